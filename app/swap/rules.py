"""Where a swap stands and what a person has to do next, from what the wire shows. Pure."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Literal

FACTORY_ADDRESS = 1
"""#17 of a unit as it comes out of its box (manual, 1.0)."""

Kind = Literal["silent", "digimax", "garbled", "foreign"]
StepName = Literal["find", "address", "remote", "restore", "proven"]
STEPS: tuple[StepName, ...] = ("find", "address", "remote", "restore", "proven")


@dataclass(frozen=True, slots=True)
class Sight:
    """What the wire shows of a swap. ``remote`` and ``equal`` None: not known yet.

    ``at_target``: what answers at the section's address; ``at_factory``: at address 1.
    ``equal``: whether the unit equals the set, as the last full read says.
    """

    target: int
    at_target: Kind
    at_factory: Kind
    remote: bool | None
    equal: bool | None
    configured: frozenset[int] = frozenset()


@dataclass(frozen=True, slots=True)
class Advice:
    """The step at hand, and in words (a template for ``target`` and ``factory``) what to do now.

    ``at_panel``: only a person at the keypad can do it.
    """

    step: StepName
    text: str
    at_panel: bool


def advice(sight: Sight) -> Advice:
    """What to do now."""
    if sight.at_target in ("garbled", "foreign"):
        return _at_target_wrong(sight)
    if sight.at_target == "silent":
        return _nothing_at_target(sight)
    if sight.remote is not True:
        text = (
            "At the keypad of the new unit set parameter 19 to 1 (REMOTE). In LOCAL it refuses every write, "
            "and the link cannot change that."
        )
        return Advice("remote", text, at_panel=True)
    if sight.equal is not True:
        return Advice("restore", "The unit answers in REMOTE. Restore its parameters now.", at_panel=False)
    return Advice("proven", "The new unit is what the old one was, proven by a full read.", at_panel=False)


def _at_target_wrong(sight: Sight) -> Advice:
    if sight.at_target == "foreign":
        text = "Something that is no DIGIMAX IV answers at address {target}. Take it off the cable."
    else:
        text = (
            "Two units answer at address {target} at once. Take the old one off the cable, or give the other "
            "its own address at its keypad (parameter 17)."
        )
    return Advice("address", text, at_panel=True)


def _nothing_at_target(sight: Sight) -> Advice:
    if sight.at_factory == "garbled":
        text = (
            "Two units answer at address {factory}: the spare still has its factory address, which another "
            "section uses. At the keypad of the spare set parameter 17 to {target}."
        )
        return Advice("address", text, at_panel=True)
    if sight.at_factory == "digimax" and FACTORY_ADDRESS not in sight.configured:
        text = (
            "The spare answers at its factory address {factory}. At its keypad set parameter 17 to {target}."
        )
        return Advice("address", text, at_panel=True)
    text = (
        "Nothing new answers yet. Connect and power the spare; at its keypad set parameter 17 to {target} "
        "and parameter 18 to the baud rate of this line."
    )
    return Advice("find", text, at_panel=True)


def done_steps(now: StepName) -> Collection[StepName]:
    """The steps that lie behind."""
    return STEPS[: STEPS.index(now)] if now != "proven" else STEPS
