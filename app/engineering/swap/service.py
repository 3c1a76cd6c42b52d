"""The service of unit swaps: the values for the spare, the probes, the restore, the event at the end.

Swaps are stored and continue after a restart. The service only reads units; a restore writes.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field, replace

from app.core.database import StoreConnection
from app.core.database.connection import messages_of, stored_messages, upsert
from app.core.database.database import Tables, writing
from app.core.web.access import Person, account_shown
from app.core.web.arrival import Deadline
from app.engineering.sets.lookup import FormSource, side
from app.engineering.sets.model import ParameterSet, status_of
from app.engineering.sets.restore_plan import Restore
from app.engineering.sets.restore_service import RestoreService
from app.engineering.sets.saving import SetKeeper
from app.engineering.swap.rules import FACTORY_ADDRESS, Advice, LostUnit, ProbeFinding, SwapState, finding
from app.errors import Problem, StoreError, or_404
from app.line.commands.catalogue import WRITE_PARAMETER
from app.line.commands.review import outcome_message
from app.line.commands.service import CommandService
from app.line.live.bus_live import BusLive, LiveState
from app.line.live.requests import unit_or_404
from app.people.audit.acts import Act
from app.people.audit.log import EventLog
from bus.contract import ScanBus, UnitLink
from bus.instants import UnixTime, unix_now
from bus.messages import Message, joined, listed, parameter_name

BEGIN = Act("begin_swap", WRITE_PARAMETER.role, "swap", "event_swap_begun")
CONFIRM_SPARE = Act("confirm_spare", WRITE_PARAMETER.role, "swap", "swap_named_by_person")
RESTORE_SPARE = Act("restore_spare", WRITE_PARAMETER.role, "swap", "event_swap_proven")
"""Recorded when a full read of the spare equals the set."""
SAVE_ENTERED = Act("save_entered_spare", WRITE_PARAMETER.role, "swap", "event_swap_kept")
CANCEL = Act("cancel_swap", WRITE_PARAMETER.role, "swap", "event_swap_given_up")
ACTS = (BEGIN, CONFIRM_SPARE, RESTORE_SPARE, SAVE_ENTERED, CANCEL)
"""Each step needs the role for writing parameters, as a restore does."""

_SHEET = "sheet"
"""The source in a form if no set is stored: a person enters the values of the parameter sheet."""
PROBE_WAIT_S = 2.0
"""The time that a page waits for a probe before it shows the previous one."""
_PROBE_TIMEOUT_S = 30.0
MAX_PROBES = 4
"""The attempts at an address whose unit still responds to the scan."""


@dataclass(frozen=True, slots=True)
class SwapSource:
    """The unit of a stored set that the spare shall equal: the section's own unit, or a similar one."""

    set: int
    unit: int

    def message(self, unit: int) -> Message:
        """Name the set, and its unit if it differs from ``unit``."""
        if self.unit == unit:
            return Message.of("set_numbered", set=self.set)
        return Message.of("set_of_unit", set=self.set, unit=self.unit)


@dataclass(slots=True)
class Swap:
    """The replacement of the unit of a section.

    ``source`` is None if no set is stored and the spare is entered from the sheet. ``is_new``: the unit at
    the section's address is the spare, as nothing responded there for a while or a person confirmed it.
    ``seen``: the findings on the wire, each once, in order.
    """

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
    """The result of the last probe."""
    probe: asyncio.Task[SwapState] | None = None

    def saw(self, state: SwapState) -> bool:
        """Note the result of a probe; return whether it was new."""
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
        """The rows of the set that were not written: the spare lacks them, or nobody chose them."""
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
        """The source of the parameters, as text."""
        return Message("swap_sheet") if self.source is None else self.source.message(self.unit)

    @property
    def story(self) -> Message:
        """The findings on the wire, in order."""
        return Message.of("swap_seen", findings=listed(self.seen))


_VALUES = ("who", "began_at", "set_id", "set_unit", "is_new", "proven", "restore_id", "seen")
FindRestore = Callable[[str], Awaitable[Restore | None]]


class SwapStore(Tables):
    """The table of swaps."""

    @writing
    def save(self, connection: StoreConnection, swap: Swap) -> None:
        """Store the present state of a swap instead of the section's earlier one."""
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
        """Return each swap that was not closed, with its restore if it has one."""
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


class SwapService:
    """The service that keeps the swap of each unit until it is closed or the unit's next swap begins."""

    def __init__(
        self,
        live: LiveState,
        commands: Mapping[str, CommandService],
        keepers: Mapping[str, SetKeeper],
        restores: RestoreService,
        store: SwapStore,
        events: EventLog,
    ) -> None:
        self._live = live
        self._commands = commands
        self._keepers = keepers
        self._restores = restores
        self._store = store
        self._events = events
        self._swaps: dict[tuple[str, int], Swap] = {}
        restores.on_end(self.on_restore_end)

    async def load(self) -> None:
        """Take up the swaps that were under way when the server ended; restores come first."""
        self._swaps = {(swap.bus, swap.unit): swap for swap in await self._store.load(self._restores.find)}

    def find(self, bus: str, unit: int) -> Swap | None:
        """Return the swap of a section, under way or just ended."""
        return self._swaps.get((bus, unit))

    def find_or_404(self, bus: str, unit: int) -> Swap:
        """Return the swap of a section. Raise Problem 404 if none was begun."""
        return or_404(self.find(bus, unit), "unknown_swap", Message.of("swap_not_begun", unit=unit))

    def _refuse_closed(self, swap: Swap) -> None:
        """Raise Problem 404 if the swap was closed while its unit was read: another may have begun."""
        is_open = self.find(swap.bus, swap.unit) is swap
        or_404(swap if is_open else None, "unknown_swap", Message.of("swap_not_begun", unit=swap.unit))

    async def source_of(self, person: Person, bus: str, unit: int, form: FormSource) -> SwapSource | None:
        """Return the stored set that a form names; None for the sheet.

        A neighbor is read and saved now, a file is saved. Raise Problem 403, 404, 422 or 504.
        """
        BEGIN.check(person)
        if form.file and (rows := await form.uploaded(unit)):
            name = (form.file.filename or "")[:80]
            kept = await self._keepers[bus].save(person, [rows], "from a file", name)
            return SwapSource(kept.id, rows.unit)
        if form.text == _SHEET:
            return None
        if not form.text:
            raise Problem(422, "invalid", Message("spare_not_chosen"))
        chosen = await side(form.text, self._keepers[bus].store, self._live)
        if chosen.kind == "set":
            return SwapSource(int(chosen.source), chosen.unit)
        unit_or_404(self._live, chosen.source, chosen.unit)
        keeper = self._keepers[chosen.source]
        kept = await keeper.read_and_save(person, [chosen.unit], origin="for a unit swap")
        return SwapSource(kept.id, chosen.unit)

    async def begin(self, person: Person, bus: str, unit: int, source: SwapSource | None) -> Swap:
        """Begin the swap of a section's unit; ``source``: the unit that the spare shall equal.

        Raise Problem 409 if another swap of the unit is under way.
        """
        BEGIN.check(person)
        under_way = self.find(bus, unit)
        if under_way is not None and not under_way.proven:
            other = Message.of("swap_under_way", who=account_shown(under_way.who), unit=unit)
            raise Problem(409, "busy", other)
        swap = Swap(bus, unit, person.name, source, unix_now())
        # Set before waiting for the store: of two who begin at once, one is refused.
        self._swaps[bus, unit] = swap
        try:
            await self._store.save(swap)
        except StoreError:
            self._swaps.pop((bus, unit))
            raise
        performed = BEGIN.by(person, source=swap.source_message)
        await self._events.record(**performed, bus=bus, unit=unit)
        return swap

    async def look(self, person: Person, swap: Swap) -> SwapState | None:
        """Return the state of the wire; while a probe takes long, the previous state, None if there is none
        or its unit has stopped responding since.

        Only one probe runs at a time: it takes gaps of the scan, and reloading a page must not add more.
        Raise the Problem that ended the probe.
        """
        running = swap.probe = swap.probe or asyncio.create_task(
            self._probe_line(person, swap), name=f"look for the spare of {swap.unit}"
        )
        done, _ = await asyncio.wait({running}, timeout=PROBE_WAIT_S)
        if done and swap.probe is running:
            swap.probe = None
            if swap.saw(running.result()) and self.find(swap.bus, swap.unit) is swap:
                await self._store.save(swap)
        if swap.state is None or not swap.state.still_holds(self._link(swap)):
            return None
        return replace(swap.state, is_new=swap.is_new, equal=swap.equal)

    def _link(self, swap: Swap) -> UnitLink:
        return self._live.buses[swap.bus].units[swap.unit].link

    async def confirm_spare(self, person: Person, swap: Swap) -> None:
        """Note that a person confirmed the unit at the section's address as the spare. Raise Problem 409 if
        it has stopped responding since it was found."""
        CONFIRM_SPARE.check(person)
        self._refuse_closed(swap)
        if swap.state is not None and not swap.state.still_holds(self._link(swap)):
            raise Problem(409, "not_in_state", Message.of("swap_found_lost", target=swap.unit))
        swap.is_new = True
        swap.seen.append(Message(CONFIRM_SPARE.event))
        await self._store.save(swap)

    async def begin_restore(self, person: Person, swap: Swap, restore: Restore) -> None:
        """Note the planned restore of the spare."""
        RESTORE_SPARE.check(person)
        self._refuse_closed(swap)
        swap.restore = restore
        await self._store.save(swap)

    async def cancel(self, person: Person, swap: Swap) -> None:
        """Close a swap that is given up, or that was verified."""
        CANCEL.check(person)
        self._refuse_closed(swap)
        del self._swaps[swap.bus, swap.unit]
        await self._store.remove(swap)
        if not swap.proven:
            performed = CANCEL.by(person)
            await self._events.record(**performed, bus=swap.bus, unit=swap.unit, message=swap.story)

    async def on_restore_end(self, restore: Restore) -> None:
        """End the swap to which a restore belongs, if the full read equals the set. A restore from another
        set leaves the swap as it is."""
        swap = self.find(restore.bus, restore.unit)
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
        """End a swap whose values a person entered from the sheet; the unit was saved as ``kept``."""
        SAVE_ENTERED.check(person)
        self._refuse_closed(swap)
        swap.proven = True
        await self._store.save(swap)
        story = joined([swap.story, Message("entered_from_sheet"), Message.of("kept_as_set", set=kept.id)])
        await self._events.record(
            **SAVE_ENTERED.by(person), bus=swap.bus, unit=swap.unit, message=story or "", outcome="verified"
        )

    async def _probe_line(self, person: Person, swap: Swap) -> SwapState:
        """Probe the wire. Raise Problem 503 if the bus is closed or too busy."""
        line, target = self._live.buses[swap.bus], swap.unit
        unit = line.units[target]
        at_target = await self._probe(person, swap.bus, target)
        for _ in range(MAX_PROBES - 1):
            # One lost response must not make the old unit, still on the cable, pass as the spare.
            if at_target != "silent" or unit.link.link != "online":
                break
            at_target = await self._probe(person, swap.bus, target)
        at_factory: ProbeFinding = "silent"
        if at_target == "silent" and target != FACTORY_ADDRESS:
            at_factory = await self._probe(person, swap.bus, FACTORY_ADDRESS)
        # REMOTE counts only as the unit reports it after its return.
        is_back = at_target == "digimax" and unit.link.link == "online"
        status = status_of(line, unit) if is_back else None
        return SwapState(
            target=target,
            at_target=at_target,
            at_factory=at_factory,
            remote=None if status is None else status.remote,
            configured=frozenset(line.units),
            baud=line.baud,
            read_at=unix_now(),
            other_lost=_other_lost(line, swap),
        )

    async def _probe(self, person: Person, bus: str, address: int) -> ProbeFinding:
        action = ScanBus(first=address, last=address)
        result = await self._commands[bus].send(
            person, action, deadline=Deadline.within(_PROBE_TIMEOUT_S), origin="unit swap"
        )
        if result.outcome != "verified":
            raise Problem(503, "not_looked", outcome_message(result))
        return next((found.kind for found in result.found if found.unit == address), "silent")


def _other_lost(line: BusLive, swap: Swap) -> LostUnit | None:
    """Return the one other unit that has stopped responding since the swap began; None if several have."""
    lost = [
        LostUnit(number, unit.reading.at)
        for number, unit in line.units.items()
        if number != swap.unit and unit.link.link == "offline" and unit.reading is not None
    ]
    lost = [each for each in lost if each.since > swap.began_at]
    return lost[0] if len(lost) == 1 else None


def step_text(advice: Advice, swap: Swap) -> Message:
    """Return the instruction of a step, with the result of a restore, or the next action for a sheet."""
    if swap.source is None and advice.step == "restore":
        return Message("swap_enter_sheet")
    if swap.source is None and advice.step == "proven":
        return Message("swap_compare_with_sheet")
    if advice.step == "proven" and (kept := swap.not_restored):
        return Message.of("swap_proven_except", rows=listed([parameter_name(number) for number in kept]))
    if advice.step == "restore" and swap.restore is not None and swap.equal is False:
        return Message("swap_restore_unfinished")
    return advice.text
