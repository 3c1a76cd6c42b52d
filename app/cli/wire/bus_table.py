"""What a scan has found as the ``[[bus]]`` of a lineside.toml. Pure."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Sequence

from bus.line.scan.found import Found, settings_seen

NAME = "line-1"


def bus_table(port: str, found: Sequence[Found], turnaround_ms: float) -> str:
    """The table, with a ``[[bus.unit]]`` for each drive in the order of addresses. A bus has one baud rate:
    that of most units; others are named in a comment. ``turnaround_ms``: what was needed."""
    drives = [one for one in found if one.kind == "digimax"]
    baud = Counter(one.baud for one in drives).most_common(1)[0][0] if drives else 9600
    own = [one for one in drives if one.baud == baud]
    return "\n".join([*_of_bus(port, baud, own, turnaround_ms), *_of_units(own), *_others(found, own), ""])


def _of_bus(port: str, baud: int, own: Sequence[Found], turnaround_ms: float) -> Iterator[str]:
    yield from ("[[bus]]", f"name = {json.dumps(NAME)}", f"port = {json.dumps(port)}", f"baud = {baud}")
    yield f"turnaround_ms = {turnaround_ms:g}"
    for key, value in settings_seen(own).items():
        if value is not None:
            yield f"{key} = {json.dumps(value)}"


def _of_units(own: Sequence[Found]) -> Iterator[str]:
    for one in own:
        yield from ("", "[[bus.unit]]", f"id = {one.unit}", f'name = "Unit {one.unit}"')


def _others(found: Sequence[Found], own: Sequence[Found]) -> Iterator[str]:
    for one in found:
        if one not in own:
            yield f"# Address {one.unit} at {one.baud} baud: {one.kind}."
