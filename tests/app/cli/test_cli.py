"""The command as a person types it: check, user, token, audit; exit codes and one line on stderr."""

from __future__ import annotations

import os
import pty
import re
import select
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from importlib.metadata import version
from pathlib import Path
from typing import cast

import click
import pytest
from click.testing import CliRunner

from app.cli import COMMANDS, cli
from tests.for_each import for_each

PATIENCE_S = 60.0
"""This machine may be busy."""
CONFIG = """\
[site]
name = "Mill 7"
[[bus]]
name = "dry-end"
port = "/dev/ttyUSB99"
[[bus.unit]]
id = 1
name = "Unwind"
"""


class Shell:
    """Runs the command in a folder that has a lineside.toml."""

    def __init__(self, folder: Path) -> None:
        self.config = folder / "lineside.toml"
        self.config.write_text(CONFIG)
        self.store = folder / "data" / "lineside.db"

    def __call__(self, *words: str, typed: str = "") -> tuple[int, str, str]:
        result = CliRunner().invoke(cli, [*words, "--config", str(self.config)], input=typed)
        return result.exit_code, result.stdout, result.stderr


@pytest.fixture
def lineside(tmp_path: Path) -> Shell:
    return Shell(tmp_path)


def test_every_command_is_there_and_explains_itself() -> None:
    for name in COMMANDS:
        result = CliRunner().invoke(cli, [name, "--help"])
        assert result.exit_code == 0, name
        assert "Usage:" in result.stdout


def test_a_withdrawn_command_names_what_takes_its_place() -> None:
    result = CliRunner().invoke(cli, ["home", "take", "--bus", "dry-end"])
    assert (result.exit_code, result.stdout) == (2, "")
    assert "lineside home is withdrawn" in result.stderr
    assert "lineside restore-store" in result.stderr
    assert "[[peer]]" in result.stderr


FACTS = (
    *("scan", "decode", "check", "status", "report", "user list", "token list", "audit verify"),
    *("backup", "diff", "restore", "backup-store", "install-service"),
)
"""Commands that print facts."""


def every_command(group: click.Group, above: str = "") -> Iterator[tuple[str, click.Command]]:
    for name in group.list_commands(click.Context(group)):
        _, command, _ = group.resolve_command(click.Context(group), [name])
        assert command is not None
        yield f"{above}{name}", command
        if isinstance(command, click.Group):
            yield from every_command(command, f"{name} ")


def test_options_are_the_same_in_every_command() -> None:
    helps: dict[str, set[str]] = {}
    with_json = set()
    for words, command in every_command(cast(click.Group, cli)):
        context = click.Context(command, parent=cli.make_context("lineside", words.split()))
        assert context.help_option_names == ["-h", "--help"]
        for option in command.params:
            if option.opts[0] in ("--config", "--json", "--token", "--token-file"):
                helps.setdefault(option.opts[0], set()).add(str(option.type.name))
            with_json |= {words} if "--json" in option.opts else set()
    assert with_json == {*FACTS}
    assert {name: len(kinds) for name, kinds in helps.items()} == dict.fromkeys(helps, 1)


def test_a_shell_completes_commands_and_options(monkeypatch: pytest.MonkeyPatch) -> None:
    def completed(words: str, last: str) -> str:
        monkeypatch.setenv("COMP_WORDS", words)
        monkeypatch.setenv("COMP_CWORD", str(len(words.split()) - bool(last)))
        monkeypatch.setenv("_LINESIDE_COMPLETE", "bash_complete")
        return CliRunner().invoke(cli, prog_name="lineside").stdout

    found = completed("lineside st", "st")
    assert ("status" in found, "serve" in found) == (True, False)
    assert "list" in completed("lineside user ", "")
    assert "--json" in completed("lineside status --j", "--j")


def test_it_prints_its_version() -> None:
    result = CliRunner().invoke(cli, ["--version"])
    assert (result.exit_code, result.stdout) == (0, f"lineside {version('lineside')}\n")


STAGES = """import sys, click; from contextlib import suppress; from app.cli import cli, main
def end(stage): print("STAGE", *(name for name, module in sys.modules.items() if module is not None))
cli.shell_complete(click.Context(cli), "st"); end("completed")
cli(["--help"], standalone_mode=False); end("helped")
sys.argv = ["lineside", "--help"]
with suppress(SystemExit): main()
import app.cli.serve, app.cli.hosting, structlog; end("workers begin")
print(app.cli.hosting._import_server().__name__)
from fastapi.openapi.models import Info; print(Info.__pydantic_complete__, Info(title="", version="").title)
end("serves")
"""
NOT_FOR_HELP = {"fastapi", "pydantic", "sqlite3", "httpx", "bus.simulator.plant", "app.main"}
NOT_TO_SERVE = {
    *("multiprocessing", "pydantic.v1", "rich", "httpx", "httpx2", "authlib", "joserfc", "cryptography"),
    *("asyncua", "app.system.opcua.process", "app.system.opcua.link"),
}
"""The command line of uvicorn, the login with a company account, OPC UA, and the models that describe
OpenAPI."""


def test_nothing_is_imported_before_it_is_needed() -> None:
    """A shell completes without a command's module, help is printed without web, store and wire, workers
    begin before the dashboard is imported, and that leaves out what it never uses."""
    # The measurement of coverage would load modules.
    environment = {name: value for name, value in os.environ.items() if not name.startswith("COVERAGE")}
    run = [sys.executable, "-c", STAGES]
    shown = subprocess.run(run, capture_output=True, text=True, check=True, env=environment).stdout
    completed, helped, begun, served = (
        set(line.split()) for line in shown.splitlines() if line.startswith("STAGE")
    )
    assert [name for name in completed if name.startswith("app.cli.")] == []
    assert "  serve" in shown
    assert helped & NOT_FOR_HELP == set()
    assert begun & {"fastapi", "rich"} == set()
    assert "\napp.cli.server\nFalse \n" in shown
    assert served & NOT_TO_SERVE == set()


def test_a_bad_configuration_is_refused_with_its_line(lineside: Shell) -> None:
    lineside.config.write_text(CONFIG.replace("[site]", "[sight]"))
    for command in ("check", "serve"):
        code, out, err = lineside(command)
        assert (code, out) == (1, "")
        assert f"{lineside.config}:1: unknown key sight in the file; did you mean site?" in err


def test_users(lineside: Shell) -> None:
    add = ("user", "add", "ann", "--role", "operator", "--password-stdin")
    assert lineside(*add, typed="correct horse\n") == (0, "", "")
    assert lineside("user", "list")[1] == "ann\toperator\n"
    assert lineside("user", "password", "ann", "--password-stdin", typed="another good one") == (0, "", "")
    code, _, err = lineside(*add, typed="correct horse")
    assert (code, err) == (2, "lineside: a user ann exists already; choose another name\n")
    assert lineside("user", "remove", "ann")[0] == 0
    assert lineside("user", "list")[1] == ""


def test_without_a_terminal_a_password_comes_by_its_option(lineside: Shell) -> None:
    code, out, err = lineside("user", "add", "ann", "--role", "viewer", typed="correct horse\n")
    assert (code, out) == (2, "")
    assert "give --password-stdin" in err
    assert lineside("user", "list")[1] == ""


def test_a_terminal_prompts_for_the_password_without_echo(lineside: Shell) -> None:
    """README, step 4: at a terminal, the command must not wait without a prompt."""
    master, slave = pty.openpty()
    words = ("user", "add", "ann", "--role", "admin", "--password-stdin", "--config", str(lineside.config))
    with subprocess.Popen(
        [sys.executable, "-m", "app.cli", *words],
        stdin=slave,
        stdout=slave,
        stderr=slave,
        start_new_session=True,
    ) as process:
        os.close(slave)
        shown = b""
        for prompt in (b"Password: ", b"confirmation: "):
            while prompt not in shown.rpartition(b"\n")[2]:
                assert select.select([master], [], [], PATIENCE_S)[0], f"no prompt: {shown!r}"
                shown += os.read(master, 1024)
            os.write(master, b"correct horse battery\n")
        assert process.wait(PATIENCE_S) == 0
    os.close(master)
    assert b"horse" not in shown
    assert lineside("user", "list")[1] == "ann\tadmin\n"


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (["nonsense"], "No such command"),
        (["serve", "--nonsense"], "No such option"),
        (["user", "add"], "Missing argument"),
        (["user", "add", "ann", "--role", "king"], "'king' is not one of 'viewer', 'operator'"),
        (["user", "add", "ann", "--role", "viewer", "--password-stdin"], "12 to 256 characters"),
        (["user", "remove", "eve"], "there is no user eve"),
        (["token", "revoke", "t"], "there is no token t"),
        (
            ["token", "create", "t", "--role", "worker", "--bus", "x"],
            "there is no bus 'x'; there are: dry-end",
        ),
        (["token", "create", "t", "--role", "viewer", "--expires", "0"], "after 1 to 3650 days"),
    ],
)
def test_wrong_use_exits_with_2(lineside: Shell, words: list[str], error: str) -> None:
    code, out, err = lineside(*words)
    assert (code, out) == (2, "")
    assert error in err


def test_tokens(lineside: Shell) -> None:
    code, out, err = lineside("token", "create", "plc", "--role", "worker", "--bus", "dry-end")
    assert (code, err) == (0, "")
    assert len(out.strip()) >= 43
    assert out.count("\n") == 1
    assert re.fullmatch(r"plc\tworker\t[^\t]+\tdry-end\n", lineside("token", "list")[1])
    assert out.strip() not in lineside("token", "list")[1]
    assert lineside("token", "revoke", "plc")[0] == 0
    assert lineside("token", "list")[1] == ""


def tamper(store: Path, sql: str) -> None:
    with closing(sqlite3.connect(store)) as connection:
        names = connection.execute("SELECT name FROM sqlite_master WHERE type = 'trigger'").fetchall()
        for (name,) in names:
            connection.execute(f"DROP TRIGGER {name}")
        connection.execute(sql)
        connection.commit()


def test_the_log_is_verified_and_its_first_broken_entry_named(lineside: Shell) -> None:
    for name in ("a", "b", "c"):
        lineside("token", "create", name, "--role", "viewer")
    assert lineside("audit", "verify") == (0, "the audit log is intact: 3 entries\n", "")
    tamper(lineside.store, "UPDATE events SET who = 'nobody' WHERE id = 2")
    code, out, err = lineside("audit", "verify")
    assert (code, out) == (1, "")
    assert "the audit log is broken at entry 2: " in err


def test_no_store_and_no_log(lineside: Shell) -> None:
    code, _, err = lineside("audit", "verify")
    assert code == 1
    assert "nothing was served with this configuration yet" in err
    assert not lineside.store.exists(), "to look is not to make"


def test_a_store_that_is_none(lineside: Shell) -> None:
    lineside.store.parent.mkdir()
    lineside.store.write_bytes(b"nonsense" * 200)
    lineside.config.write_text("[server]\nport = 0\n" + CONFIG)
    for words in (("audit", "verify"), ("user", "list"), ("serve",)):
        code, out, err = lineside(*words)
        assert (code, out) == (1, ""), words
        assert "it is not a Lineside store, or it is damaged" in err


def test_a_worker_without_its_bus(lineside: Shell) -> None:
    call = ("worker", "--bus", "nix", "--app", "http://127.0.0.1:1", "--token", "t")
    code, _, err = lineside(*call)
    assert code == 1
    assert "there is no [[bus]] named 'nix'; it has dry-end" in err
    assert lineside("worker", "--bus", "dry-end", "--app", "plant", "--token", "t")[0] == 2


@for_each(
    ("words", "code", "error"),
    [
        (["backup", "--url", "http://a..b", "--token", "t"], 1, "cannot be reached"),
        (["backup", "--url", "http://127.0.0.1:1", "--token", "ü"], 2, "no token"),
    ],
)
def test_an_impossible_call_prints_one_line(words: list[str], code: int, error: str) -> None:
    done = CliRunner().invoke(cli, [*words, "--bus", "b", "--out", "o"])
    assert (done.exit_code, done.stderr.count("\n")) == (code, 1)
    assert done.stderr.startswith("lineside: ")
    assert error in done.stderr
