"""A forged or damaged backup: restore-store refuses it with one line, and changes nothing anywhere."""

from __future__ import annotations

import gzip
import hashlib
import io
import json
import os
import sqlite3
import tarfile
from collections.abc import Callable
from contextlib import closing
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from click.testing import CliRunner, Result

from app.cli import cli
from app.core.database import Database
from app.system.backup import archive as backup
from app.system.backup.archive import MAX_ARCHIVE_BYTES

MAIN = "lineside.db"
Forgery = Callable[["Site"], object]


class Site:
    """A configuration with a store, a foreign file beside its data, and an archive to restore."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.config = folder / "lineside.toml"
        self.config.write_text('[server]\ndata = "data"\n')
        self.data = folder / "data"
        Database(self.data / MAIN).close()
        self.foreign = folder / "foreign.db"
        with closing(sqlite3.connect(self.foreign)) as connection:
            connection.execute("CREATE TABLE theirs (x)")
        self.foreign.chmod(0o644)
        self.archive = folder / "one.tar"
        self.before = self.state()

    def state(self) -> dict[str, tuple[int, str]]:
        """Mode and content of every file but the archive."""
        return {
            str(path): (path.lstat().st_mode, hashlib.sha256(path.read_bytes()).hexdigest())
            for path in sorted(self.folder.rglob("*"))
            if path.is_file()
            and path != self.archive
            and not path.name.endswith((".opening", "-wal", "-shm"))
        }

    def write(self, *members: tuple[tarfile.TarInfo, bytes], **manifest: Any) -> None:
        """An archive with a manifest, then these members; the manifest names each with its digest."""
        stores = {info.name: hashlib.sha256(content).hexdigest() for info, content in members}
        text = json.dumps({"lineside": "1", "time": 1.0, "stores": stores} | manifest).encode()
        with tarfile.open(self.archive, "w") as archive:
            for info, content in [(plain("manifest.json", text), text), *members]:
                archive.addfile(info, io.BytesIO(content))

    def put(self, name: str = MAIN, *, header: dict[str, str] | None = None, **manifest: Any) -> None:
        """An archive with a sound store under this name, with this extended header."""
        info = plain(name, sound())
        info.pax_headers = header or {}
        self.write((info, sound()), **manifest)

    def cut(self, size: int) -> None:
        os.truncate(self.archive, size)

    def restore(self) -> Result:
        return CliRunner().invoke(
            cli, ["restore-store", str(self.archive), "--yes", "--config", str(self.config)]
        )


@cache
def sound() -> bytes:
    """A sound store."""
    with TemporaryDirectory() as folder:
        Database(Path(folder) / MAIN).close()
        return (Path(folder) / MAIN).read_bytes()


def digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def plain(name: str, content: bytes) -> tarfile.TarInfo:
    info = tarfile.TarInfo(name)
    info.size = len(content)
    return info


def of_type(kind: bytes) -> Forgery:
    def forge(site: Site) -> None:
        info = tarfile.TarInfo(MAIN)
        info.type, info.linkname = kind, "../foreign.db"
        site.write((info, b""))

    return forge


def content(made: bytes, **header: str) -> Forgery:
    """Instead of a store."""

    def forge(site: Site) -> None:
        info = plain(MAIN, made)
        info.pax_headers = header
        site.write((info, made))

    return forge


def head(size: int, kind: bytes = tarfile.REGTYPE, tail: int = 0) -> Forgery:
    """A header alone, before a tail that is a hole."""

    def forge(site: Site) -> None:
        info = tarfile.TarInfo(MAIN)
        info.type, info.size = kind, size
        site.archive.write_bytes(info.tobuf(tarfile.GNU_FORMAT))
        site.cut(512 + tail)

    return forge


def extended(**header: str) -> Forgery:
    return lambda site: site.put(header=header)


def deep_manifest(site: Site) -> None:
    text = b"[" * 60_000
    with tarfile.open(site.archive, "w") as archive:
        archive.addfile(plain("manifest.json", text), io.BytesIO(text))


def long_tail(size: int) -> Forgery:
    def forge(site: Site) -> None:
        site.put()
        site.cut(size)

    return forge


def stated_for_all(site: Site) -> None:
    site.put()
    header = tarfile.TarInfo("x").create_pax_global_header({"comment": "x"})
    site.archive.write_bytes(header + site.archive.read_bytes())


def no_end(site: Site) -> None:
    """Cut off after the last member."""
    site.put()
    with tarfile.open(site.archive) as archive:
        site.cut(max(each.offset_data + -(-each.size // 512) * 512 for each in archive))


def other_end(site: Site) -> None:
    no_end(site)
    with site.archive.open("ab") as archive:
        archive.write(b"something else " * 1000)


def odd_tables(site: Site) -> None:
    """It claims every step of a store, and has no table."""
    fresh = site.folder / "odd.db"
    with closing(sqlite3.connect(fresh)) as connection:
        connection.execute("CREATE TABLE migrations (number INTEGER, name TEXT, applied_at REAL)")
        with closing(sqlite3.connect(site.data / MAIN)) as present:
            rows = present.execute("SELECT * FROM migrations").fetchall()
        connection.executemany("INSERT INTO migrations VALUES (?, ?, ?)", rows)
        connection.commit()
    made = fresh.read_bytes()
    fresh.unlink()
    content(made)(site)


def compressed(site: Site) -> None:
    site.put()
    site.archive.write_bytes(gzip.compress(site.archive.read_bytes()))


SPARSE = {"GNU.sparse.major": "1", "GNU.sparse.minor": "0", "GNU.sparse.name": MAIN}
MANY_HEADERS = tarfile.TarInfo("x").create_pax_global_header({"comment": "x"}) * 5000
FORGERIES: dict[str, Forgery] = {
    "an absolute name": lambda site: site.put(str(site.foreign)),
    "a store elsewhere": lambda site: site.put(stores={str(site.foreign): digest(site.foreign.read_bytes())}),
    "a name upward": lambda site: site.put("../foreign.db"),
    "a name below": lambda site: site.put(f"sub/{MAIN}"),
    "an unknown name": lambda site: site.put("other.db"),
    "twice": lambda site: site.write(*[(plain(MAIN, sound()), sound())] * 2),
    "not in the manifest": lambda site: site.put(stores={"history.db": "0" * 64}),
    "no stores": lambda site: site.write(),
    "an odd manifest": lambda site: site.put(stores=[MAIN]),
    "an odd time": lambda site: site.put(time=1e300),
    "an odd digest": lambda site: site.put(stores={MAIN: 7}),
    "a deep manifest": deep_manifest,
    "a large manifest": lambda site: site.put(note="x" * 300_000),
    "a link": of_type(tarfile.SYMTYPE),
    "a hard link": of_type(tarfile.LNKTYPE),
    "a pipe": of_type(tarfile.FIFOTYPE),
    "a device": of_type(tarfile.CHRTYPE),
    "a folder": of_type(tarfile.DIRTYPE),
    "an old sparse file": of_type(tarfile.GNUTYPE_SPARSE),
    "a claim of 300 GiB": content(
        b"0\n0\n" + bytes(508), **SPARSE, **{"GNU.sparse.realsize": str(300 * 2**30)}
    ),
    "a megabyte of holes": content(b"9999999\n" + b"0\n" * 2**19, **SPARSE),
    "a hole at its end": long_tail(MAX_ARCHIVE_BYTES + 1),
    "a long tail": long_tail(2**30),
    "a size beyond its end": head(2**40),
    "a negative size": head(-(2**40), tail=10_240),
    "a large header": head(2**30, tarfile.XHDTYPE, tail=2**30 + 9728),
    "many headers": lambda site: site.archive.write_bytes(MANY_HEADERS),
    "a large size by a header": extended(size=str(2**40)),
    "a negative size by a header": extended(size="-1024"),
    "an odd size by a header": extended(size="1e9"),
    "its own name by a header": extended(path=MAIN),
    "another name by a header": extended(path="/" + "x" * 200),
    "a header for all": stated_for_all,
    "no end": no_end,
    "another end": other_end,
    "no database": content(b"rubbish" * 1000),
    "a foreign database": lambda site: content(site.foreign.read_bytes())(site),
    "odd tables": odd_tables,
    "no tar": lambda site: site.archive.write_bytes(b"something else " * 1000),
    "nothing": lambda site: site.archive.write_bytes(b""),
    "compressed": compressed,
    "a pipe itself": lambda site: os.mkfifo(site.archive),
    "a folder itself": lambda site: site.archive.mkdir(),
    "absent": lambda site: site.archive.unlink(missing_ok=True),
}


@pytest.mark.parametrize("forged", FORGERIES)
def test_a_bad_archive_is_one_line_and_changes_nothing(tmp_path: Path, forged: str) -> None:
    site = Site(tmp_path)
    FORGERIES[forged](site)
    done = site.restore()
    assert (done.exit_code, done.stdout) == (1, ""), done.output
    assert done.stderr.startswith("lineside: ")
    assert done.stderr.count("\n") == 1, done.stderr
    assert isinstance(done.exception, SystemExit)
    assert site.state() == site.before


def test_what_the_disk_cannot_hold_is_refused_before_it_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    site = Site(tmp_path)
    site.put()
    monkeypatch.setattr(backup, "free_bytes", lambda _: 1000)
    done = site.restore()
    assert (done.exit_code, "free" in done.stderr) == (1, True)
    assert site.state() == site.before


def test_a_store_that_is_a_link_is_not_followed(tmp_path: Path) -> None:
    site = Site(tmp_path)
    site.put()
    (site.data / "history.db").symlink_to(site.foreign)
    before = site.foreign.read_bytes()
    done = site.restore()
    assert (done.exit_code, "is a link" in done.stderr) == (1, True)
    assert (site.foreign.read_bytes(), site.foreign.stat().st_mode & 0o777) == (before, 0o644)
    assert not (tmp_path / "foreign.db-wal").exists()


def test_an_archive_of_another_tar_is_restored(tmp_path: Path) -> None:
    """As GNU tar writes it from an unpacked backup: another order, full seconds, larger records."""
    site = Site(tmp_path)
    content = sound()
    manifest = json.dumps({"time": 1, "stores": {MAIN: hashlib.sha256(content).hexdigest()}}).encode()
    with tarfile.open(site.archive, "w", format=tarfile.GNU_FORMAT) as archive:
        archive.addfile(plain(MAIN, content), io.BytesIO(content))
        archive.addfile(plain("manifest.json", manifest), io.BytesIO(manifest))
    os.truncate(site.archive, site.archive.stat().st_size + 512_000)
    done = site.restore()
    assert done.exit_code == 0, done.output
