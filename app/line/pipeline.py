"""The pipeline of a worker's reports, in order: to the live state, and with it browsers, ``/stream``, drift
and alarms (:class:`app.line.live.bus_live.Audience`); then to history, then to events.

All are called in the same turn of the event loop, and none delays or stops the one before it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from msgspec.structs import replace

from app.core.web.shape import iso
from app.line.history.service import History
from app.line.live.bus_live import BusLive
from app.line.live.change_recorder import ChangeDetector, ChangeRecorder, LineEvent
from bus.catalogue.values import plausible_parameter
from bus.contract import BusLink, Hello, ParameterValue, Reading, Snapshot, UnitLink, Update
from bus.instants import UnixTime
from bus.messages import Message, number, term

KEPT = (Reading, ParameterValue, UnitLink, BusLink)
"""Updates that history keeps; momentary ones do not wait in its queue."""
IMPLAUSIBLE = Message("updates_implausible")
KNOWN = Message("updates_late_known")
STARTING_S = 15.0
OVER_QUOTA = Message("updates_over_quota")
"""Reasons to refuse updates of a worker."""
OTHER_RELEASE = "worker_version_differs"
"""The code of a refusal because the worker is of another release."""


class Pipeline:
    """The pipeline of one bus. Everything in it is called on the event loop, without waiting."""

    def __init__(self, live: BusLive, history: History, recorder: ChangeRecorder) -> None:
        self._live = live
        self._history = history
        self._recorder = recorder
        self._changes = ChangeDetector(live.settings)
        self.since = UnixTime(0.0)
        """The time from which on history believes the worker: older reports are stored, or missing for
        good."""

    def snapshot(self, snapshot: Snapshot) -> None:
        """Pass on the complete state of a worker. History has its readings, or gets them as backlog;
        parameters and the states of links may be new to it."""
        updates = self._live.connect_worker(snapshot)
        self._append([update for update in updates if not isinstance(update, Reading)])

    def batch(self, updates: Sequence[Update], *, live: bool, stored: Sequence[Update] | None = None) -> None:
        """Pass on updates in order. Updates kept while the app was away (``live`` False) go to history and
        events only. ``stored``: those for history, if not all."""
        if live:
            self._live.apply(updates)
        of_history = updates if stored is None else stored
        if kept := [update for update in of_history if isinstance(update, KEPT)]:
            self._append(kept)
        for update in updates:
            for change in self._changes.detect(update):
                self._recorder.note(change)

    @property
    def units(self) -> Collection[int]:
        """The addresses of the units that are configured for this bus."""
        return self._live.units.keys()

    @property
    def port_is_open(self) -> bool:
        """Whether the port is open, as the worker last reported."""
        return self._live.link.link == "open"

    def worker_connected(self, hello: Hello, at: UnixTime, *, again: bool) -> None:
        """Record that a worker connected; ``again``: the one that this app knew, else one newly started."""
        what = Message.of("event_worker_back" if again else "event_worker_started", port=hello.port)
        self._recorder.note(LineEvent("worker", None, at, what, "", term("connected")))

    def worker_refused(self, at: UnixTime, holder: str, refused: str, reason: Message) -> None:
        """Record that a worker was refused. ``holder`` and ``refused``: the tokens and their addresses. A bus
        without a worker shows that its worker is of another release."""
        self._recorder.note(refusal_of_worker(at, holder, refused, reason))
        live = self._live
        if reason.code == OTHER_RELEASE and not live.worker_connected and live.link.cause != reason:
            live.apply([BusLink(at=at, link="closed", cause=reason)])

    def updates_refused(self, at: UnixTime, counts: Mapping[Message, int]) -> None:
        """Record the number of updates of a worker that were refused for each reason; events of a reason are
        summed up."""
        what = Message("event_updates_refused")
        for reason, count in counts.items():
            refused = LineEvent("worker", None, at, what, "", "", reason, reason.code, count)
            self._recorder.note(refused)

    def readings_came_late(self, at: UnixTime, count: int, since: UnixTime, until: UnixTime) -> None:
        """Record that the worker delivered readings of an earlier span; trends mark it. Those that waited no
        longer than a server takes to start are no event."""
        if at - since < STARTING_S:
            return
        what = Message.of("event_readings_late", n=count, count=count, since=iso(since), until=iso(until))
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
        """Return what history keeps of an update; None for nothing. A link state from before `since` has its
        place there already; a parameter scales readings only from `since` on, and only if the manual allows
        its value."""
        match update:
            case UnitLink() | BusLink():
                return update if update.at >= self.since else None
            case ParameterValue() if plausible_parameter(update.number, update.raw) != update.raw:
                return None
            case ParameterValue():
                return replace(update, at=max(update.at, self.since))
        return update


def refusal_of_worker(at: UnixTime, holder: str, refused: str, reason: Message) -> LineEvent:
    """Return the event of a worker that was refused."""
    what = Message("event_worker_refused")
    return LineEvent("worker", None, at, what, holder, refused, reason, series=what.code)
