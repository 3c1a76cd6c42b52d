"""The moving picture of the README: made of still ones, small, and of what it is to show."""

from __future__ import annotations

import struct

from docs.animation import chunks
from docs.scenes import SITUATIONS
from docs.screenshots import ANIMATION, SIZES, STORY, STORY_SIZE
from tests.test_architecture import ROOT, text_of

MAX_BYTES = 400_000


def still(data: bytes) -> bytes:
    """A file with one picture, and a profile that no frame needs."""
    profile = b"ICCP" + struct.pack("<I", 2) + b"xy"
    padded = data + b"\0" * (len(data) % 2)
    body = b"WEBP" + profile + b"VP8 " + struct.pack("<I", len(data)) + padded
    return b"RIFF" + struct.pack("<I", len(body)) + body


def test_the_story_is_of_scenes_that_there_are() -> None:
    there = {(situation.name, scene.name) for situation in SITUATIONS for scene in situation.scenes}
    assert set(STORY) <= there


def test_the_picture_of_the_readme_is_small_and_has_every_frame() -> None:
    kept = ANIMATION.read_bytes()
    parts = list(chunks(kept))
    assert len(kept) <= MAX_BYTES
    assert [name for name, _ in parts].count(b"ANMF") == len(STORY)
    width, height = (int.from_bytes(parts[0][1][at : at + 3], "little") + 1 for at in (4, 7))
    assert (width, height) == SIZES[STORY_SIZE]
    assert f"]({ANIMATION.relative_to(ROOT)})" in text_of(ROOT / "README.md")
