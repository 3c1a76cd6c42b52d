"""Catalogs as gettext reads them, kept in a folder from one start to the next."""

from __future__ import annotations

import gettext
import hashlib
from contextlib import suppress
from io import BytesIO
from pathlib import Path

_DIGEST_BYTES = 32


def compiled(path: Path, kept_in: Path | None) -> gettext.GNUTranslations:
    """The catalog of a ``.po`` file. To parse one takes a tenth of a second, so what comes of it is kept in
    ``kept_in`` until the file changes. A folder that cannot be written costs that time and nothing else."""
    source = path.read_bytes()
    digest = hashlib.sha256(source).digest()
    kept = kept_in / f"{path.stem}.mo" if kept_in is not None else None
    if kept is not None:
        with suppress(OSError):
            data = kept.read_bytes()
            if data[:_DIGEST_BYTES] == digest:
                return gettext.GNUTranslations(BytesIO(data[_DIGEST_BYTES:]))
    data = _parsed(source, path.stem)
    if kept is not None:
        with suppress(OSError):
            kept.parent.mkdir(0o700, parents=True, exist_ok=True)
            unfinished = kept.with_suffix(".new")
            unfinished.write_bytes(digest + data)
            unfinished.replace(kept)
    return gettext.GNUTranslations(BytesIO(data))


def _parsed(source: bytes, locale: str) -> bytes:
    # Only here, because importing it takes as long as half a catalog.
    from babel.messages.mofile import write_mo
    from babel.messages.pofile import read_po

    target = BytesIO()
    # Of a catalog without a locale, Babel leaves the rule for plurals out.
    write_mo(target, read_po(BytesIO(source), locale=locale))
    return target.getvalue()
