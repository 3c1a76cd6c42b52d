"""A bus of three units with its alarms, on a clock that the test sets."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from app.core.database import Database
from app.line.alarms.alarm import Alarm
from app.line.alarms.bus_alarms import BusAlarms
from app.line.alarms.journal import AlarmStore
from app.line.alarms.settings import AlarmSettings, BuiltInAlarmSettings
from app.line.live.bus_live import LiveState
from app.people.audit.log import EventLog
from bus.contract import BusLink, ParameterValue, Reading, UnitLink, Update
from bus.messages import Message
from bus.settings import BusSettings, UnitLabels, UnitSettings

REMOTE, AT_SPEED = 0b0100_0000, 0b1000_0000
RUN, HEALTHY = 0b01, 0b10
BUS = "dry-end"


class AlarmBus:
    """``now`` is the clock of all. Every unit is online, in REMOTE, running at 1000 with one decimal."""

    def __init__(
        self,
        database: Database,
        *own: dict[str, Any],
        units: int = 3,
        tuned: Sequence[BuiltInAlarmSettings] = (),
    ) -> None:
        self.now = 1000.0
        self.step_s = 0.0
        self.drifted: set[int] = set()
        self.left_control: Callable[[], Message | None] = lambda: None
        self.events = EventLog(database)
        self.store = AlarmStore(database)
        settings = [
            AlarmSettings(**{"name": f"Own {i}", "bus": BUS, "unit": 1, **o}) for i, o in enumerate(own)
        ]
        self.settings = BusSettings(
            name=BUS,
            port="/dev/null",
            unit=tuple(
                UnitSettings(id=n + 1, name=f"Unit {n + 1}", labels=UnitLabels(analog="Tension"))
                for n in range(units)
            ),
        )
        self.live = LiveState([self.settings], self.now).buses[BUS]
        self.alarms = BusAlarms(
            self.live,
            settings,
            self.store,
            lambda unit: unit in self.drifted,
            lambda: self.left_control(),
            clock=lambda: self.now + self.step_s,
            monotonic=lambda: self.now,
            tuned=tuned,
        )

    def connect(self) -> None:
        """A worker connected, its port is open, every unit responds."""
        self.live.worker_lost = None
        units = range(1, len(self.live.units) + 1)
        self.apply(BusLink(at=self.now, link="open"))
        self.apply(*(UnitLink(unit=unit, at=self.now, link="online") for unit in units))
        self.apply(*(ParameterValue(unit=unit, number=3, at=self.now, raw=1) for unit in units))
        self.read(*units)

    def apply(self, *updates: Update) -> None:
        self.live.apply(list(updates))

    def read(self, *units: int, **changes: Any) -> None:
        """A reading of each unit, now."""
        fields: dict[str, Any] = {"commanded": 1000, "actual": 1000, "analog": 51, "inputs": RUN | HEALTHY}
        fields |= {"outputs": REMOTE | AT_SPEED, "at": self.now + self.step_s, **changes}
        self.apply(*(Reading(unit=unit, **fields) for unit in units))

    def wait(self, seconds: float, *units: int, **changes: Any) -> None:
        """Time passes in steps of half a second, with readings of ``units`` and the ticks of the app."""
        for _ in range(round(seconds * 2)):
            self.now += 0.5
            if units:
                self.read(*units, **changes)
            self.alarms.tick()
            self.alarms.list.advance(self.now + self.step_s)

    def alarm(self, key: str) -> Alarm:
        """By its key without the bus."""
        return self.alarms.list.alarms[f"{BUS}.{key}"]

    def own(self, name: str = "Own 0") -> Alarm:
        """One of the configuration."""
        (found,) = (a for a in self.alarms.list.alarms.values() if a.definition.name == name)
        return found

    def state(self, key: str) -> str:
        return self.alarm(key).facts.state

    def present(self) -> set[str]:
        """The keys of all that are not normal."""
        alarms = self.alarms.list.alarms.values()
        return {a.definition.key.removeprefix(f"{BUS}.") for a in alarms if a.facts.state != "normal"}
