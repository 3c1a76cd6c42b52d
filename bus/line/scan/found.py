"""What a scan has found: at one address, and what only all addresses together show. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from bus.catalogue.parameters import PARAMETERS
from bus.messages import Message

Checksum10h = Literal["once", "twice"]
Setting = int | float | str | None

TWO_UNITS = Message("found_two_units")
TWO_UNITS_OR_ELSE = Message("found_garbled")
LATE = Message("found_late")
STRANGE = Message("found_strange")
_HIGHEST = max(PARAMETERS)


@dataclass(frozen=True, slots=True)
class Found:
    """The device at one address. ``own_address``: the value of its #17, None where it was not read."""

    unit: int
    baud: int
    kind: Literal["digimax", "garbled", "foreign", "late"]
    parameters: tuple[int, ...] = ()
    remarks: tuple[Message, ...] = ()
    remote: bool | None = None
    own_address: int | None = None
    counts_in_bcd: bool = False
    checksum_10h: Checksum10h | None = None
    reply_bytes: tuple[int, ...] = ()
    estop_healthy: Literal[0, 1] | None = None
    """Its e-stop bit while it turns at speed; None where it never did."""
    responds_within_s: float | None = None
    late: bool = False
    """Whether some of its responses came after their window."""


def remarks_on(one: Found, *, garbled: int, requests: int, uncertain: bool) -> tuple[Message, ...]:
    """Remarks about a DIGIMAX IV; of ``requests``, ``garbled`` had noise, some (``uncertain``) nothing."""
    remarks = _on_its_address(one)
    last = len(one.parameters)
    if last < _HIGHEST:
        remarks.append(Message.of("found_parameters", last=last) if last else Message("found_no_parameter"))
    if uncertain:
        remarks.append(Message("found_uncertain"))
    if garbled:
        remarks.append(Message.of("found_noise", n=garbled, all=requests))
    if one.checksum_10h == "twice":
        remarks.append(Message("found_checksum_twice"))
    if one.estop_healthy == 0:
        remarks.append(Message("found_estop_low"))
    return tuple(remarks)


def _on_its_address(one: Found) -> list[Message]:
    if one.counts_in_bcd:
        return [Message("found_bcd")]
    if one.own_address is None:
        return [Message("found_no_address")]
    if one.own_address == one.unit:
        return []
    return [Message.of("found_other_address", own=one.own_address, unit=one.unit)]


def conclude(found: Sequence[Found]) -> list[Message]:
    """What only all addresses together show."""
    remarks = [LATE] if any(one.late for one in found) else []
    owners = [one.own_address for one in found if one.own_address not in (None, one.unit)]
    for owner in sorted({owner for owner in owners if owner is not None}):
        if owners.count(owner) > 1:
            remarks.append(Message.of("found_many_addresses", unit=owner, count=owners.count(owner)))
    differ = [name for name, values in _seen(found).items() if len(values) > 1]
    if differ:
        remarks.append(Message.of("found_settings_differ", settings=differ))
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
        # 0 where a value is as wide as its type.
        "parameter_reply_bytes": {
            one.reply_bytes[0] if len(one.reply_bytes) == 1 else 0 for one in units if one.reply_bytes
        },
        "estop_healthy": {one.estop_healthy for one in units if one.estop_healthy is not None},
    }
