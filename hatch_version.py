"""The version, for hatchling: that of the git tag, so that it moves with every release and every commit.

At the tag v1.4.0 it is ``1.4.0``; seven commits later ``1.4.1.dev7+g845bc4487``, which is after 1.4.0 and
before 1.4.1 (PEP 440). Where a clone has no tags, the newest release of CHANGELOG.md stands for them; where
there is no git, as in a source archive, PKG-INFO has the version.
"""

from __future__ import annotations

import re
import subprocess
from email import message_from_string
from pathlib import Path

ROOT = Path(__file__).resolve().parent
DESCRIBED = re.compile(
    r"v(?P<release>\d+(?:\.\d+)*)-(?P<commits>\d+)-(?P<commit>g[0-9a-f]+)(?P<changed>-dirty)?"
)
RELEASES = re.compile(r"^## \[(\d+(?:\.\d+)*)\]", re.M)


def version(root: Path = ROOT) -> str:
    """The version of the files in ``root``."""
    archive = root / "PKG-INFO"
    if archive.is_file():
        return str(message_from_string(archive.read_text(encoding="utf-8"))["Version"])
    if described := _git(root, "describe", "--tags", "--match", "v[0-9]*", "--long", "--dirty"):
        return of_tag(described)
    newest = max(RELEASES.findall((root / "CHANGELOG.md").read_text(encoding="utf-8")), key=_numbers)
    commit = _git(root, "rev-parse", "--short=9", "HEAD")
    number = _git(root, "rev-list", "--count", "HEAD") or "0"
    return f"{_after(newest)}.dev{number}" + (f"+g{commit}" if commit else "")


def of_tag(described: str) -> str:
    """The version for what ``git describe --long --dirty`` prints. Raises ValueError for another text."""
    parts = DESCRIBED.fullmatch(described)
    if parts is None:
        raise ValueError(f"A tag of a release is v and numbers: {described}")
    if parts["commits"] == "0" and not parts["changed"]:
        return parts["release"]
    changed = ".dirty" if parts["changed"] else ""
    return f"{_after(parts['release'])}.dev{parts['commits']}+{parts['commit']}{changed}"


def _after(release: str) -> str:
    *first, last = _numbers(release)
    return ".".join(map(str, (*first, last + 1)))


def _numbers(release: str) -> tuple[int, ...]:
    return tuple(map(int, release.split(".")))


def _git(root: Path, *arguments: str) -> str:
    """What git prints; empty where there is none, or ``root`` is a folder of another repository."""
    if not (root / ".git").exists():
        return ""
    try:
        done = subprocess.run(["git", *arguments], cwd=root, capture_output=True, text=True, check=False)
    except OSError:
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""
