"""Which packages Lineside needs where it runs, and their exact versions and hashes."""

from __future__ import annotations

import re
from importlib.metadata import distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parent.parent
LOCK = ROOT / "requirements-dev.lock"
"""Of the two locks the one that has the extras; what is in both has the same version."""
ENTRY = re.compile(r"^(?P<name>[\w.-]+)==(?P<version>[^\s;]+)[^\n]*\n(?:[ ]+[^\n]*\n)*", re.M)


def needed(*extras: str, name: str = "lineside") -> set[str]:
    """Return the names of the packages that an installation with these extras has besides ``name``."""
    found: set[str] = set()
    waiting = [(name, frozenset(extras))]
    while waiting:
        package, extras = waiting.pop()
        for text in distribution(package).requires or ():
            required = Requirement(text)
            if required.marker is None or any(
                required.marker.evaluate({"extra": extra}) for extra in (extras or {""})
            ):
                canonical = str(canonicalize_name(required.name))
                if canonical not in found:
                    found.add(canonical)
                    waiting.append((canonical, frozenset(required.extras)))
    return found


def extras(name: str = "lineside") -> list[str]:
    """Return every extra: bundle and package have them all, for where there is no network to add one."""
    return distribution(name).metadata.get_all("Provides-Extra") or []


def locked(lock: Path = LOCK) -> dict[str, tuple[str, str]]:
    """Of each package in the lock its version, and its entry with the hashes."""
    text = lock.read_text(encoding="utf-8")
    return {
        str(canonicalize_name(entry["name"])): (entry["version"], without_comments(entry[0]))
        for entry in ENTRY.finditer(text)
    }


def without_comments(entry: str) -> str:
    lines = [line for line in entry.splitlines() if not line.lstrip().startswith("#")]
    return "\n".join(lines).rstrip(" \\") + "\n"


def requirements() -> str:
    """Return a file of requirements for pip, with the hash of everything that runs and of pip itself."""
    entries = locked()
    return "".join(entries[name][1] for name in sorted(needed(*extras()) | {"pip"}))
