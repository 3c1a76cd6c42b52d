"""Browsers without a window, so many live sockets: ``python -m benchmarks.onlookers URL TOKEN COUNT``.

Prints ``ready`` when all are open and have their snapshot.
"""

from __future__ import annotations

import asyncio
import sys
from itertools import count

from websockets.asyncio.client import ClientConnection, connect

SPEAK_S = 10.0


async def watch(url: str, token: str, opened: asyncio.Semaphore) -> None:
    headers = {"Authorization": f"Bearer {token}", "Origin": url}
    address = url.replace("http", "ws", 1) + "/live?language=en"
    async with connect(address, additional_headers=headers, compression=None, max_size=None) as socket:
        await socket.send("{}")
        await socket.recv()
        opened.release()
        speaking = asyncio.create_task(_speak(socket))
        async for _ in socket:
            pass
        speaking.cancel()


async def _speak(socket: ClientConnection) -> None:
    for _ in count():
        await asyncio.sleep(SPEAK_S)
        await socket.send("{}")


async def main(url: str, token: str, number: int) -> None:
    opened = asyncio.Semaphore(0)
    watching = [asyncio.create_task(watch(url, token, opened)) for _ in range(number)]
    for _ in watching:
        await opened.acquire()
    print("ready", flush=True)
    await asyncio.gather(*watching)


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], sys.argv[2], int(sys.argv[3])))
