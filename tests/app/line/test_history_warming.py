"""Data prepared before the first page request."""

from __future__ import annotations

from pathlib import Path

import pytest

from app.core.web.assets import Assets, static_dir, templates_dir
from app.core.web.templating import Templates
from app.line.history import pages
from app.line.history.service import History
from app.settings import ServerSettings, Settings, Site
from bus.settings import BusSettings, UnitSettings


@pytest.mark.parametrize("open_store", [True, False], ids=["a store", "none that opens"])
async def test_catalogs_are_read_files_packed_templates_loaded_and_the_store_queried(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, open_store: bool
) -> None:
    monkeypatch.setattr(pages, "AFTER_S", 0.0)
    bus = BusSettings(name="line", port="/dev/null", unit=(UnitSettings(id=1, name="Nip"),))
    history = History(Settings(server=ServerSettings(data=tmp_path), bus=(bus,)))
    if open_store:
        history.start()
    assets = Assets(static_dir())
    templates = Templates(templates_dir(), assets, Site(), kept_in=tmp_path / "compiled")
    await pages.warm(history, templates, assets, "de")
    if open_store:
        history.close()
    assert all(assets.get(name)._form[1] is not None for name in assets)
    cache = templates.environment("de").cache
    assert cache is not None
    read = {name for _, name in cache}
    assert {"base.html", "trends/page.html", "components/frame.html"} <= read
    assert "catalog" in vars(templates.languages["de"])
    kept = {path.name for path in (tmp_path / "compiled").glob("*.mo")}
    assert kept == {f"{language.locale}.mo" for language in templates.languages}
