"""Code → English text of every message, grouped by subject. Data only.

A text with a number of things is ``Plural``: ``n`` decides. A code is in one group only.
"""

from __future__ import annotations

from bus.messages.texts import (
    accounts,
    alarms,
    audit,
    command_line,
    commands,
    configuration,
    events,
    findings,
    frames,
    history,
    machine,
    notification,
    ports,
    recipes,
    reports,
    requests,
    results,
    reviews,
    sets,
    stores,
    swaps,
    units,
    workers,
)
from bus.messages.texts.plural import EnglishText
from bus.messages.texts.plural import Plural as Plural

GROUPS: tuple[dict[str, EnglishText], ...] = (
    accounts.TEXTS,
    alarms.TEXTS,
    audit.TEXTS,
    command_line.TEXTS,
    commands.TEXTS,
    configuration.TEXTS,
    events.TEXTS,
    findings.TEXTS,
    frames.TEXTS,
    history.TEXTS,
    machine.TEXTS,
    notification.TEXTS,
    ports.TEXTS,
    recipes.TEXTS,
    reports.TEXTS,
    requests.TEXTS,
    results.TEXTS,
    reviews.TEXTS,
    sets.TEXTS,
    stores.TEXTS,
    swaps.TEXTS,
    units.TEXTS,
    workers.TEXTS,
)
TEXTS: dict[str, EnglishText] = {code: text for group in GROUPS for code, text in group.items()}
