"""People and programs of a campaign: they set speeds, acknowledge alarms, read, and record what they see.

``python -m tests.campaign.clients LOG TOKEN BUS UNITS URL…`` runs until SIGTERM.
"""

from __future__ import annotations

import asyncio
import json
import random
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Any
from uuid import uuid4

import httpx

COMMAND_EVERY_S, LOOK_EVERY_S, ALARMS_EVERY_S = 0.4, 0.25, 1.0
TIMEOUT_S = 2.0
"""How long a command may wait to be sent: what the API takes where nothing else is given."""
CALL_S = 8.0
MAX_RAW = 1999
OUTCOMES = {"verified", "acknowledged", "refused", "unverified", "not_sent", "bus_closed"}
FROM_A_PROXY = (502, 504)
UNKNOWN_AT_HOME = "home_unverified"
"""The server that passed the command on had no response of the home, which may have got it or not."""


class Clients:
    """Everything that one process does with the servers at ``urls``."""

    def __init__(
        self, log: IO[str], bus: str, units: int, urls: list[str], client: httpx.AsyncClient
    ) -> None:
        self._log, self._bus, self._urls, self._client = log, bus, urls, client
        self._next = _unused(units)
        self._shown: set[tuple[object, ...]] = set()

    def write(self, kind: str, **row: object) -> None:
        self._log.write(json.dumps({"kind": kind, "bus": self._bus, **row}) + "\n")
        self._log.flush()

    async def run(self) -> None:
        """Until it is canceled."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(_repeat(self._set_speed, COMMAND_EVERY_S))
            tasks.create_task(_repeat(self._acknowledge, ALARMS_EVERY_S))
            for url in self._urls:
                tasks.create_task(_repeat(lambda url=url: self._look(url), LOOK_EVERY_S))  # type: ignore[misc]
                tasks.create_task(_repeat(lambda url=url: self._journal(url), ALARMS_EVERY_S))  # type: ignore[misc]
                tasks.create_task(_repeat(lambda url=url: self._stream(url), ALARMS_EVERY_S))  # type: ignore[misc]

    async def _set_speed(self) -> None:
        """One speed that no other command has, to one unit, on any server."""
        unit, raw = next(self._next)
        began, outcome, reason = time.time(), None, ""
        url = f"{random.choice(self._urls)}/api/v1/buses/{self._bus}/units/{unit}/speed"
        headers = {"Lineside-Sent-At": _instant(began), "Idempotency-Key": uuid4().hex}
        with suppress(httpx.HTTPError):
            outcome, reason = _outcome(await self._client.post(url, json={"raw": raw}, headers=headers))
        row = {"sent_at": began, "responded_at": time.time(), "unit": unit, "raw": raw}
        self.write("command", **row, timeout_s=TIMEOUT_S, outcome=outcome, reason=reason)

    async def _acknowledge(self) -> None:
        """Every alarm that waits for it."""
        url = random.choice(self._urls)
        found = await self._client.get(f"{url}/api/v1/alarms?state=unack_active&bus={self._bus}")
        for alarm in found.json().get("alarms", ()) if found.status_code == 200 else ():
            response = await self._client.post(f"{url}/api/v1/alarms/{alarm['id']}/acknowledge")
            if response.status_code == 200:
                key, _, occurrence = alarm["id"].rpartition(".")
                row = {"alarm": key, "occurrence": int(occurrence), "trigger": "acknowledge"}
                self.write("acknowledged", **row, after="")

    async def _look(self, url: str) -> None:
        """A unit with a value that is live, by the age that the server states: its clock may be wrong."""
        response = await self._client.get(f"{url}/api/v1/buses/{self._bus}")
        if response.status_code != 200:
            return
        now = time.time()
        ages = [unit["age_ms"] for unit in response.json()["units"] if unit["link"] == "online"]
        if ages:
            self.write("live", at=now, read_at=now - min(ages) / 1000, server=url)

    async def _journal(self, url: str) -> None:
        response = await self._client.get(f"{url}/api/v1/alarms/journal?limit=100")
        for row in response.json().get("transitions", ()) if response.status_code == 200 else ():
            if row["bus"] != self._bus:
                continue
            key, _, occurrence = row["alarm"].rpartition(".")
            shown = {"alarm": key, "occurrence": int(occurrence)}
            shown |= {"trigger": row["trigger"], "after": row["after"]}
            if (mark := tuple(shown.values())) not in self._shown:
                self._shown.add(mark)
                self.write("transition", **shown)

    async def _stream(self, url: str) -> None:
        """Read changes until the server ends; how many came."""
        count = 0
        with suppress(httpx.HTTPError):
            async with self._client.stream("GET", f"{url}/api/v1/stream?bus={self._bus}") as stream:
                async for line in stream.aiter_lines():
                    count += line.startswith("data:")
        self.write("stream", at=time.time(), server=url, count=count)


async def _repeat(work: Any, every_s: float) -> None:
    while True:
        with suppress(httpx.HTTPError, json.JSONDecodeError):
            await work()
        await asyncio.sleep(every_s)


def _unused(units: int) -> Iterator[tuple[int, int]]:
    """A unit and a speed, each pair once: a frame on the wire names its command."""
    pairs = [(unit, raw) for unit in range(1, units + 1) for raw in range(1, MAX_RAW)]
    random.Random(0).shuffle(pairs)
    return iter(pairs)


def _outcome(response: httpx.Response) -> tuple[str | None, str]:
    """The outcome as the home of the bus states it, and why; None: it did not state one.

    Every other refusal is ``refused_here``.
    """
    try:
        body = response.json()
    except json.JSONDecodeError:
        return None, ""
    code, reason = body.get("code"), body.get("reason", "")
    if reason == UNKNOWN_AT_HOME or (code not in OUTCOMES and response.status_code in FROM_A_PROXY):
        return None, reason
    return (code if code in OUTCOMES else "refused_here"), reason


def _instant(at: float) -> str:
    return datetime.fromtimestamp(at, UTC).isoformat(timespec="milliseconds")


async def main(log: IO[str], token: str, bus: str, units: str, *urls: str) -> None:
    """Run the clients of one bus."""
    headers = {"Authorization": f"Bearer {token}"}
    timeout = httpx.Timeout(CALL_S, read=CALL_S)
    async with httpx.AsyncClient(headers=headers, timeout=timeout, trust_env=False) as client:
        await Clients(log, bus, int(units), list(urls), client).run()


if __name__ == "__main__":
    with Path(sys.argv[1]).open("a", encoding="utf-8") as opened:
        asyncio.run(main(opened, *sys.argv[2:]))
