"""``python -m tests.campaign.checker FOLDER STORE BUS…``: every violation on a line, then what was judged."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from tests.campaign.checker import records, rules, stored
from tests.campaign.checker.frames import SET_AND_EXECUTE
from tests.campaign.checker.writers import attribute

SLACK_S = 1.0
"""From the worker's decision to the wire: 0.8 s in which unacknowledged bytes may still arrive
(``TCP_USER_TIMEOUT`` of the worker), and what device server and recorder take."""


def violations(folder: Path, store: str, bus: str) -> Iterator[str]:
    """Everything that does not hold of one bus."""
    found = records.read(folder, bus)
    ownership = attribute(found.requests, found.connections)
    yield from ownership.violations
    yield from rules.commands_on_the_wire(found.commands, ownership.owners, found.halts, SLACK_S)
    yield from rules.verified_commands(found.commands, ownership.owners, found.responses, found.keypads)
    yield from rules.values_reported(found.values, found.stored, found.responses, found.keypads)
    yield from rules.events_kept(found.commands, stored.commands(store, bus))
    yield from rules.transitions_kept([*found.acknowledged, *found.shown], stored.journal(store, bus))
    yield from rules.missing_returns(found.faults, found.values)


def summary(folder: Path, bus: str) -> str:
    """How much was judged: a campaign without commands proves nothing."""
    found = records.read(folder, bus)
    frames = attribute(found.requests, found.connections).owners
    held = sum(
        rules.is_held(owned, owned.arrived, found.halts) and owned.frame.command == SET_AND_EXECUTE
        for owned in frames
        if found.connections
    )
    outcomes = Counter(command.outcome or "without a response" for command in found.commands)
    typed = sum(command.typed is not None and command.outcome == "verified" for command in found.commands)
    latest = rules.latest_s(found.commands, frames)
    margin = "" if latest is None else f", the latest left {latest:+.2f} s from its deadline"
    changes = sum(change.began > 0 for change in found.keypads)
    stored_count = sum(len(value.numbers) for value in found.stored)
    return (
        f"{bus}: {len(frames)} requests of {len({owned.owner for owned in frames})} connections; "
        f"{len(found.commands)} commands: "
        f"{', '.join(f'{count} {outcome}' for outcome, count in sorted(outcomes.items())) or 'none'} "
        f"({typed} typed and verified){margin}; {held} held by a halted device server; "
        f"{len(found.faults)} faults, {changes} changes at keypads; "
        f"{len(found.values)} values shown, {stored_count} stored; "
        f"{len(found.acknowledged)} acknowledged alarms, {len(found.shown)} transitions"
    )


def main(folder: str, store: str, *buses: str) -> int:
    """Exit with 1 where something does not hold."""
    wrong = [f"{bus}: {line}" for bus in buses for line in violations(Path(folder), store, bus)]
    print(*wrong, *(summary(Path(folder), bus) for bus in buses), sep="\n")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
