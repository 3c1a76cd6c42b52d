"""Static files and the sign of life."""

from __future__ import annotations

from fastapi import APIRouter, Depends
from starlette.requests import Request
from starlette.responses import Response

from app.web.access import public
from app.web.assets import Assets
from app.web.services import service_of

router = APIRouter(dependencies=[Depends(public)], include_in_schema=False)


@router.get("/static/{version}/{name:path}")
async def static_file(request: Request, version: str, name: str) -> Response:
    """A file under the address that names its version; under another version it is not kept."""
    assets = service_of(request, Assets)
    return assets.response(request, name, forever=version == assets.version)


@router.get("/healthz")
async def health() -> dict[str, str]:
    """Responds once the app serves."""
    return {"status": "ok"}
