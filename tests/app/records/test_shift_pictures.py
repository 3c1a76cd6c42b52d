"""Pictures of notes: judged by their content, stored without metadata, never a page. About 4 s."""

from __future__ import annotations

import asyncio
import random
import stat
import zlib
from base64 import b64encode
from pathlib import Path
from struct import pack
from typing import Any

import httpx
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.core.database import Database
from app.core.web.access import Role
from app.errors import ConstraintError, StoreError
from app.records.handover.notes import FILE, MIGRATIONS
from app.records.handover.rules import TURNED, exif_of, orientation_of, plain_exif, plain_picture
from app.system.backup import archive
from bus.errors import CallerError
from tests.app.backups import read_backup, write_backup
from tests.app.complete_app import House, complete_app
from tests.for_each import for_each

API = "/api/v1/shifts"
PLACE = b"GPS 52.5, 13.4"
HTML = b"<html><script>alert(1)</script></html>"


def chunk(kind: bytes, data: bytes) -> bytes:
    return pack(">I", len(data)) + kind + data + pack(">I", zlib.crc32(kind + data))


def png(width: int = 2, height: int = 2, more: bytes = b"") -> bytes:
    header = chunk(b"IHDR", pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0))
    data = zlib.compress((b"\0" + bytes(2)) * 2)
    return b"\x89PNG\r\n\x1a\n" + header + more + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def segment(marker: int, data: bytes) -> bytes:
    return bytes([0xFF, marker]) + pack(">H", len(data) + 2) + data


def jpeg(width: int = 2, height: int = 2, more: bytes = b"") -> bytes:
    """Its segments, in order: of a real one a browser test sends some."""
    frame = segment(0xC0, b"\x08" + pack(">HH", height, width) + b"\x01\x01\x11\x00")
    scan = segment(0xDA, b"\x01\x01\x00\x00\x3f\x00") + b"\x12\xff\x00\x34\xff\xd0\x56"
    return b"\xff\xd8" + more + segment(0xDB, bytes(65)) + frame + scan + b"\xff\xd9"


def webp(width: int = 2, height: int = 2, more: bytes = b"") -> bytes:
    bits = (width - 1) | (height - 1) << 14
    data = b"\x2f" + pack("<I", bits) + b"\0"
    chunks = b"WEBP" + more + b"VP8L" + pack("<I", len(data)) + data
    return b"RIFF" + pack("<I", len(chunks)) + chunks


MAKERS = {"image/png": png, "image/jpeg": jpeg, "image/webp": webp}
METADATA = {
    "image/png": chunk(b"tEXt", b"place\0" + PLACE) + chunk(b"eXIf", PLACE),
    "image/jpeg": segment(0xE1, b"Exif\0\0" + PLACE) + segment(0xFE, PLACE) + segment(0xED, PLACE),
    "image/webp": b"EXIF" + pack("<I", len(PLACE)) + PLACE,
}


@pytest.mark.parametrize("kind", MAKERS)
def test_a_picture_is_kept_without_metadata_and_without_what_follows_it(kind: str) -> None:
    plain = plain_picture(MAKERS[kind](more=METADATA[kind]) + HTML)
    assert (plain.media_type, plain.content) == (kind, MAKERS[kind]())
    assert plain_picture(plain.content) == plain


def tiff(*entries: bytes, order: str = ">") -> bytes:
    """Exif data of one directory."""
    head = {">": b"MM\0*", "<": b"II*\0"}[order] + pack(f"{order}I", 8)
    return head + pack(f"{order}H", len(entries)) + b"".join(entries) + bytes(4)


def entry(tag: int, value: int, *, kind: int = 3, values: int = 1, order: str = ">") -> bytes:
    return pack(f"{order}HHIHH", tag, kind, values, value, 0)


def with_exif(kind: str, exif: bytes) -> bytes:
    """A picture with this Exif data, as cameras and phones place it."""
    if kind == "image/png":
        return png(more=chunk(b"eXIf", exif))
    return jpeg(more=segment(0xE1, b"Exif\0\0" + exif))


@pytest.mark.parametrize("kind", ["image/jpeg", "image/png"])
@given(st.integers(0, 9) | st.integers(0, 65_535), st.sampled_from("<>"), st.binary(max_size=40))
def test_of_its_exif_data_a_picture_keeps_the_orientation_alone(
    kind: str, turn: int, order: str, more: bytes
) -> None:
    place, make = entry(0x8825, 200, order=order), entry(0x010F, 77, order=order)
    exif = tiff(make, entry(0x0112, turn, order=order), place, order=order) + PLACE + more
    plain = plain_picture(with_exif(kind, exif)).content
    turned = 2 <= turn <= 8
    assert (with_exif(kind, tiff(entry(0x0112, turn))) == plain) is turned
    assert PLACE not in plain
    assert b"\x88\x25" not in plain
    if not turned:
        assert b"\x01\x12" not in plain
    assert plain_picture(plain).content == plain


@given(st.binary(max_size=200), st.sampled_from([b"", b"MM\0*", b"II*\0", b"MM\0*\0\0\0\x08"]))
def test_any_bytes_have_an_orientation_and_leave_nothing_else(rest: bytes, head: bytes) -> None:
    assert orientation_of(head + rest) in range(1, 9)
    assert plain_exif(head + rest) in (b"", *map(exif_of, TURNED))


@pytest.mark.parametrize(
    "exif",
    [
        tiff(entry(0x010F, 77)),
        tiff(entry(0x0112, 6, kind=4)),
        tiff(entry(0x0112, 6, values=2)),
        tiff(entry(0x0112, 6))[:-8],
        b"MM\0*" + pack(">I", 2**32 - 1),
        b"MM\0*" + pack(">IH", 8, 65_535) + bytes(65_000),
        b"XX\0*" + tiff(entry(0x0112, 6))[4:],
    ],
)
def test_exif_data_that_is_none_leaves_a_picture_upright(exif: bytes) -> None:
    assert orientation_of(exif) == 1
    assert plain_picture(jpeg(more=segment(0xE1, b"Exif\0\0" + exif))).content == jpeg()


@pytest.mark.parametrize("kind", MAKERS)
@pytest.mark.parametrize(("width", "height"), [(10_000, 10_001), (16_383, 16_383)])
def test_a_picture_of_a_hundred_megapixels_is_refused_by_its_size(kind: str, width: int, height: int) -> None:
    with pytest.raises(CallerError, match="pixels"):
        plain_picture(MAKERS[kind](width, height))


def test_the_size_of_the_canvas_counts_too() -> None:
    canvas = b"VP8X" + pack("<I", 10) + b"\x3c\0\0\0" + b"\xff\xff\xff" + b"\xff\xff\xff"
    with pytest.raises(CallerError, match="pixels"):
        plain_picture(webp(more=canvas))


@pytest.mark.parametrize(
    "content",
    [
        b"",
        HTML,
        b"<svg xmlns='http://www.w3.org/2000/svg'><script/></svg>",
        b"GIF89a" + bytes(40),
        b"BM" + bytes(60),
        b"\x89PNG\r\n\x1a\n" + HTML,
        b"\x89PNG\r\n\x1a\n" + chunk(b"IEND", b""),
        b"\xff\xd8\xff\xd9",
        b"\xff\xd8\xff" + HTML,
        b"RIFF\x04\0\0\0WEBP",
        jpeg(more=segment(0xFE, PLACE) + b"no marker"),
        webp().replace(b"\x2f", b"\x2e"),
        b"RIFF" + pack("<I", 22) + b"WEBPVP8 " + pack("<I", 10) + bytes(10),
        jpeg()[:-4],
        png()[:-8],
        png(0, 2),
        jpeg(2, 0),
    ],
)
def test_other_content_is_refused(content: bytes) -> None:
    with pytest.raises(CallerError):
        plain_picture(content)


def test_fill_bytes_before_a_marker_of_jpeg_are_left_out() -> None:
    assert plain_picture(jpeg(more=b"\xff\xff")).content == jpeg()


def lossy_webp(data: bytes) -> bytes:
    """A picture coded as VP8, with an alpha channel."""
    chunks = b"".join(
        kind + pack("<I", len(each)) + each for kind, each in ((b"ALPH", b"\0\0"), (b"VP8 ", data))
    )
    return b"RIFF" + pack("<I", 4 + len(chunks)) + b"WEBP" + chunks


def test_a_lossy_webp_states_its_size() -> None:
    frame = b"\x30\x01\0\x9d\x01\x2a"
    small = lossy_webp(frame + pack("<HH", 2, 2))
    assert plain_picture(small).content == small
    with pytest.raises(CallerError, match="pixels"):
        plain_picture(lossy_webp(frame + pack("<HH", 10_000, 10_001)))


@given(st.sampled_from(list(MAKERS)), st.data())
def test_damage_is_refused_or_leaves_a_picture_of_the_same_kind(kind: str, data: st.DataObject) -> None:
    content = bytearray(MAKERS[kind](more=METADATA[kind]))
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    try:
        plain = plain_picture(bytes(content[: data.draw(st.integers(0, len(content)))]))
    except CallerError:
        return
    assert plain_picture(plain.content) == plain


async def present(client: httpx.AsyncClient) -> str:
    start: str = (await client.get(API)).json()["shifts"][0]["start"]
    return start


async def write(client: httpx.AsyncClient, *pictures: bytes, **more: Any) -> httpx.Response:
    body = {"text": "Felt", "pictures": [b64encode(each).decode() for each in pictures], **more}
    return await client.post(f"{API}/{await present(client)}/notes", json=body)


async def test_a_picture_is_served_as_a_picture_and_nothing_else(house: House, tmp_path: Path) -> None:
    operator, viewer = await house.program(Role.OPERATOR), await house.program(Role.VIEWER)
    made = await write(operator, jpeg(more=METADATA["image/jpeg"]) + HTML, png())
    assert made.status_code == 201, made.text
    first, second = made.json()["pictures"]
    served = await viewer.get(f"/shifts/pictures/{first}")
    assert (served.content, served.headers["content-type"]) == (jpeg(), "image/jpeg")
    assert served.headers["x-content-type-options"] == "nosniff"
    assert "sandbox" in served.headers["content-security-policy"]
    assert "default-src 'none'" in served.headers["content-security-policy"]
    assert (await house.client().get(f"/shifts/pictures/{first}")).headers["location"].startswith("/login")
    assert stat.S_IMODE((tmp_path / "data" / "pictures.db").stat().st_mode) == 0o600
    (event,) = await house.events("shift")
    assert event["new"] == f"{first} {second}"
    page = (await viewer.get(f"/shifts/{await present(viewer)}")).text
    assert f'src="/shifts/pictures/{first}"' in page
    file = (await viewer.get(f"{API}/{await present(viewer)}/sheet.html")).text
    assert f'<img src="data:image/jpeg;base64,{b64encode(jpeg()).decode()}"' in file
    assert "sha256:" not in file


@for_each("digest", ["0" * 64, "..%2F..%2Flineside.db", "0" * 63, "A" * 64, "%00" * 10])
async def test_a_picture_has_no_path(house: House, digest: str) -> None:
    operator = await house.program(Role.OPERATOR)
    await write(operator, png())
    assert (await operator.get(f"/shifts/pictures/{digest}")).status_code in (404, 422)


async def test_the_form_takes_files_by_their_content_and_not_by_their_name(house: House) -> None:
    operator = await house.signed_in(Role.OPERATOR)
    path = f"/shifts/{await present(operator)}/notes"
    for name, content, status in (
        ("../../etc/passwd", png(), 303),
        ("picture.png", HTML, 422),
        ("large.png", png() + bytes(1024**2), 413),
        ("largest.png", bytes(3 * 1024**2), 413),
    ):
        files = {"pictures": (name, content, "image/png")}
        sent = await operator.post(path, data={"text": "Felt"}, files=files)
        assert sent.status_code == status, sent.text
    many = [("pictures", ("a.png", png(), "image/png"))] * 4
    assert (await operator.post(path, data={"text": "Felt"}, files=many)).status_code in (400, 413, 422)
    found = (await operator.get(f"{API}/{await present(operator)}")).json()["notes"]
    assert [len(note["pictures"]) for note in found] == [1]


async def test_a_refused_note_stores_no_picture(house: House, tmp_path: Path) -> None:
    operator = await house.program(Role.OPERATOR)
    for wrong in ({"corrects": 99}, {"alarm": "none.1"}, {"bus": "none"}, {"text": " "}):
        assert (await write(operator, png(), **wrong)).status_code in (404, 422)
    refused = await operator.post(
        f"{API}/{await present(operator)}/notes", json={"text": "x", "pictures": ["not base64!"]}
    )
    assert refused.json()["reason"] == "picture_not_base64"
    assert not (tmp_path / "data" / "pictures.db").exists()


def noise(number: int) -> bytes:
    """A picture of many pages of the store."""
    return png(more=chunk(b"IDAT", random.Random(number).randbytes(60_000)))


async def with_pictures(folder: Path) -> list[str]:
    """A house in which three notes with a picture each were written; their digests."""
    async with complete_app(folder) as house:
        operator = await house.program(Role.OPERATOR)
        return [(await write(operator, noise(n))).json()["pictures"][0] for n in range(3)]


def restored(folder: Path, backup: Path) -> None:
    read_backup(backup, folder / "data", [folder / "lineside.audit.key"])


async def test_a_backup_brings_notes_and_pictures_back_together(tmp_path: Path) -> None:
    digests, backup, elsewhere = await with_pictures(tmp_path), tmp_path / "one.tar", tmp_path / "elsewhere"
    async with complete_app(tmp_path):
        assert write_backup(tmp_path / "data", backup).stores == ["history.db", "lineside.db", "pictures.db"]
    elsewhere.mkdir()
    await asyncio.to_thread(restored, elsewhere, backup)
    async with complete_app(elsewhere) as house:
        viewer = await house.program(Role.VIEWER)
        notes = (await viewer.get(f"{API}/{await present(viewer)}")).json()["notes"]
        assert [note["pictures"] for note in notes] == [[digest] for digest in digests]
        for number, digest in enumerate(digests):
            assert (await viewer.get(f"/shifts/pictures/{digest}")).content == noise(number)


async def test_each_note_of_a_backup_has_its_pictures_when_one_is_written_meanwhile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    backup, elsewhere, copy = tmp_path / "one.tar", tmp_path / "elsewhere", archive.copy_store
    async with complete_app(tmp_path) as house:
        operator, loop = await house.program(Role.OPERATOR), asyncio.get_running_loop()
        await write(operator, noise(0))
        numbers = iter(range(1, 9))

        def copy_and_write(store: Path, place: Path) -> None:
            copy(store, place)
            writing = asyncio.run_coroutine_threadsafe(write(operator, noise(next(numbers))), loop)
            assert writing.result().status_code == 201

        monkeypatch.setattr(archive, "copy_store", copy_and_write)
        await asyncio.to_thread(write_backup, tmp_path / "data", backup)
    elsewhere.mkdir()
    await asyncio.to_thread(restored, elsewhere, backup)
    async with complete_app(elsewhere) as house:
        viewer = await house.program(Role.VIEWER)
        notes = (await viewer.get(f"{API}/{await present(viewer)}")).json()["notes"]
        assert len(notes) == 2
        for note in notes:
            assert (await viewer.get(f"/shifts/pictures/{note['pictures'][0]}")).status_code == 200


def test_the_pictures_of_an_earlier_version_are_there_and_stay(tmp_path: Path) -> None:
    folder = tmp_path / "migrations"
    folder.mkdir()
    first = MIGRATIONS / "0001_pictures.sql"
    (folder / first.name).write_text(first.read_text("utf-8"), "utf-8")
    row = ("0" * 64, "image/png", png())
    earlier = Database(tmp_path / FILE, folder)
    earlier.write_now(lambda store: store.execute("INSERT INTO picture VALUES (?, ?, ?)", row))
    earlier.close()
    present = Database(tmp_path / FILE, MIGRATIONS)
    found = present.read_now(lambda store: store.execute("SELECT * FROM picture").fetchall())
    assert [tuple(each) for each in found] == [row]
    for change in ("DELETE FROM picture", "UPDATE picture SET content = x''"):
        with pytest.raises(ConstraintError, match="never"):
            present.write_now(lambda store, change=change: store.execute(change))
    present.close()


@pytest.mark.parametrize("damage", ["a page", "the head"])
async def test_a_damaged_store_of_pictures_is_reported_and_costs_its_pictures_only(
    tmp_path: Path, damage: str
) -> None:
    digests, path = await with_pictures(tmp_path), tmp_path / "data" / "pictures.db"
    content = path.read_bytes()
    inside = content.index(noise(1)[30_000:30_016])
    first = 0 if damage == "the head" else inside - inside % 4096
    path.write_bytes(content[:first] + bytes([255]) * 64 + content[first + 64 :])
    async with complete_app(tmp_path) as house:
        operator = await house.signed_in(Role.OPERATOR, "ann")
        sheet = f"{API}/{await present(operator)}"
        served = [(await operator.get(f"/shifts/pictures/{digest}")).status_code for digest in digests]
        file = await operator.get(f"{sheet}/sheet.html")
        assert file.status_code == 200
        assert served.count(200) == file.text.count("data:image/png") == (0 if damage == "the head" else 2)
        assert f"<p>{3 - served.count(200)} picture" in file.text
        assert (await operator.get(f"/shifts/{await present(operator)}")).status_code == 200
        assert (await write(operator)).status_code == 201
        if damage == "the head":
            refused = await write(operator, png())
            assert (refused.status_code, refused.json()["code"]) == (503, "store")
            assert "move it away" in refused.json()["detail"]
        with pytest.raises(StoreError, match=r"pictures\.db: it is .*damaged; restore a backup"):
            await asyncio.to_thread(write_backup, tmp_path / "data", tmp_path / "one.tar")
        assert not (tmp_path / "one.tar").exists()


async def test_the_pictures_of_a_shift_are_bounded(house: House) -> None:
    operator = await house.program(Role.OPERATOR)
    for number in range(6):
        pictures = [png(more=b"", width=2 + number, height=1 + each) for each in range(3)]
        assert (await write(operator, *pictures)).status_code == 201
    full = await write(operator, png(30), png(31), png(32))
    assert (full.status_code, full.json()["reason"]) == (409, "shift_pictures_full")
    assert (await write(operator, png(30), png(31))).status_code == 201
