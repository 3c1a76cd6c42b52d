"""A mail server and a receiver of webhooks, real ones on this machine, as a test sets them."""

from __future__ import annotations

import asyncio
import json
import shutil
import ssl
import subprocess
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from email import message_from_bytes
from email.message import EmailMessage
from email.policy import default
from pathlib import Path
from typing import Any, cast

import pytest

LIMIT_S = 60.0
Serve = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


@asynccontextmanager
async def listening(serve: Serve, context: ssl.SSLContext | None = None) -> AsyncIterator[int]:
    """A server on this machine; its port. Every connection is closed at the end."""
    tasks: set[asyncio.Task[None]] = set()

    async def connected(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        tasks.add(task)
        try:
            with suppress(OSError, asyncio.IncompleteReadError):
                await serve(reader, writer)
        finally:
            writer.close()
            with suppress(OSError):
                await writer.wait_closed()

    server = await asyncio.start_server(connected, "127.0.0.1", 0, ssl=context)
    try:
        yield server.sockets[0].getsockname()[1]
    finally:
        server.close()
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


def certificate(folder: Path) -> Path:
    """A certificate that signs itself, with its key, for 127.0.0.1."""
    openssl = shutil.which("openssl")
    if openssl is None:
        pytest.skip("openssl makes the certificate, and is not here")
    made, key = folder / "plant.pem", folder / "plant.key"
    names = ("-subj", "/CN=plant", "-addext", "subjectAltName=IP:127.0.0.1")
    kind = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2")
    command = [openssl, "req", "-x509", *kind, *names, "-keyout", str(key), "-out", str(made)]
    subprocess.run(command, check=True, capture_output=True)
    made.write_text(made.read_text() + key.read_text())
    return made


def server_context(file: Path) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(file)
    return context


@dataclass
class PlayedMailServer:
    """``replies``: what it replies to a command instead of agreeing; empty: it does not reply at all."""

    context: ssl.SSLContext | None = None
    replies: dict[str, str] = field(default_factory=dict)
    port: int = 0
    mails: list[EmailMessage] = field(default_factory=list)
    recipients: list[str] = field(default_factory=list)
    commands: list[str] = field(default_factory=list)
    is_encrypted: bool = False
    greeting: str = "220 plant"
    arrived: asyncio.Condition = field(default_factory=asyncio.Condition)

    async def mail(self, count: int = 1) -> EmailMessage:
        """The mail of this number, once it is there."""
        async with asyncio.timeout(LIMIT_S), self.arrived:
            await self.arrived.wait_for(lambda: len(self.mails) >= count)
        return self.mails[count - 1]

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if not self.greeting:
            await reader.read()
            return
        writer.write(f"{self.greeting}\r\n".encode())
        offers_tls = self.context is not None
        while line := (await reader.readline()).decode():
            async with self.arrived:
                self.commands.append(line.strip())
                self.arrived.notify_all()
            word = line.split()[0].upper()
            reply = self.replies.get(word, self._reply(word, line, offers_tls))
            if not reply:
                await reader.read()
                return
            writer.write(f"{reply}\r\n".encode())
            if word == "STARTTLS" and reply.startswith("220"):
                assert self.context is not None
                await writer.start_tls(self.context)
                self.is_encrypted, offers_tls = True, False
            if word == "DATA" and reply.startswith("354"):
                await self._take(await reader.readuntil(b"\r\n.\r\n"), writer)
            if word == "QUIT":
                return

    def _reply(self, word: str, line: str, offers_tls: bool) -> str:
        if word == "EHLO":
            offers = ["plant", "AUTH PLAIN", *(["STARTTLS"] if offers_tls else [])]
            return "\r\n".join([*(f"250-{offer}" for offer in offers), "250 HELP"])
        if word == "RCPT":
            self.recipients.append(line.partition("<")[2].partition(">")[0])
        return {"STARTTLS": "220 go", "DATA": "354 go", "QUIT": "221 bye", "AUTH": "235 ok"}.get(
            word, "250 ok"
        )

    async def _take(self, content: bytes, writer: asyncio.StreamWriter) -> None:
        mail = message_from_bytes(content.removesuffix(b".\r\n"), policy=default)
        async with self.arrived:
            self.mails.append(cast(EmailMessage, mail))
            self.arrived.notify_all()
        reply = self.replies.get("CONTENT", "250 queued")
        writer.write(f"{reply}\r\n".encode() if reply else b"")


@asynccontextmanager
async def mail_server(context: ssl.SSLContext | None = None, **more: Any) -> AsyncIterator[PlayedMailServer]:
    """Listening on ``port``."""
    played = PlayedMailServer(context, **more)
    async with listening(played.serve) as played.port:
        yield played


@dataclass
class PlayedReceiver:
    """``response``: what it sends back; None: nothing, ever."""

    response: bytes | None = b"HTTP/1.1 204 No Content\r\n\r\n"
    url: str = ""
    received: list[tuple[dict[str, str], bytes]] = field(default_factory=list)
    arrived: asyncio.Condition = field(default_factory=asyncio.Condition)

    async def body(self, count: int = 1) -> dict[str, Any]:
        """The body of the POST of this number, once it is there."""
        async with asyncio.timeout(LIMIT_S), self.arrived:
            await self.arrived.wait_for(lambda: len(self.received) >= count)
        body: dict[str, Any] = json.loads(self.received[count - 1][1])
        return body

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        head = (await reader.readuntil(b"\r\n\r\n")).decode().split("\r\n")
        headers = {name.lower(): value for name, _, value in (line.partition(": ") for line in head[1:])}
        body = await reader.readexactly(int(headers.get("content-length", 0)))
        async with self.arrived:
            self.received.append((headers, body))
            self.arrived.notify_all()
        if self.response is None:
            await reader.read()
        else:
            writer.write(self.response)
            await writer.drain()


@asynccontextmanager
async def receiver(context: ssl.SSLContext | None = None, **more: Any) -> AsyncIterator[PlayedReceiver]:
    """Listening at ``url``."""
    played = PlayedReceiver(**more)
    async with listening(played.serve, context) as port:
        played.url = f"{'http' if context is None else 'https'}://127.0.0.1:{port}/hooks/s3cret"
        yield played
