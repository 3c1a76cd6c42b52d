"""The commands over HTTP, against a worker that is played: statuses, bodies, what reaches the worker, the
trace file."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from typing import Any

import httpx
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.core.web.access import Person, Role
from app.core.web.routes import Turns
from app.core.web.shape import iso
from app.line.commands.service import MAX_AT_ONCE
from app.line.commands.trace_file import is_trace_line, parse_trace_line, trace_line
from app.line.feed.ingest import FeedQuota
from bus.catalogue.parameters import PARAMETERS
from bus.contract import (
    Command,
    Direction,
    ExecuteAll,
    ExecuteSpeed,
    Frame,
    ParameterValue,
    ReadParameters,
    ReadTrace,
    ReserveTurn,
    SetLine,
    SetSpeed,
    UnitOutcome,
    Update,
    WriteAnalogOutput,
    WriteOutput,
    WriteParameter,
)
from bus.errors import CallerError
from bus.instants import unix_now
from bus.messages import term
from tests.app.complete_app import House
from tests.app.fake_worker import PlayedWorker, reading, responding, result_of, snapshot, unit_state, until
from tests.for_each import for_each


@pytest.fixture
async def worker(worker: PlayedWorker) -> PlayedWorker:
    """Every unit takes everything."""
    worker.play = responding("verified", read_back=1)
    return worker


async def test_a_turn_is_reserved_before_the_write_comes(site: House, worker: PlayedWorker) -> None:
    await site.request("POST", "/units/1/speed", {"raw": 5})
    kinds = [type(message) for message in worker.received if isinstance(message, ReserveTurn | Command)]
    assert kinds == [ReserveTurn, Command]


async def test_for_who_may_not_write_the_wire_waits_never(site: House, worker: PlayedWorker) -> None:
    assert (await site.request("POST", "/units/1/speed", {"raw": 5}, role="viewer")).status_code == 403
    await site.request("GET", "/units/1/parameters?refresh=true")
    await worker.receive(Command)
    assert not any(isinstance(message, ReserveTurn) for message in worker.received)


@for_each(
    ("method", "path", "body", "action"),
    [
        ("POST", "/units/1/speed", {"raw": 12345}, SetSpeed(unit=1, raw=12345)),
        ("POST", "/units/16/speed", {"raw": 5, "execute": False}, SetSpeed(unit=16, raw=5, execute=False)),
        ("POST", "/units/1/speed", {"value": "1234.5"}, SetSpeed(unit=1, raw=12345)),
        ("POST", "/units/1/speed", {"value": "1234,5"}, SetSpeed(unit=1, raw=12345)),
        ("POST", "/units/1/speed", {"value": 7}, SetSpeed(unit=1, raw=70)),
        ("POST", "/units/1/speed", {"value": "105 %"}, SetSpeed(unit=1, raw=1050)),
        ("POST", "/units/1/execute", None, ExecuteSpeed(unit=1)),
        ("POST", "/execute", None, ExecuteAll()),
        (
            "POST",
            "/speeds",
            {"setpoints": {"1": {"raw": 100}, "16": {"value": "1.5"}}},
            SetLine({1: 100, 16: 15}),
        ),
        ("PUT", "/units/1/outputs/3", {"on": True}, WriteOutput(unit=1, number=3, on=True)),
        ("PUT", "/units/1/analog-output", {"raw": 350}, WriteAnalogOutput(unit=1, raw=350)),
        ("PUT", "/units/1/parameters/6", {"raw": 50}, WriteParameter(unit=1, number=6, raw=50)),
        ("PUT", "/units/1/parameters/6", {"value": "5.0"}, WriteParameter(unit=1, number=6, raw=50)),
        ("PUT", "/units/1/parameters/18", {"raw": 48, "confirm": True}, WriteParameter(1, 18, 48)),
    ],
)
async def test_the_worker_gets_the_requested_action(
    site: House, worker: PlayedWorker, method: str, path: str, body: Any, action: object
) -> None:
    worker.commands.clear()
    response = await site.request(method, path, body)
    assert response.status_code == 200, response.text
    assert response.json()["outcome"] == response.json()["code"] == "verified"
    assert [command.action for command in worker.commands] == [action]


@for_each(
    ("method", "path", "body"),
    [
        ("POST", "/units/1/speed", {}),
        ("POST", "/units/1/speed", {"raw": 1, "value": "0.1"}),
        ("POST", "/units/1/speed", {"raw": True}),
        ("POST", "/units/1/speed", {"raw": "5"}),
        ("POST", "/units/1/speed", {"raw": 100000}),
        ("POST", "/units/1/speed", {"raw": 1, "execute": "yes"}),
        ("POST", "/units/1/speed", {"raw": 1, "surprise": 1}),
        ("POST", "/units/1/speed", {"raw": 1, "timeout_s": 0.01}),
        ("POST", "/units/1/speed?timeout_s=0", {"raw": 1}),
        ("POST", "/units/1/speed", {"value": "1.23"}),
        ("POST", "/units/1/speed", {"value": ""}),
        ("POST", "/units/1/execute", {"raw": 5}),
        ("POST", "/execute", []),
        ("POST", "/speeds", {"setpoints": {}}),
        ("POST", "/speeds", {"setpoints": {"0": {"raw": 1}}}),
        ("POST", "/speeds", {"setpoints": {"1": {"raw": 1}, "2": {"raw": 100000}}}),
        ("PUT", "/units/1/outputs/3", {"on": 1}),
        ("PUT", "/units/1/analog-output", {"raw": 99}),
        ("PUT", "/units/1/parameters/6", {"raw": 10000}),
        ("PUT", "/units/1/parameters/17", {"raw": 5, "confirm": True}),
    ],
)
async def test_bad_input_is_explained_and_nothing_is_sent(
    site: House, worker: PlayedWorker, method: str, path: str, body: Any
) -> None:
    response = await site.request(method, path, body)
    assert response.status_code == 422, response.text
    assert response.headers["content-type"] == "application/problem+json"
    assert response.json()["code"] == "invalid"
    assert response.json()["detail"]
    assert worker.commands == []


@for_each(
    ("method", "path", "body"),
    [
        ("POST", "/units/3/speed", {"raw": 1}),
        ("POST", "/units/abc/speed", {"raw": 1}),
        ("POST", "/speeds", {"setpoints": {"1": {"raw": 1}, "3": {"raw": 1}}}),
        ("PUT", "/units/1/outputs/7", {"on": True}),
        ("PUT", "/units/1/parameters/41", {"raw": 1}),
        ("GET", "/units/3/parameters", None),
        ("GET", "/units/3", None),
    ],
)
async def test_what_there_is_not(
    site: House, worker: PlayedWorker, method: str, path: str, body: Any
) -> None:
    response = await site.request(method, path, body)
    assert response.status_code == 404, response.text
    assert worker.commands == []


async def test_a_bus_there_is_not(site: House) -> None:
    for path, body in (("execute", None), ("speeds", {"setpoints": {"1": {"raw": 1}}})):
        response = await site.http().post(f"/api/v1/buses/nowhere/{path}", json=body)
        assert response.status_code == 404
        assert response.json()["code"] == "unknown_bus"


@for_each(
    ("outcome", "status"),
    [("verified", 200), ("acknowledged", 200), ("unverified", 504), ("not_sent", 503), ("invalid", 422)],
)
async def test_each_outcome_has_its_status(
    site: House, worker: PlayedWorker, outcome: str, status: int
) -> None:
    worker.play = responding(outcome, message=term("as it was"))
    response = await site.request("POST", "/units/1/speed", {"raw": 5})
    assert response.status_code == status
    result = response.json()
    assert result["outcome"] == result["code"] == outcome
    assert (result["reason"], result["params"], result["detail"]) == (
        "term",
        {"text": "as it was"},
        "as it was",
    )
    assert result.get("status", 200) == status
    assert not {"frames", "message"} & result.keys()


async def test_a_command_to_one_unit_states_its_result_once(site: House, worker: PlayedWorker) -> None:
    now = time.time()
    part = UnitOutcome(unit=1, outcome="verified", read_back=5, sent_at=now, proven_at=now)
    worker.play = responding("verified", units=[part], read_back=5)
    result = (await site.request("POST", "/units/1/speed", {"raw": 5})).json()
    assert (result["unit"], result["units"]) == (1, {})
    assert (result["sent_at"], result["proven_at"]) == (iso(now), iso(now))


async def test_a_reading_takes_no_frames(site: House) -> None:
    response = await site.request("GET", "/units/1/parameters?frames=true")
    assert (response.status_code, response.json()["reason"]) == (422, "parameter_unknown")


def members(node: Any, name: str) -> int:
    """How often a member of this name is in a body."""
    if isinstance(node, list):
        return sum(members(each, name) for each in node)
    if not isinstance(node, dict):
        return 0
    return (name in node) + sum(members(each, name) for each in node.values())


@for_each(
    ("method", "path", "body", "reason"),
    [
        ("POST", "/units/1/speed", {"raw": 99999}, "setpoint_outside_display"),
        ("PUT", "/units/1/parameters/6", {"raw": 9999999}, "parameter_cannot_be"),
        ("PUT", "/units/1/analog-output", {"raw": 1}, "analog_output_outside"),
        ("PUT", "/units/1/parameters/19", {"raw": 0}, "term"),
        ("POST", "/units/99/speed", {"raw": 5}, "no_such_unit"),
        ("POST", "/units/1/speed", {"raw": "x"}, "fields_malformed"),
    ],
)
async def test_a_refusal_states_everything_once_and_on_one_level(
    site: House, worker: PlayedWorker, method: str, path: str, body: dict[str, Any], reason: str
) -> None:
    """The nearest value was there four times, and the code of the text three levels down."""
    problem = (await site.request(method, path, body)).json()
    assert problem["reason"] == reason
    errors = problem.pop("errors", [])
    assert all(error.keys() == {"where", "code", "params", "detail"} for error in errors)
    for name in ("code", "reason", "params", "detail"):
        assert members(problem, name) == 1
    assert members(problem, "nearest") <= 1
    assert not problem["params"].keys() & problem.keys()
    assert all(isinstance(value, (int, float, str)) for value in problem["params"].values())
    assert worker.commands == []


async def test_a_refusal_names_the_units_error(site: House, worker: PlayedWorker) -> None:
    worker.play = responding("refused", unit_error=128)
    response = await site.request("POST", "/units/1/speed", {"raw": 5})
    assert response.status_code == 409
    result = response.json()
    assert (result["outcome"], result["unit_error"]) == ("refused", 128)
    assert result["unit_error_name"] == "unit is not in REMOTE mode"
    assert "REMOTE" in result["detail"]


async def test_a_line_action_returns_each_unit_and_its_frames_on_request(
    site: House, worker: PlayedWorker
) -> None:
    units = [
        UnitOutcome(unit=1, outcome="verified", read_back=100, sent_at=1.0, proven_at=2.0),
        UnitOutcome(unit=2, outcome="unverified", message=term("no response")),
    ]
    frame = Frame(
        at=time.time(), direction="out", data=b"\x10\x02\x00\x83\x10\x03\x7d", meanings=[term("execute, all")]
    )
    worker.play = responding("unverified", units=units, skew_s=0.02, frames=[frame])
    body = {"setpoints": {"1": {"raw": 100}, "2": {"raw": 100}}}
    assert "frames" not in (await site.request("POST", "/speeds", body)).json()
    response = await site.request("POST", "/speeds?frames=true", body)
    result = response.json()
    assert response.status_code == 504
    assert result["units"]["1"]["outcome"] == "verified"
    assert result["units"]["1"]["read_back"] == 100
    assert result["units"]["2"]["detail"] == "no response"
    assert result["skew_s"] == 0.02
    assert result["frames"][0]["hex"] == "10 02 00 83 10 03 7D"


async def test_the_time_is_passed_on(site: House, worker: PlayedWorker) -> None:
    for path, body, seconds in (
        ("/units/1/speed", {"raw": 5}, 2.0),
        ("/units/1/speed", {"raw": 5, "timeout_s": 20}, 20.0),
        ("/units/1/speed?timeout_s=20", {"raw": 5}, 20.0),
    ):
        before = time.time()
        await site.request("POST", path, body)
        deadline = worker.commands[-1].deadline
        assert before + seconds - 1 < deadline <= time.time() + seconds


async def test_a_value_reads_the_decimals_first_where_they_are_not_known(site: House) -> None:
    states = [unit_state(1, {}), unit_state(2), unit_state(16)]
    worker = await site.worker(state=snapshot(units=states))

    async def play(command: Command) -> Sequence[Update]:
        if isinstance(command.action, ReadParameters):
            known = {2: 20000, 3: 2, 8: 0}
            values = [
                ParameterValue(1, number, time.time(), known[number]) for number in command.action.numbers
            ]
            return [*values, result_of(command, "verified", values=values)]
        return [result_of(command, "verified", read_back=1)]

    worker.play = play
    assert (await site.request("POST", "/units/1/speed", {"value": "12.34"})).status_code == 200
    assert [command.action for command in worker.commands] == [
        ReadParameters(unit=1, numbers=[3, 8]),
        ReadParameters(unit=1, numbers=[2]),
        SetSpeed(unit=1, raw=1234),
    ]


async def test_a_value_for_a_unit_that_does_not_respond_is_unverified_and_not_sent(site: House) -> None:
    worker = await site.worker(state=snapshot(units=[unit_state(1, {}), unit_state(2), unit_state(16)]))
    worker.play = responding("unverified", message=term("no response"))
    response = await site.request("POST", "/units/1/speed", {"value": "12.3"})
    assert response.status_code == 504
    assert "nothing was sent" in response.json()["detail"]
    assert len(worker.commands) == 1


async def test_parameters_as_last_read_and_refreshed(site: House, worker: PlayedWorker) -> None:
    rows = (await site.request("GET", "/units/1/parameters")).json()
    assert [row["number"] for row in rows] == list(range(1, 41))
    assert rows[2]["raw"] == 1
    assert rows[4]["read_at"] is None
    assert rows[4]["available"] is None

    async def play(command: Command) -> Sequence[Update]:
        values = [
            ParameterValue(
                unit=1, number=number, at=time.time(), raw=7, available=number <= 20 or number == 21
            )
            for number in PARAMETERS
        ]
        return [*values, result_of(command, "verified", values=values)]

    worker.play = play
    rows = (await site.request("GET", "/units/1/parameters?refresh=true", role="viewer")).json()
    assert rows[5]["raw"] == 7
    assert rows[5]["value"] == "0.7"
    assert rows[5]["unit"] == "s"
    assert rows[5]["read_at"] is not None
    assert rows[39]["available"] is False
    assert rows[20]["raw"] is None
    assert "7" not in str(rows[20]["value"])


async def test_a_refresh_that_breaks_off_is_no_list(site: House, worker: PlayedWorker) -> None:
    worker.play = responding("unverified", message=term("no response"))
    response = await site.request("GET", "/units/1/parameters?refresh=true")
    assert response.status_code == 504
    assert response.json()["code"] == "unverified"


async def test_a_requested_trace_delays_nothing_else(
    site: House, worker: PlayedWorker, monkeypatch: pytest.MonkeyPatch
) -> None:
    sizes: list[int] = []

    def counted(_quota: FeedQuota, _message: object, size: int, _now: float) -> float:
        sizes.append(size)
        return 0.0

    monkeypatch.setattr(FeedQuota, "pause_s", counted)
    frame = Frame(at=unix_now(), direction="in", data=b"a" * 500, meanings=[])
    worker.play = responding("verified", frames=[frame])
    await site.request("GET", "/trace", role="engineer")
    assert 0 in sizes
    sizes.clear()
    worker.play = responding("verified", read_back=250)
    await site.request("POST", "/units/1/speed", {"raw": 250})
    assert sizes
    assert 0 not in sizes


async def test_the_password_is_in_no_response_and_no_event(site: House, worker: PlayedWorker) -> None:
    frame = Frame(at=1.0, direction="out", data=b"\x00\x00\x10\x92", meanings=[term("write #21 = 4242")])
    worker.play = responding("verified", read_back=4242, frames=[frame])
    response = await site.request("PUT", "/units/1/parameters/21", {"raw": 4242})
    assert response.status_code == 200
    assert "4242" not in response.text
    events = await site.http().get("/api/v1/events?kind=command")
    assert "4242" not in events.text
    assert "10 92" not in events.text


@pytest.mark.usefixtures("worker")
async def test_every_command_is_an_event_with_old_new_and_outcome(site: House) -> None:
    await site.request("POST", "/units/1/speed", {"raw": 1500}, role="operator", name="anna")
    event = (await site.http().get("/api/v1/events?kind=command")).json()["events"][0]
    expected = {"who": "anna", "bus": "dry-end", "unit": 1, "outcome": "verified", "kind": "command"}
    assert event.items() >= expected.items()
    assert (event["old"], event["new"]) == ("100.0", "150.0")
    assert (event["old_raw"], event["new_raw"]) == (1000, 1500)


async def test_a_change_of_several_is_an_event_for_the_line_and_one_for_each_unit(
    site: House, worker: PlayedWorker
) -> None:
    units = [UnitOutcome(unit=1, outcome="verified"), UnitOutcome(unit=2, outcome="unverified")]
    worker.play = responding("unverified", units=units, message=term("unit 2 did not respond"))
    await site.request("POST", "/speeds", {"setpoints": {"1": {"raw": 1100}, "2": {"raw": 1200}}})
    events = (await site.http().get("/api/v1/events?kind=command")).json()["events"]
    result = [(event["unit"], event["old"], event["new"], event["outcome"]) for event in reversed(events)]
    assert result == [
        (None, "1: 100.0, 2: 100.0", "1: 110.0, 2: 120.0", "unverified"),
        (1, "100.0", "110.0", "verified"),
        (2, "100.0", "120.0", "unverified"),
    ]
    of_unit = (await site.http().get("/api/v1/events?bus=dry-end&unit=2")).json()["events"]
    assert (of_unit[0]["old_raw"], of_unit[0]["new_raw"]) == (1000, 1200)
    assert (await site.log.proof.verify()).fault is None


@pytest.mark.usefixtures("worker")
async def test_a_refused_command_is_an_event_too(site: House) -> None:
    await site.request("POST", "/units/1/speed", {"raw": 100000})
    await site.request("PUT", "/units/1/parameters/18", {"raw": 48})
    events = (await site.http().get("/api/v1/events?kind=command")).json()["events"]
    assert [event["outcome"] for event in events] == ["dangerous", "invalid"]


async def test_the_trace_is_read_in_pieces_and_its_file_can_be_read_back(
    site: House, worker: PlayedWorker
) -> None:
    start = time.time() - 30
    frames = [
        Frame(at=start + n / 1000, direction="out", data=bytes([n % 256]), meanings=[term("m")])
        for n in range(2500)
    ]

    async def play(command: Command) -> Sequence[Update]:
        assert isinstance(command.action, ReadTrace)
        wanted = [frame for frame in frames if frame.at >= command.action.since]
        return [result_of(command, "acknowledged", frames=wanted[: command.action.limit])]

    worker.play = play
    text = (await site.request("GET", "/trace?seconds=60", role="engineer")).text
    lines = text.splitlines()
    assert len(lines) == 2500
    assert parse_trace_line(lines[7]).data == frames[7].data
    shown = (await site.request("GET", "/trace?limit=3")).json()["frames"]
    assert [frame["at"] for frame in shown] == [iso(frame.at) for frame in frames[-3:]]


async def test_an_account_reads_two_traces_at_a_time(site: House, worker: PlayedWorker) -> None:
    """Each is thousands of frames to decode and to write."""

    async def play(command: Command) -> Sequence[Update]:
        return [result_of(command, "verified")]

    worker.play = play
    downloads, account = (
        site.app.state.services[Turns].downloads,
        Person("eva", Role.ENGINEER, "session").account,
    )
    async with downloads.turn(account), downloads.turn(account):
        third = asyncio.create_task(site.request("GET", "/trace", role="engineer", name="eva"))
        await until(lambda: downloads.count_of(account) == 3, "a third waits")
        assert (await site.request("GET", "/trace", role="engineer", name="ben")).status_code == 200
        assert len(worker.commands) == 1
    assert (await third).status_code == 200


async def test_what_one_account_sends_keeps_no_other_waiting(site: House, worker: PlayedWorker) -> None:
    """A program that writes without end has two writes in progress; what slows has separate turns."""

    def write(name: str, raw: int, timeout_s: float = 30.0) -> asyncio.Task[httpx.Response]:
        body = {"raw": raw, "timeout_s": timeout_s}
        return asyncio.create_task(site.request("POST", "/units/1/speed", body, "operator", name=name))

    worker.play = None
    flood = [write("anna", 1100 + number) for number in range(5)]
    await worker.receive(Command, MAX_AT_ONCE)
    late = await write("anna", 1200, 0.1)
    assert (late.status_code, late.json()["outcome"]) == (503, "not_sent")
    others = [write("ben", 1300), write("anna", 0)]
    await worker.receive(Command, MAX_AT_ONCE + len(others))
    sent = [command.action.raw for command in worker.commands if isinstance(command.action, SetSpeed)]
    assert sorted(sent[MAX_AT_ONCE:]) == [0, 1300]

    async def verified(command: Command) -> Sequence[Update]:
        return [result_of(command, "verified")]

    worker.play = verified
    for each in tuple(worker.commands):
        await worker.update(result_of(each, "verified"))
    assert {(await task).status_code for task in (*flood, *others)} == {200}


async def test_the_shown_speed_changes_by_readings_alone(site: House, worker: PlayedWorker) -> None:
    await site.request("POST", "/units/1/speed", {"raw": 1500})
    assert (await site.request("GET", "/units/1")).json()["commanded_raw"] == 1000

    async def play(command: Command) -> Sequence[Update]:
        return [reading(1, 1600), result_of(command, "verified", read_back=1600)]

    worker.play = play
    await site.request("POST", "/units/1/speed", {"raw": 1600})
    unit = (await site.request("GET", "/units/1")).json()
    assert (unit["commanded_raw"], unit["commanded"]) == (1600, "160.0")


LINE = "2026-11-21T02:01:33.123456+00:00\tout\t10 02 04 81 10 03 7B\tunit 4: read speed and status"


def test_a_line() -> None:
    frame = Frame(
        1795226493.123456, "out", bytes.fromhex("10020481 10037B"), [term("unit 4: read speed and status")]
    )
    assert trace_line(frame) == LINE
    assert is_trace_line(LINE)


@given(
    st.integers(0, 4_000_000_000_000_000),
    st.sampled_from(["out", "in"]),
    st.binary(max_size=40),
    st.text(max_size=40),
)
def test_lines_round_trip(microseconds: int, direction: Direction, data: bytes, meaning: str) -> None:
    at = microseconds / 1e6
    line = trace_line(Frame(at, direction, data, [term(meaning)]))
    assert "\n" not in line
    assert is_trace_line(line)
    back = parse_trace_line(line + "\n")
    assert back.at == pytest.approx(at, abs=2e-6)
    assert (back.direction, back.data, back.meaning) == (direction, data, " ".join(meaning.split()))


@pytest.mark.parametrize(
    "line",
    ["", "10 02 04", LINE.replace("out", "up"), LINE.replace("10 02", "1x 02"), LINE.replace("2026", "when")],
)
def test_texts_that_are_no_line(line: str) -> None:
    with pytest.raises(CallerError, match="not a line of a trace"):
        parse_trace_line(line)


def test_hex_is_not_taken_for_a_trace() -> None:
    assert not is_trace_line("10 02 04\t81 10 03 7B")
