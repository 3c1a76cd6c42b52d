"""What a unit saw of its restore, against what the product claims. Nothing is imported from the product.

A claim is false where the unit never showed it: *verified* without a read of that value, *equal* where the
last read of a row was another, *not sent* where a write arrived.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

from tests.path.independent_unit import ACK, Unit, frame

READ, WRITE = 0x85, 0x86


class Seen(NamedTuple):
    """An 85h to which a unit responded, or an 86h that it carried out, acknowledged alone, or refused."""

    what: Literal["read", "written", "acknowledged", "refused"]
    number: int
    raw: int


@dataclass
class WatchedUnit(Unit):
    """``seen``: in order. ``spoil``: makes another reply of each, None for none. ``hooks``: by the number of
    the write before which it is called, once."""

    seen: list[Seen] = field(default_factory=list)
    spoil: Callable[[bytes], bytes | None] | None = None
    refuses: set[int] = field(default_factory=set)
    hooks: dict[int, Callable[[], None]] = field(default_factory=dict)
    forgets: set[int] = field(default_factory=set)
    """Parameters whose value it loses once it was read back."""
    writes_seen: int = 0

    def respond(self, body: bytes) -> bytes | None:
        """As any unit does, and remembers it."""
        is_write = body[0] == self.address and body[1] == WRITE
        if is_write and not self.off:
            self.writes_seen += 1
            hook = self.hooks.pop(self.writes_seen, None)
            if hook is not None:
                hook()
        before = dict(self.values)
        reply = super().respond(body)
        if body[0] == self.address and not self.off:
            self._remember(body, before)
        return self.spoil(reply) if reply and self.spoil else reply

    def _remember(self, body: bytes, before: Mapping[int, int]) -> None:
        command, data = body[1], body[2:]
        if command == READ and data[0] in self.values:
            self.seen.append(Seen("read", data[0], self.values[data[0]]))
            if data[0] in self.forgets:
                self.forgets.discard(data[0])
                self.values[data[0]] = before[data[0]] ^ 1
        elif command == WRITE:
            number, raw = data[0], int.from_bytes(data[1:], "big")
            if not self.remote or number in self.refuses:
                self.seen.append(Seen("refused", number, raw))
            elif WRITE in self.deaf_to:
                self.seen.append(Seen("acknowledged", number, raw))
            else:
                self.seen.append(Seen("written", number, raw))

    def _write(self, command: int, data: bytes) -> int:
        if command == WRITE and data[0] in self.refuses:
            return 0x83
        return super()._write(command, data)

    def heal(self) -> None:
        """Let every fault of the unit end; its values stay."""
        self.remote, self.off, self.spoil = True, False, None
        self.refuses, self.deaf_to, self.mute_on = set(), set(), set()
        self.hooks, self.forgets, self.writes_seen = {}, set(), 0


def wrong_checksum(reply: bytes) -> bytes:
    """A reply that the line has spoilt."""
    return reply[:-1] + bytes([reply[-1] ^ 0x55])


def of_another(reply: bytes) -> bytes:
    """The same reply, as the unit with the next address would send it."""
    return frame(bytes([reply[2] + 1, ACK]))


def complaints(
    claimed: Mapping[str, Any], wanted: Mapping[int, int], seen: list[Seen], others: Iterable[tuple[int, int]]
) -> list[str]:
    """False claims of a restore that has ended. ``seen``: between its start and its end; ``others``: rows
    that others wrote meanwhile."""
    found = []
    written = max((place for place, each in enumerate(seen) if each.what != "read"), default=0)
    proof = {(each.number, each.raw) for each in seen[written:] if each.what == "read"}
    rows = {row["number"]: row for row in claimed["rows"] if row["selected"]}
    for number, row in rows.items():
        found += _of_row(number, row, wanted[number], seen)
    left = {row["number"] for row in claimed["left_out"]}
    compared = {number: raw for number, raw in wanted.items() if number not in left}
    if claimed["state"] == "equal":
        found += [
            f"equal, and #{number} was not read as {raw} after the last write"
            for number, raw in compared.items()
            if (number, raw) not in proof
        ]
    elif claimed["state"] == "different":
        remaining = {row["number"] for row in claimed["remaining"]}
        found += [
            f"different in {sorted(remaining)}, and #{number} was not read so after the last write"
            for number, raw in compared.items()
            if not any((n == number and (value == raw) != (number in remaining)) for n, value in proof)
        ]
    elif claimed["state"] != "stopped" or not claimed["cause"]:
        found.append(f"it ended {claimed['state']} without a cause")
    requested = {(number, wanted[number]) for number in rows} | set(others)
    found += [
        f"{each.what} #{each.number} = {each.raw}, which no one requested"
        for each in seen
        if each.what != "read" and (each.number, each.raw) not in requested
    ]
    return found


def _of_row(number: int, row: Mapping[str, Any], raw: int, seen: list[Seen]) -> list[str]:
    arrived = [each.what for each in seen if each.what != "read" and (each.number, each.raw) == (number, raw)]
    outcome = row["outcome"]
    if outcome == "verified" and Seen("read", number, raw) not in seen:
        return [f"#{number} is called verified, and was never read as {raw}"]
    if outcome == "verified" and not arrived:
        return [f"#{number} is called verified, and no write of it arrived"]
    if outcome == "refused" and ("written" in arrived or "refused" not in arrived):
        return [f"#{number} is called refused; the unit: {arrived}"]
    if outcome in (None, "not_sent", "bus_closed", "invalid") and arrived:
        return [f"#{number} is called {outcome}; the unit: {arrived}"]
    if outcome not in (None, "verified", "unverified", "refused", "not_sent", "bus_closed", "invalid"):
        return [f"#{number} has the outcome {outcome}"]
    return []
