"""``lineside scan`` against simulated lines, and ``lineside decode``."""

from __future__ import annotations

import json
import os
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import serial
from click.testing import CliRunner, Result

from app.cli import cli as command_line
from app.cli import wire as scan
from app.cli.wire import announcement, bauds_to_try, bus_table, parse_hex
from app.line.commands.trace_file import trace_line
from app.settings import Settings
from bus.catalogue import parameters as numbers
from bus.contract import Frame
from bus.errors import CallerError, WireError
from bus.line.examination import Found
from bus.line.scanner import Prober
from bus.messages import Message, term
from bus.settings import Dialect
from bus.simulator.line import FaultKind, Faults, SimulatedLine
from bus.simulator.plant import Plant, Section
from bus.simulator.ports import PtyPort
from bus.simulator.serve import LineServer
from bus.simulator.unit import Memory, Traits, Unit

PATIENCE_MS = "400"
GONE = Message.of("port_gone", port="it")
"""A unit of these tests responds at once, but on a busy machine its process may have to wait. An address
without a unit costs this at every probe, so there are few of those.
"""

cli = scan.scan


def unit(address: int, baud: int = 9600, **traits: Any) -> Unit:
    return Unit(Memory({numbers.OWN_ADDRESS: address, numbers.BAUD_RATE: baud // 100}), Traits(**traits))


@contextmanager
def line(*units: Unit, faults: Faults | None = None) -> Iterator[str]:
    sections = [Section(one, seed=number) for number, one in enumerate(units)]
    simulated = SimulatedLine(Plant(sections), faults or Faults(1))
    with LineServer(simulated, PtyPort()) as server:
        yield server.port.name


def run(port: str, *options: str) -> Result:
    return CliRunner().invoke(cli, ["--port", port, *options])


def scanned(port: str, *options: str, last: int = 3) -> dict[str, Any]:
    result = run(port, "--json", "--last", str(last), "--turnaround-ms", PATIENCE_MS, *options)
    assert result.exit_code == 0, result.output
    response: dict[str, Any] = json.loads(result.stdout)
    return response


def by_id(response: dict[str, Any]) -> dict[int, dict[str, Any]]:
    return {one["id"]: one for one in response["units"]}


def test_units_of_different_age_and_dialect() -> None:
    with line(
        unit(1),
        unit(3, last_parameter=20),
        unit(4, dialect=Dialect(parameter_numbers="bcd")),
        unit(5, dialect=Dialect(parameter_reply_bytes=4, checksum_10h="twice")),
    ) as port:
        found = by_id(scanned(port, "--baud", "9600", last=5))
    assert sorted(found) == [1, 3, 4, 5]
    assert {one["kind"] for one in found.values()} == {"digimax"}
    assert {one["baud"] for one in found.values()} == {9600}
    assert found[1]["parameters"] == list(range(1, 41))
    assert found[3]["parameters"] == list(range(1, 21))
    assert [found[address]["parameter_numbers"] for address in (1, 4)] == ["binary", "bcd"]
    assert found[4]["parameters"] == list(range(1, 41))
    assert found[5]["parameter_reply_bytes"] == [4]


def test_the_baud_rate_is_found_from_the_fastest_on() -> None:
    with line(unit(2, baud=4800)) as port:
        response = scanned(port)
    assert [tried["baud"] for tried in response["bauds"]] == [9600, 4800]
    assert by_id(response)[2]["baud"] == 4800


def test_two_units_at_one_address_garble_each_other() -> None:
    with line(unit(1), unit(2), unit(2)) as port:
        found = by_id(scanned(port, "--baud", "9600"))
    assert found[1]["kind"] == "digimax"
    assert found[2]["kind"] == "garbled"
    assert "two units" in found[2]["remarks"][0]


def test_a_device_that_is_no_digimax() -> None:
    faults = Faults(1)
    faults.set(FaultKind.WRONG_LENGTH, 1.0, unit=2)
    with line(unit(1), unit(2), faults=faults) as port:
        found = by_id(scanned(port, "--baud", "9600"))
    assert (found[1]["kind"], found[2]["kind"]) == ("digimax", "foreign")


def test_a_scan_finds_a_unit_that_responds_to_every_address() -> None:
    faults = Faults(1)
    faults.set(FaultKind.ALL_ADDRESSES, 1.0, unit=3)
    with line(unit(3), faults=faults) as port:
        response = scanned(port, "--baud", "9600", last=6)
    assert response["remarks"] == ["unit 3 responds to addresses that are not its own (5 of them)"]


def test_an_adapter_that_echoes() -> None:
    faults = Faults(1)
    faults.set(FaultKind.ECHO, 1.0)
    with line(unit(2), faults=faults) as port:
        response = scanned(port, "--baud", "9600")
    assert by_id(response)[2]["kind"] == "digimax"
    assert "half duplex" in response["remarks"][0]


def test_words_for_people() -> None:
    with line(unit(2)) as port:
        result = run(port, "--baud", "9600", "--last", "3", "--turnaround-ms", PATIENCE_MS)
    assert result.exit_code == 0
    assert result.stdout.startswith(
        "unit 2 at 9600 baud: DIGIMAX IV, parameters 1 to 40, in REMOTE, responds within"
    )
    assert "addresses 1 to 3, at 9600 baud" in result.stderr


def test_nothing_there() -> None:
    with line(unit(9)) as port:
        result = run(port, "--baud", "9600", "--last", "3", "--json")
    assert result.exit_code == 1
    assert json.loads(result.stdout)["units"] == []
    assert "no unit responded at 9600 baud" in result.stderr


def test_no_unit_is_absent_after_one_request(monkeypatch: pytest.MonkeyPatch) -> None:
    examine, probed = Prober.examine, list[int]()

    async def deaf_at_first(line: Any, address: int) -> Found | None:
        probed.append(address)
        return await examine(line, address) if probed.count(address) > 1 else None

    monkeypatch.setattr(Prober, "examine", deaf_at_first)
    with line(unit(3), unit(2)) as port:
        response = scanned(port, "--baud", "9600", last=4)
    assert [one["id"] for one in response["units"]] == [2, 3]
    assert probed == [1, 2, 3, 4, 1, 2, 3, 4, 1, 4], "a second pass, as the first found a unit"


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [(KeyboardInterrupt(), 130, "interrupted"), (WireError(GONE), 1, "it was disconnected")],
)
def test_units_found_before_an_early_end_are_printed(
    monkeypatch: pytest.MonkeyPatch, error: BaseException, code: int, words: str
) -> None:
    examine = Prober.examine

    async def ended(line: Any, address: int) -> Found | None:
        if address == 4:
            raise error
        return await examine(line, address)

    monkeypatch.setattr(Prober, "examine", ended)
    with line(unit(2), unit(5)) as port:
        result = run(port, "--json", "--baud", "9600", "--last", "6", "--turnaround-ms", PATIENCE_MS)
    assert result.exit_code == code
    response = json.loads(result.stdout)
    assert [one["id"] for one in response["units"]] == [2]
    assert response["complete"] is False
    assert words in result.stderr
    assert "the scan is not complete" in result.stderr


def test_a_line_with_unrequested_bytes_is_not_scanned() -> None:
    faults = Faults(1)
    faults.set(FaultKind.FLOOD, 1.0)
    with line(unit(2), faults=faults) as port:
        result = run(port, "--baud", "9600", "--last", "3")
    assert result.exit_code == 1
    assert "without a request" in result.stderr


def test_toml_is_a_part_of_a_configuration() -> None:
    with line(unit(2)) as port:
        result = run(port, "--toml", "--baud", "9600", "--last", "3", "--turnaround-ms", PATIENCE_MS)
        refused = run(port, "--toml", "--json")
    assert (result.exit_code, refused.exit_code) == (0, 2)
    assert result.stdout.startswith("[[bus]]\n")
    [bus] = tomllib.loads(result.stdout)["bus"]
    assert (bus["port"], bus["baud"], [each["id"] for each in bus["unit"]]) == (port, 9600, [2])


def test_a_port_that_is_not_there_or_no_serial_port() -> None:
    result = run("/dev/no-such-port")
    assert result.exit_code == 1
    assert "lineside: /dev/no-such-port does not exist" in result.stderr
    assert run(os.devnull).exit_code == 1


def test_a_port_that_another_program_holds() -> None:
    with line(unit(2)) as port, serial.Serial(port, exclusive=True):
        result = run(port, "--baud", "9600")
    assert result.exit_code == 1
    assert "is in use" in result.stderr


def test_wrong_use() -> None:
    for port in ("nonsense://x:1", "socket://x", ""):
        result = run(port)
        assert (result.exit_code, "--port" in result.stderr) == (2, True)
    for options in (["--baud", "19200"], ["--first", "7", "--last", "3"], ["--last", "256"]):
        assert run("/dev/no-such-port", *options).exit_code == 2


def test_a_device_server_keeps_its_own_baud_rate() -> None:
    assert bauds_to_try("socket://10.0.0.1:4001", None) == (9600,)
    assert bauds_to_try("socket://10.0.0.1:4001", 300) == (300,)
    assert bauds_to_try("/dev/ttyUSB0", None) == (9600, 4800, 2400, 1200, 600, 300)


def test_it_prints_beforehand_how_long_it_takes() -> None:
    every = range(1, 256)
    assert "at 9600 baud: about 35 s;" in str(announcement("P", (9600,), every, 0.05, False))
    six = str(announcement("P", (9600, 4800, 2400, 1200, 600, 300), every, 0.05, False))
    assert "9600 baud, about 35 s, then the slower ones until a unit responds: 7 min 31 s at most" in six
    assert "all six baud rates: about 7 min 31 s" in str(
        announcement("P", (9600, 4800, 2400, 1200, 600, 300), every, 0.05, True)
    )
    assert "address 7, at 300 baud: about 1 s" in str(announcement("P", (300,), range(7, 8), 0.05, False))


MANUAL = "10 02 04 82 00 00 02 10 10 10 03 68"
JSON_OF_MANUAL = [{"uid": 4, "kind": "set_speed", "fields": {"raw": 528}, "checksum_ok": True}]


def decoded(arguments: list[str], **given: str) -> Result:
    return CliRunner().invoke(command_line, ["decode", *arguments], **given)


def test_hex_in_many_spellings() -> None:
    for text in (
        MANUAL.replace(" ", ""),
        MANUAL.lower(),
        "0x" + MANUAL.replace(" ", ""),
        "0x" + MANUAL.replace(" ", ", 0x"),
        MANUAL.replace(" ", "\n"),
        "[" + MANUAL.replace(" ", "][") + "]",
        "0X10,0X02;04:82-0000-0210-1010-0368".replace("-", " "),
    ):
        assert parse_hex(text) == bytes.fromhex(MANUAL)
    for bad in ("xyz", "1", "10 0", "10 02 0g"):
        with pytest.raises(CallerError, match="is not hex"):
            parse_hex(bad)


def test_words_and_the_same_for_programs_as_arguments_and_on_standard_input() -> None:
    result = decoded([MANUAL])
    assert result.stdout == f"{MANUAL}\n    unit 4: set speed (staged) 528\n"
    for result in (decoded(["--json", *MANUAL.split()]), decoded(["--json", "-"], input=MANUAL + "\n")):
        assert json.loads(result.stdout) == JSON_OF_MANUAL


def test_nothing_given_or_no_hex_is_wrong_use(tmp_path: Path) -> None:
    assert decoded([]).exit_code == 2
    assert decoded(["-"], input="").exit_code == 2
    assert decoded(["10", "--file", str(tmp_path / "none")]).exit_code == 2
    result = decoded(["10 02 0g"])
    assert (result.exit_code, result.stderr.count("\n")) == (2, 1)


def test_no_valid_frame() -> None:
    for data in ("10 02 04 82 00 00 02 10 10 10 03 67", "00 11 22"):
        result = decoded(["--json", data])
        assert result.exit_code == 1
        assert not any(frame["checksum_ok"] for frame in json.loads(result.stdout))
        assert "no valid frame" in result.stderr


def test_a_bad_frame_beside_a_good_one() -> None:
    result = decoded(["--json", "10 02 04 06 10 03 00", MANUAL])
    assert result.exit_code == 0
    assert [frame["checksum_ok"] for frame in json.loads(result.stdout)] == [False, True]


def test_a_trace_file_with_its_directions_apart(tmp_path: Path) -> None:
    """The response overlaps the next request, as it may on four wires; each direction is decoded
    separately.
    """
    request, response = bytes.fromhex("10 02 01 85 06 10 03 74"), bytes.fromhex("10 02 01 06 00 32 10 03 C7")
    frames = [
        Frame(1.0, "out", request, [term("unit 1: read parameter #6")]),
        Frame(1.01, "in", response[:4], [term("the first half")]),
        Frame(1.02, "in", response[4:], [term("the second half")]),
    ]
    trace = tmp_path / "trace.txt"
    trace.write_text("".join(trace_line(frame) + "\n" for frame in frames))
    result = decoded(["--json", "--file", str(trace)])
    assert result.exit_code == 0, result.output
    assert [(frame["kind"], frame["fields"].get("raw")) for frame in json.loads(result.stdout)] == [
        ("read_parameter", None),
        ("parameter_value", 50),
    ]


def test_a_spoilt_trace_names_the_line(tmp_path: Path) -> None:
    trace = tmp_path / "trace.txt"
    trace.write_text(trace_line(Frame(1.0, "out", b"\x10", [term("x")])) + "\nnot a line\n")
    result = decoded(["--file", str(trace)])
    assert result.exit_code == 2
    assert "not a line of a trace" in result.stderr


def test_a_file_of_hex_and_one_that_is_not_there(tmp_path: Path) -> None:
    (tmp_path / "bytes.txt").write_text(MANUAL)
    assert decoded(["--file", str(tmp_path / "bytes.txt")]).exit_code == 0
    result = decoded(["--file", str(tmp_path / "none")])
    assert (result.exit_code, "none" in result.stderr) == (1, True)


def found(unit: int, baud: int = 9600, kind: str = "digimax", **more: object) -> Found:
    return Found(unit, baud, kind, **more)  # type: ignore[arg-type]


def test_it_is_a_bus_of_a_configuration_with_what_the_units_want() -> None:
    text = bus_table('/dev/a "b"', [found(7, checksum_10h="twice", estop_healthy=0), found(12)], 62)
    [bus] = Settings.model_validate(tomllib.loads(text)).bus
    assert (bus.port, bus.baud, bus.turnaround_ms) == ('/dev/a "b"', 9600, 62)
    assert (bus.checksum_10h, bus.estop_healthy) == ("twice", 0)
    assert [(unit.id, unit.name) for unit in bus.unit] == [(7, "Unit 7"), (12, "Unit 12")]


def test_units_of_another_baud_and_other_devices_are_named_beside_it() -> None:
    text = bus_table("/dev/a", [found(1, 4800), found(2), found(3), found(9, kind="foreign")], 50)
    [bus] = Settings.model_validate(tomllib.loads(text)).bus
    assert (bus.baud, [unit.id for unit in bus.unit]) == (9600, [2, 3])
    assert "# Address 1 at 4800 baud: digimax." in text
    assert "# Address 9 at 9600 baud: foreign." in text
