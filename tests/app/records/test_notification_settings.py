"""``[notify]`` of lineside.toml and each of its faults in words, and what ``lineside check`` finds."""

from __future__ import annotations

import asyncio
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from app.cli import check
from app.settings import load
from tests.app.configured import faults_of
from tests.app.notification_servers import mail_server, receiver

BUS = '[[bus]]\nname = "dry-end"\nport = "/dev/null"\n'
SMTP = '[notify.smtp]\nhost = "mail"\nsender = "lineside@plant"\n'
GROUP = '[[notify.group]]\nname = "duty"\n'
cli = check.check


def test_the_example_of_the_contract_is_read(tmp_path: Path) -> None:
    smtp = (
        'host = "mail"\nport = 587\nsender = "lineside@plant"\nto = ["duty@plant"]\npriorities = ["high"]\n'
    )
    hook = 'url = "https://plant.example/x"\nsecret_file = "hook.key"\npriorities = ["urgent"]\n'
    assert faults_of(tmp_path, BUS + f"[notify.smtp]\n{smtp}[[notify.webhook]]\n{hook}") == ""
    (webhook,) = load(tmp_path / "lineside.toml").notify.webhook
    assert webhook.secret_file == tmp_path / "hook.key"


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        (SMTP + 'to = ["a@b\\r\\nBcc: c@d"]\n', 7, "write one e-mail address"),
        (SMTP + 'user = "u"\nsecurity = "none"\n', 8, "would send the password unencrypted"),
        (SMTP + 'password = "x"\n', 7, "unknown key password"),
        ('[[notify.webhook]]\nurl = "ftp://x"\nsecret_file = "k"\n', 5, "https:// or http://"),
        ('[[notify.webhook]]\nurl = "https://u:p@x"\nsecret_file = "k"\n', 5, "leave user and password out"),
        ('[[notify.webhook]]\nsecret_file = "k"\n', 4, "either url or url_file"),
        ('[[notify.webhook]]\nurl = "https://x"\nsecret_file = "k"\nbuses = ["wet"]\n', 7, "no bus wet"),
        (SMTP + GROUP, 7, "group duty has no one"),
        (SMTP + GROUP + 'to = ["a@b"]\n' + GROUP + 'to = ["a@b"]\n', 11, "given twice"),
        (GROUP + 'to = ["a@b"]\n', 5, "add [notify.smtp]"),
        (SMTP + '[[notify.rule]]\ngroup = "x"\n', 8, "there is no group x"),
        (
            SMTP + GROUP + '[[notify.group.duty]]\nstarts = "6:00"\nends = "14:00"\nto = ["a@b"]\n',
            10,
            "06:30",
        ),
        ("[notify]\nflood = 0\n", 5, "at least 1"),
    ],
)
def test_a_fault_is_named_with_its_line(tmp_path: Path, text: str, line: int, words: str) -> None:
    fault = faults_of(tmp_path, BUS + text)
    assert words in fault
    assert fault.startswith(f"FILE:{line}: ")


@contextmanager
def served(server: Any) -> Iterator[Any]:
    """A server of the event loop in a thread apart: the command line has its own loop."""
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever)
    thread.start()
    try:
        yield asyncio.run_coroutine_threadsafe(server.__aenter__(), loop).result(10)
    finally:
        asyncio.run_coroutine_threadsafe(server.__aexit__(None, None, None), loop).result(10)
        loop.call_soon_threadsafe(loop.stop)
        thread.join(10)
        loop.close()


def checked(folder: Path, text: str) -> Result:
    path = folder / "lineside.toml"
    path.write_text("[server]\nport = 0\n" + text)
    return CliRunner().invoke(cli, ["--config", str(path)])


def test_check_reports_a_path_that_works(tmp_path: Path) -> None:
    (tmp_path / "hook.key").write_text("key")
    (tmp_path / "hook.key").chmod(0o600)
    with ExitStack() as stack:
        smtp = stack.enter_context(served(mail_server()))
        hooks = stack.enter_context(served(receiver(response=b"HTTP/1.1 405 No\r\n\r\n")))
        result = checked(
            tmp_path,
            f'[notify.smtp]\nhost = "127.0.0.1"\nport = {smtp.port}\nsecurity = "none"\nsender = "l@plant"\n'
            f'to = ["a@b"]\n[[notify.webhook]]\nurl = "{hooks.url}"\nsecret_file = "hook.key"\n',
        )
        assert smtp.mails == []
        assert [body for _, body in hooks.received] == [b""]
    assert f"mail server 127.0.0.1:{smtp.port} responds" in result.stdout
    assert "webhook 127.0.0.1#" in result.stdout
    assert "dashboard_url is not set" in result.stdout
    assert "s3cret" not in result.output
    assert "notification" not in result.stderr


def test_check_reports_a_server_that_refuses_and_one_that_hangs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("app.records.notification.senders.SOCKET_S", 0.2)
    monkeypatch.setitem(sys.modules, "apprise", None)
    (tmp_path / "hook.key").write_text("key")
    with ExitStack() as stack:
        smtp = stack.enter_context(served(mail_server(greeting="554 no service for you")))
        hooks = stack.enter_context(served(receiver(response=None)))
        result = checked(
            tmp_path,
            f'[notify.smtp]\nhost = "127.0.0.1"\nport = {smtp.port}\nsender = "l@plant"\n'
            f'[[notify.webhook]]\nurl = "{hooks.url}"\nsecret_file = "hook.key"\n'
            '[[notify.webhook]]\nurl = "http://127.0.0.1:1/"\nsecret_file = "gone.key"\n'
            '[[notify.apprise]]\nurl_file = "gone.url"\n',
        )
    assert result.exit_code == 1
    assert "554 no service for you" in result.stderr
    assert "did not respond in time" in result.stderr
    assert "gone.key cannot be read" in result.stderr
    assert "The package apprise is not installed" in result.stderr
    assert f"can be read by every user of this machine: run chmod o= {tmp_path / 'hook.key'}" in result.stdout


def test_check_reports_a_roster_with_a_gap(tmp_path: Path) -> None:
    duty = '[[notify.group.duty]]\nends = "22:00"\nstarts = "06:00"\nto = ["a@b"]\ndays = ["mon"]\n'
    result = checked(tmp_path, SMTP.replace('"mail"', '"127.0.0.1"\nport = 1') + GROUP + duty)
    assert result.exit_code == 1
    assert "Group duty: no one is on duty from Monday 00:00 to Monday 06:00." in result.stderr
    assert "Group duty: no one is on duty from Monday 22:00 to Sunday 24:00." in result.stderr
