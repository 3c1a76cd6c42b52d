"""What a scan has found: at one address, and what only all addresses together show. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from bus.catalogue.parameters import PARAMETERS
from bus.contract import FoundUnit

Checksum10h = Literal["once", "twice"]
Setting = int | float | str | None

TWO_UNITS = "its answers are garbled or come twice: two units at this address? Switch one off and scan again"
TWO_UNITS_OR_ELSE = (
    "every answer is garbled: two units at this address, another protocol, or another baud rate"
)
LATE = "units respond later than turnaround_ms allows: increase it for this bus and scan again"
STRANGE = "answers in whole frames, but not as a DIGIMAX IV does"
_HIGHEST = max(PARAMETERS)


@dataclass(frozen=True, slots=True)
class Found:
    """What is at one address. ``own_address``: what its #17 says, None where it says nothing."""

    unit: int
    baud: int
    kind: Literal["digimax", "garbled", "foreign", "late"]
    parameters: tuple[int, ...] = ()
    remarks: tuple[str, ...] = ()
    remote: bool | None = None
    own_address: int | None = None
    counts_in_bcd: bool = False
    checksum_10h: Checksum10h | None = None
    reply_bytes: tuple[int, ...] = ()
    estop_healthy: Literal[0, 1] | None = None
    """Its e-stop bit while it turns at speed; None where it never did."""
    answered_within_s: float | None = None
    late: bool = False
    """Whether some of its responses came after their window."""

    def for_contract(self) -> FoundUnit:
        """The part of it that the app is told."""
        return FoundUnit(self.unit, self.baud, self.kind, list(self.parameters), list(self.remarks))


def remarks_on(one: Found, *, garbled: int, questions: int, uncertain: bool) -> tuple[str, ...]:
    """What a person should know of a DIGIMAX IV. ``garbled`` of its ``questions`` were answered with noise;
    ``uncertain``: some of them not at all."""
    remarks = _on_its_address(one)
    last = len(one.parameters)
    if last < _HIGHEST:
        remarks.append(f"has the parameters 1 to {last} only" if last else "has no parameter to read")
    if uncertain:
        remarks.append("did not answer every question, so its list may be longer")
    if garbled:
        remarks.append(f"{garbled} of {questions} answers came with noise: look at the shielding")
    if one.checksum_10h == "twice":
        remarks.append('a checksum of 10h comes twice: set checksum_10h = "twice" for this bus')
    if one.estop_healthy == 0:
        remarks.append("turns at speed while its e-stop bit is 0: set estop_healthy = 0 for this bus")
    return tuple(remarks)


def _on_its_address(one: Found) -> list[str]:
    if one.counts_in_bcd:
        return ['counts parameters in BCD: set parameter_numbers = "bcd" for this bus']
    if one.own_address is None:
        return ["does not say its own address (#17)"]
    if one.own_address == one.unit:
        return []
    said = f"#17 says {one.own_address}, not {one.unit}"
    return [f"{said}: it counts parameters otherwise, or answers for another"]


def conclude(found: Sequence[Found]) -> list[str]:
    """What only all addresses together show."""
    remarks = [LATE] if any(one.late for one in found) else []
    owners = [one.own_address for one in found if one.own_address not in (None, one.unit)]
    for owner in sorted({owner for owner in owners if owner is not None}):
        if owners.count(owner) > 1:
            remarks.append(
                f"unit {owner} answers to addresses that are not its own ({owners.count(owner)} of them)"
            )
    differ = [name for name, values in _seen(found).items() if len(values) > 1]
    if differ:
        remarks.append(f"units of this bus differ in {', '.join(differ)}: one [[bus]] cannot serve them all")
    return remarks


def settings_seen(found: Sequence[Found]) -> dict[str, Setting]:
    """The keys of ``[[bus]]`` as these units want them; None where nothing showed it, or units differ."""
    return {name: values.pop() if len(values) == 1 else None for name, values in _seen(found).items()}


def _seen(found: Sequence[Found]) -> dict[str, set[Setting]]:
    units = [one for one in found if one.kind == "digimax"]
    return {
        "checksum_10h": {one.checksum_10h for one in units if one.checksum_10h is not None},
        "parameter_numbers": {
            "bcd" if one.counts_in_bcd else "binary"
            for one in units
            if one.counts_in_bcd or one.own_address == one.unit
        },
        "parameter_reply_bytes": {_reply_bytes(one) for one in units if one.reply_bytes},
        "estop_healthy": {one.estop_healthy for one in units if one.estop_healthy is not None},
    }


def _reply_bytes(one: Found) -> int:
    """As the setting has it: 0 where a value is as wide as its type."""
    return one.reply_bytes[0] if len(one.reply_bytes) == 1 else 0
