"""Run the tables named on the command line, or all of them."""

from __future__ import annotations

import importlib
import sys

TABLES = {
    "wire": "the wire: polls, gaps, a dead unit",
    "buses": "what bus workers cost: one to sixteen",
    "commands": "a command: from the request to the wire, and many units as one",
    "screen": "the screen: from the wire to the pixel, with many browsers",
    "board": "the board: 8 to 255 units changing four times a second, on a slow device",
    "tiles": "sixteen and eight moving tiles with their curves: what the browser uses",
    "press": "speed felt: from a press to its picture, on a slow device",
    "screen_memory": "the board: what a page keeps after ten minutes (only when named)",
    "sets": "parameter sets: a backup on the wire",
    "history": "history: stored, packed, drawn",
    "history_kill": "history: killed fifty times",
    "alarms": "alarms: 255 units with 20 each, and a flood",
    "alarm_flood": "alarms: a page that is used while 10,000 change within a minute",
    "tls": "TLS: what it costs the server with 200 browsers",
    "start": "the start: from nothing to the first live value",
}
LONG = {"screen_memory"}
"""Run only when named."""
AGAINST = "against"


def main(wanted: list[str]) -> int:
    """Exit 2 when a table is not known. ``against COMMIT`` is a table only when named."""
    if wanted[:1] == [AGAINST] and len(wanted) == 2:
        importlib.import_module("benchmarks.against").run(wanted[1])
        return 0
    unknown = [name for name in wanted if name not in TABLES]
    if unknown:
        known = "".join(f"\n  {name:14} {meaning}" for name, meaning in TABLES.items())
        known += f"\n  {AGAINST} COMMIT  this tree beside an earlier one (only when named)"
        print(f"no table {', '.join(unknown)}; there are{known}", file=sys.stderr)
        return 2
    for name in wanted or [name for name in TABLES if name not in LONG]:
        importlib.import_module(f"benchmarks.{name}").run()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
