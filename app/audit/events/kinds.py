"""The kinds of event. A filter for an unknown one is refused, instead of returning nothing."""

from __future__ import annotations

from typing import Literal

EventKind = Literal[
    "access_refused",
    "alarm",
    "audit",
    "block",
    "bus",
    "clock",
    "command",
    "configuration",
    "control",
    "estop",
    "home",
    "limits",
    "login",
    "notification",
    "login_refused",
    "logout",
    "mode",
    "parameter_set",
    "recipe",
    "restore",
    "run",
    "secret",
    "server",
    "shift",
    "swap",
    "token",
    "unit",
    "user",
    "worker",
]
