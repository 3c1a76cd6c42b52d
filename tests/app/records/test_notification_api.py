"""Notification over HTTP and on its page, the link of a message, [notify] of lineside.toml, and what lineside
check finds."""

from __future__ import annotations

import asyncio
import re
import sys
import threading
from collections.abc import AsyncIterator, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
from click.testing import CliRunner, Result

from app.cli import check
from app.core.web.access import Role
from app.line.alarms.bus_alarms import BusAlarms
from app.records.notification.service import Notification
from app.records.notification.settings import NotifySettings
from app.settings import load
from tests.app.complete_app import House, complete_app
from tests.app.configured import faults_of
from tests.app.notification_servers import PlayedMailServer, mail_server, receiver
from tests.app.played_line import BUS, played_line
from tests.app.records.test_notification_path import Path_
from tests.for_each import for_each

API = "/api/v1/notifications"
MAIL = "mail:duty@plant"
ESTOP = f"{BUS}.1.estop_active.1"


@pytest.fixture
async def mail() -> AsyncIterator[PlayedMailServer]:
    async with mail_server() as mail:
        yield mail


@pytest.fixture
async def house(tmp_path: Path, mail: PlayedMailServer) -> AsyncIterator[House]:
    smtp = {"host": "127.0.0.1", "port": mail.port, "security": "none", "sender": "lineside@plant"}
    duty = {"starts": "06:00", "ends": "06:00", "to": ["anna@plant"], "days": ["mon"]}
    settings = NotifySettings.model_validate(
        {
            "dashboard_url": "https://plant.example/",
            "smtp": {**smtp, "to": ["duty@plant"]},
            "group": [{"name": "night", "duty": [duty]}],
            "rule": [{"group": "night", "after_s": 3600.0}],
        }
    )
    async with complete_app(tmp_path, notify=settings) as house:
        await played_line(house.services)
        house.services.buses[BUS][BusAlarms].tick()
        yield house


async def risen(house: House, mail: PlayedMailServer) -> str:
    """The link of the mail of an alarm, without the host."""
    await Path_(house, mail, None).estop(active=True)  # type: ignore[arg-type]
    text = (await mail.mail()).get_content()
    found = re.search(r"https://plant\.example(/notifications/acknowledge\S+)", text)
    assert found is not None
    return found[1]


def state(house: House) -> str:
    return house.services.buses[BUS][BusAlarms].list.alarms[f"{BUS}.1.estop_active"].facts.state


async def test_a_test_message_is_sent_and_its_result_given(house: House, mail: PlayedMailServer) -> None:
    engineer = await house.program(Role.ENGINEER)
    sent = (await engineer.post(f"{API}/test", json={"endpoint": MAIL})).json()["delivery"]
    assert (sent["state"], sent["attempts"], sent["kinds"]) == ("delivered", 1, ["test"])
    assert sent["result"] is None
    mail.replies["RCPT"] = "550 no such mailbox"
    refused = (await engineer.post(f"{API}/test", json={"endpoint": MAIL})).json()["delivery"]
    assert refused["state"] == "retrying"
    assert "550 no such mailbox" in refused["result"]["detail"]
    assert refused["result"]["code"] == "notify_mail_refused"
    (status, _) = (await engineer.get(API)).json()["endpoints"]
    assert (status["key"], status["works"], status["result"]) == (MAIL, False, refused["result"])
    listed = (await engineer.get(f"{API}/deliveries", params={"limit": 1})).json()
    assert ([each["id"] for each in listed["deliveries"]], listed["next"]) == ([refused["id"]], refused["id"])
    assert (await engineer.post(f"{API}/test", json={"endpoint": "mail:x@y"})).status_code == 404


async def test_the_overview_names_people_on_duty_and_the_gaps(house: House) -> None:
    engineer = await house.program(Role.ENGINEER)
    (group,) = (await engineer.get(API)).json()["groups"]
    assert (group["name"], group["on_duty"]) == ("night", ["anna@plant"])
    assert "no one is on duty from Tuesday 06:00 to Sunday 24:00" in group["gaps"][1]["detail"]


async def test_nothing_is_notified_in_a_maintenance(house: House, mail: PlayedMailServer) -> None:
    engineer = await house.program(Role.ENGINEER)
    for wrong in ({"reason": "", "minutes": 5}, {"reason": "x", "minutes": 0}, {"minutes": 5}):
        assert (await engineer.post(f"{API}/maintenance", json=wrong)).status_code == 422
    unknown = {"reason": "x", "minutes": 5, "bus": "other"}
    assert (await engineer.post(f"{API}/maintenance", json=unknown)).status_code == 404
    body = {"reason": "new felt", "minutes": 5, "bus": BUS}
    (begun,) = (await engineer.post(f"{API}/maintenance", json=body)).json()
    assert (begun["bus"], begun["reason"]) == (BUS, "new felt")
    path = Path_(house, mail, None)  # type: ignore[arg-type]
    await path.estop(active=True)
    assert await house.services[Notification].outbox.deliveries(9, None) == []
    assert (await engineer.post(f"{API}/maintenance/{begun['id']}/end")).json() == []
    assert (await engineer.post(f"{API}/maintenance/{begun['id']}/end")).status_code == 404
    await path.advance()
    assert "Emergency stop" in (await mail.mail())["Subject"]
    whats = [event["what"] for event in await house.events("notification")]
    assert "Notification paused for maintenance: 5 minutes" in whats
    assert "Notification resumed, maintenance ended" in whats


async def test_a_link_needs_a_login_and_the_button(house: House, mail: PlayedMailServer) -> None:
    link = await risen(house, mail)
    stranger = await house.client(accept="text/html").get(link)
    assert stranger.status_code == 303
    assert stranger.headers["location"].startswith("/login?next=/notifications/acknowledge")
    viewer, operator = await house.signed_in(Role.VIEWER), await house.signed_in(Role.OPERATOR)
    assert "An operator acknowledges alarms" in (await viewer.get(link)).text
    assert (await viewer.post(link)).status_code == 403
    assert "Acknowledge alarm" in (await operator.get(link)).text
    assert state(house) == "unack_active"
    done = await operator.post(link)
    assert (done.status_code, done.headers["location"]) == (303, f"/alarms/{ESTOP}")
    assert state(house) == "ack_active"
    assert (await operator.post(link)).status_code == 409
    assert "waits for no acknowledgement any more" in (await operator.get(link)).text


async def test_a_link_that_was_altered_is_refused_in_words(house: House, mail: PlayedMailServer) -> None:
    link = await risen(house, mail)
    operator = await house.signed_in(Role.OPERATOR)
    for wrong in (
        link.replace("alarm=dry-end.1", "alarm=dry-end.2"),
        re.sub(r"until=\d", "until=9", link),
        link[:-1] + ("0" if link[-1] != "0" else "1"),
        re.sub(r"signature=.*", "signature=%C3%A4", link),
    ):
        response = await operator.post(wrong)
        assert (response.status_code, "This link is not valid" in response.text) == (403, True)
    assert state(house) == "unack_active"


async def test_a_link_that_has_expired_is_refused_in_words(
    house: House, mail: PlayedMailServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("app.records.notification.compose.VALID_S", -1)
    link = await risen(house, mail)
    operator = await house.signed_in(Role.OPERATOR)
    response = await operator.get(link)
    assert (response.status_code, "This link has expired" in response.text) == (403, True)


@for_each("language", ["en", "de"])
async def test_the_page_shows_it_all(house: House, mail: PlayedMailServer, language: str) -> None:
    engineer = await house.signed_in(Role.ENGINEER)
    await engineer.post("/account/language", data={"language": language})
    mail.replies["RCPT"] = "550 no <b>such</b> mailbox"
    # A second one would wait for the next attempt of the first.
    if language == "en":
        sent = await engineer.post("/notifications/test", data={"endpoint": MAIL})
        assert sent.status_code == 303
        shown = (await engineer.get(sent.headers["location"])).text
        assert "Test message to duty@plant: is tried again" in shown
    begin: dict[str, Any] = {"minutes": "30", "reason": "felt", "bus": BUS}
    assert (await engineer.post("/notifications/maintenance", data=begin)).status_code == 303
    assert (
        await engineer.post("/notifications/maintenance", data=begin | {"reason": " "})
    ).status_code == 422
    page = (await engineer.get("/notifications")).text
    words = {
        "en": ("Notification", "is tried again", "Maintenance of dry-end", "On duty now"),
        "de": ("Benachrichtigung", "wird wiederholt", "Wartung von dry-end", "Jetzt im Dienst"),
    }
    for text in (*words[language], "duty@plant", "550 no &lt;b&gt;such&lt;/b&gt; mailbox", "felt"):
        assert text in page
    (row,) = house.services[Notification].maintenance.present()
    assert (await engineer.post(f"/notifications/maintenance/{row.id}/end")).status_code == 303
    assert "felt" not in (await engineer.get("/notifications")).text


async def test_a_page_without_notification_names_what_to_do(tmp_path: Path) -> None:
    async with complete_app(tmp_path) as house:
        engineer: httpx.AsyncClient = await house.signed_in(Role.ENGINEER)
        page = (await engineer.get("/notifications")).text
        assert "No one is notified of alarms. Add [notify.smtp]" in page
        assert 'href="/notifications"' in (await engineer.get("/alarms")).text
        viewer = await house.signed_in(Role.VIEWER)
        assert 'href="/notifications"' not in (await viewer.get("/alarms")).text


ONE_BUS = '[[bus]]\nname = "dry-end"\nport = "/dev/null"\n'
SMTP = '[notify.smtp]\nhost = "mail"\nsender = "lineside@plant"\n'
GROUP = '[[notify.group]]\nname = "duty"\n'
cli = check.check


def test_the_example_of_the_contract_is_read(tmp_path: Path) -> None:
    smtp = (
        'host = "mail"\nport = 587\nsender = "lineside@plant"\nto = ["duty@plant"]\npriorities = ["high"]\n'
    )
    hook = 'url = "https://plant.example/x"\nsecret_file = "hook.key"\npriorities = ["urgent"]\n'
    assert faults_of(tmp_path, ONE_BUS + f"[notify.smtp]\n{smtp}[[notify.webhook]]\n{hook}") == ""
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
    fault = faults_of(tmp_path, ONE_BUS + text)
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
