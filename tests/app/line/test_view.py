"""The present state, and the line, its buses and units as the API shows them."""

from __future__ import annotations

import time
from collections.abc import Sequence
from datetime import datetime
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ConfigDict, TypeAdapter

from app.line.commands.api import CommandResult, result_json
from app.line.live.api.view import BusShown, CauseShown, ParameterShown, UnitShown, parameter_json
from app.line.live.bus_live import (
    NO_WORKER,
    Audience,
    BusLive,
    LiveState,
    offline_after_s,
    scan_s_at_best,
    scan_s_of,
    stale_after_s,
    unit_link_now,
    updates_of,
)
from bus.catalogue import parameters as catalogue
from bus.contract import (
    BusFigures,
    BusLink,
    Frame,
    ParameterValue,
    Result,
    Staged,
    UnitFigures,
    UnitLink,
    UnitLinkState,
    UnitOutcome,
    Update,
)
from bus.messages import Message, term
from tests.app.complete_app import House
from tests.app.fake_worker import HEALTHY, PARAMETERS, REMOTE, bus_settings, reading, snapshot, until
from tests.app.screens import line_view

CONTRACT_UNIT = {
    *("id", "name", "link", "read_at", "age_ms", "commanded_raw", "actual_raw", "commanded", "actual"),
    *("decimals", "analog_raw", "analog", "at_speed", "remote", "outputs", "inputs"),
}
CONTRACT_BUS = {"name", "port", "baud", "link", "scan_hz", "wire_utilisation", "units"}
NULL_BEFORE_READ = CONTRACT_UNIT - {"id", "name", "link"}


def live_with(**settings: Any) -> LiveState:
    """Return the state of three units that responded."""
    live = LiveState([bus_settings(**settings)], time.time())
    live.buses["dry-end"].connect_worker(snapshot())
    return live


def shown(live: LiveState, unit: int = 1, later_s: float = 0.0) -> dict[str, Any]:
    """One unit's JSON."""
    return line_view(live).unit("dry-end", unit, time.time() + later_s)


def parameter(number: int, raw: int | None, **more: Any) -> ParameterValue:
    """Of unit 1."""
    return ParameterValue(unit=1, number=number, at=time.time(), raw=raw, **more)


def test_what_was_never_read_is_null() -> None:
    unit = shown(LiveState([bus_settings()], time.time()))
    assert unit.keys() >= CONTRACT_UNIT
    assert {name for name in CONTRACT_UNIT if unit[name] is None} == NULL_BEFORE_READ
    assert unit["link"] == "unknown"


def test_a_unit_in_its_own_decimals() -> None:
    live = live_with()
    live.buses["dry-end"].apply([reading(1, 12345, actual=12300, analog=51)])
    unit = shown(live)
    assert unit.keys() >= CONTRACT_UNIT
    assert (unit["commanded_raw"], unit["actual_raw"], unit["decimals"]) == (12345, 12300, 1)
    assert (unit["commanded"], unit["actual"], unit["deviation"]) == ("1234.5", "1230.0", "-4.5")
    assert (unit["analog_raw"], unit["analog"]) == (51, 100.0)
    assert unit["rpm"] == 1076.2
    assert unit["link"] == "online"


def test_without_decimals_no_number_is_made_up() -> None:
    live = LiveState([bus_settings()], time.time())
    live.buses["dry-end"].apply([reading(1, 12345), UnitLink(unit=1, at=time.time(), link="online")])
    unit = shown(live)
    assert unit["commanded_raw"] == 12345
    assert unit["commanded"] is unit["actual"] is unit["decimals"] is unit["analog"] is unit["rpm"] is None


def test_the_age_is_by_the_servers_clock() -> None:
    unit = shown(live_with(), later_s=3.0)
    assert 2900 <= unit["age_ms"] <= 60_000
    assert unit["link"] in ("stale", "offline")
    assert datetime.fromisoformat(unit["read_at"]).tzinfo is not None


@pytest.mark.parametrize(
    ("outputs", "inputs", "expected"),
    [
        (REMOTE, HEALTHY, {"remote": True, "at_speed": False}),
        (0x80, HEALTHY, {"remote": False, "at_speed": True, "mode": "LOCAL"}),
        (0b101001, HEALTHY, {"outputs": [True, False, False, True, False, True]}),
    ],
)
def test_output_bits(outputs: int, inputs: int, expected: dict[str, Any]) -> None:
    live = live_with()
    live.buses["dry-end"].apply([reading(1, outputs=outputs, inputs=inputs)])
    assert shown(live).items() >= expected.items()


@pytest.mark.parametrize(
    ("healthy", "bit", "active"), [(1, 1, False), (1, 0, True), (0, 0, False), (0, 1, True)]
)
def test_estop_is_true_when_one_is_active_in_this_dialect(healthy: int, bit: int, active: bool) -> None:
    live = live_with(estop_healthy=healthy)
    live.buses["dry-end"].apply([reading(1, inputs=bit << 1)])
    assert shown(live)["inputs"]["estop"] is active


def test_every_input_has_its_name() -> None:
    names = ("run", "estop", "preset", "reverse", "up", "down", "slave")
    for position, name in enumerate(names):
        live = live_with(estop_healthy=0)
        live.buses["dry-end"].apply([reading(1, inputs=1 << position)])
        inputs = shown(live)["inputs"]
        assert [key for key in names if inputs[key]] == [name]
        assert set(inputs) == set(names)


def test_a_follower_stages_a_ratio_and_shows_a_speed_or_a_ratio_by_dialect() -> None:
    for follower_speed, commanded in (("speed", "1000.0"), ("ratio", "1.0000")):
        live = live_with(follower_speed=follower_speed)
        live.buses["dry-end"].apply([reading(1, 10000), parameter(8, 1), Staged(unit=1, at=0.0, raw=12345)])
        unit = shown(live)
        assert unit["follower"] is True
        assert (unit["commanded"], unit["staged"]) == (commanded, "1.2345")


def test_a_bus_with_and_without_figures() -> None:
    live = live_with()
    bus = line_view(live).bus("dry-end", time.time())
    assert bus.keys() >= CONTRACT_BUS
    assert (bus["link"], bus["scan_hz"], len(bus["units"])) == ("open", None, 3)
    figures = BusFigures(at=1.0, scan_hz=12.5, scan_s=0.08, wire_utilisation=0.98, scan_s_with_one_more=0.1)
    live.buses["dry-end"].apply([figures, BusLink(at=2.0, link="closed", cause=term("unplugged"))])
    bus = line_view(live).bus("dry-end", time.time())
    assert (bus["link"], bus["link_cause"]["detail"], bus["scan_hz"]) == ("closed", "unplugged", 12.5)


def test_a_parameter_as_read_unread_and_not_there() -> None:
    live = live_with()
    live.buses["dry-end"].apply([parameter(6, 50), parameter(40, None, available=False)])
    unit = live.buses["dry-end"].units[1]
    ramp = parameter_json(unit, 6)
    wanted = {"number": 6, "raw": 50, "value": "5.0", "unit": "s", "min": 0, "max": 9999, "available": True}
    assert ramp.items() >= wanted.items()
    unread = parameter_json(unit, 7)
    assert [unread[name] for name in ("raw", "value", "read_at", "available")] == [None] * 4
    absent = parameter_json(unit, 40)
    assert (absent["raw"], absent["available"]) == (None, False)
    assert absent["read_at"] is not None
    assert parameter_json(unit, 2)["value"] == f"{PARAMETERS[2] / 10}"


def test_the_password_is_masked() -> None:
    live = live_with()
    live.buses["dry-end"].apply([parameter(21, 4242)])
    row = parameter_json(live.buses["dry-end"].units[1], 21)
    assert row["raw"] is None
    assert row["masked"] is True
    assert "4242" not in str(row)


EXACT = ConfigDict(extra="forbid", strict=True)


@pytest.fixture
def exact(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is converted, and nothing is left over. TypeAdapter takes it from the class alone, of which
    apps and other tests make schemas."""
    for kind in (BusShown, UnitShown, ParameterShown, CommandResult):
        monkeypatch.setattr(kind, "__pydantic_config__", EXACT, raising=False)


@pytest.mark.usefixtures("exact")
def test_units_and_buses_read_and_unread() -> None:
    live = LiveState([bus_settings()], time.time())
    view = line_view(live, blocks={1: "belt off"})
    for _ in range(2):
        bus = view.bus("dry-end", time.time())
        TypeAdapter(BusShown).validate_python(bus)
        for unit in bus["units"]:
            TypeAdapter(UnitShown).validate_python(unit)
            assert unit.keys() == UnitShown.__annotations__.keys()
            assert unit["cause"].keys() == CauseShown.__annotations__.keys()
        live.buses["dry-end"].connect_worker(snapshot())
    for number in catalogue.PARAMETERS:
        row = parameter_json(live.buses["dry-end"].units[1], number)
        TypeAdapter(ParameterShown).validate_python(row)


@pytest.mark.usefixtures("exact")
def test_outcomes() -> None:
    live = LiveState([bus_settings()], time.time())
    frame = Frame(at=1.0, direction="out", data=b"x", meanings=[term("m")])
    parts = [UnitOutcome(unit=1, outcome="verified", sent_at=1.0, proven_at=2.0, attempts=1)]
    result = Result(id="a", at=1.0, outcome="verified", units=parts, frames=[frame])
    for unit in (None, 1):
        result_of = result_json(live.buses["dry-end"], result, unit)
        TypeAdapter(CommandResult).validate_python(result_of)


async def test_figures_before_and_after_they_are_measured(site: House) -> None:
    worker = await site.worker()
    assert (await site.request("GET", "/figures", role="viewer")).json()["measured"] is False
    units = [UnitFigures(unit=1, polls=9, naks={128: 2})]
    await worker.update(BusFigures(1.0, 12.0, 0.08, 0.98, 0.1, units=units))
    await until(lambda: site.live.figures is not None, "figures")
    figures = (await site.request("GET", "/figures", role="viewer")).json()
    assert figures["scan_hz"] == 12.0
    assert figures["units"][0]["polls"] == 9
    assert figures["units"][0]["naks"] == [
        {"unit_error": 128, "unit_error_name": "unit is not in REMOTE mode", "count": 2}
    ]


async def test_a_text_is_one_object_with_its_code(site: House) -> None:
    worker = await site.worker()
    late = Message("diagnosis_no_response")
    await worker.update(BusFigures(1.0, 12.0, 0.08, 0.98, 0.1, responds_for_all=2, diagnosis=[late]))
    await until(lambda: site.live.figures is not None, "figures")
    await site.request("POST", "/units/1/block", {"reason": "belt off"}, role="operator")
    bus = (await site.http("viewer").get("/api/v1/buses/dry-end")).json()
    assert bus["diagnosis"] == [{"code": "diagnosis_no_response", "params": {}, "detail": str(late)}]
    assert bus["link_cause"] is None
    unit = bus["units"][0]
    assert (unit["suspect"]["code"], unit["suspect"]["params"]) == ("suspect_by_duplicates", {"unit": 2})
    assert unit["suspect"]["detail"] == "unit 2 may respond in its place (each response comes twice)"
    assert unit["blocked"]["params"]["reason"] == "belt off"
    assert "belt off" in unit["blocked"]["detail"]


READ_AT = 1000.0


def bus_of(reported: UnitLinkState = "online", *, port: str = "open", scan_s: float | None = None) -> BusLive:
    """Unit 1 was read at READ_AT."""
    live = LiveState([bus_settings()], 0.0)
    read = reading(1)
    word = type(read)(1, READ_AT, read.commanded, read.actual, read.analog, read.outputs, read.inputs)
    live.buses["dry-end"].apply([word, UnitLink(unit=1, at=READ_AT, link=reported)])
    live.buses["dry-end"].apply([BusLink(at=0.0, link="open" if port == "open" else "closed")])
    if scan_s is not None:
        live.buses["dry-end"].apply([BusFigures(0.0, 1 / scan_s, scan_s, 0.9, scan_s)])
    return live.buses["dry-end"]


@pytest.mark.parametrize(
    ("reported", "port", "age_s", "link"),
    [
        ("online", "open", 0.0, "online"),
        ("online", "open", 2.0, "online"),
        ("online", "open", 2.01, "stale"),
        ("online", "open", 10.1, "offline"),
        ("stale", "open", 0.0, "stale"),
        ("offline", "open", 0.0, "offline"),
        ("online", "closed", 0.0, "stale"),
        ("online", "closed", 11.0, "offline"),
    ],
)
def test_the_worse_of_word_port_and_age(
    reported: UnitLinkState, port: str, age_s: float, link: UnitLinkState
) -> None:
    bus = bus_of(reported, port=port)
    assert unit_link_now(bus, bus.units[1], READ_AT + age_s) == link


def test_a_long_scan_is_given_its_time() -> None:
    bus = bus_of(scan_s=6.6)
    assert unit_link_now(bus, bus.units[1], READ_AT + 13.1) == "online"
    assert unit_link_now(bus, bus.units[1], READ_AT + 13.3) == "stale"
    assert unit_link_now(bus, bus.units[1], READ_AT + 34.0) == "offline"


def test_a_unit_that_never_responded_is_unknown_whatever_is_reported() -> None:
    bus = bus_of()
    assert unit_link_now(bus, bus.units[2], READ_AT) == "unknown"


def test_before_figures_the_scan_is_what_the_wire_allows() -> None:
    bus = bus_of()
    assert scan_s_of(bus) == scan_s_at_best(bus.settings)
    assert scan_s_at_best(bus.settings) == pytest.approx(3 * 250 / 9600)


def test_before_figures_a_limited_scan_is_given_its_time() -> None:
    bus = bus_of()
    bus.settings = bus.settings.model_copy(update={"max_scan_hz": 0.2})
    assert scan_s_of(bus) == 5.0
    bus.settings = bus.settings.model_copy(update={"max_scan_hz": 100.0})
    assert scan_s_of(bus) == pytest.approx(3 * 250 / 9600), "more than the wire carries"


@given(st.floats(0, 1000))
def test_offline_comes_after_stale(scan_s: float) -> None:
    assert offline_after_s(scan_s) > stale_after_s(scan_s) >= 2.0


@pytest.fixture
def live() -> LiveState:
    return LiveState([bus_settings()], 100.0)


def test_at_first_nothing_is_known(live: LiveState) -> None:
    bus = live.buses["dry-end"]
    assert (bus.link.link, bus.link.cause, bus.worker_connected) == ("closed", NO_WORKER, False)
    assert list(bus.units) == [1, 2, 16]
    assert {unit.link.link for unit in bus.units.values()} == {"unknown"}
    assert all(unit.reading is None for unit in bus.units.values())


def test_each_word_changes_what_it_is_about(live: LiveState) -> None:
    figures = BusFigures(at=1.0, scan_hz=4.0, scan_s=0.25, wire_utilisation=0.9, scan_s_with_one_more=0.3)
    link = UnitLink(unit=2, at=1.0, link="online")
    port = BusLink(at=1.0, link="open")
    update = reading(2, 55)
    live.buses["dry-end"].apply(
        [port, figures, link, update, ParameterValue(2, 3, 1.0, 1), Staged(2, 1.0, 77)]
    )
    bus, unit = live.buses["dry-end"], live.buses["dry-end"].units[2]
    assert (bus.link, bus.figures) == (port, figures)
    assert (unit.link, unit.reading, unit.staged, unit.parameter_raw(3)) == (link, update, 77, 1)
    assert unit.parameter_raw(4) is None
    live.buses["dry-end"].apply([Staged(2, 2.0, None)])
    assert unit.staged is None
    assert live.buses["dry-end"].units[1].reading is None


def test_the_rate_is_the_last_that_the_worker_reported(live: LiveState) -> None:
    bus = live.buses["dry-end"]
    live.buses["dry-end"].apply([BusLink(at=1.0, link="open")])
    assert bus.baud == 9600, "as configured where an older worker reports none"
    live.buses["dry-end"].apply([BusLink(at=1.0, link="open", baud=4800)])
    assert bus.baud == 4800


def test_a_unit_that_is_not_configured_is_passed_over(live: LiveState) -> None:
    live.buses["dry-end"].apply([reading(99), reading(1, 5)])
    found = live.buses["dry-end"].units[1].reading
    assert found is not None
    assert found.commanded == 5


def test_a_snapshot_is_the_same_as_its_updates(live: LiveState) -> None:
    present = snapshot()
    other = LiveState([bus_settings()], 100.0)
    live.buses["dry-end"].connect_worker(present)
    other.buses["dry-end"].apply(updates_of(present))
    assert live.buses["dry-end"].units == other.buses["dry-end"].units


def test_a_lost_worker_leaves_the_readings_and_takes_the_trust(live: LiveState) -> None:
    live.buses["dry-end"].connect_worker(snapshot())
    live.buses["dry-end"].apply([UnitLink(unit=16, at=1.0, link="offline")])
    live.buses["dry-end"].lose_worker(9.0)
    bus = live.buses["dry-end"]
    assert (bus.link, bus.figures) == (BusLink(at=9.0, link="closed", cause=NO_WORKER), None)
    assert bus.units[1].reading is not None
    assert [unit.link.link for unit in bus.units.values()] == ["stale", "stale", "offline"]


def test_subscribers_get_every_change_until_they_leave(live: LiveState) -> None:
    received: list[Sequence[Update]] = []
    leave = live.buses["dry-end"].subscribe(Audience.STREAM, received.append)
    update = [reading(1)]
    live.buses["dry-end"].apply(update)
    leave()
    live.buses["dry-end"].apply([reading(1)])
    assert received == [update]


def test_subscribers_learn_of_a_report_in_the_order_of_their_audiences(live: LiveState) -> None:
    learned: list[Audience] = []
    for audience in reversed(Audience):
        live.buses["dry-end"].subscribe(audience, lambda _, audience=audience: learned.append(audience))
    live.buses["dry-end"].apply([reading(1)])
    assert learned == list(Audience)


def test_a_subscriber_that_fails_stops_no_other(live: LiveState) -> None:
    def fail(updates: Sequence[Update]) -> None:
        raise RuntimeError(updates)

    received: list[Sequence[Update]] = []
    live.buses["dry-end"].subscribe(Audience.BROWSERS, fail)
    live.buses["dry-end"].subscribe(Audience.STREAM, received.append)
    update = [reading(1, 5)]
    live.buses["dry-end"].apply(update)
    assert received == [update]
