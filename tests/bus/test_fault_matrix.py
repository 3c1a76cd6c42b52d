"""Truth of reports: every reading was sent by a unit and every result is so, under all faults of the line.

Each fault alone, then all together, over dozens of writes, in ``make soak`` over hundreds. The complete
worker runs on a virtual clock, and a second time over a real pseudo-terminal and a real WebSocket. The judge
compares its reports with the line's record.
"""

from __future__ import annotations

import asyncio
import random
import time
from bisect import bisect_right
from collections import Counter
from collections.abc import Awaitable, Callable, Iterable, Iterator
from contextlib import suppress
from decimal import Decimal

import pytest
import structlog

from bus.catalogue import parameters as numbers
from bus.contract import (
    Action,
    Result,
    SetLine,
    SetSpeed,
    Update,
    WriteAnalogOutput,
    WriteOutput,
    WriteParameter,
)
from bus.settings import BusSettings, Dialect
from bus.simulator.line import FaultKind, Faults, SimulatedLine, WireEventKind, WireRecord
from bus.simulator.plant import demo_line
from bus.simulator.ports import PtyPort
from bus.simulator.serve import LineServer
from bus.simulator.unit import Mode, Unit
from bus.wire.framing import FrameDecoder, ReceivedFrame
from bus.worker.service import run_worker
from tests.bus.fake_app import TOKEN, FakeApp
from tests.bus.judge import (
    READ_PARAMETER,
    Case,
    half_done,
    made_up,
    rash_broadcasts,
    too_late,
    unrequested,
    untrue_result,
)
from tests.bus.test_scale import SCALE, known
from tests.bus.virtual_line import EPOCH, VirtualLine, run
from tests.sizes import sizes

UNITS = 4
ALONE = 0.25
TOGETHER = 0.05
JAM = 0.002
"""Floods and frames of 10,000 bytes fill the cable for seconds: at this rate others are seen as well."""
LARGE = (FaultKind.FLOOD, FaultKind.HUGE)
STRANGER = 99
"""Among other faults a foreign response carries an address that no unit here has. A unit that sends in the
name of another at the very moment of its poll cannot be distinguished from it.
"""
MAX_ALL_AT_ONCE = {
    kind: JAM if kind in LARGE else TOGETHER for kind in FaultKind if kind is not FaultKind.ALL_ADDRESSES
}
KEYPAD = [(numbers.DECIMALS, 0), (numbers.DECIMALS, 1), (numbers.DECIMALS, 2), (numbers.MAX_DISPLAY, 2000)]
KEYPAD += [(numbers.MAX_DISPLAY, 20000), (numbers.FOLLOWER_MODE, 0), (numbers.FOLLOWER_MODE, 1)]
"""What is typed there: a parameter of the scale, and its raw value."""
RATIO_PLACES = 4
SPEEDUP = 10.0
CLOCK_SLACK_S = 0.5
"""Between the clocks of the worker and of the record, where both are real."""


@pytest.fixture(autouse=True)
def _quiet_log() -> Iterator[None]:
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(50))
    yield
    structlog.reset_defaults()


def commands(seed: int, count: int) -> Iterator[Action]:
    """Yield writes of every kind; each value is written once, so that its source is certain."""
    dice = random.Random(seed)
    for fresh in range(1, count + 1):
        unit = dice.randrange(1, UNITS + 1)
        yield dice.choice(
            (
                SetSpeed(unit, fresh),
                SetSpeed(unit, fresh, execute=False),
                SetLine({each: 1000 - fresh * UNITS + each for each in range(1, UNITS + 1)}),
                WriteParameter(unit, 9, 10_000 + fresh),
                WriteOutput(unit, dice.randrange(1, 7), dice.random() < 0.5),
                WriteAnalogOutput(unit, fresh),
            )
        )


class Trial:
    """A list of commands to one worker: the result of each, and what is wrong with it.

    ``perform`` returns the result of a command, ``now`` the time of the record's clock.
    """

    def __init__(
        self,
        perform: Callable[[Action, float], Awaitable[Result]],
        now: Callable[[], float],
        record: WireRecord,
        units: list[Unit],
    ) -> None:
        self.cases: list[Case] = []
        self.complaints: list[str] = []
        self._perform, self._now, self._record, self._units = perform, now, record, units

    async def play(self, seed: int, count: int) -> None:
        """Send one command after the other and judge each result before the next."""
        dice = random.Random(seed)
        for action in commands(seed, count):
            await asyncio.sleep(dice.uniform(0.0, 0.1))
            await self._judge(action, dice.choice((0.03, 0.2, 2.0)))
        self.complaints += unrequested(self.cases, self._record)
        self.complaints += rash_broadcasts(self.cases, self._record)

    async def _judge(self, action: Action, timeout_s: float) -> None:
        requested_at = self._now()
        before = {unit.address: (unit.setpoint, unit.entered) for unit in self._units}
        result = await self._perform(action, timeout_s)
        case = Case(action, requested_at, requested_at + timeout_s, result, self._now())
        self.cases.append(case)
        self.complaints += untrue_result(case, self._record, self._unit_at)
        self.complaints += half_done(case, before, self._record, self._unit_at)

    def _unit_at(self, address: int) -> Unit:
        return next(unit for unit in self._units if unit.address == address)

    def outcomes(self) -> Counter[str]:
        return Counter(case.result.outcome for case in self.cases)


def suffer(faults: Faults, rates: dict[FaultKind, float]) -> None:
    """From now on."""
    if len(rates) > 1:
        faults.foreign_address = STRANGER
    for kind, rate in rates.items():
        faults.set(kind, rate)


def bodies(written: Iterable[tuple[float, bytes]]) -> Iterator[tuple[float, bytes]]:
    """What the host's writes carried, and when they left."""
    for at, data in written:
        for event in FrameDecoder(Dialect()).feed(data):
            if isinstance(event, ReceivedFrame):
                yield at, event.body


def virtual_trial(
    rates: dict[FaultKind, float],
    seed: int,
    count: int,
    meddle: Callable[[VirtualLine], Awaitable[None]] | None = None,
) -> Trial:
    """Send commands on a virtual clock to a line with these faults, while ``meddle`` runs."""

    async def scene(line: VirtualLine) -> Trial:
        def perform(action: Action, timeout_s: float) -> Awaitable[Result]:
            return line.perform(action, timeout_s=timeout_s, within_s=300.0)

        record = line.line.record
        trial = Trial(perform, line.loop.time, record, line.plant.units)
        await asyncio.sleep(2.0)
        suffer(line.faults, rates)
        meddling = asyncio.ensure_future(meddle(line)) if meddle is not None else None
        await trial.play(seed, count)
        if meddling is not None:
            meddling.cancel()
        trial.complaints += made_up(line.updates, record, EPOCH)
        trial.complaints += too_late(trial.cases, bodies(line.written))
        return trial

    # The delays of reconnecting are random too.
    random.seed(seed)
    return run(scene, UNITS, seed=seed)


def test_on_a_good_line_every_write_in_time_is_verified() -> None:
    trial = virtual_trial({}, seed=7, count=20)
    assert trial.complaints == []
    for case in trial.cases:
        assert case.result.outcome in ("verified", "acknowledged") or case.deadline - case.requested_at < 0.1


@pytest.mark.parametrize("count", sizes(20, 100))
@pytest.mark.parametrize("kind", [kind for kind in FaultKind if kind is not FaultKind.ALL_ADDRESSES])
def test_each_fault_alone(kind: FaultKind, count: int) -> None:
    trial = virtual_trial({kind: JAM if kind in LARGE else ALONE}, 3, count)
    assert trial.complaints == []
    assert trial.outcomes()["verified"] > count / 10


@pytest.mark.parametrize("count", sizes(20, 100))
def test_a_unit_that_takes_every_address_for_its_own(count: int) -> None:
    """It carries out the requests of others, so the host does not control what it holds staged."""
    trial = virtual_trial({FaultKind.ALL_ADDRESSES: TOGETHER}, 7, count)
    assert [complaint for complaint in trial.complaints if "still holds" not in complaint] == []
    assert trial.outcomes()["verified"] > count / 10


class Displays:
    """What each unit shows of a setpoint, while somebody changes its scale at the keypad."""

    def __init__(self, line: VirtualLine) -> None:
        self._line = line
        self._places = {unit.address: [(0.0, self._present(unit))] for unit in line.plant.units}

    @staticmethod
    def _present(unit: Unit) -> int:
        return RATIO_PLACES if unit.follows else unit.memory[numbers.DECIMALS]

    async def change(self, seed: int) -> None:
        """Type at the keypads, without end."""
        dice = random.Random(seed)
        while True:
            await asyncio.sleep(dice.uniform(0.05, 1.0))
            unit = dice.choice(self._line.plant.units)
            number, raw = dice.choice(KEYPAD)
            unit.memory[number] = raw
            self._places[unit.address].append((self._line.loop.time(), self._present(unit)))

    def shown(self, unit: int, raw: int) -> set[Decimal]:
        """A setpoint as it is shown since the mode of the unit was last read; its decimals follow."""
        looks = self._line.line.record.since(0, WireEventKind.RECEIVED)
        look = bytes((unit, READ_PARAMETER, numbers.FOLLOWER_MODE))
        since = max((entry.at for entry in looks if entry.data == look), default=0.0)
        times = [at for at, _ in self._places[unit]]
        return {
            Decimal(raw).scaleb(-places) for _, places in self._places[unit][bisect_right(times, since) - 1 :]
        }


async def type_setpoints(
    line: VirtualLine, rates: dict[FaultKind, float], seed: int, count: int
) -> Counter[str]:
    """Enter speeds as a person does who sees the scale that the worker has reported; return the outcomes."""
    dice, displays = random.Random(seed), Displays(line)
    await line.until(lambda: all(known(line, unit, SCALE) for unit in line.units))
    suffer(line.faults, rates)
    keypads = asyncio.ensure_future(displays.change(seed))
    outcomes: Counter[str] = Counter()
    for _ in range(count):
        await asyncio.sleep(dice.uniform(0.0, 0.3))
        unit = dice.choice(line.units)
        scale = known(line, unit, SCALE)
        places = RATIO_PLACES if scale[numbers.FOLLOWER_MODE] else scale[numbers.DECIMALS] or 0
        raw = dice.randrange(10, 2000)
        result = await line.perform(SetSpeed(unit, raw), typed_with={unit: scale}, within_s=300.0)
        outcomes[result.outcome] += 1
        if result.outcome == "verified":
            assert Decimal(raw).scaleb(-places) in displays.shown(unit, raw), (unit, raw, places)
    keypads.cancel()
    return outcomes


@pytest.mark.parametrize("count", sizes(10, 50))
@pytest.mark.parametrize("kind", [None, *FaultKind])
def test_a_typed_value_while_its_scale_changes_among_each_fault(kind: FaultKind | None, count: int) -> None:
    """Never is a number verified that the unit does not show, whatever its responses suffer."""
    seldom = kind in LARGE or kind is FaultKind.ALL_ADDRESSES
    rates = {} if kind is None else {kind: JAM if seldom else TOGETHER}
    random.seed(7)
    outcomes = run(lambda line: type_setpoints(line, rates, 7, count), UNITS, seed=7)
    assert outcomes["verified"] > count / 10, outcomes
    assert outcomes["refused"] + outcomes["unverified"] > count / 10, outcomes


@pytest.mark.parametrize(("seed", "count"), sizes((1, 60), *((seed, 200) for seed in range(1, 12))))
def test_all_faults_together(seed: int, count: int) -> None:
    trial = virtual_trial(MAX_ALL_AT_ONCE, seed, count)
    assert trial.complaints == []
    assert trial.outcomes()["verified"] > 0


async def pull_the_cable(line: VirtualLine) -> None:
    """Out and in again, in the middle of whatever is under way."""
    dice = random.Random(line.line.faults.seed)
    while True:
        await asyncio.sleep(dice.uniform(0.2, 3.0))
        line.unplug()
        await asyncio.sleep(dice.uniform(0.1, 1.0))
        line.plug()


async def work_at_the_panels(line: VirtualLine) -> None:
    """Switch units to LOCAL and back, and one off and on."""
    dice = random.Random(line.line.faults.seed)
    while True:
        await asyncio.sleep(dice.uniform(0.05, 0.5))
        unit = dice.choice(line.plant.units)
        unit.memory[numbers.CONTROL_MODE] = dice.choice((Mode.LOCAL, Mode.REMOTE, Mode.REMOTE, Mode.KEYLOCK))
        if dice.random() < 0.1:
            unit.power_up()


@pytest.mark.parametrize("count", sizes(30, 200))
@pytest.mark.parametrize("meddle", [pull_the_cable, work_at_the_panels])
@pytest.mark.parametrize("rates", [{}, MAX_ALL_AT_ONCE], ids=["alone", "among faults"])
def test_operation_at_the_panels(
    meddle: Callable[[VirtualLine], Awaitable[None]], rates: dict[FaultKind, float], count: int
) -> None:
    trial = virtual_trial(rates, 7, count, meddle)
    assert trial.complaints == []
    assert trial.outcomes()["verified"] > 0
    assert trial.outcomes().keys() & {"bus_closed", "refused"}


def test_a_refusal_speaks_for_its_own_try_only() -> None:
    """The first try was carried out and its response lost; then the unit was switched to LOCAL."""

    async def scene(line: VirtualLine) -> Result:
        def take_to_local() -> None:
            if line.acted(1):
                line.plant.unit(1).memory[numbers.CONTROL_MODE] = Mode.LOCAL
                line.faults.clear()
            else:
                line.loop.call_later(0.001, take_to_local)

        await asyncio.sleep(1.0)
        line.faults.set(FaultKind.LOST, 1.0)
        take_to_local()
        return await line.perform(SetSpeed(1, 321))

    result = run(scene, UNITS)
    assert (result.outcome, result.read_back) == ("verified", 321)


async def test_all_faults_together_over_a_real_pseudo_terminal() -> None:
    faults = Faults(seed=5)
    simulated = SimulatedLine(demo_line(UNITS, script=False).plant, faults, speedup=SPEEDUP)
    with LineServer(simulated, PtyPort()) as server:
        settings = demo_line(UNITS).settings
        bus = BusSettings(name="b", port=server.port.name, unit=settings)
        async with FakeApp() as app:
            leave = asyncio.Event()
            worker = asyncio.create_task(run_worker(bus, [app.url], TOKEN, leave=leave))
            await app.until(lambda: all(app.readings(unit) for unit in range(1, UNITS + 1)))
            trial = Trial(app.perform, time.monotonic, simulated.record, simulated.plant.units)
            # As seldom as at the usual speed: three within two seconds are another host.
            rates = {**MAX_ALL_AT_ONCE, FaultKind.FOREIGN: MAX_ALL_AT_ONCE[FaultKind.FOREIGN] / SPEEDUP}
            server.call(lambda line: suffer(line.faults, rates))
            await trial.play(seed=5, count=30)
            leave.set()
            with suppress(asyncio.CancelledError):
                await worker
            reported: list[Update] = app.updates()
    came = ((entry.at, entry.data) for entry in simulated.record.since(0, WireEventKind.CAME))
    trial.complaints += made_up(reported, simulated.record, time.time() - time.monotonic() - CLOCK_SLACK_S)
    trial.complaints += too_late(trial.cases, bodies(came), slack_s=CLOCK_SLACK_S)
    assert trial.complaints == []
    assert trial.outcomes()["verified"] > 0
