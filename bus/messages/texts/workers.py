"""What the app says of a bus worker, and of a command whose result it does not have."""

from __future__ import annotations

from bus.messages.texts.plural import EnglishText

TEXTS: dict[str, EnglishText] = {
    "worker_not_connected": "the bus worker is not connected",
    "worker_silent": "the bus worker is connected and does not respond",
    "worker_malformed": "the bus worker was disconnected: it sent a malformed message",
    "worker_lost": "the bus worker is not connected: whether the unit acted is not known",
    "worker_restarted": "the bus worker was restarted: whether the unit acted is not known",
    "worker_no_response": "the bus worker does not respond: whether the unit acted is not known",
    "worker_no_result": "the bus worker did not report a result: whether the unit acted is not known",
    "server_stopped": "the server stopped before the result was known",
    "result_unreadable": "its result was stored and cannot be read: whether the unit acted is not known",
    "secret_differs": "the unit reads another value, which is not shown",
}
