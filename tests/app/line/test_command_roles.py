"""The role of a command is checked where it is sent, whichever way it came."""

from __future__ import annotations

import pytest

from app.core.web.admission.access import Person, Role
from app.core.web.rendering.assets import Assets, static_dir, templates_dir
from app.core.web.rendering.templating import Templates
from app.engineering.sets.batch import rows_of_batch, write_batch
from app.engineering.sets.saving.schedule import SERVER
from app.errors import Problem
from app.line.commands.catalogue import COMMANDS, READ_PARAMETERS, ROLES_BY_COMMAND, kind_of_command
from app.people.audit.queries import Filter
from app.settings import Site
from bus.contract import Action, ReadParameters, SetSpeed
from tests.app.line.test_command_catalogue import ALL
from tests.app.stage import PlayedWorker, Stage, responding


async def code_of(stage: Stage, person: Person, action: Action) -> str:
    """Send it as confirmed; return the code of the refusal, or the outcome."""
    try:
        return (await stage.commands.send(person, action, confirm=True)).outcome
    except Problem as problem:
        return problem.code


@pytest.mark.parametrize("role", Role)
@pytest.mark.parametrize("action", ALL, ids=lambda action: type(action).__name__)
async def test_every_kind_is_sent_for_its_role_and_those_above_alone(
    stage: Stage, worker: PlayedWorker, action: Action, role: Role
) -> None:
    worker.play = responding("verified")
    person, needed = Person("anna", role, "session"), kind_of_command(action).role
    code = await code_of(stage, person, action)
    assert (code == "forbidden") == (not role.includes(needed))
    if code == "forbidden":
        assert worker.commands == []
        with pytest.raises(Problem, match=f"role {needed}") as refused:
            stage.commands.check(person, action, confirm=True)
        assert refused.value.status == 403


async def test_a_refused_write_is_recorded_with_its_author(stage: Stage, worker: PlayedWorker) -> None:
    assert (
        await code_of(stage, Person("vera", Role.VIEWER, "session"), SetSpeed(unit=1, raw=5)) == "forbidden"
    )
    (event, *_), _ = await stage.events.page(Filter(kind="command"), 1)
    assert (event["who"], event["outcome"]) == ("vera", "forbidden")
    assert worker.commands == []


async def test_a_batch_of_a_person_without_the_right_writes_nothing(
    stage: Stage, worker: PlayedWorker
) -> None:
    operator = Person("ben", Role.OPERATOR, "session")
    rows = rows_of_batch(stage.live.buses["dry-end"], 6, {1: "5.0", 2: "5.0", 16: "5.0"})
    results = await write_batch(stage.commands, operator, 6, rows, confirm=True)
    assert [result.outcome for result in results] == ["forbidden", "not_sent", "not_sent"]
    assert worker.commands == []


def test_the_server_as_an_author_may_read_and_nothing_else() -> None:
    allowed = {kind.request for kind in COMMANDS.values() if SERVER.role.includes(kind.role)}
    assert allowed == {ReadParameters} == {READ_PARAMETERS.request}


def test_templates_offer_a_command_to_its_role_and_those_above() -> None:
    templates = Templates(templates_dir(), Assets(static_dir()), Site())
    templates.permit(ROLES_BY_COMMAND)
    for kind in COMMANDS.values():
        for role in Role:
            person = Person("anna", role, "session")
            assert templates.may(person, kind.request.__name__) == role.includes(kind.role)
    assert not templates.may(None, "SetSpeed")
