"""lineside.toml as the dashboard reads it, also with keys of version 0.2."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner

from app.cli import cli
from app.core.messages.languages import machine_zone
from app.settings import ConfigurationError, Site, load, parse
from bus.configuration import load_bus

BUSES = """\
[[bus]]
name = "a"
port = "/dev/ttyUSB0"
[[bus]]
name = "b"
port = "/dev/ttyUSB1"
"""


@pytest.fixture(autouse=True)
def _zone_is_read_again() -> Iterator[None]:
    yield
    machine_zone.cache_clear()


def write(folder: Path, text: str) -> Path:
    path = folder / "lineside.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_contracts_own_example(tmp_path: Path) -> None:
    text = """
[site]
name = "Paper machine 2"

[server]
host = "127.0.0.1"
port = 8000
data = "./data"            # relative to this file

[[bus]]
name = "dry-end"
port = "/dev/ttyUSB0"
baud = 9600
turnaround_ms = 50
estop_healthy = 1

[[bus.unit]]
id = 1
name = "Unwind"
[bus.unit.labels]
output.1 = "Brake release"
analog = "Web tension"
"""
    settings = load(write(tmp_path, text))
    assert settings.site.name == "Paper machine 2"
    assert settings.server.data == tmp_path / "data"
    assert settings.server.store == tmp_path / "data" / "lineside.db"
    assert settings.bus[0].unit[0].labels.analog == "Web tension"


def test_data_is_relative_to_the_file_not_to_where_one_stands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "etc").mkdir()
    path = write(tmp_path / "etc", '[server]\ndata = "../var"\n')
    monkeypatch.chdir(tmp_path)
    assert load(path.relative_to(tmp_path)).server.data == tmp_path / "var"


def test_everything_may_be_left_out(tmp_path: Path) -> None:
    settings = load(write(tmp_path, ""))
    assert (settings.server.host, settings.server.port, settings.bus) == ("127.0.0.1", 8000, ())


@pytest.mark.parametrize(
    ("text", "error"),
    [
        (BUSES.replace('"b"', '"a"'), ":5: bus name a is given twice; every bus has its own"),
        (BUSES.replace("USB1", "USB0"), ":6: port /dev/ttyUSB0 belongs to bus a already"),
        ("[server]\nport = 70000\n", ":2: server.port = 70000: it must be at most 65535"),
        ("[serve]\n", ":1: unknown key serve in the file; did you mean server?"),
        ('[site]\nlanguage = "xx"\n', ":2: site.language = 'xx': write one of de, en"),
        ('[site]\ntime_zone = "Mars"\n', ":2: site.time_zone = 'Mars': write a time zone like Europe/Berlin"),
        ('[bus]\nname = "a"\n', ":1: write [[bus]] instead of [bus], as there may be several"),
        ('[server]\nhost = ""\n', ":2: server.host = '': it must have at least 1 character"),
        (BUSES + "estop_healthy = true\n", ":7: bus.estop_healthy = True: write an integer"),
    ],
)
def test_faults(tmp_path: Path, text: str, error: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(ConfigurationError) as caught:
        load(path)
    assert str(caught.value).startswith(f"{path}{error}")


def test_a_mark_of_the_byte_order_is_no_fault(tmp_path: Path) -> None:
    assert load(write(tmp_path, "\ufeff" + BUSES)).bus[0].name == "a"


def test_two_names_of_one_device_are_one_port(tmp_path: Path) -> None:
    link = tmp_path / "by-id"
    link.symlink_to("/dev/ttyUSB0")
    with pytest.raises(ConfigurationError, match="belongs to bus a already"):
        load(write(tmp_path, BUSES.replace("/dev/ttyUSB1", str(link))))


@pytest.mark.parametrize(
    ("variable", "zone"),
    [
        ("America/New_York", "America/New_York"),
        (":Asia/Tokyo", "Asia/Tokyo"),
        ("CET-1CEST,M3.5.0,M10.5.0/3", "UTC"),
        ("nonsense", "UTC"),
    ],
)
def test_where_no_zone_is_named_it_is_the_machines(
    variable: str, zone: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TZ", variable)
    machine_zone.cache_clear()
    assert Site().zone == zone
    assert Site(time_zone="Europe/Kyiv").zone == "Europe/Kyiv"


def test_the_zone_of_a_machine_is_where_its_link_points(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A TZ that names a link, as containers have it, contains no zone name."""
    link = tmp_path / "localtime"
    link.symlink_to("/usr/share/zoneinfo/Europe/Berlin")
    monkeypatch.setenv("TZ", f":{link}")
    machine_zone.cache_clear()
    assert Site().zone == "Europe/Berlin"


def test_the_digest_of_pages_is_another_one_for_other_names_and_not_for_what_no_page_shows() -> None:
    text = '[[bus]]\nname = "dry"\nport = "/dev/null"\n[[bus.unit]]\nid = 1\nname = "Nip"\n'
    digest = parse(text, Path("lineside.toml")).page_digest
    for same in (
        text + "# a comment",
        text.replace("/dev/null", "/dev/ttyS0"),
        f"[history]\nyears = 9\n{text}",
    ):
        assert parse(same, Path("lineside.toml")).page_digest == digest
    for other in (
        text.replace("Nip", "Coater"),
        text.replace("id = 1", "id = 2"),
        f'[site]\nname = "B"\n{text}',
    ):
        assert parse(other, Path("lineside.toml")).page_digest != digest


SECRET = "s3cret-word"


@pytest.mark.parametrize(
    "url",
    [f"postgresql://anna:{SECRET}@db/x", f"postgres://db/x?password={SECRET}", f"host=db password={SECRET}"],
)
def test_a_site_in_a_database_is_refused_with_what_takes_its_place(tmp_path: Path, url: str) -> None:
    config = tmp_path / "lineside.toml"
    config.write_text(f"[site]\nname = 'Mill'\n\n[store]\nurl = {json.dumps(url)}\n")
    with pytest.raises(ConfigurationError) as refused:
        load(config)
    text = str(refused.value)
    assert "lineside.toml:5: " in text
    assert "lineside migrate-store --to sqlite" in text
    assert "[postgresql]" in text
    assert SECRET not in text


SERVER = '[server]\nid = "app-1"\nhome = ["dry-end"]\nurl = "https://app-1"\n'
FORMER_BUSES = '[[bus]]\nname = "a"\nport = "/dev/null"\n[[bus]]\nname = "b"\nport = "/dev/ttyS1"\n'


@pytest.mark.parametrize(
    ("text", "ignored"),
    [
        ("", []),
        ("[history]\nraw_days = 5\n", []),
        ("[history]\nraw_days = 5\nspool_mb = 0\n", ["history.spool_mb"]),
        ('[store]\nurl = ""\npassword_file = "db.password"\n', ["store"]),
        (SERVER, ["server.home", "server.id", "server.url"]),
        (FORMER_BUSES + 'take_over = "manual"\n', ["bus.take_over"]),
        ('[[built_in_alarm]]\ncode = "break_glass_used"\non_delay_s = 5\n', ["built_in_alarm.code"]),
    ],
)
def test_other_keys_are_ignored_and_named(tmp_path: Path, text: str, ignored: list[str]) -> None:
    config = tmp_path / "lineside.toml"
    config.write_text(text)
    settings = load(config)
    assert [each.params["key"] for each in settings.former_notices] == ignored
    for each in settings.former_notices:
        line = text.splitlines()[int(each.params["line"]) - 1]
        assert str(each.params["key"]).rpartition(".")[2] in line
        assert str(each).startswith(f"{config}:{each.params['line']}: ")
    assert settings.history.raw_days == (5 if "raw_days" in text else 30)


def test_a_key_that_no_version_had_is_still_an_error(tmp_path: Path) -> None:
    config = tmp_path / "lineside.toml"
    config.write_text("[history]\nspool_gb = 1\n")
    with pytest.raises(ConfigurationError, match="spool_gb"):
        load(config)


def test_accounts_of_an_outage_are_named_and_sign_nobody_in(tmp_path: Path) -> None:
    config = tmp_path / "lineside.toml"
    config.write_text("")
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "break-glass.json").write_text("[]")
    (notice,) = load(config).former_notices
    assert str(notice).startswith(f"{tmp_path}/data/break-glass.json is not used any more")


def test_what_is_ignored_is_named_by_check_and_serve_and_no_fault(tmp_path: Path) -> None:
    config = tmp_path / "lineside.toml"
    config.write_text(
        '[server]\nport = 1\nid = "app-1"\n[[bus]]\nname = "a"\nport = "/dev/null"\ntake_over = "manual"\n'
    )
    found = json.loads(CliRunner().invoke(cli, ["check", "--json", "--config", str(config)]).stdout)[
        "findings"
    ]
    ignored = [each for each in found if each["code"] == "ignored_key"]
    assert [(each["fault"], each["params"]["line"]) for each in ignored] == [(False, 7), (False, 3)]
    assert "server.id is ignored" in ignored[1]["detail"]
    assert load_bus(config, "a").port == "/dev/null", "a worker reads the same file"
