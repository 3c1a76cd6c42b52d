"""The present state of every bus and its units: the newest values, how fresh they are, draw and ramp times;
and what follows from readings: the mode of a unit, how it moves, and since when its conditions hold. Pure.

Times are Unix times in seconds on the app's own clock; the feed shifts a worker's times before they come
here. A value is not marked as overdue: `unit_link_now` computes it from the age, so that a worker that hangs
cannot keep anything looking fresh.

A unit itself reports only *at speed* (ST2 bit 7). A unit whose distance from its target shrinks is ramping;
one whose distance has not shrunk for a while is off speed. Without run, or with an emergency stop active, its
target is standstill, whatever is commanded.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from functools import lru_cache
from operator import itemgetter
from typing import Literal, NamedTuple

import structlog

from app.line.conditions.catalogue import STATUS
from app.line.conditions.condition import (
    NO_DRAW,
    BusValues,
    Draw,
    SectionSpeed,
    UnitValues,
    draw_between,
    percent_message,
    percent_of,
    reads_ratio,
)
from app.line.conditions.condition import follower as follower
from app.line.conditions.unit import DRAW_OUT_OF_BAND, RUNNING, SETTLED
from bus.catalogue.parameters import (
    ACCELERATION,
    ANALOG_IN_HIGH,
    ANALOG_IN_LOW,
    CONTROL_MODE,
    DECELERATION,
    DECIMALS,
    FOLLOWER_MODE,
    MAX_DISPLAY,
    SETPOINTS,
)
from bus.catalogue.values import RATIO_DECIMALS, StatusBits, plausible_parameter, status_bits
from bus.contract import (
    BusFigures,
    BusLink,
    ParameterValue,
    Reading,
    Snapshot,
    Staged,
    UnitLink,
    UnitLinkState,
    Update,
)
from bus.contract.actions import POLL_BYTES
from bus.instants import UnixTime
from bus.messages import Message
from bus.settings import BusSettings, Seam, UnitSettings, wire_seconds

KEYLOCK = 2
"""The value of #19 of a unit whose keypad is locked (manual, 4.0)."""
_TURNING = frozenset(("turning",))


def bits_of(bus: BusValues, reading: Reading) -> StatusBits:
    """Return the status bits of a reading in the dialect of its bus."""
    return status_bits(reading.outputs, reading.inputs, bus.settings.estop_healthy)


def is_driven(bits: StatusBits) -> bool:
    """Return whether the drive may move its motor: run input on and no emergency stop."""
    return bits.run and not bits.estop_active


def mode_of(unit: UnitValues, bits: StatusBits) -> str:
    """Return the mode: ``remote`` by ST2, else ``keylock`` or ``local`` by #19."""
    if bits.remote:
        return "remote"
    return "keylock" if unit.parameter_raw(CONTROL_MODE) == KEYLOCK else "local"


@lru_cache(maxsize=4096)
def status_conditions(bits: StatusBits) -> frozenset[str]:
    """Return the codes of the conditions that these bits show."""
    return frozenset(code for code, holds in STATUS.items() if holds(bits))


def conditions_of(bits: StatusBits, reading: Reading) -> frozenset[str]:
    """Return `status_conditions`, with ``turning`` while the actual speed of the reading is not 0."""
    found = status_conditions(bits)
    return found | _TURNING if reading.actual else found


MotionState = Literal[
    "", "at_speed", "at_zero", "ramping_up", "ramping_down", "off_speed", "stopped", "stopping", "turning"
]
"""``stopped``, ``stopping``, ``turning``: not driven; standing still, slowing down, or neither."""

PATIENCE_S = 3.0
"""The seconds, or three scans, in which a ramping unit must come nearer, or it counts as off speed."""
PATIENCE_SCANS = 3


@dataclass(slots=True)
class Motion:
    """The movement of one unit towards its commanded speed, or to a standstill."""

    state: MotionState = ""
    _goal: int | None = None
    _least_error: int = 0
    _nearer_at: UnixTime = UnixTime(0.0)

    def note(self, reading: Reading, bits: StatusBits, *, scan_s: float, ratio: bool = False) -> MotionState:
        """Return the state after this reading. ``ratio``: whether speeds are ratios to a master, which do not
        show whether the motor turns."""
        if reading.commanded is None or reading.actual is None:
            self.state, self._goal = "", None
            return self.state
        driven = is_driven(bits)
        goal = reading.commanded if driven else 0
        error = abs(goal - reading.actual)
        arrived = bits.at_speed if driven else error == 0
        if goal != self._goal or error < self._least_error or arrived:
            self._goal, self._least_error, self._nearer_at = goal, error, reading.at
        gave_up = reading.at - self._nearer_at > max(PATIENCE_S, PATIENCE_SCANS * scan_s)
        if driven or (reading.commanded == 0 and reading.actual == 0):
            self.state = _driven(reading.commanded, reading.actual, bits.at_speed, gave_up)
        else:
            self.state = "" if ratio else _not_driven(reading, gave_up)
        return self.state


def _driven(commanded: int, actual: int, at_speed: bool, gave_up: bool) -> MotionState:
    if commanded == 0 and actual == 0:
        return "at_zero"
    if at_speed:
        return "at_speed"
    if gave_up:
        return "off_speed"
    return "ramping_up" if commanded > actual else "ramping_down"


def _not_driven(reading: Reading, gave_up: bool) -> MotionState:
    if reading.actual == 0:
        return "stopped"
    return "turning" if gave_up else "stopping"


UNSEEN_S = 3600.0
"""A condition before and after a gap of at most this many seconds, such as a restart or a cable that is out,
is uninterrupted: nobody saw it end, and its alarm, which nobody saw clear, keeps its time."""
_NOTHING: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class Onset:
    """The beginning of a condition. Not ``exact``: first seen ``at`` that time, perhaps older."""

    at: UnixTime
    exact: bool = True


WordSpan = tuple[UnixTime, UnixTime, int]
"""A span in which the status bits of a unit were the same: begin, end, and the bits as ST2 * 256 + ST1."""


@dataclass(slots=True)
class Onsets:
    """The conditions of one unit that hold now, each with its beginning."""

    since: dict[str, Onset] = field(default_factory=dict)
    """The onset of each condition that holds, by its code."""
    _held: frozenset[str] = _NOTHING
    _seen_at: UnixTime = UnixTime(-math.inf)

    def note(self, at: UnixTime, holding: frozenset[str], change_seen_s: float) -> None:
        """Note which conditions hold by a reading. A change between two readings that are at most
        ``change_seen_s`` apart, the time after which a unit counts as offline, began with the later one; else
        its onset is not exact."""
        gap, self._seen_at = at - self._seen_at, at
        if holding == self._held and gap <= UNSEEN_S:
            return
        held = self._held if gap <= UNSEEN_S else _NOTHING
        begun = dict.fromkeys(holding - held, Onset(at, exact=gap <= change_seen_s))
        self.since = {name: onset for name, onset in self.since.items() if name in holding & held} | begun
        self._held = holding

    def correct(self, name: str, seen: Onset, found: Onset) -> bool:
        """Replace the onset ``seen`` by what was ``found`` elsewhere; return whether that is news."""
        if self.since.get(name) != seen or seen == found:
            return False
        self.since[name] = found
        return True


def later(*onsets: Onset | None) -> Onset | None:
    """Return when several conditions first held together; None if one of them does not hold."""
    known = [onset for onset in onsets if onset is not None]
    return max(known, key=lambda onset: onset.at) if len(known) == len(onsets) else None


def onset_in(
    spans: Sequence[WordSpan], holds: Callable[[int], bool], seen: Onset, change_seen_s: float
) -> tuple[Onset, bool]:
    """Return the onset of a condition that was first ``seen`` then, by the earlier status bits in order of
    time, and whether these reach back to where it began."""
    began = seen.at
    for at, until, word in reversed([span for span in spans if span[0] < seen.at]):
        gap = began - until
        if not holds(word):
            return Onset(began, exact=gap <= change_seen_s), True
        if gap > UNSEEN_S:
            return Onset(began, exact=False), True
        began = at
    return Onset(began, exact=False), False


log = structlog.get_logger()

SHOWN_WITH = (MAX_DISPLAY, DECIMALS, FOLLOWER_MODE, ANALOG_IN_LOW, ANALOG_IN_HIGH)
"""The parameters that are needed to show a reading."""
NO_WORKER = Message("worker_not_connected")
BusSubscriber = Callable[[Sequence[Update]], None]
"""Called with the updates of a bus after they were applied."""


class Audience(IntEnum):
    """The receivers of a report in their order: people who look come before features that compare and
    judge."""

    BROWSERS = 0
    STREAM = 1
    DRIFT = 2
    ALARMS = 3


@dataclass(slots=True)
class UnitLive:
    """The present state of one unit. ``link`` is what the worker reported; see `unit_link_now`."""

    settings: UnitSettings
    link: UnitLink
    reading: Reading | None = None
    parameters: dict[int, ParameterValue] = field(default_factory=dict)
    staged: int | None = None
    staged_unknown: bool = False
    """Whether it is unknown what the unit holds: it did not acknowledge 82h, or was away with a staged
    speed."""
    may_differ_since: UnixTime | None = None
    """The time when a parameter was found changed, or the unit came back online. A person who changed one at
    the keypad may have changed others, so earlier values count as old until they are read again."""
    motion: Motion = field(default_factory=Motion)
    onsets: Onsets = field(default_factory=Onsets)
    draw: Draw = NO_DRAW
    """The draw to the unit before it at the time of its reading."""
    last_response: UnixTime | None = None
    """The time of the unit's last response before this server started; None while not known."""

    @property
    def names(self) -> list[str]:
        """The names by which people search for the unit: its name, address, group and wiring."""
        settings = self.settings
        wired = (*settings.labels.input.values(), *settings.labels.output.values(), settings.labels.analog)
        return [settings.name, str(settings.id), settings.group, *wired]

    def parameter_raw(self, number: int) -> int | None:
        """Return the raw value of a parameter as last read; None if it was never read, is not available, or
        is outside of its printed range, as it scales and bounds nothing then."""
        known = self.parameters.get(number)
        return plausible_parameter(number, known.raw) if known is not None else None

    def is_current(self, number: int) -> bool:
        """Return whether a parameter was read since the unit was last away or changed at its keypad."""
        known, since = self.parameters.get(number), self.may_differ_since
        return known is not None and (since is None or known.at >= since)

    @property
    def scale_is_old(self) -> bool:
        """Whether the scale of the unit has not been read yet, or may have changed since then."""
        if DECIMALS not in self.parameters:
            return self.reading is not None
        return self.may_differ_since is not None and not all(
            self.is_current(number) for number in SHOWN_WITH if number in self.parameters
        )

    def note_parameter(self, value: ParameterValue) -> None:
        """Note a parameter that was read."""
        former = self.parameters.get(value.number)
        if former is not None and former.raw != value.raw and value.number not in SETPOINTS:
            self.may_differ_since = value.at
        self.parameters[value.number] = value


class Silence(NamedTuple):
    """A span in which no unit of a bus responded because its port was closed or its worker stood still: from
    the last reading before it to the first one after."""

    since: UnixTime
    until: UnixTime


@dataclass(slots=True)
class BusLive:
    """The present state of one bus: its port, its figures, its units in floor order. Only what the worker
    reports changes it, never a command."""

    settings: BusSettings
    link: BusLink
    link_onset: Onset
    """The beginning of the present ``link``."""
    worker_lost: Onset | None
    """The time when the last worker was lost; None while one is connected."""
    figures: BusFigures | None = None
    figures_before: BusFigures | None = None
    """The last figures of a worker that was lost."""
    units: dict[int, UnitLive] = field(default_factory=dict)
    read_at: UnixTime | None = None
    """The time of the newest reading of any unit."""
    silence: Silence | None = None
    """The last silence of the bus."""
    seams: dict[int, Seam] = field(init=False, compare=False)
    """The seam before each unit but the first, by its address."""
    _subscribers: list[tuple[Audience, BusSubscriber]] = field(default_factory=list, compare=False)

    def __post_init__(self) -> None:
        self.seams = self.settings.seams

    @property
    def worker_connected(self) -> bool:
        """Whether a worker of this bus is connected now."""
        return self.worker_lost is None

    @property
    def baud(self) -> int:
        """The baud rate that the worker reports, which #18 may have changed; before a report, the configured
        one."""
        return self.link.baud or self.settings.baud

    def subscribe(self, audience: Audience, subscriber: BusSubscriber) -> Callable[[], None]:
        """Call ``subscriber`` with the updates after each change, in the order of audiences. Return a
        function that ends the subscription."""
        entry = (audience, subscriber)
        self._subscribers.append(entry)
        self._subscribers.sort(key=itemgetter(0))
        return lambda: self._subscribers.remove(entry)

    def apply(self, updates: Sequence[Update]) -> None:
        """Apply a worker's updates in order, then call every subscriber, even if one fails. Updates of units
        that are not configured change nothing."""
        for update in updates:
            self._apply_one(update, self.units.get(getattr(update, "unit", 0)))
        for _, subscriber in tuple(self._subscribers):
            try:
                subscriber(updates)
            except Exception:
                log.exception("subscriber of the live state failed", bus=self.settings.name)

    def connect_worker(self, snapshot: Snapshot) -> list[Update]:
        """Apply the complete state of a worker that has connected; return it as updates."""
        if not self.worker_connected:
            self.worker_lost = None
            # The worker reports the state of its port, but not its beginning.
            self.link, self.link_onset = snapshot.bus, Onset(snapshot.bus.at, exact=False)
        updates = updates_of(snapshot)
        self.apply(updates)
        return updates

    def lose_worker(self, at: UnixTime, cause: Message = NO_WORKER) -> None:
        """Note that the worker's connection ended: the port counts as closed, no value as fresh."""
        self.worker_lost = Onset(at)
        self.figures, self.figures_before = None, self.figures or self.figures_before
        units = [unit for unit in self.units.values() if unit.link.link == "online"]
        stale = [UnitLink(unit=unit.settings.id, at=at, link="stale", cause=cause) for unit in units]
        self.apply([BusLink(at=at, link="closed", cause=cause), *stale])

    def _apply_one(self, update: Update, unit: UnitLive | None) -> None:
        match update:
            case Reading() if unit:
                self.note_reading(unit, update)
            case UnitLink() if unit:
                if update.link == "online" and unit.link.link == "offline":
                    unit.may_differ_since = update.at
                unit.link = update
            case ParameterValue() if unit:
                unit.note_parameter(update)
            case Staged() if unit:
                unit.staged, unit.staged_unknown = update.raw, update.unknown
            case BusFigures():
                self.figures = update
            case BusLink():
                self._note_link(update)

    def _note_link(self, link: BusLink) -> None:
        if link.link != self.link.link:
            self.link_onset = Onset(link.at)
        self.link = link

    def note_reading(self, unit: UnitLive, reading: Reading) -> None:
        """Note a reading, and derive motion, conditions and draw of the unit from it."""
        unit.reading = reading
        bits, scan_s = bits_of(self, reading), scan_s_of(self)
        if self.read_at is not None and reading.at - self.read_at > silence_after_s(scan_s):
            self.silence = Silence(self.read_at, reading.at)
        self.read_at = reading.at if self.read_at is None else max(self.read_at, reading.at)
        unit.motion.note(reading, bits, scan_s=scan_s, ratio=reads_ratio(self, unit))
        holding = conditions_of(bits, reading)
        unit.draw = draw_of(self, unit, reading.at)
        if DRAW_OUT_OF_BAND.holds(unit.draw) or _keeps_draw(unit, reading.at):
            holding |= {DRAW_OUT_OF_BAND.code}
        unit.onsets.note(reading.at, holding, offline_after_s(scan_s))


def _keeps_draw(unit: UnitLive, at: UnixTime) -> bool:
    """Return whether a draw out of its band stays so while it is not judged, as its alarm does: a section
    ramps, or the one before has not responded again after a gap."""
    onset = unit.onsets.since.get(DRAW_OUT_OF_BAND.code)
    lasted = onset is not None and at - onset.at >= DRAW_OUT_OF_BAND.tuning.on_delay_s
    return lasted and DRAW_OUT_OF_BAND.holds(unit.draw) is None


def changed_by(bus: BusLive, updates: Sequence[Update]) -> tuple[list[int], bool]:
    """Return the configured units that updates are about, and whether they are about the bus too."""
    if any(type(update) is BusLink for update in updates):
        return sorted(bus.units), True
    units = {unit for update in updates if (unit := getattr(update, "unit", None)) in bus.units}
    return sorted(units), any(type(update) is BusFigures for update in updates)


class LiveState:
    """The live state of the configured buses, by name."""

    def __init__(self, buses: Iterable[BusSettings], started_at: UnixTime) -> None:
        self.buses = {settings.name: bus_without_reports(settings, started_at) for settings in buses}


def bus_without_reports(settings: BusSettings, at: UnixTime) -> BusLive:
    """Return a bus that no worker has reported yet, as of ``at``."""
    units = {
        unit.id: UnitLive(settings=unit, link=UnitLink(unit=unit.id, at=at, link="unknown"))
        for unit in settings.unit
    }
    first_seen = Onset(at, exact=False)
    return BusLive(settings, BusLink(at, "closed", NO_WORKER), first_seen, first_seen, units=units)


def updates_of(snapshot: Snapshot) -> list[Update]:
    """Return the updates that lead to a complete state."""
    updates: list[Update] = [snapshot.bus]
    for state in snapshot.units:
        updates.append(state.link)
        if state.reading is not None:
            updates.append(state.reading)
        staged = Staged(state.unit, snapshot.sent_at, state.staged, state.staged_unknown)
        updates += [*state.parameters, staged]
    if snapshot.figures is not None:
        updates.append(snapshot.figures)
    return updates


OFFLINE_SCANS = 5


def stale_after_s(scan_s: float) -> float:
    """Return the age in seconds from which a response is overdue: two seconds, or two scans if longer."""
    return max(2.0, 2 * scan_s)


def offline_after_s(scan_s: float) -> float:
    """Return the seconds without a response after which a unit counts as lost."""
    return max(10.0, OFFLINE_SCANS * scan_s)


def silence_after_s(scan_s: float) -> float:
    """Return the seconds without a response of any unit after which the bus counts as silent. They are fewer
    than `offline_after_s` by more than a scan, so that a gap which loses a unit always counts as silence."""
    return offline_after_s(scan_s) / 2


def scan_s_of(bus: BusValues) -> float:
    """Return the seconds that one scan of all units takes: as the worker measured them, else as the wire and
    the configuration allow."""
    if bus.figures is not None and bus.figures.scan_s > 0:
        return bus.figures.scan_s
    return scan_s_at_best(bus.settings)


def scan_s_at_best(settings: BusSettings) -> float:
    """Return the wire time of one poll of every configured unit, in seconds, or the least that the
    configuration sets."""
    return max(wire_seconds(len(settings.unit) * POLL_BYTES, settings.baud), settings.least_scan_s)


WORKER_TIMEOUT_S = 2.0
"""The silence in seconds of a worker that hangs; it reports figures every second, beside readings."""


def unit_link_now(bus: BusLive, unit: UnitLive, now: UnixTime) -> UnitLinkState:
    """Return the link of a unit as the worker reported it, or worse by the age of its reading or a closed
    port."""
    if unit.reading is None:
        return "unknown"
    scan_s = scan_s_of(bus)
    if lost_at(bus, unit, now, offline_after_s(scan_s)) is not None:
        return "offline"
    age = now - unit.reading.at
    if unit.link.link != "online" or bus.link.link == "closed" or age > stale_after_s(scan_s):
        return "stale"
    return "online"


def lost_at(bus: BusLive, unit: UnitLive, now: UnixTime, patience_s: float) -> UnixTime | None:
    """Return when a unit had not responded for ``patience_s``; None if it is not lost.

    After a silence of the bus its units respond one after the other, so each gets its time again, except one
    that was lost before the silence.
    """
    if unit.reading is not None and unit.link.link == "offline":
        known_at = found_at = unit.link.at
    else:
        known_at = bus.link_onset.at if unit.reading is None else unit.reading.at
        found_at = known_at + patience_s
    if bus.silence is not None and known_at <= bus.silence.until and found_at > bus.silence.since:
        found_at = bus.silence.until + patience_s
    return found_at if now >= found_at else None


def worker_timed_out(bus: BusLive, now: UnixTime) -> bool:
    """Return whether a connected worker no longer sends: its process hangs, or its network is cut."""
    if not bus.worker_connected or bus.figures is None:
        return False
    since = now - WORKER_TIMEOUT_S
    return bus.figures.at < since and (bus.read_at is None or bus.read_at < since)


def figures_now(bus: BusLive, now: UnixTime) -> BusFigures | None:
    """Return the figures of a bus; None if they are out of date."""
    return None if bus.link.link == "closed" or worker_timed_out(bus, now) else bus.figures


class StagedUnits(NamedTuple):
    """The names of the units of a bus that hold a staged setpoint. ``unknown``: those that may hold one that
    nobody knows any more; of both, ``silent``: those without live values; ``local``: those not in REMOTE,
    which keep it."""

    bus: str
    known: list[str]
    unknown: list[str]
    silent: list[str]
    local: list[str]

    @property
    def key(self) -> str:
        """What the strip of staged setpoints shows of the bus: it is drawn again when this changes."""
        return "; ".join([self.bus, *map(", ".join, self[1:])])


def staged_units(buses: Iterable[BusLive], now: UnixTime) -> list[StagedUnits]:
    """Return what is staged on each bus that has anything staged."""
    found = []
    for bus in buses:
        held = [bus.units[number] for number in held_units(bus)]
        if held:
            unknown = [unit.settings.name for unit in held if unit.staged_unknown]
            known = [unit.settings.name for unit in held if not unit.staged_unknown]
            silent = [unit.settings.name for unit in held if unit_link_now(bus, unit, now) != "online"]
            local = [
                name
                for unit in held
                if (name := unit.settings.name) not in silent
                and unit.reading is not None
                and not bits_of(bus, unit.reading).remote
            ]
            found.append(StagedUnits(bus.settings.name, known, unknown, silent, local))
    return found


def held_units(bus: BusLive) -> list[int]:
    """Return the addresses of the units that hold, or may hold, a staged setpoint."""
    return [number for number, unit in bus.units.items() if unit.staged is not None or unit.staged_unknown]


def draw_of(bus: BusLive, unit: UnitLive, now: UnixTime) -> Draw:
    """Return the draw of a unit to the one before it; it counts while both run and neither ramps."""
    seam = bus.seams.get(unit.settings.id)
    if seam is None:
        return NO_DRAW
    before = bus.units[seam.before]
    judged = before.motion.state in SETTLED and unit.motion.state in SETTLED
    speeds = _actual_speed(bus, before, now), _actual_speed(bus, unit, now)
    return draw_between(*speeds, seam.band, judged=judged)


def draw_numbers(bus: BusLive, unit: UnitLive, draw: Draw) -> Message | None:
    """Return a draw with the section that it is to and its band; None where it is not known or has none."""
    seam = bus.seams.get(unit.settings.id)
    if seam is None or not seam.band or draw.tenths is None:
        return None
    low, high = map(percent_message, seam.band)
    shown, before = percent_message(percent_of(draw.tenths), "+"), bus.units[seam.before].settings.name
    return Message.of("draw_numbers", draw=shown, before=before, low=low, high=high)


def both_run(bus: BusLive, unit: UnitLive) -> bool:
    """Return whether a unit and the one before it run, which makes their draw worth showing."""
    seam = bus.seams.get(unit.settings.id)
    return seam is not None and {bus.units[seam.before].motion.state, unit.motion.state} <= RUNNING


def quantity_of(bus: BusLive, unit: UnitLive) -> str | None:
    """Return the measure of a unit's speeds, by its label; None if they are ratios."""
    return None if reads_ratio(bus, unit) else unit.settings.labels.unit


def _actual_speed(bus: BusLive, unit: UnitLive, now: UnixTime) -> SectionSpeed:
    reading = unit.reading if unit_link_now(bus, unit, now) == "online" else None
    raw = None if reading is None else reading.actual
    return SectionSpeed(raw, unit.parameter_raw(DECIMALS), quantity_of(bus, unit))


def ramp_parameter(old: int | None, new: int) -> int:
    """Return the parameter that sets the ramp between two raw speeds: #7 downwards, else #6."""
    return DECELERATION if old is not None and new < old else ACCELERATION


def ramp_seconds(unit: UnitLive, old: int | None, new: int) -> float | None:
    """Return the seconds in which a unit ramps from one raw speed to another, by #6 or #7, which are tenths
    of a second for the full span #2. None for a follower, which follows its master, and while a parameter is
    not known."""
    span, tenths = unit.parameter_raw(MAX_DISPLAY), unit.parameter_raw(ramp_parameter(old, new))
    if old is None or tenths is None or follower(unit):
        return None
    if tenths == 0:
        return 0.0
    return abs(new - old) / span * tenths / 10 if span else None


def speed_decimals(bus: BusLive, unit: UnitLive) -> int | None:
    """Return the decimals of commanded and actual speed; None while #3 was not read."""
    return RATIO_DECIMALS if reads_ratio(bus, unit) else unit.parameter_raw(DECIMALS)


def setpoint_decimals(unit: UnitLive) -> int | None:
    """Return the decimals of a setpoint, for a follower those of a ratio; None while #3 was not read."""
    return RATIO_DECIMALS if follower(unit) else unit.parameter_raw(DECIMALS)
