"""Shifts by the clock of the site with their settings, the scope of a sheet or report, and the parts of a
picture that are kept. Pure.

A shift lasts from one start to the next. Where the clocks change, a shift is an hour shorter or longer.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import date, datetime, timedelta
from struct import error, pack, unpack_from
from typing import Annotated, Literal, NamedTuple
from zlib import crc32
from zoneinfo import ZoneInfo

from pydantic import Field, field_validator

from app.records.notification.settings import ClockTime, minute_of_day
from bus.errors import CallerError
from bus.instants import UnixTime
from bus.messages import Message
from bus.settings import StrictModel

DAY = timedelta(days=1)


@dataclass(frozen=True, slots=True)
class Shift:
    """A shift from ``start`` up to ``end``, which is the start of the next shift."""

    start: UnixTime
    end: UnixTime

    def holds(self, at: UnixTime) -> bool:
        return self.start <= at < self.end


def shift_at(at: UnixTime, starts: Sequence[int], zone: ZoneInfo) -> Shift:
    """Return the shift of a moment. ``starts``: minutes after local midnight, at least one."""
    edges = _edges(_day(at, zone), starts, zone)
    later = next(index for index, edge in enumerate(edges) if edge > at)
    return Shift(edges[later - 1], edges[later])


def shifts_until(at: UnixTime, starts: Sequence[int], zone: ZoneInfo) -> Iterator[Shift]:
    """Yield the shift of a moment and the shifts before it, newest first."""
    shift = shift_at(at, starts, zone)
    while True:
        yield shift
        shift = shift_at(shift.start - 1.0, starts, zone)


def instant_of(minute: int, shift: Shift, zone: ZoneInfo) -> UnixTime | None:
    """Return the first moment of a shift at which the clock shows this minute of the day; None if it never
    does."""
    first = datetime.combine(_day(shift.start, zone), datetime.min.time())
    for days in range(3):
        for fold in (0, 1):
            local = (first + timedelta(days=days, minutes=minute)).replace(tzinfo=zone, fold=fold)
            at = UnixTime(local.timestamp())
            if shift.holds(at) and _clock(at, zone) == minute:
                return at
    return None


def site_time(at: UnixTime, zone: ZoneInfo) -> str:
    """Return a moment by the clock of the site, as text for messages."""
    return datetime.fromtimestamp(float(at), zone).strftime("%Y-%m-%d %H:%M")


def _edges(day: date, starts: Sequence[int], zone: ZoneInfo) -> list[UnixTime]:
    """Return every start from the day before to the day after next, in order. A start that the clocks skip is
    the moment at which they go on."""
    midnights = (datetime.combine(day + days * DAY, datetime.min.time()) for days in (-2, -1, 0, 1, 2))
    return sorted(
        {
            UnixTime((midnight + timedelta(minutes=minute)).replace(tzinfo=zone).timestamp())
            for midnight in midnights
            for minute in starts
        },
        key=float,
    )


def _day(at: UnixTime, zone: ZoneInfo) -> date:
    return datetime.fromtimestamp(float(at), zone).date()


def _clock(at: UnixTime, zone: ZoneInfo) -> int:
    local = datetime.fromtimestamp(float(at), zone)
    return 60 * local.hour + local.minute


class Scope(NamedTuple):
    """The scope of a sheet or report. ``bus`` None: the site; ``unit`` None: all units of the bus."""

    bus: str | None = None
    unit: int | None = None

    def holds(self, bus: str | None, unit: int | None) -> bool:
        """Return whether the scope includes a place."""
        return self.bus in (None, bus) and self.unit in (None, unit)

    def concerns(self, bus: str | None, unit: int | None) -> bool:
        """Return whether people of the scope must know about a place: also about its line and the site."""
        return (
            bus is None
            or self.bus is None
            or (bus == self.bus and (unit is None or self.unit in (None, unit)))
        )

    def conditions(self, table: str = "") -> tuple[str, list[object]]:
        """Return SQL to append to a query of a table with these columns, and its values."""
        named = [(name, value) for name, value in self._asdict().items() if value is not None]
        return "".join(f" AND {table}{name} = ?" for name, _ in named), [value for _, value in named]


EVERYTHING = Scope()


UPRIGHT = 1
TURNED = range(2, 9)
"""The values of the Exif entry by which browsers turn or mirror a picture (``from-image``)."""
_ORIENTATION = 0x0112
_SHORT = 3
_ORDERS = {b"II*\0": "<", b"MM\0*": ">"}
_ENTRY_BYTES = 12


def orientation_of(exif: bytes) -> int:
    """Return the orientation, 1 (upright) to 8; upright for data that is not Exif or states none. Read at
    most the 65,535 entries of one directory."""
    order = _ORDERS.get(exif[:4])
    if order is None:
        return UPRIGHT
    try:
        (start,) = unpack_from(f"{order}I", exif, 4)
        (count,) = unpack_from(f"{order}H", exif, start)
        for place in range(start + 2, start + 2 + count * _ENTRY_BYTES, _ENTRY_BYTES):
            tag, kind, values, value = unpack_from(f"{order}HHIH", exif, place)
            if tag == _ORIENTATION:
                return value if (kind, values) == (_SHORT, 1) and value in TURNED else UPRIGHT
    except error:
        pass
    return UPRIGHT


def exif_of(orientation: int) -> bytes:
    """Return Exif data with only this entry: 26 bytes."""
    return b"MM\0*" + pack(">IHHHIHHI", 8, 1, _ORIENTATION, _SHORT, 1, orientation, 0, 0)


def plain_exif(exif: bytes) -> bytes:
    """Return Exif data with only its orientation; empty for a picture that is upright."""
    orientation = orientation_of(exif)
    return exif_of(orientation) if orientation in TURNED else b""


PictureType = Literal["image/jpeg", "image/png", "image/webp"]
MAX_PIXELS = 25_000_000
"""The most pixels of a picture; a browser takes 100 MB to draw them."""
_PNG = b"\x89PNG\r\n\x1a\n"
_PNG_KEPT = (b"IHDR", b"PLTE", b"tRNS", b"gAMA", b"cHRM", b"sRGB", b"IDAT", b"IEND")
_WEBP_KEPT = (b"VP8X", b"VP8 ", b"VP8L", b"ALPH")
_ALPHA = 0x10
"""The only flag of VP8X that stays."""
_EXIF = b"Exif\0\0"
_FRAMES = frozenset((*range(0xC0, 0xD0),)) - {0xC4, 0xC8, 0xCC}
"""The markers SOF0 to SOF15: they hold the size."""
_JPEG_KEPT = _FRAMES | {0xC4, 0xCC, 0xDA, 0xDB, 0xDC, 0xDD, 0xEE}
"""Frames, tables, scans, restart intervals and Adobe's segment, which states the coding of colors."""
_IN_SCAN = (0x00, *range(0xD0, 0xD8))
"""The bytes after 0xFF that are data of a scan."""


@dataclass(frozen=True, slots=True)
class PlainPicture:
    """A picture whose ``content`` has no metadata."""

    media_type: PictureType
    content: bytes


class _BrokenPictureError(Exception):
    """Raised if the content is not of the type that its first bytes state."""


def plain_picture(content: bytes) -> PlainPicture:
    """Return a picture without metadata. Raise CallerError for other content or too many pixels."""
    try:
        if content.startswith(b"\xff\xd8\xff"):
            return PlainPicture("image/jpeg", b"\xff\xd8" + b"".join(_jpeg(content)) + b"\xff\xd9")
        if content.startswith(_PNG):
            return PlainPicture("image/png", _PNG + b"".join(_png(content)))
        if content[:4] == b"RIFF" and content[8:12] == b"WEBP":
            chunks = b"WEBP" + b"".join(_webp(content))
            return PlainPicture("image/webp", b"RIFF" + len(chunks).to_bytes(4, "little") + chunks)
    except (_BrokenPictureError, IndexError, ValueError):
        raise CallerError(Message("picture_damaged")) from None
    raise CallerError(Message("picture_of_other_kind"))


def _png(content: bytes) -> Iterator[bytes]:
    place, kind = len(_PNG), b""
    while kind != b"IEND":
        length = int.from_bytes(_part(content, place, 4), "big")
        chunk, kind = _part(content, place, length + 12), content[place + 4 : place + 8]
        if (kind == b"IHDR") is not (place == len(_PNG)):
            raise _BrokenPictureError
        if kind == b"IHDR":
            _check_size(int.from_bytes(chunk[8:12], "big"), int.from_bytes(chunk[12:16], "big"))
        if kind in _PNG_KEPT:
            yield chunk
        elif kind == b"eXIf" and (exif := plain_exif(chunk[8:-4])):
            yield pack(">I", len(exif)) + kind + exif + pack(">I", crc32(kind + exif))
        place += len(chunk)


def _jpeg(content: bytes) -> Iterator[bytes]:
    place, has_size = 2, False
    while True:
        if content[place] != 0xFF:
            raise _BrokenPictureError
        marker = content[place + 1]
        if marker in (0xD9, 0xFF):
            place += 1
            if marker == 0xFF:
                continue
            break
        end = place + 2 + int.from_bytes(_part(content, place + 2, 2), "big")
        segment = _part(content, place, end - place)
        if marker in _FRAMES:
            _check_size(int.from_bytes(segment[7:9], "big"), int.from_bytes(segment[5:7], "big"))
            has_size = True
        if marker == 0xDA:
            end = _end_of_scan(content, end)
            segment = content[place:end]
        if marker in _JPEG_KEPT:
            yield segment
        elif marker == 0xE1 and segment[4:10] == _EXIF and (exif := plain_exif(segment[10:])):
            yield segment[:2] + pack(">H", len(exif) + 8) + _EXIF + exif
        place = end
    if not has_size:
        raise _BrokenPictureError


def _end_of_scan(content: bytes, place: int) -> int:
    while True:
        place = content.index(b"\xff", place)
        if content[place + 1] not in _IN_SCAN:
            return place
        place += 2


def _webp(content: bytes) -> Iterator[bytes]:
    place, end, has_image = 12, 8 + int.from_bytes(content[4:8], "little"), False
    while place < min(end, len(content)):
        length = int.from_bytes(_part(content, place + 4, 4), "little")
        kind, data = content[place : place + 4], _part(content, place + 8, length)
        if kind in _WEBP_KEPT:
            has_image |= _check_webp(kind, data)
            yield kind + length.to_bytes(4, "little") + _kept(kind, data) + b"\0" * (length % 2)
        place += 8 + length + length % 2
    if not has_image:
        raise _BrokenPictureError


def _kept(kind: bytes, data: bytes) -> bytes:
    return bytes([data[0] & _ALPHA]) + data[1:] if kind == b"VP8X" else data


def _check_webp(kind: bytes, data: bytes) -> bool:
    """Check the size that a chunk states; return whether the chunk is the picture."""
    if kind == b"VP8X":
        _check_size(1 + int.from_bytes(data[4:7], "little"), 1 + int.from_bytes(data[7:10], "little"))
    elif kind == b"VP8 ":
        if data[3:6] != b"\x9d\x01\x2a" or len(data) < 10:
            raise _BrokenPictureError
        width, height = unpack_from("<HH", data, 6)
        _check_size(width & 0x3FFF, height & 0x3FFF)
    elif kind == b"VP8L":
        bits = int.from_bytes(_part(data, 1, 4), "little")
        if data[0] != 0x2F:
            raise _BrokenPictureError
        _check_size(1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF))
    return kind in (b"VP8 ", b"VP8L")


def _check_size(width: int, height: int) -> None:
    if not width or not height:
        raise _BrokenPictureError
    if width * height > MAX_PIXELS:
        raise CallerError(Message.of("picture_too_large", width=width, height=height))


def _part(content: bytes, place: int, length: int) -> bytes:
    part = content[place : place + length]
    if len(part) < length:
        raise _BrokenPictureError
    return part


class ShiftSettings(StrictModel):
    """The start times of the site's shifts, and the space for pictures."""

    starts: Annotated[tuple[ClockTime, ...], Field(min_length=1, max_length=24)] = ("06:00", "14:00", "22:00")
    """The local times at which shifts start; a shift lasts until the next start."""
    pictures_mb: Annotated[int, Field(ge=0, le=1_000_000)] = 2_000
    """The most space for the pictures of all notes, in MB."""

    @property
    def minutes(self) -> list[int]:
        """The starts as minutes after local midnight."""
        return [minute_of_day(each) for each in self.starts]

    @field_validator("starts")
    @classmethod
    def _each_once(cls, starts: tuple[str, ...]) -> tuple[str, ...]:
        for index, start in enumerate(starts):
            if start in starts[:index]:
                raise ValueError(Message.of("setting_shift_twice", time=start))
        return starts
