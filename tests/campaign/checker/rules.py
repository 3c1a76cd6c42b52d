"""What has to hold of a campaign. Each rule yields one line for each violation; pure."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from decimal import Decimal

from tests.campaign.checker.frames import READ_PARAMETER, SET_AND_EXECUTE, Piece, WireFrame, decode
from tests.campaign.checker.records import (
    JournalRow,
    KeypadChange,
    SentCommand,
    ShownValue,
    StoredValue,
    digits,
)
from tests.campaign.checker.writers import OwnedFrame

MAX_ATTEMPTS = 4
"""The first write and its three retries."""
MAX_BREAK_S = 30.0
"""From the end of a fault to a fresh value of each unit, which is polled less often while it is silent."""
DECIMALS, FOLLOWER_MODE, RATIO_DECIMALS = 3, 8, 4
"""Parameters that make the number on a unit's display, and the decimals of a ratio (manual, section 4)."""
CONCLUDED = {"verified", "acknowledged", "refused", "unverified"}
"""Outcomes that the database must hold, for the command was sent or may have been."""
Span = tuple[float, float]
"""Begin and end, Unix time."""


def commands_on_the_wire(
    commands: Sequence[SentCommand], frames: Sequence[OwnedFrame], halts: Sequence[Span], slack_s: float
) -> Iterator[str]:
    """None after its deadline, none more often than a write is retried, none by two writers, none refused.

    ``slack_s``: what a frame may take from the worker to the wire: its bytes, the network, the recorder.
    ``halts``: when the device server stood still, and held back what had arrived in time.
    """
    sent: dict[tuple[int, int], list[OwnedFrame]] = {}
    for owned in frames:
        if owned.frame.command == SET_AND_EXECUTE:
            sent.setdefault((owned.frame.unit, digits(owned.frame.value)), []).append(owned)
    for command in commands:
        found = sent.get((command.unit, command.digits), [])
        name = command.name
        for owned in found:
            late_s = owned.frame.began - command.deadline
            if late_s > slack_s and not is_held(owned, command.deadline + slack_s, halts):
                yield f"{owned.frame.began:.3f}: {name} {late_s:.3f} s after its deadline"
        if len(found) > MAX_ATTEMPTS:
            yield f"{found[-1].frame.began:.3f}: {name} on the wire {len(found)} times"
        if len({owned.owner for owned in found}) > 1:
            yield f"{found[-1].frame.began:.3f}: {name} written by two connections"
        if found and command.is_unsent:
            yield f"{found[0].frame.began:.3f}: {name} on the wire, reported as {command.outcome}"


def is_held(owned: OwnedFrame, limit: float, halts: Iterable[Span]) -> bool:
    """Whether a frame that came to the device server by ``limit`` was held there, for it was halted then."""
    return owned.arrived <= limit and any(
        begin <= owned.frame.began and owned.arrived <= end for begin, end in halts
    )


def latest_s(commands: Iterable[SentCommand], frames: Sequence[OwnedFrame]) -> float | None:
    """How long before (negative) or after its deadline the latest command left for the wire; None of none."""
    deadlines = {(command.unit, command.digits): command.deadline for command in commands}
    return max(
        (
            owned.arrived - deadlines[owned.frame.unit, digits(owned.frame.value)]
            for owned in frames
            if owned.frame.command == SET_AND_EXECUTE
            and (owned.frame.unit, digits(owned.frame.value)) in deadlines
        ),
        default=None,
    )


def verified_commands(
    commands: Iterable[SentCommand],
    frames: Sequence[OwnedFrame],
    responses: Iterable[Piece],
    keypads: Sequence[KeypadChange],
) -> Iterator[str]:
    """A verified one was shown by its unit after it was written, before that was reported; a typed one as the
    number that the unit displays after the last look at its scale."""
    writes: dict[tuple[int, int], WireFrame] = {}
    looks: defaultdict[int, list[float]] = defaultdict(list)
    for frame in (owned.frame for owned in frames):
        if frame.command == SET_AND_EXECUTE:
            writes.setdefault((frame.unit, digits(frame.value)), frame)
        elif frame.body[1:] == bytes((READ_PARAMETER, FOLLOWER_MODE)):
            looks[frame.unit].append(frame.ended)
    shown = [item for item in decode(responses) if isinstance(item, WireFrame)]
    times = [item.ended for item in shown]
    for command in commands:
        if command.outcome != "verified":
            continue
        when, name = f"{command.responded_at:.3f}", command.name
        first = writes.get((command.unit, command.digits))
        if first is None:
            yield f"{when}: {name} verified, never written"
            continue
        after = shown[bisect_left(times, first.ended) : bisect_left(times, command.responded_at)]
        after = [item for item in after if item.unit == command.unit]
        proof = next((item.ended for item in after if item.shown == first.value), None)
        if proof is None:
            yield f"{when}: {name} verified, never shown"
            continue
        look = next((at for at in looks[command.unit] if at > proof), proof)
        seen = next((item.ended for item in after if item.ended > look), proof)
        displayed = displayed_numbers(command.unit, first.value, keypads, (seen, command.responded_at))
        if command.typed is not None and Decimal(command.typed) not in displayed:
            yield f"{when}: {name} verified, the unit displays {', '.join(map(str, sorted(displayed)))}"


def displayed_numbers(unit: int, raw: int, keypads: Iterable[KeypadChange], span: Span) -> set[Decimal]:
    """What a unit shows of a setpoint within a span, by what was typed at its keypad."""
    changes = [change for change in keypads if change.unit == unit]
    numbers = set()
    if any(raw_before_or_in(changes, FOLLOWER_MODE, span)):
        numbers.add(Decimal(raw).scaleb(-RATIO_DECIMALS))
    if 0 in raw_before_or_in(changes, FOLLOWER_MODE, span):
        numbers |= {Decimal(raw).scaleb(-each) for each in raw_before_or_in(changes, DECIMALS, span)}
    return numbers


def raw_before_or_in(changes: Iterable[KeypadChange], number: int, span: Span) -> set[int]:
    """The values that a parameter of one unit may have had within a span."""
    begin, end = span
    found: set[int] = set()
    for change in sorted((each for each in changes if each.number == number), key=lambda each: each.began):
        if change.ended < begin:
            found = {change.raw}
        elif change.began <= end:
            found.add(change.raw)
    return found


def values_reported(
    values: Iterable[ShownValue],
    stored: Iterable[StoredValue],
    responses: Iterable[Piece],
    keypads: Sequence[KeypadChange],
) -> Iterator[str]:
    """Each value that was shown or stored is one that its unit had sent, in a scale that the unit has had."""
    sent: dict[tuple[int, tuple[int, int, int]], float] = {}
    for item in decode(responses):
        if isinstance(item, WireFrame) and item.status is not None:
            sent.setdefault((item.unit, item.status), item.ended)
    first_shown = {(value.unit, value.raw, value.texts): value for value in reversed([*values])}
    for value in first_shown.values():
        if sent.get((value.unit, value.raw), value.at) >= value.at:
            yield f"{value.at:.3f}: unit {value.unit} shown with {value.raw}, which it had not sent"
        possible = _in_decimals(value.unit, value.raw[:2], keypads, value.at)
        for text in value.texts:
            if text is not None and Decimal(text) not in possible:
                yield f"{value.at:.3f}: unit {value.unit} shown with {text} of {value.raw[:2]}"
    speeds: defaultdict[tuple[int, str], set[int]] = defaultdict(set)
    for unit, (commanded, actual, _) in sent:
        speeds[unit, "commanded"].add(commanded)
        speeds[unit, "actual"].add(actual)
    for row in stored:
        every = _in_decimals(row.unit, speeds[row.unit, row.value], keypads, float("inf"))
        known = {round(float(number), RATIO_DECIMALS) for number in every}
        for wrong in sorted({round(number, RATIO_DECIMALS) for number in row.numbers} - known):
            yield f"unit {row.unit} stored with {row.value} {wrong}, which it had not sent"


def _in_decimals(
    unit: int, raw: Iterable[int], keypads: Sequence[KeypadChange], until: float
) -> set[Decimal]:
    """Speeds in each scale that a unit has had."""
    changes = [change for change in keypads if change.unit == unit]
    decimals = raw_before_or_in(changes, DECIMALS, (0.0, until))
    return {Decimal(each).scaleb(-places) for each in raw for places in decimals}


def events_kept(commands: Iterable[SentCommand], stored: Counter[tuple[int, int, str]]) -> Iterator[str]:
    """The database has each command whose outcome a client was given, with that outcome.

    ``stored`` counts (unit, digits, outcome).
    """
    for command in commands:
        if command.outcome in CONCLUDED and not stored[command.unit, command.digits, command.outcome]:
            yield f"{command.responded_at:.3f}: {command.name}, {command.outcome}: not in the database"


def transitions_kept(shown: Iterable[JournalRow], stored: set[JournalRow]) -> Iterator[str]:
    """The database has each transition that a client was shown or that it caused.

    One that it caused may have led to another state than it saw: its ``after`` is empty.
    """
    kept = stored | {replace(row, after="") for row in stored}
    for row in shown:
        if row not in kept:
            yield f"transition {row.alarm}, {row.trigger} → {row.after}: not in the database"


def missing_returns(faults: Sequence[Span], values: Sequence[ShownValue]) -> Iterator[str]:
    """After a fault that no other follows meanwhile, every unit is live again, with a value read after it."""
    live = [value for value in values if value.link == "online"]
    last = max((value.at for value in values), default=0.0)
    began = [begin for begin, _ in faults]
    for _, ended in faults:
        due = ended + MAX_BREAK_S
        if any(ended < begin < due for begin in began):
            continue
        back = {value.unit for value in live if value.read_at > ended and value.at <= due}
        for unit in sorted({value.unit for value in live} - back) if due < last else ():
            yield f"{ended:.3f}: unit {unit} not live {MAX_BREAK_S:.0f} s after a fault"
