"""An act states its role once: for its route, for templates, and where it is done."""

from __future__ import annotations

from pathlib import Path

import pytest

from app.core.web.access import Person, Requires, Role, public
from app.core.web.assets import Assets, static_dir, templates_dir
from app.core.web.routes import GuardedRoute, calls_of
from app.core.web.templating import Templates
from app.errors import Problem
from app.line.commands.catalogue import COMMANDS
from app.main import FEATURES, create_app
from app.people.audit.acts import Act
from app.settings import Site
from bus.messages import Message
from tests.app.complete_app import settings_in

READS = {"GET", "HEAD"}
WITHOUT_AN_ACT = {
    ("POST", "/account/language"): "what a user sets for the own pages is no event",
    ("POST", "/trends/views"): "any user has own views; to share one is an act that the service checks",
    ("POST", "/trends/views/{number}/delete"): "any user has own views; of shared ones the service checks it",
    ("POST", "/api/v1/alarms/simulate"): "reads stored readings and changes nothing",
}
"""Routes that change something and name neither an act nor a command, with the reason."""
RETIRE = Act("retire", Role.ENGINEER, "recipe", "event_recipe_retired")
ACTS = [act for feature in FEATURES for act in feature.acts]


@pytest.mark.parametrize("role", Role)
def test_an_act_is_refused_to_every_role_that_does_not_include_its_own(role: Role) -> None:
    person = Person("anna", role, "session")
    if role.includes(Role.ENGINEER):
        RETIRE.check(person)
    else:
        with pytest.raises(Problem, match="role engineer") as refused:
            RETIRE.check(person)
        assert (refused.value.status, refused.value.code) == (403, "forbidden")


def test_an_act_is_recorded_with_its_person_and_its_text() -> None:
    assert RETIRE.by(Person("anna", Role.ENGINEER, "token"), name="A", version=2) == {
        "kind": "recipe",
        "who": "anna",
        "origin": "token",
        "what": Message.of("event_recipe_retired", name="A", version=2),
    }


def test_an_act_without_a_text_is_refused() -> None:
    with pytest.raises(ValueError, match="act retire has no text: event_nothing"):
        Act("retire", Role.ENGINEER, "recipe", "event_nothing")


def test_templates_offer_each_act_to_its_role_and_those_above() -> None:
    templates = Templates(templates_dir(), Assets(static_dir()), Site())
    templates.permit({act.name: act.role for act in ACTS})
    for act in ACTS:
        for role in Role:
            assert templates.may(Person("anna", role, "session"), act.name) == role.includes(act.role)
    with pytest.raises(RuntimeError, match="two commands or acts are named save_recipe"):
        templates.permit({"save_recipe": Role.VIEWER})


def test_each_route_that_changes_something_names_what_a_person_does(tmp_path: Path) -> None:
    named = {act.name: act.role for act in ACTS}
    named |= {kind.request.__name__: kind.role for kind in COMMANDS.values()}
    unnamed = set[tuple[str, str]]()
    for route in create_app(settings_in(tmp_path)).routes:
        if not isinstance(route, GuardedRoute):
            continue
        requirements = list(calls_of(route))
        for method in (route.methods or set()) - READS:
            acts = {each.act: each.role for each in requirements if isinstance(each, Requires) and each.act}
            assert acts.items() <= named.items(), route.path
            if not acts and public not in requirements:
                unnamed.add((method, str(route.path)))
    assert unnamed == WITHOUT_AN_ACT.keys(), "name an act, or state why there is none"
