"""Static files: kept for ever under the address of their version, packed, and nothing else served."""

from __future__ import annotations

import gzip
import re
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from starlette.requests import Request

from app.errors import Problem
from app.web.assets import Assets, static_dir, templates_dir
from tests.app.whole_app import House, whole_app


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "js").mkdir()
    (tmp_path / "js" / "a.js").write_text("export const a = 1;\n" * 50)
    (tmp_path / "logo.png").write_bytes(b"\x89PNG" + bytes(100))
    return tmp_path


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    async with whole_app(tmp_path) as house:
        yield house


def asked(accept_encoding: str = "gzip, br") -> Request:
    headers = [(b"accept-encoding", accept_encoding.encode())]
    return Request({"type": "http", "method": "GET", "path": "/", "headers": headers})


def test_the_address_changes_with_any_file(folder: Path) -> None:
    before = Assets(folder).url("js/a.js")
    assert before == Assets(folder).url("js/a.js")
    (folder / "logo.png").write_bytes(b"other")
    after = Assets(folder).url("js/a.js")
    assert before != after
    assert after.endswith("/js/a.js"), "so that a module's relative import stays in its version"


def test_text_is_packed_for_who_takes_it(folder: Path) -> None:
    packed = Assets(folder).response(asked(), "js/a.js", forever=True)
    assert packed.headers["content-encoding"] == "gzip"
    assert packed.headers["vary"] == "Accept-Encoding"
    assert gzip.decompress(bytes(packed.body)) == (folder / "js" / "a.js").read_bytes()
    plain = Assets(folder).response(asked(""), "js/a.js", forever=True)
    assert "content-encoding" not in plain.headers
    picture = Assets(folder).response(asked(), "logo.png", forever=True)
    assert "content-encoding" not in picture.headers


@pytest.mark.parametrize("name", ["../secret", "js/../../secret", "/etc/passwd", "js", "", "js/b.js"])
def test_only_what_was_there_at_the_start_is_served(folder: Path, name: str) -> None:
    (folder.parent / "secret").write_text("x")
    with pytest.raises(Problem) as caught:
        Assets(folder).get(name)
    assert caught.value.status == 404


async def test_nobody_need_sign_in_for_a_stylesheet(house: House) -> None:
    url = house.services.assets.url("css/tokens.css")
    answer = await house.client().get(url)
    assert answer.status_code == 200
    assert answer.headers["content-type"].startswith("text/css")
    assert answer.headers["cache-control"] == "public, max-age=31536000, immutable"
    other = await house.client().get("/static/older/css/tokens.css")
    assert (other.status_code, other.headers["cache-control"]) == (200, "no-cache")


async def test_every_file_that_the_frame_asks_for_is_there(house: House) -> None:
    page = (await house.client().get("/login")).text
    urls = [part.split('"')[0] for part in page.split('"/static/')[1:]]
    assert urls
    for url in urls:
        path = "/static/" + url.split("#")[0]
        if "/vendor/" not in path:
            assert (await house.client().get(path)).status_code == 200, path


def test_the_folders_are_found() -> None:
    assert (static_dir() / "css").is_dir()
    assert (templates_dir() / "base.html").is_file()


def test_every_module_that_a_page_begins_with_is_asked_for_at_once() -> None:
    base = (templates_dir() / "base.html").read_text(encoding="utf-8")
    asked_for = set(re.findall(r'"(\w+)"', re.findall(r"{% for module in \[(.*?)\] %}", base)[0]))
    assert asked_for == imported("main") - {"main"}


def imported(module: str, known: frozenset[str] = frozenset()) -> frozenset[str]:
    """A module and all that it imports."""
    known |= {module}
    source = (static_dir() / "js" / f"{module}.js").read_text(encoding="utf-8")
    for name in re.findall(r'from "\./([\w-]+)\.js"', source):
        if name not in known:
            known |= imported(name, known)
    return known
