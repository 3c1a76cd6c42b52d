"""Workers on the real WebSocket, and commands on their way down: order, losses, refusals, and who has a
bus."""

from __future__ import annotations

import asyncio
import time

import msgspec
import pytest
from starlette.types import Message as AsgiMessage
from starlette.websockets import WebSocket, WebSocketState

from app.core.database import Database
from app.core.web.access import Person, Role
from app.line.feed import bus_feed
from app.line.feed import channel as channels
from app.line.feed import socket as sockets
from app.line.feed.bus_feed import Credential, Ending, HeldSpeeds, Holder
from app.line.feed.channel import STUCK_AFTER_LOOKS, Channel
from app.line.feed.socket import GOING_AWAY, Workers, WorkerSocket
from app.line.live.bus_live import bus_without_reports, held_units
from app.line.pipeline import OTHER_RELEASE
from app.people.audit.log import Filter
from bus.contract import (
    CONTRACT_VERSION,
    Action,
    AppMessage,
    Batch,
    BusLink,
    ClockSync,
    Command,
    Delivered,
    Progress,
    Result,
    SetLine,
    SetSpeed,
    Staged,
    WantSnapshot,
    Watch,
    Welcome,
)
from bus.instants import Monotonic, monotonic_now, unix_now
from bus.messages import Message, term
from tests.app.complete_app import OWN_WORKER, House
from tests.app.conftest import Kept
from tests.app.fake_worker import HandshakeRefused, hello, reading, responding, result_of, snapshot, until
from tests.for_each import for_each

ANNA = Person("anna", Role.ENGINEER, "token")


@pytest.fixture
def quick_ticks(monkeypatch: pytest.MonkeyPatch) -> None:
    """The app confirms what it received with a tick, which is otherwise once a second."""
    monkeypatch.setattr(bus_feed, "TICK_S", 0.02)


@for_each("role", ["", "viewer", "operator", "engineer", "admin"])
async def test_only_a_worker_is_let_in(site: House, role: str) -> None:
    with pytest.raises(HandshakeRefused):
        await site.connect(role)


async def test_a_worker_without_a_bus_is_not_let_in(site: House) -> None:
    with pytest.raises(HandshakeRefused) as refused:
        await site.connect(bus="")
    assert refused.value.status == 403
    assert b"--bus BUS" in refused.value.body


@pytest.mark.parametrize(("of_token", "bus_name"), [("dry-end", "wet-end"), ("wet-end", "dry-end")])
async def test_a_token_speaks_for_its_own_bus_only(site: House, of_token: str, bus_name: str) -> None:
    worker = await site.connect(bus=of_token)
    await worker.send(hello(bus=bus_name))
    welcome = await worker.receive(Welcome)
    assert isinstance(welcome, Welcome)
    assert welcome.refused == f"the token is for bus {of_token}; create one for the bus of this worker"
    await worker.gone()


async def test_a_bus_that_is_not_configured_any_more_is_refused_in_words(site: House) -> None:
    worker = await site.connect(bus="wet-end")
    await worker.send(hello(bus="wet-end"))
    welcome = await worker.receive(Welcome)
    assert isinstance(welcome, Welcome)
    assert "no [[bus]] is called wet-end" in welcome.refused
    assert "dry-end" in welcome.refused
    await worker.gone()


@for_each("version", [5, 99])
async def test_a_worker_of_another_release_is_refused_with_the_command_that_upgrades_it(
    site: House, version: int
) -> None:
    worker = await site.connect()
    # What version 0.2 sent; the epoch that it named is no field any more.
    hello_of_other = msgspec.structs.asdict(hello(version=version)) | {"is": "hello", "epoch": 3}
    await worker.send_raw(msgspec.msgpack.encode(hello_of_other))
    welcome = await worker.receive(Welcome)
    assert isinstance(welcome, Welcome)
    assert "pip install ./lineside-*.whl" in welcome.refused
    await worker.gone()
    bus = site.live
    assert bus.link.cause is not None
    assert (bus.worker_connected, bus.link.link, bus.link.cause.code) == (False, "closed", OTHER_RELEASE)
    assert bus.link.cause.params["version"] == version


async def test_noise_later_ends_it_and_nothing_of_it_is_applied(site: House) -> None:
    worker = await site.worker()
    await worker.send_raw(b"\x00\x01\x02")
    await worker.gone()
    await until(lambda: site.live.link.link == "closed", "the bus closed")
    assert site.live.link.cause == Message("worker_malformed")


async def test_a_batch_before_the_snapshot_ends_it(site: House) -> None:
    worker = await site.connect()
    await worker.send(hello())
    await worker.receive(Welcome)
    await worker.update(reading(1, 777))
    await worker.gone()
    assert site.live.units[1].reading is None


async def take_over(site: House, held: list[int]) -> None:
    """Connect a new worker, which is told what units may hold a staged speed, and report for it."""
    second = await site.connect()
    await second.send(hello("w2"))
    welcome = await second.receive(Welcome)
    assert isinstance(welcome, Welcome)
    assert welcome.held == held
    await second.send(snapshot())


async def test_what_units_may_hold_staged_outlives_worker_and_server(site: House) -> None:
    worker, live, database = await site.worker(), site.live, site.services[Database]
    kept = "SELECT unit FROM held_speed"

    def stored() -> list[int]:
        return [unit for (unit,) in database.read_now(lambda connection: connection.execute(kept).fetchall())]

    now = unix_now()
    await worker.update(Staged(1, now, 300), Staged(2, now, None, unknown=True))
    await until(lambda: stored() == [1, 2], "both units stored")
    restarted = bus_without_reports(live.settings, unix_now())
    await HeldSpeeds(restarted, database).load()
    assert held_units(restarted) == [1, 2]
    assert restarted.units[1].staged_unknown
    await worker.leave(GOING_AWAY)
    settings = live.settings.model_copy(update={"unit": live.settings.unit[1:]})
    without_1 = HeldSpeeds(bus_without_reports(settings, unix_now()), database)
    await without_1.load()
    assert without_1.units == [1, 2], "a unit that was taken out of the configuration may still be on the bus"
    await take_over(site, held=[1, 2])
    await until(lambda: stored() == [], "both units removed, as this worker knows what they hold")


@pytest.mark.parametrize("change", [SetSpeed(unit=1, raw=300, execute=False), SetLine(setpoints={1: 300})])
async def test_a_unit_may_hold_what_was_staged_and_never_reported(site: House, change: Action) -> None:
    """Whichever of worker and server ends before the response: the next broadcast would execute it."""
    worker, database = await site.worker(), site.services[Database]
    sending = asyncio.create_task(site.commands.send(ANNA, change))
    await worker.receive(Command)
    server_ends_now = bus_without_reports(site.live.settings, unix_now())
    await HeldSpeeds(server_ends_now, database).load()
    assert server_ends_now.units[1].staged_unknown
    await worker.leave(GOING_AWAY)
    await take_over(site, held=[1])
    assert (await sending).outcome == "unverified"
    assert site.live.units[1].staged_unknown


async def test_a_unit_holds_nothing_once_a_worker_has_reported_that(site: House) -> None:
    worker, database = await site.worker(), site.services[Database]
    worker.play = responding("refused", unit_error=129)
    await site.commands.send(ANNA, SetSpeed(unit=1, raw=300, execute=False))
    assert held_units(site.live) == []

    def stored() -> object:
        return database.read_now(lambda connection: connection.execute("SELECT 1 FROM held_speed").fetchone())

    await until(lambda: stored() is None, "nothing stored")


@pytest.mark.usefixtures("quick_ticks")
async def test_readings_arrive_and_are_confirmed(site: House) -> None:
    worker = await site.worker()
    await worker.update(reading(1, 1234))
    await until(lambda: _commanded(site) == 1234, "the reading")
    delivered = await worker.receive(Delivered)
    assert delivered == Delivered(seq=1)
    await worker.receive(ClockSync)


async def test_a_doubled_batch_counts_once(site: House, kept: Kept) -> None:
    worker = await site.worker()
    batch = Batch(seq=1, sent_at=time.time(), updates=[reading(1, 5)])
    await worker.send(batch)
    await worker.send(batch)
    worker.seq = 1
    await worker.update(reading(1, 6))
    await until(lambda: _commanded(site) == 6, "the last reading")
    assert len(kept.readings) == 2


async def test_a_missing_number_requests_a_snapshot_once(site: House) -> None:
    worker = await site.worker()
    worker.seq = 4
    await worker.update(reading(1, 5))
    await worker.update(reading(1, 6))
    await worker.receive(WantSnapshot)
    await worker.send(snapshot(seq=6))
    await worker.update(reading(1, 7))
    await until(lambda: _commanded(site) == 7, "the reading after the snapshot")
    assert sum(isinstance(message, WantSnapshot) for message in worker.received) == 1


@pytest.mark.usefixtures("quick_ticks")
async def test_the_backlog_goes_to_history_alone_and_is_no_gap(site: House, kept: Kept) -> None:
    worker = await site.worker(state=snapshot(seq=7))
    old = msgspec.structs.replace(reading(1, 42), at=time.time() - 60)
    await worker.send(Batch(seq=5, sent_at=time.time(), updates=[old], live=False))
    await worker.receive(Delivered)
    assert kept.readings == [old]
    assert _commanded(site) == 1000
    await worker.update(reading(1, 8))
    await until(lambda: _commanded(site) == 8, "the live reading")
    assert not any(isinstance(message, WantSnapshot) for message in worker.received)
    await site.recorder.recorded()
    events, _ = await site.log.page(Filter(code="event_readings_late"), 10)
    assert [event["messages"]["what"].params["count"] for event in events] == [1]


@pytest.mark.usefixtures("quick_ticks")
async def test_the_same_worker_gets_its_last_number(site: House) -> None:
    worker = await site.worker()
    await worker.update(reading(1, 5))
    await worker.receive(Delivered)
    await worker.leave()
    back = await site.connect()
    await back.send(hello())
    welcome = await back.receive(Welcome)
    assert isinstance(welcome, Welcome)
    assert welcome.seq == 1


@pytest.mark.usefixtures("quick_ticks")
async def test_another_worker_begins_at_zero(site: House) -> None:
    worker = await site.worker()
    await worker.update(reading(1, 5))
    await worker.receive(Delivered)
    await worker.leave(GOING_AWAY)
    stranger = await site.connect()
    await stranger.send(hello("w2"))
    welcome = await stranger.receive(Welcome)
    assert isinstance(welcome, Welcome)
    assert (welcome.version, welcome.seq, welcome.refused) == (CONTRACT_VERSION, 0, "")


def pass_s(site: House, seconds: float) -> None:
    """Set the clock by which a bus is kept for its worker ahead of the real one."""
    site.feed.monotonic = lambda: Monotonic(monotonic_now() + seconds)


async def silent_worker(site: House) -> str:
    """Connect a worker that sends nothing more, and wait for its end; return the reason."""
    site.feed.timeout_ticks = 1000
    worker = await site.worker()
    site.feed.timeout_ticks = 1
    reason = await worker.gone()
    await until(lambda: not site.live.worker_connected, "the loss")
    site.feed.timeout_ticks = 1000
    return reason


async def refused(site: House, worker: str = "w2", name: str = "") -> str:
    """Why a worker is refused; empty where it is admitted."""
    other = await site.connect(name=name)
    await other.send(hello(worker))
    welcome = await other.receive(Welcome)
    assert isinstance(welcome, Welcome)
    if welcome.refused:
        await other.gone()
    return welcome.refused


async def test_a_refusal_is_an_event_that_names_both_tokens_and_addresses(site: House) -> None:
    await site.worker(name="cabinet-3")
    await refused(site, name="laptop")
    await site.recorder.recorded()
    found, _ = await site.log.page(Filter(kind="worker"), 1)
    assert (found[0]["what"], found[0]["bus"]) == ("bus worker refused", "dry-end")
    assert (found[0]["old"], found[0]["new"]) == ("cabinet-3 (127.0.0.1)", "laptop (127.0.0.1)")
    assert "another worker has this bus" in found[0]["message"]


async def test_a_worker_that_vanished_may_come_back_before_another_gets_its_bus(site: House) -> None:
    worker = await site.worker()
    await worker.leave()
    assert "a moment ago" in await refused(site, name="other")
    back = await site.worker()
    await back.leave()
    await until(lambda: not site.live.worker_connected, "the loss")
    pass_s(site, Ending.LOST.value)
    assert await refused(site, name="other") == ""


async def test_a_worker_that_announces_its_end_releases_its_bus(site: House) -> None:
    worker = await site.worker()
    await worker.leave(GOING_AWAY)
    assert await refused(site, name="other") == ""


@pytest.mark.usefixtures("quick_ticks")
async def test_a_worker_that_stands_still_keeps_its_bus(site: House) -> None:
    """Suspended for 8 s, it lost its bus to another worker, and forged results were taken for verified."""
    await silent_worker(site)
    pass_s(site, Ending.LOST.value + 1)
    assert "a moment ago" in await refused(site, name="other")
    await silent_worker(site)
    pass_s(site, Ending.LOST.value + 1 + Ending.CUT.value)
    assert await refused(site, name="other") == ""


async def test_the_servers_own_worker_without_a_port_makes_room_and_takes_none(site: House) -> None:
    """The child of a bus whose port is on another machine."""
    child = await site.worker(state=snapshot(link="closed"), name=OWN_WORKER)
    remote = await site.worker(hello("w2"))
    await child.gone()
    assert "another worker has this bus" in await refused(site, "w1", OWN_WORKER)
    await remote.update(reading(1, 9))
    await until(lambda: _commanded(site) == 9, "the remote worker's reading")


async def test_the_servers_own_worker_keeps_the_bus_once_its_port_was_open(site: House) -> None:
    child = await site.worker(name=OWN_WORKER)
    await child.update(BusLink(at=time.time(), link="closed", cause=term("gone")))
    await until(lambda: site.live.link.link == "closed", "the port closed")
    assert "another worker has this bus" in await refused(site)
    await child.leave()
    await until(lambda: not site.live.worker_connected, "the loss")
    assert "a moment ago" in await refused(site)
    assert await refused(site, "w3", OWN_WORKER) == "", "its successor starts after its end"


async def test_a_child_responds_while_it_is_linked_or_refused(site: House) -> None:
    def responds() -> list[bool]:
        return [site.services[Workers].responds("dry-end") for _ in range(3)]

    assert responds() == [False, False, False]
    child = await site.worker(state=snapshot(link="closed"), name=OWN_WORKER)
    assert responds() == [True, True, True]
    await site.worker(hello("w2"))
    await child.gone()
    assert responds() == [False, False, False], "the link of another worker is no sign of the child"
    await refused(site, "w1", OWN_WORKER)
    assert responds() == [True, False, False]


async def test_of_two_that_come_at_once_one_gets_the_bus(site: House) -> None:
    both = await asyncio.gather(refused(site, "w1", "a"), refused(site, "w2", "b"))
    assert sorted(map(bool, both)) == [False, True]


async def test_a_lost_worker_closes_the_bus_and_nothing_looks_fresh(site: House) -> None:
    worker = await site.worker()
    await worker.leave()
    await until(lambda: not site.live.worker_connected, "the loss")
    line = (await site.http().get("/api/v1/line")).json()["buses"][0]
    assert line["link"] == "closed"
    assert line["link_cause"]["detail"] == "the bus worker is not connected"
    assert {unit["link"] for unit in line["units"]} == {"stale"}
    result = await site.request("POST", "/units/1/speed", {"raw": 5})
    assert result.status_code == 503
    assert result.json()["code"] == "bus_closed"


@pytest.mark.usefixtures("quick_ticks")
async def test_a_worker_without_messages_is_taken_for_lost(site: House) -> None:
    assert "does not respond" in await silent_worker(site)
    assert site.live.link.cause == Message("worker_silent")


async def test_times_of_a_worker_with_another_clock_are_shifted(site: House) -> None:
    ahead = 3600.0
    worker = await site.connect()
    bus_name = hello()
    await worker.send(type(bus_name)(**{**_fields(bus_name), "sent_at": bus_name.sent_at + ahead}))
    await worker.receive(Welcome)
    present = snapshot()
    await worker.send(type(present)(**{**_fields(present), "sent_at": present.sent_at + ahead}))
    late = reading(1, 11)
    shifted = type(late)(**{**_fields(late), "at": late.at + ahead})
    await worker.send(Batch(seq=1, sent_at=time.time() + ahead, updates=[shifted]))
    await until(lambda: _commanded(site) == 11, "the reading")
    found = site.live.units[1].reading
    assert found is not None
    assert abs(found.at - late.at) < 60


async def test_a_command_under_way_is_repeated_to_the_same_worker(site: House) -> None:
    worker = await site.worker()
    sending = asyncio.create_task(site.request("POST", "/units/1/speed", {"raw": 5}))
    first = await worker.receive(Command)
    assert isinstance(first, Command)
    await worker.leave()
    back = await site.connect()
    await back.send(hello())
    await back.send(snapshot())
    again = await back.receive(Command)
    assert again == first
    await back.update(result_of(first, "verified", read_back=5))
    assert (await sending).status_code == 200


async def test_a_command_under_way_is_unverified_with_another_worker(site: House) -> None:
    worker = await site.worker()
    sending = asyncio.create_task(site.request("POST", "/units/1/speed", {"raw": 5}))
    await worker.receive(Command)
    await worker.leave(GOING_AWAY)
    stranger = await site.worker(hello("w2"))
    result = await sending
    assert result.status_code == 504
    assert "restarted" in result.json()["detail"]
    assert stranger.commands == []


async def test_watched_units_are_sent_to_every_new_worker(site: House) -> None:
    site.feed.watch([2, 1], True)
    worker = await site.worker()
    assert await worker.receive(Watch) == Watch(units=[1, 2], trace=True)
    site.feed.watch([], False)
    assert await worker.receive(Watch, 2) == Watch(units=[], trace=False)


def _commanded(site: House) -> int | None:
    found = site.live.units[1].reading
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


@pytest.mark.parametrize("port_seen", [False, True])
def test_a_childs_successor_need_not_wait(port_seen: bool) -> None:
    holder = Holder("w1", OWN, port_seen)
    holder.connection_ended(Ending.CUT, 100.0)
    assert holder.yields_to("w2", OWN, 100.0)
    assert holder.yields_to("w2", A, 100.0) is not port_seen


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


COMMAND = Command(id="a", deadline=0.0, action=SetSpeed(unit=1, raw=5))


class Connection:
    """Remembers what was sent; ``broken``: the other end is gone."""

    def __init__(self, *, broken: bool = False) -> None:
        self.sent: list[AppMessage] = []
        self.broken = broken

    async def send(self, message: AppMessage) -> None:
        """Raises ConnectionError."""
        if self.broken:
            raise ConnectionError("gone")
        self.sent.append(message)


def verified() -> Result:
    return Result(id="a", at=1.0, outcome="verified")


async def test_without_a_worker_nothing_is_sent() -> None:
    result = await Channel().send(COMMAND)
    assert result.outcome == "bus_closed"


async def test_a_worker_without_a_result_leaves_it_unverified() -> None:
    channel, connection = Channel(patience_s=0.0), Connection()
    await channel.opened(connection, "w")
    result = await channel.send(COMMAND)
    assert (result.id, result.outcome) == ("a", "unverified")
    assert connection.sent == [COMMAND]


@pytest.fixture
def quick_looks(monkeypatch: pytest.MonkeyPatch) -> float:
    """Seconds from look to look."""
    monkeypatch.setattr(channels, "LOOK_S", 0.01)
    return 0.01


@pytest.mark.usefixtures("quick_looks")
async def test_the_wait_for_a_worker_ends_at_the_deadline() -> None:
    channel = Channel()
    await channel.opened(Connection(), "w")
    result = await channel.send(COMMAND)
    assert result.outcome == "unverified"
    assert result.message == Message("worker_no_response")


async def test_a_worker_that_speaks_of_other_things_is_waited_for(quick_looks: float) -> None:
    channel, connection = Channel(), Connection()
    await channel.opened(connection, "w")
    sending = asyncio.create_task(channel.send(COMMAND))
    for _ in range(3 * STUCK_AFTER_LOOKS):
        channel.on_message()
        assert not (await asyncio.wait({sending}, timeout=quick_looks))[0]
    channel.on_update(verified(), connection)
    assert (await sending).outcome == "verified"


async def test_a_worker_that_does_not_come_back_leaves_it_unverified() -> None:
    channel, connection = Channel(reask_s=0.0), Connection(broken=True)
    await channel.opened(connection, "w")
    result = await channel.send(COMMAND)
    assert result.outcome == "unverified"
    assert not channel.connected
    assert (await channel.send(COMMAND)).outcome == "bus_closed"


async def test_a_broken_send_is_repeated_to_the_same_worker() -> None:
    channel, back = Channel(), Connection()
    await channel.opened(Connection(broken=True), "w")
    sending = asyncio.create_task(channel.send(COMMAND))
    await asyncio.sleep(0)
    await channel.opened(back, "w")
    channel.on_update(verified(), back)
    assert (await sending).outcome == "verified"
    assert back.sent == [COMMAND]


async def test_the_first_result_counts_and_old_updates_are_ignored() -> None:
    channel, connection = Channel(), Connection()
    await channel.opened(connection, "w")
    sending = asyncio.create_task(channel.send(COMMAND))
    await asyncio.sleep(0)
    channel.on_update(verified(), connection)
    channel.on_update(Result(id="a", at=2.0, outcome="refused"), connection)
    channel.on_update(Progress(id="a", at=2.0, stage="sent"), connection)
    channel.on_update(Progress(id="nobody", at=2.0, stage="sent"), connection)
    assert (await sending).outcome == "verified"
    channel.on_update(verified(), connection)


async def test_a_result_counts_only_from_the_connection_that_the_command_was_sent_to() -> None:
    channel, connection, other = Channel(patience_s=0.2), Connection(), Connection()
    await channel.opened(connection, "w")
    sending = asyncio.create_task(channel.send(COMMAND))
    await asyncio.sleep(0)
    channel.on_update(verified(), other)
    await channel.opened(other, "w")
    channel.on_update(verified(), connection)
    assert (await sending).outcome == "unverified"
    assert connection.sent == other.sent == [COMMAND]


async def test_a_send_that_fails_late_does_not_close_the_connection_that_came_meanwhile() -> None:
    class Slow(Connection):
        async def send(self, message: AppMessage) -> None:
            self.sent.append(message)
            await channel.opened(newer, "w")
            raise ConnectionError("gone")

    channel, newer = Channel(), Connection()
    await channel.opened(Slow(), "w")
    await channel.reserve()
    assert channel.connected


async def test_an_older_connection_that_ends_later_closes_nothing() -> None:
    channel, older, newer = Channel(), Connection(), Connection()
    await channel.opened(older, "w")
    await channel.opened(newer, "w")
    channel.closed(older)
    assert channel.connected


@pytest.mark.parametrize("units", [[], [2, 1]])
async def test_watched_units_are_sent_once_and_to_the_next_worker(units: list[int]) -> None:
    channel, connection, later = Channel(), Connection(), Connection()
    await channel.opened(connection, "w")
    await channel.watch(units, trace=False)
    await channel.watch(units, trace=False)
    await channel.opened(later, "w2")
    assert len(connection.sent) == len(later.sent) == bool(units)
