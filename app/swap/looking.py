"""Looking for the spare: at the section's address and at the factory address, by reading only."""

from __future__ import annotations

from app.commands.api.responses import outcome_message
from app.commands.service.command_service import CommandService
from app.errors import Problem
from app.live.state.bus_live import LiveState
from app.swap.record import Swap
from app.swap.rules import FACTORY_ADDRESS, ProbeFinding, SwapState
from app.web.access import Person
from bus.catalogue.status import status_bits
from bus.contract import ScanBus

LOOK_TIMEOUT_S = 30.0
LOOKS = 4
"""Attempts at an address whose unit still responds to the scan."""


async def look(commands: CommandService, live: LiveState, person: Person, swap: Swap) -> SwapState:
    """Probe the wire. Raises Problem 503 where it cannot: the bus is closed, or too busy."""
    bus, target = swap.bus, swap.unit
    at_target = await _at_section(commands, live, person, bus, target)
    at_factory: ProbeFinding = "silent"
    if at_target == "silent" and target != FACTORY_ADDRESS:
        at_factory = await _probe(commands, person, FACTORY_ADDRESS)
    return SwapState(
        target=target,
        at_target=at_target,
        at_factory=at_factory,
        remote=_remote(live, bus, target) if at_target == "digimax" else None,
        equal=swap.equal,
        is_new=swap.is_new,
        configured=frozenset(live.buses[bus].units),
        baud=live.buses[bus].baud,
    )


async def _at_section(
    commands: CommandService, live: LiveState, person: Person, bus: str, unit: int
) -> ProbeFinding:
    """One lost response is no absence: it would let the old unit, still on the cable, pass for the spare."""
    for _ in range(LOOKS):
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


def _remote(live: LiveState, bus: str, unit: int) -> bool | None:
    """REMOTE as the unit reported since it came back; None until then."""
    known = live.buses[bus].units[unit]
    if known.reading is None or known.link.link != "online":
        return None
    settings = live.buses[bus].settings
    return status_bits(known.reading.outputs, known.reading.inputs, settings.estop_healthy).remote
