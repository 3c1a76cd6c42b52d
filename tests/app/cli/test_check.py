"""``lineside check``: each obstacle to Lineside's work is reported, with exit code 1."""

from __future__ import annotations

import os
import pty
import re
import socket
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from app.cli import check
from app.cli import findings as findings
from app.core.database import Database
from app.core.database.migration import COPYING
from app.line.history.writer import MIGRATIONS
from app.people.audit.entry import KeyOrigin
from app.people.audit.keys import make_key_file
from tests.for_each import for_each
from tests.mounted import mounted

cli = check.check

UNIT = '[[bus.unit]]\nid = 1\nname = "Unwind"\n'


def bus(port: str, name: str = "dry-end") -> str:
    return f'[[bus]]\nname = "{name}"\nport = "{port}"\n{UNIT}'


@pytest.fixture
def config(tmp_path: Path) -> Path:
    return tmp_path / "lineside.toml"


def run(config: Path, text: str) -> Result:
    config.write_text(text, encoding="utf-8")
    return CliRunner().invoke(cli, ["--config", str(config)])


def test_a_good_configuration(config: Path, tmp_path: Path) -> None:
    master, slave = pty.openpty()
    port = os.ttyname(slave)
    try:
        result = run(config, "[server]\nport = 0\n" + bus(port))
    finally:
        os.close(master)
        os.close(slave)
    assert (result.exit_code, result.stderr) == (0, "")
    assert f"data in {tmp_path / 'data'}, created at the first start" in result.stdout
    assert f"bus dry-end: 1 unit at {port}, 9600 baud" in result.stdout


def test_an_absent_adapter_is_waited_for(config: Path) -> None:
    result = run(config, bus("/dev/ttyUSB99"))
    assert result.exit_code == 0
    assert (
        "1 unit at /dev/ttyUSB99, which is not there now; Lineside waits for it, 9600 baud" in result.stdout
    )


def test_a_bus_without_units_is_reported(config: Path) -> None:
    result = run(config, bus("/dev/ttyUSB99").replace(UNIT, ""))
    assert result.exit_code == 0
    assert "'lineside scan --port /dev/ttyUSB99' lists the addresses that respond" in result.stdout


def test_without_a_bus_it_prints_what_to_write(config: Path) -> None:
    result = run(config, '[site]\nname = "Mill 7"\n')
    assert result.exit_code == 1
    assert "lineside: there is no [[bus]]" in result.stderr
    assert "lineside init" in result.stderr


@for_each(
    ("text", "words"),
    [
        (
            bus("socket://a..b:4001"),
            "bus dry-end: socket://a..b:4001 names a host that this machine does not know",
        ),
        (bus("/dev/null"), "bus dry-end: /dev/null is not a serial port"),
        ('[server]\nhost = "a..b"\n' + bus("/dev/ttyUSB99"), "[server]: there is no host 'a..b'"),
        ('[server]\nhost = "192.0.2.1"\n' + bus("/dev/ttyUSB99"), "192.0.2.1 is no address of this machine"),
        ('[server]\ndata = "/etc/passwd/x"\n' + bus("/dev/ttyUSB99"), "data: /etc/passwd is no folder"),
        # Root may write there, and still cannot.
        ('[server]\ndata = "/proc/x/y"\n' + bus("/dev/ttyUSB99"), "may not create /proc/x/y"),
        ('[server]\ndata = "/proc"\n' + bus("/dev/ttyUSB99"), "may not write to /proc"),
        (bus("/dev/ttyUSB99") + '[audit]\nanchor = "/proc/x"\n', "may not write /proc/x"),
        (bus("/dev/ttyUSB99") + '[audit]\nkey_file = "/proc/x"\n', "may not make /proc/x"),
    ],
)
def test_what_cannot_work_is_a_fault(config: Path, text: str, words: str) -> None:
    result = run(config, text)
    assert result.exit_code == 1
    assert words in result.stderr
    assert result.stderr.startswith("lineside: ")


def test_a_data_folder_is_tried_and_left_as_it_was(config: Path) -> None:
    result = run(config, '[server]\ndata = "var/lib/data"\n' + bus("/dev/ttyUSB99"))
    assert (result.exit_code, result.stderr) == (0, "")
    assert list(config.parent.iterdir()) == [config]


def test_every_fault_is_reported_at_once(config: Path) -> None:
    result = run(config, '[server]\nhost = "a..b"\n' + bus("/dev/null") + bus("socket://a..b:1", "b"))
    assert result.exit_code == 1
    assert result.stderr.count("lineside: ") == 3


def test_a_folder_that_may_not_be_written_is_a_fault(config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(findings.os, "access", lambda path, _mode: path != config.parent)
    result = run(config, bus("/dev/ttyUSB99"))
    assert result.exit_code == 1
    assert f"may not create {config.parent / 'data'}" in result.stderr


def test_a_folder_that_may_not_be_looked_into_is_a_fault(
    config: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Root may, so the tests play what another user sees."""
    exists, access = Path.exists, os.access

    def hidden(path: Path) -> bool:
        if path.is_relative_to("/root"):
            raise PermissionError(13, "Permission denied")
        return exists(path)

    monkeypatch.setattr(Path, "exists", hidden)
    monkeypatch.setattr(findings.os, "access", lambda path, mode: path != Path("/") and access(path, mode))
    result = run(config, '[server]\ndata = "/root/data"\n' + bus("/dev/ttyUSB99"))
    assert result.exit_code == 1
    assert "may not create /root/data" in result.stderr


def test_a_port_without_permission_is_a_fault(config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    master, slave = pty.openpty()
    monkeypatch.setattr(findings.os, "access", lambda path, _mode: not str(path).startswith("/dev/pts/"))
    try:
        result = run(config, bus(os.ttyname(slave)))
    finally:
        os.close(master)
        os.close(slave)
    assert result.exit_code == 1
    assert "add the user to its group, 'sudo usermod -aG" in result.stderr


def test_a_dashboard_port_in_use_is_no_fault(config: Path) -> None:
    """Lineside itself may be running."""
    with socket.create_server(("127.0.0.1", 0)) as taken:
        result = run(config, f"[server]\nport = {taken.getsockname()[1]}\n" + bus("/dev/ttyUSB99"))
    assert result.exit_code == 0
    assert "which is in use now" in result.stdout


# --- the stores and their disk -------------------------------------------------------------------------


@pytest.fixture
def data(config: Path) -> Path:
    """The data folder of a site that was started once."""
    folder = config.parent / "data"
    Database(folder / "lineside.db").close()
    Database(folder / "history.db", MIGRATIONS).close()
    make_key_file(config.parent / "lineside.audit.key", KeyOrigin(0, "0" * 64))
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_the_stores_are_read_and_left_as_they_are(config: Path, data: Path) -> None:
    before = contents(data)
    result = run(config, bus("/dev/ttyUSB99"))
    assert (result.exit_code, result.stderr) == (0, "")
    for name in ("lineside.db", "history.db"):
        [size] = re.findall(rf"store {re.escape(str(data / name))}, (\d+\.\d) MB", result.stdout)
        assert float(size) > 0, "the same as `lineside status`"
    assert contents(data) == before


def test_a_store_that_is_missing_is_a_fault(config: Path, data: Path) -> None:
    data.rename(config.parent / "unmounted")
    result = run(config, bus("/dev/ttyUSB99"))
    assert result.exit_code == 1
    assert f"the store {data / 'lineside.db'} is missing, and its audit key" in result.stderr
    assert not data.exists()


@pytest.mark.parametrize("name", ["lineside.db", "history.db"])
def test_a_store_that_was_cut_short_is_a_fault(config: Path, data: Path, name: str) -> None:
    os.truncate(data / name, (data / name).stat().st_size // 2)
    result = run(config, bus("/dev/ttyUSB99"))
    assert result.exit_code == 1
    assert f"the store {data / name}" in result.stderr
    assert result.stderr.count("damaged") == 1


def test_a_copy_that_is_not_finished_is_a_fault(config: Path, data: Path) -> None:
    with closing(sqlite3.connect(data / "history.db")) as connection:
        connection.execute(f"CREATE TABLE {COPYING} (name)")
    result = run(config, bus("/dev/ttyUSB99"))
    assert result.exit_code == 1
    assert (
        "is a copy that is not finished; finish it with 'lineside migrate-store' of version 0.2"
        in result.stderr
    )


def test_a_damaged_page_is_a_fault(config: Path, data: Path) -> None:
    with (data / "lineside.db").open("r+b") as store:
        store.seek(5 * 4096)
        store.write(b"\xa5" * 4096)
    result = run(config, bus("/dev/ttyUSB99"))
    assert result.exit_code == 1
    assert f"the store {data / 'lineside.db'} is damaged (" in result.stderr


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("size=1m", "is full: 1 MB are free, and below 100 MB no history is stored"),
        ("size=1m,ro", "is mounted read-only"),
        ("size=300m", None),
    ],
)
def test_a_disk_that_is_full_or_read_only_is_called_that(
    config: Path, options: str, words: str | None
) -> None:
    data = config.parent / "data"
    data.mkdir()
    with mounted("-t", "tmpfs", "-o", options, "tmpfs", at=data):
        result = run(config, bus("/dev/ttyUSB99"))
    assert result.exit_code == (words is not None)
    assert f"the disk of {data} {words}" in result.stderr if words else "nearly full" in result.stdout
    assert "may not write" not in result.stderr


# --- the audit log ------------------------------------------------------------------------------------


def test_it_prints_where_the_key_and_the_anchor_of_the_audit_log_are(config: Path, tmp_path: Path) -> None:
    text = bus("/dev/ttyUSB99") + '[audit]\nanchor = "head.anchor"\n'
    result = run(config, text)
    assert (result.exit_code, result.stderr) == (0, "")
    key = tmp_path / "lineside.audit.key"
    assert f"audit key {key}, made at the first start\n" in result.stdout
    assert f"audit anchor {tmp_path / 'head.anchor'}\n" in result.stdout
    make_key_file(key, KeyOrigin(0, "0" * 64))
    assert f"audit key {key}\n" in run(config, text).stdout


@for_each(
    ("audit", "words"),
    [
        ('key_file = "absent/lineside.key"', "absent/lineside.key"),
        ('key_file = "lineside.toml"', "can be read or written by others"),
        ('anchor = "absent/head.anchor"', "may not write"),
        ('anchor = "/dev/null"', "is no file"),
    ],
)
def test_an_audit_log_that_cannot_be_verified_is_a_fault(config: Path, audit: str, words: str) -> None:
    config.touch(0o644)
    result = run(config, f"{bus('/dev/ttyUSB99')}[audit]\n{audit}\n")
    assert result.exit_code == 1
    assert words in result.stderr


def test_a_key_that_can_only_be_made_beside_the_data_is_warned_of(
    config: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As for a service with its configuration in /etc and nothing but its data folder to write."""
    data = config.parent / "var" / "data"
    data.mkdir(parents=True)
    monkeypatch.setattr(findings.os, "access", lambda path, mode: path == data or not mode & os.W_OK)
    result = run(config, f'[server]\ndata = "{data}"\n' + bus("/dev/ttyUSB99"))
    assert result.exit_code == 0
    assert f"audit key {data / 'lineside.audit.key'}, made at the first start; who can read" in result.stdout
