"""Reports of any span: the page, the files, and the mail; over the complete app."""

from __future__ import annotations

import csv
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest
from starlette.types import Message, Receive, Scope, Send

from app.core.web.access import Role
from app.errors import StoreError
from app.records.notification.service import Notification
from app.records.reports.service import Reports, ReportSchedule
from app.settings import load
from bus.configuration import ConfigurationError
from bus.contract import Reading
from bus.instants import UnixTime
from bus.messages import term
from tests.app.complete_app import House, complete_app
from tests.app.history_line import Shelf, parameter
from tests.app.notification_servers import PlayedMailServer, mail_server
from tests.for_each import for_each

MIDNIGHT = datetime.now(UTC).replace(hour=0, minute=0, second=0, microsecond=0)
BEGIN = (MIDNIGHT - timedelta(hours=12)).timestamp()
"""Yesterday at noon."""
SPAN = {"from": (MIDNIGHT - timedelta(days=1)).isoformat(), "to": MIDNIGHT.isoformat()}
AT_SPEED, ON = 0xC0, 0b11
CONFIGURATION = """\
[site]
name = "Mill 7"
time_zone = "UTC"
[server]
data = "data"
[[bus]]
name = "dry-end"
port = "/dev/null"
[[bus.unit]]
id = 1
name = "Unwind"
labels = { unit = "m/min" }
[[bus.unit]]
id = 2
name = "=Nip"
labels = { unit = "m/min" }
"""


def readings() -> list[Reading]:
    """A minute at speed, half a minute stopped, no reading for half a minute, then again a minute."""
    found = []
    for second in (*range(90), *range(120, 180)):
        for unit, raw in ((1, 600), (2, 606)):
            runs = not 60 <= second < 90
            value = raw if runs else 0
            outputs = AT_SPEED if runs else 0
            found.append(Reading(unit, UnixTime(BEGIN + second), value, value, 0, outputs, ON))
    return found


def fill(folder: Path) -> None:
    shelf = Shelf(folder / "data" / "history.db")
    shelf.keep([parameter(3, 1, BEGIN - 3600, unit) for unit in (1, 2)])
    shelf.keep(readings())
    shelf.close()


@asynccontextmanager
async def mill(folder: Path, more: str = "", zone: str = "UTC") -> AsyncIterator[House]:
    config = folder / "lineside.toml"
    config.write_text(CONFIGURATION.replace("UTC", zone) + more)
    fill(folder)
    async with complete_app(folder, config=config) as house:
        yield house


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    async with mill(tmp_path) as house:
        yield house


async def test_a_report_has_the_figures_of_each_unit(house: House) -> None:
    client = await house.program(Role.VIEWER)
    report = (await client.get("/api/v1/report", params=SPAN)).json()
    unwind, nip = report["units"]
    assert (unwind["running_s"], unwind["at_speed_s"]) == (119.0, 119.0)
    assert (unwind["known_s"], unwind["unread_s"]) == (148.0, 86_252.0)
    assert [(stop["seconds"], stop["cause"]) for stop in unwind["stops"]] == [(29.0, "speed_zero")]
    assert (unwind["speed_average"], unwind["length"], unwind["length_unit"]) == (60.0, 119.0, "m")
    assert (unwind["draw"], nip["draw"]) == (None, {"average": 1.0, "least": 1.0, "greatest": 1.0})
    of_one = (await client.get("/api/v1/report", params={**SPAN, "bus": "dry-end", "unit": 2})).json()
    assert of_one["units"] == [nip]


async def test_report_sheet_and_list_of_a_shift_begin_with_the_same_figures(house: House) -> None:
    """Units that stand at the same time are one stop, and the length is that of the last unit."""
    client = await house.program(Role.VIEWER)
    shifts = (await client.get("/api/v1/shifts")).json()["shifts"]
    shift = next(each for each in shifts if _time(each["start"]) <= BEGIN < _time(each["end"]))
    span = {"from": shift["start"], "to": shift["end"]}
    line = (await client.get("/api/v1/report", params=span)).json()["line"]
    figures = {"stops": 1, "stopped_s": 29.0, "alarms": 0, "length": 120.19, "length_unit": "m"}
    unread_s = 28_800.0 - 148.0
    assert line == figures | {"unread_s": unread_s}
    sheet = (await client.get(f"/api/v1/shifts/{shift['start']}")).json()
    assert sheet["line"] == line
    browser = await house.signed_in(Role.VIEWER)
    shown = "1 stop, 0:00:29 · 0 alarms · 120.2\N{NO-BREAK SPACE}m · 7:57:32 without readings"
    assert shown in (await browser.get(f"/shifts/{shift['start']}")).text
    assert shown in (await browser.get("/shifts")).text, "the sheet has read them"


def _time(text: str) -> float:
    return datetime.fromisoformat(text).timestamp()


async def test_the_stops_are_rows_of_csv_and_no_name_is_a_formula(house: House) -> None:
    client = await house.program(Role.VIEWER)
    response = await client.get("/api/v1/report/stops.csv", params=SPAN)
    assert response.headers["content-disposition"].endswith('-stops.csv"')
    rows = list(csv.DictReader(response.text.splitlines()))
    assert [(row["unit"], row["name"], row["seconds"], row["reason"]) for row in rows] == [
        ("1", "Unwind", "29.0", "speed_zero"),
        ("2", "'=Nip", "29.0", "speed_zero"),
    ]
    began = datetime.fromisoformat(rows[0]["began"])
    assert began.timestamp() == BEGIN + 60
    units = list(
        csv.DictReader((await client.get("/api/v1/report/units.csv", params=SPAN)).text.splitlines())
    )
    assert [(row["at_speed_s"], row["draw_average"]) for row in units] == [("119.0", ""), ("119.0", "1.0")]


async def test_the_page_has_the_figures_of_a_day(house: House) -> None:
    client = await house.signed_in(Role.VIEWER)
    page = await client.get("/reports", params={"span": "yesterday"})
    for shown in ("0:01:59", "1 · 0:00:29", "window of its parameter 12"):
        assert shown in page.text


async def test_a_page_without_readings_states_what_it_is_for(house: House) -> None:
    client = await house.signed_in(Role.VIEWER)
    page = (
        await client.get("/reports", params={"since": "2000-01-01T06:00", "until": "2000-01-02T06:00"})
    ).text
    assert "No readings of this span are stored." in page
    assert "stop is recorded" not in page
    assert "0 stops" not in page


async def test_the_fields_of_a_report_from_a_link_are_written_as_people_type_them(house: House) -> None:
    client = await house.signed_in(Role.VIEWER)
    client.headers["accept-language"] = "de"
    page = await client.get("/reports", params={"since": "2000-01-01T06:00", "until": "2000-01-02T06:00"})
    assert 'value="01.01.2000 06:00"' in page.text
    assert 'value="02.01.2000 06:00"' in page.text


async def test_a_page_is_sent_up_to_its_report_before_that_is_read(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent: list[bytes] = []

    async def app(scope: Scope, receive: Receive, send: Send) -> None:
        async def note(message: Message) -> None:
            sent.append(message.get("body", b""))
            await send(message)

        await house.app(scope, receive, note)

    async def fail(*_: Any) -> None:
        assert b"</form>" in b"".join(sent)
        raise StoreError(term("The disk is gone."))

    monkeypatch.setattr(Reports, "report", fail)
    person = await house.signed_in(Role.VIEWER)
    transport = httpx.ASGITransport(app, client=(house.address, 4711))
    async with httpx.AsyncClient(
        transport=transport, base_url=person.base_url, cookies=person.cookies
    ) as client:
        page = await client.get("/reports", headers={"Accept-Encoding": "identity"})
    assert (page.status_code, "The disk is gone." in page.text) == (200, True)
    assert page.text.rstrip().endswith("</html>")


@for_each(
    ("query", "status", "reason"),
    [
        ({"since": "2026-02-02T06:00", "until": "2026-02-01T06:00"}, 422, "begins before now and ends later"),
        ({"since": "2016-02-01T06:00", "until": "2026-02-01T06:00"}, 422, "92 days at most"),
        ({"since": "yesterday", "until": "2026-02-01T06:00"}, 422, "yesterday"),
        ({"since": "9999-12-31T23:59", "until": ""}, 422, "9998"),
        ({"place": "dry-end/"}, 404, "There is no unit dry-end/"),
    ],
)
async def test_a_wrong_span_or_place_is_refused_and_stays_typed(
    house: House, query: dict[str, str], status: int, reason: str
) -> None:
    client = await house.signed_in(Role.VIEWER)
    page = await client.get("/reports", params=query)
    assert (page.status_code, reason in page.text) == (status, True), page.text
    assert all(typed in page.text for name, typed in query.items() if name != "place")


async def test_the_api_refuses_what_the_page_does(house: House) -> None:
    client = await house.program(Role.VIEWER)
    for query, status, code in (
        ({"from": SPAN["to"], "to": SPAN["from"]}, 422, "span_reversed"),
        ({"from": "2016-02-01T06:00:00Z"}, 422, "report_span_too_long"),
        ({**SPAN, "unit": 1}, 422, "report_unit_without_bus"),
        ({**SPAN, "bus": "dry-end", "unit": 9}, 404, "no_such_unit"),
        ({**SPAN, "bus": "wet-end"}, 404, "no_such_bus"),
    ):
        response = await client.get("/api/v1/report", params=query)
        assert (response.status_code, response.json()["reason"]) == (status, code)


MAIL = """\
[notify.smtp]
host = "127.0.0.1"
port = {port}
security = "none"
sender = "lineside@plant"
[[report]]
every = "day"
at = "{at}"
to = ["shift@plant", "boss@plant"]
[[report]]
every = "day"
at = "{at}"
bus = "dry-end"
unit = 2
to = ["boss@plant"]
"""


@pytest.fixture
async def mail() -> AsyncIterator[PlayedMailServer]:
    async with mail_server() as mail:
        yield mail


async def test_a_day_is_sent_once_to_each_address_as_a_page(tmp_path: Path, mail: PlayedMailServer) -> None:
    at = datetime.now(UTC).strftime("%H:%M")
    async with mill(tmp_path, MAIL.format(port=mail.port, at=at)) as house:
        notification = house.services[Notification]
        schedule = ReportSchedule(house.services.settings, notification.dispatcher.add)
        await schedule.send_due()
        await schedule.send_due()
        received = [await mail.mail(count) for count in (1, 2, 3)]
    assert len(mail.mails) == 3
    subjects = sorted(str(each["Subject"]) for each in received)
    day = MIDNIGHT - timedelta(days=1)
    shown = f"{day:%-d %b %Y}, 00:00"
    of_site = f"report of Mill 7, day from {shown}"
    assert subjects == [f"report of Mill 7 dry-end/2, day from {shown}", of_site, of_site]
    first = next(each for each in received if each["Subject"] == of_site)
    body = first.get_body(("plain",))
    assert body is not None
    assert "1 stop, 0:00:29" in body.get_content()
    [page] = first.iter_attachments()
    assert (page.get_content_type(), page.get_filename()) == (
        "text/html",
        f"report-{day:%Y-%m-%d}T0000Z.html",
    )
    text = page.get_content()
    assert "0:01:59" in text
    assert "Unwind" in text
    assert "<script" not in text


def test_a_report_that_cannot_be_sent_is_no_configuration(tmp_path: Path) -> None:
    config = tmp_path / "lineside.toml"
    config.write_text(CONFIGURATION + '[[report]]\nevery = "week"\nto = ["boss@plant"]\n')
    with pytest.raises(ConfigurationError, match=r"notify\.smtp"):
        load(config)
