"""The OPC UA process of a server, which starts it: ``python -m app.cli.opcua``. It has no use for people."""

from __future__ import annotations

import os

from app.system.opcua.serve import run
from bus.worker.process import configure_log, tie_to

if __name__ == "__main__":
    tie_to(os.getppid())
    configure_log()
    raise SystemExit(run())
