"""A press that was held up on the way is not carried out, whatever it asks for.

Every page says when a button was pressed, by the server's own clock as it was told: fragments in the header
``Lineside-Asked-At``, forms of the browser in the query ``asked_at`` (static/js/review.js). Programs say
nothing: theirs to decide.
"""

from __future__ import annotations

import time

from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from app.errors import Problem
from app.web.problems import respond
from app.web.security import SAFE_METHODS

OLDEST_S = 5.0


class NotTooLate:
    """Refuses what was pressed longer than :data:`OLDEST_S` ago. Reading is never late."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        app = self._app
        if scope["type"] == "http" and scope["method"] not in SAFE_METHODS:
            request = Request(scope, receive)
            if is_late(request, time.time()):
                words = "this press came too late to be carried out; nothing was sent"
                app = respond(request, Problem(409, "late", words))
        await app(scope, receive, send)


def is_late(request: Request, now: float) -> bool:
    """Whether the page said when it was pressed, and that is too long ago. ``now``: epoch seconds."""
    said = request.headers.get("lineside-asked-at") or request.query_params.get("asked_at", "")
    try:
        return now - float(said) > OLDEST_S
    except ValueError:
        return False
