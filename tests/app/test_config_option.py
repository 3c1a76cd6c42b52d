"""Which configuration a command takes that names none."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from app.cli.config_option import NEW_CONFIG, default_config


def test_the_environment_comes_first_then_this_folder_then_the_service(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    of_service = tmp_path / "etc.toml"
    assert default_config({}, of_service) == NEW_CONFIG
    of_service.touch()
    assert default_config({}, of_service) == of_service
    NEW_CONFIG.touch()
    assert default_config({}, of_service) == NEW_CONFIG
    assert default_config({"LINESIDE_CONFIG": "/a/b.toml"}, of_service) == Path("/a/b.toml")
    assert default_config({"LINESIDE_CONFIG": ""}, of_service) == NEW_CONFIG


def test_a_command_finds_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Started and not forked, because the variable is read with the module."""
    monkeypatch.setenv("LINESIDE_CONFIG", str(tmp_path / "missing.toml"))
    program = Path(sys.executable).with_name("lineside")
    done = subprocess.run([program, "check"], capture_output=True, text=True, check=False)
    assert (done.returncode, str(tmp_path / "missing.toml") in done.stderr) == (1, True)
