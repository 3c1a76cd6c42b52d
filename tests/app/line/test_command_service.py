"""From a request to the wire: recorded before it is sent, sent once, also where its id is repeated after a
restart."""

from __future__ import annotations

import asyncio
import hashlib
import sqlite3
import time
from collections.abc import Awaitable, Callable, Sequence
from typing import Any

import msgspec
import pytest

from app.core.database import Database
from app.core.web.access import Person, Role
from app.core.web.arrival import Deadline
from app.errors import Problem, StoreError
from app.line.commands import record
from app.line.commands.record import CommandRequest, without_secret
from app.line.commands.service import CommandService
from app.line.live.requests import key_of
from app.people.audit.entry import KeyRing
from app.people.audit.log import Filter
from bus.contract import (
    Action,
    Cancel,
    ChangeBaud,
    Command,
    FoundUnit,
    ReadParameters,
    Result,
    ScanBus,
    SetLine,
    SetSpeed,
    UnitOutcome,
    Update,
    WriteParameter,
)
from bus.messages import Message, term
from tests.app.complete_app import BUS, House
from tests.app.fake_worker import PlayedWorker, responding, result_of

ANNA = Person("anna", Role.ENGINEER, "token")
COMMAND = SetSpeed(unit=1, raw=5)


async def commands(site: House) -> list[dict[str, Any]]:
    """The commands in the events, newest first."""
    found, _ = await site.log.page(Filter(kind="command"), 100)
    return found


async def test_the_intent_is_on_disk_before_anything_is_sent(site: House, worker: PlayedWorker) -> None:
    seen: list[Any] = []

    async def play(command: Command) -> Sequence[Update]:
        seen.extend((event["what"], event["outcome"]) for event in await commands(site))
        return [result_of(command, "verified")]

    worker.play = play
    await site.commands.send(ANNA, COMMAND)
    assert seen == [("set speed", None)]
    assert (await commands(site))[0]["outcome"] == "verified"


async def test_an_outcome_that_cannot_be_stored_is_returned(
    site: House, worker: PlayedWorker, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def full(*_: object) -> None:
        raise StoreError(Message.of("system_error", error="the disk is full"))

    worker.play = responding("verified")
    monkeypatch.setattr(site.log, "conclude", full)
    assert (await site.commands.send(ANNA, COMMAND)).outcome == "verified"


async def test_the_outcome_is_stored_after_the_client_disconnects(site: House, worker: PlayedWorker) -> None:
    sending = asyncio.create_task(site.commands.send(ANNA, COMMAND, id="mine"))
    command = await worker.receive(Command)
    assert isinstance(command, Command)
    sending.cancel()
    await worker.update(result_of(command, "verified"))
    assert (await site.commands.send(ANNA, COMMAND, id="mine")).outcome == "verified"
    assert [event["outcome"] for event in await commands(site)] == ["verified"]
    assert len(worker.commands) == 1


async def test_a_client_that_lost_the_right_sends_nothing(site: House, worker: PlayedWorker) -> None:
    await withdraw(site, "rights withdrawn: the role was lowered; nothing more was sent")
    for action in (COMMAND, ReadParameters(unit=1, numbers=[6])):
        with pytest.raises(Problem, match="the role was lowered") as refused:
            await site.commands.send(ANNA, action)
        assert (refused.value.status, refused.value.code) == (403, "rights_withdrawn")
    assert worker.commands == []
    assert (await commands(site))[-1]["outcome"] == "rights_withdrawn"


async def block(site: House) -> str:
    await site.guards.block(ANNA, 2, "belt off")
    return "commands to unit 2 are blocked by anna: belt off"


async def withdraw(site: House, reason: str = "rights withdrawn") -> str:
    site.rights.withdrawn["anna"] = reason
    return reason


async def hand_over(site: House) -> str:
    site.guards.control.required = True
    site.guards.control.hand_over("", "ben", time.monotonic(), time.time(), by_force=True)
    return "ben has control of this line"


@pytest.mark.parametrize("cause", [block, withdraw, hand_over])
@pytest.mark.parametrize(
    "action", [ChangeBaud(baud=4800), SetLine(setpoints={1: 5, 2: 6})], ids=["baud", "line"]
)
async def test_a_long_command_is_given_up_when_it_may_not_go_on(
    site: House, worker: PlayedWorker, cause: Callable[[House], Awaitable[str]], action: Action
) -> None:
    sending = asyncio.create_task(
        site.commands.send(ANNA, action, deadline=Deadline.within(30), confirm=True, id="mine")
    )
    command = await worker.receive(Command)
    assert isinstance(command, Command)
    reason = await cause(site)
    assert await worker.receive(Cancel) == Cancel(command.id)
    await worker.update(result_of(command, "not_sent", message=term("given up: every unit is back")))
    assert str((await sending).message) == f"{reason}; given up: every unit is back"
    event = next(event for event in await commands(site) if event["unit"] is None)
    named = reason.replace("unit 2", "Unit 2")
    assert (event["outcome"], event["message"]) == ("not_sent", f"{named}; given up: every unit is back")


async def test_a_scan_is_shown_after_its_page_was_left_and_another_person_ends_it(
    site: House, worker: PlayedWorker, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("app.line.commands.pages.bus.SCAN_WAIT_S", 0.2)
    eva, scan = site.http("engineer", "eva"), f"/bus/{BUS}/scan"
    begun = await site.http("engineer").post(scan, data={"first": "1", "last": "99"})
    assert "End the address scan" in begun.text
    assert "Addresses 1 to 99 since" in (await eva.get(scan)).text
    look = asyncio.create_task(site.commands.send(ANNA, ScanBus(first=9, last=9)))
    await worker.receive(Command, 2)
    command, of_swap = sorted(worker.commands, key=lambda each: each.action == ScanBus(first=9, last=9))
    with pytest.raises(Problem):
        await site.commands.end_scans(Person("otto", Role.OPERATOR, "session"))
    assert (await eva.post(f"{scan}/end")).status_code == 204
    assert (await eva.post(f"{scan}/end")).status_code == 204
    assert await worker.receive(Cancel) == Cancel(command.id)
    found = [FoundUnit(3, 9600, "digimax", [], [])]
    message = term("canceled after 3 of 99 addresses")
    await worker.update(result_of(command, "unverified", message=message, found=found))
    async with asyncio.timeout(5):
        while site.commands.last_scan is None or site.commands.last_scan.result is None:  # noqa: ASYNC110
            await asyncio.sleep(0.01)
    shown = (await eva.get(scan)).text
    assert "1 address responded" in shown
    assert "eva ended the scan; canceled after 3 of 99 addresses" in shown
    event = next(event for event in await commands(site) if "addresses" in event["what"])
    assert event["message"].startswith("responded: address 3; eva ended the scan")
    await worker.update(result_of(of_swap, "verified"))
    await look
    acts, _ = await site.log.page(Filter(kind="bus", who="eva"), 100)
    assert [event["what"] for event in acts] == ["scan of addresses ended"]


@pytest.mark.parametrize("cause", [block, withdraw, hand_over])
async def test_what_changes_after_the_check_is_seen_before_the_command_is_sent(
    site: House, worker: PlayedWorker, cause: Callable[[House], Awaitable[str]]
) -> None:
    """What a unit was is stored between the check and the sending, and a disk may be slow."""
    reasons: list[str] = []

    async def keep(*_: object) -> None:
        reasons.append(await cause(site))

    worker.play = responding("verified")
    site.commands.on_write(keep)
    result = await site.commands.send(ANNA, WriteParameter(unit=2, number=6, raw=50))
    assert (result.outcome, str(result.message)) == ("not_sent", reasons[0])
    assert worker.commands == []
    event = (await commands(site))[-1]
    assert (event["outcome"], event["message"]) == ("not_sent", reasons[0].replace("unit 2", "Unit 2"))


async def test_checking_alone_sends_and_writes_nothing(site: House, worker: PlayedWorker) -> None:
    site.commands.check(ANNA, COMMAND)
    with pytest.raises(Problem) as refused:
        site.commands.check(ANNA, WriteParameter(unit=1, number=19, raw=0))
    assert (refused.value.status, refused.value.code) == (409, "dangerous")
    assert worker.commands == []
    assert await commands(site) == []


async def test_reads_before_a_write_come_first(site: House, worker: PlayedWorker) -> None:
    order: list[str] = []

    async def keep(person: Person, units: Sequence[int], parameters: bool) -> None:
        order.append(f"kept {person.name} {[*units]}{' for parameters' if parameters else ''}")

    async def play(command: Command) -> Sequence[Update]:
        order.append("sent")
        return [result_of(command, "verified")]

    worker.play = play
    site.commands.on_write(keep)
    await site.commands.send(ANNA, WriteParameter(unit=1, number=6, raw=50))
    await site.commands.send(ANNA, COMMAND)
    await site.commands.send(ANNA, ReadParameters(unit=1, numbers=[6]))
    kept = "kept anna [1]"
    assert order == [f"{kept} for parameters", "sent", kept, "sent", "sent"]


def restarted(site: House) -> CommandService:
    """The commands of a server that remembers nothing but what is on disk."""
    return site.commands_after_restart()


async def test_a_known_result_is_repeated_and_nothing_is_sent(site: House, worker: PlayedWorker) -> None:
    worker.play = responding("refused", unit_error=129, message=term("value above max"))
    first = await site.commands.send(ANNA, COMMAND, id="mine")
    again = await restarted(site).send(ANNA, COMMAND, id="mine")
    assert (again.outcome, again.unit_error, again.message) == ("refused", 129, term("value above max"))
    assert again.at == first.at
    assert len(worker.commands) == 1


async def test_what_was_open_at_the_restart_is_unverified_and_not_sent_again(
    site: House, worker: PlayedWorker
) -> None:
    open_still = asyncio.create_task(site.commands.send(ANNA, COMMAND, id="mine"))
    command = await worker.receive(Command)
    assert isinstance(command, Command)
    again = await restarted(site).send(ANNA, COMMAND, id="mine")
    assert (again.outcome, again.message) == ("unverified", Message("server_stopped"))
    await worker.update(result_of(command, "verified"))
    assert (await open_still).outcome == "verified"
    assert len(worker.commands) == 1


async def test_a_command_refused_before_sending_may_be_repeated(site: House, worker: PlayedWorker) -> None:
    dangerous = WriteParameter(unit=1, number=19, raw=0)

    worker.play = responding("verified")
    with pytest.raises(Problem):
        await site.commands.send(ANNA, dangerous, id="mine")
    confirmed = await restarted(site).send(ANNA, dangerous, confirm=True, id="mine")
    assert confirmed.outcome == "verified"
    assert len(worker.commands) == 1


async def test_a_form_is_known_as_sent_after_a_restart_too(site: House, worker: PlayedWorker) -> None:
    """A page judges a form by the line as it is only where its command was not sent."""
    worker.play = responding("verified")
    assert not (await site.commands.look_up(ANNA, "mine")).is_used
    await site.commands.send(ANNA, COMMAND, id="mine")
    again = restarted(site)
    assert [(await again.look_up(person, "mine")).is_used for person in (ANNA, BEN)] == [True, False]


BEN = Person("ben", Role.ENGINEER, "session")
SENDERS = [
    BEN,
    Person("anna", Role.ENGINEER, "session"),
    Person("anna", Role.ENGINEER, "token", created_at=5.0),
]
"""Others than ANNA, a token: another name, a user of the same name, and a later token of that name."""


@pytest.mark.parametrize("other", SENDERS)
async def test_a_key_is_its_senders_own(site: House, worker: PlayedWorker, other: Person) -> None:
    """Two who count their commands from 1 neither hinder each other nor see what became of the other's."""
    worker.play = responding("verified", read_back=5)
    await site.commands.send(ANNA, COMMAND, id="1")
    worker.play = responding("refused", unit_error=129)
    for commands in (site.commands, restarted(site)):
        first = await commands.send(other, SetSpeed(unit=2, raw=7), id="1")
        assert (first.id, first.outcome, first.read_back) == ("1", "refused", None)
        mine = await commands.send(ANNA, COMMAND, id="1")
        assert (mine.id, mine.outcome, mine.read_back) == ("1", "verified", 5)
    assert len(worker.commands) == 2


async def test_no_two_commands_have_the_same_id_at_the_worker(site: House, worker: PlayedWorker) -> None:
    """It repeats the result of an id that it knows: another sender's, or last week's."""
    worker.play = responding("verified")
    for person in (ANNA, *SENDERS):
        await site.commands.send(person, COMMAND, id="1")
    await site.services[Database].write(lambda connection: connection.execute("DELETE FROM idempotency"))
    await restarted(site).send(ANNA, COMMAND, id="1")
    assert len({command.id for command in worker.commands}) == len(SENDERS) + 2
    assert {key_of(command.id) for command in worker.commands} == {"1"}


async def test_two_requests_with_one_key_at_once_are_one_command(site: House, worker: PlayedWorker) -> None:
    worker.play = responding("verified", read_back=5)
    sending = [site.commands.send(ANNA, COMMAND, id="mine") for _ in range(5)]
    other = site.commands.send(ANNA, SetSpeed(unit=1, raw=6), id="mine")
    *same, refused = await asyncio.gather(*sending, other, return_exceptions=True)
    assert {result.read_back for result in same if isinstance(result, Result)} == {5}
    assert len(same) == 5
    assert isinstance(refused, Problem)
    assert refused.status == 422
    assert len(worker.commands) == 1


async def test_a_command_that_could_not_be_recorded_may_be_repeated(
    site: House, worker: PlayedWorker, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def full(*_: object, **__: object) -> list[int]:
        raise StoreError(Message.of("system_error", error="the disk is full"))

    worker.play = responding("verified")
    monkeypatch.setattr(site.log, "intend_together", full)
    with pytest.raises(StoreError):
        await site.commands.send(ANNA, COMMAND, id="mine")
    monkeypatch.undo()
    assert (await site.commands.send(ANNA, COMMAND, id="mine")).outcome == "verified"
    assert len(worker.commands) == 1


async def test_the_order_of_the_setpoints_is_not_part_of_the_command(
    site: House, worker: PlayedWorker
) -> None:
    worker.play = responding("verified")
    await site.commands.send(ANNA, SetLine(setpoints={1: 5, 2: 6}), id="mine")
    await restarted(site).send(ANNA, SetLine(setpoints={2: 6, 1: 5}), id="mine")
    assert len(worker.commands) == 1


def request(key: str | None, action: Action = COMMAND) -> CommandRequest:
    return CommandRequest("id", ANNA, "dry-end", action, deadline=0.0, origin="api", key=key)


class Table:
    """The table, at a time of the test's."""

    def __init__(self, site: House) -> None:
        self._database = site.services[Database]
        self._ring = site.log.keys.ring

    async def begin(self, request: CommandRequest, now: float, *, ends: bool = True) -> None:
        result = Result("id", now, "verified", read_back=17, units=[UnitOutcome(1, "verified", read_back=17)])

        def work(connection: sqlite3.Connection) -> None:
            record.begin_key(connection, request, self._ring, now)
            if ends:
                record.end_key(connection, request, without_secret(request.action, result))

        await self._database.write(work)

    async def knows(self, key: str) -> bool:
        found = await self._database.read(lambda c: record.find_key(c, ANNA.sender, key))
        return found is not None

    async def rows(self) -> list[tuple[object, ...]]:
        return await self._database.read(
            lambda c: [tuple(row) for row in c.execute("SELECT * FROM idempotency")]
        )


async def test_keys_are_forgotten_in_the_end(site: House) -> None:
    table = Table(site)
    await table.begin(request("old"), 0.0)
    await table.begin(request("new"), record.MAX_AGE_S + 1)
    assert not await table.knows("old")
    assert await table.knows("new")


async def test_a_sender_with_many_keys_forgets_its_own_oldest(
    site: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(record, "MAX_OF_A_SENDER", 10)
    table = Table(site)
    others = CommandRequest("id", BEN, "dry-end", COMMAND, deadline=0.0, origin="api", key="first")
    await table.begin(others, 0.0)
    await table.begin(request("open"), 0.5, ends=False)
    for number in range(20):
        await table.begin(request(str(number)), 1.0 + number)
    assert [await table.knows(str(number)) for number in (8, 9, 10, 19)] == [False, False, True, True]
    assert await table.knows("open"), "it may be under way"
    assert len(await table.rows()) == 12


async def test_a_command_without_a_key_is_not_kept(site: House, worker: PlayedWorker) -> None:
    worker.play = responding("verified")
    for key in (None, ""):
        for _ in range(2):
            await site.commands.send(ANNA, COMMAND, id=key)
    assert len(worker.commands) == 4
    assert await Table(site).rows() == []


async def test_nothing_of_a_secret_is_stored(site: House) -> None:
    table = Table(site)
    await table.begin(request("mine", WriteParameter(unit=1, number=21, raw=17)), 1.0)
    [(_, _, _, command, result)] = await table.rows()
    assert isinstance(result, bytes)
    assert b"17" not in result
    plain = hashlib.sha256(msgspec.json.encode(WriteParameter(unit=1, number=21, raw=17))).hexdigest()
    assert command != plain
    assert command != record.digest(KeyRing((b"x" * 32,)), "dry-end", WriteParameter(1, 21, 17))


async def test_a_result_that_cannot_be_read_is_unverified(site: House, worker: PlayedWorker) -> None:
    worker.play = responding("verified")
    await site.commands.send(ANNA, COMMAND, id="mine")
    await site.services[Database].write(lambda c: c.execute("UPDATE idempotency SET result = ?", (b"{",)))
    again = await restarted(site).send(ANNA, COMMAND, id="mine")
    assert (again.outcome, again.message) == ("unverified", record.UNREADABLE)
    assert len(worker.commands) == 1


async def test_a_newer_key_of_the_log_forgets_no_command(site: House, worker: PlayedWorker) -> None:
    worker.play = responding("verified")
    await site.commands.send(ANNA, COMMAND, id="mine")
    site.log.keys.rotate()
    assert (await restarted(site).send(ANNA, COMMAND, id="mine")).outcome == "verified"
    assert len(worker.commands) == 1
