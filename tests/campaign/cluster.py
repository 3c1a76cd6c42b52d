"""PostgreSQL with a synchronous standby, each on its machine: a commit is acknowledged once both have it."""

from __future__ import annotations

import shutil
import signal
import subprocess
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

from tests.campaign.network import SUBNET, Machine, call
from tests.postgresql import binaries

BINARIES = binaries() or Path()
AS_POSTGRES = ("runuser", "-u", "postgres", "--")
CONFIGURATION = """\
listen_addresses = '*'
unix_socket_directories = ''
fsync = off
max_connections = 60
shared_buffers = 32MB
synchronous_standby_names = '{standby}'
tcp_keepalives_idle = 2
tcp_keepalives_interval = 1
tcp_keepalives_count = 3
tcp_user_timeout = 4000
wal_sender_timeout = 4000
wal_receiver_timeout = 4000
"""
"""``fsync`` is off because machines are killed here, never the computer."""
PATIENCE_S = 60.0


@dataclass
class Cluster:
    """The two change their places when ``fail_over`` promotes the standby."""

    primary: Machine
    standby: Machine
    folder: Path = field(default_factory=lambda: Path(tempfile.mkdtemp(prefix="lineside-campaign-")))
    """Not a folder of pytest, which other users may not enter. ``close`` removes it."""
    running: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)

    @property
    def url(self) -> str:
        hosts = ",".join(sorted((self.primary.address, self.standby.address)))
        return f"postgresql://postgres@{hosts}/lineside?target_session_attrs=read-write&connect_timeout=2"

    def start(self) -> None:
        """Make both and wait until they replicate."""
        shutil.chown(self.folder, "postgres")
        data = self._data(self.primary)
        self._as_postgres(self.primary, "initdb", "--no-sync", "--auth=trust", "-D", data)
        with (data / "pg_hba.conf").open("a") as rules:
            rules.write(f"host all all {SUBNET}.0/24 trust\nhost replication all {SUBNET}.0/24 trust\n")
        self._configure(self.primary, standby="")
        self.begin(self.primary)
        self._sql("CREATE DATABASE lineside", database="postgres")
        self.add_standby()

    def add_standby(self) -> None:
        """Copy the primary to the other machine, and wait until every commit is on both."""
        source, data = f"postgresql://postgres@{self.primary.address}", self._data(self.standby)
        shutil.rmtree(data, ignore_errors=True)
        copy = ("-d", source, "-D", data, "--write-recovery-conf", "--no-sync", "--checkpoint=fast")
        self._as_postgres(self.standby, "pg_basebackup", *copy)
        self.begin(self.standby)
        self._configure(self.primary, standby="*")
        self._sql("SELECT pg_reload_conf()")
        self._wait_until_synchronous()

    def fail_over(self) -> None:
        """The primary dies, the standby takes its place. It waits for no other until ``add_standby``."""
        self.primary.signal(signal.SIGKILL)
        self.primary, self.standby = self.standby, self.primary
        self._configure(self.primary, standby="")
        for action in ("reload", "promote"):
            self._as_postgres(self.primary, "pg_ctl", action, "-D", self._data(self.primary))

    def close(self) -> None:
        """Remove what it kept, once nothing of it runs."""
        shutil.rmtree(self.folder)

    def begin(self, machine: Machine) -> None:
        """Start the server of a machine, also after it was killed, and wait until it accepts connections."""
        log = self.folder / f"{machine.name}.log"
        # Its number may still name a process that was killed and is not reaped, or another one.
        (self._data(machine) / "postmaster.pid").unlink(missing_ok=True)
        command = (*AS_POSTGRES, BINARIES / "postgres", "-D", self._data(machine))
        self.running[machine.name] = machine.start(*command, log=log, cwd=self.folder)
        ready = [*machine.inside, str(BINARIES / "pg_isready"), "-q", "-h", machine.address]
        end = time.monotonic() + PATIENCE_S
        while subprocess.run(ready).returncode:
            assert time.monotonic() < end, log.read_text()[-2000:]
            time.sleep(0.1)

    def _wait_until_synchronous(self) -> None:
        end = time.monotonic() + PATIENCE_S
        while "sync" not in self._sql("SELECT sync_state FROM pg_stat_replication").split():
            assert time.monotonic() < end, "the standby does not replicate"
            time.sleep(0.1)

    def _data(self, machine: Machine) -> Path:
        return self.folder / machine.name

    def _configure(self, machine: Machine, standby: str) -> None:
        """Replace its settings; where to replicate from, which a standby has beside them, stays."""
        path = self._data(machine) / "postgresql.auto.conf"
        kept = [line for line in path.read_text().splitlines() if line.startswith("primary_conninfo")]
        path.write_text("\n".join([CONFIGURATION.format(standby=standby), *kept, ""]))

    def _as_postgres(self, machine: Machine, program: str, *words: object) -> str:
        return call(*machine.inside, *AS_POSTGRES, BINARIES / program, *words, cwd=self.folder)

    def _sql(self, statement: str, database: str = "lineside") -> str:
        url = f"postgresql://postgres@{self.primary.address}/{database}"
        return self._as_postgres(self.primary, "psql", "-X", "-A", "-t", "-d", url, "-c", statement)
