"""One alarm at run time."""

from __future__ import annotations

from dataclasses import dataclass

from app.alarms.definition import AlarmDefinition
from app.alarms.rules.facts import AlarmFacts
from app.alarms.rules.states import AlarmState
from bus.messages import Message

NORMAL = AlarmFacts()
"""Of every alarm that has not risen yet."""


def state_text(state: AlarmState) -> Message:
    """The words for a state."""
    return Message(f"alarm_state_{state}")


@dataclass(slots=True, eq=False)
class Alarm:
    """``holds``: its condition as last observed; None: not known."""

    definition: AlarmDefinition
    facts: AlarmFacts = NORMAL
    holds: bool | None = None
    first_out: bool = False
    """It was the first of several that rose together."""
    hidden_by: str = ""
    """Who shelved it or took it out of service, and ``reason``: why."""
    reason: str = ""

    @property
    def id(self) -> str:
        """Names its present occurrence."""
        return f"{self.definition.key}.{self.facts.occurrence}"

    @property
    def is_unacknowledged(self) -> bool:
        """Whether it waits for a person to see it."""
        return not self.facts.is_hidden and not self.facts.acknowledged

    @property
    def is_annunciated(self) -> bool:
        """Whether a person is to know of it: it is active or not acknowledged, and nothing hides it."""
        return not self.facts.is_hidden and (self.facts.active or not self.facts.acknowledged)

    @property
    def state_text(self) -> Message:
        """The words for its state."""
        return state_text(self.facts.state)

    @property
    def hiding(self) -> tuple[str, str]:
        """The person who hides it and why; empty where none does."""
        return (self.hidden_by, self.reason) if self.facts.is_hidden_by_person else ("", "")

    @property
    def mark(self) -> str:
        """Its priority as it is drawn: ``urgent``, with ``cleared`` once it is over and ``waiting`` until it
        is acknowledged."""
        cleared = "" if self.facts.active else " cleared"
        return self.definition.priority + cleared + (" waiting" if self.is_unacknowledged else "")
