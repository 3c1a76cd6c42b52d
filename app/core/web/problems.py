"""The responses to refusals and failures: RFC 9457 for programs, a page or fragment for people."""

from __future__ import annotations

import json
from collections.abc import Sequence
from http import HTTPStatus
from typing import Any
from urllib.parse import urlsplit

import structlog
from fastapi import FastAPI
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, HTTPConnection, Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Match
from starlette.websockets import WebSocket

from app.core.server.refusals import HEADERS
from app.core.server.turns import TooManyWaitingError
from app.core.web.access import caller_of
from app.core.web.shape import message_shown, reason_shown
from app.core.web.templating import render, templates_of
from app.errors import Problem, ProblemCode, StoreError, TooCostlyError
from bus.errors import CallerError
from bus.messages import Message
from bus.validation import fault_message

log = structlog.get_logger()

_CODES: dict[int, ProblemCode] = {
    401: "unauthorized",
    403: "forbidden",
    404: "not_found",
    405: "method_not_allowed",
    422: "invalid",
}

RETRY_AFTER_S = 2
"""The seconds until a request is worth a second try, if nothing better is known."""
MAX_FAULTS = 20
"""The most faults of one body that are named."""


def wants_json(connection: HTTPConnection) -> bool:
    """Return whether a program sent the request: to the API, or elsewhere without accepting HTML."""
    path = connection.scope["path"]
    if path.startswith("/api/") or path in ("/metrics", "/healthz"):
        return True
    accepts = connection.headers.get("accept", "*/*")
    return "text/html" not in accepts and "*/*" not in accepts


def is_fragment(connection: HTTPConnection) -> bool:
    """Return whether htmx sent the request, to swap the response into an open page."""
    return connection.headers.get("hx-request") == "true"


class _ProblemResponse(JSONResponse):
    """A problem whose body may hold half a surrogate pair, as a key of a request may, which UTF-8 cannot
    encode."""

    media_type = "application/problem+json"

    def render(self, content: Any) -> bytes:
        text = json.dumps(content, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
        return text.encode("utf-8", "replace")


def problem_json(problem: Problem, detail: str = "") -> JSONResponse:
    """Return the problem as ``application/problem+json``; ``detail`` replaces its English text."""
    reason = reason_shown(problem.message)
    # A value that is a member of the problem is stated only there.
    params = {name: value for name, value in reason["params"].items() if name not in problem.extra}
    content = {
        "type": "about:blank",
        "title": HTTPStatus(problem.status).phrase,
        "status": problem.status,
        "code": problem.code,
        **reason,
        "params": params,
        "detail": detail or problem.detail,
        **problem.extra,
    }
    return _ProblemResponse(content, problem.status, problem.headers)


async def refuse_socket(socket: WebSocket, problem: Problem) -> None:
    """Refuse a handshake by an HTTP response if the server can, else by a close code 4000 + status."""
    if "websocket.http.response" in socket.scope.get("extensions", {}):
        await socket.send_denial_response(problem_json(problem))
    else:
        await socket.close(4000 + problem.status, problem.code)


def respond(request: HTTPConnection, problem: Problem) -> Response:
    """Return the problem in the form that the client can read."""
    # Only for a read: clients such as urllib3 repeat a PUT on their own if a 503 has a time, and a command is
    # never sent late.
    if problem.status == 503 and request.scope.get("method") in ("GET", "HEAD"):
        problem.headers.setdefault("Retry-After", str(RETRY_AFTER_S))
    if wants_json(request):
        return problem_json(problem, _detail(request, problem))
    template = "web/_problem.html" if is_fragment(request) else "web/problem.html"
    # What a form is about and is gone, its page has lost as well.
    left = _page_left(request) if request.scope.get("method") == "POST" and problem.status != 404 else ""
    return render(
        request, template, status=problem.status, headers=problem.headers, problem=problem, left=left
    )


def _page_left(request: HTTPConnection) -> str:
    """Return the path of the page whose form was sent; empty if the browser does not name it."""
    page = urlsplit(request.headers.get("referer", ""))
    # Browsers read two slashes as another host.
    path = f"/{page.path.lstrip('/')}" if page.scheme in ("http", "https") else ""
    return f"{path}?{page.query}" if path and page.query else path


def _detail(request: HTTPConnection, problem: Problem) -> str:
    """Return the text of a problem: English for a program with a token, in the reader's language for a page
    that calls the API."""
    person = caller_of(request)
    if person is None or person.via != "session":
        return problem.detail
    return templates_of(request).language_of(request).t(problem.message)


def too_many_requests() -> Problem:
    """Return the refusal of a request while too many of its account or address wait for their turn."""
    return Problem(429, "too_many", Message("too_many_requests")).with_headers(Retry_After=str(RETRY_AFTER_S))


def _place(location: Sequence[int | str]) -> str:
    return ".".join(str(step) for step in location if step not in ("body", "query", "path")) or "body"


def invalid(errors: Sequence[Any]) -> Problem:
    """Return the refusal of malformed input, which names each fault; its place may be a key of the
    request."""
    if any(error["type"] == "json_invalid" for error in errors):
        return Problem(422, "invalid", Message("body_not_json"))
    found = [(_place(error["loc"]), fault_message(error)) for error in errors[:MAX_FAULTS]]
    faults = [Message.of("fault_at", where=where, fault=fault) for where, fault in found]
    named = [{"where": where, **message_shown(fault)} for where, fault in found]
    return Problem(422, "invalid", Message.of("fields_malformed", errors=faults), errors=named)


def _methods(request: HTTPConnection) -> list[str]:
    """Return all methods that the path takes: the router names only those of the first route that it
    finds."""
    routes = [route for route in request.app.routes if route.matches(request.scope)[0] is not Match.NONE]
    methods = {method for route in routes for method in getattr(route, "methods", None) or ()}
    return sorted(methods | ({"HEAD"} if "GET" in methods else set()))


def is_below_a_path(connection: HTTPConnection) -> bool:
    """Return whether the path is unknown here, but known without its first part: a proxy then serves us below
    a path."""
    scope, routes = connection.scope, connection.scope["app"].routes
    tail = scope["path"][1:].partition("/")
    candidates = ({**scope, "path": f"/{tail[2]}"}, scope)
    below, here = (any(route.matches(each)[0] is Match.FULL for route in routes) for each in candidates)
    return bool(tail[1]) and below and not here


def _of_http(request: HTTPConnection, error: HTTPException) -> Problem:
    """Return a refusal by Starlette or FastAPI as a problem."""
    path = request.url.path
    match error.status_code:
        case _ if isinstance(error.__cause__, Problem):
            return error.__cause__
        case 400:
            return Problem(422, "invalid", Message("body_not_readable"))
        case 404:
            code = "served_below_a_path" if is_below_a_path(request) else "nothing_at_path"
            message = Message.of(code, path=path)
        case 405:
            message = Message.of("method_not_for_path", method=request.scope["method"], path=path)
        case _:
            message = Message.of("http_refused", reason=str(error.detail))
    problem = Problem(error.status_code, _CODES.get(error.status_code, "refused"), message)
    problem.headers.update(error.headers or {})
    if error.status_code == 405:
        problem.with_headers(Allow=", ".join(_methods(request)))
    return problem


def _problem_of(request: HTTPConnection, error: Exception) -> Problem:
    match error:
        case Problem():
            return error
        case CallerError():
            return Problem(422, "invalid", error.message)
        case TooManyWaitingError():
            return too_many_requests()
        case TooCostlyError():
            return Problem(503, "too_costly", error.message)
        case StoreError():
            log.error("store", path=request.url.path, error=str(error))
            return Problem(503, "store", error.message)
        case RequestValidationError():
            return invalid(error.errors())
        case HTTPException():
            return _of_http(request, error)
        case UnicodeDecodeError() | json.JSONDecodeError():
            return Problem(422, "invalid", Message("body_not_utf8"))
    # Starlette raises it again, for the server to log. It calls this outside of every middleware, so the
    # headers of all others are set here.
    return Problem(500, "failed", Message("server_failed")).with_headers(**HEADERS)


async def _on_error(request: Request | WebSocket, error: Exception) -> Response | None:
    if isinstance(error, Problem) and isinstance(request, WebSocket):
        await refuse_socket(request, error)
        return None
    # The client has left in the middle of its body: no page is needed.
    is_gone = isinstance(error.__cause__, ClientDisconnect)
    if isinstance(error, HTTPException) and (is_gone or error.status_code in (204, 304)):
        return Response(status_code=error.status_code)
    return respond(request, _problem_of(request, error))


def install(app: FastAPI) -> None:
    """Add the handlers that respond to every kind of failure."""
    refusals = (Problem, CallerError, StoreError, TooManyWaitingError, HTTPException, RequestValidationError)
    for kind in (*refusals, UnicodeDecodeError, json.JSONDecodeError, Exception):
        app.exception_handler(kind)(_on_error)
