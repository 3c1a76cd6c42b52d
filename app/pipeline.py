"""Where what the worker of a bus reports goes, in order: live state, history, events.

The live state comes first, and with it the browsers; history and events never hold it up.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Protocol

from app.history.service import History
from app.live.change_recorder import ChangeRecorder
from app.live.changes import Changes, LineEvent
from app.live.state.bus_live import BusLive
from bus.contract import BusLink, Hello, ParameterValue, Reading, Snapshot, UnitLink, Update
from bus.instants import UnixTime
from bus.messages import Message, number, term

KEPT = (Reading, ParameterValue, UnitLink, BusLink)
"""Updates for the history; momentary ones do not wait in its queue."""
IMPLAUSIBLE = Message("updates_implausible")


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

    def snapshot(self, snapshot: Snapshot) -> None:
        """A worker's complete state: it is live. History had its readings, or gets them as backlog; the
        parameters that scale them and the states of the links may be news to it."""
        updates = self._live.take_snapshot(snapshot)
        self._append([update for update in updates if not isinstance(update, Reading)])

    def batch(self, updates: Sequence[Update], *, live: bool) -> None:
        """Updates in order. Those kept while the app was away belong to history and events only."""
        if live:
            self._live.apply(updates)
        if kept := [update for update in updates if isinstance(update, KEPT)]:
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
        """A worker's hello was refused. ``holder`` and ``refused``: the tokens and their addresses."""
        self._recorder.note(refusal_of_worker(at, holder, refused, reason))

    def updates_refused(self, at: UnixTime, count: int) -> None:
        """Updates of a worker were not taken in: their time cannot be, or their unit is not configured."""
        what = Message("event_updates_refused")
        refused = LineEvent("worker", None, at, what, "", str(count), IMPLAUSIBLE, series=what.code)
        self._recorder.note(refused)

    def worker_disconnected(self, at: UnixTime, cause: Message) -> None:
        self._live.lose_worker(at, cause)
        self._recorder.note(LineEvent("worker", None, at, cause, term("connected"), term("gone")))

    def clock_stepped(self, step_s: float, at: UnixTime) -> None:
        self._recorder.note(_clock_step("event_worker_clock_stepped", step_s, at))

    def _append(self, updates: Sequence[Update]) -> None:
        self._history.append(self._live.settings.name, updates)


def record_history_faults(history: History, recorder: ChangeRecorder) -> None:
    """From now on record when the app's own clock was stepped, and what of the history cannot be read."""
    history.on_clock_step(
        lambda step_s, at: recorder.note(_clock_step("event_app_clock_stepped", step_s, at))
    )
    history.on_damage(lambda what, at: recorder.note(LineEvent("server", None, at, what, "", "")))


def refusal_of_worker(at: UnixTime, holder: str, refused: str, reason: Message) -> LineEvent:
    """The event of a worker whose hello was refused."""
    what = Message("event_worker_refused")
    return LineEvent("worker", None, at, what, holder, refused, reason, series=what.code)


def _clock_step(code: str, step_s: float, at: UnixTime) -> LineEvent:
    return LineEvent("clock", None, at, Message.of(code, step=number(f"{step_s:+.3f}")), "", "")
