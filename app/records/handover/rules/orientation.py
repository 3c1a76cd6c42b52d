"""How a camera was held: of the Exif data of a picture (TIFF 6.0) the one entry that turns it. Pure."""

from __future__ import annotations

from struct import error, pack, unpack_from

UPRIGHT = 1
TURNED = range(2, 9)
"""Values of the entry by which browsers turn or mirror a picture (``image-orientation: from-image``)."""
_ORIENTATION = 0x0112
_SHORT = 3
_ORDERS = {b"II*\0": "<", b"MM\0*": ">"}
_ENTRY_BYTES = 12


def orientation_of(exif: bytes) -> int:
    """1 (upright) to 8; upright for what is no Exif data or states no orientation. At most the 65,535
    entries of one directory are read."""
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
    """Exif data with this entry and nothing else: 26 bytes."""
    return b"MM\0*" + pack(">IHHHIHHI", 8, 1, _ORIENTATION, _SHORT, 1, orientation, 0, 0)


def plain_exif(exif: bytes) -> bytes:
    """Exif data with its orientation alone; empty for a picture that is upright."""
    orientation = orientation_of(exif)
    return exif_of(orientation) if orientation in TURNED else b""
