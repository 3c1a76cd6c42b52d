"""The moving picture of the README: made of still ones, small, and of what it is to show."""

from __future__ import annotations

import struct

import pytest

from docs.animation import animated, chunks
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


def test_each_picture_becomes_a_frame() -> None:
    first, second = (
        data
        for name, data in chunks(animated([still(b"abc"), still(b"wxyz")], (640, 400), 1500))
        if name == b"ANMF"
    )
    assert first[:6] == bytes(6), "at the upper left corner"
    assert first[6:12] == (639).to_bytes(3, "little") + (399).to_bytes(3, "little")
    assert int.from_bytes(first[12:15], "little") == 1500
    assert first[16:] == b"VP8 " + struct.pack("<I", 3) + b"abc\0"
    assert second[16:] == b"VP8 " + struct.pack("<I", 4) + b"wxyz"


def test_the_size_of_the_file_is_in_its_head() -> None:
    made = animated([still(b"abc")], (640, 400), 1500)
    assert struct.unpack_from("<I", made, 4) == (len(made) - 8,)
    assert [name for name, _ in chunks(made)] == [b"VP8X", b"ANIM", b"ANMF"]


def test_another_format_is_refused() -> None:
    with pytest.raises(ValueError, match="no WebP"):
        list(chunks(b"\x89PNG\r\n\x1a\n"))


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
