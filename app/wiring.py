"""Makes every service once, and adds each to the lifespan of the server where it is made."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from contextlib import AbstractAsyncContextManager
from datetime import datetime
from functools import partial
from zoneinfo import ZoneInfo

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
from app.audit.anchoring import Anchoring, AnchorStatus, anchor_notice
from app.audit.configuration import change_since_last
from app.audit.keys import open_keys
from app.audit.log import EventLog
from app.audit.store import head_of
from app.auth.accounts import Accounts
from app.auth.identity import Identity
from app.auth.lasting import Rechecks
from app.auth.passwords import Passwords
from app.auth.rights import Rights
from app.auth.rules import Lifetimes
from app.auth.signin import SignIn
from app.bus_service import BusDependencies, BusService
from app.commands.catalogue import ROLES_BY_COMMAND
from app.commands.service.idempotency import IdempotencyCache
from app.commands.service.record import CommandRecord
from app.database import Database
from app.database.migrating import FIRST, Migration
from app.database.private import make_private
from app.database.reserve import Reserve
from app.feed.workers import Workers
from app.handover.document import SheetDocuments
from app.handover.pictures import PictureStore
from app.handover.service import Handover
from app.handover.signing import Signing
from app.history.pages import warm
from app.history.service import History, status_words
from app.history.status import store_notice
from app.lifespan import Lifespan
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


class Services:
    """Every service, once. A route finds one by its type."""

    def __init__(self, settings: Settings, *, demo: bool, worker_tokens: Mapping[str, str]) -> None:
        """Open the stores and make every service, each after those that it needs. Raises StoreError."""
        self.settings = settings
        self.lifespan = Lifespan()
        self.turns = Turns()
        make_private(settings.server.data)
        self._make_stores()
        self._make_event_log()
        self._make_people(worker_tokens)
        self._make_templates(demo=demo)
        self._make_records()
        self._make_buses()
        self._make_alarms()
        self._make_parameter_services()
        self._make_handover()
        self._make_screen()

    def _make_stores(self) -> None:
        """They are closed last, once an event states that the server ended."""
        self.reserve = Reserve(self.settings.server.data)
        self.lifespan.add("disk reserve", end=partial(asyncio.to_thread, self.reserve.close))
        self.database = Database(self.settings.server.store, reserve=self.reserve)
        self.lifespan.add("store", end=partial(asyncio.to_thread, self.database.close))
        self.history = history = History(self.settings)
        close_history = partial(asyncio.to_thread, history.close)
        self.lifespan.add("history", history.inspect_daily, start=self._start_history, end=close_history)

    def _make_event_log(self) -> None:
        settings, database = self.settings, self.database
        keys = open_keys(settings.key_files, database.path, database.read_now(head_of))
        self.events = events = EventLog(database, keys=keys)
        is_configured = settings.audit.anchor is not None
        self.anchoring = Anchoring(events, settings.anchor_file, is_configured=is_configured)
        self.lifespan.add("audit anchor", self.anchoring.follow, end=self.anchoring.end)
        self.lifespan.add("event log", start=self._record_start, once=events.index, end=self._record_end)
        record_all = partial(events.repeated.record_due, everything=True)
        self.lifespan.add("repeated events", events.repeated.follow, end=record_all)

    def _make_people(self, worker_tokens: Mapping[str, str]) -> None:
        site, names = self.settings.site.name, [bus.name for bus in self.settings.bus]
        self.passwords = Passwords()
        self.lifespan.add("passwords", end=partial(asyncio.to_thread, self.passwords.close))
        self.accounts = Accounts(self.database, self.passwords, self.events, buses=names, site=site)
        self.rechecks = Rechecks()
        self.rights = Rights(self.database, self.accounts, self.rechecks)
        self.lifespan.add("rights", self.rights.watch)
        lifetimes = Lifetimes.of(self.settings.server.sessions)
        self.sign_in = SignIn(
            self.database, self.passwords, self.events, lifetimes, site=site, rechecks=self.rechecks
        )
        self.identity = Identity(self.database, self.sign_in, worker_tokens)

    def _make_templates(self, *, demo: bool) -> None:
        self.assets = Assets(static_dir())
        compiled = self.settings.server.data / "compiled"
        self.templates = Templates(
            templates_dir(),
            self.assets,
            self.settings.site,
            demo=demo,
            kept_in=compiled,
            command_roles=ROLES_BY_COMMAND,
        )

    def _make_records(self) -> None:
        """Live state, and the events of its changes."""
        self.live = LiveState(self.settings.bus, unix_now())
        self.recorder = recorder = ChangeRecorder(self.events)
        self.lifespan.add("changes of the site", recorder.follow, finish=recorder.recorded)
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
            lifespan=self.lifespan,
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
        self.lifespan.add("expiry", self.expiry.follow)
        conditions = site_conditions(
            lambda: history.status, self._anchor_status, self.notification.dispatcher.is_failing, self.expiry
        )
        of_buses = {name: bus.alarms for name, bus in self.buses.items()}
        of_site = SiteAlarms(conditions, site_values(self.expiry), store, tuned=settings.built_in_alarm)
        self.alarms = LineAlarms(of_buses, of_site, store, self.events)
        self.own_alarms = OwnAlarmBook(settings, self.alarms, OwnAlarmStore(self.database), self.events)
        self.simulator = Simulator(history)
        # The site's own alarms first: the state of each is loaded after its definition. Notification last.
        self.lifespan.add("own alarms", start=self.own_alarms.load)
        self.lifespan.add("alarms", of_site.follow, start=self.alarms.load, end=self.alarms.write)
        notifier = self.notification.notifier(None, of_site.list, lambda _: "")
        works = (notifier.follow, self.notification.dispatcher.follow)
        self.lifespan.add("notification", *works, start=self.notification.load)

    def _make_parameter_services(self) -> None:
        """Parameter sets, restores, swaps and recipes."""
        commands = {name: bus.commands for name, bus in self.buses.items()}
        readers = {name: bus.reader for name, bus in self.buses.items()}
        self.takings = Takings()
        self.lifespan.add("readings of sets", end=self.takings.background.close)
        self.restores = restores = RestoreService(readers, commands, self.events, RestoreStore(self.database))
        self.lifespan.add("restores", start=restores.load, end=restores.background.close)
        self.swaps = SwapService(self.events, SwapStore(self.database), restores, unix_now)
        self.lifespan.add("swaps", start=self.swaps.load)
        self.recipes = RecipeBook(self.live, commands, RecipeStore(self.database), self.events)
        self.lifespan.add("recipes", start=self.recipes.load_marks)

    def _make_handover(self) -> None:
        self.pictures = PictureStore(self.settings.server.data, self.settings.shift.pictures_mb)
        self.lifespan.add("pictures", end=partial(asyncio.to_thread, self.pictures.close))
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
            notices=partial(_notices, history, self.anchoring, self.reserve),
            history_fault=lambda: history.status.message,
        )
        english = Translator(templates.languages[DEFAULT], templates.formats(DEFAULT))
        self.stream = LineStream(self.settings.site.name, live, self.sources, english, unix_now)
        self.lifespan.add("stream", self.stream.follow)
        self.alarms.subscribe(self._stream_alarm)
        watchers = {name: bus.feed.watch for name, bus in buses.items()}
        self.hub = Hub(live, self.sources, templates, watchers, unix_now)
        self.lifespan.add("browsers", self.hub.beat)
        self.head = PageHead(
            lambda language: banner.banner(Translator(language, templates.formats(language.tag)), unix_now())
        )
        held_control = {name: partial(_held_control, bus) for name, bus in buses.items()}
        of_buses = {name: bus.alarms for name, bus in buses.items()}
        self.control_watch = ControlWatch(of_buses, held_control, self.hub.people)
        self.lifespan.add("control", self.control_watch.follow)
        self.measured = MetricSources(
            live, lambda: self.hub.connected, Counts(self.events), self._anchor_status, self.alarms
        )
        self.onsets = OnsetLookup(live, partial(status_words, history), self.hub.refresh_unit, unix_now)
        self.lifespan.add("onsets", self.onsets.follow)
        language = self.settings.site.language
        self.lifespan.add("warming", once=partial(warm, history, templates, self.assets, language))

    async def _start_history(self) -> None:
        self.history.start()

    async def _record_start(self) -> None:
        """Close what the last run left open, then record what this one begins with."""
        events, data = self.events, self.settings.server.data
        await events.close_open_intents()
        if self.database.migrated:
            await events.record(kind="server", what=_store_changed(self.database.migrated))
        await events.record(kind="server", what=Message("event_server_started"))
        if events.keys.path is not None and events.keys.path.is_relative_to(data):
            await events.record(kind="audit", what=Message("event_audit_key_in_data"))
        settings = self.settings.model_dump(mode="json")
        if changed := await asyncio.to_thread(change_since_last, data, settings):
            what = Message("event_configuration_changed")
            await events.record(kind="configuration", what=what, message=changed)

    async def _record_end(self) -> None:
        await self.events.record(kind="server", what=Message("event_server_ended"))

    def _anchor_status(self) -> AnchorStatus:
        return self.anchoring.status

    def _stream_alarm(self, alarm: Alarm) -> None:
        self.stream.add("alarm", alarm.definition.bus, partial(alarm_json, self.alarms, alarm))


def _held_control(bus: BusService) -> HeldControl | None:
    holding = bus.safeguards.holding()
    return None if holding is None else (holding.holder, holding.used_at)


def _notices(
    history: History, anchoring: Anchoring, reserve: Reserve, translator: Translator, now: UnixTime
) -> str:
    """Faults of the records, in the reader's language; mostly none."""
    found = (
        store_notice(history.status, translator.formats, now),
        anchor_notice(anchoring.status, translator.formats, now),
        reserve.notice,
    )
    return " ".join(translator.t(notice) for notice in found if notice is not None)


def running(services: Services) -> AbstractAsyncContextManager[None]:
    """From the first request to the last: open commands are closed, and background tasks run."""
    return services.lifespan.running()


def _store_changed(steps: Sequence[Migration]) -> Message:
    """The event of a store that was brought up to date, or made."""
    if steps[0].number == FIRST:
        return Message("event_store_created")
    names = ", ".join(f"{step.number:04d} {step.name}" for step in steps)
    return Message.of("event_store_updated", steps=names)
