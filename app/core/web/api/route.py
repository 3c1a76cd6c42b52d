"""A route of the API: repeated and unknown parameters of a request are refused, not guessed at."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Coroutine, Mapping
from typing import Annotated, Any, cast, get_args, get_origin

from fastapi import Header, params
from fastapi.dependencies.utils import get_flat_params, get_typed_return_annotation
from fastapi.routing import APIRoute
from pydantic import ConfigDict, with_config
from starlette.datastructures import QueryParams
from starlette.requests import Request
from starlette.responses import Response
from typing_extensions import is_typeddict

from app.core.web.admission.bounds import MAX_PLAIN_BODY_BYTES, parse_apart
from app.core.web.api.schema import usual_problems
from app.errors import Problem
from bus.messages import Message

MAX_MEMBERS = 1000
"""Members of a JSON object; the largest has one for each of 255 units. An unknown one is a fault each."""
_HALF_PAIR = re.compile("[\ud800-\udfff]")
RouteHandler = Callable[[Request], Coroutine[Any, Any, Response]]
RequestKey = Annotated[
    str | None,
    Header(
        alias="Idempotency-Key",
        min_length=1,
        max_length=200,
        description="A request that is sent again with its key is carried out once.",
    ),
]


class ApiRoute(APIRoute):
    """For ``APIRouter(route_class=ApiRoute)``.

    Most servers take the last of two and pass over what they do not know. A filter with a slip in its name
    would then let everything through, and of two setpoints one would be set that another program did not see.
    """

    def __init__(self, path: str, endpoint: Callable[..., Any], **options: Any) -> None:
        name = endpoint.__name__
        options["operation_id"] = options.get("operation_id") or name
        options["summary"] = options.get("summary") or name.replace("_", " ").capitalize()
        for shown in (options.get("response_model"), get_typed_return_annotation(endpoint)):
            if is_typeddict(shown):
                # Its validator is built for the first response: all at once would take a fifth of the start.
                with_config(ConfigDict(defer_build=True))(cast(type, shown))
        usual = usual_problems(path, options.get("methods") or ["GET"])
        super().__init__(path, endpoint, **{**options, "responses": usual | (options.get("responses") or {})})

    def get_route_handler(self) -> RouteHandler:
        """As FastAPI has it, behind the checks."""
        handle = super().get_route_handler()
        expected = get_flat_params(self.dependant)
        known = {
            parameter.alias: _is_list(parameter.field_info.annotation)
            for parameter in expected
            if isinstance(parameter.field_info, params.Query)
        }

        async def careful(request: Request) -> Response:
            _check_query(request.query_params, known)
            return await handle(_OfOneMeaning(request.scope, request.receive))

        return careful


class _OfOneMeaning(Request):
    """A request whose JSON has no repeated key (RFC 8259, 4 leaves open which of them would hold)."""

    async def json(self) -> Any:
        """Raises Problem 422 for a key given twice."""
        body = await self.body()
        if len(body) <= MAX_PLAIN_BODY_BYTES:
            return _loads(body)
        return await parse_apart(lambda: _loads(body))


def _loads(body: bytes) -> Any:
    return json.loads(body, object_pairs_hook=_each_once)


def _each_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    if len(pairs) > MAX_MEMBERS:
        raise Problem(422, "invalid", Message.of("too_many_members", n=MAX_MEMBERS))
    made: dict[str, Any] = {}
    for name, value in pairs:
        if name in made:
            raise _twice(ascii(name))
        made[name] = value
    for name in made:
        # Pydantic ignores a key with half a surrogate pair, even where unknown ones are forbidden.
        if _HALF_PAIR.search(name):
            raise Problem(422, "invalid", Message.of("field_unknown", name=ascii(name)))
    return made


def _check_query(query: QueryParams, known: Mapping[str, bool]) -> None:
    """``known``: by name whether it may be given several times. Raises Problem 422."""
    for name in query:
        if name not in known:
            names = {"known": ", ".join(known)} if known else {}
            code = "parameter_unknown" if known else "parameter_unknown_none"
            raise Problem(422, "invalid", Message.of(code, name=name, **names))
        if not known[name] and len(query.getlist(name)) > 1:
            raise _twice(name)


def _twice(name: str) -> Problem:
    return Problem(422, "invalid", Message.of("parameter_twice", name=name))


def _is_list(annotation: Any) -> bool:
    return list in (get_origin(each) for each in (annotation, *get_args(annotation)))
