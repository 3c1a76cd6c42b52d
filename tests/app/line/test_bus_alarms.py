"""From what a worker reports to the states of the alarms of its bus."""

from __future__ import annotations

import asyncio
import threading
from decimal import Decimal

import pytest

from app.core.database import Database
from app.line.alarms import rules
from app.line.alarms.alarm import Alarm
from app.line.alarms.own_condition import own_definition
from app.line.alarms.settings import AlarmSettings
from app.line.feed.bus_feed import Credential, refusal
from bus.contract import CONTRACT_VERSION, BusFigures, BusLink, ParameterValue, Staged, UnitFigures, UnitLink
from bus.settings import Seam
from tests.app.alarm_bus import AT_SPEED, BUS, HEALTHY, REMOTE, RUN, AlarmBus
from tests.app.fake_worker import hello


@pytest.fixture
def bus(database: Database) -> AlarmBus:
    bus = AlarmBus(database)
    bus.connect()
    bus.wait(2, 1, 2, 3)
    assert bus.present() == set()
    return bus


def test_a_unit_off_speed_is_an_alarm_unless_its_emergency_stop_is_active(bus: AlarmBus) -> None:
    bus.wait(20, 1, 2, 3, actual=700, outputs=REMOTE)
    assert bus.present() == {"1.not_at_speed", "2.not_at_speed", "3.not_at_speed"}
    bus.wait(1, 2, actual=700, outputs=REMOTE, inputs=RUN)
    assert bus.state("2.not_at_speed") == "suppressed"
    assert bus.state("1.not_at_speed") == "unack_active"


def test_a_unit_that_does_not_respond_is_one_alarm_and_its_others_are_unknown(bus: AlarmBus) -> None:
    bus.wait(1, 1, inputs=RUN)
    bus.wait(12, 2, 3)
    assert bus.state("1.unit_offline") == "unack_active"
    estop = bus.alarm("1.estop_active").facts
    assert (estop.state, estop.unknown_since is not None) == ("unack_active", True)
    bus.wait(1, 1, 2, 3)
    assert bus.state("1.unit_offline") == "rtn_unack"
    assert bus.alarm("1.estop_active").facts.unknown_since is None
    assert bus.state("1.estop_active") == "rtn_unack"


def test_a_lost_port_suppresses_its_units_and_they_neither_clear_nor_rise(bus: AlarmBus) -> None:
    bus.wait(1, 1, inputs=RUN)
    bus.apply(BusLink(at=bus.now, link="closed"))
    assert bus.state("port_lost") == "unack_active"
    assert bus.state("1.estop_active") == "suppressed"
    bus.wait(30)
    assert bus.present() == {"port_lost", "1.estop_active"}
    bus.apply(BusLink(at=bus.now, link="open"))
    bus.wait(1, 1, 2, 3, inputs=RUN)
    assert bus.state("1.estop_active") == "unack_active"


def lose_all(bus: AlarmBus) -> None:
    """The units are lost one after another, as a scan finds them: the others count as online until then."""
    for unit in (3, 1, 2):
        bus.wait(0.5)
        bus.apply(UnitLink(unit=unit, at=bus.now, link="offline"))


def test_that_no_unit_responds_is_one_alarm_and_not_one_for_each(bus: AlarmBus) -> None:
    bus.wait(1, 1, inputs=RUN)
    lose_all(bus)
    bus.wait(3)
    assert bus.state("no_unit_responds") == "unack_active"
    assert bus.state("1.estop_active") == "suppressed"
    assert bus.present() == {"no_unit_responds", "1.estop_active"}
    assert bus.alarm("2.unit_offline").facts.occurrence == 0


def test_the_units_that_stay_away_when_the_others_respond_again_are_alarms_then(bus: AlarmBus) -> None:
    lose_all(bus)
    bus.wait(3)
    bus.apply(*(UnitLink(unit=unit, at=bus.now, link="online") for unit in (1, 2)))
    bus.wait(4.5, 1, 2)
    assert bus.state("3.unit_offline") == "suppressed"
    bus.wait(2.5, 1, 2)
    assert bus.present() == {"no_unit_responds", "3.unit_offline"}
    assert bus.state("no_unit_responds") == "rtn_unack"
    assert bus.state("3.unit_offline") == "unack_active"


def test_a_unit_that_was_lost_before_the_others_keeps_its_alarm(bus: AlarmBus) -> None:
    bus.wait(12, 2, 3)
    bus.wait(14)
    assert bus.present() == {"1.unit_offline", "no_unit_responds"}
    assert bus.state("1.unit_offline") == "suppressed"
    bus.apply(BusLink(at=bus.now, link="closed"))
    assert bus.state("no_unit_responds") == "suppressed"
    assert bus.state("port_lost") == "unack_active"


def test_a_unit_lost_alone_is_an_alarm_as_soon_as_another_responds(bus: AlarmBus) -> None:
    bus.now += 0.1
    bus.apply(UnitLink(unit=3, at=bus.now, link="offline"))
    assert bus.present() == set()
    assert bus.alarm("no_unit_responds").holds is False
    bus.now += 0.03
    bus.read(1)
    assert bus.present() == {"3.unit_offline"}
    bus.wait(10, 1, 2)
    assert bus.present() == {"3.unit_offline"}


@pytest.mark.parametrize("silence_s", [9.5, 12, 60])
@pytest.mark.parametrize("cause", ["worker stands still", "new worker", "port closed", "none"])
def test_units_that_respond_one_after_the_other_after_a_silence_are_no_alarms(
    bus: AlarmBus, cause: str, silence_s: float
) -> None:
    """No unit was polled meanwhile, so none is lost."""
    if cause == "port closed":
        bus.apply(BusLink(at=bus.now, link="closed"))
    if cause == "new worker":
        bus.live.lose_worker(bus.now)
    bus.wait(silence_s)
    bus.live.worker_lost = None
    units = (UnitLink(unit=unit, at=bus.now, link="unknown") for unit in (1, 2, 3))
    bus.apply(BusLink(at=bus.now, link="open"), *(units if cause == "new worker" else ()))
    for unit in (2, 3, 1):
        bus.now += 0.03
        bus.apply(UnitLink(unit=unit, at=bus.now, link="online"))
        bus.read(unit)
        bus.alarms.tick()
    bus.wait(3, 1, 2, 3)
    occurrences = [bus.alarm(f"{unit}.unit_offline").facts.occurrence for unit in (1, 2, 3)]
    assert occurrences == [0, 0, 0]


@pytest.mark.parametrize("was_lost", [False, True], ids=["lost with it", "lost before"])
def test_a_unit_that_does_not_respond_after_a_silence_either_is_an_alarm(
    bus: AlarmBus, was_lost: bool
) -> None:
    bus.wait(12 if was_lost else 0.5, 1, 2)
    assert (bus.state("3.unit_offline") == "unack_active") is was_lost
    bus.apply(BusLink(at=bus.now, link="closed"))
    bus.wait(20)
    bus.apply(BusLink(at=bus.now, link="open"))
    bus.wait(9, 1, 2)
    assert (bus.state("3.unit_offline") == "unack_active") is was_lost
    bus.wait(2, 1, 2)
    assert bus.state("3.unit_offline") == "unack_active"
    assert bus.alarm("3.unit_offline").facts.occurrence == 1


def test_the_only_unit_of_a_bus_is_its_own_alarm(database: Database) -> None:
    bus = AlarmBus(database, units=1)
    bus.connect()
    bus.wait(12)
    assert bus.present() == {"1.unit_offline"}


def test_a_lost_worker_suppresses_its_port(bus: AlarmBus) -> None:
    bus.live.lose_worker(bus.now)
    bus.wait(9)
    assert bus.present() == set(), "it may start again"
    bus.wait(2)
    assert bus.present() == {"worker_lost"}


def test_a_worker_of_an_older_link_is_lost_with_the_command_that_upgrades_it(bus: AlarmBus) -> None:
    bus.live.lose_worker(bus.now)
    credential = Credential(token="cabinet", bus=BUS, address="192.0.2.7")
    older = refusal(hello(bus=BUS, version=CONTRACT_VERSION - 1), credential, [BUS])
    assert older is not None
    bus.apply(BusLink(at=bus.now, link="closed", cause=older))
    bus.wait(11)
    assert bus.present() == {"worker_lost"}
    value = bus.alarms.present(bus.alarm("worker_lost"))
    assert "run sudo /opt/lineside/bin/pip install ./lineside-*.whl" in str(value)
    bus.live.worker_lost = None
    bus.apply(BusLink(at=bus.now, link="open"))
    assert bus.alarms.present(bus.alarm("worker_lost")) is None


def test_a_reading_of_a_snapshot_from_before_raises_nothing(database: Database) -> None:
    bus = AlarmBus(database)
    bus.live.worker_lost = None
    bus.apply(BusLink(at=bus.now, link="open"), UnitLink(unit=1, at=bus.now, link="online"))
    bus.read(1, inputs=RUN, at=bus.now - 600)
    assert bus.present() == set()


def test_drift_a_ratio_and_a_staged_setpoint_are_alarms(bus: AlarmBus) -> None:
    bus.drifted.add(2)
    values = {8: 1, 37: 20_000, 38: 5_000, 31: 15_000}
    bus.apply(*(ParameterValue(unit=1, number=n, at=bus.now, raw=raw) for n, raw in values.items()))
    bus.apply(Staged(unit=3, at=bus.now, raw=500))
    bus.wait(1, 1, 2, 3)
    assert bus.present() == {"2.parameter_drift", "1.ratio_out_of_limits"}
    bus.wait(60, 1, 2, 3)
    assert "3.staged_left" in bus.present()


def add(bus: AlarmBus, **own: object) -> Alarm:
    settings = AlarmSettings.model_validate({"name": "Later", "bus": BUS, "unit": 1, "value": "actual"} | own)
    alarm = Alarm(own_definition(settings))
    bus.alarms.add_own(settings, alarm)
    return alarm


@pytest.mark.parametrize("own", [{"above": "90"}, {"value": "run", "state": "on"}])
def test_an_alarm_of_the_site_is_detected_from_the_reading_after_it_was_added(
    bus: AlarmBus, own: dict[str, object]
) -> None:
    alarm = add(bus, **own)
    bus.wait(0.5)
    assert (alarm.facts.state, alarm.holds) == ("normal", None)
    bus.wait(0.5, 1)
    assert alarm.facts.state == "unack_active"
    bus.alarms.end_own(alarm)
    bus.wait(1, 1, actual=500, inputs=HEALTHY)
    assert alarm.facts.state == "unack_active"
    bus.alarms.list.remove(alarm.definition.key)
    bus.wait(1, 1, 2, 3)
    assert alarm not in bus.alarms.list.alarms.values()
    assert bus.alarms.list.known[alarm.definition.key] is alarm


def test_an_added_alarm_is_suppressed_as_the_others_are(bus: AlarmBus) -> None:
    alarm = add(bus, below="90")
    bus.wait(2, 1, actual=700)
    bus.wait(1, 1, actual=700, inputs=RUN)
    assert alarm.facts.state == "suppressed"


def figures(bus: AlarmBus, polls: int, timeouts: int = 0, unrequested: int = 0) -> None:
    unit = UnitFigures(unit=1, polls=polls, timeouts=timeouts, foreign=9 * polls)
    bus.apply(BusFigures(bus.now, 10.0, 0.1, 0.5, 0.13, units=[unit], unrequested=unrequested))


def test_a_poor_connection_and_a_second_master_come_from_the_counters_of_a_minute(bus: AlarmBus) -> None:
    figures(bus, 1000)
    bus.wait(61, 1, 2, 3)
    figures(bus, 1600, timeouts=40, unrequested=9)
    assert bus.present() == {"1.link_degraded", "second_master"}
    bus.wait(61, 1, 2, 3)
    figures(bus, 2200, timeouts=40, unrequested=9)
    bus.wait(61, 1, 2, 3)
    assert bus.state("second_master") == "rtn_unack"


@pytest.mark.parametrize("others", [(), (2, 3)], ids=["no unit responds", "the others respond"])
def test_what_a_lost_unit_did_not_respond_to_is_no_poor_connection_as_well(
    bus: AlarmBus, others: tuple[int, ...]
) -> None:
    figures(bus, 1000)
    bus.wait(61, 1, 2, 3)
    figures(bus, 1600)
    bus.wait(20, *others)
    figures(bus, 1800, timeouts=150)
    bus.wait(61, 1, 2, 3)
    figures(bus, 2400, timeouts=150)
    assert bus.state("1.link_degraded") == "normal"
    bus.wait(61, 1, 2, 3)
    figures(bus, 3000, timeouts=190)
    assert bus.state("1.link_degraded") == "unack_active"


@pytest.mark.parametrize(
    ("own", "outside", "code"),
    [
        ({"value": "actual", "below": "80.0"}, {"actual": 799}, "value_out_of_limits"),
        ({"value": "commanded", "above": "120.0"}, {"commanded": 1201}, "value_out_of_limits"),
        ({"value": "deviation", "above": "5.0"}, {"actual": 900}, "deviation"),
        ({"value": "output.2", "state": "on"}, {"outputs": REMOTE | 0b10}, "state_too_long"),
        ({"value": "run", "state": "off"}, {"inputs": HEALTHY}, "state_too_long"),
        ({"value": "estop", "state": "on"}, {"inputs": RUN}, "state_too_long"),
    ],
)
def test_an_alarm_that_the_site_defined_rises_and_clears(
    database: Database, own: dict[str, str], outside: dict[str, int], code: str
) -> None:
    bus = AlarmBus(database, own)
    bus.connect()
    bus.wait(2, 1, 2, 3)
    assert bus.own().facts.state == "normal"
    bus.wait(0.5, 1, **outside)
    assert (bus.own().facts.state, bus.own().definition.code) == ("unack_active", code)


def test_an_analog_input_is_compared_in_its_unit(database: Database) -> None:
    bus = AlarmBus(database, {"value": "analog", "above": "150"})
    bus.connect()
    bus.wait(1, 1, analog=100)
    assert bus.own().holds is None
    bus.apply(*(ParameterValue(unit=1, number=n, at=bus.now, raw=raw) for n, raw in ((22, 0), (23, 500))))
    bus.wait(1, 1, analog=100)
    assert (bus.own().facts.state, bus.own().definition.code) == ("unack_active", "analog_out_of_limits")
    assert str(bus.alarms.present(bus.own())) == "196.078"


def test_a_clock_that_steps_back_keeps_the_length_of_a_delay(bus: AlarmBus) -> None:
    bus.wait(3, 1, outputs=AT_SPEED)
    bus.step_s = -3600
    bus.wait(1, 1, outputs=AT_SPEED)
    assert bus.state("1.not_in_remote") == "normal"
    bus.wait(2, 1, outputs=AT_SPEED)
    assert bus.state("1.not_in_remote") == "unack_active"
    bus.wait(1, 1)
    assert bus.state("1.not_in_remote") == "rtn_unack"


async def test_a_restart_goes_on_with_the_same_states_and_loses_and_repeats_nothing(
    database: Database,
) -> None:
    bus = AlarmBus(database)
    bus.connect()
    bus.wait(1, 2, inputs=RUN)
    bus.wait(1, 3, inputs=RUN)
    bus.wait(1, 3)
    await bus.alarms.list.write()
    again = AlarmBus(database)
    again.alarms.load(await again.store.load())
    stored = {
        key: (a.facts.state, a.facts.occurrence, a.first_out) for key, a in again.alarms.list.alarms.items()
    }
    assert stored == {
        key: (a.facts.state, a.facts.occurrence, a.first_out) for key, a in bus.alarms.list.alarms.items()
    }
    assert again.alarm("2.estop_active").facts.unknown_since == again.now
    again.connect()
    again.read(2, inputs=RUN, at=again.now + 0.1)
    await again.alarms.list.write()
    journal = await again.store.journal(100, None)
    assert [(e.alarm.split(".", 1)[1], e.trigger) for e in reversed(journal)] == [
        ("2.estop_active", "rise"),
        ("3.estop_active", "rise"),
        ("3.estop_active", "clear"),
        ("2.estop_active", "clear"),
        ("2.estop_active", "rise"),
    ]


async def test_a_restart_keeps_when_an_alarm_came_cleared_and_was_acknowledged(database: Database) -> None:
    bus = AlarmBus(database)
    bus.connect()
    bus.wait(1, 2, inputs=RUN)
    alarm = bus.alarm("2.estop_active")
    changed = rules.acknowledge(alarm.facts, alarm.definition.attributes, bus.now)
    bus.alarms.list.apply(alarm, changed, "anna", "")
    bus.wait(3, 2)
    before = (alarm.facts.came, alarm.facts.cleared, alarm.facts.acknowledged_at)
    assert None not in before
    assert len(set(before)) == 3
    await bus.alarms.list.write()
    again = AlarmBus(database)
    again.alarms.load(await again.store.load())
    facts = again.alarm("2.estop_active").facts
    assert (facts.came, facts.cleared, facts.acknowledged_at) == before


async def test_a_suppression_whose_reason_is_gone_after_a_restart_ends(database: Database) -> None:
    bus = AlarmBus(database)
    bus.connect()
    bus.wait(20, 1, 2, 3, actual=700, outputs=REMOTE)
    bus.wait(1, 1, 2, 3, commanded=0, actual=600, outputs=REMOTE)
    bus.wait(1, 2, commanded=0, inputs=RUN)
    assert bus.state("1.not_at_speed") == "suppressed"
    await bus.alarms.list.write()
    again = AlarmBus(database)
    again.alarms.load(await again.store.load())
    assert again.state("1.not_at_speed") == "unack_active"
    assert again.state("2.estop_active") == "unack_active"


async def test_the_end_of_the_server_loses_no_transition_that_is_being_written(
    bus: AlarmBus, database: Database
) -> None:
    bus.wait(1, 2, inputs=RUN)
    held = threading.Event()
    blocked = asyncio.ensure_future(database.write(lambda _: held.wait(20)))
    writing = asyncio.create_task(bus.alarms.list.write())
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    writing.cancel()
    await asyncio.gather(writing, return_exceptions=True)
    held.set()
    await blocked
    await database.write(lambda _: None)
    assert [entry.trigger for entry in await bus.store.journal(10, None)] == ["rise"]


def test_a_draw_out_of_band_is_an_alarm_while_both_sections_respond_and_stays_on_ramps(bus: AlarmBus) -> None:
    def run(seconds: int, **second: int) -> None:
        """The first unit at 100.0, the second as given."""
        for _ in range(2 * seconds):
            bus.read(1)
            bus.wait(0.5, 2, **second)

    bus.live.seams = {2: Seam(1, (Decimal(-1), Decimal(2)))}
    run(4, actual=1030)
    assert bus.present() == set()
    run(2, actual=1030)
    assert bus.present() == {"2.draw_out_of_band"}
    value = bus.alarms.present(bus.alarm("2.draw_out_of_band"))
    assert str(value) == f"+3.0 % to {bus.live.units[1].settings.name}, band \N{MINUS SIGN}1 to 2 %"
    run(3, actual=1030, commanded=1100, outputs=REMOTE)
    assert bus.state("2.draw_out_of_band") == "unack_active", "each step of a setpoint would call again"
    run(3)
    assert bus.state("2.draw_out_of_band") == "rtn_unack"
    run(4, actual=1030, commanded=1100, outputs=REMOTE)
    assert bus.state("2.draw_out_of_band") == "rtn_unack", "nor does it come on a ramp"
    run(6, actual=1030)
    assert bus.state("2.draw_out_of_band") == "unack_active"
    bus.wait(3, 2, actual=1030)
    assert bus.alarm("2.draw_out_of_band").holds is None
