"""A second decoder, written from the manual's section 2.0 alone and sharing nothing with ``bus.wire``.

It has the complete recording, which keeps it simple: at every ``10 02`` it reads a frame; if that is none, it
continues one byte further on.
"""

from __future__ import annotations


def reference_frames(recording: bytes) -> list[bytes]:
    """The bodies of all good frames, in order."""
    bodies: list[bytes] = []
    at = 0
    while at < len(recording) - 1:
        found = _frame_at(recording, at)
        if found is None:
            at += 1
        else:
            body, at = found
            bodies.append(body)
    return bodies


def reference_frame(body: bytes) -> bytes:
    """The frame of ``body``, the checksum sent once."""
    doubled = [byte for value in body for byte in ([16, 16] if value == 16 else [value])]
    return bytes([16, 2, *doubled, 16, 3, (256 - sum(body) % 256) % 256])


def _frame_at(recording: bytes, start: int) -> tuple[bytes, int] | None:
    if recording[start : start + 2] != bytes([16, 2]):
        return None
    body = []
    at = start + 2
    while recording[at : at + 2] != bytes([16, 3]):
        if at >= len(recording):
            return None
        if recording[at] == 16:
            at += 1
            if recording[at : at + 1] != bytes([16]):
                return None
        body.append(recording[at])
        at += 1
        if len(body) > 13:
            return None
    # The longest message of the manual is the response to READ SPEED AND STATUS, 13 bytes; the shortest has
    # 2.
    if len(body) < 2 or at + 2 >= len(recording):
        return None
    good = (sum(body) + recording[at + 2]) % 256 == 0
    return (bytes(body), at + 3) if good else None
