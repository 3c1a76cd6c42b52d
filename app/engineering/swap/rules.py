"""The next step of a swap, by the state of the wire. Pure."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Literal, NamedTuple

from bus.contract import UnitLink
from bus.instants import UnixTime
from bus.messages import Message, ParamValue

FACTORY_ADDRESS = 1
"""The value of #17 of a new unit (manual, 1.0)."""
FACTORY_BAUD = 9600
"""The bit rate of a new unit (#18), in bits per second."""

ProbeFinding = Literal["silent", "digimax", "garbled", "foreign", "late"]
StepName = Literal["find", "address", "remote", "restore", "proven"]
STEPS: tuple[StepName, ...] = ("find", "address", "remote", "restore", "proven")


class LostUnit(NamedTuple):
    """A unit that does not respond, and when it last did."""

    unit: int
    since: UnixTime


@dataclass(frozen=True, slots=True)
class SwapState:
    """The state of the wire for a swap.

    ``at_target``: the finding at the section's address; ``at_factory``: at address 1. ``is_new``: the unit at
    the section's address is the spare, not the old unit that is still on the cable. ``equal``: the unit
    equals the set, by the last full read. ``remote`` and ``equal`` are None if they are not known yet.
    ``read_at``: when the wire was read. ``other_lost``: the one other unit that has stopped responding since
    the swap began, because the spare may have its address; None if no other unit has, or several have.
    """

    target: int
    at_target: ProbeFinding
    at_factory: ProbeFinding
    remote: bool | None
    equal: bool | None = None
    is_new: bool = True
    configured: frozenset[int] = frozenset()
    baud: int = FACTORY_BAUD
    read_at: UnixTime = UnixTime(0.0)
    other_lost: LostUnit | None = None

    def still_holds(self, link: UnitLink) -> bool:
        """Return whether this state is still up to date: False once a unit that was found has stopped
        responding. ``link``: the link to the section's address."""
        return self.at_target != "digimax" or link.link == "online" or link.at <= self.read_at


@dataclass(frozen=True, slots=True)
class Advice:
    """The present step and its instruction. ``at_keypad``: only a person at the unit can do it;
    ``confirms_spare``: a person may confirm that the unit is the spare; ``other_lost``: a unit whose
    address the spare may have."""

    step: StepName
    text: Message
    at_keypad: bool
    confirms_spare: bool = False
    other_lost: LostUnit | None = None


PROVEN = Advice("proven", Message("swap_proven"), at_keypad=False)


def advice(state: SwapState) -> Advice:
    """Return the step that a person should do now."""
    if state.at_target == "late":
        return Advice("find", Message.of("swap_late", target=state.target), at_keypad=False)
    if state.at_target in ("garbled", "foreign"):
        code = "swap_foreign" if state.at_target == "foreign" else "swap_two_units"
        return Advice("address", Message.of(code, target=state.target), at_keypad=True)
    if state.at_target == "silent":
        return _nothing_at_target(state)
    if not state.is_new:
        text = Message.of("swap_old_or_new", target=state.target)
        return Advice("find", text, at_keypad=True, confirms_spare=True)
    if state.remote is not True:
        return Advice("remote", Message("swap_set_remote"), at_keypad=True)
    if state.equal is not True:
        return Advice("restore", Message("swap_restore_now"), at_keypad=False)
    return PROVEN


def _nothing_at_target(state: SwapState) -> Advice:
    addresses: dict[str, ParamValue] = {"target": state.target, "factory": FACTORY_ADDRESS}
    if state.at_factory == "garbled":
        return Advice("address", Message("swap_two_at_factory", addresses), at_keypad=True)
    if state.at_factory == "digimax" and FACTORY_ADDRESS not in state.configured:
        return Advice("address", Message("swap_at_factory", addresses), at_keypad=True)
    code = "swap_nothing_new" if state.baud == FACTORY_BAUD else "swap_nothing_new_other_baud"
    text = Message.of(code, target=state.target, baud=state.baud, hundreds=state.baud // 100)
    return Advice("find", text, at_keypad=True, other_lost=state.other_lost)


def finding(state: SwapState) -> Message:
    """Return the state of the wire as text for the record of the swap."""
    if state.at_target == "digimax" and state.remote is not None:
        code = "swap_found_remote" if state.remote else "swap_found_local"
        return Message.of(code, address=state.target)
    target = Message.of(f"swap_found_{state.at_target}", address=state.target)
    if state.at_target != "silent" or state.at_factory == "silent":
        return target
    factory = Message.of(f"swap_found_{state.at_factory}", address=FACTORY_ADDRESS)
    return Message.of("swap_found_both", target=target, factory=factory)


def done_steps(now: StepName) -> Collection[StepName]:
    """Return the steps before ``now``; all when the swap is verified."""
    return STEPS[: STEPS.index(now)] if now != "proven" else STEPS
