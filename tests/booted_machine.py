"""A Debian without anything of ours, booted by systemd in a container: what a plant installs on."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

SUITE = "bookworm"
PACKAGES = "python3,systemd,systemd-sysv,debconf,kmod,udev,dbus,procps"
BOOT_S = 60
ENVIRONMENT = "export PATH=/usr/sbin:/usr/bin:/sbin:/bin DEBIAN_FRONTEND=noninteractive LC_ALL=C"
IS_UP = """
import sys, time, urllib.request
end = time.monotonic() + float(sys.argv[2])
while time.monotonic() < end:
    try:
        if urllib.request.urlopen(sys.argv[1], timeout=1).status == 200:
            sys.exit(0)
    except OSError:
        time.sleep(0.2)
sys.exit("not up")
"""


@dataclass(frozen=True)
class Machine:
    """``root``: its files; ``pid``: its systemd, as this machine sees it."""

    root: Path
    pid: int

    def run(self, script: str) -> str:
        """What a shell of root there prints; fails where a command does."""
        done = subprocess.run(
            ["nsenter", "-t", str(self.pid), "-m", "-u", "-i", "-n", "-p", "--", "bash", "-euo", "pipefail"],
            input=f"{ENVIRONMENT}\n{script}\n",
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout.strip()

    def wait_for(self, url: str, within_s: float) -> float:
        """Seconds until the page is there."""
        started = time.monotonic()
        self.run(f"python3 -c '{IS_UP}' {url} {within_s}")
        return time.monotonic() - started

    def put(self, file: Path) -> str:
        """The path there of a copy of a file of this machine."""
        shutil.copy(file, self.root / "root")
        return f"/root/{file.name}"


@contextmanager
def booted(folder: Path) -> Iterator[Machine]:
    """Make and boot it, without a network. Skips the test where that cannot be done."""
    if os.geteuid() != 0 or not (shutil.which("debootstrap") and shutil.which("systemd-nspawn")):
        pytest.skip("needs root, debootstrap and systemd-container")
    root = folder / "machine"
    subprocess.run(
        ["debootstrap", "--variant=minbase", f"--include={PACKAGES}", SUITE, root],
        check=True,
        capture_output=True,
    )
    options = ("-q", "--register=no", "--keep-unit", "--private-network", "-b")
    with (folder / "console.log").open("wb") as console:
        container = subprocess.Popen(
            ["systemd-nspawn", *options, "-D", root], stdin=subprocess.DEVNULL, stdout=console, stderr=console
        )
    try:
        machine = Machine(root, systemd_of(container))
        machine.run("systemctl is-system-running --wait || true")
        yield machine
    finally:
        container.send_signal(signal.SIGTERM)
        container.wait()


def systemd_of(container: subprocess.Popen[bytes]) -> int:
    children = Path(f"/proc/{container.pid}/task/{container.pid}/children")
    end = time.monotonic() + BOOT_S
    while time.monotonic() < end:
        for child in children.read_text().split():
            if Path(f"/proc/{child}/comm").read_text().strip() == "systemd":
                return int(child)
        time.sleep(0.1)
    raise AssertionError("systemd did not start in the container")
