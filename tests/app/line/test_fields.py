from __future__ import annotations

import pytest

from app.line.live.fields import bus_fields, health_fields, unit_fields
from bus.contract import BusFigures, BusLink, ParameterValue, UnitFigures
from tests.app.screens import AT_SPEED, REMOTE, line, reading, translator


def fields(tag: str = "en", **changes: int) -> dict[str, str]:
    live = line()
    bus = live.buses["dry"]
    live.buses["dry"].apply([reading(**changes)])
    return unit_fields(bus, bus.units[1], "online", translator(tag))


def test_numbers_are_in_the_unit_s_own_decimals_and_the_language_s_sign() -> None:
    assert fields(actual=1195)["actual"] == "119.5"
    assert fields("de", actual=1195)["actual"] == "119,5"


@pytest.mark.parametrize(("actual", "expected"), [(1200, "±0.0"), (1203, "+0.3"), (1150, "−5.0")])  # noqa: RUF001
def test_the_error_has_a_sign(actual: int, expected: str) -> None:
    assert fields(actual=actual)["deviation"] == expected


def test_positions_are_parts_of_the_span() -> None:
    shown = fields(commanded=1000, actual=500)
    assert (shown["fill"], shown["mark"], shown["band"]) == ("0.2500", "0.5000", "0.0100")


@pytest.mark.parametrize(
    ("actual", "off"), [(1200, "0.500"), (1210, "0.667"), (1230, "1.000"), (100, "0.000")]
)
def test_the_band_is_the_middle_third_of_the_deviation_bar(actual: int, off: str) -> None:
    assert fields(actual=actual)["off"] == off


def test_more_than_the_span_fills_the_bar_and_no_more() -> None:
    shown = fields(commanded=2500, actual=2500)
    assert (shown["fill"], shown["mark"]) == ("1.0000", "1.0000")


def test_without_the_span_there_is_no_position() -> None:
    live = line()
    bus = live.buses["dry"]
    live.buses["dry"].apply([ParameterValue(unit=1, number=2, at=100.0, raw=None, available=False)])
    shown = unit_fields(bus, bus.units[1], "online", translator())
    assert (shown["fill"], shown["mark"], shown["band"]) == ("", "", "")


def test_a_unit_that_never_responded_is_unknown_and_not_zero() -> None:
    live = line()
    bus = live.buses["dry"]
    bus.units[1].reading = None
    shown = unit_fields(bus, bus.units[1], "unknown", translator())
    assert (shown["actual"], shown["at"], shown["state_text"]) == ("–", "", "not known")  # noqa: RUF001


def test_bits_stand_in_the_order_of_the_lamps() -> None:
    shown = fields(outputs=AT_SPEED | REMOTE | 0b000101, inputs=0b1000001)
    assert shown["outputs"] == "101000"
    assert shown["inputs"] == "1100001", "an open e-stop chain counts as active"


def test_local_and_keylock_are_distinguished_by_parameter_19() -> None:
    assert fields()["mode"] == "remote"
    assert fields(outputs=0)["mode_text"] == "LOCAL"
    live = line()
    bus = live.buses["dry"]
    live.buses["dry"].apply([reading(outputs=0), ParameterValue(unit=1, number=19, at=100.0, raw=2)])
    assert unit_fields(bus, bus.units[1], "online", translator())["mode_text"] == "KEYLOCK"


def test_analog_is_in_its_units() -> None:
    assert fields()["analog"] == "254"


def test_a_bus_without_figures_shows_unknown() -> None:
    shown = bus_fields(line().buses["dry"], translator(), 100.5)
    assert (shown["scan"], shown["wire"]) == ("–", "–")  # noqa: RUF001
    assert shown["stale_after"] == "2.00"


def test_the_rate_of_a_bus_is_shown_in_every_place() -> None:
    live = line()
    live.buses["dry"].apply([BusLink(at=100.0, link="open", baud=4800)])
    shown = bus_fields(live.buses["dry"], translator("de"), 100.5)
    assert (shown["baud"], shown["carries"]) == ("4800", "der Kapazität von 4800 Baud")


def test_a_bus_s_figures_are_texts() -> None:
    live = line()
    live.buses["dry"].apply(
        [BusFigures(at=100.0, scan_hz=4.8, scan_s=1.5, wire_utilisation=0.976, scan_s_with_one_more=1.6)],
    )
    shown = bus_fields(live.buses["dry"], translator("de"), 100.5)
    assert (shown["scan"], shown["wire"], shown["stale_after"]) == ("1,50 s", "98 %", "3.00")


def test_without_a_response_there_is_no_scan_time() -> None:
    live = line()
    live.buses["dry"].apply(
        [BusFigures(at=100.0, scan_hz=0.0, scan_s=0.0, wire_utilisation=0.3, scan_s_with_one_more=0.0)],
    )
    shown = bus_fields(live.buses["dry"], translator(), 100.5)
    assert (shown["scan"], shown["wire"]) == ("–", "30 %")  # noqa: RUF001


def test_health_names_each_refusal() -> None:
    figures = UnitFigures(
        unit=1, polls=10, responses=8, naks={0x80: 2}, response_s_median=0.003, response_s_max=0.04
    )
    shown = health_fields(figures, translator("de"))
    assert shown["naks"] == "2 x Regler ist nicht in REMOTE"
    assert shown["answer_time"] == "3,0 ms, höchstens 40,0 ms"
