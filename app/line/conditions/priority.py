"""Priority by consequence and time to respond (EEMUA 191, 4.4; ISA-18.2-2016, clause 9)."""

from __future__ import annotations

from typing import Literal

AlarmPriority = Literal["urgent", "high", "medium", "low"]
PRIORITIES: tuple[AlarmPriority, ...] = ("urgent", "high", "medium", "low")
Consequence = Literal["minor", "major", "severe"]
TimeToRespond = Literal["minutes", "half_hour", "shift"]
"""Until the consequence can no longer be averted: ten minutes, thirty, or the rest of the shift."""

MATRIX: dict[tuple[Consequence, TimeToRespond], AlarmPriority] = {
    ("severe", "minutes"): "urgent",
    ("severe", "half_hour"): "high",
    ("severe", "shift"): "medium",
    ("major", "minutes"): "high",
    ("major", "half_hour"): "medium",
    ("major", "shift"): "low",
    ("minor", "minutes"): "medium",
    ("minor", "half_hour"): "low",
    ("minor", "shift"): "low",
}
