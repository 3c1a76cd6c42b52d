"""The port is kept open until the worker ends."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any, cast

from bus.line.opener import Opener
from bus.line.poller import Poller
from tests.bus.played_clock import PlayedClock


class Port:
    """One that is well until it is closed."""

    is_closed = False

    def check(self) -> None:
        """It is there."""

    def close(self) -> None:
        self.is_closed = True


async def test_a_port_that_is_lost_in_the_turn_in_which_the_worker_ends_does_not_keep_it() -> None:
    port, opened = Port(), asyncio.Event()
    poller = SimpleNamespace(
        bus=SimpleNamespace(port="/dev/ttyUSB0"),
        baud=9600,
        clock=PlayedClock(),
        link=SimpleNamespace(counts=SimpleNamespace(answers=0)),
        port_opened=lambda _port: opened.set(),
        lost=None,
    )

    async def open_it(*_: Any) -> Any:
        return port

    task = asyncio.create_task(Opener(cast(Poller, poller), open_it).run())
    await opened.wait()
    await asyncio.sleep(0)
    poller.lost("the adapter was pulled out")
    task.cancel()
    done, _ = await asyncio.wait({task}, timeout=20)
    assert done == {task}
    assert task.cancelled()
    assert port.is_closed
