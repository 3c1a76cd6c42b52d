"""Two people who know nothing of Lineside: one at the keypads of the units, one with ``stty`` at its port.

``python -m tests.campaign.meddling keypad LOG BUS CONTROL_PORT UNITS SEED`` or ``stty LOG BUS DEVICE SEED``
runs until SIGTERM and logs what was changed, and between which moments. The first rows of ``keypad`` are what
the units begin with.
"""

from __future__ import annotations

import json
import random
import subprocess
import sys
import time
from pathlib import Path
from typing import IO

from tests.simulator_remote import Remote

SCALES: dict[int, tuple[int, ...]] = {
    1: (875, 1750, 3500),
    2: (2000, 2000, 200, 20000),
    3: (0, 1, 1, 2),
    8: (0, 0, 0, 1, 2),
    28: (1, 2, 2),
    29: (0, 100),
    30: (1000, 2000),
    31: (15000, 20000),
}
"""By parameter: what is typed at the keypad. Speeds and ratios in these scales overlap."""
KEYPAD_EVERY_S = (0.1, 0.9)
STTY = (
    *("sane", "icrnl", "inlcr", "ixon", "istrip", "1200", "300", "echo", "raw echo", "icanon"),
    *("opost onlcr", "parenb", "cs7", "-clocal", "hupcl", "min 5 time 10"),
)
STTY_EVERY_S = (0.2, 2.0)


def keypad(log: IO[str], bus: str, units: Remote, count: int, chance: random.Random) -> None:
    """Change parameters of the scale of random units at random moments."""

    def write(unit: int, number: int, raw: int, began: float) -> None:
        row = {"kind": "keypad", "bus": bus, "unit": unit, "number": number, "raw": raw}
        log.write(json.dumps({**row, "began": began, "ended": time.time()}) + "\n")
        log.flush()

    for unit in range(1, count + 1):
        for number in SCALES:
            write(unit, number, units.do("parameter", unit=unit, number=number), 0.0)
    while True:
        time.sleep(chance.uniform(*KEYPAD_EVERY_S))
        unit, number = chance.randint(1, count), chance.choice(sorted(SCALES))
        raw, began = chance.choice(SCALES[number]), time.time()
        units.do("parameter", unit=unit, number=number, raw=raw)
        write(unit, number, raw, began)


def stty(log: IO[str], bus: str, device: str, chance: random.Random) -> None:
    """Change the settings of the port at random moments."""
    while True:
        time.sleep(chance.uniform(*STTY_EVERY_S))
        words = chance.choice(STTY)
        done = subprocess.run(["stty", "-F", device, *words.split()], capture_output=True, text=True)
        row = {"kind": "stty", "bus": bus, "at": time.time(), "words": words, "error": done.stderr}
        log.write(json.dumps(row) + "\n")
        log.flush()


def main(kind: str, log: str, bus: str, target: str, *words: str) -> None:
    with Path(log).open("a", encoding="utf-8") as output:
        if kind == "keypad":
            count, seed = words
            keypad(output, bus, Remote(int(target)), int(count), random.Random(int(seed)))
        else:
            stty(output, bus, target, random.Random(int(words[0])))


if __name__ == "__main__":
    main(*sys.argv[1:])
