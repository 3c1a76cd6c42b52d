"""The wire: one process for each serial port polls, schedules, retries, verifies, stages and broadcasts."""

import sys
from types import ModuleType
from typing import cast

# structlog imports it if it is installed, for tracebacks in color: 4 MiB of every process.
sys.modules.setdefault("rich", cast(ModuleType, None))
