"""``lineside decode``: what it takes, what it prints, how it ends."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from app.cli import cli
from app.cli.wire import parse_hex
from app.line.commands.api.trace_file import trace_line
from bus.contract import Frame
from bus.errors import CallerError
from bus.messages import term

MANUAL = "10 02 04 82 00 00 02 10 10 10 03 68"
JSON_OF_MANUAL = [{"uid": 4, "kind": "set_speed", "fields": {"raw": 528}, "checksum_ok": True}]


def run(arguments: list[str], **given: str) -> Result:
    return CliRunner().invoke(cli, ["decode", *arguments], **given)


@pytest.mark.parametrize(
    "arguments",
    [
        [MANUAL],
        MANUAL.split(),
        [MANUAL.replace(" ", "")],
        [MANUAL.lower()],
        ["0x" + MANUAL.replace(" ", "")],
        ["0x" + MANUAL.replace(" ", ", 0x")],
        [MANUAL.replace(" ", "\n")],
        ["[" + MANUAL.replace(" ", "][") + "]"],
        ["0X10,0X02;04:82-0000-0210-1010-0368".replace("-", " ")],
    ],
)
def test_hex_in_many_spellings(arguments: list[str]) -> None:
    result = run(["--json", *arguments])
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout) == JSON_OF_MANUAL


def test_words() -> None:
    result = run([MANUAL])
    assert result.stdout == f"{MANUAL}\n    unit 4: set speed (staged) 528\n"


def test_standard_input() -> None:
    result = run(["--json", "-"], input=MANUAL + "\n")
    assert json.loads(result.stdout) == JSON_OF_MANUAL


@pytest.mark.parametrize("bad", ["xyz", "1", "10 0", "10 02 0g"])
def test_bad_hex_is_wrong_use(bad: str) -> None:
    result = run([bad])
    assert result.exit_code == 2
    assert result.stderr.count("\n") == 1
    assert "is not hex" in result.stderr


def test_nothing_given_is_wrong_use() -> None:
    assert run([]).exit_code == 2
    assert run(["-"], input="").exit_code == 2
    with pytest.raises(CallerError, match="no bytes given"):
        parse_hex("  ")


@pytest.mark.parametrize("data", ["10 02 04 82 00 00 02 10 10 10 03 67", "00 11 22", "10 02"])
def test_no_valid_frame(data: str) -> None:
    result = run(["--json", data])
    assert result.exit_code == 1
    assert not any(frame["checksum_ok"] for frame in json.loads(result.stdout))
    assert "no valid frame" in result.stderr


def test_a_bad_frame_beside_a_good_one() -> None:
    result = run(["--json", "10 02 04 06 10 03 00", MANUAL])
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
    result = run(["--json", "--file", str(trace)])
    assert result.exit_code == 0, result.output
    assert [(frame["kind"], frame["fields"].get("raw")) for frame in json.loads(result.stdout)] == [
        ("read_parameter", None),
        ("parameter_value", 50),
    ]


def test_a_spoilt_trace_names_the_line(tmp_path: Path) -> None:
    trace = tmp_path / "trace.txt"
    trace.write_text(trace_line(Frame(1.0, "out", b"\x10", [term("x")])) + "\nnot a line\n")
    result = run(["--file", str(trace)])
    assert result.exit_code == 2
    assert "not a line of a trace" in result.stderr


def test_a_file_of_hex(tmp_path: Path) -> None:
    (tmp_path / "bytes.txt").write_text(MANUAL)
    assert run(["--file", str(tmp_path / "bytes.txt")]).exit_code == 0


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    result = run(["--file", str(tmp_path / "none")])
    assert result.exit_code == 1
    assert "none" in result.stderr


def test_bytes_and_a_file_are_too_much(tmp_path: Path) -> None:
    assert run(["10", "--file", str(tmp_path / "none")]).exit_code == 2
