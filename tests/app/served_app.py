"""The complete app behind a real port, and the token of an engineer."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import uvicorn

from app.core.database import Database
from app.core.web.access import Role
from app.feature import Services
from app.main import create_app
from app.people.auth import rules, store
from app.people.auth.store import Token
from tests.app.complete_app import settings_in


@dataclass
class Api:
    """A served app and the token of an engineer."""

    url: str
    token: str

    @property
    def headers(self) -> dict[str, str]:
        return {"Authorization": f"Bearer {self.token}"}


@contextmanager
def served(folder: Path) -> Iterator[Api]:
    """Serve until the end of the context."""
    app = create_app(settings_in(folder))
    services: Services = app.state.services
    token = rules.new_secret()
    key = Token(0, "test", Role.ENGINEER, "test", 0.0, None)
    services[Database].write_now(lambda c: store.add_token(c, rules.secret_hash(token), key))
    server = uvicorn.Server(
        uvicorn.Config(app, port=0, log_level="warning", lifespan="on", ws="websockets-sansio")
    )
    thread = threading.Thread(target=server.run)
    thread.start()
    while not server.started:
        thread.join(0.02)
        assert thread.is_alive(), "the server did not start"
    port = server.servers[0].sockets[0].getsockname()[1]
    try:
        yield Api(f"http://127.0.0.1:{port}", token)
    finally:
        server.should_exit = True
        thread.join()
