"""One command as a user or program requested it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from msgspec.structs import replace

from app.core.web.access import Person
from app.core.web.arrival import Deadline
from app.line.commands.catalogue import kind_of_command
from app.line.commands.values import Scales
from bus.contract import Action, Result, UnitOutcome
from bus.messages import Message

CommandOrigin = Literal["api", "batch edit", "change tray", "page", "restore", "unit swap"]
"""Which way a command came; a recipe is named by a message."""
SECRET_DIFFERS = Message("secret_differs")


@dataclass(frozen=True, slots=True)
class CommandRequest:
    """``deadline``: the last moment at which a frame that writes may leave."""

    id: str
    person: Person
    bus: str
    action: Action
    deadline: Deadline
    origin: CommandOrigin | Message
    key: str | None = None
    """The sender's key, by which it gets the result again; keys of different senders are independent."""
    undoes: str = ""
    """The key of the command that it undoes."""
    scales: Scales | None = None
    """What its values were shown and typed with; None: they were given raw."""

    @property
    def can_be_undone(self) -> bool:
        """Whether a person has sent it from a page, as a command, in a change tray or by a recipe."""
        from_page = self.origin in ("page", "change tray") or isinstance(self.origin, Message)
        return self.person.via != "token" and from_page


def without_secret(action: Action, result: Result) -> Result:
    """``result`` as it may be stored and shown: of a secret not what was read back, nor the frames, nor words
    that may name it."""
    if not kind_of_command(action).is_secret(action):
        return result
    units = [replace(unit, read_back=None, message=_masked(unit)) for unit in result.units]
    return replace(result, read_back=None, message=_masked(result), units=units, values=[], frames=[])


def _masked(result: Result | UnitOutcome) -> Message | None:
    """The message of a result, unless it states the value that was read back instead of the requested one."""
    differs = result.read_back is not None and result.outcome != "verified"
    return SECRET_DIFFERS if differs else result.message
