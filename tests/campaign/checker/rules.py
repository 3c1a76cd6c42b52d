"""What has to hold of a campaign. Each rule yields one line for each violation; pure."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

from tests.campaign.checker.frames import SET_AND_EXECUTE, Piece, WireFrame, decode
from tests.campaign.checker.records import HolderDeath, JournalRow, LiveValue, SentCommand
from tests.campaign.checker.writers import OwnedFrame

MAX_ATTEMPTS = 4
"""The first write and its three retries."""
MAX_TAKE_OVER_S = 10.0
MAX_BREAK_S = 20.0
"""What concerns two servers at once lasts for up to eight seconds, and a take-over may follow."""
NOTHING_SENT = {"not_sent", "bus_closed", "refused_here"}
"""Outcomes after which the wire must not carry the command; ``refused_here``: any refusal before sending."""
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
            sent.setdefault((owned.frame.unit, owned.frame.value), []).append(owned)
    for command in commands:
        found = sent.get((command.unit, command.raw), [])
        name = f"unit {command.unit} = {command.raw}"
        for owned in found:
            late_s = owned.frame.began - command.deadline
            if late_s > slack_s and not is_held(owned, command.deadline + slack_s, halts):
                yield f"{owned.frame.began:.3f}: {name} {late_s:.3f} s after its deadline"
        if len(found) > MAX_ATTEMPTS:
            yield f"{found[-1].frame.began:.3f}: {name} on the wire {len(found)} times"
        if len({owned.owner for owned in found}) > 1:
            yield f"{found[-1].frame.began:.3f}: {name} written by two connections"
        if found and command.outcome in NOTHING_SENT:
            yield f"{found[0].frame.began:.3f}: {name} on the wire, reported as {command.outcome}"


def is_held(owned: OwnedFrame, limit: float, halts: Iterable[Span]) -> bool:
    """Whether a frame that came to the device server by ``limit`` was held there, for it was halted then."""
    return owned.arrived <= limit and any(
        begin <= owned.frame.began and owned.arrived <= end for begin, end in halts
    )


def latest_s(commands: Iterable[SentCommand], frames: Sequence[OwnedFrame]) -> float | None:
    """How long before (negative) or after its deadline the latest command left for the wire; None of none."""
    deadlines = {(command.unit, command.raw): command.deadline for command in commands}
    return max(
        (
            owned.arrived - deadlines[owned.frame.unit, owned.frame.value]
            for owned in frames
            if owned.frame.command == SET_AND_EXECUTE and (owned.frame.unit, owned.frame.value) in deadlines
        ),
        default=None,
    )


def verified_commands(
    commands: Iterable[SentCommand], frames: Sequence[OwnedFrame], responses: Iterable[Piece]
) -> Iterator[str]:
    """A verified one was shown by its unit after it was written, before that was reported."""
    writes = [owned.frame for owned in frames if owned.frame.command == SET_AND_EXECUTE]
    shown = [item for item in decode(responses) if isinstance(item, WireFrame) and item.commanded is not None]
    times = [item.ended for item in shown]
    for command in commands:
        if command.outcome != "verified":
            continue
        first = next((f for f in writes if (f.unit, f.value) == (command.unit, command.raw)), None)
        if first is None:
            yield f"{command.responded_at:.3f}: unit {command.unit} = {command.raw} verified, never written"
            continue
        after = shown[bisect_left(times, first.ended) : bisect_left(times, command.responded_at)]
        if not any(item.unit == command.unit and item.commanded == command.raw for item in after):
            yield f"{command.responded_at:.3f}: unit {command.unit} = {command.raw} verified, never shown"


def events_kept(commands: Iterable[SentCommand], stored: Counter[tuple[int, int, str]]) -> Iterator[str]:
    """The database has each command whose outcome a client was given, with that outcome.

    ``stored`` counts (unit, raw, outcome).
    """
    for command in commands:
        if command.outcome in CONCLUDED and not stored[command.unit, command.raw, command.outcome]:
            yield (
                f"{command.responded_at:.3f}: unit {command.unit} = {command.raw}, {command.outcome}: "
                "not in the database"
            )


def transitions_kept(shown: Iterable[JournalRow], stored: set[JournalRow]) -> Iterator[str]:
    """The database has each transition that a client was shown or that it caused.

    One that it caused may have led to another state than it saw: its ``after`` is empty.
    """
    kept = stored | {replace(row, after="") for row in stored}
    for row in shown:
        if row not in kept:
            yield f"transition {row.alarm}, {row.trigger} → {row.after}: not in the database"


def take_overs(
    deaths: Iterable[HolderDeath], live: Sequence[LiveValue]
) -> Iterator[tuple[HolderDeath, float | None]]:
    """Seconds from each death to the first value that was read after it and shown by another server."""
    for death in deaths:
        values = (v.at for v in live if v.read_at > death.at and v.server != death.server)
        first = min(values, default=None)
        yield death, None if first is None else first - death.at


def late_take_overs(deaths: Iterable[HolderDeath], live: Sequence[LiveValue]) -> Iterator[str]:
    for death, seconds in take_overs(deaths, live):
        if seconds is None:
            yield f"{death.at:.3f}: {death.server} died, no other server showed a live value"
        elif seconds > MAX_TAKE_OVER_S:
            yield f"{death.at:.3f}: {death.server} died, {seconds:.1f} s to the first live value"


def long_breaks(live: Sequence[LiveValue]) -> Iterator[str]:
    """Where there are two servers, one of them shows live values soon after anything that happens."""
    if len({value.server for value in live}) < 2:
        return
    for before, after in pairwise(sorted(value.at for value in live)):
        if after - before > MAX_BREAK_S:
            yield f"{before:.3f}: no live value on any server for {after - before:.1f} s"
