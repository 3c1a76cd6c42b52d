"""What people do to replace a unit. Its restore writes parameters, whose role each step needs.

One swap: who began it, what the spare shall become, what was seen since, the restore it led to.

Stores the swap of each section, so that it continues after a restart.

Unit replacement: choosing what the spare becomes, probing the wire, restoring, and the event at the end.

Swaps continue after a restart. Units are only read here; a restore writes.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine
from dataclasses import dataclass, field, replace
from typing import Any

from app.core.database import StoreConnection
from app.core.database.connection import upsert
from app.core.database.database import Tables, writing
from app.core.database.messages import messages_of, stored_messages
from app.core.web.admission.access import Person, account_shown
from app.engineering.sets.lookup import FormSource, side
from app.engineering.sets.model import ParameterSet, status_of
from app.engineering.sets.restore_plan import Restore
from app.engineering.sets.restore_service import RestoreService
from app.engineering.sets.saving import SetKeeper
from app.engineering.sets.store import SetStore
from app.engineering.swap.rules import FACTORY_ADDRESS, Advice, ProbeFinding, SwapState, finding
from app.errors import Problem, StoreError
from app.line.commands.api.responses import outcome_message
from app.line.commands.catalogue import WRITE_PARAMETER
from app.line.commands.service.command_service import CommandService
from app.line.live.bus_live import LiveState
from app.people.audit.acts import Act
from app.people.audit.log import EventLog
from bus.contract import ScanBus
from bus.instants import Clock, UnixTime
from bus.messages import Message, joined, listed, parameter_name

BEGIN = Act("begin_swap", WRITE_PARAMETER.role, "swap", "event_swap_begun")
CONFIRM_SPARE = Act("confirm_spare", WRITE_PARAMETER.role, "swap", "swap_named_by_person")
RESTORE_SPARE = Act("restore_spare", WRITE_PARAMETER.role, "swap", "event_swap_proven")
"""Recorded when a full read of the spare was equal."""
SAVE_ENTERED = Act("save_entered_spare", WRITE_PARAMETER.role, "swap", "event_swap_kept")
CANCEL = Act("cancel_swap", WRITE_PARAMETER.role, "swap", "event_swap_given_up")
ACTS = (BEGIN, CONFIRM_SPARE, RESTORE_SPARE, SAVE_ENTERED, CANCEL)


@dataclass(frozen=True, slots=True)
class SwapSource:
    """The unit of a stored set that the spare shall become: mostly the section's own, or a sister's."""

    set: int
    unit: int

    def message(self, unit: int) -> Message:
        """Which set, and of which unit where that is another than ``unit``."""
        if self.unit == unit:
            return Message.of("set_numbered", set=self.set)
        return Message.of("set_of_unit", set=self.set, unit=self.unit)


@dataclass(slots=True)
class Swap:
    """``source`` None: nothing is stored, the spare is entered from the sheet. ``is_new``: the unit at
    the section's address is the spare, as the address was empty at the beginning or a person confirmed it.
    ``seen``: findings on the wire, each once, in order."""

    bus: str
    unit: int
    who: str
    source: SwapSource | None
    began_at: UnixTime
    is_new: bool = False
    seen: list[Message] = field(default_factory=list)
    restore: Restore | None = None
    proven: bool = False
    state: SwapState | None = None
    """What the last look showed."""
    look: asyncio.Task[SwapState] | None = None

    def saw(self, state: SwapState) -> bool:
        """The wire was looked at; whether it showed anything new."""
        self.state = state
        before = self.is_new, len(self.seen)
        if state.at_target == "silent":
            self.is_new = True
        found = finding(state)
        if not self.seen or self.seen[-1] != found:
            self.seen.append(found)
        return before != (self.is_new, len(self.seen))

    @property
    def equal(self) -> bool | None:
        """Whether the spare equals the set, by the full read after the last restore."""
        if self.proven:
            return True
        if self.restore is None or self.restore.state == "planned":
            return None
        return self.restore.state == "equal"

    @property
    def not_restored(self) -> list[int]:
        """The rows of the set that the spare was not given, as it lacks them or they were not chosen."""
        restore = self.restore
        if restore is None:
            return []
        return [
            left.number
            for left in restore.left_out
            if left.reason != "address" and restore.wanted.raw(left.number) is not None
        ]

    @property
    def source_message(self) -> Message:
        """Where its parameters come from."""
        return Message("swap_sheet") if self.source is None else self.source.message(self.unit)

    @property
    def story(self) -> Message:
        """What was seen, in order."""
        return Message.of("swap_seen", findings=listed(self.seen))


_VALUES = ("who", "began_at", "set_id", "set_unit", "is_new", "proven", "restore_id", "seen")
FindRestore = Callable[[str], Awaitable[Restore | None]]


class SwapStore(Tables):
    """All access to the table of swaps."""

    @writing
    def save(self, connection: StoreConnection, swap: Swap) -> None:
        """Store the present state in place of the section's earlier one."""
        row = (
            swap.bus,
            swap.unit,
            swap.who,
            swap.began_at,
            swap.source.set if swap.source else None,
            swap.source.unit if swap.source else None,
            swap.is_new,
            swap.proven,
            swap.restore.id if swap.restore else None,
            stored_messages(swap.seen),
        )
        connection.execute(upsert("swap", ("bus", "unit"), _VALUES), row)

    @writing
    def remove(self, connection: StoreConnection, swap: Swap) -> None:
        connection.execute("DELETE FROM swap WHERE bus = ? AND unit = ?", (swap.bus, swap.unit))

    async def load(self, find_restore: FindRestore) -> list[Swap]:
        """Return every swap that was not closed, with the restore that it led to."""
        rows = await self.database.read(_select)
        for swap, restore_id in rows:
            swap.restore = await find_restore(restore_id) if restore_id else None
        return [swap for swap, _ in rows]


def _select(connection: StoreConnection) -> list[tuple[Swap, str | None]]:
    found = connection.execute(
        "SELECT bus, unit, who, began_at, set_id, set_unit, is_new, proven, seen, restore_id FROM swap"
    )
    return [
        (
            Swap(
                bus,
                unit,
                who,
                None if set_id is None else SwapSource(set_id, set_unit),
                began_at,
                is_new=bool(is_new),
                proven=bool(proven),
                seen=messages_of(seen),
            ),
            restore_id,
        )
        for bus, unit, who, began_at, set_id, set_unit, is_new, proven, seen, restore_id in found
    ]


LOOK_WAIT_S = 2.0
"""How long a page waits for a probe before it shows the previous finding."""


class SwapService:
    """Keeps the swap of each unit, until it is ended or another of the unit begins."""

    def __init__(self, events: EventLog, store: SwapStore, restores: RestoreService, clock: Clock) -> None:
        self._events = events
        self._store = store
        self._clock = clock
        self._swaps: dict[tuple[str, int], Swap] = {}
        self._restores = restores
        restores.on_end(self.on_restore_end)

    async def load(self) -> None:
        """Take up, after the restores, the swaps that were under way when the server ended."""
        self._swaps = {(swap.bus, swap.unit): swap for swap in await self._store.load(self._restores.find)}

    def of(self, bus: str, unit: int) -> Swap | None:
        """The swap of a section, under way or just ended."""
        return self._swaps.get((bus, unit))

    def of_or_404(self, bus: str, unit: int) -> Swap:
        """The swap of a section. Raises Problem 404 where none is begun."""
        swap = self.of(bus, unit)
        if swap is None:
            raise _not_begun(unit)
        return swap

    def _refuse_closed(self, swap: Swap) -> None:
        """Raise Problem 404 where it was closed while its unit was read: another may have begun since."""
        if self.of(swap.bus, swap.unit) is not swap:
            raise _not_begun(swap.unit)

    async def begin(self, person: Person, bus: str, unit: int, source: SwapSource | None) -> Swap:
        """Begin the swap of a section's unit; ``source`` is what the spare shall become.

        Raises Problem 409 where another swap of it is under way.
        """
        BEGIN.check(person)
        under_way = self.of(bus, unit)
        if under_way is not None and not under_way.proven:
            other = Message.of("swap_under_way", who=account_shown(under_way.who), unit=unit)
            raise Problem(409, "busy", other)
        swap = Swap(bus, unit, person.name, source, self._clock())
        # Before the wait for the store: of two who begin at once, one is refused.
        self._swaps[bus, unit] = swap
        try:
            await self._store.save(swap)
        except StoreError:
            self._swaps.pop((bus, unit))
            raise
        performed = BEGIN.by(person, source=swap.source_message)
        await self._events.record(**performed, bus=bus, unit=unit)
        return swap

    async def look(self, swap: Swap, look: Callable[[], Coroutine[Any, Any, SwapState]]) -> SwapState | None:
        """The finding on the wire, or the previous one where a probe takes long; None before the first.

        One probe at a time: it takes the gaps of the scan, and a page that is reloaded must not pile up more.
        Raises the Problem that ended the probe.
        """
        running = swap.look = swap.look or asyncio.create_task(
            look(), name=f"look for the spare of {swap.unit}"
        )
        done, _ = await asyncio.wait({running}, timeout=LOOK_WAIT_S)
        if done and swap.look is running:
            swap.look = None
            if swap.saw(running.result()) and self.of(swap.bus, swap.unit) is swap:
                await self._store.save(swap)
        if swap.state is None:
            return None
        return replace(swap.state, is_new=swap.is_new, equal=swap.equal)

    async def confirm_spare(self, person: Person, swap: Swap) -> None:
        """A person confirmed that the unit at the section's address is the spare."""
        CONFIRM_SPARE.check(person)
        self._refuse_closed(swap)
        swap.is_new = True
        swap.seen.append(Message(CONFIRM_SPARE.event))
        await self._store.save(swap)

    async def begin_restore(self, person: Person, swap: Swap, restore: Restore) -> None:
        """The restore of it has been planned."""
        RESTORE_SPARE.check(person)
        self._refuse_closed(swap)
        swap.restore = restore
        await self._store.save(swap)

    async def cancel(self, person: Person, swap: Swap) -> None:
        """Close a swap that is not continued, or that was verified."""
        CANCEL.check(person)
        self._refuse_closed(swap)
        del self._swaps[swap.bus, swap.unit]
        await self._store.remove(swap)
        if not swap.proven:
            performed = CANCEL.by(person)
            await self._events.record(**performed, bus=swap.bus, unit=swap.unit, message=swap.story)

    async def on_restore_end(self, restore: Restore) -> None:
        """A restore is over: where it belongs to a swap and the full read was equal, so is the swap. What a
        restore of another set finds equal is nothing about the set of the swap."""
        swap = self.of(restore.bus, restore.unit)
        if swap is None or not restore.for_swap or restore.planned_at < swap.began_at or swap.proven:
            return
        swap.restore = restore
        swap.proven = restore.state == "equal"
        await self._store.save(swap)
        if not swap.proven:
            return
        account = restore.account() or Message("restore_wrote_nothing")
        left_out = [Message.of("at_row", number=left.number, why=left.text) for left in restore.left_out]
        story = [
            swap.story,
            Message.of("swap_restored", source=swap.source_message, account=account),
            Message.of("rows_left_out", rows=listed(left_out)) if left_out else None,
            Message("proven_by_full_read"),
        ]
        await self._events.record(
            kind=RESTORE_SPARE.kind,
            who=restore.who,
            bus=swap.bus,
            unit=swap.unit,
            what=Message(RESTORE_SPARE.event),
            message=joined(story) or "",
            outcome="verified",
        )

    async def save_entered(self, person: Person, swap: Swap, kept: ParameterSet) -> None:
        """Everything was entered from the sheet, and the complete unit was read and saved as ``kept``."""
        SAVE_ENTERED.check(person)
        self._refuse_closed(swap)
        swap.proven = True
        await self._store.save(swap)
        story = joined([swap.story, Message("entered_from_sheet"), Message.of("kept_as_set", set=kept.id)])
        await self._events.record(
            **SAVE_ENTERED.by(person), bus=swap.bus, unit=swap.unit, message=story or "", outcome="verified"
        )


def _not_begun(unit: int) -> Problem:
    return Problem(404, "unknown_swap", Message.of("swap_not_begun", unit=unit))


def step_text(advice: Advice, swap: Swap) -> Message:
    """What to do; of a restore that was tried how it ended, of a sheet what to do with it."""
    if swap.source is None and advice.step == "restore":
        return Message("swap_enter_sheet")
    if swap.source is None and advice.step == "proven":
        return Message("swap_compare_with_sheet")
    if advice.step == "proven" and (kept := swap.not_restored):
        return Message.of("swap_proven_except", rows=listed([parameter_name(number) for number in kept]))
    if advice.step == "restore" and swap.restore is not None and swap.equal is False:
        return Message("swap_restore_unfinished")
    return advice.text


LOOK_TIMEOUT_S = 30.0
MAX_PROBES = 4
"""Attempts at an address whose unit still responds to the scan."""


async def look(commands: CommandService, live: LiveState, person: Person, swap: Swap) -> SwapState:
    """Probe the wire. Raises Problem 503 where it cannot: the bus is closed, or too busy."""
    bus, target = swap.bus, swap.unit
    at_target = await _at_section(commands, live, person, bus, target)
    at_factory: ProbeFinding = "silent"
    if at_target == "silent" and target != FACTORY_ADDRESS:
        at_factory = await _probe(commands, person, FACTORY_ADDRESS)
    line, unit = live.buses[bus], live.buses[bus].units[target]
    # REMOTE counts as the unit reported it since it came back.
    is_back = at_target == "digimax" and unit.link.link == "online"
    status = status_of(line, unit) if is_back else None
    return SwapState(
        target=target,
        at_target=at_target,
        at_factory=at_factory,
        remote=None if status is None else status.remote,
        equal=swap.equal,
        is_new=swap.is_new,
        configured=frozenset(line.units),
        baud=line.baud,
    )


async def _at_section(
    commands: CommandService, live: LiveState, person: Person, bus: str, unit: int
) -> ProbeFinding:
    """One lost response is no absence: it would let the old unit, still on the cable, pass for the spare."""
    for _ in range(MAX_PROBES):
        kind = await _probe(commands, person, unit)
        if kind != "silent" or live.buses[bus].units[unit].link.link != "online":
            return kind
    return "silent"


async def _probe(commands: CommandService, person: Person, address: int) -> ProbeFinding:
    action = ScanBus(first=address, last=address)
    result = await commands.send(person, action, timeout_s=LOOK_TIMEOUT_S, origin="unit swap")
    if result.outcome != "verified":
        raise Problem(503, "not_looked", outcome_message(result))
    return next((found.kind for found in result.found if found.unit == address), "silent")


SHEET = "sheet"
"""Nothing is stored: a person enters the values."""


async def source_of(
    person: Person,
    keepers: Callable[[str], SetKeeper],
    sets: SetStore,
    live: LiveState,
    bus: str,
    unit: int,
    form: FormSource,
) -> SwapSource | None:
    """What the form chooses, as a stored set: a neighbor is read now, a file is kept. None: the sheet.

    ``keepers``: by bus. Raises Problem 403, 404, 422 or 504.
    """
    BEGIN.check(person)
    if form.file and (rows := await form.uploaded(unit)):
        name = (form.file.filename or "")[:80]
        kept = await keepers(bus).save(person, [rows], "from a file", name)
        return SwapSource(kept.id, rows.unit)
    if form.text == SHEET:
        return None
    if not form.text:
        raise Problem(422, "invalid", Message("spare_not_chosen"))
    chosen = await side(form.text, sets, live)
    if chosen.kind == "set":
        return SwapSource(int(chosen.of), chosen.unit)
    kept = await keepers(chosen.of).read_and_save(person, [chosen.unit], origin="for a unit swap")
    return SwapSource(kept.id, chosen.unit)
