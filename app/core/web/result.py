"""The result of an act, on the page to which the browser is sent after it.

It is in a cookie, which the page reads once. In the address it would be part of a link, with which anybody
could make the page say that a token was revoked.
"""

from urllib.parse import parse_qsl, quote, unquote, urlencode

from starlette.requests import HTTPConnection
from starlette.responses import RedirectResponse, Response

from app.core.web.access import cookie_of, forget_cookie, set_cookie
from app.core.web.problems import is_fragment

_COOKIE, _MAX_AGE_S = "lineside_result", 60.0
_PAGE = "page"


def send_to(connection: HTTPConnection, page: str, **result: str) -> Response:
    """Send the browser to the path ``page``, which shows the result."""
    response = (
        Response(headers={"HX-Redirect": page}) if is_fragment(connection) else RedirectResponse(page, 303)
    )
    # Quoted again, because `request_rules` drops a cookie in quotation marks.
    set_cookie(connection, response, _COOKIE, quote(urlencode({_PAGE: page, **result})), _MAX_AGE_S)
    return response


def result_of(connection: HTTPConnection) -> dict[str, str]:
    """Return the result for the page of a request; empty if it was opened otherwise."""
    kept = dict(parse_qsl(unquote(cookie_of(connection, _COOKIE))))
    return kept if kept.pop(_PAGE, "") == connection.url.path else {}


def shown_once(connection: HTTPConnection, response: Response) -> Response:
    """Make the browser forget the result that a page shows."""
    if result_of(connection):
        forget_cookie(connection, response, _COOKIE)
    return response
