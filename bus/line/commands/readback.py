"""When a write is verified: only by what a later exchange shows. Pure procedures and rules.

The commanded speed of an 81h is compared with the request. A follower (#8 = 1 or 2) is given a ratio, and the
dialect decides whether its CS then is that ratio: where it is a speed, #37 is read, and only where the unit
does not return it there, a CS that has become the ratio counts as the read-back.

A unit may take a moment to show what it acknowledged, so a read-back that differs is repeated.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from bus.catalogue.numbers import FOLLOWER_MODE, RATIO_SETPOINT, SPEED_SETPOINT
from bus.catalogue.parameters import PARAMETERS
from bus.catalogue.status import StatusBits, output_is_on, status_bits
from bus.contract import Outcome, UnitScale
from bus.errors import UnitErrorCode
from bus.instants import UnixTime
from bus.line.commands.procedure import Subprocedure, Wait, send
from bus.line.exchange.send import Send, SendResult, SendStatus
from bus.line.roster import UnitRecord
from bus.messages import Message, parameter_name
from bus.settings import Dialect
from bus.wire.commands import ParameterReply, ReadParameterRequest, ReadStatusRequest, StatusReply

REREADS = 2
"""How often a read-back that differs is read again."""
REREAD_AFTER_S = 0.1
NO_READBACK = Message("readback_no_response")


@dataclass(frozen=True, slots=True)
class Readback:
    """What the read-back showed. ``read_back`` None: there was none. ``why``: where not ``shown``."""

    shown: bool
    read_back: int | None = None
    at: UnixTime | None = None
    why: Message | None = None


Verification = Subprocedure[Readback]


def read_status(unit: int) -> Subprocedure[tuple[StatusReply | None, SendResult]]:
    """A fresh 81h that nothing older can be taken for."""
    sent = yield from send(Send(ReadStatusRequest(unit), fresh=True))
    return (sent.reply if isinstance(sent.reply, StatusReply) else None), sent


def read_parameter(unit: int, number: int) -> Subprocedure[tuple[int | None, SendResult]]:
    """Read a parameter by 85h; None when the unit does not have it, or does not respond."""
    sent = yield from send(Send(ReadParameterRequest(unit, number), fresh=True))
    return (sent.reply.raw if isinstance(sent.reply, ParameterReply) else None), sent


class ScaleReading:
    """The parameters that the value for one unit was converted with, read again one by one and compared."""

    def __init__(self, unit: int, scale: UnitScale) -> None:
        self.unit = unit
        self.remaining = dict(scale)
        """Expected raw value of the parameters that are still to be read, by number."""
        self._changes: list[str | Message] = []
        self._failure: tuple[Outcome, Message] | None = None

    @property
    def difference(self) -> tuple[Outcome, Message] | None:
        """What the parameters read so far make of a command of which nothing was sent, and why; None where
        they are as expected."""
        if self._failure is None and self._changes:
            return "refused", Message.of("scale_changed", unit=self.unit, changes=self._changes)
        return self._failure

    def read_next(self) -> Subprocedure[None]:
        """Read the next parameter. One that cannot be read is the last."""
        if not self.remaining:
            return
        number = next(iter(self.remaining))
        expected = self.remaining.pop(number)
        raw, sent = yield from read_parameter(self.unit, number)
        if sent.status is SendStatus.PORT_CLOSED:
            self._failure = "bus_closed", Message("bus_link_lost")
        elif raw is None and sent.refusal != UnitErrorCode.ILLEGAL_PARAMETER_NUMBER:
            message = Message.of("scale_unread", unit=self.unit, number=parameter_name(number))
            self._failure = "unverified", message
        elif raw != expected:
            old, new = ("none" if value is None else value for value in (expected, raw))
            change = Message.of("scale_change", number=parameter_name(number), old=old, new=new)
            self._changes.append(change)
        if self._failure is not None:
            self.remaining.clear()

    def read_all(self) -> Subprocedure[None]:
        """Read what remains, also after a difference, so that the next value is converted right."""
        while self.remaining:
            yield from self.read_next()


def follows(record: UnitRecord, bits: StatusBits) -> Subprocedure[bool]:
    """Whether the unit is a follower: by #8, read now where it is not known or the status bit disagrees."""
    mode = record.raw(FOLLOWER_MODE)
    if mode is None or bool(mode) != bits.follower:
        mode, _ = yield from read_parameter(record.unit, FOLLOWER_MODE)
    return bits.follower if mode is None else mode != 0


def _until_shown(look: Callable[[], Subprocedure[Readback | None]]) -> Verification:
    """``look`` reads it once, and again where it differs; None: the unit did not respond."""
    readback = Readback(False)
    for count in range(1 + REREADS):
        if count:
            yield Wait(REREAD_AFTER_S)
        seen = yield from look()
        if seen is None:
            return Readback(False, readback.read_back, readback.at, NO_READBACK)
        readback = seen
        if readback.shown:
            break
    return readback


def verify_speed(record: UnitRecord, raw: int, dialect: Dialect, *, before: int | None) -> Verification:
    """Prove that ``raw`` is now the commanded speed (or ratio). ``before``: the CS read before the write."""

    def look() -> Subprocedure[Readback | None]:
        status, sent = yield from read_status(record.unit)
        if status is None:
            return None
        bits = status_bits(status.outputs, status.inputs, dialect.estop_healthy)
        if dialect.follower_speed == "speed" and (yield from follows(record, bits)):
            return (yield from _verify_ratio(record, raw, status, sent, before))
        if status.commanded == raw:
            return Readback(True, raw, sent.responded_at)
        return Readback(False, status.commanded, sent.responded_at, _speed_reads(status.commanded, bits))

    return (yield from _until_shown(look))


def _speed_reads(commanded: int, bits: StatusBits) -> Message:
    """Read the commanded speed, with the inputs that may stand above the setpoint."""
    active = [name for name, on in (("preset", bits.preset), ("up", bits.up), ("down", bits.down)) if on]
    inputs: list[str | Message] = [Message(f"status_{name}") for name in active]
    if not bits.remote:
        inputs.append("LOCAL")
    if not inputs:
        return Message.of("speed_reads", value=commanded)
    return Message.of("speed_reads_while", value=commanded, inputs=inputs)


def _verify_ratio(
    record: UnitRecord, raw: int, status: StatusReply, sent: SendResult, before: int | None
) -> Verification:
    ratio, ratio_read = yield from read_parameter(record.unit, RATIO_SETPOINT)
    if ratio == raw:
        return Readback(True, ratio, ratio_read.responded_at)
    if status.commanded == raw and before is not None and before != raw:
        return Readback(True, raw, sent.responded_at)
    if ratio is None:
        return Readback(False, status.commanded, sent.responded_at, Message("ratio_unread"))
    return Readback(False, ratio, ratio_read.responded_at, Message.of("ratio_reads", value=ratio))


def verify_unchanged(record: UnitRecord, before: int | None) -> Verification:
    """Prove that a unit to which nothing was to happen still has the commanded speed it had."""
    status, sent = yield from read_status(record.unit)
    if status is None:
        return Readback(False, None, None, NO_READBACK)
    if before is None or status.commanded == before:
        return Readback(True, status.commanded, sent.responded_at)
    why = Message.of("speed_moved", before=before, value=status.commanded)
    return Readback(False, status.commanded, sent.responded_at, why)


def verify_parameter(unit: int, number: int, raw: int) -> Verification:
    """Prove that 85h reads ``raw``."""

    def look() -> Subprocedure[Readback | None]:
        shown, sent = yield from read_parameter(unit, number)
        if sent.reply is None:
            return None
        if shown is None:
            why = Message("parameter_unavailable")
        elif PARAMETERS[number].secret:
            why = Message("secret_reads")
        else:
            why = Message.of("parameter_reads", value=shown)
        return Readback(shown == raw, shown, sent.responded_at, why)

    return (yield from _until_shown(look))


def verify_output(unit: int, number: int, on: bool) -> Verification:
    """Prove that the bit of output ``number`` in ST2 shows ``on``."""

    def look() -> Subprocedure[Readback | None]:
        status, sent = yield from read_status(unit)
        if status is None:
            return None
        shown = output_is_on(status.outputs, number)
        why = Message("output_reads_on" if shown else "output_reads_off")
        return Readback(shown == on, int(shown), sent.responded_at, why)

    return (yield from _until_shown(look))


def present_setpoint(record: UnitRecord, dialect: Dialect) -> Subprocedure[int | None]:
    """What 82h must put into a unit so that a stray execute changes nothing; None when it cannot be read.

    The commanded speed of a fresh 81h; a follower's ratio where CS is a speed; #20 while an input stands
    above the setpoint.
    """
    status, _ = yield from read_status(record.unit)
    if status is None:
        return None
    bits = status_bits(status.outputs, status.inputs, dialect.estop_healthy)
    follower = yield from follows(record, bits)
    if follower and (dialect.follower_speed == "speed" or bits.preset or bits.up or bits.down):
        ratio, _ = yield from read_parameter(record.unit, RATIO_SETPOINT)
        return ratio
    if bits.preset or bits.up or bits.down:
        setpoint, _ = yield from read_parameter(record.unit, SPEED_SETPOINT)
        return setpoint if setpoint is not None else status.commanded
    return status.commanded
