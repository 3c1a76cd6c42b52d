"""One alarm at run time."""

from __future__ import annotations

from dataclasses import dataclass, field

from app.alarms.definition import AlarmDefinition
from app.alarms.rules.facts import AlarmFacts


@dataclass(slots=True, eq=False)
class Alarm:
    """``holds``: its condition as last observed; None: not known."""

    definition: AlarmDefinition
    facts: AlarmFacts = field(default_factory=AlarmFacts)
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
    def mark(self) -> str:
        """Its priority as it is drawn: ``urgent``, with ``cleared`` once it is over and ``waiting`` until it
        is acknowledged."""
        cleared = "" if self.facts.active else " cleared"
        return self.definition.priority + cleared + (" waiting" if self.is_unacknowledged else "")
