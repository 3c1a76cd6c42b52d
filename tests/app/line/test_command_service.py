"""From a request to the wire: recorded before it is sent, sent once, one outcome in every case."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Sequence
from typing import Any

import pytest

from app.core.web.access import Person, Role
from app.core.web.arrival import Deadline
from app.errors import Problem, StoreError
from app.people.audit.log import Filter
from bus.contract import (
    Action,
    Cancel,
    ChangeBaud,
    Command,
    ReadParameters,
    SetLine,
    SetSpeed,
    Update,
    WriteParameter,
)
from bus.messages import Message, term
from tests.app.complete_app import House
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


async def test_what_cannot_be_written_down_is_not_sent(
    site: House, worker: PlayedWorker, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def full(*_: object, **__: object) -> list[int]:
        raise StoreError(Message.of("system_error", error="the disk is full"))

    monkeypatch.setattr(site.log, "intend_together", full)
    response = await site.request("POST", "/units/1/speed", {"raw": 5})
    assert (response.status_code, response.json()["code"]) == (503, "store")
    assert worker.commands == []


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
    assert (event["outcome"], event["message"]) == ("not_sent", f"{reason}; given up: every unit is back")


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
    assert (event["outcome"], event["message"]) == ("not_sent", reasons[0])


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
