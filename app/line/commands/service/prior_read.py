"""What must be known of a unit before a command can be judged, and the refusal where it cannot be read."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from app.errors import Problem
from app.line.commands.catalogue import kind_of_command
from app.line.commands.limits import Limits
from app.line.commands.rules import unread_for_range
from app.line.live.bus_live import BusLive
from bus.contract import Action, Outcome, Result, UnitOutcome
from bus.instants import UnixTime
from bus.messages import Message, listed, parameter_name


class UnreadError(Problem):
    """What a command needs to know of a unit cannot be read: 503 ``bus_closed`` or 504 ``unverified``."""

    def result(self, id: str, at: UnixTime, units: Sequence[int]) -> Result:
        """The result of a command for ``units`` of which nothing was sent."""
        outcome: Outcome = "bus_closed" if self.code == "bus_closed" else "unverified"
        parts = [UnitOutcome(unit, "not_sent", Message("unit_untouched")) for unit in units]
        return Result(id, at, outcome, self.message, units=parts)


def check_all_read(unit: int, numbers: Sequence[int], result: Result) -> None:
    """Raises Problem 504 where the unit did not give all the ``numbers`` that were to be read, 503 where the
    request did not reach it."""
    if len(result.values) < len(numbers):
        status = 503 if result.outcome in ("bus_closed", "not_sent") else 504
        code = result.outcome if status == 503 else "unverified"
        detail = result.message or Message.of("unit_did_not_answer", unit=unit)
        raise Problem(status, code, detail, outcome=code, unit=unit, read=len(result.values))


def read_values(unit: int, numbers: Sequence[int], result: Result) -> dict[int, int | None]:
    """The raw value of each of the ``numbers`` that a command should read. Raises UnreadError where one is
    missing."""
    if result.outcome == "bus_closed":
        reason = result.message or Message("bus_not_linked")
        raise UnreadError(503, "bus_closed", reason, outcome="bus_closed")
    values = {value.number: value.raw for value in result.values}
    if not values.keys() >= set(numbers):
        raise unread(unit, numbers)
    return values


def unread_by_unit(
    live: BusLive, action: Action, limits: Callable[[int], Limits]
) -> dict[int, tuple[int, ...]]:
    """The parameters that bound the setpoints of ``action`` and were never read."""
    found = {
        new.unit: unread_for_range(live.units[new.unit], limits(new.unit), new.raw, new.kind)
        for new in kind_of_command(action).setpoints(action, live)
    }
    return {unit: numbers for unit, numbers in found.items() if numbers}


def unread(unit: int, numbers: Sequence[int]) -> UnreadError:
    """The refusal of a command that cannot be judged without these."""
    named = listed([parameter_name(number) for number in numbers])
    message = Message.of("unit_gave_too_little", unit=unit, numbers=named)
    return UnreadError(504, "unverified", message, outcome="unverified", unit=unit)
