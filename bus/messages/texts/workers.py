"""Texts about a bus worker, and about a command whose result the app does not have."""

from __future__ import annotations

from bus.messages.texts.plural import EnglishText

TEXTS: dict[str, EnglishText] = {
    "worker_version_differs": (
        "this dashboard has version {version} of the contract and the worker {of_worker}: "
        "install the same release of lineside on both"
    ),
    "worker_token_of_other_bus": "the token is for bus {bus}; create one for the bus of this worker",
    "worker_bus_unknown": "no [[bus]] is called {bus} in this dashboard's lineside.toml (it has: {known})",
    "worker_bus_held": "another worker has this bus, or had it a moment ago",
    "updates_implausible": (
        "invalid time or a unit that is not configured; check the clock and the units of the bus worker"
    ),
    "event_worker_started": "bus worker started, port {port}",
    "event_worker_back": "bus worker is back, port {port}",
    "event_worker_refused": "bus worker refused",
    "event_updates_refused": "updates of the bus worker refused",
    "event_worker_clock_stepped": "clock of the bus worker stepped by {step} s",
    "worker_not_connected": "the bus worker is not connected",
    "worker_silent": "the bus worker is connected and does not respond",
    "worker_malformed": "the bus worker was disconnected: it sent a malformed message",
    "worker_lost": "the bus worker is not connected: whether the unit executed it is not known",
    "worker_restarted": "the bus worker was restarted: whether the unit executed it is not known",
    "worker_no_response": ("the bus worker does not respond: whether the unit executed it is not known"),
    "worker_no_result": ("the bus worker did not report a result: whether the unit executed it is not known"),
    "server_stopped": "the server stopped before the result was known",
    "result_unreadable": (
        "its result was stored and cannot be read: whether the unit executed it is not known"
    ),
    "secret_differs": "the unit reads another value, which is not shown",
}
