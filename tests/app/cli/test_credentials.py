"""Where a command takes its token from."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from app.cli import cli
from app.cli.options import TOKEN_VARIABLE, bearer_token
from bus.errors import CallerError


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


@pytest.mark.parametrize(
    ("text", "error"),
    [("", "has no token"), ("\nx", "has no token"), ("a b", "no token has"), ("ü", "no token has")],
)
def test_a_file_without_a_token_is_refused(tmp_path: Path, text: str, error: str) -> None:
    with pytest.raises(CallerError, match=error):
        bearer_token("", token_file(tmp_path, text))


def test_none_both_and_an_absent_file_are_refused(tmp_path: Path) -> None:
    with pytest.raises(CallerError, match="there is no token: give --token-file FILE"):
        bearer_token("", None)
    with pytest.raises(CallerError, match="give one of them"):
        bearer_token("x", token_file(tmp_path, "y"))
    with pytest.raises(CallerError, match="No such file"):
        bearer_token("", tmp_path / "absent")


def test_only_the_first_line_of_a_large_file_is_read(tmp_path: Path) -> None:
    assert bearer_token("", token_file(tmp_path, "first\n" + "x" * 10_000_000)) == "first"


@pytest.mark.parametrize(("mode", "warns"), [(0o600, False), (0o640, True), (0o644, True)])
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
