"""The command of the OPC UA process, ``python -m app.cli.opcua``, which a server starts. People do not use
it."""

from __future__ import annotations

import os

from app.system.opcua.serve import run
from bus.worker.process import configure_log, tie_to

if __name__ == "__main__":
    tie_to(os.getppid())
    configure_log()
    raise SystemExit(run())
