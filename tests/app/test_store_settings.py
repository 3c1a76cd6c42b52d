"""``[store]``: a URL whose password no message, event or dump contains."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from app.database.settings import StoreSettings, without_secrets
from app.settings import ConfigurationError, Settings, load

ROOT = Path(__file__).parents[2]
SECRET = "s3cret-word"


@pytest.mark.parametrize(
    ("url", "shown"),
    [
        ("postgresql://db/lineside", "postgresql://db/lineside"),
        (f"postgresql://anna:{SECRET}@db:5433/lineside", "postgresql://anna@db:5433/lineside"),
        (f"postgres://anna:{SECRET}@db/x?sslmode=verify-full", "postgres://anna@db/x?sslmode=verify-full"),
        (f"postgresql://db/x?password={SECRET}&sslpassword={SECRET}", "postgresql://db/x"),
        (
            f"postgresql://anna:{SECRET}@a:5432,b:5433/x?target_session_attrs=read-write",
            "postgresql://anna@a:5432,b:5433/x?target_session_attrs=read-write",
        ),
        ("postgresql:///x?host=/var/run/postgresql", "postgresql:///x?host=/var/run/postgresql"),
        (f"postgresql://anna:{SECRET}%40@[::1]/x", "postgresql://anna@[::1]/x"),
        ("", ""),
    ],
)
def test_a_url_is_shown_without_its_secrets(url: str, shown: str) -> None:
    assert without_secrets(url) == shown
    settings = Settings(store=StoreSettings(url=url))
    assert settings.store.url == url
    for text in (repr(settings), str(settings.model_dump()), json.dumps(settings.model_dump(mode="json"))):
        assert SECRET not in text
    assert settings.model_dump()["store"]["url"] == shown


@pytest.mark.parametrize(
    "url",
    [
        f"mysql://anna:{SECRET}@db/x",
        "db.plant.example",
        f"postgresql://anna:{SECRET}@db",
        f"postgresql://anna:{SECRET}@db/",
        f"postgresql://anna:{SECRET}@[db/x",
        f"host=db password={SECRET}",
    ],
)
def test_a_wrong_url_is_refused_with_its_line_and_without_its_password(tmp_path: Path, url: str) -> None:
    config = tmp_path / "lineside.toml"
    config.write_text(f"[store]\nurl = {json.dumps(url)}\n")
    with pytest.raises(ConfigurationError) as refused:
        load(config)
    assert "lineside.toml:2: store.url is no URL of a PostgreSQL database" in str(refused.value)
    assert SECRET not in str(refused.value)


def test_the_password_file_is_beside_the_configuration(tmp_path: Path) -> None:
    config = tmp_path / "lineside.toml"
    config.write_text('[store]\nurl = "postgresql://db/x"\npassword_file = "db.password"\n')
    assert load(config).store.password_file == tmp_path / "db.password"


def test_without_it_the_stores_are_files(tmp_path: Path) -> None:
    config = tmp_path / "lineside.toml"
    config.write_text("")
    assert load(config).store_name == str(tmp_path / "data" / "lineside.db")


def test_the_driver_is_imported_only_where_a_url_is_configured() -> None:
    """No module of the app imports it, or what needs it, when it is imported itself."""
    engine = ROOT / "app" / "database" / "postgresql"
    modules = [path for path in (ROOT / "app").rglob("*.py") if engine not in path.parents]
    assert len(modules) > 400
    pattern = re.compile(r"^(?:from|import) (?:psycopg|app\.database\.postgresql)", re.MULTILINE)
    assert [module for module in modules if pattern.search(module.read_text("utf-8"))] == []
