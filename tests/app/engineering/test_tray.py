"""The change tray: what it holds (by a model, too), what its review shows, how it is sent, and its pages."""

from __future__ import annotations

import re
import time
from collections.abc import AsyncIterator, Callable, Sequence
from pathlib import Path
from types import SimpleNamespace

import httpx
import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from app.core.web.access import Person, Role
from app.engineering.recipes.book import RecipeBook
from app.engineering.tray.contents import (
    LASTS_S,
    MAX_CHANGES,
    MAX_TRAYS,
    TrayRow,
    Trays,
    Unable,
    key_of,
    place_of,
    steps_of,
    unable_units,
)
from app.engineering.tray.feature import TrayResult, send_changes, tray_rows
from app.engineering.tray.store import TrayStore
from app.errors import Problem
from app.line.commands.limits import NO_LIMITS
from app.line.commands.review import change_of
from app.line.commands.safeguards import Safeguards
from app.line.commands.undo import ValuePlace, Values, value_now, values_set
from app.line.live.bus_live import BusLive, LiveState
from app.people.audit.log import Filter
from bus.contract import (
    Action,
    Command,
    ParameterValue,
    Reading,
    SetLine,
    SetSpeed,
    Staged,
    UnitLink,
    UnitOutcome,
    Update,
    WriteAnalogOutput,
    WriteOutput,
    WriteParameter,
)
from bus.instants import Monotonic, monotonic_now, unix_now
from bus.messages import Message, in_english
from bus.settings import UnitLabels
from tests.app.complete_app import HOST, House, complete_app, settings_in
from tests.app.fake_worker import PlayedWorker, reading, result_of
from tests.app.played_commands import HEALTHY, a_bus, fresh, responding
from tests.for_each import for_each

SPEED_1, SPEED_2 = ValuePlace("setpoint", 1), ValuePlace("setpoint", 2)
OUTPUT, ANALOG = ValuePlace("output", 1, 3), ValuePlace("analog", 2)
RAMP_UP, RAMP_DOWN = ValuePlace("parameter", 2, 6), ValuePlace("parameter", 2, 7)
ALL = (SPEED_1, SPEED_2, OUTPUT, ANALOG, RAMP_UP, RAMP_DOWN)
START = Monotonic(100.0)


@pytest.mark.parametrize("place", ALL)
def test_a_place_has_a_key(place: ValuePlace) -> None:
    assert place_of(key_of(place)) == place


@pytest.mark.parametrize(
    "key", ["", "setpoint-1", "valve-1-0", "setpoint-1-0-0", "output-\u0661-3", "output-1-333"]
)
def test_another_text_is_no_key(key: str) -> None:
    assert place_of(key) is None


def test_setpoints_are_sent_together_and_the_rest_one_by_one_as_it_was_added() -> None:
    changes = {RAMP_DOWN: 5, SPEED_2: 20, ANALOG: 7, RAMP_UP: 6, OUTPUT: 1, SPEED_1: 10}
    assert steps_of(changes) == [
        {SPEED_2: 20, SPEED_1: 10},
        {OUTPUT: 1},
        {ANALOG: 7},
        {RAMP_DOWN: 5},
        {RAMP_UP: 6},
    ]
    assert steps_of({OUTPUT: 0}) == [{OUTPUT: 0}]
    assert steps_of({}) == []


def test_a_tray_is_bounded_and_too_much_adds_nothing() -> None:
    trays = Trays()
    full = {ValuePlace("parameter", unit, number): 0 for unit in range(1, 33) for number in range(1, 17)}
    assert len(full) == MAX_CHANGES
    trays.add("anna", full, START, {})
    trays.add("anna", dict.fromkeys(full, 1), START, {})
    with pytest.raises(Problem, match="at most 512 changes"):
        trays.add("anna", {SPEED_1: 10}, START, {})
    assert trays.changes("anna", START) == dict.fromkeys(full, 1)


def test_of_too_many_trays_the_oldest_is_emptied() -> None:
    trays = Trays()
    for number in range(MAX_TRAYS):
        trays.add(f"person {number}", {SPEED_1: number}, START, {})
    trays.add("person 0", {SPEED_2: 0}, START, {})
    trays.add("anna", {SPEED_1: 10}, START, {})
    assert trays.changes("person 1", START) == {}
    assert trays.changes("person 0", START) == {SPEED_1: 0, SPEED_2: 0}
    assert trays.changes("anna", START) == {SPEED_1: 10}


class TrayModel(RuleBasedStateMachine):
    """``self.log``: when, who, and each place with its new value, or None where it was removed."""

    def __init__(self) -> None:
        super().__init__()
        self.now = 0.0
        self.log: list[tuple[float, str, ValuePlace, int | None]] = []
        self.trays = Trays()

    def expected(self, who: str) -> dict[ValuePlace, int]:
        """What this person's entries of the log come down to."""
        found: dict[ValuePlace, int] = {}
        added = 0.0
        for at, _, place, raw in [entry for entry in self.log if entry[1] == who]:
            if raw is None:
                found.pop(place, None)
                continue
            if at - added >= LASTS_S:
                found = {}
            found[place], added = raw, at
        return found if self.now - added < LASTS_S else {}

    @rule(seconds=st.sampled_from([1.0, LASTS_S / 2, LASTS_S - 1]))
    def time_passes(self, seconds: float) -> None:
        self.now += seconds

    @rule(
        who=st.sampled_from(["anna", "ben"]),
        places=st.lists(st.sampled_from(ALL), min_size=1, max_size=3),
        raw=st.integers(0, 2),
    )
    def add(self, who: str, places: list[ValuePlace], raw: int) -> None:
        self.trays.add(who, dict.fromkeys(places, raw), Monotonic(self.now), {})
        self.log += [(self.now, who, place, raw) for place in places]

    @rule(who=st.sampled_from(["anna", "ben"]), place=st.sampled_from(ALL), raw=st.integers(0, 2))
    def remove(self, who: str, place: ValuePlace, raw: int) -> None:
        if self.expected(who).get(place) == raw:
            self.log.append((self.now, who, place, None))
        self.trays.remove(who, {place: raw})

    @invariant()
    def holds_the_newest_value_of_each_place(self) -> None:
        for who in ("anna", "ben"):
            held = self.trays.changes(who, Monotonic(self.now))
            assert list(held.items()) == list(self.expected(who).items())


TestTray = TrayModel.TestCase


RAMP, MODE, BAUD = (ValuePlace("parameter", 1, number) for number in (6, 8, 18))
LOCAL = Message("obstacle_not_in_remote")
REFUSED = Message("no_such_parameter")
REACTS = "The equipment on this output reacts immediately."
UNREAD = "The unit acknowledges it; it cannot be read back."


@pytest.fixture
def bus() -> BusLive:
    live = a_bus()
    responding(live, run=True)
    bus = live.buses["dry-end"]
    object.__setattr__(bus.units[1].settings, "labels", UnitLabels(unit="m/min", output={3: "Fan"}))
    return bus


def rows(bus: BusLive, changes: dict[ValuePlace, int], *, local: int = 0) -> list[TrayRow]:
    """Unit ``local`` is in LOCAL; a write of #8 is refused."""

    def values_now(changes: Values) -> dict[ValuePlace, int | None]:
        return {place: value_now(place, bus, {2: 5}) for place in changes}

    def check(action: Action) -> None:
        if isinstance(action, WriteParameter) and action.number == 8:
            raise Problem(409, "invalid", REFUSED)

    page = SimpleNamespace(
        bus=bus,
        commands=SimpleNamespace(undo=SimpleNamespace(values_now=values_now)),
        change=lambda unit, raw: change_of(bus, bus.units[unit], raw, NO_LIMITS, time.time()),
        obstacle=lambda unit: LOCAL if unit == local else None,
        check=check,
    )
    return tray_rows(page, changes, {})  # type: ignore[arg-type]


def words(row: TrayRow) -> tuple[str, str, str, str, str, str]:
    texts = (row.what, row.old, row.new, row.measure, row.effect)
    return (row.name, *(in_english(text) for text in texts))


@pytest.mark.parametrize(
    ("place", "raw", "expected"),
    [
        (SPEED_1, 1500, ("Unwind", "Setpoint", "100.0", "150.0", "m/min", "ramp of about 0.2 s")),
        (SPEED_1, 1001, ("Unwind", "Setpoint", "100.0", "100.1", "m/min", "ramp of about 0.1 s")),
        (SPEED_1, 1000, ("Unwind", "Setpoint", "100.0", "100.0", "m/min", "no change")),
        (OUTPUT, 1, ("Unwind", "Output 3 (Fan)", "off", "on", "", REACTS)),
        (ANALOG, 7, ("Nip", "Analog output", "5", "7", "", UNREAD)),
        (
            RAMP,
            75,
            (
                "Unwind",
                "Acceleration Ramp Rate (parameter 6)",
                "10.0",
                "7.5",
                "s",
                "Time to accelerate over the full speed range.",
            ),
        ),
    ],
)
def test_a_row_has_what_changes_from_which_value_to_which(
    bus: BusLive, place: ValuePlace, raw: int, expected: tuple[str, ...]
) -> None:
    [row] = rows(bus, {place: raw})
    assert words(row) == expected
    assert row.reviewed == f"{row.key}:{raw}:{row.was}"
    assert row.refusal is None


def test_an_unknown_value_is_empty(bus: BusLive) -> None:
    object.__setattr__(bus.units[2], "reading", None)
    unknown = {ValuePlace("output", 2, 1): 1, ValuePlace("analog", 1): 7, ValuePlace("parameter", 2, 12): 30}
    for row in rows(bus, unknown):
        assert (row.was, row.old, row.was_text) == (None, "", "")
        assert row.reviewed.endswith(":")


def test_an_unknown_ramp_and_a_follower_have_their_effect(bus: BusLive) -> None:
    bus.apply([ParameterValue(unit=1, number=6, at=1.0, raw=None, available=False)])
    bus.apply([ParameterValue(unit=2, number=8, at=1.0, raw=1)])
    first, second = rows(bus, {SPEED_1: 1500, SPEED_2: 5000})
    assert in_english(first.effect) == "with the unit's own ramp; duration unknown"
    assert [in_english(text) for text in (second.what, second.new, second.effect)] == [
        "Ratio",
        "0.5000",
        "follows its master",
    ]


def test_setpoints_come_first_in_floor_order(bus: BusLive) -> None:
    changes = {RAMP: 75, SPEED_2: 10, OUTPUT: 1, SPEED_1: 10}
    assert [row.place for row in rows(bus, changes)] == [SPEED_1, SPEED_2, OUTPUT, RAMP]


def test_what_a_person_must_know_is_a_warning_or_a_danger(bus: BusLive) -> None:
    ramp, baud = rows(bus, {RAMP: 0, BAUD: 24})
    assert ([warning.code for warning in ramp.warnings], ramp.danger) == (["effect_no_ramp"], "")
    assert baud.danger


def test_a_unit_that_cannot_take_one_of_its_changes_is_named_with_the_first_reason(bus: BusLive) -> None:
    changes = {SPEED_1: 10, SPEED_2: 10, RAMP: 75, MODE: 1}
    assert unable_units(rows(bus, changes)) == {1: Unable(1, "Unwind", REFUSED)}
    both = unable_units(rows(bus, changes, local=2))
    assert both == {1: Unable(1, "Unwind", REFUSED), 2: Unable(2, "Nip", LOCAL)}
    assert unable_units(rows(bus, changes, local=1)) == {1: Unable(1, "Unwind", LOCAL)}


ANNA = Person("anna", Role.ENGINEER, "session")
BEN = Person("ben", Role.OPERATOR, "session")
WINDOW = ValuePlace("parameter", 2, 12)
CHANGES = {WINDOW: 30, OUTPUT: 1, SPEED_1: 1100, ANALOG: 300, SPEED_2: 1200}
SENT: list[Action] = [
    SetLine(setpoints={1: 1100, 2: 1200}),
    WriteOutput(unit=1, number=3, on=True),
    WriteAnalogOutput(unit=2, raw=300),
    WriteParameter(unit=2, number=12, raw=30),
]


def playing(worker: PlayedWorker, result: Callable[[Command], Update]) -> None:
    async def play(command: Command) -> Sequence[Update]:
        return [result(command)]

    worker.play = play


def verified(command: Command) -> Update:
    return result_of(command, "acknowledged" if isinstance(command.action, WriteAnalogOutput) else "verified")


async def send(site: House, changes: Values, person: Person = ANNA) -> list[TrayResult]:
    return await send_changes(site.commands, person, site.live, changes, "a-tray", monotonic_now(), {})


async def test_each_change_is_sent_once_in_order(site: House, worker: PlayedWorker) -> None:
    playing(worker, verified)
    results = await send(site, CHANGES)
    assert [command.action for command in worker.commands] == SENT
    assert {result.place: result.raw for result in results} == CHANGES
    assert all(result.is_done for result in results)
    again = await send(site, CHANGES)
    assert [result.id for result in again] == [result.id for result in results]
    assert len(worker.commands) == len(SENT)


async def test_one_setpoint_is_set_alone(site: House, worker: PlayedWorker) -> None:
    playing(worker, verified)
    await send(site, {SPEED_2: 1200})
    assert [command.action for command in worker.commands] == [SetSpeed(unit=2, raw=1200)]


async def test_after_a_failure_nothing_more_is_sent(site: House, worker: PlayedWorker) -> None:
    playing(
        worker,
        lambda command: (
            result_of(command, "refused") if isinstance(command.action, WriteOutput) else verified(command)
        ),
    )
    results = {result.place: result for result in await send(site, CHANGES)}
    assert [command.action for command in worker.commands] == SENT[:2]
    assert {place for place, result in results.items() if result.is_done} == {SPEED_1, SPEED_2}
    assert results[ANALOG].part == results[WINDOW].part == Message("tray_stopped_before")


async def test_each_unit_of_a_change_of_several_has_its_own_result(site: House, worker: PlayedWorker) -> None:
    def one_of_two(command: Command) -> Update:
        parts = [UnitOutcome(1, "verified", read_back=1100), UnitOutcome(2, "unverified")]
        return result_of(command, "unverified", units=parts)

    playing(worker, one_of_two)
    results = await send(site, {SPEED_1: 1100, SPEED_2: 1200, OUTPUT: 1})
    assert [result.is_done for result in results] == [True, False, False]


async def test_a_refusal_before_sending_stops_the_rest_too(site: House, worker: PlayedWorker) -> None:
    playing(worker, verified)
    results = {result.place: result for result in await send(site, {WINDOW: 30, ANALOG: 300}, BEN)}
    assert worker.commands == []
    refusal = results[ANALOG].part
    assert isinstance(refusal, Message)
    assert "role engineer" in str(refusal)
    assert results[WINDOW].part == Message("tray_stopped_before")


@pytest.mark.parametrize("changes", [{SPEED_1: 1100, SPEED_2: 1200}, {WINDOW: 30}])
async def test_events_name_the_tray_and_undo_goes_back(
    site: House, worker: PlayedWorker, changes: Values
) -> None:
    playing(worker, verified)
    before = site.commands.undo.values_now(changes)
    results = await send(site, changes)
    found, _ = await site.log.page(Filter(kind="command"), 10)
    assert {event["origin"] for event in found} == {"change tray"}
    for update in (reading(1, 1100), reading(2, 1200), ParameterValue(unit=2, number=12, at=1.0, raw=30)):
        site.live.apply([update])
    offer = site.commands.undo.offer(ANNA, results[0].id)
    assert offer is not None
    assert values_set(offer.action, site.live) == before


OF_PAGE = {"HX-Request": "true", "Origin": f"http://{HOST}"}
ROW = re.compile(r'name="row" value="([^"]+)"')


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    """Two units at rest in REMOTE at 100.0 of 2000.0, and an engineer."""
    async with complete_app(tmp_path) as house:
        responding(house.services[LiveState])
        await house.signed_in(Role.ENGINEER)
        yield house


def local(house: House, unit: int) -> None:
    """A unit is set to LOCAL at its keypad."""
    apply(house, Reading(unit, fresh(), 1000, 1000, 0, 0, HEALTHY))


def apply(house: House, *updates: Reading | ParameterValue) -> None:
    house.services[LiveState].buses["dry-end"].apply(list(updates))


async def post(
    house: House, path: str, client: httpx.AsyncClient | None = None, **form: str
) -> httpx.Response:
    return await (client or house.clients[0]).post(path, data=form, headers=OF_PAGE)


async def add(house: House, unit: int = 1, value: str = "150.0") -> httpx.Response:
    return await post(house, f"/units/dry-end/{unit}/tray/setpoint", value=value)


async def tray(house: House) -> httpx.Response:
    return await house.clients[0].get("/bus/dry-end/tray/review", headers=OF_PAGE)


async def review_rows(house: House) -> list[str]:
    """The changes in the review."""
    return ROW.findall((await tray(house)).text)


async def press_send(house: House, **form: str | list[str]) -> httpx.Response:
    form = {"id": "c" * 32, "reviewed_at": str(time.time()), "row": await review_rows(house), **form}
    return await house.clients[0].post("/bus/dry-end/tray/send", data=form, headers=OF_PAGE)


async def test_a_unit_outside_that_could_move_with_the_tray_or_a_recipe_is_named_before(house: House) -> None:
    saved = await house.services[RecipeBook].save(ANNA, "dry-end", "Board", "", {1: 1200})
    await add(house)
    rows = await review_rows(house)
    local(house, 2)
    house.services[LiveState].buses["dry-end"].apply([Staged(2, fresh(), None, unknown=True)])
    loading = await house.clients[0].get(f"/recipes/{saved.id}/review", headers=OF_PAGE)
    for refused in (await tray(house), loading, await press_send(house, row=rows)):
        assert refused.status_code == 409
        assert "Set Nip to REMOTE at its keypad" in refused.text


async def test_each_way_to_set_a_value_adds_to_the_tray(house: House) -> None:
    saved = await house.services[RecipeBook].save(ANNA, "dry-end", "Board", "", {2: 1200})
    ways = {
        "/units/dry-end/1/tray/setpoint": {"value": "150.0"},
        "/units/dry-end/1/tray/outputs/3": {"on": "true"},
        "/units/dry-end/1/tray/analog-output": {"value": "7"},
        "/units/dry-end/1/tray/parameters/6": {"raw": "75", "scale": "-"},
        "/bus/dry-end/tray/setpoints": {"new-1": "", "new-2": "110.0"},
        f"/recipes/{saved.id}/tray": {},
        "/batch/dry-end/tray": {"number": "7", "unit-1": "5.0", "unit-2": "6.0"},
    }
    for path, form in ways.items():
        response = await post(house, path, **form)
        assert response.status_code == 200, (path, response.text)
        assert "1 change added to the tray" in response.text, path
    # 110.0 was replaced by the recipe; #7 of unit 1 is 5.0 already.
    assert await review_rows(house) == [
        "setpoint-1-0:1500:1000",
        "setpoint-2-0:1200:1000",
        "output-1-3:1:0",
        "analog-1-0:7:",
        "parameter-1-6:75:100",
        "parameter-2-7:60:50",
    ]
    strip = await house.clients[0].get("/tray/strip")
    assert "6 changes" in strip.text
    assert "2 units" in strip.text
    assert "/bus/dry-end/tray/review" in strip.text


async def test_what_is_staged_and_not_known_any_more_is_not_offered(house: House) -> None:
    """Execute is off while a unit is silent, and gone once nobody knows what one would execute."""
    live, now = house.services[LiveState].buses["dry-end"], unix_now()
    name = live.units[1].settings.name

    async def strip(*updates: Update) -> str:
        live.apply(updates)
        return (await house.clients[0].get("/tray/strip")).text

    known = await strip(Staged(1, now, 700), Staged(2, now, 800))
    assert "disabled" not in known
    assert name in known
    off = await strip(UnitLink(1, now, "stale"))
    assert name in off
    assert off.count("disabled") == 1
    lost = await strip(Staged(1, now, None, unknown=True))
    assert "stage it again" in lost
    assert "/staged/review" not in lost
    refused = await house.clients[0].get("/bus/dry-end/staged/review", headers=OF_PAGE)
    assert name in refused.text


@for_each(
    ("path", "form", "expected"),
    [
        ("/units/dry-end/1/tray/setpoint", {"value": "9000"}, "0.0 to 2000.0"),
        ("/units/dry-end/1/tray/analog-output", {"value": "x"}, "without decimals"),
        ("/units/dry-end/1/tray/parameters/21", {"raw": "12", "scale": "-"}, "a secret"),
        ("/units/dry-end/1/tray/parameters/17", {"raw": "12", "scale": "-"}, "(parameter 17)"),
        ("/bus/dry-end/tray/setpoints", {"new-1": ""}, "empty is not zero"),
        ("/batch/dry-end/tray", {"number": "7", "unit-1": "x"}, "; nothing was sent"),
    ],
)
async def test_what_can_never_be_sent_is_refused_in_place(
    house: House, path: str, form: dict[str, str], expected: str
) -> None:
    response = await post(house, path, **form)
    assert response.status_code in (409, 422)
    assert expected in response.text
    assert response.headers["HX-Retarget"]
    assert await review_rows(house) == []


async def test_a_recipe_that_is_not_for_these_units_is_refused_in_place(house: House) -> None:
    saved = await house.services[RecipeBook].save(ANNA, "dry-end", "Board", "", {2: 1200})
    apply(house, ParameterValue(unit=2, number=8, at=1.0, raw=1))
    response = await post(house, f"/recipes/{saved.id}/tray")
    assert "holds a speed" in response.text
    del house.services[LiveState].buses["dry-end"].units[2]
    response = await post(house, f"/recipes/{saved.id}/tray")
    assert "unit 2: not in the configuration" in response.text


async def test_each_role_adds_what_it_may_set(house: House) -> None:
    operator, viewer = await house.signed_in(Role.OPERATOR), await house.signed_in(Role.VIEWER)
    for path, form, allowed in (
        ("/units/dry-end/1/tray/setpoint", {"value": "150.0"}, True),
        ("/units/dry-end/1/tray/outputs/3", {"on": "true"}, True),
        ("/units/dry-end/1/tray/analog-output", {"value": "7"}, False),
        ("/units/dry-end/1/tray/parameters/6", {"raw": "75", "scale": "-"}, False),
        ("/batch/dry-end/tray", {"number": "7"}, False),
    ):
        assert (await post(house, path, operator, **form)).status_code == (200 if allowed else 403), path
        assert (await post(house, path, viewer, **form)).status_code == 403, path
    assert (await viewer.get("/tray")).status_code == 403
    assert 'id="tray"' not in (await viewer.get("/")).text
    assert await review_rows(house) == [], "each has an own tray"


async def test_a_unit_that_cannot_take_it_is_left_out_by_name_only(house: House) -> None:
    await add(house, 1)
    await add(house, 2)
    local(house, 2)
    review = await tray(house)
    assert "Leave out Nip" in review.text
    assert "Send 1 change" in review.text
    assert "Nip: not in REMOTE" in (await press_send(house)).text
    assert "every unit is left out" in (await press_send(house, **{"leave-out": ["1", "2"]})).text
    assert "differs from the review" in (await press_send(house, **{"leave-out": "x"})).text
    sent = await press_send(house, **{"leave-out": "2"})
    assert "left out: not in REMOTE" in sent.text
    assert [event["unit"] for event in await house.events("command")] == [1]
    assert await review_rows(house) == ["setpoint-1-0:1500:1000", "setpoint-2-0:1500:1000"], (
        "there is no worker"
    )
    local(house, 1)
    assert "No change can be sent now" in (await tray(house)).text


@for_each(
    ("form", "expected"),
    [
        ({"reviewed_at": "1"}, "expired"),
        ({"row": ["setpoint-1-0:1500:990"]}, "Unwind, Setpoint: the value has changed since the review"),
        ({"row": ["setpoint-1-0:1400:1000"]}, "tray has changed since the review"),
        ({"row": []}, "tray has changed since the review"),
        ({"row": ["setpoint-1-0:x:1000"]}, "differs from the review"),
        ({"row": ["valve-1-0:1:1"]}, "differs from the review"),
    ],
)
async def test_nothing_is_sent_but_what_was_reviewed(
    house: House, form: dict[str, str | list[str]], expected: str
) -> None:
    await add(house)
    response = await press_send(house, **form)
    assert expected in response.text
    assert 'data-review-done="bad"' in response.text
    assert await house.events("command") == []
    assert await review_rows(house) == ["setpoint-1-0:1500:1000"]


async def test_a_dangerous_parameter_needs_its_word(house: House) -> None:
    await post(house, "/units/dry-end/1/tray/parameters/18", raw="48", scale="-")
    assert 'data-typed="WRITE"' in (await tray(house)).text
    assert "word was not typed" in (await press_send(house)).text
    assert await house.events("command") == []


async def test_to_look_at_a_tray_and_its_review_prolongs_no_control(tmp_path: Path) -> None:
    async with complete_app(tmp_path, control=True) as house:
        responding(house.services[LiveState])
        await house.signed_in(Role.ENGINEER)
        await post(house, "/bus/dry-end/control", do="take")
        await add(house)
        guards = house.services.buses["dry-end"][Safeguards]
        held = [guards.holding()]
        for path in (
            "/tray",
            "/bus/dry-end/tray/review",
            "/tray/strip",
            "/setpoints",
            "/units/dry-end/1",
            "/",
        ):
            response = await house.clients[0].get(path, headers=OF_PAGE)
            assert response.status_code in (200, 404), path
            held.append(guards.holding())
        assert held[0] is not None
        assert set(held) == {held[0]}


async def test_the_tray_stays_while_another_has_control(tmp_path: Path) -> None:
    async with complete_app(tmp_path, control=True) as house:
        responding(house.services[LiveState])
        await house.signed_in(Role.ENGINEER)
        ben = await house.signed_in(Role.OPERATOR, "ben")
        await post(house, "/bus/dry-end/control", ben, do="take")
        await add(house)
        assert 'data-control-offer="dry-end"' in (await tray(house)).text
        response = await press_send(house, row=["setpoint-1-0:1500:1000"])
        assert "ben has control of this line" in response.text
        assert "1 change" in (await house.clients[0].get("/tray/strip")).text
        await post(house, "/bus/dry-end/control", ben, do="release")
        await post(house, "/bus/dry-end/control", do="take")
        assert await review_rows(house) == ["setpoint-1-0:1500:1000"]


async def test_changes_are_removed_one_by_one_or_all(house: House) -> None:
    for unit in (1, 2):
        await add(house, unit)
    review = await post(house, "/bus/dry-end/tray/remove", place="setpoint-1-0")
    assert ROW.findall(review.text) == ["setpoint-2-0:1500:1000"]
    await post(house, "/bus/dry-end/tray/remove", place="setpoint-9-0")
    assert await review_rows(house) == ["setpoint-2-0:1500:1000"]
    no_form = await house.clients[0].post("/bus/dry-end/tray/remove", json={"place": ""}, headers=OF_PAGE)
    assert no_form.status_code == 422
    emptied = await post(house, "/bus/dry-end/tray/remove", place="")
    assert "The change tray is empty" in emptied.text


async def test_what_was_sent_leaves_the_page_and_its_result_covers_nothing(house: House) -> None:
    await add(house)
    page = (await house.clients[0].get("/tray")).text
    now, report = page.split('<div class="change-report">')
    assert re.search(r'id="tray-now" hx-get="/tray" .*hx-trigger="lineside:done', now)
    assert ('id="tray-sent"' in report, page.count("undo-place")) == (True, 1)
    assert 'hx-target="#tray-sent, #tray-result, ' in (await tray(house)).text


async def test_a_browser_without_scripts_has_pages(house: House) -> None:
    await add(house)
    browser = house.clients[0]
    page = await browser.get("/tray")
    assert 'formaction="/bus/dry-end/tray/remove"' in page.text
    review = await browser.get("/bus/dry-end/tray/review")
    assert "<!doctype html>" in review.text
    assert 'method="post" action="/bus/dry-end/tray/send"' in review.text
    form = {"id": "c" * 32, "reviewed_at": str(time.time()), "row": ROW.findall(review.text)}
    done = await browser.post("/bus/dry-end/tray/send", data=form)
    assert "<!doctype html>" in done.text
    assert "0 of 1 change made" in done.text
    refused = await browser.post("/bus/dry-end/tray/send", data={**form, "reviewed_at": "1"})
    assert refused.status_code == 409
    removed = await browser.post("/bus/dry-end/tray/remove", data={"place": "setpoint-1-0"})
    assert (removed.status_code, removed.headers["location"]) == (303, "/tray")
    assert "The change tray is empty" in (await browser.get("/tray")).text


async def words_of_server(house: House) -> list[str]:
    """What the events say of trays."""
    return [event["what"] for event in await house.events("server") if "tray" in event["what"]]


async def test_a_restart_keeps_the_tray_with_the_scales_and_names_what_is_dropped(tmp_path: Path) -> None:
    async with complete_app(tmp_path) as house:
        responding(house.services[LiveState])
        await house.signed_in(Role.ENGINEER)
        await add(house, 2)
        await post(house, "/units/dry-end/1/tray/parameters/6", raw="75", scale="-")
        await add(house, 1)
        await post(house, "/bus/dry-end/tray/remove", place="setpoint-1-0")
        before = house.services.buses["dry-end"][TrayStore].trays
        [sender] = before._trays
    async with complete_app(tmp_path) as house:
        responding(house.services[LiveState])
        trays = house.services.buses["dry-end"][TrayStore].trays
        assert trays.changes(sender, monotonic_now()) == {SPEED_2: 1500, RAMP: 75}
        assert trays.scales(sender)[SPEED_2] == before.scales(sender)[SPEED_2] != {}
        await house.signed_in(Role.ENGINEER)
        assert await review_rows(house) == ["setpoint-2-0:1500:1000", "parameter-1-6:75:100"]
        assert await words_of_server(house) == []
    [bus] = settings_in(tmp_path).bus
    only_unwind = bus.model_copy(update={"unit": bus.unit[:1]})
    for _ in range(2):
        async with complete_app(tmp_path, bus=only_unwind) as house:
            trays = house.services.buses["dry-end"][TrayStore].trays
            assert trays.changes(sender, monotonic_now()) == {RAMP: 75}
            assert await words_of_server(house) == [
                "1 change dropped from the tray of the-engineer: no longer in the configuration: unit 2"
            ]


async def test_what_was_being_sent_when_the_server_ended_is_not_back_as_unsent(tmp_path: Path) -> None:
    async with complete_app(tmp_path) as house:
        responding(house.services[LiveState])
        await house.signed_in(Role.ENGINEER)
        await add(house, 1)
        await add(house, 2)
        kept = house.services.buses["dry-end"][TrayStore]
        [sender] = kept.trays._trays
        under_way = kept.sending(sender, {SPEED_1: 1500})
        await under_way.__aenter__()
        await post(house, "/units/dry-end/1/tray/parameters/6", raw="75", scale="-")
    async with complete_app(tmp_path) as house:
        trays = house.services.buses["dry-end"][TrayStore].trays
        assert trays.changes(sender, monotonic_now()) == {SPEED_2: 1500, RAMP: 75}
        [words] = await words_of_server(house)
        assert words.startswith("1 change from the tray of the-engineer was being sent when the server ended")


async def test_what_was_not_sent_stays_on_disk(tmp_path: Path) -> None:
    async with complete_app(tmp_path) as house:
        responding(house.services[LiveState])
        await house.signed_in(Role.ENGINEER)
        await add(house)
        assert "0 of 1 change made" in (await press_send(house)).text
    async with complete_app(tmp_path) as house:
        responding(house.services[LiveState])
        await house.signed_in(Role.ENGINEER)
        assert await review_rows(house) == ["setpoint-1-0:1500:1000"]
        assert await words_of_server(house) == []
