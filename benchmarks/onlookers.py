"""Browsers without a window, so many live sockets: ``python -m benchmarks.onlookers URL TOKEN COUNT [BUS]``.

With BUS, the first of them follows the trace of that bus; its token must be an engineer's.
Prints ``ready`` when all are open and have their snapshot.
"""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count

from websockets.asyncio.client import ClientConnection, connect

from tests.e2e.site import end

SPEAK_S = 10.0


@contextmanager
def onlookers(url: str, token: str, number: int, *, trace: str = "") -> Iterator[None]:
    """Run ``number`` of them in a separate process until the end; all are connected when it begins."""
    command = [
        sys.executable,
        "-m",
        "benchmarks.onlookers",
        url,
        token,
        str(number),
        *([trace] if trace else []),
    ]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n", "the onlookers were not let in"
        yield
    finally:
        end(process)


async def watch(url: str, token: str, opened: asyncio.Semaphore, trace: str) -> None:
    headers = {"Authorization": f"Bearer {token}", "Origin": url}
    address = url.replace("http", "ws", 1) + "/live?language=en"
    async with connect(address, additional_headers=headers, compression=None, max_size=None) as socket:
        await socket.send(json.dumps({"trace": trace}))
        await socket.recv()
        opened.release()
        speaking = asyncio.create_task(_speak(socket, trace))
        async for _ in socket:
            pass
        speaking.cancel()


async def _speak(socket: ClientConnection, trace: str) -> None:
    for _ in count():
        await asyncio.sleep(SPEAK_S)
        await socket.send(json.dumps({"trace": trace}))


async def main(url: str, token: str, number: int, trace: str = "") -> None:
    opened = asyncio.Semaphore(0)
    traces = [trace, *[""] * (number - 1)]
    watching = [asyncio.create_task(watch(url, token, opened, each)) for each in traces]
    for _ in watching:
        await opened.acquire()
    print("ready", flush=True)
    await asyncio.gather(*watching)


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], sys.argv[2], int(sys.argv[3]), *sys.argv[4:]))
