"""Which packages Lineside needs where it runs, and their exact versions and hashes."""

from __future__ import annotations

import re
from importlib.metadata import distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parent.parent
LOCK = ROOT / "requirements.lock"
ENTRY = re.compile(r"^(?P<name>[\w.-]+)==(?P<version>[^\s;]+)[^\n]*\n(?:[ ]+[^\n]*\n)*", re.M)


def needed(name: str = "lineside") -> set[str]:
    """The names of the packages that an installation without extras has besides ``name``."""
    found: set[str] = set()
    waiting = [(name, frozenset[str]())]
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
    """A file of requirements with the hash of everything that runs, for pip."""
    entries = locked()
    return "".join(entries[name][1] for name in sorted(needed()))
