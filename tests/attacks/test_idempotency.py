"""A program repeats a used key: the result must never name a write that did not happen."""

from __future__ import annotations

from pathlib import Path

import pytest

from app.core.web.access import Person, Role
from app.errors import Problem
from app.line.commands.service import CommandService
from bus.contract import Result, WriteParameter
from tests.app.complete_app import House, commands_app
from tests.app.fake_worker import responding

ANNA = Person("anna", Role.ENGINEER, "token")


def password(raw: int) -> WriteParameter:
    return WriteParameter(unit=1, number=21, raw=raw)


@pytest.mark.parametrize("restarts", [False, True])
async def test_another_password_with_the_same_key_is_not_verified(tmp_path: Path, restarts: bool) -> None:
    """The value of #21 was left out of what was compared after a restart: it was *verified*, unwritten."""
    async with commands_app(tmp_path) as site:
        worker = await site.worker()
        worker.play = responding("verified", read_back=1234)
        assert (await _send(site.commands, 1234)).outcome == "verified"
        commands = _restarted(site) if restarts else site.commands
        with pytest.raises(Problem) as refused:
            await _send(commands, 4321)
        assert (refused.value.status, refused.value.code) == (422, "invalid")
        again = await _send(commands, 1234)
        assert (again.outcome, again.read_back) == ("verified", None)
        assert [command.action for command in worker.commands] == [password(1234)]


async def _send(commands: CommandService, raw: int) -> Result:
    return await commands.send(ANNA, password(raw), id="mine")


def _restarted(site: House) -> CommandService:
    return site.commands_after_restart()
