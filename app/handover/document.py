"""A sheet as a page in the language of the site, and as one HTML file that needs no server."""

from __future__ import annotations

from app.alarms.line_alarms import LineAlarms
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


class SheetDocuments:
    """Renders sheets apart from any request."""

    def __init__(self, templates: Templates, assets: Assets, alarms: LineAlarms) -> None:
        self._templates = templates
        self._assets = assets
        self._alarms = alarms

    def page(self, sheet: bytes) -> bytes:
        """The page of a sheet, without its signatures: what is signed beside the data."""
        readable = readable_sheet(sheet)
        return self._rendered("handover/_frozen.html", sheet=readable, place_of=self._alarms.place).encode()

    def document(self, found: SheetOfShift) -> str:
        """The page with its signatures as a file."""
        page = found.signed.frozen.page if found.signed else self.page(found.sheet)
        style = self._assets.get(STYLE).body.decode()
        return self._rendered(
            "handover/document.html", page=page.decode(), style=style, shift=found.shift, signed=found.signed
        )

    def _rendered(self, name: str, **context: object) -> str:
        return self._templates.text(self._templates.site.language, name, **context)
