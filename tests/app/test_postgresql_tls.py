"""The database over TLS with `sslmode=verify-full`: it is reached by its own certificate and by no other."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from app.database.opening import look_at, open_database
from app.database.settings import StoreSettings
from app.errors import StoreUnavailableError
from tests.certificates import certificates
from tests.free_port import free_port
from tests.own_postgresql import OwnPostgresql, own_postgresql
from tests.postgresql import USER, needs_postgresql

pytestmark = needs_postgresql


@pytest.fixture(scope="module")
def postgresql() -> Iterator[OwnPostgresql]:
    with own_postgresql() as made:
        certificates(made.folder)
        yield made


def served(postgresql: OwnPostgresql, name: str) -> StoreSettings:
    """A database whose certificate is that of this name."""
    for ending in ("pem", "key"):
        file = postgresql.folder / f"database.{ending}"
        file.write_bytes((postgresql.folder / f"{name}.{ending}").read_bytes())
        file.chmod(0o600)
        if os.geteuid() == 0:
            shutil.chown(file, "nobody")
    postgresql.kill()
    port, folder = free_port(), postgresql.folder
    files = {
        f"ssl_{kind}_file": f"{folder}/database.{ending}"
        for kind, ending in (("cert", "pem"), ("key", "key"))
    }
    postgresql.start(listen_addresses="localhost", port=str(port), ssl="on", **files)
    verified = f"sslmode=verify-full&sslrootcert={folder}/ca.pem"
    return StoreSettings(url=f"postgresql://{USER}@localhost:{port}/postgres?{verified}")


def test_it_is_reached_by_its_certificate(postgresql: OwnPostgresql) -> None:
    with closing(open_database(served(postgresql, "server"), Path("lineside.db"))) as database:
        encrypted = "SELECT ssl FROM pg_stat_ssl WHERE pid = pg_backend_pid()"
        assert database.read_now(lambda c: c.execute(encrypted).fetchone()[0])


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("misnamed", "does not match host name"),
        ("expired", "certificate verify failed"),
        ("other/server", "certificate verify failed"),
    ],
)
def test_another_certificate_is_refused_in_words(postgresql: OwnPostgresql, name: str, words: str) -> None:
    with pytest.raises(StoreUnavailableError, match=f"it cannot be reached: .*{words}"):
        look_at(served(postgresql, name))


def test_an_authority_that_is_half_written_is_refused_in_words(
    postgresql: OwnPostgresql, tmp_path: Path
) -> None:
    half = tmp_path / "ca.pem"
    half.write_text((postgresql.folder / "ca.pem").read_text()[:300])
    url = served(postgresql, "server").url.replace(str(postgresql.folder / "ca.pem"), str(half))
    with pytest.raises(StoreUnavailableError, match="could not read root certificate file"):
        look_at(StoreSettings(url=url))
