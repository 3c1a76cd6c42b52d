"""The complete worker on a virtual clock: ids, deadlines, figures, snapshot, trace, leaving."""

from __future__ import annotations

import asyncio
import json
import os
import sys
from pathlib import Path

import pytest
from msgspec.structs import replace

from bus.contract import (
    BusFigures,
    Frames,
    ReadParameters,
    ReadTrace,
    Result,
    SetSpeed,
    Watch,
    encode,
)
from bus.line.diagnosis import UnitSymptoms, diagnose, responds_for_all
from bus.messages import Message
from bus.simulator.line import FaultKind
from tests import fork_server
from tests.bus.virtual_line import EPOCH, VirtualLine, played

ROOT = Path(__file__).parents[2]


async def settled(line: VirtualLine) -> None:
    await line.until(lambda: all(line.readings(unit) for unit in line.units))
    await asyncio.sleep(1.2)


@played(2)
async def test_a_snapshot_has_everything_that_is_known(line: VirtualLine) -> None:
    await settled(line)
    await line.perform(SetSpeed(2, 333, execute=False))
    await asyncio.sleep(1.0)
    snapshot = line.worker.snapshot(17)
    assert (snapshot.seq, snapshot.bus.link) == (17, "open")
    assert [state.unit for state in snapshot.units] == [1, 2]
    assert all(state.reading is not None and state.parameters for state in snapshot.units)
    assert snapshot.units[1].staged == 333
    assert snapshot.figures is not None
    encode(snapshot)


@played(2)
async def test_an_id_is_carried_out_once_and_its_result_repeated(line: VirtualLine) -> None:
    await settled(line)
    for _ in range(3):
        line.command(SetSpeed(1, 640), command_id="same")
    await asyncio.sleep(1.0)
    assert len(line.acted()) == 1
    line.command(SetSpeed(1, 999), command_id="same")
    await asyncio.sleep(1.0)
    results = [update for update in line.updates if isinstance(update, Result)]
    assert len(results) == 2
    assert results[0].frames
    assert results[1] == replace(results[0], frames=[]), "its frames are reported once"
    assert line.plant.unit(1).setpoint == 640


@played(2)
async def test_a_command_that_comes_too_late_is_never_sent_but_a_read_is(line: VirtualLine) -> None:
    await settled(line)
    result = await line.perform(SetSpeed(1, 640), timeout_s=-0.2)
    assert result.outcome == "not_sent"
    assert "0.2 s after" in str(result.message)
    assert line.acted() == []
    assert (await line.perform(ReadParameters(1, [6]), timeout_s=-0.2)).outcome == "verified"


@played(2)
async def test_the_apps_clock_decides_lateness(line: VirtualLine) -> None:
    await settled(line)
    line.worker.app_clock.observe(EPOCH - 3600.0, EPOCH)
    result = await line.perform(SetSpeed(1, 640), timeout_s=-3599.0)
    assert result.outcome == "verified", "the app's clock is an hour slow: one second is left"


@played(2)
async def test_a_value_no_frame_can_carry_is_invalid(line: VirtualLine) -> None:
    await settled(line)
    for action in (SetSpeed(1, 100_000), SetSpeed(0, 5), SetSpeed(256, 5), ReadParameters(1, [0])):
        assert (await line.perform(action)).outcome == "invalid"
    assert line.acted() == []
    seen = len(line.readings())
    await asyncio.sleep(0.5)
    assert len(line.readings()) > seen


@played(4)
async def test_figures_come_every_second_with_the_load_of_the_wire(line: VirtualLine) -> None:
    await asyncio.sleep(12.0)
    figures = [update for update in line.updates if isinstance(update, BusFigures)]
    assert len(figures) in (11, 12)
    last = figures[-1]
    assert last.wire_utilisation > 0.98
    assert last.scan_hz == pytest.approx(38.4 / 4, rel=0.06)
    assert last.scan_s == pytest.approx(1 / last.scan_hz)
    assert last.scan_s_with_one_more == pytest.approx(last.scan_s * 5 / 4)
    assert last.diagnosis == []
    assert all(unit.responses > 50 and unit.response_s_median is not None for unit in last.units)


@played(2)
async def test_frames_are_reported_only_while_followed(line: VirtualLine) -> None:
    await settled(line)
    assert not [update for update in line.updates if isinstance(update, Frames)]
    line.worker.watch(Watch(units=[], trace=True))
    await asyncio.sleep(0.5)
    line.worker.watch(Watch(units=[]))
    frames = [frame for update in line.updates if isinstance(update, Frames) for frame in update.frames]
    assert {frame.direction for frame in frames} == {"in", "out"}
    count = len(line.updates)
    await asyncio.sleep(0.5)
    assert not [update for update in line.updates[count:] if isinstance(update, Frames)]


@played(2)
async def test_the_trace_is_read_piece_by_piece_without_a_gap(line: VirtualLine) -> None:
    await asyncio.sleep(5.0)
    frames, since = [], 0.0
    while True:
        result = await line.perform(ReadTrace(since=since, limit=100))
        new = [frame for frame in result.frames if frame not in frames]
        frames += new
        if len(result.frames) < 100:
            break
        since = result.frames[-1].at
    sent = [frame.data for frame in frames if frame.direction == "out"]
    assert sent == [data for _, data in line.written][: len(sent)]
    assert len(sent) > 100


@played(2)
async def test_on_leaving_it_takes_nothing_new_and_drops_waiting_commands(line: VirtualLine) -> None:
    await settled(line)
    slow = line.command(ReadParameters(1, urgent=False))
    began = line.loop.time()
    await line.worker.finish()
    assert line.loop.time() - began < 2.0
    assert line.result_of(slow) is not None
    result = await line.perform(SetSpeed(1, 640))
    assert result.outcome == "not_sent"
    assert "stopping" in str(result.message)


# --- diagnosis -----------------------------------------------------------------------------------

WELL = [UnitSymptoms(unit, responses=100) for unit in range(1, 6)]


def ill(*units: int, **failure: int) -> list[UnitSymptoms]:
    return [
        UnitSymptoms(each.unit, responses=each.responses, **failure) if each.unit in units else each
        for each in WELL
    ]


ONE_UNRESPONSIVE = Message.of("diagnosis_one_silent", unit=3)


@pytest.mark.parametrize(
    ("units", "noise", "echoes", "causes"),
    [
        (WELL, 0, 0, []),
        (ill(3, timeouts=1), 0, 0, []),
        (ill(3, timeouts=40), 0, 0, [ONE_UNRESPONSIVE]),
        (ill(4, 5, timeouts=40), 0, 0, [Message.of("diagnosis_silent_from", unit=4, before=3)]),
        (ill(2, 4, timeouts=40), 0, 0, [Message.of("diagnosis_some_silent", units=[2, 4])]),
        (ill(1, 2, 3, 4, 5, timeouts=40), 0, 0, [Message("diagnosis_no_response")]),
        (ill(3, spoilt=30, timeouts=30), 300, 0, [Message.of("diagnosis_one_garbled", unit=3)]),
        (ill(1, 2, 3, 4, 5, spoilt=30, timeouts=30), 300, 0, [Message("diagnosis_all_garbled")]),
        (ill(2, 3, spoilt=30, timeouts=30), 300, 0, [Message.of("diagnosis_some_garbled", units=[2, 3])]),
        (ill(3, late=20), 0, 0, [Message.of("diagnosis_late", units=[3])]),
        (ill(3, foreign=20), 0, 0, [Message.of("diagnosis_foreign", units=[3])]),
        (WELL, 0, 50, [Message("diagnosis_echo")]),
        (WELL, 500, 0, [Message("diagnosis_stray_bytes")]),
        (ill(3, timeouts=40), 10_000, 0, [ONE_UNRESPONSIVE, Message("diagnosis_other_protocol")]),
        (ill(1, 2, 4, 5, late=20), 0, 0, [Message.of("diagnosis_all_twice", unit=3)]),
        (ill(1, 2, 4, 5, offline=True), 48, 0, [Message.of("diagnosis_collisions", unit=3)]),
        (ill(1, 2, 4, 5, offline=True), 0, 0, [Message.of("diagnosis_some_silent", units=[1, 2, 4, 5])]),
        (ill(5, own_address=3), 0, 0, [Message.of("diagnosis_other_name", units=[5], own=3)]),
        (ill(5, own_address=5), 0, 0, []),
        (ill(5, own_address=3, offline=True), 0, 0, [Message.of("diagnosis_one_silent", unit=5)]),
    ],
)
def test_the_likely_cause(units: list[UnitSymptoms], noise: int, echoes: int, causes: list[Message]) -> None:
    assert diagnose(units, noise, echoes) == causes


@pytest.mark.parametrize(
    ("units", "found"),
    [
        (WELL, 0),
        (ill(1, 2, 4, 5, late=20), 3),
        (ill(1, 2, 4, 5, late=1), 0),
        (ill(1, 2, 3, 4, 5, late=20), 0),
        (ill(1, 2, late=20), 0),
        (ill(1, 2, 4, 5, late=8, timeouts=8), 0),
        ([*ill(1, 2, late=20)[:3], *ill(4, 5, offline=True)[3:]], 3),
        ([UnitSymptoms(1, responses=100, late=50), UnitSymptoms(2, responses=100)], 0),
    ],
    ids=[
        "well",
        "all but 3",
        "by chance",
        "an adapter",
        "two",
        "really late",
        "with two off",
        "of two nobody can tell",
    ],
)
def test_a_unit_that_responds_to_every_address(units: list[UnitSymptoms], found: int) -> None:
    assert responds_for_all(units) == found


@played(5)
async def test_a_unit_that_responds_for_a_dead_one_is_found_by_its_parameter_17(line: VirtualLine) -> None:
    """No frame shows that: unit 3 returns the address of the request."""
    line.faults.set(FaultKind.DEAD, 1.0, 5)
    line.faults.set(FaultKind.ALL_ADDRESSES, 1.0, 3)
    cause = Message.of("diagnosis_other_name", units=[5], own=3)
    await line.until(lambda: line.readings(5) and cause in line.worker.line.figures().diagnosis)
    assert {value.raw for value in line.parameters() if (value.unit, value.number) == (5, 17)} == {3}


# --- the process ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "token", "words"),
    [
        (["--bus", "b"], "", "no token"),
        (["--bus", "other"], "t", "other"),
    ],
)
def test_wrong_use_is_reported_in_one_line(
    arguments: list[str], token: str, words: str, tmp_path: Path
) -> None:
    config = tmp_path / "lineside.toml"
    config.write_text('[[bus]]\nname = "b"\nport = "/dev/none"\n')
    done = fork_server.run(
        *("--config", config, "--app", "http://127.0.0.1:1", *arguments),
        program="bus",
        env={**os.environ, "LINESIDE_WORKER_TOKEN": token},
    )
    assert done.returncode == 2
    assert words in done.stderr
    assert "Traceback" not in done.stderr


async def test_it_waits_for_port_and_app_logs_it_once_and_leaves_on_request(tmp_path: Path) -> None:
    config = tmp_path / "lineside.toml"
    config.write_text('[[bus]]\nname = "b"\nport = "/dev/ttyNOSUCH7"\n[[bus.unit]]\nid = 1\nname = "One"\n')
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "bus", "--config", str(config), "--bus", "b", "--app", "http://127.0.0.1:1"),
        env={**os.environ, "LINESIDE_WORKER_TOKEN": "t"},
        cwd=ROOT,
        stderr=asyncio.subprocess.PIPE,
    )
    assert process.stderr is not None
    async with asyncio.timeout(30):
        lines = [json.loads(await process.stderr.readline()) for _ in range(2)]
    process.terminate()
    _, rest = await process.communicate()
    lines += [json.loads(line) for line in rest.splitlines()]
    assert process.returncode == 0
    printed = [line.get("cause", "") + line.get("why", "") for line in lines]
    assert any("is the adapter plugged in?" in words for words in printed)
    assert any("no dashboard at" in words for words in printed)
    assert len(printed) == len(set(printed))
