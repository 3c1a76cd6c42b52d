"""The state of a swap and the next step for a person, from the findings on the wire. Pure."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Literal

FACTORY_ADDRESS = 1
"""#17 of a unit as it comes out of its box (manual, 1.0)."""
FACTORY_BAUD = 9600
"""Its #18 then, in bits a second."""

ProbeFinding = Literal["silent", "digimax", "garbled", "foreign", "late"]
StepName = Literal["find", "address", "remote", "restore", "proven"]
STEPS: tuple[StepName, ...] = ("find", "address", "remote", "restore", "proven")


@dataclass(frozen=True, slots=True)
class SwapState:
    """Findings on the wire for a swap. ``remote`` and ``equal`` None: not known yet.

    ``at_target``: the unit at the section's address; ``at_factory``: at address 1.
    ``is_new``: that unit is the spare, not the old unit that is still on the cable.
    ``equal``: whether the unit equals the set, by the last full read.
    ``baud``: the rate of the line.
    """

    target: int
    at_target: ProbeFinding
    at_factory: ProbeFinding
    remote: bool | None
    equal: bool | None
    is_new: bool = True
    configured: frozenset[int] = frozenset()
    baud: int = FACTORY_BAUD


@dataclass(frozen=True, slots=True)
class Advice:
    """The current step and its text (a template for ``target``, ``factory``, ``baud`` and ``hundreds``).

    ``at_panel``: only a person at the unit can do it. ``confirms_spare``: to confirm that it is the spare.
    """

    step: StepName
    text: str
    at_panel: bool
    confirms_spare: bool = False


PROVEN = Advice("proven", "The new unit is what the old one was, proven by a full read.", at_panel=False)


def advice(state: SwapState) -> Advice:
    """What to do now."""
    if state.at_target in ("garbled", "foreign", "late"):
        return _at_target_wrong(state)
    if state.at_target == "silent":
        return _nothing_at_target(state)
    if not state.is_new:
        text = (
            "A unit answers at address {target}. If it is the old one, switch it off and take it off the "
            "cable; this page goes on when the address is silent. If it is the spare already, say so."
        )
        return Advice("find", text, at_panel=True, confirms_spare=True)
    if state.remote is not True:
        text = (
            "At the keypad of the new unit set parameter 19 to 1 (REMOTE). In LOCAL it refuses every write, "
            "and the link cannot change that."
        )
        return Advice("remote", text, at_panel=True)
    if state.equal is not True:
        return Advice("restore", "The unit answers in REMOTE. Restore its parameters now.", at_panel=False)
    return PROVEN


def _at_target_wrong(state: SwapState) -> Advice:
    if state.at_target == "foreign":
        text = "Something that is no DIGIMAX IV answers at address {target}. Take it off the cable."
    elif state.at_target == "late":
        text = (
            "Responses from address {target} come too late to be identified. Increase turnaround_ms for this "
            "bus in lineside.toml and restart Lineside."
        )
        return Advice("find", text, at_panel=False)
    else:
        text = (
            "Two units answer at address {target} at once. Take the old one off the cable, or give the other "
            "its own address at its keypad (parameter 17)."
        )
    return Advice("address", text, at_panel=True)


def _nothing_at_target(state: SwapState) -> Advice:
    if state.at_factory == "garbled":
        text = (
            "Two units answer at address {factory}: the spare still has its factory address, which another "
            "section uses. At the keypad of the spare set parameter 17 to {target}."
        )
        return Advice("address", text, at_panel=True)
    if state.at_factory == "digimax" and FACTORY_ADDRESS not in state.configured:
        text = (
            "The spare answers at its factory address {factory}. At its keypad set parameter 17 to {target}."
        )
        return Advice("address", text, at_panel=True)
    if state.baud != FACTORY_BAUD:
        text = (
            "Nothing new answers yet. Connect and power the spare. Out of its box it speaks at 9600 baud, "
            "and this line goes at {baud}: at its keypad set parameter 17 to {target} and parameter 18 to "
            "{hundreds}, then switch it off and on."
        )
    else:
        text = (
            "Nothing new answers yet. Connect and power the spare; at its keypad set parameter 17 to "
            "{target}. If it was used elsewhere before, set parameter 18 to {hundreds} ({baud} baud) as "
            "well, then switch it off and on."
        )
    return Advice("find", text, at_panel=True)


_KIND_WORDS: dict[ProbeFinding, str] = {
    "silent": "nothing answers",
    "digimax": "a unit answers",
    "garbled": "two units answer",
    "foreign": "something that is no unit answers",
    "late": "responses come too late",
}


def seen_words(state: SwapState) -> str:
    """What the wire shows, for the record of the swap."""
    words = f"{_KIND_WORDS[state.at_target]} at address {state.target}"
    if state.at_target == "silent" and state.at_factory != "silent":
        words += f" and {_KIND_WORDS[state.at_factory]} at {FACTORY_ADDRESS}"
    if state.at_target == "digimax":
        words += " in REMOTE" if state.remote else "" if state.remote is None else ", not in REMOTE"
    return words


def done_steps(now: StepName) -> Collection[StepName]:
    """The steps that lie behind."""
    return STEPS[: STEPS.index(now)] if now != "proven" else STEPS
