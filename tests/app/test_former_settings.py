"""Keys that lineside.toml had in version 0.2: ignored with a warning; data in a database is refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from app.cli import cli
from app.settings import ConfigurationError, load
from bus.configuration import load_bus

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
BUSES = '[[bus]]\nname = "a"\nport = "/dev/null"\n[[bus]]\nname = "b"\nport = "/dev/ttyS1"\n'


@pytest.mark.parametrize(
    ("text", "ignored"),
    [
        ("", []),
        ("[history]\nraw_days = 5\n", []),
        ("[history]\nraw_days = 5\nspool_mb = 0\n", ["history.spool_mb"]),
        ("[store]\n", ["store"]),
        ('[store]\nurl = ""\npassword_file = "db.password"\n', ["store"]),
        ("store = 5\n[history]\nspool_mb = 7\n", ["history.spool_mb", "store"]),
        (SERVER, ["server.home", "server.id", "server.url"]),
        (BUSES + 'take_over = "manual"\n', ["bus.take_over"]),
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


def test_a_setting_that_no_version_had_is_an_error_of_a_bus_too(tmp_path: Path) -> None:
    config = tmp_path / "lineside.toml"
    config.write_text('[[bus]]\nname = "a"\nport = "/dev/null"\ntake_under = "manual"\n')
    with pytest.raises(ConfigurationError, match=r"lineside\.toml:4: .*take_under"):
        load(config)
