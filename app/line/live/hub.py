"""The hub, which sends changes to every open page in the turn of the event loop in which they are reported,
and the WebSocket ``/live`` of a page.

A change is rendered once for each language in use, and all pages of a language get the same bytes in the same
turn. New measurements of steady units and of many units that move, and in a flood of changes or with very
many pages every change, are held back for a moment and go together. Age, which no worker reports, is checked
once a second; the same tick is the heartbeat that every page draws.

A page may request a snapshot over its socket, but never a command: a command that was clicked while a socket
was down must never be sent later.
"""

from __future__ import annotations

import asyncio
import math
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Annotated, Literal

import msgspec
import structlog
from fastapi import APIRouter, WebSocket
from starlette.requests import Request
from starlette.websockets import WebSocketDisconnect

from app.core.server.addresses import source_of
from app.core.web.access import Person, Role, Viewer
from app.core.web.problems import refuse_socket
from app.core.web.routes import GuardedRoute
from app.core.web.services import service_of
from app.core.web.templating import WEBSOCKET_LINES, Templates, templates_of
from app.errors import Problem
from app.line.live.browser import Browser, Diff, LinesUpdate
from app.line.live.bus_live import Audience, LiveState, changed_by
from app.line.live.fields import (
    Groups,
    Translator,
    frame_fields,
    health_fields,
    merge_groups,
    progress_text,
    unit_key,
)
from app.line.live.requests import Admission, key_of
from app.line.live.screen import ALARM_GROUP, LINE_GROUP, Screen, holders
from app.line.live.sources import LineFields, Sources
from bus.contract import BusFigures, Frame, Frames, Progress, Update
from bus.instants import Clock, Monotonic, MonotonicClock, monotonic_now
from bus.messages import Message
from bus.pacing import Bucket

FLOOD = 60
WINDOW_S = 0.25
"""A flood is more than `FLOOD` changed units in `WINDOW_S` seconds, which takes more than six busy wires. In
a flood updates are sent once per window, because pages could not draw them all. So are new measurements that
may wait, because drawing each by itself takes a browser three times the CPU."""

FEW_PAGES = 40
MAX_SENDS_S = 2000
"""The most messages a second to all pages together, if they are more than `FEW_PAGES`: 200 pages get ten
updates a second each, 40 and fewer one for each response of a unit."""


@dataclass(slots=True)
class Flow:
    """The rate at which open pages are updated: on every response, unless the change may wait, in a flood or
    with very many pages."""

    clock: MonotonicClock = monotonic_now
    _gap_s: float = 0.0
    _began: Monotonic = Monotonic(0.0)
    _count: int = 0
    _flooded: bool = False
    _sent_at: Monotonic = Monotonic(-math.inf)

    def share(self, pages: int) -> None:
        """Set the number of open pages."""
        self._gap_s = pages / MAX_SENDS_S if pages > FEW_PAGES else 0.0

    def came(self, units: int = 1) -> None:
        """Note the number of units that have changed."""
        now = self.clock()
        if now - self._began >= WINDOW_S:
            self._flooded = self._count > FLOOD and now - self._began < 2 * WINDOW_S
            self._began, self._count = now, 0
        self._count += units

    def pause_s(self, *, may_wait: bool = False) -> float:
        """Return the seconds to wait before pages are sent the next update: 0 unless the change may wait,
        changes come in a flood, or very many pages are open."""
        is_flooded = self._flooded or self._count > FLOOD
        gap_s = max(self._gap_s, WINDOW_S if may_wait or is_flooded else 0.0)
        return max(0.0, self._sent_at + gap_s - self.clock())

    def sent(self) -> None:
        self._sent_at = self.clock()


ShownUnits = frozenset[tuple[str, int]]
"""Units, each as bus and address."""


class Watched:
    """The units and traces that the open pages show. They are counted as pages come, go and turn, so a page
    costs by what it shows, not by the number of pages. ``units``: the configured ones, by bus."""

    def __init__(self, units: Mapping[str, Collection[int]]) -> None:
        self._by_key = {unit_key(bus, unit): (bus, unit) for bus, of_bus in units.items() for unit in of_bus}
        self._units: dict[str, Counter[int]] = {bus: Counter() for bus in units}
        self._traces: Counter[str] = Counter()

    def known(self, keys: Iterable[str]) -> ShownUnits:
        """Return the units of these keys that exist."""
        return frozenset(self._by_key[key] for key in keys if key in self._by_key)

    def turn(self, before: ShownUnits, after: ShownUnits, trace_before: str, trace_after: str) -> None:
        """Note that a page shows other units and follows another trace; all of them exist."""
        for bus, unit in after - before:
            self._units[bus][unit] += 1
        for bus, unit in before - after:
            self._units[bus][unit] -= 1
        self._traces[trace_before] -= 1
        self._traces[trace_after] += 1

    def units(self, bus: str) -> list[int]:
        """Return the units of a bus that some page shows."""
        return sorted(unit for unit, pages in self._units[bus].items() if pages)

    def is_traced(self, bus: str) -> bool:
        """Return whether some page follows the frames of this bus."""
        return self._traces[bus] > 0


@dataclass(eq=False, slots=True)
class Broadcast:
    """The open pages of one language, and the fields sent to them. ``clock`` returns Unix time in seconds;
    ``page_digest`` identifies what a page is rendered with now.

    ``number`` is that of the last message. A page that opens while changes are held back gets a snapshot of
    that number with newer content: the next message repeats some fields.
    """

    screen: Screen
    clock: Clock
    page_digest: str = ""
    flow: Flow = field(default_factory=Flow)
    browsers: deque[Browser] = field(default_factory=deque)
    """The open pages. They take turns in being first, because writing to all takes a while."""
    number: int = 0
    _held: Groups = field(default_factory=dict)
    _due: asyncio.TimerHandle | None = None

    def join(self, browser: Browser) -> None:
        """Add a browser, and send it a snapshot."""
        self.browsers.append(browser)
        self.send_snapshot(browser)

    def leave(self, browser: Browser) -> None:
        """Remove a browser; drop held changes if no page is left."""
        self.browsers.remove(browser)
        if not self.browsers:
            self._held = {}
            if self._due is not None:
                self._due.cancel()
                self._due = None

    def send_snapshot(self, browser: Browser) -> None:
        """Send everything to a page that opened or missed a number."""
        browser.send(
            {
                "is": "snapshot",
                "digest": self.page_digest,
                "n": self.number,
                "t": round(self.clock(), 3),
                "f": self.screen.shown,
            }
        )

    def publish(self, groups: Groups, *, always: bool = False) -> None:
        """Send changed fields, at once or with the next message. ``always``: even if nothing changed."""
        if not self.browsers or not (groups or always):
            return
        self.flow.came(len(groups) or 1)
        merge_groups(self._held, groups)
        pause_s = self.flow.pause_s(may_wait=self.screen.may_wait(groups))
        loop = asyncio.get_running_loop()
        due = loop.time() + pause_s
        if self._due is not None:
            if self._due.when() <= due:
                return
            self._due.cancel()
        if pause_s:
            self._due = loop.call_at(due, self._release)
        else:
            self._release()

    def _release(self) -> None:
        groups, self._held, self._due = self._held, {}, None
        self.flow.sent()
        diff = Diff(self.number, self.number + 1, self.clock(), groups)
        self.number = diff.after
        self.browsers.rotate()
        for browser in self.browsers:
            browser.send_diff(diff)


log = structlog.get_logger()

HEARTBEAT_S = 1.0
ALARM_PAUSE_S = 0.05
"""The seconds from an alarm to the pages, which bound the cost of a flood of alarms."""
WATCH_UPDATES_A_SECOND = 5.0
MAX_WATCH_BURST = 50
"""The rate at which a worker is told which of its units are watched."""
Watcher = Callable[[list[int], bool], None]
"""Called with the units of a bus that someone has open, and whether someone follows its trace."""


class Hub:
    """The open pages of all languages. ``clock`` returns Unix time in seconds."""

    def __init__(
        self,
        live: LiveState,
        sources: Sources,
        templates: Templates,
        clock: Clock,
    ) -> None:
        self.live = live
        self._sources = sources
        self._templates = templates
        self.watchers: dict[str, Watcher] = {}
        """The function of each bus that is told which of its units the open pages show."""
        self._lines: LineFields | None = None
        self._clock = clock
        self._monotonic = monotonic_now
        self._broadcasts: dict[str, Broadcast] = {}
        """The broadcast of every language requested so far; most have no page now."""
        self._watched: dict[str, tuple[list[int], bool]] = {}
        self.admission = Admission()
        self._scans: dict[str, Progress] = {}
        """The first report of the newest scan of each bus."""
        self._pages = Watched({name: bus.units for name, bus in live.buses.items()})
        self._watch_limit = Bucket(WATCH_UPDATES_A_SECOND, MAX_WATCH_BURST)
        self._watched_is_due = False
        self._alarms_due: asyncio.TimerHandle | None = None
        self._has_warned_of_proxy = False
        self._alarmed_units: set[tuple[str, int]] = set()
        for name, bus in live.buses.items():
            bus.subscribe(Audience.BROWSERS, partial(self._on_updates, name))

    def warn_of_proxy(self) -> None:
        """Log once that a proxy before the server does not pass WebSockets."""
        if not self._has_warned_of_proxy:
            self._has_warned_of_proxy = True
            log.warning("the proxy does not pass WebSockets", add=WEBSOCKET_LINES)

    @property
    def connected(self) -> int:
        """The number of open pages."""
        return sum(len(broadcast.browsers) for broadcast in self._broadcasts.values())

    def people(self) -> dict[str, str]:
        """Return the role of each user with an open page, keyed by user name."""
        roles = {browser.name: browser.role for browser in self._browsers()}
        return {name: roles[name] for name in sorted(roles)}

    def screen(self, language: str) -> Screen:
        """Return the up-to-date screen of a language."""
        broadcast = self._broadcasts.get(language)
        if broadcast is None:
            broadcast = self._broadcasts[language] = Broadcast(
                self._new_screen(language), self._clock, self._templates.page_digest
            )
        screen = broadcast.screen
        if not broadcast.browsers:
            # A screen with an open page is up to date. Rendering a long line takes milliseconds of the event
            # loop, and some hundred pages may open at once.
            now = self._clock()
            screen.refresh(now)
            screen.put(LINE_GROUP, {"memory": self._sources.notice(screen.translator, now)})
            self._control(screen)
            screen.put(ALARM_GROUP, self._sources.banner(screen.translator))
        return screen

    def _new_screen(self, language: str) -> Screen:
        translator = Translator(
            self._templates.languages[language].on_screen, self._templates.formats(language)
        )
        return Screen(self.live, translator, self._sources)

    def join(self, browser: Browser) -> None:
        """Add a page that opened: it gets a complete snapshot first, then diffs."""
        self.screen(browser.language)
        self._broadcasts[browser.language].join(browser)
        self._has_changed()

    def leave(self, browser: Browser) -> None:
        self._broadcasts[browser.language].leave(browser)
        self._pages.turn(browser.units, frozenset(), browser.trace, "")
        self._has_changed()

    def _has_changed(self) -> None:
        for broadcast in self._broadcasts.values():
            broadcast.flow.share(self.connected)
        self._notify_watchers()
        self._publish_people()

    def send_snapshot(self, browser: Browser) -> None:
        """Send everything to a page that opened or missed a number."""
        self._broadcasts[browser.language].send_snapshot(browser)

    def follow(self, browser: Browser, keys: Iterable[str], trace: str, *, lines: bool = False) -> None:
        """Note the units that a page shows, by their keys, the bus whose trace it follows, and whether it
        shows all lines."""
        if lines and not browser.lines and self._lines is not None:
            translator = self._broadcasts[browser.language].screen.translator
            browser.show_lines(LinesUpdate(self._lines.shown(translator)))
        browser.lines = lines
        units, trace = self._pages.known(keys), trace if trace in self.live.buses else ""
        if (units, trace) == (browser.units, browser.trace):
            return
        self._pages.turn(browser.units, units, browser.trace, trace)
        browser.units, browser.trace = units, trace
        self._notify_watchers()

    def refresh_unit(self, bus: str, unit: int) -> None:
        """Show a change of a unit that no worker reports, for example a block."""
        self._render(bus, [unit], include_bus=False)

    def show_alarm(self, bus: str | None, unit: int | None) -> None:
        """Show that an alarm has changed; alarms that change together, or in a flood, go together."""
        if bus is not None and unit is not None:
            self._alarmed_units.add((bus, unit))
        if self._alarms_due is None:
            self._alarms_due = asyncio.get_running_loop().call_later(ALARM_PAUSE_S, self._show_alarms)

    def _show_alarms(self) -> None:
        self._alarms_due = None
        units, self._alarmed_units = self._alarmed_units, set()
        now = self._clock()
        for broadcast in self._with_pages():
            screen = broadcast.screen
            groups = screen.put(ALARM_GROUP, self._sources.banner(screen.translator))
            for bus, unit in units:
                merge_groups(groups, screen.render(bus, [unit], now, include_bus=False))
            broadcast.publish(merge_groups(groups, screen.show_line(now)))

    def show_control(self) -> None:
        """Show who controls each bus now."""
        for broadcast in self._with_pages():
            broadcast.publish(self._control(broadcast.screen))

    def _control(self, screen: Screen) -> Groups:
        """Put who controls each bus, until when, and who requests it. ``control`` changes whenever the head
        of a page does."""
        controls = [self._sources.guards[bus].bus_control() for bus in self.live.buses]
        held_by = {each.bus: each.holder for each in controls}
        keys = "\n\n".join(each.key for each in controls)
        groups = screen.put(LINE_GROUP, {"holder": holders(held_by, screen.translator), "control": keys})
        for each in controls:
            lapses_at = f"{each.lapses_at:.0f}" if each.holder else ""
            groups |= screen.put(each.bus, {"held_by": each.holder, "control_until": lapses_at})
        return groups

    async def beat(self) -> None:
        """Send the heartbeat of every page, indefinitely."""
        while True:
            await asyncio.sleep(HEARTBEAT_S)
            self.tick()

    def tick(self) -> None:
        """Send one heartbeat: the time of the server, and values that have aged."""
        now = self._clock()
        if self._watched_is_due:
            self._notify_watchers()
        if self._with_pages():
            # The counts of alarms and the verdict learn in the same moment that nobody reads a unit any more.
            self._sources.observe_age()
        for broadcast in self._with_pages():
            screen = broadcast.screen
            faults = screen.put(LINE_GROUP, {"memory": self._sources.notice(screen.translator, now)})
            groups = merge_groups(screen.render_aged(now), faults, self._control(screen))
            broadcast.publish(groups, always=True)
            self._show_lines(broadcast)

    def show_lines(self, lines: LineFields) -> None:
        """Show these lines from now on, on the pages that follow all lines."""
        self._lines = lines

    def _show_lines(self, broadcast: Broadcast) -> None:
        if self._lines is None:
            return
        followers = [browser for browser in broadcast.browsers if browser.lines]
        translator = broadcast.screen.translator
        if not followers:
            self._lines.forget(translator.language.tag)
        elif changed := self._lines.changes(translator):
            update = LinesUpdate(changed)
            for browser in followers:
                browser.show_lines(update)

    # --- what the workers report -------------------------------------------------------------------

    def _on_updates(self, bus_name: str, updates: Sequence[Update]) -> None:
        if not self._with_pages():
            return
        units, is_bus = changed_by(self.live.buses[bus_name], updates)
        self._render(bus_name, units, include_bus=is_bus)
        for update in updates:
            self._pass_on(bus_name, update)

    def _render(self, bus: str, units: list[int], *, include_bus: bool) -> None:
        now = self._clock()
        for broadcast in self._with_pages():
            broadcast.publish(broadcast.screen.render(bus, units, now, include_bus=include_bus))

    def _pass_on(self, bus: str, update: Update) -> None:
        """Show data that is not part of the live state."""
        match update:
            case Progress():
                self._show_progress(bus, update)
            case Frames():
                self._show_frames(bus, update.frames)
            case BusFigures():
                self._show_health(bus, update)

    def _show_progress(self, bus: str, progress: Progress) -> None:
        """Show the progress of a command or scan. Only the page of its review knows a command's id; the
        progress of a scan goes to every page of its bus."""
        group, field, first = f"command/{key_of(progress.id)}", "stage", progress
        if progress.stage == "searching":
            group, field, first = bus, "searched", self._scans.get(bus, progress)
            if first.id != progress.id:
                first = progress
            self._scans[bus] = first
        for broadcast in self._with_pages():
            broadcast.publish({group: {field: progress_text(progress, first, broadcast.screen.translator)}})

    def _show_health(self, bus: str, figures: BusFigures) -> None:
        watched = self._pages.units(bus)
        for broadcast in self._with_pages():
            screen, groups = broadcast.screen, Groups()
            for unit in figures.units:
                if unit.unit in watched:
                    groups |= screen.put(
                        f"health/{unit_key(bus, unit.unit)}", health_fields(unit, screen.translator)
                    )
            broadcast.publish(groups)

    def _show_frames(self, bus: str, frames: Sequence[Frame]) -> None:
        for broadcast in self._with_pages():
            followers = [browser for browser in broadcast.browsers if browser.trace == bus]
            if followers:
                shown = [frame_fields(frame, broadcast.screen.translator) for frame in frames]
                for browser in followers:
                    browser.show_frames(shown)

    # --- to the browsers ----------------------------------------------------------------------------

    def _with_pages(self) -> list[Broadcast]:
        """Return the languages with an open page."""
        return [broadcast for broadcast in self._broadcasts.values() if broadcast.browsers]

    def _browsers(self) -> list[Browser]:
        return [browser for broadcast in self._broadcasts.values() for browser in broadcast.browsers]

    def _publish_people(self) -> None:
        people = self.people()
        for broadcast in self._with_pages():
            screen = broadcast.screen
            here = [[name, screen.translator.t(role)] for name, role in people.items()]
            broadcast.publish(screen.put("people", {"here": here, "count": str(len(people))}))

    def _notify_watchers(self) -> None:
        """Tell the workers which units are watched, at once, but not as often as pages can turn; the next
        tick sends what was held back."""
        self._watched_is_due = not self._watch_limit.take(self._monotonic())
        if self._watched_is_due:
            return
        for bus, live in self.live.buses.items():
            units = self._pages.units(bus) or (sorted(live.units) if self.connected else [])
            watched = (units, self._pages.is_traced(bus))
            if self._watched.get(bus, ([], False)) != watched:
                self._watched[bus] = watched
                self.watchers[bus](*watched)


router = APIRouter(route_class=GuardedRoute)

IDLE_TIMEOUT_S = 30.0
"""A page that sends nothing for this long is gone; it sends every ten seconds."""


MESSAGES_A_SECOND, MAX_MESSAGES_AT_ONCE = 2.0, 10
SNAPSHOTS_A_SECOND, MAX_SNAPSHOTS_AT_ONCE = 0.5, 3
"""Limits of a page. The complete state of a large line is a quarter of a megabyte."""


class PageMessage(msgspec.Struct, forbid_unknown_fields=True):
    """The message of a page. ``units``: the units it shows, as ``bus/unit``; ``trace``: a bus to follow, for
    an engineer, as the frames show every value that passed; ``lines``: whether it shows all lines."""

    want: Literal["", "snapshot"] = ""
    units: Annotated[list[Annotated[str, msgspec.Meta(max_length=48)]], msgspec.Meta(max_length=512)] = []
    trace: Annotated[str, msgspec.Meta(max_length=40)] = ""
    lines: bool = False


_decoder = msgspec.json.Decoder(PageMessage)


@router.websocket("/live")
async def live(websocket: WebSocket, person: Viewer, language: str = "") -> None:
    """Serve one page from its opening to its end. ``language``: that of the page, so that both agree."""
    hub, address = service_of(websocket, Hub), source_of(websocket.client.host if websocket.client else "")
    if not hub.admission.enter(person.account, address):
        problem = Problem(429, "too_many", Message("too_many_pages"))
        await refuse_socket(websocket, problem.with_headers(Retry_After="10"))
        return
    try:
        await _serve(websocket, person, language, hub)
    finally:
        hub.admission.leave(person.account, address)


@router.get("/live", include_in_schema=False)
async def no_socket(request: Request, person: Viewer, failed: bool = False) -> None:
    """Respond to a request that is no WebSocket handshake: a proxy has left out the upgrade, or a page
    without a socket asks whether the server responds at all. ``failed``: it does, and no socket opens.

    Raise Problem 426, and 429 if sockets are refused for another reason.
    """
    hub, address = service_of(request, Hub), source_of(request.client.host if request.client else "")
    if not hub.admission.enter(person.account, address):
        raise Problem(429, "too_many", Message("too_many_pages")).with_headers(Retry_After="10")
    hub.admission.leave(person.account, address)
    if failed or "sec-websocket-version" in request.headers:
        hub.warn_of_proxy()
    problem = Problem(426, "upgrade_required", Message.of("websockets_not_passed", line=WEBSOCKET_LINES))
    raise problem.with_headers(Upgrade="websocket")


async def _serve(websocket: WebSocket, person: Person, language: str, hub: Hub) -> None:
    await websocket.accept()
    templates = templates_of(websocket)
    if language not in templates.languages:
        language = templates.language_of(websocket).tag
    browser = Browser(person.account, person.role.value, language)
    hub.join(browser)
    writing = asyncio.create_task(_write(websocket, browser))
    try:
        await _listen(websocket, browser, hub)
    except (WebSocketDisconnect, msgspec.DecodeError, TimeoutError, KeyError, RuntimeError):
        with suppress(WebSocketDisconnect, RuntimeError):
            await websocket.close()
    finally:
        hub.leave(browser)
        writing.cancel()


async def _write(websocket: WebSocket, browser: Browser) -> None:
    with suppress(WebSocketDisconnect, RuntimeError):
        while True:
            await _send(websocket, await browser.next())


async def _send(websocket: WebSocket, texts: list[str]) -> None:
    """Send texts without keeping them while the page waits for its next: a snapshot is up to 250 KiB."""
    for text in texts:
        await websocket.send_text(text)


async def _listen(websocket: WebSocket, browser: Browser, hub: Hub) -> None:
    """Read the messages of a page, more slowly if it sends more than its share."""
    messages = Bucket(MESSAGES_A_SECOND, MAX_MESSAGES_AT_ONCE)
    snapshots = Bucket(SNAPSHOTS_A_SECOND, MAX_SNAPSHOTS_AT_ONCE)
    while True:
        async with asyncio.timeout(IDLE_TIMEOUT_S):
            text = await websocket.receive_text()
        if not messages.take(monotonic_now()):
            await asyncio.sleep(1 / MESSAGES_A_SECOND)
        wants_snapshot = _follow(hub, browser, text)
        del text  # up to 32 KiB of each open page, until its next message
        if wants_snapshot:
            if not snapshots.take(monotonic_now()):
                await asyncio.sleep(1 / SNAPSHOTS_A_SECOND)
            hub.send_snapshot(browser)


def _follow(hub: Hub, browser: Browser, text: str) -> bool:
    """Apply a message of a page; return whether it wants a snapshot too. Raise msgspec.DecodeError."""
    message = _decoder.decode(text)
    may_trace = Role(browser.role).includes(Role.ENGINEER)
    hub.follow(browser, message.units, message.trace if may_trace else "", lines=message.lines)
    return message.want == "snapshot"
