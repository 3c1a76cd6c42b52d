"""The wire: one process per serial port polls, schedules, retries, verifies, stages and broadcasts."""

import sys

if "rich" not in sys.modules:
    # structlog imports it where it is installed, for tracebacks in color: 4 MiB of every process.
    sys.modules["rich"] = None  # type: ignore[assignment]
    import structlog as structlog

    del sys.modules["rich"]
