"""The device server of ``docs/hardware.md``, and the systemd drop-in of a worker in ``docs/spare.md``."""

from __future__ import annotations

import os
import re
import shutil
import socket
import subprocess
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from select import select

import pytest

from bus.settings import Dialect
from bus.wire.framing import FrameDecoder, ReceivedFrame
from tests import unpacked
from tests.app.served_tls import PATIENCE_S
from tests.e2e.site import eventually
from tests.free_port import free_port
from tests.test_architecture import ROOT, text_of
from tests.test_service_unit import INSTALLED, LINESIDE, UNITS

TEXT = "".join(text_of(ROOT / "docs" / name) for name in ("hardware.md", "spare.md"))
DROP_INS = re.findall(r"`/etc/systemd/system/(\S+?\.service)\.d/(\S+?)[`;].*?```ini\n(.*?)```", TEXT, re.S)
READ = bytes.fromhex("10 02 01 81 10 03 7E")


def example(kind: str, holds: str) -> str:
    (found,) = (each for each in re.findall(rf"```{kind}\n(.*?)```", TEXT, re.S) if holds in each)
    return str(found)


def faults(folder: Path, unit: str, name: str, text: str) -> list[str]:
    """What systemd has to note about a unit with this drop-in."""
    (folder / unit).write_text(UNITS[unit].replace(INSTALLED, str(LINESIDE)))
    drop_ins = folder / f"{unit}.d"
    drop_ins.mkdir()
    (drop_ins / name).write_text(text.replace(INSTALLED, str(LINESIDE)))
    environment = {**os.environ, "SYSTEMD_UNIT_PATH": f"{folder}:"}
    verify = ["systemd-analyze", "verify", folder / unit]
    done = subprocess.run(verify, capture_output=True, text=True, env=environment)
    return [line for line in done.stderr.splitlines() if unit in line or name in line]


@pytest.mark.parametrize(("unit", "name", "text"), DROP_INS)
def test_systemd_accepts_a_drop_in(tmp_path: Path, unit: str, name: str, text: str) -> None:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("systemd-analyze is not installed: apt-get install systemd, and run this again")
    assert faults(tmp_path, unit, name, text) == []


def test_systemd_reads_the_drop_ins(tmp_path: Path) -> None:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("systemd-analyze is not installed: apt-get install systemd, and run this again")
    ((unit, name, text),) = DROP_INS
    assert faults(tmp_path, unit, name, f"{text}Nonsense=1\n") != []


# --- the device server ------------------------------------------------------------------------------


@contextmanager
def device_server(folder: Path) -> Iterator[tuple[int, int]]:
    """ser2net as the page configures it, for a pseudo-terminal: its port, and the other end of the cable."""
    program, port = unpacked.program("ser2net"), free_port()
    units, device = os.openpty()
    tty.setraw(device)
    text = example("yaml", "connection:").replace("0.0.0.0,4001", f"127.0.0.1,{port}")
    config = folder / "ser2net.yaml"
    config.write_text(text.replace("/dev/ttyS0", os.ttyname(device)))
    environment = unpacked.environment("ser2net")
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen([program, "-n", "-c", config], env=environment, stdout=log, stderr=log)
    try:
        eventually(lambda: _accepts(port), "ser2net listens")
        yield port, units
    finally:
        process.kill()
        process.wait()
        os.close(units)
        os.close(device)


def _accepts(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port)).close()
    except OSError:
        return False
    return True


def _connected(port: int) -> socket.socket:
    return socket.create_connection(("127.0.0.1", port), PATIENCE_S)


def _until_closed(connection: socket.socket) -> bytes:
    received = b""
    while data := connection.recv(256):
        received += data
    return received


def test_a_device_server_serves_one_and_gives_up_who_falls_still(tmp_path: Path) -> None:
    with device_server(tmp_path) as (port, units):

        def holding() -> socket.socket | None:
            """A connection whose bytes reach the cable: the one before may not be closed yet."""
            connection = _connected(port)
            connection.sendall(READ)
            if units in select([connection, units], [], [], PATIENCE_S)[0]:
                return connection
            connection.close()
            return None

        first = eventually(holding, "the port is given")
        with first:
            assert os.read(units, 64).endswith(READ)
            with _connected(port) as second:
                refusal = _until_closed(second)
            assert refusal.strip() == b"Port already in use"
            decoder = FrameDecoder(Dialect())
            assert not any(isinstance(event, ReceivedFrame) for event in decoder.feed(refusal))
            began = time.monotonic()
            first.settimeout(PATIENCE_S)
            assert _until_closed(first) == b""
            assert time.monotonic() - began > 1, "not at once"
        with eventually(holding, "the next one has the port"):
            assert os.read(units, 64).endswith(READ)
