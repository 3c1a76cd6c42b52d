"""What the head of a page shows from its first paint, before a script has run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from app.messages import Language


@dataclass(frozen=True, slots=True)
class PageHead:
    """``alarms``: the fields of the alarms in the language of a reader."""

    alarms: Callable[[Language], Mapping[str, Any]]
