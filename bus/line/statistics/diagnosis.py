"""The likely cause of trouble on a bus, from the last seconds' counts. Pure rules.

One unit: its drop or its address. All: adapter, main cable or termination. All from one place on: the
cable there. Spoilt bytes at many: shielding. Spoilt bytes at one address only: two units may share it.
All but one answer twice, or are spoilt when they are asked: that one answers for the others too. Where it
does so for one that is off, no frame shows it; only the address does that the answering unit reads in #17.
"""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from bus.messages import Message

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


def diagnose(units: Sequence[UnitSymptoms], noise_bytes: int, echoes: int) -> list[Message]:
    """One or two causes; empty when all is well."""
    found = [_in_another_name(units), _garbled(units), _collided(units, noise_bytes) or _silent(units)]
    found += [_duplicated(units)] if answers_for_all(units) else [_slow(units), _foreign(units)]
    if echoes:
        found.append(Message("diagnosis_echo"))
    if noise_bytes >= MUCH_NOISE_BYTES:
        found.append(_noise(units, named=any(found)))
    return [each for each in found if each is not None]


def answers_for_all(units: Sequence[UnitSymptoms]) -> int:
    """The unit that seems to answer to every address, as all others are received twice; 0: none."""
    heard = [each for each in units if not each.silent]
    alone = [each for each in heard if not each.twice]
    return alone[0].unit if len(alone) == 1 and len(heard) >= MANY and alone[0].answers else 0


def _duplicated(units: Sequence[UnitSymptoms]) -> Message:
    return Message.of("diagnosis_all_twice", unit=answers_for_all(units))


def _in_another_name(units: Sequence[UnitSymptoms]) -> Message | None:
    others = [each for each in units if each.says not in (None, each.unit) and not each.silent]
    if not others or (own := others[0].says) is None:
        return None
    same = _addresses([each for each in others if each.says == own])
    return Message.of("diagnosis_other_name", units=same, own=own)


def _collided(units: Sequence[UnitSymptoms], noise_bytes: int) -> Message | None:
    alone = [each.unit for each in units if not each.silent]
    if len(alone) != 1 or len(units) < MANY or noise_bytes < COLLIDED_BYTES:
        return None
    return Message.of("diagnosis_collisions", unit=alone[0])


def _silent(units: Sequence[UnitSymptoms]) -> Message | None:
    silent = [each for each in units if each.silent and not each.garbled]
    if not silent:
        return None
    if len(silent) == len(units) and len(units) > 1:
        return Message("diagnosis_no_response")
    if len(silent) == 1:
        return Message.of("diagnosis_one_silent", unit=silent[0].unit)
    first = units.index(silent[0])
    if list(units[first:]) == silent and first > 0:
        return Message.of("diagnosis_silent_from", unit=silent[0].unit, before=units[first - 1].unit)
    return Message.of("diagnosis_some_silent", units=_addresses(silent))


def _garbled(units: Sequence[UnitSymptoms]) -> Message | None:
    garbled = [each for each in units if each.garbled]
    if not garbled:
        return None
    if len(garbled) == 1 and len(units) > 1:
        return Message.of("diagnosis_one_garbled", unit=garbled[0].unit)
    if len(garbled) == len(units):
        return Message("diagnosis_all_garbled")
    return Message.of("diagnosis_some_garbled", units=_addresses(garbled))


def _noise(units: Sequence[UnitSymptoms], *, named: bool) -> Message | None:
    if any(each.silent and not each.garbled for each in units):
        return Message("diagnosis_other_protocol")
    return None if named else Message("diagnosis_stray_bytes")


def _slow(units: Sequence[UnitSymptoms]) -> Message | None:
    slow = [each for each in units if each.slow]
    return Message.of("diagnosis_late", units=_addresses(slow)) if slow else None


def _foreign(units: Sequence[UnitSymptoms]) -> Message | None:
    foreign = [each for each in units if each.foreign >= FEW]
    return Message.of("diagnosis_foreign", units=_addresses(foreign)) if foreign else None


def _addresses(units: Sequence[UnitSymptoms]) -> list[int | str | Message]:
    return [each.unit for each in units]
