"""A lineside.toml, and what is wrong with it."""

from __future__ import annotations

from pathlib import Path

from app.settings import ConfigurationError, load


def faults_of(folder: Path, text: str) -> str:
    """The faults of ``text`` as ``folder``'s lineside.toml; empty where there is none."""
    path = folder / "lineside.toml"
    path.write_text(text)
    try:
        load(path)
    except ConfigurationError as error:
        return str(error).replace(str(path), "FILE")
    return ""
