"""``lineside audit verify`` of a site whose old events are archived, and the check of its folder."""

from __future__ import annotations

from pathlib import Path

import pytest

from app.cli.audit import proof_of
from app.cli.findings import Finding, archive
from app.errors import StoreError
from app.settings import Settings, load
from bus.messages import Message
from tests.app.archived_site import archived_site


@pytest.fixture
async def site(tmp_path: Path) -> Settings:
    """Five months of events, of which the first three are archived."""
    return await archived_site(tmp_path)


def verified(settings: Settings, archive: Path | None = None) -> list[str]:
    return [str(line) for line in proof_of(settings, None, archive)]


async def test_verify_follows_the_chains_through_the_archive(site: Settings, tmp_path: Path) -> None:
    complete, *_ = lines = verified(site)
    assert complete == "the audit log is intact: 13 entries"
    assert "the archive is intact: 6 of these entries" in lines
    elsewhere = (tmp_path / "archive").rename(tmp_path / "safe")
    assert any("events-2026-01.jsonl.gz" in line and "not verified" in line for line in verified(site))
    assert "the archive is intact: 6 of these entries" in verified(site, elsewhere)


async def test_verify_names_a_damaged_file(site: Settings, tmp_path: Path) -> None:
    (tmp_path / "archive" / "events-2026-02.jsonl.gz").write_bytes(b"damaged")
    with pytest.raises(StoreError, match="events-2026-02"):
        verified(site)


def test_check_names_a_folder_that_is_not_there(tmp_path: Path) -> None:
    file = tmp_path / "lineside.toml"
    file.write_text('[audit]\narchive = "archive"\n')
    folder = tmp_path / "archive"
    missing = Message.of("audit_archive_folder_missing", folder=str(folder))
    assert Finding(missing, is_fault=True) in list(archive(load(file)))
    folder.mkdir()
    assert Finding(Message.of("check_archive", folder=str(folder))) in list(archive(load(file)))
