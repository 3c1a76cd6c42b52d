"""The version comes from git tags, and moves with every commit; the program reports it."""

from __future__ import annotations

import subprocess
from importlib.metadata import version as installed
from pathlib import Path

import pytest
from packaging.version import Version

import hatch_version
from app.version import VERSION

CHANGES = "# Changelog\n\n## [Unreleased]\n\n## [0.9.0]\n\n## [0.10.0]\n"


def git(folder: Path, *arguments: str) -> None:
    identity = ("-c", "user.name=x", "-c", "user.email=x@example.com", "-c", "commit.gpgsign=false")
    subprocess.run(["git", *identity, *arguments], cwd=folder, check=True, capture_output=True)


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A repository with one commit and no tag."""
    git(tmp_path, "init", "-q")
    (tmp_path / "CHANGELOG.md").write_text(CHANGES)
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-qm", "First")
    return tmp_path


def test_a_tag_is_a_release_and_what_follows_lies_before_the_next(checkout: Path) -> None:
    git(checkout, "tag", "v1.4.0")
    assert hatch_version.version(checkout) == "1.4.0"
    git(checkout, "commit", "-qm", "Second", "--allow-empty")
    later = hatch_version.version(checkout)
    assert later.startswith("1.4.1.dev1+g")
    assert Version("1.4.0") < Version(later) < Version("1.4.1")
    git(checkout, "tag", "v1.5.0")
    assert hatch_version.version(checkout) == "1.5.0"
    (checkout / "CHANGELOG.md").write_text("changed")
    assert hatch_version.version(checkout).endswith(".dirty")
    assert Version("1.5.0") < Version(hatch_version.version(checkout))


def test_without_tags_the_newest_release_of_the_changelog_counts(checkout: Path) -> None:
    first = hatch_version.version(checkout)
    assert first.startswith("0.10.1.dev1+g")
    git(checkout, "commit", "-qm", "Second", "--allow-empty")
    assert Version(first) < Version(hatch_version.version(checkout)) < Version("0.10.1")


def test_a_source_archive_knows_its_version_also_in_the_repository_of_something_else(checkout: Path) -> None:
    unpacked = checkout / "lineside"
    unpacked.mkdir()
    (unpacked / "CHANGELOG.md").write_text(CHANGES)
    git(checkout, "tag", "v7.0.0")
    assert hatch_version.version(unpacked) == "0.10.1.dev0"
    (unpacked / "PKG-INFO").write_text("Name: lineside\nVersion: 1.2.3\n\nVersion: 9\n")
    assert hatch_version.version(unpacked) == "1.2.3"


@pytest.mark.parametrize("described", ["v1.2rc1-0-gabc", "1.2.0-0-gabc", "v1.2.0"])
def test_another_tag_is_refused(described: str) -> None:
    with pytest.raises(ValueError, match="tag of a release"):
        hatch_version.of_tag(described)


def test_the_program_reports_the_installed_one() -> None:
    assert installed("lineside") == VERSION
