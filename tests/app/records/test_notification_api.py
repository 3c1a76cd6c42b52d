"""Notification over HTTP and on its page, and the link of a message."""

from __future__ import annotations

import re
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from app.core.web.access import Role
from app.line.alarms.bus_alarms import BusAlarms
from app.records.notification.service import Notification
from app.records.notification.settings import NotifySettings
from tests.app.complete_app import House, complete_app
from tests.app.notification_servers import PlayedMailServer, mail_server
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
    assert (await engineer.post("/notifications/test", data={"endpoint": MAIL})).status_code == 303
    begin: dict[str, Any] = {"minutes": "30", "reason": "felt", "bus": BUS}
    assert (await engineer.post("/notifications/maintenance", data=begin)).status_code == 303
    assert (
        await engineer.post("/notifications/maintenance", data=begin | {"reason": " "})
    ).status_code == 422
    page = (await engineer.get("/notifications")).text
    words = {
        "en": (
            "Notification",
            "Send test message",
            "is tried again",
            "Maintenance of dry-end",
            "On duty now",
        ),
        "de": (
            "Benachrichtigung",
            "Testnachricht senden",
            "wird wiederholt",
            "Wartung von dry-end",
            "Jetzt im Dienst",
        ),
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
