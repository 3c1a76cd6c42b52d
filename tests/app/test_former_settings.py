"""Keys that lineside.toml had in version 0.2: ignored with a warning; data in a database is refused."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import pytest

from app.former_settings import former_keys
from app.settings import ConfigurationError, load

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


@pytest.mark.parametrize(
    ("text", "ignored"),
    [
        ("", []),
        ("[history]\nraw_days = 5\n", []),
        ("[history]\nraw_days = 5\nspool_mb = 0\n", ["history.spool_mb"]),
        ("[store]\n", ["store"]),
        ('[store]\nurl = ""\npassword_file = "db.password"\n', ["store"]),
        ("store = 5\n[history]\nspool_mb = 7\n", ["history.spool_mb", "store"]),
    ],
)
def test_other_keys_are_ignored_and_named(tmp_path: Path, text: str, ignored: list[str]) -> None:
    config = tmp_path / "lineside.toml"
    config.write_text(text)
    settings = load(config)
    assert former_keys(tomllib.loads(text)) == ignored
    assert len(settings.former_notices) == bool(ignored)
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
