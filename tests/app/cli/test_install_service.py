"""The service of systemd: its unit, the steps in their order, what is refused, and what is left alone."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import tomllib
from collections.abc import Sequence
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from app.cli import cli, install_service
from app.cli.findings import service
from app.cli.install_service import (
    ServiceUnit,
    carry_out,
    configured,
    installation,
    quoted,
    removal,
    run,
    unit_of,
    write_configuration,
)
from app.settings import Settings
from bus.errors import LinesideError
from tests.test_service_unit import UNITS


def test_the_documented_unit_is_the_installed_one() -> None:
    assert UNITS["lineside.service"] == ServiceUnit().text


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is not installed")
def test_it_exposes_little(tmp_path: Path) -> None:
    unit = tmp_path / "lineside.service"
    unit.write_text(ServiceUnit().text)
    words = ["systemd-analyze", "security", "--offline=true", "--threshold=20", "--no-pager", unit]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-500:]


@pytest.fixture
def unit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ServiceUnit:
    """The service with its configuration in a folder of the test, whose user is the one who runs it."""
    monkeypatch.setattr(shutil, "chown", lambda *_: None)
    return ServiceUnit(Path("/opt/lineside/bin/lineside"), tmp_path / "etc/lineside.toml", "plant")


def service_of(config: Path, text: str) -> ServiceUnit:
    config.parent.mkdir(exist_ok=True)
    config.write_text(text, encoding="utf-8")
    return unit_of(Path("/opt/lineside/bin/lineside"), config, "plant", configured(config))


def test_it_may_write_where_the_configuration_lets_it(tmp_path: Path) -> None:
    config = tmp_path / "etc" / "lineside.toml"
    assert unit_of(Path("/opt/x"), config, "plant", configured(config)).written == ()
    found = service_of(
        config,
        '[server]\ndata = "/srv/lineside"\n[backup]\nfolder = "/mnt/b"\n'
        '[audit]\nanchor = "/mnt/worm/a"\narchive = "/mnt/a"\n',
    )
    folders = (Path("/srv/lineside"), Path("/mnt/b"), Path("/mnt/a"), Path("/mnt/worm"))
    assert found.written == folders
    assert f"ReadWritePaths={config.parent} -/srv/lineside -/mnt/b -/mnt/a -/mnt/worm\n" in found.text
    own = '[server]\ndata = "/var/lib/lineside/data"\n[backup]\nfolder = "backups"\n'
    assert service_of(config, own).written == ()
    elsewhere = service_of(config, '[server]\ndata = "/srv/lineside"\n').written
    assert elsewhere == (Path("/srv/lineside"),), "the key and the anchor are beside the configuration"


@pytest.mark.parametrize(
    ("ports", "opens_ports"),
    [
        ([], True),
        (["socket://10.0.0.7:4001", "rfc2217://10.0.0.7:4002"], False),
        (["socket://10.0.0.7:4001", "/dev/ttyUSB0"], True),
    ],
)
def test_it_is_in_the_group_of_serial_ports_where_a_bus_is_on_one(
    tmp_path: Path, ports: list[str], opens_ports: bool
) -> None:
    config = tmp_path / "lineside.toml"
    assert "dialout" in unit_of(Path("/opt/x"), config, "plant", configured(config)).text
    buses = "".join(f'[[bus]]\nname = "bus-{n}"\nport = "{port}"\n' for n, port in enumerate(ports))
    text = service_of(config, buses).text
    assert ("SupplementaryGroups=dialout\n" in text) is opens_ports
    assert text.count("\n\n") == 2


SIGNS = "a b %h 100% $HOME \"q\" 'r' back\\slash ; # ä"


def test_signs_of_systemd_in_paths_are_quoted() -> None:
    assert [quoted(word) for word in ("/opt/x-1_2.toml", "-/mnt/b", "/a b", '/50%/"q"\\', "/ä")] == [
        *("/opt/x-1_2.toml", "-/mnt/b", '"/a b"', r'"/50%%/\"q\"\\"', '"/ä"')
    ]
    with pytest.raises(LinesideError, match=r"'/a\\nUser=root' has a sign"):
        quoted("/a\nUser=root")


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is not installed")
def test_systemd_reads_the_paths_that_were_meant(tmp_path: Path) -> None:
    folder, programs = tmp_path / SIGNS, tmp_path / "a b %h 100% $HOME ;"  # a program has no quotes there
    programs.mkdir()
    command = programs / "lineside"
    command.write_text("#!/bin/sh\n")
    command.chmod(0o755)
    written = (folder / "nightly copies", Path("/mnt/c d"))
    unit = ServiceUnit(command, folder / "lineside.toml", "root", written)
    assert verified(tmp_path, unit.text) == ""
    # What it would print: each path is read, and none only in part.
    assert "is not executable" in verified(tmp_path, ServiceUnit(programs / "absent", user="root").text)
    assert "not absolute" in verified(tmp_path, unit.text.replace('"-/mnt/c d"', "-/mnt/c d"))


def verified(folder: Path, text: str) -> str:
    """What systemd complains of in a unit file."""
    file = folder / "lineside.service"
    file.write_text(text, encoding="utf-8")
    # The check of its manual pages would run `man`, and every other unit of this machine is none of it.
    words = ["systemd-analyze", "verify", "--man=no", "--recursive-errors=no", file]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    return "".join(line for line in done.stderr.splitlines(keepends=True) if "lineside.service" in line)


def test_it_is_installed_in_order_and_again_without_a_change(tmp_path: Path, unit: ServiceUnit) -> None:
    done: list[str] = []

    def record(command: Sequence[str]) -> None:
        unit.configuration.parent.mkdir(exist_ok=True)
        done.append(" ".join(command[:2]))

    unit_file = tmp_path / "lineside.service"
    carry_out(unit, list(installation(unit, False)), record, unit_file=unit_file)
    assert done == [
        *("useradd --system", "install -d", "install -d"),
        *("systemctl daemon-reload", "systemctl enable", "systemctl restart"),
    ]
    assert unit_file.read_text() == unit.text
    assert f"--config {unit.configuration}\n" in unit.text
    written = tomllib.loads(unit.configuration.read_text())
    assert written["server"]["data"] == "/var/lib/lineside/data"
    unit.configuration.write_text("# mine\n")
    carry_out(unit, list(installation(unit, True)), record, unit_file=unit_file)
    assert unit.configuration.read_text() == "# mine\n"
    assert "useradd --system" not in done[6:]


def test_an_edited_unit_file_is_named_line_by_line_and_kept(
    tmp_path: Path, unit: ServiceUnit, capsys: pytest.CaptureFixture[str]
) -> None:
    unit.configuration.parent.mkdir()
    unit_file = tmp_path / "lineside.service"
    assert list(service(Settings(), unit_file)) == []
    edited = unit.text.replace("WatchdogSec=20", "WatchdogSec=abc").replace("Restart=", "Restrat=")
    unit_file.write_text(edited)
    if shutil.which("systemd-analyze"):
        complaints = "\n".join(str(each.message) for each in service(Settings(), unit_file) if each.is_fault)
        assert "abc" in complaints
        assert "Restrat" in complaints
    carry_out(unit, [["systemctl", "daemon-reload"]], lambda _: None, unit_file=unit_file)
    assert unit_file.read_text() == unit.text
    kept = tmp_path / "lineside.service.before"
    assert kept.read_text() == edited
    assert str(kept) in capsys.readouterr().out


def test_it_is_removed_and_leaves_configuration_and_data(tmp_path: Path, unit: ServiceUnit) -> None:
    unit.configuration.parent.mkdir()
    write_configuration(unit)
    commands = list(removal(tmp_path / "lineside.service"))
    carry_out(unit, commands, lambda _: None, unit_file=None)
    assert unit.configuration.exists()
    assert not any("rmdir" in word or str(unit.configuration) in word for each in commands for word in each)


def test_a_step_that_fails_is_named(tmp_path: Path) -> None:
    with pytest.raises(LinesideError, match=r"ls .*missing: .*No such file"):
        run(["ls", str(tmp_path / "missing")])
    with pytest.raises(LinesideError, match="no-such-program-here"):
        run(["no-such-program-here"])


def called(*words: str) -> Result:
    return CliRunner().invoke(cli, ["install-service", *words])


def test_a_dry_run_prints_the_unit_and_the_steps_and_changes_nothing(tmp_path: Path) -> None:
    config = tmp_path / "lineside.toml"
    printed = json.loads(called("--dry-run", "--json", "--config", str(config)).stdout)
    assert f"--config {config}" in printed["unit"]
    assert printed["steps"][-1] == "systemctl restart lineside.service"
    assert not config.exists()
    removed = called("--dry-run", "--remove").stdout
    assert "# systemctl disable --now lineside.service" in removed


def test_a_wrong_configuration_is_stated_and_nothing_installed(tmp_path: Path) -> None:
    config = tmp_path / "lineside.toml"
    config.write_text('[[bus]]\nname = "dry-end"\nport = "/dev/ttyUSB0"\nbaud = 1200000\n')
    for words in ((), ("--dry-run",), ("--dry-run", "--json")):
        done = called(*words, "--config", str(config))
        assert (done.exit_code, done.stdout) == (1, ""), done.stderr
        assert f"{config}:4: " in done.stderr
    removed = called("--dry-run", "--remove", "--config", str(config))
    assert (removed.exit_code, removed.stderr) == (0, "")


def test_without_systemd_or_with_a_bad_user_it_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(install_service, "BOOTED", tmp_path / "none")
    with pytest.raises(LinesideError, match="does not run systemd"):
        install_service.refuse_without_systemd()
    monkeypatch.setattr(install_service, "BOOTED", tmp_path)
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    with pytest.raises(LinesideError, match="only root"):
        install_service.refuse_without_systemd()
    with pytest.raises(LinesideError, match="home folder"):
        install_service.refuse_elsewhere(Path("/home/anna/venv/bin/lineside"))
    done = called("--user", "a b; rm")
    assert (done.exit_code, "no name of a user" in done.stderr) == (2, True)
