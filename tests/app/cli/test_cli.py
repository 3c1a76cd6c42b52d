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
from tests import fork_server

PATIENCE_S = 60.0
"""This machine may be busy."""
PASSWORD = "correct horse"
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


@pytest.mark.parametrize("words", [("home",), ("home", "take", "--bus", "dry-end"), ("home", "--json")])
def test_a_withdrawn_command_names_what_takes_its_place(words: tuple[str, ...]) -> None:
    result = CliRunner().invoke(cli, words)
    assert (result.exit_code, result.stdout) == (2, "")
    assert "lineside home is withdrawn" in result.stderr
    assert "lineside restore-store" in result.stderr
    assert "[[peer]]" in result.stderr


PRINT_LOADED = "print(*(name for name, module in sys.modules.items() if module is not None))"


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


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_a_shell_completes_commands_and_options(shell: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def completed(words: str, last: str) -> str:
        monkeypatch.setenv("COMP_WORDS", words)
        monkeypatch.setenv("COMP_CWORD", last if shell == "fish" else str(len(words.split()) - bool(last)))
        monkeypatch.setenv("_LINESIDE_COMPLETE", f"{shell}_complete")
        return CliRunner().invoke(cli, prog_name="lineside").stdout

    monkeypatch.setenv("_LINESIDE_COMPLETE", f"{shell}_source")
    assert "_LINESIDE_COMPLETE" in CliRunner().invoke(cli, prog_name="lineside").stdout
    found = completed("lineside st", "st")
    assert ("status" in found, "serve" in found) == (True, False)
    assert "list" in completed("lineside user ", "")
    assert "--json" in completed("lineside status --j", "--j")


def test_completing_a_command_imports_none() -> None:
    program = (
        "import sys, click; from app.cli import cli; cli.shell_complete(click.Context(cli), 'st');"
        " print([name for name in sys.modules if name.startswith('app.cli.')])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_it_prints_its_version() -> None:
    result = CliRunner().invoke(cli, ["--version"])
    assert (result.exit_code, result.stdout) == (0, f"lineside {version('lineside')}\n")


def test_help_reads_nothing_heavy() -> None:
    """Sixteen commands are listed without importing the web, the store or the wire."""
    script = (
        "import sys; from app.cli import cli; cli(['--help'], standalone_mode=False); print(*sys.modules)"
    )
    shown = unmeasured(script)
    loaded = set(shown.split())
    assert "serve" in shown
    assert not loaded & {"fastapi", "pydantic", "sqlite3", "httpx", "bus.simulator.plant", "app.main"}


def unmeasured(code: str) -> str:
    """Run code in a process of its own without the measurement of coverage, which would load modules, and
    return what it prints."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("COVERAGE")}
    run = [sys.executable, "-c", code]
    return subprocess.run(run, capture_output=True, text=True, check=True, env=environment).stdout


def test_workers_begin_before_the_dashboard_is_imported() -> None:
    """Each takes a quarter of a second of the start, and rich 4 MiB of every process."""
    code = f"import sys; import app.cli.serve, app.cli.hosting, structlog; {PRINT_LOADED}"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert {"fastapi", "rich"} & set(run.stdout.split()) == set()


def test_the_dashboard_leaves_out_what_it_never_uses() -> None:
    """The command line of uvicorn and multiprocessing, the login with a company account, OPC UA, and the
    models that describe OpenAPI."""
    code = f"""import sys; from contextlib import suppress; from app.cli import main
sys.argv = ["lineside", "--help"]
with suppress(SystemExit): main()
from app.cli.hosting import _import_server; print(_import_server().__name__)
from fastapi.openapi.models import Info; print(Info.__pydantic_complete__, Info(title="", version="").title)
{PRINT_LOADED}"""
    *_, server, complete, loaded = unmeasured(code).splitlines()
    assert (server, complete) == ("app.cli.server", "False ")
    unused = {
        "multiprocessing",
        "pydantic.v1",
        "rich",
        "httpx",
        "httpx2",
        "authlib",
        "joserfc",
        "cryptography",
        "asyncua",
        "app.system.opcua.process",
        "app.system.opcua.link",
    }
    assert unused & set(loaded.split()) == set()


@pytest.mark.parametrize(
    "words", [["nonsense"], ["serve", "--nonsense"], ["user", "add"], ["token", "create"]]
)
def test_wrong_use_is_2(words: list[str]) -> None:
    result = CliRunner().invoke(cli, words)
    assert result.exit_code == 2
    assert result.stdout == ""


def test_check_reports_faults(lineside: Shell) -> None:
    lineside.config.write_text(CONFIG.replace("id = 1", "id = 0"))
    code, out, err = lineside("check")
    assert (code, out) == (1, "")
    assert f"{lineside.config}:7: bus.unit.id = 0: it must be at least 1" in err


def test_serve_refuses_a_bad_configuration(lineside: Shell) -> None:
    lineside.config.write_text(CONFIG.replace("[site]", "[sight]"))
    code, _, err = lineside("serve")
    assert code == 1
    assert ":1: unknown key sight in the file; did you mean site?" in err


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
    ("words", "typed", "error"),
    [
        (
            ["user", "add", "ann", "--role", "king", "--password-stdin"],
            PASSWORD,
            "'king' is not one of 'viewer', 'operator'",
        ),
        (["user", "add", "a b", "--role", "viewer", "--password-stdin"], PASSWORD, "1 to 40 letters"),
        (["user", "add", "ann", "--role", "viewer", "--password-stdin"], "", "12 to 256 characters"),
        (["user", "add", "ann", "--role", "viewer", "--password-stdin"], "x", "12 to 256 characters"),
        (["user", "add", "ann", "--role", "viewer", "--password-stdin"], "password1234", "easy to guess"),
        (["user", "remove", "eve"], "", "there is no user eve"),
        (["token", "create", "t", "--role", "king"], "", "'king' is not one of 'viewer', 'operator'"),
        (["token", "revoke", "t"], "", "there is no token t"),
        (
            ["token", "create", "t", "--role", "worker"],
            "",
            "a token with the role worker is for one bus; give one of dry-end",
        ),
        (
            ["token", "create", "t", "--role", "worker", "--bus", "x"],
            "",
            "there is no bus 'x'; there are: dry-end",
        ),
        (["token", "create", "t", "--role", "viewer", "--bus", "dry-end"], "", "has no bus"),
        (["token", "create", "t", "--role", "viewer", "--expires", "0"], "", "after 1 to 3650 days"),
    ],
)
def test_wrong_use_exits_with_2(lineside: Shell, words: list[str], typed: str, error: str) -> None:
    code, out, err = lineside(*words, typed=typed)
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


def test_the_log_is_verified(lineside: Shell) -> None:
    for name in ("a", "b", "c"):
        lineside("token", "create", name, "--role", "viewer")
    assert lineside("audit", "verify") == (0, "the audit log is intact: 3 entries\n", "")


@pytest.mark.parametrize(
    ("sql", "broken"),
    [
        ("UPDATE events SET who = 'nobody' WHERE id = 2", 2),
        ("DELETE FROM events WHERE id = 1", 1),
        ("DELETE FROM events WHERE id = 3", 3),
        ("DELETE FROM events", 1),
        ("UPDATE events SET id = 9 WHERE id = 3", 3),
    ],
)
def test_the_first_broken_entry_is_named(lineside: Shell, sql: str, broken: int) -> None:
    for name in ("a", "b", "c"):
        lineside("token", "create", name, "--role", "viewer")
    tamper(lineside.store, sql)
    code, out, err = lineside("audit", "verify")
    assert (code, out) == (1, "")
    assert f"the audit log is broken at entry {broken}: " in err


def test_no_store_and_no_log(lineside: Shell) -> None:
    code, _, err = lineside("audit", "verify")
    assert code == 1
    assert "nothing was served with this configuration yet" in err
    assert not lineside.store.exists(), "to look is not to make"


def test_a_store_that_is_none(lineside: Shell) -> None:
    lineside.store.parent.mkdir()
    lineside.store.write_bytes(b"nonsense" * 200)
    for words in (("audit", "verify"), ("user", "list")):
        code, _, err = lineside(*words)
        assert code == 1, words
        assert "it is not a Lineside store, or it is damaged" in err
    lineside.config.write_text("[server]\nport = 0\n" + CONFIG)
    served = fork_server.run("serve", "--config", lineside.config)
    assert (served.returncode, served.stdout) == (1, "")
    assert "it is not a Lineside store, or it is damaged" in served.stderr


def test_a_worker_without_its_bus(lineside: Shell) -> None:
    call = ("worker", "--bus", "nix", "--app", "http://127.0.0.1:1", "--token", "t")
    code, _, err = lineside(*call)
    assert code == 1
    assert "there is no [[bus]] named 'nix'; it has dry-end" in err
    assert lineside("worker", "--bus", "dry-end", "--app", "plant", "--token", "t")[0] == 2


@pytest.mark.parametrize(
    ("words", "code", "error"),
    [
        (["simulate", "--link", "/nonexistent/line"], 1, "the link /nonexistent/line cannot be made"),
        (
            ["backup", "--url", "http://a..b", "--token", "t", "--bus", "b", "--out", "o"],
            1,
            "cannot be reached",
        ),
        (
            ["backup", "--url", "http://127.0.0.1:1", "--token", "ü", "--bus", "b", "--out", "o"],
            2,
            "no token",
        ),
    ],
)
def test_an_impossible_call_prints_one_line(words: list[str], code: int, error: str) -> None:
    done = fork_server.run(*words)
    assert (done.returncode, done.stderr.count("\n")) == (code, 1)
    assert done.stderr.startswith("lineside: ")
    assert error in done.stderr
