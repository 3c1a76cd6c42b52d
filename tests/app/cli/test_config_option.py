"""Which configuration a command takes that names none."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from app.cli.options import NEW_CONFIG, default_config
from tests.test_architecture import ROOT


def test_the_environment_comes_first_then_the_service_then_this_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An installed service has one configuration: a file in this folder does not hide it."""
    monkeypatch.chdir(tmp_path)
    of_service = tmp_path / "etc.toml"
    assert default_config({}, of_service) == NEW_CONFIG
    NEW_CONFIG.touch()
    assert default_config({}, of_service) == NEW_CONFIG
    of_service.touch()
    assert default_config({}, of_service) == of_service
    assert default_config({"LINESIDE_CONFIG": "/a/b.toml"}, of_service) == Path("/a/b.toml")
    assert default_config({"LINESIDE_CONFIG": ""}, of_service) == of_service


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can close a folder to another user")
@pytest.mark.parametrize("where", ["/", "closed"])
def test_a_user_who_may_not_look_is_told_so_in_any_folder(where: str) -> None:
    """Neither the folder of the service nor this one may be open to the user."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o755)
        etc, closed = Path(folder, "etc"), Path(folder, "closed")
        for each in (etc, closed):
            each.mkdir(mode=0o700)
        (etc / "lineside.toml").touch()
        program = (
            "import os, pathlib, app.cli.options as found\n"
            "from bus.configuration import ConfigurationError, read\n"
            "import bus.messages; str(bus.messages.Message('configuration_missing', {'file': ''}))\n"
            "os.setgroups([]); os.setgid(4321); os.setuid(4321)\n"
            f"path = pathlib.Path({str(etc / 'lineside.toml')!r})\n"
            "assert found.default_config({}, path) == path\n"
            f"assert found.default_config({{}}, pathlib.Path({folder!r}, 'none', 'x')) == found.NEW_CONFIG\n"
            "try: read(path)\n"
            "except ConfigurationError as error: print(error.message)\n"
        )
        folder_of_call = closed if where == "closed" else Path(where)
        words = [sys.executable, "-c", program]
        environment = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1"}
        done = subprocess.run(
            words, cwd=folder_of_call, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        assert "may not read it; call the command with sudo" in done.stdout


def test_a_command_finds_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Started and not forked, because the variable is read with the module."""
    monkeypatch.setenv("LINESIDE_CONFIG", str(tmp_path / "missing.toml"))
    program = Path(sys.executable).with_name("lineside")
    done = subprocess.run([program, "check"], capture_output=True, text=True, check=False)
    assert (done.returncode, str(tmp_path / "missing.toml") in done.stderr) == (1, True)
