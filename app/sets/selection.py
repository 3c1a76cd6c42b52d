"""Which rows of a restore a person chose to write."""

from __future__ import annotations

from dataclasses import dataclass, replace

from app.errors import Problem
from bus.messages import Message


@dataclass(frozen=True, slots=True)
class Selection:
    """The selected rows, by number. ``include``: rows that are left out unless named; ``exclude``:
    rows not to write; ``confirmed``: dangerous rows to write, each confirmed separately.

    Raises Problem 422 for a row that is both named and excluded.
    """

    include: frozenset[int] = frozenset()
    exclude: frozenset[int] = frozenset()
    confirmed: frozenset[int] = frozenset()

    def __post_init__(self) -> None:
        both = sorted(self.exclude & (self.include | self.confirmed))
        if both:
            raise Problem(422, "invalid", Message.of("row_included_and_excluded", number=both[0]))

    def choosing(self, include: frozenset[int], exclude: frozenset[int]) -> Selection:
        """Another choice of rows; what was confirmed stays so unless it is excluded now."""
        return replace(self, include=include, exclude=exclude, confirmed=self.confirmed - exclude)


EVERYTHING_HARMLESS = Selection()
"""The rows written without a selection: all but setpoints and dangerous ones."""
