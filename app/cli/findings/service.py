"""Whether the unit file of the service is one that systemd takes: it may have been edited."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

from app.cli.findings.machine import Finding, fault
from app.cli.setup.service_unit import UNIT_FILE
from bus.messages import Message

WITHIN_S = 10.0


def service_findings(unit_file: Path = UNIT_FILE) -> Iterator[Finding]:
    """Each line that systemd complains of, which it mostly ignores when it starts the service. Nothing
    without an installed service."""
    program = shutil.which("systemd-analyze")
    if program is None or not unit_file.is_file():
        return
    try:
        done = subprocess.run(
            [program, "verify", unit_file], capture_output=True, text=True, timeout=WITHIN_S, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return
    complaints = [line for line in done.stderr.splitlines() if unit_file.name in line]
    for line in complaints:
        yield fault("check_service_refused", complaint=line)
    if not complaints:
        yield Finding(Message.of("check_service", file=str(unit_file)))
