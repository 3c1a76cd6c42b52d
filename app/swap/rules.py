"""Where a swap stands and what a person has to do next, from what the wire shows. Pure."""

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
    """What the wire shows of a swap. ``remote`` and ``equal`` None: not known yet.

    ``at_target``: what answers at the section's address; ``at_factory``: at address 1.
    ``is_new``: what answers there is the spare, not the old unit that is still on the cable.
    ``equal``: whether the unit equals the set, as the last full read says.
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
    """The step at hand, and in words (a template for ``target``, ``factory``, ``baud`` and ``hundreds``)
    what to do now.

    ``at_panel``: only a person at the unit can do it. ``asks``: whether the unit there is the spare.
    """

    step: StepName
    text: str
    at_panel: bool
    asks: bool = False


PROVEN = Advice(
    "proven", ("The new unit has the parameters of the old unit, verified by a full read."), at_panel=False
)


def advice(state: SwapState) -> Advice:
    """What to do now."""
    if state.at_target in ("garbled", "foreign", "late"):
        return _at_target_wrong(state)
    if state.at_target == "silent":
        return _nothing_at_target(state)
    if not state.is_new:
        text = (
            "A unit responds at address {target}. If it is the old unit, switch it off and "
            "disconnect it; this page continues when the address stops responding. If it is already "
            "the spare, confirm it."
        )
        return Advice("find", text, at_panel=True, asks=True)
    if state.remote is not True:
        text = (
            "At the keypad of the new unit, set parameter 19 to 1 (REMOTE). In LOCAL it rejects "
            "every write, and the link cannot change that."
        )
        return Advice("remote", text, at_panel=True)
    if state.equal is not True:
        return Advice(
            "restore", "The unit responds and is in REMOTE. Restore its parameters now.", at_panel=False
        )
    return PROVEN


def _at_target_wrong(state: SwapState) -> Advice:
    if state.at_target == "foreign":
        text = "A device that is not a DIGIMAX IV responds at address {target}. Disconnect it from the cable."
    elif state.at_target == "late":
        text = (
            "Responses from address {target} arrive too late to be identified. Increase "
            "turnaround_ms for this bus in lineside.toml and restart Lineside."
        )
        return Advice("find", text, at_panel=False)
    else:
        text = (
            "Two units respond at address {target}. Disconnect the old unit, or set a unique address "
            "at the keypad of the other (parameter 17)."
        )
    return Advice("address", text, at_panel=True)


def _nothing_at_target(state: SwapState) -> Advice:
    if state.at_factory == "garbled":
        text = (
            "Two units respond at address {factory}: the spare still has its factory address, which "
            "another section uses. At the keypad of the spare, set parameter 17 to {target}."
        )
        return Advice("address", text, at_panel=True)
    if state.at_factory == "digimax" and FACTORY_ADDRESS not in state.configured:
        text = (
            "The spare responds at its factory address {factory}. At its keypad, set parameter 17 to "
            "{target}."
        )
        return Advice("address", text, at_panel=True)
    if state.baud != FACTORY_BAUD:
        text = (
            "No spare responds yet. Connect and power the spare. Its factory setting is 9600 baud, "
            "and this line runs at {baud}: at its keypad, set parameter 17 to {target} and parameter "
            "18 to {hundreds}, then switch it off and on."
        )
    else:
        text = (
            "No spare responds yet. Connect and power the spare; at its keypad, set parameter 17 to "
            "{target}. If it was used elsewhere before, also set parameter 18 to {hundreds} ({baud} "
            "baud), then switch it off and on."
        )
    return Advice("find", text, at_panel=True)


_KIND_WORDS: dict[ProbeFinding, str] = {
    "silent": "no response",
    "digimax": "a unit answers",
    "garbled": "two units answer",
    "foreign": "a device that is not a unit responds",
    "late": "responses arrive too late",
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
