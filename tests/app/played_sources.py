"""Data shown beside the live state, as a test sets it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

from app.core.web.rendering.head_control import BusControl
from app.line.live.fields import Fields, Translator
from app.line.live.sources import AlarmChangeSubscriber, Drifted, Sources, UnitSubscriber
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

    def on_control(self, _subscriber: Callable[[], None]) -> None:
        """A change is seen at the next tick."""

    def on_block(self, _subscriber: UnitSubscriber) -> None:
        """These never change."""


class NoGoldenSets:
    """No unit has a golden set."""

    def summary(self, _unit: int, _translator: Translator, _now: float) -> Drifted:
        """Nothing."""
        return Drifted()

    def on_change(self, _subscriber: UnitSubscriber) -> None:
        """Never."""


class NoAlarms:
    """Nothing is wrong."""

    def banner(self, _translator: Translator, _now: float) -> dict[str, str]:
        """Nothing."""
        return {}

    def of_unit(self, _bus: str, _unit: int, _translator: Translator, _now: float) -> dict[str, str]:
        """Nothing."""
        return {}

    def on_change(self, _subscriber: AlarmChangeSubscriber) -> None:
        """Never."""


class NoLines:
    """There is no other line."""

    def shown(self, _translator: Translator) -> dict[str, Fields]:
        """Nothing."""
        return {}

    def changes(self, _translator: Translator) -> dict[str, Fields]:
        """Nothing."""
        return {}

    def forget(self, _tag: str) -> None:
        """Nothing is kept."""


class NoRecipes:
    """No recipe was loaded."""

    def loaded_words(self, _bus: str) -> None:
        """Nothing."""
        return


def played_sources(
    buses: Iterable[str] = ("dry",),
    blocks: Mapping[int, str] | None = None,
    controls: Mapping[str, str] | None = None,
) -> Sources:
    """Nothing to show but what the test names."""
    controls, blocks = {} if controls is None else controls, {} if blocks is None else blocks
    guards = {bus: PlayedGuards(bus, blocks, controls) for bus in buses}
    drift = {bus: NoGoldenSets() for bus in guards}
    return Sources(
        guards, drift, NoRecipes(), NoAlarms(), NoLines(), lambda _translator, _now: "", lambda: None
    )
