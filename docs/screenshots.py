"""Every page in every situation as people see it: ``make screenshots``.

Lines of the simulator are served and brought into the situations of ``docs.scenes``; Chromium photographs
them as a phone, a panel and a desktop, by day and by night, in every language, into ``docs/pictures/all``,
which is not kept. The few pictures of the README and of the operator's guide are taken on the way, the moving
one among them.

    python -m docs.screenshots [--situation NAME …] [--scene NAME …] [--size NAME …] [--look light-en …]
"""

from __future__ import annotations

import argparse
import base64
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from itertools import groupby
from pathlib import Path
from typing import Any

from playwright.sync_api import Browser, FloatRect, Page, sync_playwright

from docs.animation import animated
from docs.scenes import SITUATIONS, Scene, Situation
from tests.e2e.conftest import CHROMIUM, FLAGS, signed_in
from tests.e2e.site import Site, site

PICTURES = Path(__file__).parent / "pictures"
ALL = PICTURES / "all"
SIZES = {"phone": (360, 780), "panel": (1280, 800), "desktop": (1920, 1080)}
LOOKS = [f"{scheme}-{language}" for scheme in ("light", "dark") for language in ("en", "de")]
TOML = '[site]\nname = "Coater 2"\nsimulated = true\n'
SETTLE_MS = 1500
"""For bars to be drawn, short trends to be fetched and fragments to come in."""
KEPT = {
    ("one-off", "line-tiles", "panel", "light-en"): "line",
    ("one-off", "line-tiles", "panel", "dark-en"): "line-dark",
    ("one-off", "line-tiles", "phone", "light-en"): "line-phone",
    ("well", "unit", "panel", "light-en"): "unit",
    ("well", "parameters", "panel", "light-en"): "parameters",
    ("well", "unit-review", "panel", "light-de"): "review",
    ("one-off", "line-tiles", "panel", "light-de"): "line-de",
    ("well", "unit", "panel", "light-de"): "unit-de",
    ("well", "unit-review", "panel", "light-en"): "setpoint",
    ("255-abnormal", "line-matrix", "panel", "dark-en"): "matrix",
}
"""Situation, scene, size, look → the name of a picture that is kept."""
_BESIDE_RAIL: FloatRect = {"x": 96, "y": 100, "width": 1184, "height": 695}
CLIPS: dict[str, FloatRect] = {
    "matrix": {"x": 0, "y": 0, "width": 1280, "height": 610},
    "setpoint": {"x": 850, "y": 260, "width": 425, "height": 535},
    **dict.fromkeys(("unit", "unit-de", "review", "parameters"), _BESIDE_RAIL),
}
"""What of a kept picture is enough; each is to stay below 150 kB."""

STORY = (
    ("well", "line-tiles"),
    ("well", "unit"),
    ("well", "unit-review"),
    ("acted", "unit-done"),
    ("one-off", "line-tiles"),
    ("well", "parameters"),
)
"""Situation and scene of each frame of the moving picture."""
STORY_SIZE, STORY_LOOK, FRAME_MS, QUALITY = "panel", "light-en", 2200, 70
ANIMATION = PICTURES / "tour.webp"


class Camera:
    """Takes what was requested."""

    def __init__(self, chromium: Browser, wanted: argparse.Namespace) -> None:
        self._chromium = chromium
        self._wanted = wanted
        self.failed: list[str] = []
        self._frames: dict[tuple[str, str], bytes] = {}

    def take(self, served: Site, situation: Situation) -> None:
        """All pictures of a situation."""
        scenes = [scene for scene in situation.scenes if _is_requested(scene.name, self._wanted.scene)]
        for role in sorted({scene.role for scene in scenes}):
            for size in self._wanted.size or SIZES:
                for look in self._wanted.look or LOOKS:
                    chosen = [scene for scene in scenes if scene.role == role]
                    self._series(served, situation, chosen, size, look)

    def _series(self, served: Site, situation: Situation, scenes: list[Scene], size: str, look: str) -> None:
        with _page(self._chromium, served, scenes[0].role, SIZES[size], look) as page:
            for scene in scenes:
                name = f"{situation.name}/{scene.name}.{size}.{look}"
                try:
                    _show(page, served, situation, scene)
                except Exception as error:
                    self.failed.append(f"{name}: {str(error).splitlines()[0]}")
                if (size, look) == (STORY_SIZE, STORY_LOOK) and (situation.name, scene.name) in STORY:
                    self._frames[situation.name, scene.name] = _webp(page)
                _keep(page, ALL / f"{name}.png", whole=scene.whole)
                kept = KEPT.get((situation.name, scene.name, size, look))
                if kept:
                    page.screenshot(path=PICTURES / f"{kept}.png", clip=CLIPS.get(kept))

    def tell_story(self) -> None:
        """Renew the moving picture where all of its frames were requested."""
        if self._frames.keys() == set(STORY):
            frames = [self._frames[key] for key in STORY]
            ANIMATION.write_bytes(animated(frames, SIZES[STORY_SIZE], FRAME_MS))


def main() -> int:
    """Take what was requested; 1 when a page did not come to where its picture is taken."""
    wanted = _arguments()
    requested = [one for one in SITUATIONS if _is_requested(one.name, wanted.situation)]
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        camera = Camera(chromium, wanted)
        for name, situations in groupby(SITUATIONS, key=lambda situation: situation.line):
            if any(one.line == name for one in requested):
                _one_line(camera, list(situations), requested)
        chromium.close()
    camera.tell_story()
    print("\n".join(camera.failed))
    return 1 if camera.failed else 0


def _one_line(camera: Camera, situations: list[Situation], requested: list[Situation]) -> None:
    last = max(place for place, one in enumerate(situations) if one in requested)
    with (
        tempfile.TemporaryDirectory() as folder,
        site(Path(folder), situations[0].units, toml=TOML, line_options=("--no-script",)) as served,
    ):
        for situation in situations[: last + 1]:
            situation.prepare(served)
            if situation in requested:
                print(situation.name, flush=True)
                camera.take(served, situation)


def _show(page: Page, served: Site, situation: Situation, scene: Scene) -> None:
    page.goto(scene.path)
    if scene.role and scene.path != "/offline":
        page.wait_for_selector("body[data-link=live]")
    page.wait_for_timeout(SETTLE_MS)
    if scene.press:
        scene.press(page)
        page.wait_for_timeout(300)
    if situation.after:
        situation.after(served)
        page.wait_for_selector(situation.ends)
        served.start()


def _keep(page: Page, path: Path, *, whole: bool) -> None:
    """``whole``: in a window as high as the page, so that what is fixed to its edges stays there."""
    path.parent.mkdir(parents=True, exist_ok=True)
    window = page.viewport_size
    assert window is not None
    if whole:
        height = page.evaluate("document.documentElement.scrollHeight")
        page.set_viewport_size({"width": window["width"], "height": max(window["height"], height)})
    page.screenshot(path=path)
    page.set_viewport_size(window)


def _webp(page: Page) -> bytes:
    """The window in a format that Playwright does not offer."""
    session = page.context.new_cdp_session(page)
    taken = session.send("Page.captureScreenshot", {"format": "webp", "quality": QUALITY})
    session.detach()
    return base64.b64decode(taken["data"])


@contextmanager
def _page(chromium: Browser, served: Site, role: str, size: tuple[int, int], look: str) -> Iterator[Page]:
    scheme, _, language = look.partition("-")
    state: Any = signed_in(chromium, served, role) if role else None
    context = chromium.new_context(
        base_url=served.url,
        storage_state=state,
        viewport={"width": size[0], "height": size[1]},
        color_scheme="dark" if scheme == "dark" else "light",
        locale=language,
    )
    context.set_default_timeout(20_000)
    yield context.new_page()
    context.close()


def _is_requested(name: str, names: Iterable[str] | None) -> bool:
    return not names or name in names


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--situation", nargs="*", choices=[one.name for one in SITUATIONS])
    parser.add_argument("--scene", nargs="*")
    parser.add_argument("--size", nargs="*", choices=list(SIZES))
    parser.add_argument("--look", nargs="*", choices=LOOKS)
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
