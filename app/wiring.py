"""Makes every service once, starts them, and ends them in order."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from datetime import datetime
from functools import partial
from zoneinfo import ZoneInfo

import structlog

from app.alarms.alarm import Alarm
from app.alarms.banner import AlarmBanner
from app.alarms.control_watch import ControlWatch, HeldControl
from app.alarms.expiry_watch import ExpiryWatch, certificates_of
from app.alarms.line_alarms import LineAlarms
from app.alarms.notification.service import Notification
from app.alarms.own_book import OwnAlarmBook
from app.alarms.own_store import OwnAlarmStore
from app.alarms.shown import alarm_json
from app.alarms.simulation.simulator import Simulator
from app.alarms.site_alarms import SiteAlarms, site_conditions, site_values
from app.alarms.store import AlarmStore
from app.audit.anchoring import AT_END_S, Anchoring, AnchorStatus, anchor_notice
from app.audit.configuration import change_since_last
from app.audit.keys import open_keys
from app.audit.log import EventLog
from app.audit.store import head_of
from app.auth.accounts import Accounts
from app.auth.identity import Identity
from app.auth.passwords import Passwords
from app.auth.rights import Rights
from app.auth.rules import Lifetimes
from app.auth.signin import SignIn
from app.bus_service import BusDependencies, BusService
from app.commands.service.idempotency import IdempotencyCache
from app.commands.service.record import CommandRecord
from app.database import Database
from app.database.migrating import FIRST, Migration
from app.database.private import make_private
from app.feed.workers import Workers
from app.handover.document import SheetDocuments
from app.handover.pictures import PictureStore
from app.handover.service import Handover
from app.handover.signing import Signing
from app.history.pages import warm
from app.history.service import History, status_words
from app.history.status import store_notice
from app.live.api.line_stream import LineStream
from app.live.browsers.hub import Hub
from app.live.change_recorder import ChangeRecorder
from app.live.changes import LineEvent
from app.live.screen.fields import Translator
from app.live.screen.sources import Sources
from app.live.state.bus_live import LiveState
from app.live.state.onset_lookup import OnsetLookup
from app.messages import DEFAULT
from app.metrics.api import Counts, MetricSources
from app.recipes.book import RecipeBook
from app.recipes.store import RecipeStore
from app.sets.restore import RestoreService
from app.sets.restore_store import RestoreStore
from app.sets.store import SetStore
from app.sets.taking import Takings
from app.settings import Settings
from app.swap.service import SwapService
from app.swap.store import SwapStore
from app.web.assets import Assets, static_dir, templates_dir
from app.web.templating import Templates
from app.web.turns import Turns
from bus.instants import UnixTime, unix_now
from bus.messages import Message

log = structlog.get_logger()

AGAIN_AFTER_S = 1.0
RECORDED_WITHIN_S = 1.0
"""What the end waits for the last changes of the line to be written down."""


class Services:
    """Every service, once. A route finds one by its type."""

    def __init__(self, settings: Settings, *, demo: bool, worker_tokens: Mapping[str, str]) -> None:
        """Open the stores and make every service, each after those that it needs. Raises StoreError."""
        self.settings, site = settings, settings.site
        make_private(settings.server.data)
        self.database = database = Database(settings.server.store)
        keys = open_keys(settings.key_files, database.path, database.read_now(head_of))
        self.events = events = EventLog(database, keys=keys)
        self.passwords = Passwords()
        self.anchoring = None if settings.audit.anchor is None else Anchoring(events, settings.audit.anchor)
        self.assets = Assets(static_dir())
        compiled = settings.server.data / "compiled"
        self.templates = templates = Templates(
            templates_dir(), self.assets, site, demo=demo, kept_in=compiled
        )
        names = [bus.name for bus in settings.bus]
        self.accounts = Accounts(database, self.passwords, events, buses=names, site=site.name)
        self.rights = Rights(database, self.accounts)
        lifetimes = Lifetimes.of(settings.server.sessions)
        self.sign_in = SignIn(database, self.passwords, events, lifetimes, site=site.name)
        self.identity = Identity(database, self.sign_in, worker_tokens)
        self.live = live = LiveState(settings.bus, unix_now())
        self.history = history = History(settings)
        self.recorder = ChangeRecorder(events)
        history.on_fault(lambda kind, what, at: self.recorder.note(LineEvent(kind, None, at, what, "", "")))
        self.sets, alarm_store = SetStore(database), AlarmStore(database)
        local_time = partial(datetime.now, ZoneInfo(site.zone))
        self.notification = Notification(settings, database, events, templates.languages, local_time)
        of_site = BusDependencies(
            events=events,
            database=database,
            history=history,
            rights=self.rights,
            sessions=self.sign_in,
            find_account=self.accounts.find,
            control_required=site.control,
            sets=self.sets,
            alarms=alarm_store,
            own_alarms=settings.alarm,
            built_in_alarms=settings.built_in_alarm,
            notification=self.notification,
            local_time=local_time,
            record=CommandRecord(events, database, unix_now),
            idempotency=IdempotencyCache(),
        )
        self.buses = buses = {name: BusService(bus, of_site) for name, bus in live.buses.items()}
        self.expiry = ExpiryWatch(self.accounts.tokens, certificates_of(settings.notify))
        anchor_status = partial(_anchor_status, self.anchoring)
        conditions = site_conditions(
            lambda: history.status, anchor_status, self.notification.dispatcher.is_failing, self.expiry
        )
        of_buses = {name: bus.alarms for name, bus in buses.items()}
        site_alarms = SiteAlarms(
            conditions, site_values(self.expiry), alarm_store, tuned=settings.built_in_alarm
        )
        self.alarms = LineAlarms(of_buses, site_alarms, alarm_store, events)
        self.own_alarms = OwnAlarmBook(settings, self.alarms, OwnAlarmStore(database), events)
        self.simulator = Simulator(history)
        self.pictures = PictureStore(settings.server.data)
        self.handover = Handover(settings, database, events, self.pictures)
        self.documents = SheetDocuments(templates, self.assets, self.alarms, self.pictures)
        self.signing = Signing(self.handover, database, events, self.sign_in, self.documents.page)
        self.workers = Workers({name: bus.feed for name, bus in buses.items()}, self.recorder)
        commands = {name: bus.commands for name, bus in buses.items()}
        readers = {name: bus.reader for name, bus in buses.items()}
        self.takings = Takings()
        self.restores = RestoreService(readers, commands, events, RestoreStore(database))
        self.swaps = SwapService(events, SwapStore(database), self.restores, unix_now)
        self.recipes = RecipeBook(live, commands, RecipeStore(database), events)
        self.sources = Sources(
            guards={name: bus.safeguards for name, bus in buses.items()},
            drift={name: bus.drift for name, bus in buses.items()},
            recipes=self.recipes,
            alarms=AlarmBanner(self.alarms),
            notices=partial(_notices, history, self.anchoring),
            history_fault=lambda: history.status.message,
        )
        english = Translator(templates.languages[DEFAULT], templates.formats(DEFAULT))
        self.stream = LineStream(site.name, live, self.sources, english, unix_now)
        self.alarms.subscribe(self._stream_alarm)
        watchers = {name: bus.feed.watch for name, bus in buses.items()}
        self.hub = hub = Hub(live, self.sources, templates, watchers, unix_now)
        held_control = {name: partial(_held_control, bus) for name, bus in buses.items()}
        self.control_watch = ControlWatch(of_buses, held_control, hub.people)
        self.measured = MetricSources(live, lambda: hub.connected, Counts(events), anchor_status, self.alarms)
        self.onsets = OnsetLookup(live, partial(status_words, history), hub.refresh_unit, unix_now)
        self.turns = Turns()

    def _stream_alarm(self, alarm: Alarm) -> None:
        self.stream.add("alarm", alarm.definition.bus, partial(alarm_json, self.alarms, alarm))


def _held_control(bus: BusService) -> HeldControl | None:
    holding = bus.safeguards.holding()
    return None if holding is None else (holding.holder, holding.used_at)


def _anchor_status(anchoring: Anchoring | None) -> AnchorStatus:
    return AnchorStatus() if anchoring is None else anchoring.status


def _notices(history: History, anchoring: Anchoring | None, translator: Translator, now: UnixTime) -> str:
    """Faults of the records, in the reader's language; mostly none."""
    found = (
        store_notice(history.status, translator.formats, now),
        anchor_notice(_anchor_status(anchoring), translator.formats, now),
    )
    return " ".join(translator.t(notice) for notice in found if notice is not None)


@asynccontextmanager
async def running(services: Services) -> AsyncIterator[None]:
    """From the first request to the last: open commands are closed, and background tasks run."""
    site_notifier = services.notification.notifier(None, services.alarms.site.list, lambda _: "")
    await _begin(services)
    works = (
        *((services.anchoring.follow,) if services.anchoring else ()),
        services.events.repeated.follow,
        services.recorder.follow,
        services.alarms.site.follow,
        services.expiry.follow,
        services.control_watch.follow,
        site_notifier.follow,
        services.notification.dispatcher.follow,
        *(work for bus in services.buses.values() for work in bus.works()),
        services.hub.beat,
        services.stream.follow,
        services.onsets.follow,
        services.history.inspect_daily,
        services.rights.watch,
    )
    tasks = [asyncio.create_task(_restarted(work)) for work in works]
    language = services.settings.site.language
    tasks.append(asyncio.create_task(services.events.index()))
    tasks.append(asyncio.create_task(warm(services.history, services.templates, services.assets, language)))
    try:
        yield
    finally:
        with suppress(TimeoutError):
            async with asyncio.timeout(RECORDED_WITHIN_S):
                recorders = (services.recorder, *(bus.recorder for bus in services.buses.values()))
                await asyncio.gather(*(recorder.recorded() for recorder in recorders))
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        await services.alarms.write()
        await _end(services)


def _store_changed(steps: Sequence[Migration]) -> Message:
    """The event of a store that was brought up to date, or made."""
    if steps[0].number == FIRST:
        return Message("event_store_created")
    names = ", ".join(f"{step.number:04d} {step.name}" for step in steps)
    return Message.of("event_store_updated", steps=names)


async def _begin(services: Services) -> None:
    services.history.start()
    await services.events.close_open_intents()
    if services.database.migrated:
        await services.events.record(kind="server", what=_store_changed(services.database.migrated))
    await services.events.record(kind="server", what=Message("event_server_started"))
    key_file = services.events.keys.path
    if key_file is not None and key_file.is_relative_to(services.settings.server.data):
        await services.events.record(kind="audit", what=Message("event_audit_key_in_data"))
    changed = await asyncio.to_thread(
        change_since_last, services.settings.server.data, services.settings.model_dump(mode="json")
    )
    if changed:
        await services.events.record(
            kind="configuration", what=Message("event_configuration_changed"), message=changed
        )
    for bus in services.buses.values():
        await bus.load()
    await services.own_alarms.load()
    await services.alarms.load()
    await services.notification.load()
    await services.restores.load()
    await services.swaps.load()
    await services.recipes.load_marks()


async def _end(services: Services) -> None:
    await services.takings.background.close()
    for bus in services.buses.values():
        await bus.close()
    await services.restores.background.close()
    await services.events.repeated.record_due(everything=True)
    await services.events.record(kind="server", what=Message("event_server_ended"))
    if services.anchoring is not None:
        with suppress(TimeoutError):
            async with asyncio.timeout(AT_END_S):
                await services.anchoring.export(AT_END_S)
    await asyncio.to_thread(services.history.close)
    services.passwords.close()
    await asyncio.to_thread(services.pictures.close)
    await asyncio.to_thread(services.database.close)


async def _restarted(work: Callable[[], Awaitable[None]]) -> None:
    """Run ``work``; a failure is logged, and it starts again."""
    while True:
        try:
            await work()
        except Exception:
            log.exception("failed, goes on")
        await asyncio.sleep(AGAIN_AFTER_S)
