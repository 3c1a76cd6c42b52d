"""All browsers: told of a change in the same turn of the loop in which the worker reported it.

Nothing here batches or waits for a timer. A change is rendered once for each language that someone
reads, encoded once, and handed to every browser of that language. Only what nobody reports, age,
is looked at once a second; the same tick is the heartbeat that every page draws.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import Any

from app.live.age import scan_s_of
from app.live.browser import Browser, Diff
from app.live.fields import Voice, health_fields, unit_key
from app.live.screen import WHOLE_LINE, Block, Drift, Groups, Recipe, Screen, motions_for, watch_motions
from app.live.state import LiveState
from app.web.templating import Templates
from bus.contract import BusFigures, BusLink, Frame, Frames, Progress, Update

HEARTBEAT_S = 1.0
STAGE_WORDS = {
    "waiting": "waiting for the wire",
    "sent": "sent",
    "acknowledged": "acknowledged",
    "proving": "reading back",
}
Watcher = Callable[[str, list[int], bool], None]
"""Told of a bus, the units that someone has open there, and whether someone follows its trace."""


class Hub:
    """Every open page. ``clock`` gives seconds since the epoch, as the live state's times are."""

    def __init__(self, live: LiveState, templates: Templates, clock: Callable[[], float]) -> None:
        self.live = live
        self._templates = templates
        self._clock = clock
        self._motions = motions_for(live)
        self._screens: dict[str, Screen] = {}
        self._numbers: dict[str, int] = {}
        self._browsers: list[Browser] = []
        self._watched: dict[str, tuple[list[int], bool]] = {}
        self.block: Block = _unblocked
        self.drift: Drift = _undrifted
        self.recipe: Recipe = _unloaded
        self.watch: Watcher = _unwatched
        self.holder: Callable[[str], str] = _unheld
        """Who holds control of a bus; empty where nobody does."""
        self.memory: Callable[[Voice, float], str] = _unforgetting
        """Why no history is kept, in words; empty while it is."""
        live.subscribe(self._on_updates)

    @property
    def connected(self) -> int:
        """How many pages are open now."""
        return len(self._browsers)

    def people(self) -> dict[str, str]:
        """Whoever has a page open now, by name, with the role."""
        roles = {browser.name: browser.role for browser in self._browsers}
        return {name: roles[name] for name in sorted(roles)}

    def screen(self, language: str) -> Screen:
        """What is shown in a language, brought up to date."""
        screen = self._screens.get(language)
        if screen is None:
            voice = Voice(self._templates.languages[language], self._templates.formats(language))
            screen = Screen(
                self.live,
                voice,
                self._motions,
                lambda bus, unit: self.block(bus, unit),
                lambda bus, unit: self.drift(bus, unit),
                lambda bus: self.recipe(bus),
            )
            self._screens[language] = screen
            self._numbers[language] = 0
        self._publish(language, screen.refresh(self._clock()))
        self._publish(language, screen.put(WHOLE_LINE, {"memory": self.memory(screen.voice, self._clock())}))
        return screen

    def join(self, browser: Browser) -> None:
        """A page opened: the whole snapshot first, then diffs."""
        self.screen(browser.language)
        self._browsers.append(browser)
        self.send_snapshot(browser)
        self._tell_watched()
        self._share()
        self._publish_people()

    def leave(self, browser: Browser) -> None:
        """A page closed."""
        self._browsers.remove(browser)
        self._share()
        self._tell_watched()
        self._publish_people()

    def send_snapshot(self, browser: Browser) -> None:
        """Everything, to a page that opened or missed a number."""
        browser.say(
            {
                "is": "snapshot",
                "n": self._numbers[browser.language],
                "t": round(self._clock(), 3),
                "f": self._screens[browser.language].shown,
            }
        )

    def follow(self, browser: Browser, units: frozenset[tuple[str, int]], trace: str) -> None:
        """A page says which units it shows and whose frames it follows."""
        browser.units, browser.trace = units, trace
        self._tell_watched()

    def refresh_unit(self, bus: str, unit: int) -> None:
        """Something that no worker reports has changed, for example a block."""
        self._render(bus, [unit], whole_bus=False)

    async def beat(self) -> None:
        """The heartbeat of every page, for ever."""
        while True:
            await asyncio.sleep(HEARTBEAT_S)
            self.tick()

    def tick(self) -> None:
        """One heartbeat: what has aged, and the server's time."""
        now = self._clock()
        for language in self._languages():
            screen = self._screens[language]
            groups = screen.settle(now)
            said = {"holder": self._holders(), "memory": self.memory(screen.voice, now)}
            for held in (screen.put(WHOLE_LINE, said), *self._held(screen)):
                for group, fields in held.items():
                    groups.setdefault(group, {}).update(fields)
            self._publish(language, groups, always=True)

    def _holders(self) -> str:
        return ", ".join(sorted({holder for bus in self.live.buses if (holder := self.holder(bus))}))

    def _held(self, screen: Screen) -> list[Groups]:
        return [screen.put(bus, {"held_by": self.holder(bus)}) for bus in self.live.buses]

    # --- what the workers report -------------------------------------------------------------------

    def _on_updates(self, bus_name: str, updates: Sequence[Update]) -> None:
        bus = self.live.buses[bus_name]
        units = {unit for update in updates if (unit := getattr(update, "unit", None)) in bus.units}
        watch_motions(self._motions, bus_name, bus, sorted(units), scan_s_of(bus))
        whole_bus = any(isinstance(update, BusFigures | BusLink) for update in updates)
        if any(isinstance(update, BusLink) for update in updates):
            units = set(bus.units)
        self._render(bus_name, sorted(units), whole_bus=whole_bus)
        for update in updates:
            self._pass_on(bus_name, update)

    def _render(self, bus: str, units: list[int], *, whole_bus: bool) -> None:
        now = self._clock()
        for language in self._languages():
            self._publish(language, self._screens[language].see(bus, units, now, whole_bus=whole_bus))

    def _pass_on(self, bus: str, update: Update) -> None:
        match update:
            case Progress():
                self._show_progress(update)
            case Frames():
                self._show_frames(bus, update.frames)
            case BusFigures():
                self._show_health(bus, update)

    def _show_progress(self, progress: Progress) -> None:
        for language in self._languages():
            voice = self._screens[language].voice
            text = voice.t(STAGE_WORDS[progress.stage])
            if progress.of > 1:
                text += f" {progress.done}/{progress.of}"
            self._publish(language, {f"command/{progress.id}": {"stage": text}})

    def _show_health(self, bus: str, figures: BusFigures) -> None:
        watched = self._opened_units(bus)
        for language in self._languages():
            screen, groups = self._screens[language], Groups()
            for unit in figures.units:
                if unit.unit in watched:
                    groups |= screen.put(
                        f"health/{unit_key(bus, unit.unit)}", health_fields(unit, screen.voice)
                    )
            self._publish(language, groups)

    def _show_frames(self, bus: str, frames: Sequence[Frame]) -> None:
        followers = [browser for browser in self._browsers if browser.trace == bus]
        if followers:
            shown = [_frame(frame) for frame in frames]
            for browser in followers:
                browser.show_frames(shown)

    # --- to the browsers ----------------------------------------------------------------------------

    def _languages(self) -> list[str]:
        return sorted({browser.language for browser in self._browsers})

    def _publish(self, language: str, groups: Groups, *, always: bool = False) -> None:
        if not groups and not always:
            return
        before = self._numbers[language]
        self._numbers[language] = before + 1
        readers = [browser for browser in self._browsers if browser.language == language]
        if readers:
            diff = Diff(before, before + 1, self._clock(), groups)
            for browser in readers:
                browser.tell(diff)

    def _share(self) -> None:
        for browser in self._browsers:
            browser.share(len(self._browsers))

    def _publish_people(self) -> None:
        people = self.people()
        for language in self._languages():
            screen = self._screens[language]
            here = "\n".join(f"{name}\t{screen.voice.t(role)}" for name, role in people.items())
            self._publish(language, screen.put("people", {"here": here, "count": str(len(people))}))

    def _tell_watched(self) -> None:
        for bus, live in self.live.buses.items():
            units = self._opened_units(bus) or (sorted(live.units) if self._browsers else [])
            wish = (units, any(browser.trace == bus for browser in self._browsers))
            if self._watched.get(bus, ([], False)) != wish:
                self._watched[bus] = wish
                self.watch(bus, *wish)

    def _opened_units(self, bus: str) -> list[int]:
        """The units that have a page of their own open. A page of the whole line watches all alike."""
        opened = {number for browser in self._browsers for name, number in browser.units if name == bus}
        return sorted(opened)


def _unblocked(_bus: str, _unit: int) -> str:
    return ""


def _undrifted(_bus: str, _unit: int) -> int:
    return 0


def _unloaded(_bus: str) -> None:
    return None


def _unheld(_bus: str) -> str:
    return ""


def _unforgetting(_voice: Voice, _now: float) -> str:
    return ""


def _unwatched(_bus: str, _units: list[int], _trace: bool) -> None:
    return None


def _frame(frame: Frame) -> dict[str, Any]:
    return {
        "at": round(frame.at, 4),
        "direction": frame.direction,
        "hex": frame.data.hex(" ").upper(),
        "meaning": frame.meaning,
        "valid": frame.valid,
    }
