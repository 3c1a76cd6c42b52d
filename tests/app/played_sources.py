"""Data shown beside the live state, as a test sets it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from app.line.live.fields import Translator
from app.line.live.sources import BusControl, Drifted, Sources
from bus.messages import Message


class PlayedGuards:
    """``blocks``: by unit, why commands to it are blocked; ``controls``: by bus, who controls it."""

    def __init__(self, bus: str, blocks: Mapping[int, str], controls: Mapping[str, str]) -> None:
        self._bus = bus
        self._blocks = blocks
        self._controls = controls

    def block_reason(self, unit: int) -> Message | None:
        """As the real ones; anna has blocked all of them."""
        reason = self._blocks.get(unit)
        return None if reason is None else Message.of("block_by", reason=reason, who="anna")

    def bus_control(self) -> BusControl:
        """As the real ones; no request is open."""
        return BusControl(self._bus, self._controls.get(self._bus, ""))


class NoGoldenSets:
    """No unit has a golden set."""

    def of(self, _unit: int) -> list[object]:
        """Nothing differs."""
        return []

    def summary(self, _unit: int, _translator: Translator, _now: float) -> Drifted:
        """Nothing differs."""
        return Drifted()


def played_sources(
    buses: Iterable[str] = ("dry",),
    blocks: Mapping[int, str] | None = None,
    controls: Mapping[str, str] | None = None,
) -> Sources:
    """Nothing to show but what the test names."""
    controls, blocks = {} if controls is None else controls, {} if blocks is None else blocks
    names = list(buses)
    return Sources(
        {bus: PlayedGuards(bus, blocks, controls) for bus in names},
        {bus: NoGoldenSets() for bus in names},
        {bus: lambda: None for bus in names},
    )
