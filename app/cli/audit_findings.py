"""Whether the audit log that a configuration names can be sealed and anchored on this machine."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from app.audit.keys import KeyFileError, find_key_file, owners_of, read_key_file
from app.cli.finding import Finding, fault, is_visible, may_make_files_in, user
from app.settings import Settings
from bus.messages import Message


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
        return fault("check_key_refused", reason=error.message)
    return Finding(Message.of("check_key", file=str(found)))


def _new_key(paths: Sequence[Path]) -> Finding:
    *others, last = paths
    for path in others:
        if may_make_files_in(path.parent):
            return Finding(Message.of("check_key_new", file=str(path)))
    if not others and not may_make_files_in(last.parent):
        return fault("check_key_not_creatable", user=user(), file=str(last), folder=str(last.parent))
    return Finding(Message.of("check_key_new_beside_data" if others else "check_key_new", file=str(last)))


def _anchor(path: Path) -> Finding:
    exists = is_visible(path)
    if path.is_symlink() or (exists and not path.is_file()):
        return fault("check_anchor_no_file", file=str(path))
    if not (os.access(path, os.W_OK) if exists else may_make_files_in(path.parent)):
        return fault("check_anchor_not_writable", user=user(), file=str(path))
    return Finding(Message.of("check_anchor", file=str(path)))
