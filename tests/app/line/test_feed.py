"""Workers on the real WebSocket: order of messages, losses, refusals, and who has a bus."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path

import msgspec
import pytest
import websockets
from starlette.types import Message as AsgiMessage
from starlette.websockets import WebSocket, WebSocketState

from app.line.feed import bus_feed
from app.line.feed import socket as sockets
from app.line.feed.bus_feed import Credential, Ending, Holder
from app.line.feed.socket import GOING_AWAY, WorkerSocket
from app.line.pipeline import OTHER_RELEASE
from app.people.audit.queries import Filter
from bus.contract import (
    CONTRACT_VERSION,
    Batch,
    BusLink,
    ClockSync,
    Command,
    Delivered,
    WantSnapshot,
    Watch,
    Welcome,
)
from bus.messages import Message, term
from tests.app.stage import OWN_WORKER, Stage, hello, reading, result_of, snapshot, staged, until


@pytest.fixture
def quick_ticks(monkeypatch: pytest.MonkeyPatch) -> None:
    """The app confirms what it received with a tick, which is otherwise once a second."""
    monkeypatch.setattr(bus_feed, "TICK_S", 0.02)


@pytest.mark.parametrize("role", ["", "viewer", "operator", "engineer", "admin"])
async def test_only_a_worker_is_let_in(stage: Stage, role: str) -> None:
    with pytest.raises(websockets.InvalidStatus):
        await stage.connect(role)


async def test_a_worker_without_a_bus_is_not_let_in(stage: Stage) -> None:
    with pytest.raises(websockets.InvalidStatus) as refused:
        await stage.connect(bus="")
    assert refused.value.response.status_code == 403
    assert b"--bus BUS" in (refused.value.response.body or b"")


@pytest.mark.parametrize(("of_token", "bus_name"), [("dry-end", "wet-end"), ("wet-end", "dry-end")])
async def test_a_token_speaks_for_its_own_bus_only(stage: Stage, of_token: str, bus_name: str) -> None:
    worker = await stage.connect(bus=of_token)
    await worker.send(hello(bus=bus_name))
    welcome = await worker.receive(Welcome)
    assert isinstance(welcome, Welcome)
    assert welcome.refused == f"the token is for bus {of_token}; create one for the bus of this worker"
    await worker.gone()


async def test_a_bus_that_is_not_configured_any_more_is_refused_in_words(stage: Stage) -> None:
    worker = await stage.connect(bus="wet-end")
    await worker.send(hello(bus="wet-end"))
    welcome = await worker.receive(Welcome)
    assert isinstance(welcome, Welcome)
    assert "no [[bus]] is called wet-end" in welcome.refused
    assert "dry-end" in welcome.refused
    await worker.gone()


@pytest.mark.parametrize("version", [5, 99])
async def test_a_worker_of_another_release_is_refused_with_the_command_that_upgrades_it(
    stage: Stage, version: int
) -> None:
    worker = await stage.connect()
    # What version 0.2 sent; the epoch that it named is no field any more.
    hello_of_other = msgspec.structs.asdict(hello(version=version)) | {"is": "hello", "epoch": 3}
    await worker.send_raw(msgspec.msgpack.encode(hello_of_other))
    welcome = await worker.receive(Welcome)
    assert isinstance(welcome, Welcome)
    assert "pip install ./lineside-*.whl" in welcome.refused
    await worker.gone()
    bus = stage.live.buses["dry-end"]
    assert bus.link.cause is not None
    assert (bus.worker_connected, bus.link.link, bus.link.cause.code) == (False, "closed", OTHER_RELEASE)
    assert bus.link.cause.params["version"] == version


@pytest.mark.parametrize("noise", [b"\xff\x00", b"", "text", b"\x81\xa2is\xa4nope"])
async def test_noise_first_ends_the_connection_with_a_reason(stage: Stage, noise: bytes | str) -> None:
    worker = await stage.connect()
    await worker.send_raw(noise)
    closed = await worker.gone()
    assert closed.rcvd is not None
    assert closed.rcvd.reason


async def test_noise_later_ends_it_and_nothing_of_it_is_applied(stage: Stage) -> None:
    worker = await stage.worker()
    await worker.send_raw(b"\x00\x01\x02")
    await worker.gone()
    await until(lambda: stage.live.buses["dry-end"].link.link == "closed", "the bus closed")
    assert stage.live.buses["dry-end"].link.cause == Message("worker_malformed")


async def test_a_batch_before_the_snapshot_ends_it(stage: Stage) -> None:
    worker = await stage.connect()
    await worker.send(hello())
    await worker.receive(Welcome)
    await worker.update(reading(1, 777))
    await worker.gone()
    assert stage.live.buses["dry-end"].units[1].reading is None


@pytest.mark.usefixtures("quick_ticks")
async def test_readings_arrive_and_are_confirmed(stage: Stage) -> None:
    worker = await stage.worker()
    await worker.update(reading(1, 1234))
    await until(lambda: _commanded(stage) == 1234, "the reading")
    delivered = await worker.receive(Delivered)
    assert delivered == Delivered(seq=1)
    await worker.receive(ClockSync)


async def test_a_doubled_batch_counts_once(stage: Stage) -> None:
    worker = await stage.worker()
    batch = Batch(seq=1, sent_at=time.time(), updates=[reading(1, 5)])
    await worker.send(batch)
    await worker.send(batch)
    worker.seq = 1
    await worker.update(reading(1, 6))
    await until(lambda: _commanded(stage) == 6, "the last reading")
    assert len(stage.history.readings) == 2


async def test_a_missing_number_requests_a_snapshot_once(stage: Stage) -> None:
    worker = await stage.worker()
    worker.seq = 4
    await worker.update(reading(1, 5))
    await worker.update(reading(1, 6))
    await worker.receive(WantSnapshot)
    await worker.send(snapshot(seq=6))
    await worker.update(reading(1, 7))
    await until(lambda: _commanded(stage) == 7, "the reading after the snapshot")
    assert sum(isinstance(message, WantSnapshot) for message in worker.received) == 1


@pytest.mark.usefixtures("quick_ticks")
async def test_the_backlog_goes_to_history_alone_and_is_no_gap(stage: Stage) -> None:
    worker = await stage.worker(state=snapshot(seq=7))
    old = reading(1, 42)
    await worker.send(Batch(seq=5, sent_at=time.time(), updates=[old], live=False))
    await worker.receive(Delivered)
    assert stage.history.readings == [old]
    assert _commanded(stage) == 1000
    await worker.update(reading(1, 8))
    await until(lambda: _commanded(stage) == 8, "the live reading")
    assert not any(isinstance(message, WantSnapshot) for message in worker.received)
    await stage.recorder.recorded()
    events, _ = await stage.events.page(Filter(code="event_readings_late"), 10)
    assert [event["messages"]["what"].params["count"] for event in events] == [1]


@pytest.mark.usefixtures("quick_ticks")
async def test_the_same_worker_gets_its_last_number(stage: Stage) -> None:
    worker = await stage.worker()
    await worker.update(reading(1, 5))
    await worker.receive(Delivered)
    await worker.leave()
    back = await stage.connect()
    await back.send(hello())
    welcome = await back.receive(Welcome)
    assert isinstance(welcome, Welcome)
    assert welcome.seq == 1


@pytest.mark.usefixtures("quick_ticks")
async def test_another_worker_begins_at_zero(stage: Stage) -> None:
    worker = await stage.worker()
    await worker.update(reading(1, 5))
    await worker.receive(Delivered)
    await worker.leave(GOING_AWAY)
    stranger = await stage.connect()
    await stranger.send(hello("w2"))
    welcome = await stranger.receive(Welcome)
    assert isinstance(welcome, Welcome)
    assert (welcome.version, welcome.seq, welcome.refused) == (CONTRACT_VERSION, 0, "")


async def refused(stage: Stage, worker: str = "w2", name: str = "") -> str:
    """Why a worker is refused; empty where it is admitted."""
    other = await stage.connect(name=name)
    await other.send(hello(worker))
    welcome = await other.receive(Welcome)
    assert isinstance(welcome, Welcome)
    if welcome.refused:
        await other.gone()
    return welcome.refused


async def test_a_second_worker_is_refused_while_the_first_lives(stage: Stage) -> None:
    holder = await stage.worker(state=snapshot(link="closed"))
    assert "another worker has this bus" in await refused(stage)
    assert "another worker has this bus" in await refused(stage, name="other")
    await holder.update(reading(1, 7))
    await until(lambda: _commanded(stage) == 7, "the holder's reading")


async def test_a_refusal_is_an_event_that_names_both_tokens_and_addresses(stage: Stage) -> None:
    await stage.worker(name="cabinet-3")
    await refused(stage, name="laptop")
    await stage.recorder.recorded()
    found, _ = await stage.events.page(Filter(kind="worker"), 1)
    assert (found[0]["what"], found[0]["bus"]) == ("bus worker refused", "dry-end")
    assert (found[0]["old"], found[0]["new"]) == ("cabinet-3 (127.0.0.1)", "laptop (127.0.0.1)")
    assert "another worker has this bus" in found[0]["message"]


async def test_a_worker_that_vanished_may_come_back_before_another_gets_its_bus(stage: Stage) -> None:
    worker = await stage.worker()
    await worker.leave()
    assert "a moment ago" in await refused(stage, name="other")
    back = await stage.worker()
    await back.leave()
    await until(lambda: not stage.live.buses["dry-end"].worker_connected, "the loss")
    stage.skipped_s += Ending.LOST.value
    assert await refused(stage, name="other") == ""


async def test_a_worker_that_announces_its_end_releases_its_bus(stage: Stage) -> None:
    worker = await stage.worker()
    await worker.leave(GOING_AWAY)
    assert await refused(stage, name="other") == ""


async def test_a_worker_that_stands_still_keeps_its_bus(tmp_path: Path) -> None:
    """Suspended for 8 s, it lost its bus to another worker, and forged results were taken for verified."""
    async with staged(tmp_path, missed_ticks=1) as stage:
        worker = await stage.worker()
        await worker.gone()
        stage.skipped_s += Ending.LOST.value + 1
        assert "a moment ago" in await refused(stage, name="other")
        back = await stage.worker()
        await back.gone()
        await until(lambda: not stage.live.buses["dry-end"].worker_connected, "the loss")
        stage.skipped_s += Ending.CUT.value
        assert await refused(stage, name="other") == ""


async def test_the_servers_own_worker_without_a_port_makes_room_and_takes_none(stage: Stage) -> None:
    """The child of a bus whose port is on another machine."""
    child = await stage.worker(state=snapshot(link="closed"), name=OWN_WORKER)
    remote = await stage.worker(hello("w2"))
    await child.gone()
    assert "another worker has this bus" in await refused(stage, "w1", OWN_WORKER)
    await remote.update(reading(1, 9))
    await until(lambda: _commanded(stage) == 9, "the remote worker's reading")


async def test_the_servers_own_worker_keeps_the_bus_once_its_port_was_open(stage: Stage) -> None:
    child = await stage.worker(name=OWN_WORKER)
    await child.update(BusLink(at=time.time(), link="closed", cause=term("gone")))
    await until(lambda: stage.live.buses["dry-end"].link.link == "closed", "the port closed")
    assert "another worker has this bus" in await refused(stage)
    await child.leave()
    await until(lambda: not stage.live.buses["dry-end"].worker_connected, "the loss")
    assert "a moment ago" in await refused(stage)
    assert await refused(stage, "w3", OWN_WORKER) == "", "its successor starts after its end"


async def test_a_child_responds_while_it_is_linked_or_refused(stage: Stage) -> None:
    def responds() -> list[bool]:
        return [stage.workers.responds("dry-end") for _ in range(3)]

    assert responds() == [False, False, False]
    child = await stage.worker(state=snapshot(link="closed"), name=OWN_WORKER)
    assert responds() == [True, True, True]
    await stage.worker(hello("w2"))
    await child.gone()
    assert responds() == [False, False, False], "the link of another worker is no sign of the child"
    await refused(stage, "w1", OWN_WORKER)
    assert responds() == [True, False, False]


async def test_of_two_that_come_at_once_one_gets_the_bus(stage: Stage) -> None:
    both = await asyncio.gather(refused(stage, "w1", "a"), refused(stage, "w2", "b"))
    assert sorted(map(bool, both)) == [False, True]


async def test_a_lost_worker_closes_the_bus_and_nothing_looks_fresh(stage: Stage) -> None:
    worker = await stage.worker()
    await worker.leave()
    await until(lambda: not stage.live.buses["dry-end"].worker_connected, "the loss")
    line = (await stage.http().get("/api/v1/line")).json()["buses"][0]
    assert line["link"] == "closed"
    assert line["link_cause"]["detail"] == "the bus worker is not connected"
    assert {unit["link"] for unit in line["units"]} == {"stale"}
    result = await stage.request("POST", "/units/1/speed", {"raw": 5})
    assert result.status_code == 503
    assert result.json()["code"] == "bus_closed"


async def test_a_worker_without_messages_is_taken_for_lost(tmp_path: Path) -> None:
    async with staged(tmp_path, missed_ticks=1) as stage:
        worker = await stage.worker()
        closed = await worker.gone()
        assert closed.rcvd is not None
        assert "does not respond" in closed.rcvd.reason
        await until(lambda: not stage.live.buses["dry-end"].worker_connected, "the loss")
        assert stage.live.buses["dry-end"].link.cause == Message("worker_silent")


async def test_times_of_a_worker_with_another_clock_are_shifted(stage: Stage) -> None:
    ahead = 3600.0
    worker = await stage.connect()
    bus_name = hello()
    await worker.send(type(bus_name)(**{**_fields(bus_name), "sent_at": bus_name.sent_at + ahead}))
    await worker.receive(Welcome)
    present = snapshot()
    await worker.send(type(present)(**{**_fields(present), "sent_at": present.sent_at + ahead}))
    late = reading(1, 11)
    shifted = type(late)(**{**_fields(late), "at": late.at + ahead})
    await worker.send(Batch(seq=1, sent_at=time.time() + ahead, updates=[shifted]))
    await until(lambda: _commanded(stage) == 11, "the reading")
    found = stage.live.buses["dry-end"].units[1].reading
    assert found is not None
    assert abs(found.at - late.at) < 60


async def test_a_command_under_way_is_repeated_to_the_same_worker(stage: Stage) -> None:
    worker = await stage.worker()
    sending = asyncio.create_task(stage.request("POST", "/units/1/speed", {"raw": 5}))
    first = await worker.receive(Command)
    assert isinstance(first, Command)
    await worker.leave()
    back = await stage.connect()
    await back.send(hello())
    await back.send(snapshot())
    again = await back.receive(Command)
    assert again == first
    await back.update(result_of(first, "verified", read_back=5))
    assert (await sending).status_code == 200


async def test_a_command_under_way_is_unverified_with_another_worker(stage: Stage) -> None:
    worker = await stage.worker()
    sending = asyncio.create_task(stage.request("POST", "/units/1/speed", {"raw": 5}))
    await worker.receive(Command)
    await worker.leave(GOING_AWAY)
    stranger = await stage.worker(hello("w2"))
    result = await sending
    assert result.status_code == 504
    assert "restarted" in result.json()["detail"]
    assert stranger.commands == []


async def test_watched_units_are_sent_to_every_new_worker(stage: Stage) -> None:
    stage.feed.watch([2, 1], True)
    worker = await stage.worker()
    assert await worker.receive(Watch) == Watch(units=[1, 2], trace=True)
    stage.feed.watch([], False)
    assert await worker.receive(Watch, 2) == Watch(units=[], trace=False)


def _commanded(stage: Stage) -> int | None:
    found = stage.live.buses["dry-end"].units[1].reading
    return found.commanded if found is not None else None


def _fields(message: object) -> dict[str, object]:
    return {name: getattr(message, name) for name in message.__struct_fields__}  # type: ignore[attr-defined]


A = Credential("a", "dry-end", "192.0.2.1")
B = Credential("b", "dry-end", "192.0.2.2")
OWN = Credential("worker", "dry-end", "127.0.0.1", own=True)


@pytest.mark.parametrize("ending", Ending)
def test_a_bus_is_reserved_for_as_long_as_its_ending_allows(ending: Ending) -> None:
    holder = Holder("w1", A)
    assert not holder.yields_to("w2", A, 1e9), "while it is connected, another is always refused"
    holder.connection_ended(ending, 100.0)
    for credential in (A, B):
        assert not holder.yields_to("w2", credential, 99.9 + ending.value)
        assert holder.yields_to("w2", credential, 100.0 + ending.value)


def test_the_same_process_may_return_at_any_time_and_only_by_its_own_token() -> None:
    holder = Holder("w1", A)
    assert holder.yields_to("w1", A, 0.0)
    assert not holder.yields_to("w1", B, 0.0), "a worker's id is no secret"


@pytest.mark.parametrize(("port_seen", "yields"), [(False, True), (True, False)])
def test_a_child_yields_to_a_worker_elsewhere_until_its_port_was_open(port_seen: bool, yields: bool) -> None:
    holder = Holder("w1", OWN, port_seen)
    assert holder.yields_to("w2", A, 0.0) is yields
    assert not holder.yields_to("w2", OWN, 0.0)


@pytest.mark.parametrize("port_seen", [False, True])
def test_a_childs_successor_need_not_wait(port_seen: bool) -> None:
    holder = Holder("w1", OWN, port_seen)
    holder.connection_ended(Ending.CUT, 100.0)
    assert holder.yields_to("w2", OWN, 100.0)
    assert holder.yields_to("w2", A, 100.0) is not port_seen


def test_a_worker_elsewhere_never_yields_to_a_child() -> None:
    holder = Holder("w1", A)
    assert not holder.yields_to("w2", OWN, 0.0)


def unread() -> WebSocket:
    """A WebSocket whose peer reads nothing: every send waits."""

    async def receive() -> AsgiMessage:
        return await asyncio.Future()

    async def send(_: AsgiMessage) -> None:
        await asyncio.Future()

    made = WebSocket({"type": "websocket", "path": "/feed", "headers": []}, receive, send)
    made.client_state = made.application_state = WebSocketState.CONNECTED
    return made


@pytest.fixture(autouse=True)
def soon(monkeypatch: pytest.MonkeyPatch) -> None:
    """The limit is over at once."""
    monkeypatch.setattr(sockets, "SEND_WITHIN_S", 0.0)


async def test_a_send_without_a_reader_ends_as_a_lost_connection() -> None:
    async with asyncio.timeout(60):
        with pytest.raises(ConnectionError):
            await WorkerSocket(unread()).send(ClockSync(app_time=1.0))


async def test_neither_does_its_close_wait() -> None:
    async with asyncio.timeout(60):
        await WorkerSocket(unread()).close("enough")
