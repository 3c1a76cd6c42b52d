"""The scan of a port that nobody else uses: opens it at one baud rate and asks address after address."""

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
"""How long the line is listened to before anything is asked."""
MOST_UNASKED_BYTES = 10
"""More than this in that time, and nothing on the line can be told from anything else."""


@dataclass(slots=True)
class BaudScan:
    """What has answered so far at one baud rate. ``echoes``: the adapter hears what it sends.

    ``turnaround_s``: what a unit may take to begin its answer; it grows where a unit proves slower.
    """

    baud: int
    turnaround_s: float
    found: list[Found] = field(default_factory=list)
    echoes: bool = False
    seconds: float = 0.0


async def scan_baud(
    scan: BaudScan, port: str, addresses: Sequence[int], progress: Callable[[int], None]
) -> None:
    """Ask every one of ``addresses`` and put down in ``scan`` who answers, in their order.

    ``progress`` is called with how many of ``PASSES`` questions for each address are settled; with a
    negative number when all are asked again, as a unit proved slower than was allowed.
    Raises WireError when the port cannot be opened or is lost, or when bytes come that nobody asked for.
    """
    async with scan_port(port, scan.baud) as line:
        await scan_addresses(scan, line, addresses, progress)


async def scan_addresses(
    scan: BaudScan, line: ScanPort, addresses: Sequence[int], progress: Callable[[int], None]
) -> None:
    """As ``scan_baud``, over an open port."""
    began = asyncio.get_running_loop().time()
    if (unasked := await line.listen(LISTEN_S)) > MOST_UNASKED_BYTES:
        raise WireError(Message.of("bytes_unrequested", count=unasked, seconds=LISTEN_S))
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
