"""Ids of commands between app and bus worker.

The worker carries out an id once and repeats its result when it gets the id again. Therefore no id is used
twice: the id given by a sender, which another sender or a later day may use as well, is only a part of it, by
which a page finds the progress of its command.
"""

from __future__ import annotations

import uuid

_MARK = "#"


def new_command_id(key: str | None = None) -> str:
    """An id that no other command has or will have; ``key``: what its sender calls it."""
    unique = uuid.uuid4().hex
    return unique if key is None else f"{key}{_MARK}{unique}"


def key_of(command_id: str) -> str:
    """What its sender calls a command; its id where the sender gave it no key."""
    key, _, unique = command_id.rpartition(_MARK)
    return key or unique
