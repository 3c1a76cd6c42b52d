"""Where the next page of a list is, for a list that is an array and has no member for it (RFC 8288)."""

from __future__ import annotations

from typing import Any

from starlette.requests import Request
from starlette.responses import Response

NEXT_PAGE: dict[int | str, dict[str, Any]] = {
    200: {"headers": {"Link": {"$ref": "#/components/headers/Link"}}},
}
"""For ``responses=``."""


def link_next(request: Request, response: Response, before: int) -> None:
    """Name the page of what is before an id, with the other parameters of the request."""
    url = request.url.include_query_params(before=before)
    response.headers["Link"] = f'<{url.path}?{url.query}>; rel="next"'
