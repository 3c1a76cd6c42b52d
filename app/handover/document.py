"""A sheet as a page in the language of the site, and as one HTML file that needs no server."""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import Mapping

from app.alarms.line_alarms import LineAlarms
from app.handover.pictures import PictureStore
from app.handover.rules.pictures import PlainPicture
from app.handover.service import SheetOfShift
from app.handover.sheet_view import readable_sheet
from app.web.assets import Assets
from app.web.templating import Templates

STYLE = "css/handover-document.css"
APART = {
    "Content-Security-Policy": (
        "default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'none'; sandbox"
    )
}
"""For files with what people have written: they are never a page of this site."""


_PICTURE = re.compile(r'(?<=<img src=")sha256:([0-9a-f]{64})(?=")')
"""How the page of a sheet names a picture. What people write cannot: it is escaped."""


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
        """The page of a sheet, without its signatures: what is signed beside the data."""
        readable = readable_sheet(sheet)
        return self._rendered("handover/_frozen.html", sheet=readable, place_of=self._alarms.place).encode()

    async def document(self, found: SheetOfShift) -> str:
        """The page with its signatures and pictures as a file."""
        page = (found.signed.frozen.page if found.signed else self.page(found.sheet)).decode()
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
    """A picture as an address that holds it; one that is lost keeps its name."""
    found = pictures.get(digest)
    if found is None:
        return f"sha256:{digest}"
    return f"data:{found.media_type};base64,{b64encode(found.content).decode()}"
