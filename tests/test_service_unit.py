"""The systemd units of docs/hardware.md: they verify, agree on their folders, and run as they are written."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from configparser import ConfigParser
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest

from tests import fork_server
from tests.e2e.site import eventually
from tests.free_port import free_port
from tests.test_architecture import ROOT, text_of

LINESIDE = Path(sys.executable).with_name("lineside")
PATIENCE_S = 60.0
INSTALLED = "/opt/lineside/bin/lineside"
CONFIGURATION = "/etc/lineside"
STATE = "/var/lib"
"""Where systemd makes a StateDirectory (systemd.exec(5))."""
MAKE_FOLDER = "sudo install -d -o lineside -g lineside "
AS_SERVICE = "sudo -u lineside "
TEXT = text_of(ROOT / "docs" / "hardware.md")
UNITS = {
    match[1]: match[2]
    for match in re.finditer(r"`/etc/systemd/system/([\w-]+\.service)`:\n\n```ini\n(.*?)```", TEXT, re.S)
}
COMMANDS = [line for block in re.findall(r"```sh\n(.*?)```", TEXT, re.S) for line in block.splitlines()]
"""What an administrator types, in order."""
CONFIGURATIONS = re.findall(r"```toml\n(\[server\].*?)```", TEXT, re.S)


class Unit(ConfigParser):
    """A unit file whose keys keep their case."""

    def __init__(self, text: str) -> None:
        super().__init__(interpolation=None)
        self.optionxform = str  # type: ignore[assignment,method-assign]
        self.read_string(text)

    @property
    def service(self) -> dict[str, str]:
        """The section [Service]."""
        return dict(self["Service"])


def test_both_units_and_their_configuration_are_documented() -> None:
    assert list(UNITS) == ["lineside.service", "lineside-worker.service"]
    assert len(CONFIGURATIONS) == 1


@pytest.mark.parametrize("name", UNITS)
def test_systemd_accepts_it_without_a_word(name: str, tmp_path: Path) -> None:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("systemd-analyze is not installed: apt-get install systemd, and run this again")
    unit = tmp_path / name
    unit.write_text(UNITS[name].replace(INSTALLED, str(LINESIDE)))
    done = subprocess.run(["systemd-analyze", "verify", unit], capture_output=True, text=True)
    errors = [line for line in done.stderr.splitlines() if name in line]
    assert (errors, done.returncode) == ([], 0)


@pytest.mark.parametrize("name", UNITS)
def test_it_has_what_a_service_on_a_plant_needs(name: str) -> None:
    unit = Unit(UNITS[name])
    service = unit.service
    assert unit["Unit"]["StartLimitIntervalSec"] == "0", "a fault that lasts must not end it for good"
    wanted = {
        "User": "lineside",
        "SupplementaryGroups": "dialout",
        "UMask": "0077",
        "Restart": "always",
        "KillSignal": "SIGTERM",
        "NoNewPrivileges": "yes",
        "ProtectSystem": "strict",
    }
    assert {key: service.get(key) for key in wanted} == wanted
    assert "PrivateDevices" not in service, "the serial ports are devices"
    assert not any("TOKEN" in value.upper() for value in service.values()), "all may read a command line"


def test_every_command_of_the_service_runs_as_its_user() -> None:
    """No other user may read its folders."""
    assert [line for line in COMMANDS if INSTALLED in line and not line.startswith(AS_SERVICE)] == []


def test_its_folders_are_those_of_the_configuration() -> None:
    service, settings = Unit(UNITS["lineside.service"]).service, tomllib.loads(CONFIGURATIONS[0])
    state = f"{STATE}/{service['StateDirectory']}"
    assert Path(settings["server"]["data"]).parent == Path(state), (
        "the audit key may have to be made beside the data"
    )
    assert service["ReadWritePaths"] == CONFIGURATION
    made = {shlex.split(line)[-1] for line in COMMANDS if line.startswith(MAKE_FOLDER)}
    assert made == {CONFIGURATION, state}
    assert "`LINESIDE_TOKEN=…`" in TEXT
    for unit in UNITS.values():
        called = shlex.split(Unit(unit).service["ExecStart"])
        assert called[0] == INSTALLED
        assert called[called.index("--config") + 1] == f"{CONFIGURATION}/lineside.toml"


# --- as systemd would run it ------------------------------------------------------------------------


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A temporary file system, with the folders and the configuration that an administrator makes."""
    for folder in (CONFIGURATION, STATE):
        (tmp_path / folder[1:]).parent.mkdir(parents=True, exist_ok=True)
    for command in COMMANDS:
        if command.startswith(MAKE_FOLDER):
            words = shlex.split(below(tmp_path, command.removeprefix(MAKE_FOLDER)))
            subprocess.run(["install", "-d", *words], check=True)
    typed(tmp_path, "init")
    return tmp_path


def typed(root: Path, command: str, code: int = 0) -> str:
    """Run the documented ``lineside`` command of this name below ``root``; gives what it printed."""
    (line,) = (line for line in COMMANDS if line.startswith(f"{AS_SERVICE}{INSTALLED} {command} "))
    words = shlex.split(below(root, line.removeprefix(f"{AS_SERVICE}{INSTALLED}")))
    done = fork_server.run(*words)
    assert (done.returncode, bool(done.stderr)) == (code, bool(code)), done.stderr
    return done.stdout


@contextmanager
def running(root: Path, unit: str, **environment: str) -> Iterator[subprocess.Popen[str]]:
    """The ExecStart of a unit below ``root``, in the working folder and environment that systemd gives it."""
    command = Unit(UNITS[unit]).service["ExecStart"].replace(INSTALLED, str(LINESIDE))
    called = [below(root, word) for word in shlex.split(command)]
    log = root / "log"
    with (
        log.open("w") as output,
        subprocess.Popen(
            called,
            cwd="/",
            env={"PATH": "/usr/bin:/bin", "LANG": "C.UTF-8", **environment},
            stdout=output,
            stderr=output,
            text=True,
            umask=0o077,
        ) as process,
    ):
        try:
            yield process
        finally:
            process.terminate()
            code = process.wait(PATIENCE_S)
    assert (code, "Traceback" in log.read_text()) == (0, False), log.read_text()


def below(root: Path, text: str) -> str:
    """``text`` with the folders of the documentation below ``root``."""
    for folder in (CONFIGURATION, f"{STATE}/lineside"):
        text = text.replace(folder, f"{root}{folder}")
    return text


def test_the_service_serves_and_keeps_its_data_as_configured(root: Path) -> None:
    port = free_port()
    text = below(root, CONFIGURATIONS[0]).replace("port = 8000", f"port = {port}")
    (root / "etc/lineside/lineside.toml").write_text(text)
    assert f"data in {root}/var/lib/lineside/data, created at the first start\n" in typed(root, "check")
    typed(root, "status", code=1)
    with running(root, "lineside.service"):

        def serves() -> bool:
            try:
                response = httpx.get(f"http://127.0.0.1:{port}/healthz", trust_env=False)
            except httpx.TransportError:
                return False
            return response.json() == {"status": "ok"}

        eventually(serves, "the dashboard serves")
        assert f"serving at http://127.0.0.1:{port}, Lineside " in typed(root, "status")
    assert (root / "var/lib/lineside/data/lineside.db").is_file()
    made = {path.name for path in (root / "etc").rglob("*") if path.is_file()}
    assert made <= {"lineside.toml", "lineside.audit.key", "lineside.audit.key.anchor"}
    readable = [path for path in (root / "var").rglob("*") if path.is_file() and path.stat().st_mode & 0o077]
    assert readable == []


def test_the_worker_takes_its_token_from_its_environment(root: Path) -> None:
    (root / "etc/lineside/lineside.toml").write_text(below(root, CONFIGURATIONS[0]))
    with running(root, "lineside-worker.service", LINESIDE_TOKEN="secret"):
        eventually(
            lambda: "ws://server:8000/feed" in (root / "log").read_text(), "the dashboard is looked for"
        )
