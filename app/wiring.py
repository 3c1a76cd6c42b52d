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
from app.web.page_head import PageHead
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
        self.settings = settings
        make_private(settings.server.data)
        self.database = Database(settings.server.store)
        keys = open_keys(settings.key_files, self.database.path, self.database.read_now(head_of))
        self.events = EventLog(self.database, keys=keys)
        self.anchoring = (
            None if settings.audit.anchor is None else Anchoring(self.events, settings.audit.anchor)
        )
        self.turns = Turns()
        self._make_people(worker_tokens)
        self._make_templates(demo=demo)
        self._make_records()
        self._make_buses()
        self._make_alarms()
        self._make_parameter_services()
        self._make_handover()
        self._make_screen()

    def _make_people(self, worker_tokens: Mapping[str, str]) -> None:
        site, names = self.settings.site.name, [bus.name for bus in self.settings.bus]
        self.passwords = Passwords()
        self.accounts = Accounts(self.database, self.passwords, self.events, buses=names, site=site)
        self.rights = Rights(self.database, self.accounts)
        lifetimes = Lifetimes.of(self.settings.server.sessions)
        self.sign_in = SignIn(self.database, self.passwords, self.events, lifetimes, site=site)
        self.identity = Identity(self.database, self.sign_in, worker_tokens)

    def _make_templates(self, *, demo: bool) -> None:
        self.assets = Assets(static_dir())
        compiled = self.settings.server.data / "compiled"
        self.templates = Templates(
            templates_dir(), self.assets, self.settings.site, demo=demo, kept_in=compiled
        )

    def _make_records(self) -> None:
        """Live state, history and the events of their changes."""
        self.live = LiveState(self.settings.bus, unix_now())
        self.history = History(self.settings)
        self.recorder = ChangeRecorder(self.events)
        self.history.on_fault(
            lambda kind, what, at: self.recorder.note(LineEvent(kind, None, at, what, "", ""))
        )

    def _make_buses(self) -> None:
        settings, database = self.settings, self.database
        self.sets, self._alarm_store = SetStore(database), AlarmStore(database)
        local_time = partial(datetime.now, ZoneInfo(settings.site.zone))
        self.notification = Notification(
            settings, database, self.events, self.templates.languages, local_time
        )
        of_site = BusDependencies(
            events=self.events,
            database=database,
            history=self.history,
            rights=self.rights,
            sessions=self.sign_in,
            find_account=self.accounts.find,
            control_required=settings.site.control,
            sets=self.sets,
            alarms=self._alarm_store,
            own_alarms=settings.alarm,
            built_in_alarms=settings.built_in_alarm,
            notification=self.notification,
            local_time=local_time,
            record=CommandRecord(self.events, database, unix_now),
            idempotency=IdempotencyCache(),
        )
        self.buses = {name: BusService(bus, of_site) for name, bus in self.live.buses.items()}
        self.workers = Workers({name: bus.feed for name, bus in self.buses.items()}, self.recorder)

    def _make_alarms(self) -> None:
        settings, history, store = self.settings, self.history, self._alarm_store
        self.expiry = ExpiryWatch(self.accounts.tokens, certificates_of(settings.notify))
        conditions = site_conditions(
            lambda: history.status, self._anchor_status, self.notification.dispatcher.is_failing, self.expiry
        )
        of_buses = {name: bus.alarms for name, bus in self.buses.items()}
        of_site = SiteAlarms(conditions, site_values(self.expiry), store, tuned=settings.built_in_alarm)
        self.alarms = LineAlarms(of_buses, of_site, store, self.events)
        self.own_alarms = OwnAlarmBook(settings, self.alarms, OwnAlarmStore(self.database), self.events)
        self.simulator = Simulator(history)

    def _make_parameter_services(self) -> None:
        """Parameter sets, restores, swaps and recipes."""
        commands = {name: bus.commands for name, bus in self.buses.items()}
        readers = {name: bus.reader for name, bus in self.buses.items()}
        self.takings = Takings()
        self.restores = RestoreService(readers, commands, self.events, RestoreStore(self.database))
        self.swaps = SwapService(self.events, SwapStore(self.database), self.restores, unix_now)
        self.recipes = RecipeBook(self.live, commands, RecipeStore(self.database), self.events)

    def _make_handover(self) -> None:
        self.pictures = PictureStore(self.settings.server.data)
        self.handover = Handover(self.settings, self.database, self.events, self.pictures)
        self.documents = SheetDocuments(self.templates, self.assets, self.alarms, self.pictures)
        self.signing = Signing(self.handover, self.database, self.events, self.sign_in, self.documents.page)

    def _make_screen(self) -> None:
        """What browsers and programs are sent as it changes."""
        live, history, buses, templates = self.live, self.history, self.buses, self.templates
        banner = AlarmBanner(self.alarms)
        self.sources = Sources(
            guards={name: bus.safeguards for name, bus in buses.items()},
            drift={name: bus.drift for name, bus in buses.items()},
            recipes=self.recipes,
            alarms=banner,
            notices=partial(_notices, history, self.anchoring),
            history_fault=lambda: history.status.message,
        )
        english = Translator(templates.languages[DEFAULT], templates.formats(DEFAULT))
        self.stream = LineStream(self.settings.site.name, live, self.sources, english, unix_now)
        self.alarms.subscribe(self._stream_alarm)
        watchers = {name: bus.feed.watch for name, bus in buses.items()}
        self.hub = Hub(live, self.sources, templates, watchers, unix_now)
        self.head = PageHead(
            lambda language: banner.banner(Translator(language, templates.formats(language.tag)), unix_now())
        )
        held_control = {name: partial(_held_control, bus) for name, bus in buses.items()}
        of_buses = {name: bus.alarms for name, bus in buses.items()}
        self.control_watch = ControlWatch(of_buses, held_control, self.hub.people)
        self.measured = MetricSources(
            live, lambda: self.hub.connected, Counts(self.events), self._anchor_status, self.alarms
        )
        self.onsets = OnsetLookup(live, partial(status_words, history), self.hub.refresh_unit, unix_now)

    def _anchor_status(self) -> AnchorStatus:
        return _status_of(self.anchoring)

    def _stream_alarm(self, alarm: Alarm) -> None:
        self.stream.add("alarm", alarm.definition.bus, partial(alarm_json, self.alarms, alarm))


def _held_control(bus: BusService) -> HeldControl | None:
    holding = bus.safeguards.holding()
    return None if holding is None else (holding.holder, holding.used_at)


def _status_of(anchoring: Anchoring | None) -> AnchorStatus:
    return AnchorStatus() if anchoring is None else anchoring.status


def _notices(history: History, anchoring: Anchoring | None, translator: Translator, now: UnixTime) -> str:
    """Faults of the records, in the reader's language; mostly none."""
    found = (
        store_notice(history.status, translator.formats, now),
        anchor_notice(_status_of(anchoring), translator.formats, now),
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
