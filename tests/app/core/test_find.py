"""Find anything: by which names, what comes first, and for whom."""

from __future__ import annotations

import re
from pathlib import Path

import httpx
from hypothesis import given
from hypothesis import strategies as st

from app.core.find.finders import missing, rank, words_of
from app.core.web.access import Role
from app.core.web.formats import UNKNOWN
from app.engineering.recipes.book import RecipeBook
from app.line.live.bus_live import LiveState
from app.people.audit.log import EventLog, Filter
from bus.contract import BusLink, ParameterValue, Reading, UnitLink
from bus.instants import unix_now
from bus.messages import Message
from tests.app.complete_app import complete_app
from tests.app.played_commands import ANNA
from tests.for_each import for_each

PLACE = re.compile(
    r'<a class="find__place" href="([^"]+)"><span class="find__label" dir="auto">([^<]+)</span>'
)


@for_each(
    ("typed", "names", "found"),
    [
        ("kuhl", ["Kühlwalze"], 1),
        ("KÜHLWALZE", ["kühlwalze"], 0),
        ("dryer 1", ["Dryer 1", "4"], 0),
        ("dryer 1", ["Dryer 1 top", "4"], 3),
        ("walze", ["Kühlwalze"], 3),
        ("estop", ["E-stop input"], 3),
        ("nothalt", ["Not\N{NON-BREAKING HYPHEN}Halt"], 3),
        ("2", ["12"], None),
        ("#2", ["Coater", "2"], 0),
        ("dryer nip", ["Dryer 1"], None),
        ("حزام", ["حزام ناقل"], 1),
    ],
)
def test_words_are_found_in_names(typed: str, names: list[str], found: int | None) -> None:
    assert rank(words_of(typed), names) == found


@given(st.text(max_size=20), st.lists(st.text(max_size=20), max_size=4))
def test_a_name_finds_itself_and_only_missing_words_hinder(typed: str, names: list[str]) -> None:
    words = words_of(typed)
    assert rank(words, [*names, typed]) is not None
    assert (rank(words, names) is None) == bool(missing(words, names))


async def test_units_parameters_recipes_events_and_pages_are_found(tmp_path: Path) -> None:
    async with complete_app(tmp_path) as house:
        live = house.services[LiveState].buses["dry-end"]
        live.apply([ParameterValue(unit=1, number=number, at=1, raw=raw) for number, raw in ((3, 1), (8, 0))])
        await house.services[RecipeBook].save(ANNA, "dry-end", "Board 200", "", {1: 700})
        events = house.services[EventLog]
        await events.record(kind="note", what=Message("event_server_started"), bus="dry-end", unit=2)
        client = await house.signed_in(Role.VIEWER)

        async def found(typed: str, **more: str) -> list[tuple[str, str]]:
            response = await client.get("/find", params={"typed": typed, "part": "true", **more})
            assert response.status_code == 200
            return PLACE.findall(response.text)

        assert (await found("nip"))[0] == ("/units/dry-end/2", "Nip")
        assert (
            "/units/dry-end/2/parameters#parameter-6",
            "Acceleration Ramp Rate (parameter 6)",
        ) in await found("nip accel")
        near = await found("#6", near="/units/dry-end/2")
        assert ("/units/dry-end/2/parameters#parameter-6", "Acceleration Ramp Rate (parameter 6)") in near
        assert ("/recipes/1", "Board 200") in await found("board")
        assert ("/alarms", "Alarms") in await found("alarms")
        events_found = [label for href, label in await found("nip") if "#event-" in href]
        assert events_found == ["Nip · server started"], "an event of the unit by its name, and with it"
        page = await client.get("/events", params={"search": "Nip"})
        assert "server started" in page.text
        assert not [href for href, _ in await found("add user") if href.startswith("/users")]
        assert await found("") == []
        assert await found("!?%") == []


async def test_help_actions_and_the_state_of_an_input_are_found(tmp_path: Path) -> None:
    async with complete_app(tmp_path) as house:
        live = house.services[LiveState].buses["dry-end"]
        client, engineer = await house.signed_in(Role.VIEWER), await house.signed_in(Role.ENGINEER, "eve")

        async def found(client: httpx.AsyncClient, typed: str) -> str:
            return (await client.get("/find", params={"typed": typed, "part": "true"})).text

        assert 'href="/help/replace-a-drive"' in await found(client, "replace")
        assert 'href="/swap/' not in await found(client, "replace")
        assert 'href="/swap/dry-end/2"' in await found(engineer, "replace nip")
        assert "data-theme-toggle" in await found(client, "theme")
        assert 'href="/system"' in await found(client, "backup")
        german = await house.signed_in(Role.ENGINEER, "gerda")
        german.headers["Accept-Language"] = "de"
        for typed, page in (
            ("Gerätetausch", "/swap/dry-end/2"),
            ("Regler tauschen", "/swap/dry-end/2"),
            ("Alarmton", "/alarms#sound-title"),
            ("Ton", "/alarms#sound-title"),
            ("Farbschema", "#theme-toggle"),
            ("Kennwort", "/account"),
            ("Übergabe", "/shifts"),
            ("Störung", "/alarms"),
            ("Null", "/setpoints"),
            ("Null", "#press-zero"),
            ("Raute", "/help/legend"),
            ("rückgängig", "/help"),
        ):
            assert f'href="{page}"' in await found(german, typed), typed
        assert "data-tour" not in await found(client, "tour"), "only a demo has one"
        for typed, page in (
            ("sound", "/alarms#sound-title"),
            ("graph", "/trends"),
            ("handover", "/shifts"),
            ("protocol", "/events"),
            ("logout", "/account"),
            ("tour", "/help"),
            ("Sprache", "/account"),
            ("legend", "/help/legend"),
            ("drift", "/sets/compare"),
        ):
            assert f'href="{page}"' in await found(client, typed)
        never = await found(client, "nip run input")
        assert re.search(rf"Nip · Run input</span>\s*<small><span[^>]*>{UNKNOWN}<", never)
        now = unix_now()
        live.apply([BusLink(at=now, link="open"), UnitLink(unit=2, at=now, link="online")])
        live.apply([Reading(2, now, 1000, 1000, 0, 0xC0, 0x03)])
        shown = await found(client, "nip run input")
        assert re.search(r"Nip · Run input</span>\s*<small><span[^>]*>(on|off)<", shown)
        assert "Run input" not in await found(client, "nip"), "a name alone is that of the unit"
        assert ">8 more<" in await found(client, "input"), "of seven of each of two units"


async def test_a_demo_finds_its_tour_first(tmp_path: Path) -> None:
    async with complete_app(tmp_path, demo=True) as house:
        house.address = "127.0.0.1"
        client = house.client(host="127.0.0.1:8000")
        found = await client.get("/find", params={"typed": "tour", "part": "true"})
        assert 0 < found.text.find("data-tour") < found.text.find('href="/help"')


async def test_units_of_one_name_are_told_apart_by_their_bus(tmp_path: Path) -> None:
    config = tmp_path / "lineside.toml"
    bus = '[[bus]]\nname = "{0}"\nport = "/dev/tty-{0}"\n[[bus.unit]]\nid = 2\nname = "Nip"\n'
    config.write_text('[server]\ndata = "./data"\n' + bus.format("dry") + bus.format("wet"), encoding="utf-8")
    async with complete_app(tmp_path, config=config) as house:
        engineer = await house.signed_in(Role.ENGINEER)
        for typed, label in (("replace nip", "Replace {} · Nip"), ("nip run input", "{} · Nip · Run input")):
            page = await engineer.get("/find", params={"typed": typed, "part": "true"})
            assert [label.format(each) in page.text for each in ("dry", "wet")] == [True, True], typed
        trends = (await engineer.get("/trends")).text
        assert [f">{each} · Nip</option>" in trends for each in ("dry", "wet")] == [True, True]


async def test_typed_text_is_bounded_and_a_key_press_searches_the_newest_entries(tmp_path: Path) -> None:
    async with complete_app(tmp_path) as house:
        client = await house.signed_in(Role.VIEWER)
        for query in ({"typed": "x" * 81}, {"near": "x" * 201, "typed": "x"}, {"typed": "a\nb"}):
            assert (await client.get("/find", params=query)).status_code == 422
        events = house.services[EventLog]
        for _ in range(3):
            await events.record(kind="note", what=Message("event_server_started"), bus="dry-end", unit=2)
        every, _ = await events.page(Filter(search="server started"), 10)
        newest, _ = await events.page(Filter(search="server started", newest=2), 10)
        assert len(every) >= 3
        assert [event["id"] for event in newest] == [event["id"] for event in every[:2]]
