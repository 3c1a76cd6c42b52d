"""A sheet as a page in the language of the site, and as one HTML file that needs no server."""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import Mapping
from datetime import datetime
from typing import Any

import msgspec

from app.core.web.assets import Assets
from app.core.web.templating import Templates
from app.line.alarms.line_alarms import LineAlarms
from app.records.handover.pictures import PictureStore
from app.records.handover.rules.pictures import PlainPicture
from app.records.handover.service import SheetOfShift
from bus.instants import UnixTime
from bus.messages import Message

STYLE = "css/handover-document.css"
APART = {
    "Content-Security-Policy": (
        "default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'none'; sandbox"
    )
}
"""For files with what people have written: they are never a page of this site."""
INSTANTS = frozenset({"start", "end", "until", "made_at", "time", "came", "written_at"})
_PICTURE = re.compile(r'(?<=<img src=")sha256:([0-9a-f]{64})(?=")')
"""How the page of a sheet names a picture. What people write cannot: it is escaped."""


def readable(part: Any) -> Any:
    """Return a sheet of the API, or a part of one, as templates show it: moments for its instants, and
    messages, which each reader has in their language, for its texts."""
    match part:
        case {"code": _, "params": _}:
            return msgspec.convert(part, Message)
        case dict():
            found = {
                name: _moment(each) if name in INSTANTS else readable(each) for name, each in part.items()
            }
            return found | _texts_of(found) if "trigger" in found else found
        case list():
            return [readable(each) for each in part]
        case _:
            return part


def _moment(text: str | None) -> UnixTime | None:
    return None if text is None else UnixTime(datetime.fromisoformat(text).timestamp())


def _texts_of(transition: Mapping[str, Any]) -> dict[str, str | Message]:
    """Return the name of an alarm, of a built-in one as a message; and its state."""
    alarm, code = transition["alarm"].rpartition(".")[0], transition["code"]
    title = Message(f"alarm_{code}") if alarm.endswith(f".{code}") else transition["name"]
    return {"title": title, "state": Message(f"alarm_state_{transition.get('at_end', transition['after'])}")}


class SheetDocuments:
    """Renders sheets apart from any request."""

    def __init__(
        self, templates: Templates, assets: Assets, alarms: LineAlarms, pictures: PictureStore
    ) -> None:
        self._templates = templates
        self._assets = assets
        self._alarms = alarms
        self._pictures = pictures

    def page(self, sheet: bytes) -> bytes:
        """Return the page of a sheet, without its signatures: what is signed beside the data."""
        shown = readable(msgspec.json.decode(sheet))
        return self._rendered("handover/_frozen.html", sheet=shown, place_of=self._alarms.place).encode()

    async def document(self, found: SheetOfShift) -> str:
        """Return the page with its signatures and pictures as a file."""
        page = (found.signed.page if found.signed else self.page(found.sheet)).decode()
        named = dict.fromkeys(_PICTURE.findall(page))
        pictures = await self._pictures.all_of(named)
        style = self._assets.get(STYLE).body.decode()
        page = _PICTURE.sub(lambda named: _inline(named[1], pictures), page)
        return self._rendered(
            "handover/document.html",
            page=page,
            style=style,
            shift=found.shift,
            signed=found.signed,
            missing=found.missing,
            lost=len(named) - len(pictures),
        )

    def _rendered(self, name: str, **context: object) -> str:
        return self._templates.text(self._templates.site.language, name, **context)


def _inline(digest: str, pictures: Mapping[str, PlainPicture]) -> str:
    """Return a picture as an address that holds it; one that is lost keeps its name."""
    found = pictures.get(digest)
    if found is None:
        return f"sha256:{digest}"
    return f"data:{found.media_type};base64,{b64encode(found.content).decode()}"
