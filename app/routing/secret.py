"""The secret by which the servers of a site know each other. It is in their store and nowhere else."""

from __future__ import annotations

import secrets

from app.database import StoreConnection
from app.routing.forwarding.hop import SECRET_BYTES


def site_secret(connection: StoreConnection) -> bytes:
    """The secret of the site, made by the server that comes first."""
    connection.execute(
        "INSERT INTO site_secret (id, secret) VALUES (1, ?) ON CONFLICT (id) DO NOTHING",
        (secrets.token_bytes(SECRET_BYTES),),
    )
    return bytes(connection.execute("SELECT secret FROM site_secret WHERE id = 1").fetchone()[0])
