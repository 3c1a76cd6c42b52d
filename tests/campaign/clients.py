"""People and programs of a campaign: they set speeds, acknowledge alarms, read, and record what they see.

``python -m tests.campaign.clients LOG TOKEN UNITS BUS URL SEED`` runs until SIGTERM.
"""

from __future__ import annotations

import asyncio
import json
import random
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from datetime import UTC, datetime
from decimal import Decimal
from pathlib import Path
from typing import IO, Any
from uuid import uuid4

import httpx

COMMAND_EVERY_S, LOOK_EVERY_S, ALARMS_EVERY_S, AWAY_S = 0.05, 0.25, 1.0, 0.5
SENDERS = 3
"""How many commands to a bus are under way at once."""
TIMEOUT_S = 2.0
"""How long a command may wait to be sent: what the API takes where nothing else is given."""
CALL_S = 8.0
RAW_PART = 0.3
"""Of the commands; the others are typed in display units."""
SPEEDS, RATIOS = range(1, 2000), range(5001, 20000)
RATIO_DECIMALS = 4
STORED_H, POINTS = 3, 20_000


class Clients:
    """Everything that one process does with a bus of the server at ``url``."""

    def __init__(
        self, log: IO[str], bus: str, units: int, url: str, client: httpx.AsyncClient, chance: random.Random
    ) -> None:
        self._log, self._bus, self._units, self._client, self._chance = log, bus, units, client, chance
        self._api = f"{url}/api/v1"
        self._speeds, self._ratios = _unused(SPEEDS, units, chance), _unused(RATIOS, units, chance)
        self._display: dict[int, tuple[bool, int]] = {}
        """By unit, as last looked at: whether it follows, and the decimals of its speed."""
        self._shown: set[tuple[object, ...]] = set()

    def write(self, kind: str, **row: object) -> None:
        self._log.write(json.dumps({"kind": kind, "bus": self._bus, **row}) + "\n")
        self._log.flush()

    async def run(self) -> None:
        """Until it is canceled."""
        async with asyncio.TaskGroup() as tasks:
            for _ in range(SENDERS):
                tasks.create_task(_repeat(self._set_speed, COMMAND_EVERY_S))
            tasks.create_task(_repeat(self._acknowledge, ALARMS_EVERY_S))
            tasks.create_task(_repeat(self._look, LOOK_EVERY_S))
            tasks.create_task(_repeat(self._journal, ALARMS_EVERY_S))

    async def _set_speed(self) -> None:
        """One number that no other command to its unit has, raw or as its unit displays it."""
        unit = self._chance.randint(1, self._units)
        follows, decimals = self._display.get(unit, (False, 0))
        digits = next((self._ratios if follows else self._speeds)[unit])
        typed, body = None, {"raw": digits}
        if self._chance.random() >= RAW_PART:
            typed = f"{Decimal(digits).scaleb(-RATIO_DECIMALS if follows else -decimals):f}"
            body = {"value": typed}
        began, outcome, error, reason = time.time(), None, None, ""
        url = f"{self._api}/buses/{self._bus}/units/{unit}/speed"
        headers = {"Lineside-Sent-At": _instant(began), "Idempotency-Key": uuid4().hex}
        with suppress(httpx.HTTPError):
            outcome, error, reason = _outcome(await self._client.post(url, json=body, headers=headers))
        row: dict[str, object] = {
            "sent_at": began,
            "responded_at": time.time(),
            "unit": unit,
            "digits": digits,
            "typed": typed,
        }
        row |= {"outcome": outcome, "unit_error": error, "reason": reason}
        self.write("command", **row, timeout_s=TIMEOUT_S)
        if outcome is None:
            await asyncio.sleep(AWAY_S)

    async def _acknowledge(self) -> None:
        """Every alarm that waits for it."""
        found = await self._client.get(f"{self._api}/alarms?state=unack_active&bus={self._bus}")
        for alarm in found.json().get("alarms", ()) if found.status_code == 200 else ():
            response = await self._client.post(f"{self._api}/alarms/{alarm['id']}/acknowledge")
            if response.status_code == 200:
                key, _, occurrence = alarm["id"].rpartition(".")
                row = {"alarm": key, "occurrence": int(occurrence), "trigger": "acknowledge"}
                self.write("acknowledged", **row, after="")

    async def _look(self) -> None:
        """Every unit that has values, with the age that the server states: its clock may be wrong."""
        response = await self._client.get(f"{self._api}/buses/{self._bus}")
        if response.status_code != 200:
            return
        now, units = time.time(), response.json()["units"]
        for unit in units:
            self._display[unit["id"]] = bool(unit["follower"]), unit["decimals"] or 0
        shown = [
            {"id": unit["id"], "link": unit["link"], "age_ms": unit["age_ms"]}
            | {"raw": [unit[name] for name in ("commanded_raw", "actual_raw", "analog_raw")]}
            | {"texts": [unit["commanded"], unit["actual"]]}
            for unit in units
            if unit["commanded_raw"] is not None
        ]
        if shown:
            self.write("live", at=now, units=shown)

    async def _journal(self) -> None:
        response = await self._client.get(f"{self._api}/alarms/journal?limit=100")
        for row in response.json().get("transitions", ()) if response.status_code == 200 else ():
            if row["bus"] != self._bus:
                continue
            key, _, occurrence = row["alarm"].rpartition(".")
            shown = {"alarm": key, "occurrence": int(occurrence)}
            shown |= {"trigger": row["trigger"], "after": row["after"]}
            if (mark := tuple(shown.values())) not in self._shown:
                self._shown.add(mark)
                self.write("transition", **shown)

    async def read_stored(self) -> None:
        """Each number that the history has of the speeds of each unit. Raises httpx.HTTPError."""
        now = time.time()
        span = {"from": _instant(now - STORED_H * 3600), "to": _instant(now), "points": POINTS}
        for unit in range(1, self._units + 1):
            for value in ("commanded", "actual"):
                query = {"bus": self._bus, "unit": unit, "value": value, **span}
                response = await self._client.get(f"{self._api}/history", params=query)
                response.raise_for_status()
                found = response.json()
                numbers = {*found["min"], *found["max"]} - {None}
                self.write("stored", unit=unit, value=value, numbers=sorted(numbers))


async def _repeat(work: Any, every_s: float) -> None:
    while True:
        with suppress(httpx.HTTPError, json.JSONDecodeError):
            await work()
        await asyncio.sleep(every_s)


def _unused(numbers: range, units: int, chance: random.Random) -> dict[int, Iterator[int]]:
    """By unit, each number once: a frame on the wire names its command. None ends with a zero, so that it is
    seen in the raw of every scale."""
    usable = [number for number in numbers if number % 10]
    return {unit: iter(chance.sample(usable, len(usable))) for unit in range(1, units + 1)}


def _outcome(response: httpx.Response) -> tuple[str | None, int | None, str]:
    """The outcome as the server states it, the error of the unit, and why; None: it did not state one.

    A problem without the id of a command is ``refused_here``: none was made of the request, as where the
    scale of a typed value could not be read.
    """
    try:
        body = response.json()
    except json.JSONDecodeError:
        return None, None, ""
    reason = body.get("detail") or body.get("message") or ""
    outcome = body["outcome"] if "id" in body else "refused_here"
    return outcome, body.get("unit_error"), str(reason)


def _instant(at: float) -> str:
    return datetime.fromtimestamp(at, UTC).isoformat(timespec="milliseconds")


async def main(log: IO[str], token: str, units: str, bus: str, url: str, seed: str) -> None:
    """Run the clients of one bus until SIGTERM, then read what was stored."""
    headers = {"Authorization": f"Bearer {token}"}
    async with httpx.AsyncClient(headers=headers, timeout=CALL_S, trust_env=False) as client:
        clients = Clients(log, bus, int(units), url, client, random.Random(f"{bus} {seed}"))
        running = asyncio.ensure_future(clients.run())
        asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, running.cancel)
        with suppress(asyncio.CancelledError):
            await running
        await clients.read_stored()


if __name__ == "__main__":
    with Path(sys.argv[1]).open("a", encoding="utf-8") as opened:
        asyncio.run(main(opened, *sys.argv[2:]))
