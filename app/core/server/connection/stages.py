"""Tells the gate of a connection how far its request is: an ASGI middleware before all others."""

from __future__ import annotations

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.core.server.admission.turns import ARRIVED_AT
from app.core.server.connection.client_connection import CONNECTION
from app.core.server.connection.gate import Gate


class Stages:
    """Tells the gate what the app and uvicorn do with a request, and stamps it with its arrival."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        gate: Gate = scope["state"][CONNECTION]
        scope["state"][ARRIVED_AT] = gate.arrived_at

        async def receiving() -> Message:
            message = await receive()
            if message["type"] in ("http.request", "websocket.receive"):
                gate.received(len(message.get("body", b"")), is_all=not message.get("more_body"))
            return message

        async def sending(message: Message) -> None:
            if message["type"] == "http.response.start" and gate.is_last():
                message = {**message, "headers": [*message.get("headers", ()), (b"connection", b"close")]}
            await send(message)
            match message["type"]:
                case "http.response.body" if not message.get("more_body"):
                    gate.responded()
                case "websocket.accept":
                    gate.opened()
                case "websocket.close":
                    gate.closed()

        refusal = gate.begin(scope)
        await (refusal or self._app)(scope, receiving, sending)
