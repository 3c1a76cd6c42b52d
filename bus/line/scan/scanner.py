"""The scan of a port without other users: opens it at one baud rate and requests address after address."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from bus.errors import WireError
from bus.line.scan.found import Found
from bus.line.scan.passes import Passes
from bus.line.scan.prober import Prober, SlowUnitError
from bus.line.scan.scan_port import ScanPort, scan_port
from bus.messages import Message

LISTEN_S = 0.2
"""How long the line is received before the first request."""
MOST_UNREQUESTED_BYTES = 10
"""More than this in that time, and responses cannot be distinguished from other traffic."""


@dataclass(slots=True)
class BaudScan:
    """What has responded so far at one baud rate. ``echoes``: the adapter receives what it sends.

    ``turnaround_s``: within which a unit begins its response; it grows where a unit is slower.
    """

    baud: int
    turnaround_s: float
    found: list[Found] = field(default_factory=list)
    echoes: bool = False
    seconds: float = 0.0


async def scan_baud(
    scan: BaudScan, port: str, addresses: Sequence[int], progress: Callable[[int], None]
) -> None:
    """Request each of ``addresses`` and record in ``scan`` which respond, in their order.

    ``progress`` is called with how many of ``PASSES`` requests for each address are done; with a negative
    number when all are repeated, because a unit is slower than was allowed. Raises WireError when the port
    cannot be opened or is lost, or when unrequested bytes arrive.
    """
    async with scan_port(port, scan.baud) as line:
        await scan_addresses(scan, line, addresses, progress)


async def scan_addresses(
    scan: BaudScan, line: ScanPort, addresses: Sequence[int], progress: Callable[[int], None]
) -> None:
    """As ``scan_baud``, over an open port."""
    began = asyncio.get_running_loop().time()
    if (unrequested := await line.listen(LISTEN_S)) > MOST_UNREQUESTED_BYTES:
        raise WireError(Message.of("bytes_unrequested", count=unrequested, seconds=LISTEN_S))
    complete = False
    while not complete:
        passes = Passes(addresses)
        try:
            await _probe_all(scan, line, passes, progress, began)
            complete = True
        except SlowUnitError as slow:
            scan.turnaround_s = slow.allowance_s
            scan.found.clear()
            progress(-passes.settled)


async def _probe_all(
    scan: BaudScan, line: ScanPort, passes: Passes, progress: Callable[[int], None], began: float
) -> None:
    prober = Prober(line, scan.baud, scan.turnaround_s)
    for unit in passes:
        settled, one = passes.settled, await prober.examine(unit)
        if one is None:
            passes.no_response()
        else:
            passes.found()
            scan.found.append(one)
            scan.found.sort(key=lambda each: each.unit)
        scan.echoes, scan.seconds = line.echoes, asyncio.get_running_loop().time() - began
        progress(passes.settled - settled)
