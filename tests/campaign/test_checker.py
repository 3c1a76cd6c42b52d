"""The checker of a campaign: a good record passes, and each forged one fails by its rule."""

from __future__ import annotations

import ast
import json
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.campaign.checker.__main__ import main, violations
from tests.campaign.checker.frames import Piece, Stray, WireFrame, decode
from tests.campaign.recorders import Streams

CHECKER = Path(__file__).with_name("checker")
VECTORS = Path(__file__).parents[1] / "vectors" / "frames.json"
READ, WRITE, ACK, SHOWN, READ_SCALE, SCALE = (
    bytes.fromhex(text)
    for text in (
        "10 02 01 81 10 03 7E",
        "10 02 01 84 00 00 03 E8 10 03 90",
        "10 02 01 06 10 03 F9",
        "10 02 01 06 00 00 03 E8 00 00 03 E7 80 C1 03 10 03 E0",
        "10 02 01 85 08 10 03 72",
        "10 02 01 06 00 10 03 F9",
    )
)
STATUS = [1000, 999, 128]
A, B = "10.77.0.11:40001", "10.77.0.12:40002"
Logs = dict[str, list[dict[str, Any]]]


def sent(at: float, data: bytes, peer: str = A) -> list[tuple[str, dict[str, Any]]]:
    return [
        ("connections-line", {"at": at, "peer": peer, "data": data.hex()}),
        ("wire-line", {"at": at + 0.01, "direction": "request", "data": data.hex()}),
    ]


def came(at: float, data: bytes) -> list[tuple[str, dict[str, Any]]]:
    return [("wire-line", {"at": at, "direction": "response", "data": data.hex()})]


def command(**changed: Any) -> dict[str, Any]:
    usual = {"kind": "command", "sent_at": 99.9, "responded_at": 100.7, "bus": "line", "unit": 1, "digits": 1}
    return {**usual, "typed": "100.0", "timeout_s": 2.0, "outcome": "verified", "unit_error": None, **changed}


def live(at: float, age_ms: int = 100, **changed: Any) -> dict[str, Any]:
    unit = {"id": 1, "link": "online", "age_ms": age_ms, "raw": STATUS, "texts": ["100.0", "99.9"], **changed}
    return {"kind": "live", "bus": "line", "at": at, "units": [unit]}


def keypad(number: int, raw: int, began: float = 0.0, ended: float = 0.0) -> dict[str, Any]:
    return {"kind": "keypad", "bus": "line", "unit": 1, "number": number, "raw": raw} | {
        "began": began,
        "ended": ended,
    }


def good() -> Logs:
    """A typed write, its proof and the scale after it, the death of the worker, values of the next."""
    rows = [*sent(100.0, WRITE), *came(100.1, ACK), *sent(100.2, READ), *came(100.3, SHOWN)]
    rows += [*sent(100.4, READ_SCALE), *came(100.5, SCALE), *sent(107.0, READ, B), *came(107.1, SHOWN)]
    logs: Logs = {"wire-line": [], "connections-line": [], "clients": [], "faults": [], "keypads-line": []}
    for name, row in rows:
        logs[name].append(row)
    journal = {"bus": "line", "alarm": "line/1.deviation", "occurrence": 1}
    logs["clients"] = [
        command(),
        {"kind": "acknowledged", **journal, "trigger": "acknowledge", "after": ""},
        {"kind": "transition", **journal, "trigger": "rise", "after": "unack_active"},
        live(100.4),
        live(107.2),
        live(140.0),
        {"kind": "stored", "bus": "line", "unit": 1, "value": "commanded", "numbers": [100.0]},
        {"kind": "stored", "bus": "line", "unit": 1, "value": "actual", "numbers": [99.9]},
    ]
    logs["faults"] = [{"kind": "fault", "began": 101.0, "ended": 106.0}]
    logs["keypads-line"] = [keypad(3, 1), keypad(8, 0)]
    return logs


def store(folder: Path) -> sqlite3.Connection:
    connection = sqlite3.connect(folder / "store.db", isolation_level=None)
    connection.execute("CREATE TABLE events (id, about, kind, bus, unit, new_raw, outcome)")
    connection.execute("INSERT INTO events VALUES (1, NULL, 'command', 'line', 1, 1000, NULL)")
    connection.execute("INSERT INTO events VALUES (2, 1, 'result', 'line', 1, 1000, 'verified')")
    connection.execute("CREATE TABLE alarm_journal (alarm, occurrence, trigger, after, bus)")
    for trigger, after in (("rise", "unack_active"), ("acknowledge", "ack_active")):
        row = ("line/1.deviation", 1, trigger, after, "line")
        connection.execute("INSERT INTO alarm_journal VALUES (?, ?, ?, ?, ?)", row)
    return connection


def write(folder: Path, logs: Logs) -> Path:
    for name, rows in logs.items():
        (folder / f"{name}.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    return folder


def found(folder: Path) -> list[str]:
    return list(violations(folder, str(folder / "store.db"), "line"))


def test_a_good_record_passes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    store(tmp_path)
    folder = write(tmp_path, good())
    assert found(folder) == []
    assert main(str(folder), str(folder / "store.db"), "line") == 0
    assert (
        "4 requests of 2 connections; 1 commands: 1 verified (1 typed and verified)"
        in capsys.readouterr().out
    )


def add(*rows: tuple[str, dict[str, Any]]) -> Callable[[Logs], None]:
    def forge(logs: Logs) -> None:
        for name, row in rows:
            logs[name].append(row)
            logs[name].sort(key=lambda row: row["at"])

    return forge


def changed(place: int, **values: Any) -> Callable[[Logs], None]:
    return lambda logs: logs["clients"][place].update(values)


def interleaved(logs: Logs) -> None:
    """The frame of B arrives inside a frame of A."""
    (first,) = (row for row in logs["wire-line"] if row["data"] == WRITE.hex())
    first["data"] = (WRITE[:5] + READ + WRITE[5:]).hex()


def held(*, halted: bool = True, late_s: float = 0.0) -> Callable[[Logs], None]:
    """The write is on the wire six seconds after it came to the device server, ``late_s`` later than good."""

    def forge(logs: Logs) -> None:
        for row in logs["wire-line"]:
            row["at"] = max(row["at"], 106.0)
        for row in logs["connections-line"][:2]:
            row["at"] += late_s
        logs["clients"][0]["outcome"] = None
        logs["clients"][3] = live(106.5)
        if halted:
            logs["faults"].append({"kind": "device_halt", "begin": 99.0, "end": 106.1})

    return forge


def scale(number: int, raw: int, at: float) -> Callable[[Logs], None]:
    """The parameter was changed at the keypad."""
    return lambda logs: logs["keypads-line"].append(keypad(number, raw, at, at + 0.01))


def shown(**values: Any) -> Callable[[Logs], None]:
    return lambda logs: logs["clients"][3]["units"][0].update(values)


def scale_shown_early(logs: Logs) -> None:
    scale(3, 2, 103.0)(logs)
    shown(texts=["10.00", "9.99"])(logs)


FORGED: dict[str, tuple[Callable[[Logs], None], str]] = {
    "a frame inside another": (interleaved, "bytes of no frame"),
    "the first writer comes back": (add(*sent(108.0, READ, A)), "writes after"),
    "a writer that no connection has": (
        add(("wire-line", {"at": 109.0, "direction": "request", "data": READ.hex()})),
        "no connection carried",
    ),
    "after its deadline": (changed(0, sent_at=90.0), "after its deadline"),
    "held back without a halt": (held(halted=False), "after its deadline"),
    "after its deadline, then held back": (held(late_s=5.0), "after its deadline"),
    "too often": (
        add(*(row for n in range(4) for row in sent(100.01 + n / 100, WRITE))),
        "on the wire 5 times",
    ),
    "by two": (add(*sent(107.5, WRITE, B)), "written by two connections"),
    "reported as not sent": (changed(0, outcome="not_sent"), "reported as not_sent"),
    "refused for its scale, and sent": (changed(0, outcome="refused"), "reported as refused"),
    "verified before it was shown": (changed(0, responded_at=100.2), "verified, never shown"),
    "verified without a write": (changed(0, digits=1001), "verified, never written"),
    "verified beside ten times what was typed": (scale(3, 0, 50.0), "verified, the unit displays 1000"),
    "the scale changed before it was read again": (scale(3, 2, 100.35), "verified, the unit displays 10.00"),
    "a speed that became a ratio": (scale(8, 1, 100.35), "verified, the unit displays 0.1000"),
    "another outcome than stored": (changed(0, outcome="unverified"), "not in the database"),
    "a lost acknowledgement": (changed(1, occurrence=2), "not in the database"),
    "a lost transition": (changed(2, after="rtn_unack"), "not in the database"),
    "a value without its highest bits": (shown(raw=[1000, 999, 0]), "which it had not sent"),
    "a value that is sent later": (changed(3, at=100.2), "which it had not sent"),
    "a speed in decimals that the unit never had": (shown(texts=["10.00", "9.99"]), "shown with 10.00"),
    "a speed in decimals that the unit has later": (scale_shown_early, "shown with 10.00"),
    "a stored value that no unit sent": (changed(6, numbers=[100.0, 104.0]), "stored with commanded 104.0"),
    "a stored value in another scale": (changed(7, numbers=[999.0]), "stored with actual 999.0"),
    "no value after a fault": (lambda logs: logs["clients"].pop(4), "not live 30 s after a fault"),
    "a value from before": (changed(4, **live(107.2, age_ms=3000)), "not live 30 s after a fault"),
    "a value that is not live": (changed(4, **live(107.2, link="stale")), "not live 30 s after a fault"),
}


@pytest.mark.parametrize("name", FORGED)
def test_a_forged_record_fails(tmp_path: Path, name: str) -> None:
    forge, expected = FORGED[name]
    store(tmp_path)
    logs = good()
    forge(logs)
    lines = found(write(tmp_path, logs))
    assert any(expected in line for line in lines), lines
    assert main(str(tmp_path), str(tmp_path / "store.db"), "line") == 1


def test_what_a_halted_device_server_held_back_came_in_time(tmp_path: Path) -> None:
    store(tmp_path)
    logs = good()
    held()(logs)
    assert found(write(tmp_path, logs)) == []


def test_an_event_that_the_database_lost_fails(tmp_path: Path) -> None:
    store(tmp_path).execute("DELETE FROM events WHERE about = 1")
    (line,) = found(write(tmp_path, good()))
    assert "not in the database" in line


@pytest.mark.parametrize(
    ("number", "raw", "began", "ended"),
    [(3, 2, 100.45, 100.55), (3, 2, 100.6, 100.61), (2, 200, 50.0, 50.01)],
)
def test_a_scale_that_changed_afterwards_or_meanwhile_does_not_make_it_false(
    tmp_path: Path, number: int, raw: int, began: float, ended: float
) -> None:
    store(tmp_path)
    logs = good()
    logs["keypads-line"].append(keypad(number, raw, began, ended))
    assert found(write(tmp_path, logs)) == []


def test_a_port_of_the_server_has_no_connections(tmp_path: Path) -> None:
    store(tmp_path)
    logs = good()
    del logs["connections-line"]
    add(("wire-line", {"at": 103.0, "direction": "request", "data": SHOWN[3:].hex()}))(logs)
    assert found(write(tmp_path, logs)) == []


def test_a_port_that_is_used_again_is_another_connection() -> None:
    streams = Streams()
    assert streams.take(A, 999, b"", True) == (A, b"")
    for sequence, data, new in ((1000, READ, READ), (1000, READ + ACK, ACK), (1000, READ, b"")):
        assert streams.take(A, sequence, data, False) == (A, new)
    for _ in range(2):
        assert streams.take(A, 1 << 31, b"", True) == (f"{A}#2", b"")
    assert streams.take(A, (1 << 31) + 1, READ, False) == (f"{A}#2", READ)
    assert streams.take(A, 2**32 - 1, WRITE, False) == (f"{A}#2", WRITE), "after bytes that were not seen"
    assert streams.take(A, len(WRITE) - 1, READ, False) == (f"{A}#2", READ), "past the last number"


def test_its_decoder_reads_the_frames_of_the_manual() -> None:
    vectors = [row for row in json.loads(VECTORS.read_text()) if "frame" in row]
    assert len(vectors) > 20
    for row in vectors:
        (frame,) = decode([Piece(1.0, bytes.fromhex(row["frame"]))])
        assert isinstance(frame, WireFrame)
        assert frame.body == bytes.fromhex(row["body"])


def test_its_decoder_gives_up_one_byte_after_a_failure() -> None:
    stray, frame = decode([Piece(1.0, READ[:3]), Piece(2.0, READ)])
    assert stray == Stray(1.0, READ[:3])
    assert frame == WireFrame(2.0, 2.0, b"\x01\x81")


def test_it_imports_nothing_of_the_product() -> None:
    imported = set()
    for path in CHECKER.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            imported |= {name for name in names if name.startswith(("app", "bus", "tests"))}
    assert {name.rpartition(".")[0] or name for name in imported} <= {
        "tests.campaign",
        "tests.campaign.checker",
    }
