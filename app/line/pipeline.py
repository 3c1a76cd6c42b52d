"""Who learns of what the worker of a bus reports, in order: the live state, and with it browsers,
``/stream``, drift and alarms (:class:`app.line.live.bus_live.Audience`); then history, then events.

Each is called in the same turn of the event loop, and none holds up or stops the one before it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Protocol

from msgspec.structs import replace

from app.core.web.shape import iso
from app.line.live.bus_live import BusLive
from app.line.live.change_recorder import ChangeRecorder, Changes, LineEvent
from bus.catalogue.values import plausible_parameter
from bus.contract import BusLink, Hello, ParameterValue, Reading, Snapshot, UnitLink, Update
from bus.instants import UnixTime
from bus.messages import Message, number, term

KEPT = (Reading, ParameterValue, UnitLink, BusLink)
"""Updates for the history; momentary ones do not wait in its queue."""
IMPLAUSIBLE = Message("updates_implausible")
KNOWN = Message("updates_late_known")
OVER_QUOTA = Message("updates_over_quota")
"""Why updates of a worker are refused."""
OTHER_RELEASE = "worker_version_differs"
"""The code of the refusal of a worker whose link has another version."""


class HistoryIntake(Protocol):
    """What keeps readings: the history, never waiting."""

    def append(self, bus: str, updates: Sequence[Update]) -> None:
        """Take in what a worker reported."""


class Pipeline:
    """Of one bus. Everything here is called on the event loop, without waiting."""

    def __init__(self, live: BusLive, history: HistoryIntake, recorder: ChangeRecorder) -> None:
        self._live = live
        self._history = history
        self._recorder = recorder
        self._changes = Changes(live.settings)
        self.since = UnixTime(0.0)
        """From when on history believes the worker: what was before was stored then, or is missing."""

    def snapshot(self, snapshot: Snapshot) -> None:
        """A worker's complete state: it is live. History had its readings, or gets them as backlog; the
        parameters that scale them and the states of the links may be news to it."""
        updates = self._live.take_snapshot(snapshot)
        self._append([update for update in updates if not isinstance(update, Reading)])

    def batch(self, updates: Sequence[Update], *, live: bool, stored: Sequence[Update] | None = None) -> None:
        """Updates in order. Those kept while the app was away belong to history and events only. ``stored``:
        those that history takes, where that is not all."""
        if live:
            self._live.apply(updates)
        of_history = updates if stored is None else stored
        if kept := [update for update in of_history if isinstance(update, KEPT)]:
            self._append(kept)
        for update in updates:
            for change in self._changes.see(update):
                self._recorder.note(change)

    @property
    def units(self) -> Collection[int]:
        """The addresses of the units that are configured for this bus."""
        return self._live.units.keys()

    @property
    def port_is_open(self) -> bool:
        """As the worker last reported."""
        return self._live.link.link == "open"

    def worker_connected(self, hello: Hello, at: UnixTime, *, again: bool) -> None:
        """A worker sent its hello: ``again``: the one that this app knew, else one that was started."""
        what = Message.of("event_worker_back" if again else "event_worker_started", port=hello.port)
        self._recorder.note(LineEvent("worker", None, at, what, "", term("connected")))

    def worker_refused(self, at: UnixTime, holder: str, refused: str, reason: Message) -> None:
        """A worker's hello was refused. ``holder`` and ``refused``: the tokens and their addresses. A bus
        without a worker shows that its worker is of another release."""
        self._recorder.note(refusal_of_worker(at, holder, refused, reason))
        live = self._live
        if reason.code == OTHER_RELEASE and not live.worker_connected and live.link.cause != reason:
            live.apply([BusLink(at=at, link="closed", cause=reason)])

    def updates_refused(self, at: UnixTime, counts: Mapping[Message, int]) -> None:
        """So many updates of a worker were not taken in, for each reason; they are summed up."""
        what = Message("event_updates_refused")
        for reason, count in counts.items():
            if count:
                refused = LineEvent("worker", None, at, what, "", "", reason, reason.code, count)
                self._recorder.note(refused)

    def readings_came_late(self, at: UnixTime, count: int, since: UnixTime, until: UnixTime) -> None:
        """The worker has delivered readings of a span before; trends mark it."""
        what = Message.of("event_readings_late", count=count, since=iso(since), until=iso(until))
        self._recorder.note(LineEvent("worker", None, at, what, "", "", series=what.code))

    def worker_disconnected(self, at: UnixTime, cause: Message) -> None:
        self._live.lose_worker(at, cause)
        self._recorder.note(LineEvent("worker", None, at, cause, term("connected"), term("gone")))

    def clock_stepped(self, step_s: float, at: UnixTime) -> None:
        what = Message.of("event_worker_clock_stepped", step=number(f"{step_s:+.3f}"))
        self._recorder.note(LineEvent("clock", None, at, what, "", ""))

    def _append(self, updates: Sequence[Update]) -> None:
        believed = [each for update in updates if (each := self._believed(update)) is not None]
        self._history.append(self._live.settings.name, believed)

    def _believed(self, update: Update) -> Update | None:
        """What history takes of it. A state from before has its place there already. A parameter that was
        another then scales readings only from when that is known. What the manual rules out is no value."""
        match update:
            case Reading():
                return None if update.implausible else update
            case UnitLink() | BusLink():
                return update if update.at >= self.since else None
            case ParameterValue() if plausible_parameter(update.number, update.raw) != update.raw:
                return None
            case ParameterValue():
                return replace(update, at=max(update.at, self.since))
        return update


def refusal_of_worker(at: UnixTime, holder: str, refused: str, reason: Message) -> LineEvent:
    """The event of a worker whose hello was refused."""
    what = Message("event_worker_refused")
    return LineEvent("worker", None, at, what, holder, refused, reason, series=what.code)
