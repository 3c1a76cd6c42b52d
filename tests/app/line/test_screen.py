"""What pages show of units, buses, frames and the line, and which fields go on after a change."""

from __future__ import annotations

import re

import pytest

from app.line.conditions.catalogue import TILES
from app.line.live.bus_live import Onset
from app.line.live.diagnosis import abnormal
from app.line.live.fields import bus_fields, frame_fields, health_fields, name_on_site, unit_fields
from app.line.live.screen import NO_BREAK, NamedCause, Screen, holders, line_fields, verdict_line
from app.line.live.sources import Drifted
from bus.contract import MAX_MEANING, BusFigures, BusLink, Frame, ParameterValue, UnitFigures
from bus.instants import UnixTime
from bus.messages import Message, term
from bus.settings import Dialect
from bus.wire.commands import WriteParameterRequest, encode_request
from bus.wire.describe import describe_bytes
from tests.app.screens import AT_SPEED, HEALTHY, REMOTE, line, reading, screen, translator


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


def test_what_a_setpoint_is_shown_in_is_a_field_that_its_steps_and_limits_follow() -> None:
    live = line()
    bus = live.buses["dry"]
    seen = []
    for number, raw in ((8, 0), (3, 2), (2, 1500), (8, 1)):
        bus.apply([ParameterValue(unit=1, number=number, at=2.0, raw=raw)])
        shown = unit_fields(bus, bus.units[1], "online", translator("en"))
        seen.append((shown["scale"], shown["follower"]))
    assert seen == [
        ("1:2000:speed", "speed"),
        ("2:2000:speed", "speed"),
        ("2:1500:speed", "speed"),
        ("2:1500:ratio", "ratio"),
    ]


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
        [BusFigures(at=100.0, scan_hz=4.8, scan_s=1.5, wire_utilisation=0.976, scan_s_with_one_more=1.6)]
    )
    shown = bus_fields(live.buses["dry"], translator("de"), 100.5)
    assert (shown["scan"], shown["wire"], shown["stale_after"]) == ("1,50 s", "98 %", "3.00")


def test_without_a_response_there_is_no_scan_time() -> None:
    live = line()
    live.buses["dry"].apply(
        [BusFigures(at=100.0, scan_hz=0.0, scan_s=0.0, wire_utilisation=0.3, scan_s_with_one_more=0.0)]
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


def test_a_frame_in_german() -> None:
    (described,) = describe_bytes(encode_request(WriteParameterRequest(3, 6, 50), Dialect()))
    frame = Frame(at=100.1234, direction="out", data=described.wire, meanings=[described.meaning])
    assert frame_fields(frame, translator("de")) == {
        "at": 100.1234,
        "direction": "out",
        "hex": "10 02 03 86 06 00 00 00 32 10 03 3F",
        "meaning": "Regler 3: Hochlauframpe (Parameter 6) = 50 schreiben",
        "valid": True,
    }
    assert frame.meaning == "unit 3: write Acceleration Ramp Rate (parameter 6) = 50"


def test_each_statement_of_a_frame_is_shown() -> None:
    noise = Message.of("noise", count=2, reason=Message("noise_outside"))
    frame = Frame(at=1.0, direction="in", data=b"", meanings=[noise, Message("ack")])
    assert frame_fields(frame, translator("de"))["meaning"] == (
        "2 Byte, die kein Telegramm sind: außerhalb eines Telegramms; ACK, Schreiben angenommen"
    )


@pytest.mark.parametrize("tag", ["en", "de"])
@pytest.mark.parametrize(
    ("message", "meaning"),
    [
        (
            Message.of("frame_recorded", text="{a.__class__} {a!r} {a:>99999}"),
            "{a.__class__} {a!r} {a:>99999}",
        ),
        (Message.of("frame_recorded", words="x"), "{text}"),
        (Message.of("of_another_version", unit=3), "of_another_version 3"),
        (Message.of("frame_recorded", text="x" * 4_000), "x" * MAX_MEANING),
    ],
)
def test_a_message_of_a_worker_is_no_format(tag: str, message: Message, meaning: str) -> None:
    frame = Frame(at=1.0, direction="in", data=b"", meanings=[message])
    assert frame_fields(frame, translator(tag))["meaning"] == frame.meaning == meaning


@pytest.mark.parametrize(
    ("held_by", "english", "german"),
    [
        ({"line": ""}, "", ""),
        ({"line": "anna"}, "anna", "anna"),
        ({"line": "anna", "wet": "anna"}, "anna, every bus", "anna, jeder Bus"),
        ({"line": "", "wet": "ben"}, "line: free, wet: ben", "line: frei, wet: ben"),
        ({"line": "", "wet": "ben", "dry": ""}, "wet: ben, the others: free", "wet: ben, die anderen: frei"),
        ({"line": "a (token)", "wet": ""}, "line: a (token), wet: free", "line: a (token), wet: frei"),
    ],
)
def test_the_holder_of_control_is_shown_with_the_bus(
    held_by: dict[str, str], english: str, german: str
) -> None:
    texts = [holders(held_by, translator(tag)).replace("\u00a0", " ") for tag in ("en", "de")]
    assert texts == [english, german]


def test_a_unit_is_named_with_its_bus_where_there_are_several() -> None:
    assert name_on_site("wet", "Nip", ["wet"]) == "Nip"
    assert name_on_site("wet", "Nip", ["wet", "dry"]) == "wet · Nip"


def test_units_abnormal_or_with_an_alarm_are_counted_and_a_bus_is_named() -> None:
    units = [NamedCause(f"dry/{n}", f"Unit {n}", abnormal("estop_active")) for n in range(1, 41)]
    found = [*units, NamedCause("wet", "wet", abnormal("no_unit_yet"))]
    wet, alarmed = {"wet": line(4).buses["dry"]}, {"dry/1", "dry/41"}
    fields = line_fields(wet, {}, found, translator("en"), UnixTime(1_000_000.0), alarmed)
    assert (fields["abnormal"], fields["counts"], fields["name"]) == ("45", "45 abnormal", "Unit 1")
    assert fields["named"] == "wet: No unit has responded yet"
    assert fields["beside"] == "·_wet:_No_unit_has_responded_yet".replace("_", NO_BREAK)


def test_a_condition_of_low_priority_is_no_verdict() -> None:
    found = [NamedCause("dry/1", "Nip", abnormal("drift", params={"why": "#3 differs"}))]
    fields = line_fields({}, {}, found, translator("en"), UnixTime(1_000_000.0))
    assert (fields["level"], fields["name"], fields["at"]) == ("", "", "")
    assert (fields["abnormal"], fields["counts"]) == ("1", "1 abnormal")


@pytest.mark.parametrize(
    ("tag", "verdict", "why"),
    [
        ("en", "Stopped: run input off since 12:00", "no alarm: an input stopped it"),
        ("de", "Steht: Eingang Lauf aus seit 12:00", "kein Alarm: per Eingang gestoppt"),
    ],
)
def test_the_reason_why_a_cause_is_no_alarm_is_beside_the_verdict(tag: str, verdict: str, why: str) -> None:
    no_alarms = [code for code in TILES if not TILES[code].is_alarm]
    assert [code for code in no_alarms if TILES[code].priority != "low"] == ["run_off"]
    cause = abnormal("run_off", Onset(UnixTime(43_200.0)), {"motion": "stopped"})
    nip, estop = NamedCause("dry/1", "Nip", cause), NamedCause("dry/2", "Coater", abnormal("estop_active"))

    def shown(*found: NamedCause) -> tuple[str, str]:
        fields = line_fields({}, {}, found, translator(tag), UnixTime(43_260.0))
        return fields["cause"], fields["named"]

    assert shown(nip) == (f"· {verdict}", why)
    assert shown(estop, nip)[1] == f"Nip: {why}"
    assert shown(nip, *(NamedCause(f"dry/{n}", f"Unit {n}", cause) for n in (3, 4)))[1] == (
        f"Nip, Unit 3, Unit 4: {why}"
    )
    four = shown(*(NamedCause(f"dry/{n}", f"Unit {n}", cause) for n in range(4)))[1]
    assert re.fullmatch(rf"4 (units|Regler): {why}", four)
    assert verdict_line(cause, translator(tag), UnixTime(43_260.0)) == f"{verdict} · {why}"


def test_until_a_cause_is_an_alarm_the_verdict_says_when_it_will_be() -> None:
    live = line()
    live.buses["dry"].lose_worker(UnixTime(100.0))
    shown = screen(live)
    for delay_s, named in ((10.0, "alarm after 10 s"), (0.0, "")):
        delays = {("dry", "worker_lost"): delay_s}
        shown.sources.alarm_delay_s = lambda *condition, delays=delays: delays[condition]
        shown.render("dry", [], UnixTime(101.0), include_bus=True)
        assert shown.shown["line_summary"]["level"] == "urgent"
        assert shown.shown["line_summary"]["named"] == named


def stopped_with(source: str, at: float) -> Screen:
    """A line whose second unit is stopped by its e-stop, with a time for its alarm from this source."""
    live = line()
    shown = screen(live)
    setattr(shown.sources, source, lambda *of: UnixTime(at) if of == ("dry/2", "estop_active") else None)
    live.buses["dry"].apply([reading(2, at=258.0, inputs=1)])
    shown.render("dry", [2], UnixTime(260.2), include_bus=False)
    return shown


def test_a_cause_that_is_an_alarm_is_told_with_the_time_of_the_alarm() -> None:
    shown = stopped_with("alarm_since", 260.0)
    assert str(shown.shown["dry/2"]["status"]).endswith("since 00:04")
    assert str(shown.shown["line_summary"]["cause"]).endswith("since 00:04")


def test_a_cause_whose_alarm_is_shelved_says_until_when_on_its_page_and_beside_the_verdict() -> None:
    shown = stopped_with("shelved_until", 900.0)
    assert str(shown.shown["dry/2"]["status"]).endswith(" · alarm shelved until 00:15")
    assert shown.shown["line_summary"]["named"] == "alarm shelved until 00:15"
    found = [
        NamedCause("dry/1", "Nip", abnormal("not_at_speed")),
        NamedCause("dry/2", "Coater", abnormal("estop_active")),
    ]
    fields = line_fields(
        {}, {}, found, translator("de"), UnixTime(0.0), shelved_until=shown.sources.shelved_until
    )
    assert fields["named"] == "Coater: Alarm zurückgestellt bis 00:15"


def figures(scan_s: float = 0.3) -> BusFigures:
    return BusFigures(at=100.0, scan_hz=3, scan_s=scan_s, wire_utilisation=0.9, scan_s_with_one_more=0.4)


def test_the_alarm_of_a_cause_alone_says_its_time() -> None:
    live = line()
    shown = screen(live)
    page = "/alarms/dry.2.estop_active.1"
    for mark, status in (("urgent waiting", "active"), ("urgent cleared", "active since 00:01")):
        shown.sources.unit_alarm = lambda *_, mark=mark: {"alarm": mark, "alarm_at": page}
        live.buses["dry"].apply([reading(2, at=100.2, inputs=1)])
        changed = shown.render("dry", [2], 100.2, include_bus=False)
        assert changed["dry/2"]["status"] == f"Still turning: emergency stop {status}"


def test_a_unit_that_ramps_beside_an_alarm_is_shown_like_any_other() -> None:
    live = line()
    shown = screen(live)
    shown.sources.unit_alarm = lambda *_: {"alarm": "low", "alarm_at": "/alarms/dry.2.drift.1"}
    live.buses["dry"].apply([reading(2, at=100.2, outputs=0x40, actual=900)])
    changed = shown.render("dry", [2], 100.2, include_bus=False)
    assert changed["dry/2"]["status"].startswith("Ramp")
    assert changed["dry/2"]["brief"].startswith("Ramp")
    assert (shown.flat()["dry/2.worn"], shown.flat()["dry/2.words"]) == ("low", "")


def test_a_unit_that_ramps_beside_a_drift_has_the_ramp_on_its_tile() -> None:
    live = line()
    shown = screen(live)
    shown.sources.drift["dry"].summary = lambda *_: Drifted("1 value differs", "6")  # type: ignore[method-assign]
    live.buses["dry"].apply([reading(2, at=100.2, outputs=0x40, actual=900)])
    assert shown.render("dry", [2], 100.2, include_bus=False)["dry/2"]["brief"].startswith("Ramp")


@pytest.mark.parametrize(
    ("mark", "inputs", "worn"),
    [
        ("medium waiting", 3, ("medium waiting", "alarm")),
        ("medium", 1, ("", "")),
        ("urgent waiting", 1, ("urgent waiting", "")),
        ("high cleared waiting", 3, ("", "")),
    ],
)
def test_the_mark_and_the_words_of_a_unit_are_of_one_condition(
    mark: str, inputs: int, worn: tuple[str, str]
) -> None:
    live = line()
    shown = screen(live)
    shown.sources.unit_alarm = lambda *_: {"alarm": mark}
    live.buses["dry"].apply([reading(2, at=100.2, inputs=inputs)])
    shown.render("dry", [2], 100.2, include_bus=False)
    assert (shown.flat()["dry/2.worn"], shown.flat()["dry/2.words"]) == worn


def test_only_what_changed_is_given() -> None:
    live = line()
    shown = screen(live)
    live.buses["dry"].apply([reading(1, at=100.2, actual=1199)])
    changed = shown.render("dry", [1], 100.2, include_bus=False)
    assert changed == {
        "dry/1": {"at": "100.20", "actual": "119.9", "deviation": "−0.1", "fill": "0.5995", "off": "0.483"}  # noqa: RUF001
    }
    assert shown.render("dry", [1], 100.2, include_bus=False) == {}


def test_the_worst_cause_is_the_verdict_and_goes() -> None:
    live = line()
    shown = screen(live)
    assert shown.shown["line_summary"]["at"] == ""
    live.buses["dry"].apply([reading(2, at=100.2, inputs=1)])
    changed = shown.render("dry", [2], 100.2, include_bus=False)
    assert {
        name: changed["line_summary"][name] for name in ("at", "level", "verdict", "untimed", "counts")
    } == {
        "at": "/units/dry/2",
        "level": "urgent",
        "verdict": "Unit 2 · Still turning: emergency stop active since 00:01",
        "untimed": "· Still turning: emergency stop active",
        "counts": "1 abnormal",
    }
    assert changed["dry/2"]["status"] == "Still turning: emergency stop active since 00:01"
    assert changed["dry/2"]["brief"] == "Still turning: emergency stop"
    live.buses["dry"].apply([reading(1, at=100.3, inputs=1)])
    changed = shown.render("dry", [1], 100.3, include_bus=False)
    briefs = [shown.shown[f"dry/{unit}"]["brief"] for unit in (1, 2)]
    assert sorted(brief.removeprefix("Still turning: emergency stop") for brief in briefs) == [
        "",
        " since 00:01",
    ]
    live.buses["dry"].apply([reading(1, at=100.4)])
    shown.render("dry", [1], 100.4, include_bus=False)
    live.buses["dry"].apply([reading(2, at=100.4)])
    well = shown.render("dry", [2], 100.4, include_bus=False)["line_summary"]
    verdict = "Running 120.0 m/min · all 2 at speed"
    assert (well["verdict"], well["at"], well["counts"]) == (verdict, "", "")


def test_the_worst_cause_comes_before_an_earlier_one() -> None:
    live = line(3)
    shown = screen(live)
    for unit, at, inputs in ((1, 115.0, 2), (2, 135.0, 1), (3, 150.0, 2)):
        live.buses["dry"].apply([reading(unit, at=at - 0.2), reading(unit, at=at, inputs=inputs, actual=0)])
    live.buses["dry"].apply(
        [reading(unit, at=150.2, inputs=inputs, actual=0) for unit, inputs in ((1, 2), (2, 1))]
    )
    changed = shown.render("dry", [1, 2, 3], 150.2, include_bus=False)["line_summary"]
    assert changed["verdict"] == "Unit 2 · Stopped: emergency stop active since 00:02"
    assert changed["abnormal"] == "3"


def test_a_unit_does_not_repeat_the_lost_cable_of_its_bus() -> None:
    live = line()
    shown = screen(live)
    live.buses["dry"].apply([BusLink(at=101.0, link="closed", cause=term("unplugged"))])
    shown.render("dry", [1, 2], 130.0, include_bus=True)
    assert [shown.shown["dry/1"][name] for name in ("link", "level", "page_level", "cause", "status")] == [
        *("offline", "", "urgent", ""),
        "Port closed since 00:01: unplugged",
    ]
    assert shown.shown["dry/1"]["silent"] == "port closed"


def test_time_alone_makes_stale_then_offline() -> None:
    shown = screen(line())
    assert shown.render_aged(101.0) == {}
    assert shown.render_aged(102.5)["dry/1"]["link"] == "stale"
    offline = shown.render_aged(111.0)["dry/1"]
    assert (offline["link"], shown.shown["dry/1"]["silent"]) == ("offline", "no response")


def test_the_verdict_says_of_no_unit_that_is_stale_what_it_does() -> None:
    live = line()
    shown = screen(live)
    live.buses["dry"].apply([reading(2, at=102.4)])
    shown.render("dry", [2], 102.4, include_bus=False)
    assert shown.render_aged(102.5)["line_summary"]["verdict"] == "1 of 2 at speed, 1 not live"


def test_a_closed_port_is_one_entry_and_not_one_for_each_unit() -> None:
    live = line()
    shown = screen(live)
    live.buses["dry"].apply([BusLink(at=101.0, link="closed", cause=term("unplugged"))])
    changed = shown.render("dry", [1, 2], 101.0, include_bus=True)
    shown_fields = {name: changed["line_summary"][name] for name in ("verdict", "at", "abnormal")}
    assert shown_fields == {
        "verdict": "dry · Port closed since 00:01: unplugged",
        "at": "/bus/dry",
        "abnormal": "2",
    }
    assert changed["dry"]["link"] == "closed"


def test_the_line_s_figures_are_the_worst_of_all_buses() -> None:
    live = line()
    shown = screen(live)
    live.buses["dry"].apply([figures()])
    assert shown.render("dry", [], 100.1, include_bus=True)["line_summary"] == {
        "scan": "0.30 s",
        "wire": "90 %",
    }
    live.buses["wet"] = line().buses["dry"]
    changed = shown.render("dry", [], 100.2, include_bus=True)["line_summary"]
    assert (changed["scan"], changed["wire"]) == ("–", "–")  # noqa: RUF001


def test_a_block_is_shown_with_its_reason() -> None:
    shown = screen(line(), blocks={2: "belt off"})
    assert shown.shown["dry/2"]["status"] == "At speed"
    assert shown.shown["dry/2"]["check"] == "Commands blocked: belt off (anna)"


def test_the_first_line_of_a_unit_says_how_it_runs_and_nothing_of_low_priority() -> None:
    shown = screen(line())
    shown.sources.drift["dry"].summary = lambda *_: Drifted("1 value differs", "6")  # type: ignore[method-assign]
    shown.refresh(100.0)
    unit = shown.shown["dry/1"]
    assert (unit["status"], unit["page_level"], unit["level"]) == ("At speed", "", "low")
    assert unit["check"] == "1 value differs"
    said = {"alarm": "low waiting", "alarm_at": "/alarms/dry.1.parameter_drift.1"}
    shown.sources.unit_alarm = lambda *_: said
    shown.refresh(100.0)
    assert (shown.shown["dry/1"]["status"], shown.shown["dry/1"]["check"]) == ("At speed", "")


def test_a_bus_without_any_response_is_one_entry() -> None:
    shown = screen(line())
    shown.render_aged(111.0)
    assert shown.shown["line_summary"]["verdict"] == "dry · No unit responds since 00:01"
    assert shown.shown["line_summary"]["level"] == "urgent"
    assert shown.shown["dry/1"]["status"] == "No response since 00:01"


@pytest.mark.parametrize(
    ("readings", "verdict", "german"),
    [
        (
            [{}, {}],
            "Running 120.0 m/min · all 2 at speed",
            "Läuft mit 120,0 m/min · alle 2 auf Sollwert",
        ),
        ([{"commanded": 0, "actual": 0}] * 2, "All 2 units at zero", "Alle 2 Regler auf null"),
        ([{}, {"outputs": 0x40, "actual": 900}], "1 of 2 ramping", "1 von 2 in Rampe"),
        (
            [{}, {"commanded": 0, "actual": 0}],
            "1 of 2 at speed, 1 at zero",
            "1 von 2 auf Sollwert, 1 auf null",
        ),
        (
            [{}],
            "Running 120.0 m/min · 1 unit at speed",
            "Läuft mit 120,0 m/min · 1 Regler auf Sollwert",
        ),
        ([{"commanded": 0, "actual": 0}], "1 unit at zero", "1 Regler auf null"),
    ],
)
def test_the_verdict_of_a_normal_line_is_one_text(
    readings: list[dict[str, int]], verdict: str, german: str
) -> None:
    live = line(len(readings))
    live.buses["dry"].apply([reading(unit, **changes) for unit, changes in enumerate(readings, 1)])
    for tag, text in (("en", verdict), ("de", german)):
        shown = screen(live, tag).shown["line_summary"]
        assert (shown["verdict"], shown["counts"], shown["level"]) == (text, "", "")


def test_without_units_the_verdict_reports_it() -> None:
    assert screen(line(0)).shown["line_summary"]["verdict"] == "No unit is configured"


def test_the_first_line_of_a_unit_that_is_well_is_its_state() -> None:
    assert screen(line()).shown["dry/1"]["status"] == "At speed"
    assert screen(line(), "de").shown["dry/1"]["status"] == "Auf Sollwert"


def test_a_ramp_updates_its_unit_and_not_the_line_each_second() -> None:
    live = line()
    shown = screen(live)
    live.buses["dry"].apply([reading(1, at=101.0, outputs=0x40, actual=200)])
    shown.render("dry", [1], 101.0, include_bus=False)
    live.buses["dry"].apply([reading(1, at=103.0, outputs=0x40, actual=500)])
    changed = shown.render("dry", [1], 103.0, include_bus=False)
    assert changed["dry/1"]["status"] == "Ramping to 120.0, about 4\u00a0s left"
    assert "line_summary" not in changed


@pytest.mark.parametrize(("tag", "more"), [("en", "and 2 more ·"), ("de", "und 2 weitere ·")])
def test_the_verdict_counts_the_units_that_have_its_cause_too(tag: str, more: str) -> None:
    live = line(4)
    live.buses["dry"].apply([reading(unit, at=100.0, inputs=HEALTHY) for unit in (2, 3, 4)])
    page = screen(live, tag)
    page.refresh(100.5)
    shown = page.flat()
    assert shown["line_summary.name"] == "Unit 2"
    assert str(shown["line_summary.cause"]).startswith(more)
    assert str(shown["line_summary.untimed"]).startswith(more)
    assert str(shown["line_summary.verdict"]).startswith(f"Unit 2 {more}")
