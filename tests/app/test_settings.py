"""lineside.toml as the dashboard reads it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from app.core.messages.languages import machine_zone
from app.settings import ConfigurationError, Site, load, parse

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
        ("bus = 3\n", ":1: bus = 3: it must be a list"),
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
        ("/usr/share/zoneinfo/Europe/Berlin", "Europe/Berlin"),
        ("CET-1CEST,M3.5.0,M10.5.0/3", "UTC"),
        ("nonsense", "UTC"),
        ("localtime", "UTC"),
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
