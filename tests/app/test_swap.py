"""The swap path: from what the wire shows to what a person has to do."""

from __future__ import annotations

import pytest

from app.swap.rules import STEPS, Kind, Sight, advice, done_steps


def sight(at_target: Kind, at_factory: Kind = "silent", **more: object) -> Sight:
    given = {"remote": None, "equal": None, "configured": frozenset({5})} | more
    return Sight(5, at_target, at_factory, **given)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("seen", "step", "at_panel", "says"),
    [
        (sight("silent"), "find", True, "Connect and power"),
        (sight("silent", "digimax"), "address", True, "factory address"),
        (sight("silent", "digimax", configured=frozenset({1, 5})), "find", True, "Connect and power"),
        (sight("silent", "garbled"), "address", True, "Two units answer at address {factory}"),
        (sight("garbled"), "address", True, "Two units answer at address {target}"),
        (sight("foreign"), "address", True, "no DIGIMAX IV"),
        (sight("digimax", remote=None), "remote", True, "REMOTE"),
        (sight("digimax", remote=False), "remote", True, "REMOTE"),
        (sight("digimax", remote=True), "restore", False, "Restore"),
        (sight("digimax", remote=True, equal=False), "restore", False, "Restore"),
        (sight("digimax", remote=True, equal=True), "proven", False, "proven"),
    ],
)
def test_what_to_do_now(seen: Sight, step: str, at_panel: bool, says: str) -> None:
    now = advice(seen)
    assert (now.step, now.at_panel) == (step, at_panel)
    assert says in now.text
    assert now.text.format(target=5, factory=1)


def test_all_steps_lie_behind_only_when_it_is_proven() -> None:
    assert tuple(done_steps("proven")) == STEPS
    assert list(done_steps("remote")) == ["find", "address"]
