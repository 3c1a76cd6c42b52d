"""The pictures of the README, taken of the real thing: ``make screenshots``.

A line of the demo's eight sections is served, worked on a little so that there is something to see, and
photographed by Chromium in the sizes that people use.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

from playwright.sync_api import Browser, Page, sync_playwright

from tests.e2e.conftest import CHROMIUM, FLAGS, signed_in
from tests.e2e.site import Site, site

PICTURES = Path(__file__).parent / "pictures"
DESK = (1440, 900)
PHONE = (390, 844)
TOML = '[site]\nname = "Coater 2"\nsimulated = true\n'
SETTLE_MS = 4000
"""For deviation bars and short trends to fill."""
DECELERATION = 7

Scheme = Literal["light", "dark"]


def main() -> int:
    """Take them all."""
    PICTURES.mkdir(exist_ok=True)
    with (
        tempfile.TemporaryDirectory() as folder,
        site(Path(folder), 8, toml=TOML, line_options=("--no-script",)) as served,
        sync_playwright() as playwright,
    ):
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        _work_on(served)
        _picture(chromium, served, "line", "/", DESK)
        _picture(chromium, served, "line-dark", "/", DESK, scheme="dark")
        _picture(chromium, served, "line-phone", "/", PHONE)
        _picture(chromium, served, "unit", "/units/line/3", DESK)
        _picture(chromium, served, "parameters", "/units/line/3/parameters", DESK)
        chromium.close()
    return 0


def _work_on(served: Site) -> None:
    """One section in LOCAL, one on a long ramp, an output switched, every parameter read."""
    served.line.remote.do("mode", unit=5, to="local")
    served.line.remote.do("parameter", unit=7, number=DECELERATION, raw=3000)
    with served.api("operator") as client:
        client.put("/buses/line/units/3/outputs/1", json={"on": True}).raise_for_status()
        client.post("/buses/line/units/7/speed", json={"value": "60.0", "execute": True}).raise_for_status()
        client.get("/buses/line/units/3/parameters?refresh=true", timeout=60).raise_for_status()


def _picture(
    chromium: Browser, served: Site, name: str, path: str, size: tuple[int, int], scheme: Scheme = "light"
) -> None:
    with _page(chromium, served, size, scheme) as page:
        page.goto(path)
        page.wait_for_selector("body[data-link=live]")
        page.wait_for_timeout(SETTLE_MS)
        page.screenshot(path=PICTURES / f"{name}.png")


@contextmanager
def _page(chromium: Browser, served: Site, size: tuple[int, int], scheme: Scheme) -> Iterator[Page]:
    context = chromium.new_context(
        base_url=served.url,
        storage_state=signed_in(chromium, served, "engineer"),
        viewport={"width": size[0], "height": size[1]},
        color_scheme=scheme,
    )
    yield context.new_page()
    context.close()


if __name__ == "__main__":
    sys.exit(main())
