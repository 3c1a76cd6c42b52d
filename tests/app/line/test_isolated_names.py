"""A name in letters from right to left leaves the text beside it in its order, on the screen alone."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from app.core.messages import Languages
from app.core.web.access import Role
from app.line.live.bus_live import LiveState
from bus.messages import Message, listed, number, term
from tests.app.complete_app import House, complete_app
from tests.app.fake_worker import snapshot
from tests.app.page_texts import PAGES, texts_without

UNIT, GROUP, SITE, REASON = "حزام ناقل", "نهاية جافة", "مصنع الورق", "صيانة"
CONFIG = f"""
[site]
name = "{SITE}"
[server]
data = "data"
[[bus]]
name = "dry-end"
port = "/dev/null"
[[bus.unit]]
id = 1
name = "{UNIT}"
group = "{GROUP}"
[bus.unit.labels]
output.1 = "{REASON}"
[[bus.unit]]
id = 2
name = "{UNIT} 2"
group = "{GROUP}"
"""
ISOLATED = re.compile("\u2068[^\u2068\u2069]*\u2069")
FROM_RIGHT = re.compile("[\u0600-\u06ff]")
OTHER = re.compile(r"[A-Za-z0-9·:]")


def mixed(page: str) -> Iterator[str]:
    """Texts in which such a name stands beside others without isolation."""
    for text, left in texts_without(page, ISOLATED):
        left = left.replace(f"{UNIT} 2", UNIT)
        if FROM_RIGHT.search(left) and OTHER.search(left):
            yield " ".join(text.split())


async def blocked(house: House) -> httpx.AsyncClient:
    """A browser, while the commands to a unit are blocked for a reason of such letters."""
    house.services[LiveState].buses["dry-end"].connect_worker(snapshot())
    client = await house.signed_in(Role.ADMIN)
    client.headers["Accept"] = "text/html"
    body = {"reason": REASON}
    response = await client.post("/api/v1/buses/dry-end/units/1/block", json=body)
    assert response.status_code == 200, response.text
    return client


async def test_no_page_has_a_name_beside_other_text_without_isolation(tmp_path: Path) -> None:
    config = tmp_path / "lineside.toml"
    config.write_text(CONFIG, encoding="utf-8")
    async with complete_app(tmp_path, config=config) as house:
        reader = await blocked(house)
        pages = {path: (await reader.get(path, follow_redirects=True)).text for path in PAGES}
        program = await house.program(Role.ADMIN)
        events = [(await program.get(f"/api/v1/{path}")).text for path in ("events", "events.csv", "line")]
    found = {path: list(mixed(page)) for path, page in pages.items()}
    assert {path: texts for path, texts in found.items() if texts} == {}
    assert "\u2068" in pages["/units/dry-end/1"]
    assert [text for text in events if not FROM_RIGHT.search(text) or "\u2068" in text] == []


@pytest.mark.parametrize("tag", ["en", "de"])
def test_a_name_is_isolated_in_messages_and_texts_of_the_screen(tag: str) -> None:
    screen = Languages()[tag].on_screen
    message = Message.of("alarm_text", name=UNIT, response=listed(["Nip", UNIT]))
    assert screen.t(message) == f"\u2068{UNIT}\u2069. Nip, \u2068{UNIT}\u2069"
    one, many = "Write {name} to {n} unit", "Write {name} to {n} units"
    for text in (screen.t("Set {name} to {value}", name=UNIT, value="1"), screen.tn(one, many, 2, name=UNIT)):
        assert f"\u2068{UNIT}\u2069" in text


def test_other_names_numbers_and_words_stay_as_they_are() -> None:
    screen, plain = Languages()["de"].on_screen, Languages()["de"]
    for value in ("Kühlwalze", "Ŝ-Walze 2", "2026-11-26", number("48.0"), term("verified")):
        message = Message.of("alarm_text", name=value, response="")
        assert screen.t(message) == plain.t(message)
    assert str(screen) == "de"


def test_what_programs_and_mail_get_has_the_name_alone() -> None:
    message = Message.of("line_event_at", name=UNIT, event="x")
    assert [str(message), Languages()["de"].t(message)] == [f"{UNIT} · x"] * 2
