"""What the files of a site hold for an administrator: sizes, for how long the disk is enough, certificates,
backups."""

from __future__ import annotations

import json
import os
from contextlib import closing
from datetime import datetime
from pathlib import Path

import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from app.cli import cli
from app.cli.status import backup_facts, certificate_facts, disk_facts
from app.core.database import Database
from app.core.database.connection import open_unchanged
from app.core.database.files import MIN_FREE_OF_OTHERS
from app.core.web.shape import iso
from app.line.history.series.runs import DAY, HOUR, micros
from app.line.history.status import MAX_DAYS, days_left, growth_of_history
from app.settings import load
from bus.instants import UnixTime, unix_now
from tests.app.history_line import NOON, Shelf, polls
from tests.certificates import certificates

MB = 1_000_000


@pytest.mark.parametrize(
    ("usable", "readings", "stored", "kept", "lasting", "days"),
    [
        (300, 10, 0, 30, 0, None),  # as much as will ever be stored
        (299, 10, 0, 30, 0, 29.9),
        (100, 10, 30, 30, 0, None),
        (100, 10, 30, 30, 1, 100),
        (100, 10, 25, 30, 1, 50),  # 55 until the retention, then 1 a day
        (100, 0, 0, 30, 0.01, None),
        (0, 10, 30, 30, 1, 0),
        (-50, 10, 10, 30, 0, 0),
    ],
)
def test_readings_grow_until_their_retention_and_the_rest_goes_on(
    usable: float, readings: float, stored: float, kept: int, lasting: float, days: float | None
) -> None:
    left = days_left(MIN_FREE_OF_OTHERS + int(usable * MB), readings * MB, stored, kept, lasting * MB)
    assert left == (None if days is None else pytest.approx(days))


@given(st.integers(0, 10**13), *[st.floats(0, 1e10)] * 2, st.integers(1, 3650), st.floats(0, 1e9))
def test_a_forecast_is_never_negative_and_more_space_lasts_longer(
    free: int, readings: float, stored: float, kept: int, lasting: float
) -> None:
    now, more = (days_left(each, readings, stored, kept, lasting) for each in (free, free + MB))
    assert now is None or now >= 0
    assert more is None or (now is not None and more >= now)


def test_the_growth_is_what_was_stored_of_late(tmp_path: Path) -> None:
    shelf = Shelf(tmp_path / "history.db")
    shelf.keep(polls(NOON, NOON + 120))
    shelf.fold()
    shelf.close()
    now = micros(UnixTime(NOON + 7200))
    with closing(open_unchanged(tmp_path / "history.db")) as connection:
        assert growth_of_history(connection, micros(UnixTime(NOON + 600))) is None
        [(size,)] = connection.execute("SELECT sum(length(data)) FROM raw")
        found = growth_of_history(connection, now)
        assert found is not None
        readings, _, stored = found
        assert stored == pytest.approx(2 * HOUR / DAY)
        assert readings == pytest.approx(size / stored)
        assert growth_of_history(connection, now + 30 * DAY) is None


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "lineside.toml"
    path.write_text(
        '[site]\nname = "Mill 7"\ntime_zone = "Europe/Berlin"\n[server]\nport = 1\ndata = "data"\n'
    )
    Database(tmp_path / "data" / "lineside.db").close()
    return path


def test_stores_have_their_sizes_and_the_disk_its_space(config: Path) -> None:
    facts = disk_facts(load(config), unix_now()).shown
    assert facts["stores"] == {"lineside.db": (config.parent / "data" / "lineside.db").stat().st_size}
    assert facts["disk_free"] > 0
    assert facts["disk_days"] is None


def test_with_history_the_disk_has_a_forecast(config: Path) -> None:
    shelf = Shelf(config.parent / "data" / "history.db")
    shelf.keep(polls(NOON, NOON + 120))
    shelf.fold()
    shelf.close()
    days = disk_facts(load(config), UnixTime(NOON + 7200)).shown["disk_days"]
    assert days is not None
    assert 0 < days <= MAX_DAYS


def test_a_certificate_has_its_end_or_cannot_be_read(config: Path) -> None:
    certificates(config.parent)
    tls = '[server.tls]\ncertificate = "server.pem"\nkey = "server.key"\nclient_ca = "none.pem"\n'
    config.write_text(config.read_text() + tls)
    found = certificate_facts(load(config))
    ends = {Path(each["file"]).name: each["ends"] for each in found.shown["certificates"]}
    assert datetime.fromisoformat(ends["server.pem"]).timestamp() > unix_now()
    assert ends["none.pem"] is None
    assert [line.code for line in found.lines] == ["status_certificate", "status_certificate_unreadable"]


def test_backups_are_those_of_the_folder(config: Path) -> None:
    assert backup_facts(load(config), unix_now()).shown == {"backup": None}
    config.write_text(config.read_text() + '[backup]\nfolder = "copies"\nat = "02:30"\n')
    now = UnixTime(1_795_690_800.0)  # 2026-11-26, 12:00 at the site
    missing = backup_facts(load(config), now).shown["backup"]
    assert (missing["is_there"], missing["newest"], missing["next"]) == (False, None, iso(now))
    file = config.parent / "copies" / "lineside-2026-11-26-023000.tar"
    file.parent.mkdir()
    file.touch()
    os.utime(file, (float(now) - 34_200, float(now) - 34_200))
    found = backup_facts(load(config), now).shown["backup"]
    assert (found["newest"], found["next"]) == (iso(now - 34_200), iso(now + 52_200))


def test_one_screen_and_the_same_facts_as_json(config: Path) -> None:
    config.write_text(
        config.read_text() + '[backup]\nfolder = "copies"\n'
        '[[bus]]\nname = "dry-end"\nport = "/dev/ttyUSB0"\n[[bus.unit]]\nid = 1\nname = "Unwind"\n'
    )
    (config.parent / "copies").mkdir()
    shown = CliRunner().invoke(cli, ["status", "--config", str(config)])
    assert shown.exit_code == 1
    lines = shown.stdout.splitlines()
    assert len(lines) < 20
    for text in (
        *("Mill 7: not serving, Lineside ", "  bus dry-end: 1 unit at /dev/ttyUSB0", "  lineside.db: 0."),
        *(" GB free; how long", "  backups: none yet in "),
    ):
        assert any(text in line for line in lines), text
    facts = json.loads(CliRunner().invoke(cli, ["status", "--config", str(config), "--json"]).stdout)
    assert (facts["serving"], facts["site"], facts["buses"]) == (False, "Mill 7", None)
    assert facts["configured"] == [{"name": "dry-end", "port": "/dev/ttyUSB0", "baud": 9600, "units": 1}]
    assert facts["stores"].keys() == {"lineside.db"}
    assert facts["disk_free"] > 0
    assert facts["backup"]["newest"] is None
    assert facts["version"]
