"""Static files and the sign of life."""

from __future__ import annotations

from typing import cast

from fastapi import APIRouter, Depends
from starlette.requests import Request
from starlette.responses import Response

from app.web.access import public
from app.web.assets import Assets

router = APIRouter(dependencies=[Depends(public)], include_in_schema=False)


def assets_of(request: Request) -> Assets:
    """The app's static files."""
    return cast(Assets, request.app.state.services.assets)


@router.get("/static/{version}/{name:path}")
async def static_file(request: Request, version: str, name: str) -> Response:
    """A file under the address that names its version; under another version it is not kept."""
    assets = assets_of(request)
    return assets.response(request, name, forever=version == assets.version)


@router.get("/healthz")
async def health() -> dict[str, str]:
    """Answers once the app serves."""
    return {"status": "ok"}
