"""What TLS costs: the server with 200 browsers while all units ramp, with it and without."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from benchmarks.onlookers import onlookers
from benchmarks.processes import cpu_seconds, family, memory_mib
from benchmarks.screen import ramp
from benchmarks.tables import show
from tests.certificates import certificates
from tests.e2e.site import site

BROWSERS = 200
UNITS = 8
MEASURED_S = 12.0
REPEATS = 3
"""The least CPU of several: a machine that is busy with other work only adds to it."""


def run() -> None:
    """One table."""
    with tempfile.TemporaryDirectory() as folder:
        made = certificates(Path(folder))
        (clear, clear_mib), (encrypted, encrypted_mib) = _used(None), _used(made)
    rows = [
        ["HTTP", f"{clear:.1%}", "", f"{clear_mib:.0f} MiB"],
        ["HTTPS", f"{encrypted:.1%}", f"{encrypted / clear:.2f}", f"{encrypted_mib:.0f} MiB"],
    ]
    note = f"{UNITS} units that ramp, {BROWSERS} browsers; CPU of one core. At most 1.3 times."
    show("What TLS costs the server", ["", "CPU", "ratio", "memory"], rows, note)


def _used(made: Path | None) -> tuple[float, float]:
    """The server's share of a core, and its memory."""
    with (
        tempfile.TemporaryDirectory() as folder,
        site(Path(folder), UNITS, line_options=("--no-script",), installed=True, certificate=made) as served,
        _trusting(made),
        onlookers(served.url, served.tokens["viewer"], BROWSERS),
    ):
        assert served.server is not None
        server, *_ = family(served.server.pid)
        shares = []
        for _ in range(REPEATS):
            ramp(served)
            begun, used = time.monotonic(), cpu_seconds(server)
            time.sleep(MEASURED_S)
            shares.append((cpu_seconds(server) - used) / (time.monotonic() - begun))
        return min(shares), memory_mib(server)


@contextmanager
def _trusting(made: Path | None) -> Iterator[None]:
    """The browsers trust the authority of the site."""
    if made is not None:
        os.environ["SSL_CERT_FILE"] = str(made / "ca.pem")
    try:
        yield
    finally:
        os.environ.pop("SSL_CERT_FILE", None)
