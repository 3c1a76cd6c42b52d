"""The port is kept open until the worker ends."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any, cast

from bus.line.line_loop import LineLoop
from bus.line.opener import Opener
from bus.messages import Message
from tests.bus.played_clock import PlayedClock


class Port:
    """One that is well until it is closed."""

    is_closed = False

    def check(self) -> list[str]:
        """It is there."""
        return []

    def close(self) -> None:
        self.is_closed = True


async def test_a_port_that_is_lost_in_the_turn_in_which_the_worker_ends_does_not_keep_it() -> None:
    port, opened = Port(), asyncio.Event()
    lost: asyncio.Future[Message] = asyncio.get_running_loop().create_future()

    async def run(_port: Any) -> Message:
        opened.set()
        return await lost

    line = SimpleNamespace(
        bus=SimpleNamespace(port="/dev/ttyUSB0"),
        baud=9600,
        clock=PlayedClock(),
        link=SimpleNamespace(has_responses=False),
        run=run,
    )

    async def open_it(*_: Any) -> Any:
        return port

    task = asyncio.create_task(Opener(cast(LineLoop, line), open_it).run())
    await opened.wait()
    await asyncio.sleep(0)
    lost.set_result(Message("adapter_gone"))
    task.cancel()
    done, _ = await asyncio.wait({task}, timeout=20)
    assert done == {task}
    assert task.cancelled()
    assert port.is_closed
