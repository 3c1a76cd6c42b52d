"""The OpenAPI document: what FastAPI knows, under published names, every refusal as a problem of RFC 9457."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter
from fastapi.openapi.utils import get_openapi
from starlette.requests import Request
from starlette.responses import JSONResponse

from app.web.access import Viewer
from app.web.schema_names import with_published_names
from app.web.schema_parameters import describe_parameters
from app.web.schema_problem import problem_schemas

router = APIRouter(include_in_schema=False)


@router.get("/api/v1/openapi.json")
async def openapi(request: Request, _: Viewer) -> JSONResponse:
    """The description of every call."""
    app = request.app
    if app.openapi_schema is None:
        app.openapi_schema = openapi_document(app)
    return JSONResponse(app.openapi_schema)


def leave_bodies_out(document: dict[str, Any]) -> None:
    """A body that is not required can be left out, so it need not be null: generated clients fail on both."""
    for path in document["paths"].values():
        for operation in path.values():
            for content in operation.get("requestBody", {}).get("content", {}).values():
                match content["schema"]:
                    case {"anyOf": [schema, {"type": "null"}]}:
                        content["schema"] = schema


def openapi_document(app: Any) -> dict[str, Any]:
    """The document of an app. Raises ValueError where two schemas would have one name."""
    document = with_published_names(
        get_openapi(title=app.title, version=app.version, summary=app.summary, routes=app.routes)
    )
    describe_parameters(document)
    leave_bodies_out(document)
    components = document["components"]
    components["schemas"] |= problem_schemas(components["schemas"])
    components["securitySchemes"] = {"token": {"type": "http", "scheme": "bearer"}}
    document["security"] = [{"token": []}]
    return document
