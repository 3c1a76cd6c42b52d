"""PostgreSQL with a synchronous standby, each on its machine: a commit is acknowledged once both have it."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

from tests.campaign.network import SUBNET, Machine, call

BINARIES = Path("/usr/lib/postgresql/15/bin")
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
    """``first`` begins as the primary, ``second`` as its standby."""

    first: Machine
    second: Machine
    folder: Path = field(default_factory=lambda: Path(tempfile.mkdtemp(prefix="lineside-campaign-")))
    """Not a folder of pytest, which other users may not enter. ``close`` removes it."""
    running: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)

    @property
    def url(self) -> str:
        return f"postgresql://postgres@{self.first.address}/lineside"

    def start(self) -> None:
        """Make both and wait until they replicate."""
        shutil.chown(self.folder, "postgres")
        data = self._data(self.first)
        self._as_postgres(self.first, "initdb", "--no-sync", "--auth=trust", "-D", data)
        with (data / "pg_hba.conf").open("a") as rules:
            rules.write(f"host all all {SUBNET}.0/24 trust\nhost replication all {SUBNET}.0/24 trust\n")
        self._configure(self.first, standby="")
        self.begin(self.first)
        self._sql("CREATE DATABASE lineside", database="postgres")
        source = f"postgresql://postgres@{self.first.address}"
        copy = ("-d", source, "-D", self._data(self.second), "--write-recovery-conf", "--no-sync")
        self._as_postgres(self.second, "pg_basebackup", *copy, "--checkpoint=fast")
        self.begin(self.second)
        self._configure(self.first, standby="*")
        self._sql("SELECT pg_reload_conf()")
        self.wait_until_synchronous()

    def close(self) -> None:
        """Remove what it kept, once nothing of it runs."""
        shutil.rmtree(self.folder)

    def begin(self, machine: Machine) -> None:
        """Start the server of a machine, also after it was killed, and wait until it accepts connections."""
        log = self.folder / f"{machine.name}.log"
        command = (*AS_POSTGRES, BINARIES / "postgres", "-D", self._data(machine))
        self.running[machine.name] = machine.start(*command, log=log, cwd=self.folder)
        ready = [*machine.inside, str(BINARIES / "pg_isready"), "-q", "-h", machine.address]
        end = time.monotonic() + PATIENCE_S
        while subprocess.run(ready).returncode:
            assert time.monotonic() < end, log.read_text()[-2000:]
            time.sleep(0.1)

    def wait_until_synchronous(self) -> None:
        """Until every commit is on both."""
        end = time.monotonic() + PATIENCE_S
        while "sync" not in self._sql("SELECT sync_state FROM pg_stat_replication").split():
            assert time.monotonic() < end, "the standby does not replicate"
            time.sleep(0.1)

    def _data(self, machine: Machine) -> Path:
        return self.folder / machine.name

    def _configure(self, machine: Machine, standby: str) -> None:
        (self._data(machine) / "postgresql.auto.conf").write_text(CONFIGURATION.format(standby=standby))

    def _as_postgres(self, machine: Machine, program: str, *words: object) -> str:
        return call(*machine.inside, *AS_POSTGRES, BINARIES / program, *words, cwd=self.folder)

    def _sql(self, statement: str, database: str = "lineside") -> str:
        url = self.url.replace("/lineside", f"/{database}")
        return self._as_postgres(self.first, "psql", "-X", "-A", "-t", "-d", url, "-c", statement)
