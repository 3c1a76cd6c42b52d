"""A forged or damaged backup: restore-store refuses it with one line, and changes nothing anywhere."""

from __future__ import annotations

import hashlib
import io
import json
import os
import sqlite3
import tarfile
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from app.cli import cli
from app.core.database import Database
from app.system.backup import archive as backup
from app.system.backup.archive import MAX_ARCHIVE_BYTES

MAIN = "lineside.db"


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

    def store(self) -> bytes:
        """A sound store."""
        fresh = self.folder / "fresh" / MAIN
        Database(fresh).close()
        content = fresh.read_bytes()
        for path in fresh.parent.iterdir():
            path.unlink()
        fresh.parent.rmdir()
        return content

    def write(self, *members: tuple[tarfile.TarInfo, bytes], **manifest: Any) -> None:
        """An archive with a manifest, then these members; the manifest names each with its digest."""
        stores = {info.name: hashlib.sha256(content).hexdigest() for info, content in members}
        text = json.dumps({"lineside": "1", "time": 1.0, "stores": stores} | manifest).encode()
        with tarfile.open(self.archive, "w") as archive:
            for info, content in [(plain("manifest.json", text), text), *members]:
                archive.addfile(info, io.BytesIO(content))

    def restore(self) -> Result:
        return CliRunner().invoke(
            cli, ["restore-store", str(self.archive), "--yes", "--config", str(self.config)]
        )


def plain(name: str, content: bytes) -> tarfile.TarInfo:
    info = tarfile.TarInfo(name)
    info.size = len(content)
    return info


def of_type(kind: bytes, name: str = MAIN, to: str = "../foreign.db") -> tarfile.TarInfo:
    info = tarfile.TarInfo(name)
    info.type, info.linkname = kind, to
    return info


def absolute(site: Site) -> None:
    content = site.foreign.read_bytes()
    site.write((plain(str(site.foreign), content), content))


def foreign_moved_in(site: Site) -> None:
    """The manifest names a store elsewhere, by its path."""
    digest = hashlib.sha256(site.foreign.read_bytes()).hexdigest()
    member = (plain(MAIN, site.store()), site.store())
    site.write(member, stores={str(site.foreign): digest})


def parent(site: Site) -> None:
    site.write((plain("../foreign.db", site.store()), site.store()))


def below(site: Site) -> None:
    site.write((plain("sub/" + MAIN, site.store()), site.store()))


def unknown_name(site: Site) -> None:
    site.write((plain("other.db", site.store()), site.store()))


def twice(site: Site) -> None:
    site.write((plain(MAIN, site.store()), site.store()), (plain(MAIN, site.store()), site.store()))


def not_in_manifest(site: Site) -> None:
    site.write((plain(MAIN, site.store()), site.store()), stores={"history.db": "0" * 64})


def no_stores(site: Site) -> None:
    site.write()


def odd_manifest(site: Site) -> None:
    site.write((plain(MAIN, site.store()), site.store()), stores=[MAIN])


def odd_time(site: Site) -> None:
    site.write((plain(MAIN, site.store()), site.store()), time=1e300)


def odd_digest(site: Site) -> None:
    site.write((plain(MAIN, site.store()), site.store()), stores={MAIN: 7})


def deep_manifest(site: Site) -> None:
    site.write((plain(MAIN, site.store()), site.store()), stores=[])
    text = b"[" * 60_000
    with tarfile.open(site.archive, "w") as archive:
        archive.addfile(plain("manifest.json", text), io.BytesIO(text))


def large_manifest(site: Site) -> None:
    site.write((plain(MAIN, site.store()), site.store()), note="x" * 300_000)


def link(site: Site) -> None:
    site.write((of_type(tarfile.SYMTYPE), b""))


def hard_link(site: Site) -> None:
    site.write((of_type(tarfile.LNKTYPE), b""))


def fifo(site: Site) -> None:
    site.write((of_type(tarfile.FIFOTYPE), b""))


def device(site: Site) -> None:
    site.write((of_type(tarfile.CHRTYPE), b""))


def folder(site: Site) -> None:
    site.write((of_type(tarfile.DIRTYPE), b""))


def sparse(site: Site) -> None:
    """10 kB that claim to hold 300 GiB, in the newer format of GNU tar."""
    info = plain(MAIN, b"0\n0\n" + bytes(508))
    info.pax_headers = {
        "GNU.sparse.major": "1",
        "GNU.sparse.minor": "0",
        "GNU.sparse.name": MAIN,
        "GNU.sparse.realsize": str(300 * 2**30),
    }
    site.write((info, b"0\n0\n" + bytes(508)))


def old_sparse(site: Site) -> None:
    site.write((of_type(tarfile.GNUTYPE_SPARSE), b""))


def sparse_file(site: Site) -> None:
    """An archive whose end is a hole."""
    site.write((plain(MAIN, site.store()), site.store()))
    os.truncate(site.archive, MAX_ARCHIVE_BYTES + 1)


def long_tail(site: Site) -> None:
    site.write((plain(MAIN, site.store()), site.store()))
    os.truncate(site.archive, 2**30)


def beyond_the_end(site: Site) -> None:
    info = plain(MAIN, b"")
    info.size = 2**40
    site.archive.write_bytes(info.tobuf(tarfile.GNU_FORMAT))


def negative_size(site: Site) -> None:
    info = plain(MAIN, b"")
    info.size = -(2**40)
    site.archive.write_bytes(info.tobuf(tarfile.GNU_FORMAT) + bytes(10_240))


def many_headers(site: Site) -> None:
    """A chain of headers for one member."""
    header = tarfile.TarInfo("x").create_pax_global_header({"comment": "x"})
    site.archive.write_bytes(header * 5000)


def large_header(site: Site) -> None:
    """A header for a member, a gigabyte of it."""
    info = plain("pax", b"")
    info.type, info.size = tarfile.XHDTYPE, 2**30
    site.archive.write_bytes(info.tobuf(tarfile.GNU_FORMAT))
    os.truncate(site.archive, 2**30 + 10_240)


def stated_by_header(site: Site, **header: str) -> None:
    info = plain(MAIN, site.store())
    info.pax_headers = header
    site.write((info, site.store()))


def large_by_header(site: Site) -> None:
    stated_by_header(site, size=str(2**40))


def negative_by_header(site: Site) -> None:
    stated_by_header(site, size="-1024")


def odd_size_by_header(site: Site) -> None:
    stated_by_header(site, size="1e9")


def named_by_header(site: Site) -> None:
    """With a name that it may have."""
    stated_by_header(site, path=MAIN)


def stated_for_all(site: Site) -> None:
    site.write((plain(MAIN, site.store()), site.store()))
    header = tarfile.TarInfo("x").create_pax_global_header({"comment": "x"})
    site.archive.write_bytes(header + site.archive.read_bytes())


def many_sparse_parts(site: Site) -> None:
    """A map of holes that goes on for a megabyte."""
    content = b"9999999\n" + b"0\n" * 2**19
    info = plain(MAIN, content)
    info.pax_headers = {"GNU.sparse.major": "1", "GNU.sparse.minor": "0", "GNU.sparse.name": MAIN}
    site.write((info, content))


def no_end(site: Site) -> None:
    """Cut off after the last member."""
    site.write((plain(MAIN, site.store()), site.store()))
    with tarfile.open(site.archive) as archive:
        end = max(each.offset_data + -(-each.size // 512) * 512 for each in archive)
    os.truncate(site.archive, end)


def other_end(site: Site) -> None:
    """Something else after the last member."""
    no_end(site)
    with site.archive.open("ab") as archive:
        archive.write(b"something else " * 1000)


def renamed_by_header(site: Site) -> None:
    info = plain(MAIN, site.store())
    info.pax_headers = {"path": "/" + "x" * 200}
    site.write((info, site.store()))


def no_database(site: Site) -> None:
    site.write((plain(MAIN, b"rubbish" * 1000), b"rubbish" * 1000))


def foreign_database(site: Site) -> None:
    """A sound SQLite file that is no store."""
    content = site.foreign.read_bytes()
    site.write((plain(MAIN, content), content))


def odd_tables(site: Site) -> None:
    """It claims every step of a store, and has no table."""
    fresh = site.folder / "odd.db"
    with closing(sqlite3.connect(fresh)) as connection:
        connection.execute("CREATE TABLE migrations (number INTEGER, name TEXT, applied_at REAL)")
        with closing(sqlite3.connect(site.data / MAIN)) as present:
            rows = present.execute("SELECT * FROM migrations").fetchall()
        connection.executemany("INSERT INTO migrations VALUES (?, ?, ?)", rows)
        connection.commit()
    content = fresh.read_bytes()
    fresh.unlink()
    site.write((plain(MAIN, content), content))


def not_tar(site: Site) -> None:
    site.archive.write_bytes(b"something else " * 1000)


def empty(site: Site) -> None:
    site.archive.write_bytes(b"")


def compressed(site: Site) -> None:
    site.write((plain(MAIN, site.store()), site.store()))
    with tarfile.open(site.folder / "z", "w:gz") as archive:
        archive.add(site.archive, "one.tar")
    (site.folder / "z").rename(site.archive)


def a_fifo_itself(site: Site) -> None:
    os.mkfifo(site.archive)


def a_folder_itself(site: Site) -> None:
    site.archive.mkdir()


def absent(site: Site) -> None:
    site.archive.unlink(missing_ok=True)


FORGERIES: tuple[Callable[[Site], None], ...] = (
    *(absolute, foreign_moved_in, parent, below, unknown_name, twice, not_in_manifest, no_stores),
    *(odd_manifest, odd_time, odd_digest, deep_manifest, large_manifest, renamed_by_header),
    *(link, hard_link, fifo, device, folder, sparse, old_sparse, sparse_file, long_tail),
    *(beyond_the_end, negative_size, many_headers, large_header),
    *(large_by_header, negative_by_header, odd_size_by_header, named_by_header, stated_for_all),
    *(many_sparse_parts, no_end, other_end),
    *(no_database, foreign_database, odd_tables, not_tar, empty, compressed),
    *(a_fifo_itself, a_folder_itself, absent),
)


@pytest.mark.parametrize("forge", FORGERIES, ids=lambda forge: forge.__name__)
def test_a_bad_archive_is_one_line_and_changes_nothing(tmp_path: Path, forge: Callable[[Site], None]) -> None:
    site = Site(tmp_path)
    forge(site)
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
    site.write((plain(MAIN, site.store()), site.store()))
    monkeypatch.setattr(backup, "free_bytes", lambda _: 1000)
    done = site.restore()
    assert (done.exit_code, "free" in done.stderr) == (1, True)
    assert site.state() == site.before


def test_a_store_that_is_a_link_is_not_followed(tmp_path: Path) -> None:
    site = Site(tmp_path)
    site.write((plain(MAIN, site.store()), site.store()))
    (site.data / "history.db").symlink_to(site.foreign)
    before = site.foreign.read_bytes()
    done = site.restore()
    assert (done.exit_code, "is a link" in done.stderr) == (1, True)
    assert (site.foreign.read_bytes(), site.foreign.stat().st_mode & 0o777) == (before, 0o644)
    assert not (tmp_path / "foreign.db-wal").exists()


def test_an_archive_of_another_tar_is_restored(tmp_path: Path) -> None:
    """As GNU tar writes it from an unpacked backup: another order, full seconds, larger records."""
    site = Site(tmp_path)
    content = site.store()
    manifest = json.dumps({"time": 1, "stores": {MAIN: hashlib.sha256(content).hexdigest()}}).encode()
    with tarfile.open(site.archive, "w", format=tarfile.GNU_FORMAT) as archive:
        archive.addfile(plain(MAIN, content), io.BytesIO(content))
        archive.addfile(plain("manifest.json", manifest), io.BytesIO(manifest))
    os.truncate(site.archive, site.archive.stat().st_size + 512_000)
    done = site.restore()
    assert done.exit_code == 0, done.output
