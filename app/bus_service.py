"""All that belongs to one bus: made once for each ``[[bus]]``, so that another server could be its home."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from functools import partial

from app.alarm_settings import AlarmSettings
from app.alarms.bus_alarms import BusAlarms
from app.alarms.notification.service import Notification
from app.alarms.store import AlarmStore
from app.audit.log import EventLog
from app.built_in_settings import BuiltInAlarmSettings
from app.commands.authority import SessionEnds, Withdrawals
from app.commands.safeguards.service import AccountLookup, Safeguards
from app.commands.service.command_service import CommandService
from app.commands.service.idempotency import IdempotencyCache
from app.commands.service.record import CommandRecord
from app.database import Database
from app.feed.bus_feed import BusFeed
from app.feed.channel import Channel
from app.history.service import History
from app.lifespan import Lifespan
from app.live.change_recorder import ChangeRecorder
from app.live.state.bus_live import BusLive
from app.pipeline import Pipeline
from app.sets.drift import BusDrift
from app.sets.first_write import FirstWrites
from app.sets.keeper import SetKeeper
from app.sets.reading import ParameterReader
from app.sets.schedule import SetSchedule
from app.sets.store import SetStore
from app.web.access import Person, Role

SERVER = Person("server", Role.VIEWER, "worker")
"""Author of automatic actions: the daily sets, and reading what is compared with a golden set. It reads."""


@dataclass(frozen=True, slots=True)
class BusDependencies:
    """What every bus needs of its site."""

    lifespan: Lifespan
    events: EventLog
    database: Database
    history: History
    sets: SetStore
    alarms: AlarmStore
    own_alarms: tuple[AlarmSettings, ...]
    built_in_alarms: tuple[BuiltInAlarmSettings, ...]
    notification: Notification
    rights: Withdrawals
    sessions: SessionEnds
    find_account: AccountLookup
    control_required: bool
    local_time: Callable[[], datetime]
    record: CommandRecord
    idempotency: IdempotencyCache


class BusService:
    """One bus: its live state, its worker's reports, and its commands, in the lifespan of the site."""

    def __init__(self, live: BusLive, site: BusDependencies) -> None:
        name = live.settings.name
        self._history = site.history
        self.live = live
        self.recorder = ChangeRecorder(site.events, name)
        self.pipeline = Pipeline(live, site.history, self.recorder)
        self.channel = Channel()
        self.feed = BusFeed(self.channel, self.pipeline)
        self.safeguards = Safeguards(
            name,
            site.database,
            site.events,
            control_required=site.control_required,
            find=site.find_account,
            rights=site.rights,
            sessions=site.sessions,
        )
        self.commands = CommandService(
            live, self.channel, site.record, site.idempotency, self.safeguards, site.rights
        )
        self.reader = ParameterReader(live, self.commands)
        self.drift = BusDrift(live, site.sets, site.events)
        self.sets = SetKeeper(live, self.reader, self.drift, site.sets, site.events, site.rights)
        own_alarms = [alarm for alarm in site.own_alarms if alarm.bus == name]
        self.alarms = BusAlarms(
            live,
            own_alarms,
            site.alarms,
            lambda unit: bool(self.drift.of(unit)),
            tuned=site.built_in_alarms,
        )
        self.notifier = site.notification.notifier(name, self.alarms.list, self.alarms.place)
        self.set_schedule = SetSchedule(live, self.sets, site.events, site.local_time)
        self.first_writes = FirstWrites(live, self.commands, self.sets, site.local_time)
        site.lifespan.add(
            f"bus {name}",
            self.recorder.follow,
            self.alarms.follow,
            self.notifier.follow,
            partial(self.set_schedule.follow, SERVER),
            partial(self.sets.learn_marked, SERVER),
            start=self._load,
            finish=self.recorder.recorded,
            end=self._close,
        )

    async def _load(self) -> None:
        self.feed.coverage.until = await self._history.newest(self.live.settings.name)
        await self.safeguards.load()
        await self.drift.load()

    async def _close(self) -> None:
        await self.first_writes.background.close()
        await self.drift.background.close()
