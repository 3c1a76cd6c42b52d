"""Who wrote each frame of the wire: the connections to the device server, one after the other or not."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

from tests.campaign.checker.frames import Piece, Stray, WireFrame, decode

CLOCKS_S = 0.05
"""What the clocks of two recorders of one machine may differ, and what a recorder takes to write a line."""


@dataclass
class _Writer:
    """A connection: the frames that came on it, and how many of them were found on the wire."""

    peer: str
    frames: list[WireFrame]
    place: int = 0

    def find(self, frame: WireFrame) -> int | None:
        """The place of ``frame`` among those not yet found; what comes before it never reached the wire."""
        for place in range(self.place, len(self.frames)):
            sent = self.frames[place]
            if sent.began > frame.ended + CLOCKS_S:
                return None
            if sent.body == frame.body:
                return place
        return None


@dataclass(frozen=True)
class OwnedFrame:
    """A frame of the wire with its connection, and when it arrived on it; "": no connection carried it."""

    frame: WireFrame
    owner: str
    arrived: float


@dataclass
class Ownership:
    """Each frame of the wire with its connection, and what is wrong."""

    owners: list[OwnedFrame] = field(default_factory=list)
    violations: list[str] = field(default_factory=list)


def attribute(requests: Iterable[Piece], connections: Mapping[str, list[Piece]]) -> Ownership:
    """Find the writer of every frame. A connection that another has followed may write nothing more.

    Without connections it is a port of the server itself: one process has it, and what foreign settings of it
    make of the bytes is not judged.
    """
    if not connections:
        frames = (item for item in decode(requests) if isinstance(item, WireFrame))
        return Ownership([OwnedFrame(frame, "port", frame.began) for frame in frames])
    writers = {peer: _Writer(peer, list(_frames(pieces))) for peer, pieces in connections.items()}
    result, current = Ownership(), ""
    ended: set[str] = set()
    for item in decode(requests):
        if isinstance(item, Stray):
            result.violations.append(f"{item.at:.3f}: bytes of no frame on the wire: {item.data.hex(' ')}")
            continue
        owned = _owned(item, writers, current)
        owner = owned.owner
        result.owners.append(owned)
        if not owner:
            result.violations.append(f"{item.ended:.3f}: no connection carried {item.body.hex(' ')}")
        elif owner != current:
            if owner in ended:
                result.violations.append(f"{item.ended:.3f}: {owner} writes after {current} has")
            ended.add(current)
            current = owner
    return result


def _owned(item: WireFrame, writers: Mapping[str, _Writer], current: str) -> OwnedFrame:
    """By the one that writes now where it sent this frame, else by the one that sent it last."""
    found = {peer: place for peer, writer in writers.items() if (place := writer.find(item)) is not None}
    if not found:
        return OwnedFrame(item, "", item.began)
    peer = (
        current if current in found else max(found, key=lambda peer: writers[peer].frames[found[peer]].began)
    )
    writers[peer].place = found[peer] + 1
    return OwnedFrame(item, peer, writers[peer].frames[found[peer]].began)


def _frames(pieces: list[Piece]) -> Iterator[WireFrame]:
    return (item for item in decode(pieces) if isinstance(item, WireFrame))
