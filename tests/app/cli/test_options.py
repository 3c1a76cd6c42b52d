"""The options that several commands share: the configuration of a command that names none, and its bearer
token."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from click.testing import CliRunner

from app.cli import cli
from app.cli.command import NEW_CONFIG, TOKEN_VARIABLE, bearer_token, default_config
from bus.errors import CallerError
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
def test_a_user_who_may_not_look_is_told_so_in_any_folder() -> None:
    """Neither the folder of the service nor this one may be open to the user."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o755)
        etc, closed = Path(folder, "etc"), Path(folder, "closed")
        for each in (etc, closed):
            each.mkdir(mode=0o700)
        (etc / "lineside.toml").touch()
        program = (
            "import os, pathlib, app.cli.command as found\n"
            "from bus.configuration import ConfigurationError, read\n"
            "import bus.messages; str(bus.messages.Message('configuration_missing', {'file': ''}))\n"
            "os.setgroups([]); os.setgid(4321); os.setuid(4321)\n"
            f"path = pathlib.Path({str(etc / 'lineside.toml')!r})\n"
            "assert found.default_config({}, path) == path\n"
            f"assert found.default_config({{}}, pathlib.Path({folder!r}, 'none', 'x')) == found.NEW_CONFIG\n"
            "try: read(path)\n"
            "except ConfigurationError as error: print(error.message)\n"
        )
        words = [sys.executable, "-c", program]
        environment = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1"}
        done = subprocess.run(words, cwd=closed, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        assert "may not read it; call the command with sudo" in done.stdout


def test_a_command_finds_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a process of its own, because the variable is read with the module."""
    monkeypatch.setenv("LINESIDE_CONFIG", str(tmp_path / "missing.toml"))
    show = "from app.cli.command import LINESIDE_TOML; print(LINESIDE_TOML)"
    done = subprocess.run([sys.executable, "-c", show], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == str(tmp_path / "missing.toml")


@pytest.fixture(autouse=True)
def bare(monkeypatch: pytest.MonkeyPatch) -> None:
    """The environment of the test gives none."""
    monkeypatch.delenv(TOKEN_VARIABLE, raising=False)


def token_file(folder: Path, text: str, mode: int = 0o600) -> Path:
    file = folder / "token"
    file.write_text(text)
    file.chmod(mode)
    return file


def test_the_option_comes_first_then_the_file_then_the_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(TOKEN_VARIABLE, "of-environment\n")
    assert bearer_token("of-option", None) == "of-option"
    assert bearer_token("", token_file(tmp_path, "of-file\nnot this\n")) == "of-file"
    assert bearer_token("", None) == "of-environment"


def test_the_former_variable_of_the_worker_still_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LINESIDE_WORKER_TOKEN", "former")
    assert bearer_token("", None, "LINESIDE_WORKER_TOKEN") == "former"
    monkeypatch.setenv(TOKEN_VARIABLE, "present")
    assert bearer_token("", None, "LINESIDE_WORKER_TOKEN") == "present"


def test_none_both_an_absent_file_and_one_without_a_token_are_refused(tmp_path: Path) -> None:
    for text, error in (("\nx", "has no token"), ("a b", "no token has"), ("ü", "no token has")):
        with pytest.raises(CallerError, match=error):
            bearer_token("", token_file(tmp_path, text))
    with pytest.raises(CallerError, match="there is no token: give --token-file FILE"):
        bearer_token("", None)
    with pytest.raises(CallerError, match="give one of them"):
        bearer_token("x", token_file(tmp_path, "y"))
    with pytest.raises(CallerError, match="No such file"):
        bearer_token("", tmp_path / "absent")


def test_only_the_first_line_of_a_large_file_is_read(tmp_path: Path) -> None:
    assert bearer_token("", token_file(tmp_path, "first\n" + "x" * 10_000_000)) == "first"


@pytest.mark.parametrize(("mode", "warns"), [(0o600, False), (0o640, True)])
def test_a_file_that_others_can_read_is_warned_about(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], mode: int, warns: bool
) -> None:
    bearer_token("", token_file(tmp_path, "t", mode))
    assert ("chmod 600" in capsys.readouterr().err) is warns


def test_the_worker_takes_its_token_from_a_file(tmp_path: Path) -> None:
    """It comes as far as its configuration, which is not there."""
    file = token_file(tmp_path, "t")
    call = ["worker", "--bus", "b", "--app", "http://127.0.0.1:1", "--config", str(tmp_path / "none.toml")]
    assert "there is no token" in CliRunner().invoke(cli, call).stderr
    assert "there is no such file" in CliRunner().invoke(cli, [*call, "--token-file", str(file)]).stderr
