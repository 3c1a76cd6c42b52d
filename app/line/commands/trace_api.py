"""``GET /buses/{bus}/trace``: the frames that a worker has kept, decoded, as JSON or as a file.

The frames show every value that passed, so this needs an engineer.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import AsyncIterator, Iterable
from datetime import UTC, datetime
from typing import Annotated, Any

from fastapi import APIRouter, Query
from starlette.responses import JSONResponse, Response, StreamingResponse
from typing_extensions import TypedDict

from app.core.web.access import Person
from app.core.web.api import ApiRoute
from app.core.web.routes import DOWNLOAD
from app.errors import Problem
from app.line.commands.api import FrameShown, frame_json
from app.line.commands.catalogue import READ_TRACE
from app.line.commands.service import Commands, CommandService, permitted
from app.line.commands.trace_file import trace_line
from bus.contract import Frame, ReadTrace
from bus.instants import UnixTime, unix_now
from bus.messages import Message

router = APIRouter(prefix="/api/v1/buses/{bus}", tags=["trace"], route_class=ApiRoute)
HOUR_S = 3600.0
RECENT_S = 60.0
PIECE = 2000
MAX_PIECES = 200
"""An hour of a full bus has 140. Bounds a download from a worker that always has more frames."""


class TraceShown(TypedDict):
    """The last frames of a bus, oldest first."""

    bus: str
    frames: list[FrameShown]


TRACE: dict[int | str, dict[str, Any]] = {
    200: {"model": TraceShown, "content": {"text/plain": {"schema": {"type": "string"}}}}
}


@router.get("/trace", responses=TRACE, dependencies=[DOWNLOAD])
async def get_trace(
    person: Annotated[Person, permitted(READ_TRACE)],
    commands: Commands,
    bus: str,
    seconds: Annotated[float | None, Query(gt=0, le=HOUR_S)] = None,
    limit: Annotated[int, Query(ge=1, le=PIECE)] = 200,
) -> Response:
    """Return the last ``limit`` frames as JSON; with ``seconds`` all of that time as a text file, one frame a
    line, which ``lineside decode`` reads back."""
    now = unix_now()
    if seconds is None:
        frames: deque[Frame] = deque(maxlen=limit)
        async for piece in _pieces(commands, person, now - RECENT_S):
            frames.extend(piece)
        return JSONResponse({"bus": bus, "frames": [shown async for shown in _shown(frames)]})
    pieces = _pieces(commands, person, now - seconds)
    first: list[Frame] = await anext(pieces, [])
    name = f"{bus}-{datetime.fromtimestamp(float(now), UTC):%Y%m%dT%H%M%SZ}.trace.txt"
    headers = {"Content-Disposition": f'attachment; filename="{name}"'}
    return StreamingResponse(_lines(first, pieces), headers=headers, media_type="text/plain; charset=utf-8")


async def _pieces(commands: CommandService, person: Person, since: UnixTime) -> AsyncIterator[list[Frame]]:
    for _ in range(MAX_PIECES):
        result = await commands.send(person, ReadTrace(since=since, limit=PIECE))
        if result.outcome not in ("verified", "acknowledged"):
            reason = result.message or Message("worker_no_result")
            raise Problem(503, result.outcome, reason, outcome=result.outcome)
        frames = [frame for frame in result.frames if frame.at > since]
        if frames:
            yield frames
        if len(result.frames) < PIECE:
            return
        since = frames[-1].at


async def _shown(frames: Iterable[Frame]) -> AsyncIterator[FrameShown]:
    """Yield each frame as JSON. Two thousand take a tenth of a second, during which others have their
    turns."""
    for frame in frames:
        yield frame_json(frame)
        await asyncio.sleep(0)


async def _lines(first: list[Frame], pieces: AsyncIterator[list[Frame]]) -> AsyncIterator[str]:
    yield _text(first)
    async for frames in pieces:
        yield _text(frames)


def _text(frames: list[Frame]) -> str:
    return "".join(f"{trace_line(frame)}\n" for frame in frames)
