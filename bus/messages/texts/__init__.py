"""Code → English text of every message, grouped by subject. Data only.

A text with a number of things is ``Plural``: ``n`` decides. A code is in one group only.
"""

from __future__ import annotations

from collections.abc import Mapping

from bus.messages.texts import (
    accounts,
    alarms,
    audit,
    command_line,
    commands,
    configuration,
    events,
    handover,
    history,
    notification,
    requests,
    results,
    sets,
    swaps,
    wire,
    workers,
)
from bus.messages.texts.plural import EnglishText
from bus.messages.texts.plural import Plural as Plural

GROUPS: tuple[Mapping[str, EnglishText], ...] = (
    accounts.TEXTS,
    alarms.TEXTS,
    audit.TEXTS,
    command_line.TEXTS,
    commands.TEXTS,
    configuration.TEXTS,
    events.TEXTS,
    handover.TEXTS,
    wire.TEXTS,
    history.TEXTS,
    workers.TEXTS,
    notification.TEXTS,
    requests.TEXTS,
    results.TEXTS,
    sets.TEXTS,
    swaps.TEXTS,
)
TEXTS: dict[str, EnglishText] = {code: text for group in GROUPS for code, text in group.items()}
