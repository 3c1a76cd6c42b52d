"""The OpenAPI document: what FastAPI knows, and that every refusal is a problem of RFC 9457."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter
from fastapi.openapi.utils import get_openapi
from starlette.requests import Request
from starlette.responses import JSONResponse

from app.web.access import Viewer

router = APIRouter(include_in_schema=False)

_PROBLEM = {
    "type": "object",
    "required": ["type", "title", "status", "code", "detail"],
    "properties": {
        "type": {"type": "string"},
        "title": {"type": "string"},
        "status": {"type": "integer"},
        "code": {"type": "string", "description": "the reason, for programs"},
        "detail": {"type": "string", "description": "the reason and what to do, for people"},
    },
}
_REFUSAL = {
    "description": "Refused; nothing was done that is not said",
    "content": {"application/problem+json": {"schema": {"$ref": "#/components/schemas/Problem"}}},
}
_METHODS = ("get", "put", "post", "delete", "patch")


@router.get("/api/v1/openapi.json")
async def openapi(request: Request, _: Viewer) -> JSONResponse:
    """The description of every call."""
    app = request.app
    if app.openapi_schema is None:
        app.openapi_schema = _document(app)
    return JSONResponse(app.openapi_schema)


def _document(app: Any) -> dict[str, Any]:
    document = get_openapi(title=app.title, version=app.version, summary=app.summary, routes=app.routes)
    components = document.setdefault("components", {})
    components.setdefault("schemas", {})["Problem"] = _PROBLEM
    components["securitySchemes"] = {"token": {"type": "http", "scheme": "bearer"}}
    document["security"] = [{"token": []}]
    for path in document["paths"].values():
        for method in _METHODS:
            if method in path:
                path[method]["responses"].pop("422", None)
                path[method]["responses"]["default"] = _REFUSAL
    return document
