"""Cookies of this server alone: another one on the same host has others.

Browsers send the cookies of a host to every port of it, so a name carries the port under which the browser
reaches this server; a default port is not in it.
"""

from __future__ import annotations

import re

from starlette.requests import HTTPConnection
from starlette.responses import Response

SESSION = "lineside_session"
_HOST_PREFIX = "__Host-"
"""Browsers take a cookie of such a name from this host alone, and by TLS (RFC 6265bis, 4.1.3.2)."""
_PORT = re.compile(r":(\d{1,5})$")


def is_encrypted(connection: HTTPConnection) -> bool:
    """Whether the browser reached this server, or the trusted proxy before it, by TLS."""
    return connection.url.scheme in ("https", "wss")


def cookie_name(connection: HTTPConnection, name: str) -> str:
    """The name of a cookie under the scheme and the port of a request: one of another is not read."""
    port = _PORT.search(connection.headers.get("host", ""))
    return _of_scheme(connection, f"{name}_{port[1]}" if port else name)


def cookie_of(connection: HTTPConnection, name: str) -> str:
    """The value of a cookie; empty where there is none."""
    return connection.cookies.get(cookie_name(connection, name), "")


def session_name(connection: HTTPConnection) -> str:
    """The name of the cookie that has the session of a request: without a port where the session began
    before names had one."""
    name = cookie_name(connection, SESSION)
    return name if name in connection.cookies else _of_scheme(connection, SESSION)


def _of_scheme(connection: HTTPConnection, name: str) -> str:
    return f"{_HOST_PREFIX}{name}" if is_encrypted(connection) else name


def set_cookie(
    connection: HTTPConnection, response: Response, name: str, value: str, max_age_s: float
) -> None:
    """Make the browser keep a cookie that no script reads. SameSite is lax, so that a link from an e-mail
    opens signed in; changes are guarded by their Origin
    (`app.core.web.admission.security`). It is not Secure on plain HTTP, which plants use."""
    response.set_cookie(
        cookie_name(connection, name),
        value,
        max_age=int(max_age_s),
        httponly=True,
        samesite="lax",
        secure=is_encrypted(connection),
    )


def forget_cookie(connection: HTTPConnection, response: Response, name: str) -> None:
    """Make the browser delete a cookie."""
    response.delete_cookie(cookie_name(connection, name), path="/", secure=is_encrypted(connection))
