"""Judges a host: compares its reports with the simulated line's record.

The record is independent evidence: what each unit received, did and sent, before any fault changed it. Every
function returns the defects as text; none is the pass.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field

from bus.contract import (
    Action,
    ParameterValue,
    Reading,
    Result,
    SetLine,
    SetSpeed,
    Update,
    WriteAnalogOutput,
    WriteOutput,
    WriteParameter,
)
from bus.simulator.line import WireEvent, WireEventKind, WireRecord
from bus.simulator.unit import Unit
from bus.wire.framing import ACK, NAK

READ_STATUS, STAGE, EXECUTE, SET, READ_PARAMETER = 0x81, 0x82, 0x83, 0x84, 0x85
WRITES = frozenset((STAGE, EXECUTE, SET, 0x86, 0x87, 0x88))
UNSENT = frozenset(("not_sent", "bus_closed", "invalid"))
Speeds = dict[int, tuple[int, int]]
"""By unit: its executed and its staged speed."""
Times = defaultdict[tuple[int, int, int | None], list[float]]


# --- readings -------------------------------------------------------------------------------------


@dataclass
class SentValues:
    """What units sent: each status body and each parameter's value, with the times."""

    statuses: defaultdict[bytes, list[float]] = field(default_factory=lambda: defaultdict(list))
    parameters: Times = field(default_factory=lambda: defaultdict(list))

    @classmethod
    def of(cls, record: WireRecord) -> SentValues:
        """All that is on record."""
        sent, requests = cls(), dict[int, bytes]()
        for entry in record.since(0, WireEventKind.RECEIVED, WireEventKind.RESPONDED):
            if entry.what is WireEventKind.RECEIVED:
                requests[entry.unit] = entry.data
            else:
                sent._note(requests[entry.unit], entry)
        return sent

    def _note(self, request: bytes, entry: WireEvent) -> None:
        body = entry.data
        if request[1] == READ_STATUS and body[1] == ACK:
            self.statuses[body].append(entry.at)
        elif request[1] == READ_PARAMETER:
            raw = None if body[1] == NAK else int.from_bytes(body[2:], "big")
            self.parameters[body[0], request[2], raw].append(entry.at)


def status_body(reading: Reading) -> bytes:
    """Return the body of the response that ``reading`` reports."""
    speeds = reading.commanded.to_bytes(4, "big") + reading.actual.to_bytes(4, "big")
    return bytes((reading.unit, ACK)) + speeds + bytes((reading.analog, reading.outputs, reading.inputs))


def made_up(updates: Iterable[Update], record: WireRecord, epoch: float) -> list[str]:
    """Return readings and parameters that no unit had sent when they were reported; ``epoch``: the record's
    zero.
    """
    sent = SentValues.of(record)
    return [f"no unit ever said {update}" for update in updates if not _was_sent(update, sent, epoch)]


def _was_sent(update: Update, sent: SentValues, epoch: float) -> bool:
    match update:
        case Reading():
            times = sent.statuses.get(status_body(update), [])
        case ParameterValue():
            times = sent.parameters.get((update.unit, update.number, update.raw), [])
        case _:
            return True
    return any(at <= update.at - epoch for at in times)


# --- writes ---------------------------------------------------------------------------------------


@dataclass
class Case:
    """One command from its request to its result. Times on the record's clock."""

    action: Action
    requested_at: float
    deadline: float
    result: Result
    reported_at: float

    def wanted(self) -> dict[bytes, int]:
        """Every request that may act for it, as a body, and the unit meant (0: all)."""
        match self.action:
            case SetSpeed(unit=unit, raw=raw, execute=execute):
                return {_body(unit, SET if execute else STAGE, raw): unit}
            case SetLine(setpoints=setpoints):
                stages = {_body(unit, STAGE, raw): unit for unit, raw in setpoints.items()}
                singly = {bytes((unit, EXECUTE)): unit for unit in setpoints}
                return stages | singly | {bytes((0, EXECUTE)): 0}
            case WriteParameter(unit=unit, number=number, raw=raw):
                return {bytes((unit, 0x86, number)) + raw.to_bytes(4, "big"): unit}
            case WriteOutput(unit=unit, number=number, on=on):
                return {bytes((unit, 0x87, number, on)): unit}
            case WriteAnalogOutput(unit=unit, raw=raw):
                return {_body(unit, 0x88, raw): unit}
        raise AssertionError(f"the judge knows nothing of {self.action}")


def _body(unit: int, command: int, raw: int) -> bytes:
    return bytes((unit, command)) + raw.to_bytes(4, "big")


def untrue_result(case: Case, record: WireRecord, unit_at: Callable[[int], Unit]) -> list[str]:
    """Compare the result of ``case`` with what its units did; called before the next case."""
    acted = [entry.data for entry in _acted(case, record)]
    outcome, complaints = case.result.outcome, list[str]()
    for unit, shown in _shown(case.action, unit_at).items():
        if outcome == "verified" and not shown:
            complaints.append(f"verified, and unit {unit} does not hold it")
    if isinstance(case.action, SetLine):
        return complaints
    if outcome == "acknowledged" and not acted:
        complaints.append("acknowledged, and the unit did not act")
    if outcome in UNSENT | {"refused"} and acted:
        complaints.append(f"{outcome}, and the unit acted")
    return [f"{case.action}: {complaint}" for complaint in complaints]


def _acted(case: Case, record: WireRecord) -> list[WireEvent]:
    wanted = case.wanted()
    return [
        entry
        for entry in record.since(0, WireEventKind.ACTED)
        if entry.data in wanted and case.requested_at <= entry.at <= case.reported_at
    ]


def _shown(action: Action, unit_at: Callable[[int], Unit]) -> dict[int, bool]:
    match action:
        case SetSpeed(unit=unit, raw=raw, execute=True):
            return {unit: unit_at(unit).setpoint == raw}
        case SetLine(setpoints=setpoints):
            return {unit: unit_at(unit).setpoint == raw for unit, raw in setpoints.items()}
        case WriteParameter(unit=unit, number=number, raw=raw):
            return {unit: unit_at(unit).memory[number] == raw}
        case WriteOutput(unit=unit, number=number, on=on):
            return {unit: unit_at(unit).outputs[number - 1] == on}
    return {}


def unrequested(cases: list[Case], record: WireRecord) -> list[str]:
    """Return writes that a unit carried out without a command at that time.

    A change of all units may also write a unit's present speed back into its memory.
    """
    present: dict[int, int] = {}
    complaints = []
    for entry in record.since(0, WireEventKind.ACTED):
        case = next((case for case in cases if case.requested_at <= entry.at <= case.reported_at), None)
        back = isinstance(case and case.action, SetLine) and _puts_back(entry, present)
        if case is None or not (entry.data in case.wanted() or back):
            complaints.append(f"unit {entry.unit} did {entry.data.hex(' ')} at {entry.at:.3f}, unrequested")
        _follow(entry, present)
    return complaints


def _puts_back(entry: WireEvent, present: dict[int, int]) -> bool:
    raw = int.from_bytes(entry.data[2:], "big")
    return entry.data[1] == STAGE and present.get(entry.data[0], raw) == raw


def _follow(entry: WireEvent, present: dict[int, int]) -> None:
    """Update the speed that a unit has, as far as the record shows it."""
    if entry.data[1] == SET:
        present[entry.data[0]] = int.from_bytes(entry.data[2:], "big")
    elif entry.data[1] == EXECUTE:
        present.pop(entry.data[0] or entry.unit, None)


def too_late(cases: list[Case], written: Iterable[tuple[float, bytes]], slack_s: float = 0.0) -> list[str]:
    """Writes that left the host after the deadline of their command. ``written``: when and which body."""
    complaints = []
    for at, body in written:
        if body[1] not in WRITES:
            continue
        for case in cases:
            if (
                body in case.wanted()
                and case.requested_at <= at <= case.reported_at
                and at > case.deadline + slack_s
            ):
                complaints.append(f"{case.action}: {body.hex(' ')} left {at - case.deadline:.3f} s late")
    return complaints


def rash_broadcasts(cases: list[Case], record: WireRecord) -> list[str]:
    """83h to all before every unit of that very change had taken its 82h."""
    complaints = []
    for case, broadcast in _broadcasts(cases, record):
        assert isinstance(case.action, SetLine)
        staged = {entry.data for entry in _acted(case, record) if entry.at < broadcast.at}
        missing = [
            unit for unit, raw in case.action.setpoints.items() if _body(unit, STAGE, raw) not in staged
        ]
        if missing:
            complaints.append(f"broadcast at {broadcast.at:.3f} while units {missing} had not staged")
    return complaints


def _broadcasts(cases: list[Case], record: WireRecord) -> Iterator[tuple[Case, WireEvent]]:
    received: dict[float, WireEvent] = {
        entry.at: entry
        for entry in record.since(0, WireEventKind.RECEIVED)
        if entry.data == bytes((0, EXECUTE))
    }
    for entry in received.values():
        for case in cases:
            if case.requested_at <= entry.at <= case.reported_at and isinstance(case.action, SetLine):
                yield case, entry


def half_done(case: Case, before: Speeds, record: WireRecord, unit_at: Callable[[int], Unit]) -> list[str]:
    """A change of all units without a broadcast must leave every speed as it was, and nothing staged unsaid.

    What an operator had staged before may stay, or give way to the present speed.
    """
    if not isinstance(case.action, SetLine) or list(_broadcasts([case], record)):
        return []
    complaints = []
    for unit, (speed, entered) in before.items():
        now = unit_at(unit)
        if now.setpoint != speed:
            complaints.append(f"unit {unit} was changed from {speed} to {now.setpoint}")
        if now.entered not in (speed, entered) and "staged" not in str(case.result.message):
            complaints.append(f"unit {unit} still holds {now.entered} staged, unsaid: {case.result.message}")
    return complaints
