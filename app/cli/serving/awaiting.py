"""A start before the database: it waits, and each request gets a response in words meanwhile."""

from __future__ import annotations

import re
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from ssl import SSLContext

from app.cli.ending import report
from app.database.opening import look_at
from app.errors import StoreUnavailableError
from app.messages import Languages
from app.server.admission.refusal import Refusal, last_response
from app.server.service_manager import ServiceManager
from app.server.tls.certificate import ServerCertificate
from app.settings import Settings
from bus.messages import Message

RETRY_S = 1.0
WITHIN_S = 0.5
"""How long a client may take for a step of its request."""
MAX_END_S = 2.0
MAX_HEAD = 8192
WAITING = Message("waits_for_store")
RETRY_AFTER_S = "5"
"""When a page loads itself again: a panel on a wall has no keyboard."""
_ACCEPTED = re.compile(rb"^accept-language: *([^\r\n]*)", re.IGNORECASE | re.MULTILINE)
_PAGE = """<!doctype html>
<html lang="{language}">
<meta charset="utf-8"><meta name="viewport" content="width=device-width">
<meta name="color-scheme" content="light dark">
<title>Lineside</title>
<main><p>Lineside</p><h1>{text}</h1></main>
</html>
"""


def await_database(settings: Settings, listening: socket.socket, manager: ServiceManager) -> None:
    """Wait until a database of another machine responds: after a failure of power both start together. Each
    reason is reported once. Raises StoreError where waiting does not help."""
    reason: Message | None = None
    with ExitStack() as opened:
        while True:
            try:
                look_at(settings.store)
                break
            except StoreUnavailableError as error:
                if reason is None:
                    opened.enter_context(_responding(settings, listening))
                if error.message != reason:
                    report(Message.of("store_awaited", reason=error.message), err=True)
                    manager.ready(f"waiting for the database: {error.message}")
                reason = error.message
            manager.alive()
            time.sleep(RETRY_S)
    if reason is not None:
        report(Message("store_responds"))


@contextmanager
def _responding(settings: Settings, listening: socket.socket) -> Iterator[None]:
    tls, ending = settings.server.tls, threading.Event()
    context = ServerCertificate(tls).context_for(b"") if tls else None
    arguments = (ending, listening, context, settings.site.language)
    thread = threading.Thread(target=_respond_until, args=arguments, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ending.set()
        # A client that is slow on purpose keeps nothing but this thread.
        thread.join(MAX_END_S)


def _respond_until(
    ending: threading.Event, listening: socket.socket, context: SSLContext | None, language: str
) -> None:
    listening.settimeout(WITHIN_S)
    languages = Languages()
    while not ending.is_set():
        with suppress(OSError), listening.accept()[0] as plain:
            plain.settimeout(WITHIN_S)
            with context.wrap_socket(plain, server_side=True) if context else plain as client:
                client.sendall(_response(client.recv(MAX_HEAD), languages, language))


def _response(head: bytes, languages: Languages, otherwise: str) -> bytes:
    """503: for a browser a page in its language, which loads itself again; for a program a problem."""
    if b"text/html" not in head:
        return Refusal(503, WAITING.code, str(WAITING)).response()
    accepted = _ACCEPTED.search(head)
    language = languages.choose("", accepted[1].decode("latin-1") if accepted else "", otherwise)
    page = _PAGE.format(language=language, text=language.t(WAITING))
    return last_response(503, "text/html; charset=utf-8", page.encode(), Refresh=RETRY_AFTER_S)
