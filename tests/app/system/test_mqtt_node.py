"""A bus as a Sparkplug edge node, judged by a host that was written from the specification alone."""

from __future__ import annotations

import struct
from contextlib import suppress
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from app.line.live.bus_live import Audience, BusLive, LiveState, unit_link_now
from app.system.mqtt.node import EdgeNode
from app.system.mqtt.payload import DataType, Metric, PayloadError, commands_in, encode_birth, encode_payload
from app.system.mqtt.settings import Deadbands, identifier_of
from app.system.tags import unique_names
from bus.contract import BusLink, ParameterValue, Reading, UnitLink, Update
from bus.instants import UnixTime
from bus.settings import BusSettings, UnitSettings
from tests.app.sparkplug import Host, decoded

LABELS: Any = {
    "unit": "m/min",
    "analog_unit": "N",
    "output": {1: "Brake", 2: "BRAKE", 3: "Air / oil"},
    "input": {"up": "Run"},
}
BEGIN = UnixTime(1_700_000_000.0)
HEALTHY, DRIVEN = 0b10, 0b11


def bus_live(names: tuple[str, ...] = ("Unwind", "Nip + 1", "NIP - 1")) -> BusLive:
    units = tuple(UnitSettings(id=n, name=name, labels=LABELS) for n, name in enumerate(names, 1))
    bus = LiveState([BusSettings(name="dry-end", port="/dev/null", unit=units)], BEGIN).buses["dry-end"]
    bus.worker_lost = None
    bus.apply([BusLink(BEGIN, "open")])
    return bus


def responds(unit: int, at: UnixTime, actual: int = 1234, inputs: int = DRIVEN) -> list[Update]:
    return [UnitLink(unit, at, "online"), Reading(unit, at, 1200, actual, 51, 0xC0, inputs)]


def scales(unit: int, at: UnixTime, decimals: int = 1) -> list[Update]:
    raw = {2: 20_000, 3: decimals, 8: 0, 22: 0, 23: 510}
    return [ParameterValue(unit, number, at, value) for number, value in raw.items()]


def command(name: str, value: bool = True) -> bytes:
    metric = Metric(name, DataType.BOOLEAN)
    return encode_payload(0, [encode_birth(metric, 0, value)], None)


class Line:
    """An edge node and a host that follows it."""

    def __init__(self, deadbands: Deadbands | None = None) -> None:
        self.now = BEGIN
        self.bus = bus_live()
        self.alarms: dict[int, int] = {}
        self.node = EdgeNode(
            self.bus, "Mill 7", lambda unit: self.alarms.get(unit, 0), deadbands or Deadbands()
        )
        self.host = Host("dry-end", "Mill 7")
        self.bus.subscribe(Audience.STREAM, self.node.note)

    def take(self, publications: Any) -> None:
        for topic, payload in publications:
            self.host.take(topic, payload)

    def begin(self, bd_seq: int = 0) -> None:
        self.take(self.node.begin(bd_seq, self.now))

    def flush(self) -> None:
        self.take(self.node.changes(self.now))

    def command(self, topic: str, payload: bytes) -> None:
        self.take(self.node.take_command(topic, payload, self.now))


@pytest.fixture
def line() -> Line:
    return Line()


def test_a_birth_has_names_units_ranges_and_values(line: Line) -> None:
    line.bus.apply([*scales(1, BEGIN), *responds(1, BEGIN)])
    line.begin(7)
    assert line.host.faults == []
    assert line.host.bd_seq == 7
    assert list(line.host.values) == ["Unwind"], "a unit that has not responded is not born"
    values = line.host.values["Unwind"]
    assert (values["Speed/Actual"], values["Speed/Commanded"], values["Analog"]) == (123.4, 120.0, 102.0)
    assert (values["At speed"], values["Remote"], values["Link/State"]) == (True, True, "online")
    assert values["Inputs/Emergency stop"] is False
    assert values["Alarms/Active"] == 0
    assert (values["Parameters/02"], values["Parameters/01"]) == (20_000, None)
    assert "Parameters/21" not in values, "the password of the keypad"
    assert {
        "Outputs/Brake",
        "Outputs/BRAKE (output 2)",
        "Outputs/Air - oil",
        "Outputs/Output 4",
    } < values.keys()
    assert {"Inputs/Run", "Inputs/Run (up)"} < values.keys()
    about = line.host.properties["Unwind", "Speed/Actual"]
    assert about == {"engUnit": "m/min", "engLow": 0.0, "engHigh": 2000.0, "decimals": 1}
    assert line.host.properties["Unwind", "Parameters/03"]["documentation"]


def test_names_that_differ_in_case_only_get_their_number() -> None:
    names = [(1, "Nip"), (2, "NIP"), (3, "Nip 2")]
    assert unique_names(names) == {1: "Nip (1)", 2: "NIP (2)", 3: "Nip 2"}
    assert identifier_of("Paper + coat/2 #") == "Paper - coat-2 -"
    assert identifier_of("Mill / 7 +# north") == "Mill - 7 -- north"
    assert [device.name for device in Line().node.devices.values()] == [
        "Unwind",
        "Nip - 1 (2)",
        "NIP - 1 (3)",
    ]


def test_only_what_differs_is_sent_with_the_time_of_its_reading(line: Line) -> None:
    line.bus.apply([*scales(1, BEGIN), *responds(1, BEGIN)])
    line.begin()
    assert line.node.changes(BEGIN) == []
    line.now += 1
    line.bus.apply([*responds(1, BEGIN + 0.5), *responds(1, BEGIN + 0.75, 1240)])
    (publication,) = line.node.changes(line.now)
    line.host.take(*publication)
    (metric,) = decoded(publication.payload)["metrics"]
    assert (metric["value"], metric["timestamp"]) == (124.0, round(float(BEGIN + 0.75) * 1000))
    assert line.host.faults == []


def test_a_reading_is_sent_once_though_it_is_older_than_what_was_sent(line: Line) -> None:
    line.bus.apply([*scales(1, BEGIN), *responds(1, BEGIN)])
    line.begin()
    line.node.note([Reading(1, BEGIN - 5, 1200, 99, 51, 0xC0, DRIVEN)])
    assert line.node.changes(BEGIN) == []


def test_within_its_deadband_a_value_is_not_sent() -> None:
    line = Line(Deadbands(actual="0.5"))  # type: ignore[arg-type]
    line.bus.apply([*scales(1, BEGIN), *responds(1, BEGIN, 1200)])
    line.begin()
    for step, actual in enumerate((1204, 1196, 1205, 1204), 1):
        line.bus.apply(responds(1, BEGIN + step / 10, actual))
        line.flush()
    sent = [value for _, value, _ in line.host.readings["Unwind", "Speed/Actual"]]
    assert sent == [120.0, 120.5]


def test_a_new_scale_is_a_new_birth(line: Line) -> None:
    line.bus.apply([*scales(1, BEGIN), *responds(1, BEGIN)])
    line.begin()
    line.bus.apply([*scales(1, BEGIN + 1, decimals=2), *responds(1, BEGIN + 1)])
    line.now += 1
    line.flush()
    assert line.host.faults == []
    assert line.host.properties["Unwind", "Speed/Actual"]["decimals"] == 2
    assert line.host.values["Unwind"]["Speed/Actual"] == 12.34


def test_a_value_whose_scale_is_not_known_is_null(line: Line) -> None:
    line.bus.apply(responds(1, BEGIN))
    line.begin()
    assert line.host.values["Unwind"]["Speed/Actual"] is None
    assert line.host.values["Unwind"]["Remote"] is True
    assert line.host.faults == []


def test_rebirth_is_done_at_most_every_five_seconds_and_nothing_else_is(line: Line) -> None:
    line.bus.apply([*scales(1, BEGIN), *responds(1, BEGIN)])
    line.begin()
    node = "spBv1.0/Mill 7/NCMD/dry-end"
    for step in range(12):
        line.now = BEGIN + 100 + step
        line.command(node, command("Node Control/Rebirth"))
    assert line.host.births == 4, "at 100, 105 and 110 s"
    assert line.node.refused == 0
    refused = [
        (node, command("Node Control/Rebirth", value=False)),
        (node, command("Node Control/Reboot")),
        (node, command("Node Control/Rebirth") + command("Speed/Commanded")),
        (node, b""),
        (node, b"\x12\xff\xff\xff\xff\x0fx"),
        ("spBv1.0/Mill 7/DCMD/dry-end/Unwind", command("Node Control/Rebirth")),
        ("spBv1.0/Mill 7/DCMD/dry-end/Unwind", command("Speed/Commanded")),
    ]
    line.now += 100
    for topic, payload in refused:
        line.command(topic, payload)
    assert line.node.refused == len(refused)
    assert line.host.births == 4
    assert line.host.faults == []


def test_the_past_is_marked_and_only_of_units_that_are_born(line: Line) -> None:
    line.bus.apply([*scales(1, BEGIN), *responds(1, BEGIN)])
    line.begin()
    inputs = ("run", "estop", "preset", "reverse", "up", "down", "slave")
    outputs = (f"output_{number}" for number in range(1, 7))
    bits = dict.fromkeys((*inputs, *outputs, "remote", "at_speed"), False)
    rows = [
        (BEGIN - 10.0 + step, {"actual": value, "commanded": 120.0, "analog": 1.0, **bits})
        for step, value in enumerate((118.0, 118.0, 119.5))
    ]
    line.take(line.node.historical(1, rows, BEGIN))
    assert line.host.faults == []
    past = [(at, value) for at, value, old in line.host.readings["Unwind", "Speed/Actual"] if old]
    assert past == [(round(float(BEGIN - 10.0) * 1000), 118.0), (round(float(BEGIN - 8.0) * 1000), 119.5)]
    assert line.host.values["Unwind"]["Speed/Actual"] == 123.4, "the past changes nothing of the present"
    assert line.node.historical(2, rows, BEGIN) == []


@given(st.binary(max_size=200))
def test_a_command_of_any_bytes_is_read_or_refused(payload: bytes) -> None:
    with suppress(PayloadError):
        assert isinstance(commands_in(payload), list)


@given(st.integers(0, 2**63 - 1), st.floats(allow_nan=False), st.text(max_size=50), st.booleans())
def test_payloads_are_read_by_another_decoder(alias: int, number: float, text: str, bit: bool) -> None:
    values: list[tuple[DataType, Any]] = [
        (DataType.DOUBLE, number),
        (DataType.STRING, text),
        (DataType.BOOLEAN, bit),
        (DataType.INT64, -alias),
        (DataType.INT32, -5),
        (DataType.DOUBLE, None),
    ]
    known: dict[str, Any] = {"a": text, "b": number, "c": bit, "d": -3}
    metrics = [encode_birth(Metric(text, kind, alias, known), 5, value) for kind, value in values]
    found = decoded(encode_payload(alias, metrics, 255))
    assert (found["timestamp"], found["seq"]) == (alias, 255)
    signed = [
        value if value is None or kind not in (DataType.INT32, DataType.INT64) else wrapped(kind, value)
        for kind, value in values
    ]
    assert [each["value"] for each in found["metrics"]] == signed
    assert {each["alias"] for each in found["metrics"]} == {alias}
    for each in found["metrics"]:
        assert each["properties"] == {**known, "d": wrapped(DataType.INT32, -3)}


def wrapped(kind: DataType, value: int) -> int:
    """Return a negative integer as the unsigned one that is sent."""
    small, large = ("<i", "<I") if kind == DataType.INT32 else ("<q", "<Q")
    found: int = struct.unpack(large, struct.pack(small, value))[0]
    return found


class NodeMachine(RuleBasedStateMachine):
    """State machine: whatever happens on the line, the host knows the same of it as the server after each
    message."""

    @initialize()
    def begin(self) -> None:
        self.line = Line()
        self.line.begin()
        self.bd_seq = 0

    @rule(unit=st.integers(1, 3), actual=st.integers(0, 2000), inputs=st.sampled_from((HEALTHY, DRIVEN, 0)))
    def read(self, unit: int, actual: int, inputs: int) -> None:
        self.line.now += 0.1
        self.line.bus.apply(responds(unit, self.line.now, actual, inputs))

    @rule(unit=st.integers(1, 3), decimals=st.integers(0, 4))
    def read_scale(self, unit: int, decimals: int) -> None:
        self.line.bus.apply(scales(unit, self.line.now, decimals))

    @rule(seconds=st.sampled_from((0.5, 3.0, 15.0)))
    def wait(self, seconds: float) -> None:
        self.line.now += seconds

    @rule(unit=st.integers(1, 3), count=st.integers(0, 3))
    def alarm(self, unit: int, count: int) -> None:
        self.line.alarms[unit] = count
        self.line.node.note_unit(unit)

    @rule()
    def lose_port(self) -> None:
        self.line.bus.apply([BusLink(self.line.now, "closed")])

    @rule()
    def open_port(self) -> None:
        self.line.bus.apply([BusLink(self.line.now, "open")])

    @rule()
    def rebirth(self) -> None:
        self.line.command("spBv1.0/Mill 7/NCMD/dry-end", command("Node Control/Rebirth"))

    @rule()
    def reconnect(self) -> None:
        self.line.host.take(*self.line.node.death(self.bd_seq, self.line.now))
        self.line.node.end()
        self.bd_seq = (self.bd_seq + 1) % 256
        self.line.begin(self.bd_seq)

    @invariant()
    def host_knows_the_line(self) -> None:
        line = self.line
        line.flush()
        assert line.host.faults == []
        now = line.now
        alive = {
            line.node.devices[number].name: unit
            for number, unit in line.bus.units.items()
            if unit_link_now(line.bus, unit, now) == "online"
        }
        assert line.host.values.keys() == alive.keys()
        for name, unit in alive.items():
            reading, decimals = unit.reading, unit.parameter_raw(3)
            assert reading is not None
            assert reading.actual is not None
            expected = None if decimals is None else reading.actual / 10**decimals
            shown = line.host.values[name]
            assert shown["Speed/Actual"] == expected
            assert shown["Inputs/Emergency stop"] is not bool(reading.inputs & HEALTHY)
            assert shown["Alarms/Active"] == line.alarms.get(unit.settings.id, 0)
            assert shown["Parameters/03"] == decimals


TestNodeMachine = NodeMachine.TestCase
TestNodeMachine.settings = settings(max_examples=25, stateful_step_count=25, deadline=None)
