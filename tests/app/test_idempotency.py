"""A command's id, given again after a restart of the server: the same fate, and nothing is sent."""

from __future__ import annotations

import asyncio

import pytest

from app.audit.log import ENDED_BEFORE
from app.commands import idempotency
from app.commands.desk import Desk
from app.commands.wish import Wish
from app.errors import Problem
from app.web.access import Person, Role
from bus.contract import Action, Command, Result, SetSpeed, WriteParameter
from tests.app.stage import PlayedWorker, Stage, answering, fate

ANNA = Person("anna", Role.ENGINEER, "token")
WISH = SetSpeed(unit=1, raw=5)


def restarted(stage: Stage) -> Desk:
    """The desk of a server that remembers nothing but what is on disk."""
    return Desk(stage.live, stage.workers.channels, stage.events, stage.database, stage.guards, stage.rights)


async def test_a_known_fate_is_given_again_and_nothing_is_sent(stage: Stage, worker: PlayedWorker) -> None:
    worker.play = answering("refused", unit_error=129, message="value above max")
    first = await stage.desk.ask(ANNA, "dry-end", WISH, id="mine")
    again = await restarted(stage).ask(ANNA, "dry-end", WISH, id="mine")
    assert (again.outcome, again.unit_error, again.message) == ("refused", 129, "value above max")
    assert again.at == first.at
    assert len(worker.commands) == 1


async def test_what_was_open_at_the_restart_is_unverified_and_not_sent_again(
    stage: Stage, worker: PlayedWorker
) -> None:
    open_still = asyncio.create_task(stage.desk.ask(ANNA, "dry-end", WISH, id="mine"))
    command = await worker.hear(Command)
    assert isinstance(command, Command)
    again = await restarted(stage).ask(ANNA, "dry-end", WISH, id="mine")
    assert (again.outcome, again.message) == ("unverified", ENDED_BEFORE)
    await worker.update(fate(command, "verified"))
    assert (await open_still).outcome == "verified"
    assert len(worker.commands) == 1


async def test_an_id_of_another_command_is_refused_after_a_restart_too(
    stage: Stage, worker: PlayedWorker
) -> None:
    worker.play = answering("verified")
    await stage.desk.ask(ANNA, "dry-end", WISH, id="mine")
    with pytest.raises(Problem) as refused:
        await restarted(stage).ask(ANNA, "dry-end", SetSpeed(unit=1, raw=6), id="mine")
    assert (refused.value.status, refused.value.code) == (422, "invalid")
    assert len(worker.commands) == 1


async def test_what_was_refused_before_it_was_sent_may_be_asked_again(
    stage: Stage, worker: PlayedWorker
) -> None:
    dangerous = WriteParameter(unit=1, number=19, raw=0)

    worker.play = answering("verified")
    with pytest.raises(Problem):
        await stage.desk.ask(ANNA, "dry-end", dangerous, id="mine")
    confirmed = await restarted(stage).ask(ANNA, "dry-end", dangerous, confirm=True, id="mine")
    assert confirmed.outcome == "verified"
    assert len(worker.commands) == 1


async def test_an_id_is_its_givers_own(stage: Stage, worker: PlayedWorker) -> None:
    worker.play = answering("verified", read_back=5)
    await stage.desk.ask(ANNA, "dry-end", WISH, id="1")
    for desk in (stage.desk, restarted(stage)):
        with pytest.raises(Problem, match="was used for another command"):
            await desk.ask(Person("ben", Role.ENGINEER, "token"), "dry-end", WISH, id="1")
    assert len(worker.commands) == 1


async def test_ids_are_forgotten_in_the_end(stage: Stage) -> None:
    def wish(id: str) -> Wish:
        return Wish(id, ANNA, "dry-end", WISH, deadline=0.0, origin="api")

    await stage.database.write(lambda connection: idempotency.begin(connection, wish("old"), 0.0))
    await stage.database.write(
        lambda connection: idempotency.begin(connection, wish("new"), idempotency.KEPT_S + 1)
    )
    assert await stage.database.read(lambda connection: idempotency.find(connection, "old")) is None
    assert await stage.database.read(lambda connection: idempotency.find(connection, "new")) is not None


async def test_nothing_of_a_secret_is_stored(stage: Stage) -> None:
    def secret(raw: int) -> Action:
        return WriteParameter(unit=1, number=21, raw=raw)

    assert idempotency.command_of("anna", "dry-end", secret(17)) == idempotency.command_of(
        "anna", "dry-end", secret(42)
    )
    wish = Wish("mine", ANNA, "dry-end", secret(17), deadline=0.0, origin="api")
    result = Result("mine", 1.0, "verified", read_back=17)
    await stage.database.write(lambda connection: idempotency.begin(connection, wish, 1.0))
    await stage.database.write(lambda connection: idempotency.end(connection, wish, result))
    found = await stage.database.read(lambda connection: idempotency.find(connection, "mine"))
    assert found is not None
    assert found.fate.read_back is None
