"""The likely cause of trouble on a bus, in words, from the last seconds' counts. Pure rules.

One unit: its drop or its address. All: adapter, main cable or termination. All from one place on: the
cable there. Spoilt bytes at many: shielding. Spoilt bytes at one address only: two units may share it.
All but one answer twice, or are spoilt when they are asked: that one answers for the others too. Where it
does so for one that is off, no frame shows it; only the address does that the answering unit reads in #17.
"""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

TROUBLED = 0.1
"""A unit is in trouble when it misses or spoils more than this part of its answers."""
FEW = 3
"""Fewer events than this are chance."""
MANY = 3
"""Units of which one can be told from all the others."""
LATE_PART = 0.05
MUCH_NOISE_BYTES = 100
COLLIDED_BYTES = 20
"""What is left of a few answers that two units gave at once; units that are off leave nothing."""


class UnitSymptoms(msgspec.Struct, frozen=True):
    """What one unit did in the window, units in floor order. ``spoilt``: answers with a wrong checksum.
    ``says``: the address that its #17 reads, None where that was not read."""

    unit: int
    offline: bool = False
    answers: int = 0
    timeouts: int = 0
    spoilt: int = 0
    foreign: int = 0
    late: int = 0
    says: int | None = None

    @property
    def asked(self) -> int:
        return self.answers + self.timeouts

    @property
    def silent(self) -> bool:
        return self.offline or (self.timeouts >= FEW and self.timeouts > TROUBLED * self.asked)

    @property
    def garbled(self) -> bool:
        return self.spoilt >= FEW and self.spoilt > TROUBLED * self.asked

    @property
    def slow(self) -> bool:
        return self.late >= FEW and self.late > LATE_PART * self.asked

    @property
    def twice(self) -> bool:
        """Frames come in its name that it does not owe: an answer that is late was given up before."""
        return self.slow and self.timeouts < FEW


def diagnose(units: Sequence[UnitSymptoms], noise_bytes: int, echoes: int) -> str:
    """One or two sentences; empty when all is well."""
    found = [_in_another_name(units), _garbled(units), _collided(units, noise_bytes) or _silent(units)]
    found += [_duplicated(units)] if answers_for_all(units) else [_slow(units), _foreign(units)]
    if echoes:
        found.append("The adapter hears itself: switch its echo (or two-wire mode) off.")
    if noise_bytes >= MUCH_NOISE_BYTES:
        found.append(_noise(units, named=any(found)))
    return " ".join(sentence for sentence in found if sentence)


def answers_for_all(units: Sequence[UnitSymptoms]) -> int:
    """The unit that seems to answer to every address, as all others are heard twice; 0: none."""
    heard = [each for each in units if not each.silent]
    alone = [each for each in heard if not each.twice]
    return alone[0].unit if len(alone) == 1 and len(heard) >= MANY and alone[0].answers else 0


def _duplicated(units: Sequence[UnitSymptoms]) -> str:
    unit = answers_for_all(units)
    return f"The answers of every unit but unit {unit} come twice: does unit {unit} answer to every address?"


def _in_another_name(units: Sequence[UnitSymptoms]) -> str:
    others = [each for each in units if each.says not in (None, each.unit) and not each.silent]
    if not others:
        return ""
    says = others[0].says
    names = _names([each for each in others if each.says == says])
    return (
        f"What answers as unit {names} reads {says} as its own address (#17): does unit {says} answer in its "
        "name, or does it count parameters otherwise?"
    )


def _collided(units: Sequence[UnitSymptoms], noise_bytes: int) -> str:
    alone = [each.unit for each in units if not each.silent]
    if len(alone) != 1 or len(units) < MANY or noise_bytes < COLLIDED_BYTES:
        return ""
    return (
        f"Only unit {alone[0]} answers, and something comes when others are asked: does unit {alone[0]} "
        "answer to every address?"
    )


def _silent(units: Sequence[UnitSymptoms]) -> str:
    silent = [each for each in units if each.silent and not each.garbled]
    if not silent:
        return ""
    if len(silent) == len(units) and len(units) > 1:
        return "No unit answers: look at the adapter, the main cable, its termination, and the baud rate."
    if len(silent) == 1:
        return f"Only unit {silent[0].unit} does not answer: look at its drop, its power, its address (#17)."
    first = units.index(silent[0])
    if list(units[first:]) == silent and first > 0:
        return (
            f"No unit answers from unit {silent[0].unit} on: look at the cable between unit "
            f"{units[first - 1].unit} and unit {silent[0].unit}."
        )
    return f"Units {_names(silent)} do not answer: look at what they share, and at the power of each."


def _garbled(units: Sequence[UnitSymptoms]) -> str:
    garbled = [each for each in units if each.garbled]
    if not garbled:
        return ""
    if len(garbled) == 1 and len(units) > 1:
        return (
            f"Only the answers of unit {garbled[0].unit} are spoilt: two units may have this address (#17), "
            "or its drop is bad."
        )
    if len(garbled) == len(units):
        return "Answers of every unit are spoilt: look at shielding, grounding and termination."
    return f"Answers of units {_names(garbled)} are spoilt: look at the shielding of their stretch of cable."


def _noise(units: Sequence[UnitSymptoms], *, named: bool) -> str:
    if any(each.silent and not each.garbled for each in units):
        return "Bytes come in that are no answer: another protocol, or another baud rate?"
    if named:
        return ""
    return "Stray bytes come in without being asked for: look at shielding and grounding."


def _slow(units: Sequence[UnitSymptoms]) -> str:
    slow = [each for each in units if each.slow]
    if not slow:
        return ""
    return f"Answers of unit {_names(slow)} come late or twice: a longer turnaround_ms may be needed."


def _foreign(units: Sequence[UnitSymptoms]) -> str:
    foreign = [each for each in units if each.foreign >= FEW]
    if not foreign:
        return ""
    return f"Unit {_names(foreign)} answers with what is not its own address or length: is it a DIGIMAX IV?"


def _names(units: Sequence[UnitSymptoms]) -> str:
    return ", ".join(str(each.unit) for each in units)
