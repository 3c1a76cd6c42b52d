"""Faults of a lineside.toml are reported with the line and what would be right."""

from __future__ import annotations

from pathlib import Path

import pytest

from bus.configuration import ConfigurationError, LineNumbers, load_bus

GOOD = """\
[site]
anything = "the worker does not judge the dashboard's part"

[[bus]]
name = "wet-end"
port = "/dev/ttyUSB0"

[[bus]]
name = "dry-end"
port = "socket://10.0.0.7:4001"
baud = 4800

[[bus.unit]]
id = 1
name = "Unwind"
[bus.unit.labels]
output.1 = "Brake release"
analog = "Web tension"

[[bus.unit]]
id = 16
name = "Rewind"
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "lineside.toml"
    path.write_text(text, encoding="utf-8")
    return path


def fault(folder: Path, text: str) -> str:
    path = write(folder, text)
    with pytest.raises(ConfigurationError) as caught:
        load_bus(path, "dry-end")
    return str(caught.value).replace(str(path), "FILE")


def test_a_worker_reads_its_own_bus(tmp_path: Path) -> None:
    bus = load_bus(write(tmp_path, GOOD), "dry-end")
    assert (bus.baud, [unit.id for unit in bus.unit]) == (4800, [1, 16])
    assert bus.unit[0].labels.output == {1: "Brake release"}


def test_an_unknown_bus_is_reported_with_the_configured_ones(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"no \[\[bus\]\] named 'mid'; it has wet-end, dry-end"):
        load_bus(write(tmp_path, GOOD), "mid")


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"nix\.toml: there is no such file; name one with --config"):
        load_bus(tmp_path / "nix.toml", "dry-end")


def test_a_file_that_is_not_text(tmp_path: Path) -> None:
    path = tmp_path / "lineside.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigurationError, match="not UTF-8 text"):
        load_bus(path, "dry-end")


@pytest.mark.parametrize("value", ["9" * 5000, "[" * 5000])
def test_a_value_beyond_what_the_parser_takes(tmp_path: Path, value: str) -> None:
    path = tmp_path / "lineside.toml"
    path.write_text(f"a = {value}")
    with pytest.raises(ConfigurationError, match="too many digits"):
        load_bus(path, "dry-end")


@pytest.mark.parametrize(
    ("line", "written", "fault_text"),
    [
        (11, "baud = 4801", "bus.baud = 4801: it must be one of 300, 600, 1200, 2400, 4800, 9600"),
        (11, "buad = 4800", "unknown key buad in [[bus]]; did you mean baud?"),
        (11, "zzz = 1", "unknown key zzz in [[bus]]; known here: checksum_10h, "),
        (11, "max_scan_hz = 0", "bus.max_scan_hz = 0: it must be at least 0.1"),
        (11, "max_scan_hz = true", "bus.max_scan_hz = True: it must be a finite number"),
        (11, "turnaround_ms = -1", "bus.turnaround_ms = -1: it must be at least 0"),
        (9, 'name = "Dry End"', "bus.name = 'Dry End': write small letters, digits and hyphens"),
        (10, 'port = "tcp://x"', "bus.port = 'tcp://x': write a device path, socket://host:port or"),
        (14, "id = 300", "bus.unit.id = 300: it must be at most 255"),
        (14, 'id = "one"', "bus.unit.id = 'one': it must be an integer"),
        (15, "nmae = 3", "unknown key nmae in [[bus.unit]]; did you mean name?"),
        (17, 'output.7 = "x"', "bus.unit.labels.output.7 = '7': it must be at most 6"),
        (17, 'outputs.1 = "x"', "unknown key outputs in [bus.unit.labels]; did you mean output?"),
        (21, "id = 1", "unit id 1 is given twice; every unit on a bus has its own (parameter 17)"),
    ],
)
def test_each_fault_names_its_line(tmp_path: Path, line: int, written: str, fault_text: str) -> None:
    lines = GOOD.splitlines()
    lines[line - 1] = written
    assert f"FILE:{line}: {fault_text}" in fault(tmp_path, "\n".join(lines))


@pytest.mark.parametrize(
    ("port", "right"),
    [
        ("COM3", "a port of Windows; write a device path, such as one in /dev/serial/by-id/ or /dev/ttyUSB0"),
        ("10.0.0.5:4001", "write socket://10.0.0.5:4001, or rfc2217://"),
        ("[fe80::1]:4001", "write socket://[fe80::1]:4001"),
        ("socket:10.0.0.5:4001", "write socket://10.0.0.5:4001"),
        ("/dev/ttyUSB*", "a pattern may name several devices; write the path of one"),
        ("ttyUSB0", "a device path begins with /, like /dev/ttyUSB0"),
        ("/dev/serial/by-id/", "this is a folder"),
        ("/dev/ttyUSB0:9600", "write /dev/ttyUSB0 and, as a key of its own, baud = 9600"),
        ("socket://10.0.0.5:4001/raw", "write host and port number"),
    ],
)
def test_a_port_that_can_be_none_is_refused_with_what_would_be_right(
    tmp_path: Path, port: str, right: str
) -> None:
    assert right in fault(tmp_path, GOOD.replace("socket://10.0.0.7:4001", port))


@pytest.mark.parametrize(
    "port",
    [
        "socket://moxa_1:4001",
        "rfc2217://[fe80::1]:4001",
        "/dev/serial/by-path/pci-0000:00:14.0-usb-0:1:1.0-port0",
        "/dev/pts/3",
    ],
)
def test_a_port_that_can_be_one(tmp_path: Path, port: str) -> None:
    path = write(tmp_path, GOOD.replace("socket://10.0.0.7:4001", port))
    assert load_bus(path, "dry-end").port == port


@pytest.mark.parametrize(
    ("written", "right"),
    [
        ('turnaround_ms = "12,5"', "bus.turnaround_ms = '12,5': write it with a decimal point: 12.5"),
        ("turnaround_ms = 12,5", "FILE:11: the line is turnaround_ms = 12,5; write it with a decimal point:"),
    ],
)
def test_a_decimal_comma_is_answered_with_the_decimal_point(tmp_path: Path, written: str, right: str) -> None:
    assert right in fault(tmp_path, GOOD.replace("baud = 4800", written))


def test_a_missing_key_is_reported_at_its_place(tmp_path: Path) -> None:
    assert "FILE:13: [[bus.unit]] needs name = …" in fault(tmp_path, GOOD.replace('name = "Unwind"\n', ""))


def test_every_fault_is_reported_at_once(tmp_path: Path) -> None:
    text = GOOD.replace("4800", "1").replace("id = 16", "id = 0")
    assert len(fault(tmp_path, text).splitlines()) == 2


@pytest.mark.parametrize(
    ("text", "fault_text"),
    [
        ("[site]\nname = Mill\n", "FILE:2: this is not TOML: Invalid value; the line is 'name = Mill'"),
        ("[site\n", "FILE:1: this is not TOML: Expected ']'"),
        ('a = """\nnever closed\n', "FILE:2: this is not TOML"),
        ("", "there is no [[bus]] named 'dry-end'; it has none"),
    ],
)
def test_a_fault_of_the_writing_itself(tmp_path: Path, text: str, fault_text: str) -> None:
    assert fault_text in fault(tmp_path, text)


def test_lines_are_found_in_arrays_dotted_keys_and_long_values() -> None:
    lines = LineNumbers(
        'a.b = 1\nlist = [\n  1,\n  2,\n]\n[[x]]\n[[x.y]]\n[[x.y]]\nk = 1\n[[x]]\n[x."q r"]\nz = 3\n'
    )
    assert lines.line_of(("a", "b")) == 1
    assert lines.line_of(("list", 1)) == 2
    assert lines.line_of(("x", 0, "y", 1, "k")) == 9
    assert lines.line_of(("x", 1, "q r", "z")) == 12
    assert lines.line_of(("x", 1, "y", 5)) == 10
    assert lines.line_of(("nowhere",)) == 1


@pytest.mark.parametrize(
    ("good", "bad", "right"),
    [
        ("id = 16", "id = true", "must be an integer"),
        ("id = 16", 'id = "16"', "must be an integer"),
        ("id = 16", 'id = 16\ngroup = "a\\u0000"', "character 2 is a control character (U+0000)"),
        ("socket://10.0.0.7:4001", "socket://10.0.0.7", "host and port number"),
        ("socket://10.0.0.7:4001", "rfc2217://:4001", "host and port number"),
        ("socket://10.0.0.7:4001", "socket://10.0.0.7:0", "host and port number"),
        (
            "socket://10.0.0.7:4001",
            "rfc2217://ann:pw@10.0.0.7:1",
            "port = 'rfc2217://…@10.0.0.7:1': leave user",
        ),
    ],
)
def test_a_value_is_not_bent_into_what_was_meant(tmp_path: Path, good: str, bad: str, right: str) -> None:
    assert right in fault(tmp_path, GOOD.replace(good, bad))
