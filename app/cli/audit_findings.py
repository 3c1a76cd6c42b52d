"""Whether the audit log that a configuration names can be sealed and anchored on this machine."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from app.audit.key_file import KeyFileError, read_key_file
from app.audit.keys import find_key_file, owners_of
from app.cli.finding import Finding, is_visible, may_make_files_in, user
from app.settings import Settings


def audit_findings(settings: Settings) -> Iterator[Finding]:
    """Where its key and its anchor are or will be."""
    yield _key(settings.key_files, settings.server.store)
    if settings.audit.anchor is not None:
        yield _anchor(settings.audit.anchor)


def _key(paths: Sequence[Path], store: Path) -> Finding:
    found = find_key_file(paths)
    if found is None:
        return _new_key(paths)
    try:
        read_key_file(found, owners_of(store) if is_visible(store) else frozenset({os.geteuid(), 0}))
    except KeyFileError as error:
        return Finding(f"[audit]: {error}.", is_fault=True)
    return Finding(f"audit key {found}")


def _new_key(paths: Sequence[Path]) -> Finding:
    *others, last = paths
    for path in others:
        if may_make_files_in(path.parent):
            return Finding(f"audit key {path}, made at the first start")
    if not others and not may_make_files_in(last.parent):
        return Finding(
            f"audit key: {user()} may not make {last}. Give that user write access to {last.parent} for the "
            "first start, or name another place as key_file in [audit].",
            is_fault=True,
        )
    warning = "" if not others else "; who can read the data can forge the log: name a key_file in [audit]"
    return Finding(f"audit key {last}, made at the first start{warning}")


def _anchor(path: Path) -> Finding:
    exists = is_visible(path)
    if path.is_symlink() or (exists and not path.is_file()):
        return Finding(f"anchor: {path} is no file. Name a file as anchor in [audit].", is_fault=True)
    if not (os.access(path, os.W_OK) if exists else may_make_files_in(path.parent)):
        return Finding(
            f"anchor: {user()} may not write {path}. Give that user write access to it, or name another file "
            "as anchor in [audit].",
            is_fault=True,
        )
    return Finding(f"audit anchor {path}")
