"""Built-in alarms and those of the site: set by lineside.toml, and judged against the model of the
standard."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any

import pytest
from pydantic import ValidationError

from app.core.database import Database
from app.core.web.access import Role
from app.line.alarms.alarm import Alarm, built_in
from app.line.alarms.bus_alarms import control_left_by
from app.line.alarms.journal import AlarmStore
from app.line.alarms.line_alarms import ExpiryWatch, SiteAlarms
from app.line.alarms.rules import AlarmFacts
from app.line.alarms.settings import BuiltInAlarmSettings, tuning_of
from app.line.conditions.catalogue import CONDITIONS, certificate_expires, token_expires
from app.line.live.diagnosis import bus_facts
from app.people.auth.store import Token
from bus.contract import BusFigures, BusLink, ParameterValue
from bus.instants import DAY_S, Monotonic, UnixTime
from tests.app.alarm_bus import AT_SPEED, BUS, REMOTE, AlarmBus
from tests.app.alarm_model import FOREVER, ModelAlarm
from tests.app.configured import faults_of
from tests.app.notification_servers import certificate
from tests.sizes import sizes

CODES = (
    "unit_offline link_degraded estop_active not_at_speed deviation running_without_run ratio_out_of_limits "
    "not_in_remote parameter_drift analog_out_of_limits duplicate_address staged_left port_lost worker_lost "
    "second_master clock_stepped history_degraded audit_degraded disk_low certificate_expiring "
    "notification_failed"
)
"""Those that programs rely on."""
DAY = UnixTime(DAY_S)


@pytest.fixture
def bus(database: Database) -> AlarmBus:
    bus = AlarmBus(database)
    bus.connect()
    bus.apply(*(ParameterValue(unit=unit, number=2, at=bus.now, raw=2000) for unit in (1, 2, 3)))
    bus.wait(2, 1, 2, 3)
    return bus


def test_every_code_that_programs_rely_on_is_in_the_catalogue() -> None:
    assert set(CODES.split()) <= set(CONDITIONS)


def model_of(code: str) -> ModelAlarm:
    row = CONDITIONS[code]
    return ModelAlarm(row.tuning.on_delay_s, row.tuning.off_delay_s, FOREVER, row.latching)


@pytest.mark.parametrize(
    ("code", "abnormal"), [("deviation", {"actual": 1150}), ("analog_out_of_limits", {"analog": 255})]
)
@pytest.mark.parametrize("seed", sizes(0, 1, 2, 3, 4))
def test_a_random_history_of_readings_equals_the_model(
    bus: AlarmBus, code: str, abnormal: dict[str, int], seed: int
) -> None:
    """Normal, abnormal, quiet, and late readings of a moment when it was otherwise."""
    random, model, alarm = Random(seed), model_of(code), bus.alarm(f"1.{code}")
    read_at, holds = bus.now, False
    for _ in range(40):
        what = random.choice(("normal", "abnormal", "quiet", "late"))
        for _ in range(random.randrange(1, 20)):
            bus.now += 0.5
            bus.read(2, 3)
            if what == "late":
                read_at = bus.now - 30
                bus.read(1, at=read_at, **({} if holds else abnormal))
            elif what != "quiet":
                read_at, holds = bus.now, what == "abnormal"
                bus.read(1, **(abnormal if holds else {}))
                model.observed.append((bus.now, holds))
            if what in ("quiet", "late") and bus.now - read_at > 2:
                model.observed.append((bus.now, None))
            bus.alarms.tick()
            bus.alarms.list.advance(Monotonic(bus.now))
            assert alarm.facts.state == model.state(bus.now)
            assert (alarm.facts.unknown_since is not None) == (model.observed[-1][1] is None)
    assert alarm.facts.occurrence == model.occurrences(bus.now) > 0


def test_a_deviation_ends_by_its_deadband_and_means_nothing_on_a_ramp_or_at_rest(bus: AlarmBus) -> None:
    bus.wait(6, 1, 2, 3, actual=1101)
    assert bus.present() == {"1.deviation", "2.deviation", "3.deviation"}
    bus.wait(5, 1, 2, 3, actual=1090)
    assert bus.state("1.deviation") == "unack_active"
    bus.wait(3, 1, 2, 3, actual=1079)
    assert bus.state("1.deviation") == "rtn_unack"
    bus.wait(1, 1, 2, 3, commanded=2000, outputs=REMOTE)
    assert bus.alarm("1.deviation").holds is False
    assert [bus.alarm(f"{unit}.deviation").first_out for unit in (1, 2, 3)] == [3, 0, 0]


def test_a_scan_over_its_budget_is_an_alarm_after_a_minute_and_unknown_without_a_port(bus: AlarmBus) -> None:
    slow = BusFigures(at=bus.now, scan_hz=1, scan_s=1.0, wire_utilisation=1.0, scan_s_with_one_more=1.3)
    for _ in range(62):
        bus.apply(replace_at(slow, bus.now))
        bus.wait(1, 1, 2, 3)
    assert bus.present() == {"wire_overloaded"}
    bus.apply(BusLink(at=bus.now, link="closed"))
    bus.wait(1)
    assert bus.state("wire_overloaded") == "suppressed"
    assert bus.alarm("wire_overloaded").facts.unknown_since is not None
    facts = bus_facts(bus.live, bus.now)._replace(port_is_closed=False)
    assert CONDITIONS["wire_overloaded"].holds(facts) is True, "only the port is in the way"


def test_a_scan_that_the_configuration_limits_is_not_over_its_budget(bus: AlarmBus) -> None:
    bus.live.settings = bus.settings.model_copy(update={"max_scan_hz": 1.0})
    slow = BusFigures(at=bus.now, scan_hz=1, scan_s=1.0, wire_utilisation=0.1, scan_s_with_one_more=1.0)
    bus.apply(slow)
    assert CONDITIONS["wire_overloaded"].holds(bus_facts(bus.live, bus.now)) is False
    bus.apply(BusFigures(bus.now, 0.5, 2.0, 0.1, 2.0))
    assert CONDITIONS["wire_overloaded"].holds(bus_facts(bus.live, bus.now)) is True


def replace_at(figures: BusFigures, at: float) -> BusFigures:
    return BusFigures(
        at=at,
        scan_hz=figures.scan_hz,
        scan_s=figures.scan_s,
        wire_utilisation=figures.wire_utilisation,
        scan_s_with_one_more=figures.scan_s_with_one_more,
    )


def test_control_is_left_when_its_holder_has_no_page_and_sends_nothing(bus: AlarmBus) -> None:
    pages, used_at = {"anna"}, Monotonic(bus.now)
    bus.left_control = lambda: control_left_by("anna", used_at, pages, Monotonic(bus.now))
    bus.wait(200, 1, 2, 3)
    assert bus.state("control_left") == "normal"
    pages.clear()
    bus.wait(1, 1, 2, 3)
    alarm = bus.alarm("control_left")
    assert (alarm.facts.state, str(bus.alarms.present(alarm))) == ("unack_active", "held by anna")
    used_at = Monotonic(bus.now)
    bus.wait(6, 1, 2, 3)
    assert alarm.facts.state == "rtn_unack"


# --- the clock -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("step_s", [-3600.0, 3600.0])
def test_a_step_of_the_clock_raises_nothing_on_a_bus_and_keeps_every_distance(
    database: Database, step_s: float
) -> None:
    bus = AlarmBus(database, units=1)
    bus.connect()
    bus.wait(2, 1)
    bus.wait(6, 1, outputs=AT_SPEED)
    alarm = bus.alarm("1.not_in_remote")
    assert alarm.facts.since is not None
    age = bus.now - alarm.facts.since
    bus.step_s = step_s
    bus.alarms.tick()
    assert bus.now + step_s - alarm.facts.since == age
    assert bus.alarms.list.pop_unwritten()[1] != []
    bus.wait(9)
    assert bus.present() == {"1.not_in_remote"}
    bus.wait(1, 1, outputs=AT_SPEED)
    bus.wait(20)
    assert "1.unit_offline" in bus.present()


def test_that_the_clock_was_set_is_an_alarm_with_the_step(database: Database) -> None:
    now, step = 1000.0, 0.0
    site = SiteAlarms(
        AlarmStore(database),
        lambda: UnixTime(now + step),
        lambda: now,  # type: ignore
    )
    alarm = site.list.alarms["_.clock_stepped"]
    model = model_of("clock_stepped")
    for seconds in range(200):
        now += 1.0
        step = -7200.0 if seconds > 20 else 0.0
        site.tick()
        site.list.advance(UnixTime(now + step))
        model.observed.append((now, seconds == 21))
        assert alarm.facts.state == model.state(now)
    assert (alarm.facts.state, str(site.present(alarm))) == ("rtn_unack", "set by -7200.0 s")


# --- what expires ----------------------------------------------------------------------------------------


def test_a_token_expires_near_its_end_while_a_program_uses_it() -> None:
    def expires(days_left: float, life: float = 365, unused: float | None = 0) -> bool:
        now = DAY + 1000 * DAY_S
        used_at = None if unused is None else now - unused * DAY_S
        return token_expires(now + (days_left - life) * DAY_S, now + days_left * DAY_S, used_at, now)

    assert [expires(days) for days in (15, 13, -1)] == [False, True, True]
    assert [expires(0.5, life=1), expires(0.05, life=1)] == [False, True]
    assert [expires(1, unused=31), expires(1, unused=None)] == [False, False]
    assert not token_expires(DAY, None, DAY, DAY)
    assert [certificate_expires(DAY + days * DAY_S, DAY) for days in (31, 29, -1)] == [False, True, True]


async def test_the_token_and_the_certificate_that_end_first_are_named(
    database: Database, tmp_path: Path
) -> None:
    now = DAY + 1000 * DAY_S
    tokens = [
        Token(number, name, Role.VIEWER, "t", DAY, now, expires_at=now + days * DAY_S)
        for number, (name, days) in enumerate((("later", 5), ("scada", 2), ("good", 90)))
    ]

    async def stored() -> list[Token]:
        return tokens

    expiry = ExpiryWatch(stored, [certificate(tmp_path), tmp_path / "none.pem"], lambda: now)
    site = SiteAlarms(AlarmStore(database))
    site.watch("token_expiring", lambda: expiry.token)
    site.watch("certificate_expiring", lambda: expiry.certificate)
    site.tick()
    token, authority = (site.list.alarms[f"_.{code}"] for code in ("token_expiring", "certificate_expiring"))
    assert (token.holds, authority.holds) == (None, None)
    await expiry.look()
    site.tick()
    assert (token.facts.state, str(site.present(token))) == ("unack_active", "scada until 1972-09-30")
    assert authority.facts.state == "normal"
    now = UnixTime(time.time()) + 365 * DAY_S
    tokens.clear()
    await expiry.look()
    site.tick()
    assert (token.facts.state, authority.facts.state) == ("rtn_unack", "unack_active")
    assert str(site.present(authority)).startswith("plant.pem until 20")


CONFIGURED = '[[bus]]\nname = "dry-end"\nport = "/dev/null"\n[[bus.unit]]\nid = 4\nname = "Dryer"\n'
OWN = '[[alarm]]\nname = "Dryer too slow"\nbus = "dry-end"\nunit = 4\n'


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ('value = "actual"\nbelow = "80"\non_delay_s = -1\n', 13, "on_delay_s = -1"),
        ('value = "actual"\n', 7, "above, below or both, or a change per second (change_per_s)"),
        ('value = "run"\n', 7, 'write state = "on" or "off"'),
        ('value = "actual"\nstate = "on"\n', 7, "actual is a number"),
        ('value = "actual"\nbelow = "80"\nabove = "70"\n', 7, "below is not less than above"),
        ('value = "actual"\nbelow = "80"\nabove = "90"\ndeadband = "5"\n', 7, "would never clear"),
        (
            'value = "actual"\nabove = "90"\ndeadband = "91"\n',
            7,
            "deadband is wider than the limits leave room for",
        ),
        ('value = "actual"\nchange_per_s = "5"\ndeadband = "1"\n', 7, "use off_delay_s"),
        ('value = "actual"\nbelow = "nan"\n', 12, "finite number"),
    ],
)
def test_a_fault_of_an_own_alarm_is_named_with_its_line(
    tmp_path: Path, text: str, line: int, words: str
) -> None:
    fault = faults_of(tmp_path, CONFIGURED + OWN + text)
    assert words in fault
    assert fault.startswith(f"FILE:{line}: ")


@pytest.mark.parametrize(
    ("own", "line", "words"),
    [
        (OWN.replace("unit = 4", "unit = 9"), 10, "alarm Dryer too slow: bus dry-end has no unit 9"),
        (OWN.replace("dry-end", "wet-end"), 9, "alarm Dryer too slow: there is no bus wet-end"),
        (OWN + 'value = "actual"\nabove = 1\n' + OWN, 14, "is given twice for bus dry-end"),
    ],
)
def test_an_own_alarm_has_its_unit_and_its_name(tmp_path: Path, own: str, line: int, words: str) -> None:
    fault = faults_of(tmp_path, CONFIGURED + own + 'value = "actual"\nbelow = "80"\n')
    assert words in fault
    assert fault.startswith(f"FILE:{line}: ")


DEVIATION = '[[built_in_alarm]]\ncode = "deviation"\n'
OF_UNIT = 'bus = "dry-end"\nunit = 4\n'


def tuned_bus(database: Database, *entries: dict[str, Any]) -> AlarmBus:
    """Three units whose maximum display value is 200.0."""
    bus = AlarmBus(database, tuned=[BuiltInAlarmSettings(**each) for each in entries])
    bus.connect()
    bus.apply(*(ParameterValue(unit=unit, number=2, at=bus.now, raw=2000) for unit in (1, 2, 3)))
    bus.wait(2, 1, 2, 3)
    return bus


@pytest.mark.parametrize("code", [row.code for row in CONDITIONS.values() if row.is_alarm])
def test_the_delays_of_every_built_in_alarm_can_be_set(code: str) -> None:
    row = CONDITIONS[code]
    entry = BuiltInAlarmSettings(code=code, on_delay_s=7.0)
    tuning = tuning_of([entry], row.code, BUS, 1)
    assert tuning == replace(row.tuning, on_delay_s=7.0)
    assert built_in(row.code, BUS, 1, [entry]).attributes.on_delay_s == 7


@pytest.mark.parametrize("code", [row.code for row in CONDITIONS.values() if not row.is_alarm])
def test_a_condition_without_an_alarm_cannot_be_set(code: str) -> None:
    with pytest.raises(ValidationError):
        BuiltInAlarmSettings(code=code, on_delay_s=7.0)


def test_a_unit_comes_before_its_bus_and_that_before_everywhere(database: Database) -> None:
    """At 40 of 2000 away: 2 %."""
    bus = tuned_bus(
        database,
        {"code": "deviation", "bus": BUS, "unit": 2, "above_percent": 3},
        {"code": "deviation", "bus": BUS, "above_percent": "1.5"},
        {"code": "deviation", "above_percent": 4, "off_delay_s": 7.0},
        {"code": "deviation", "bus": BUS, "unit": 3, "on_delay_s": 60.0},
    )
    bus.wait(10, 1, 2, 3, actual=1040)
    assert bus.present() == {"1.deviation"}
    assert {bus.alarm(f"{unit}.deviation").definition.attributes.off_delay_s for unit in (1, 2, 3)} == {7}
    bus.wait(51, 1, 2, 3, actual=1040)
    assert bus.present() == {"1.deviation", "3.deviation"}


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        (DEVIATION + "on_delay_s = -1\n", 9, "on_delay_s = -1"),
        (DEVIATION + 'deadband_percent = "5"\n', 8, "alarm deviation: deadband is wider than the limits"),
        (DEVIATION + "below_percent = 1\n", 9, "alarm deviation has no below_percent; known here: "),
        (DEVIATION, 8, "alarm deviation: nothing is set; write one of above_percent, "),
        (DEVIATION + "unit = 4\nabove_percent = 3\n", 9, "name the bus"),
        (DEVIATION + OF_UNIT.replace("4", "9") + "on_delay_s = 1\n", 10, "bus dry-end has no unit 9"),
        (DEVIATION + OF_UNIT.replace("dry", "wet") + "on_delay_s = 1\n", 9, "there is no bus wet-end"),
        (
            '[[built_in_alarm]]\ncode = "analog_out_of_limits"\nbelow_percent = 99.7\n',
            8,
            "below is not less than above",
        ),
        (
            '[[built_in_alarm]]\ncode = "worker_lost"\n' + OF_UNIT + "on_delay_s = 1\n",
            10,
            "worker_lost is not of one unit",
        ),
        (
            '[[built_in_alarm]]\ncode = "disk_low"\nbus = "dry-end"\non_delay_s = 1\n',
            9,
            "disk_low is of the server",
        ),
        (2 * (DEVIATION + "above_percent = 3\n"), 11, "deviation is set twice for one place"),
        ('[[built_in_alarm]]\ncode = "deviations"\n', 8, "unit_offline"),
    ],
)
def test_a_fault_of_a_built_in_alarm_is_named_with_its_line(
    tmp_path: Path, text: str, line: int, words: str
) -> None:
    fault = faults_of(tmp_path, CONFIGURED + text)
    assert words in fault
    assert fault.startswith(f"FILE:{line}: ")


def test_limits_are_judged_with_those_that_they_are_set_over(tmp_path: Path) -> None:
    everywhere = DEVIATION + "above_percent = 10\ndeadband_percent = 6\n"
    assert faults_of(tmp_path, CONFIGURED + everywhere) == ""
    fault = faults_of(tmp_path, CONFIGURED + everywhere + DEVIATION + OF_UNIT + "above_percent = 5\n")
    assert "deadband is wider than the limits" in fault
    assert fault.startswith("FILE:12: ")


def test_the_time_of_an_alarm_is_that_of_its_state_and_not_of_an_act() -> None:
    alarm = Alarm(built_in("estop_active", BUS, 1), AlarmFacts(active=True, came=5.0, since=9.0))
    assert alarm.state_at == 5.0
    alarm.facts = AlarmFacts(active=True, came=5.0, since=9.0, unknown_since=7.0)
    assert alarm.state_at == 7.0
    alarm.facts = AlarmFacts(acknowledged=False, came=5.0, since=9.0, cleared=8.0)
    assert alarm.state_at == 8.0
