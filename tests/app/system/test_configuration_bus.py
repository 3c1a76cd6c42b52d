"""The page of a bus: an admin adds one to a server that has none, scans its port, and corrects it later."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from html import unescape
from pathlib import Path

import httpx
import pytest

from app.core.web.access import Role
from app.settings import load
from app.system.configuration import port_scan
from app.system.configuration.port_scan import PortScan, ports
from tests.app.cli.test_wire import line, unit
from tests.app.complete_app import House, complete_app
from tests.app.configuration_file import TEXT, PlantFile, fields_of, house_with_file, plant_file
from tests.for_each import for_each

house = pytest.fixture(house_with_file)
file = pytest.fixture(plant_file)
FIRST, NEXT = "/configuration/bus/0", "/configuration/bus/1"


@pytest.fixture
async def admin(house: House, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[httpx.AsyncClient]:
    monkeypatch.setattr(port_scan, "OPTIONS", ("--json", "--last=5", "--baud=9600"))
    yield await house.signed_in(Role.ADMIN)
    await house.services[PortScan].stop()


async def typed(client: httpx.AsyncClient, page: str, **fields: str) -> dict[str, str]:
    shown = await client.get(page)
    assert shown.status_code == 200, shown.text
    return {"digest": fields_of(shown.text)["digest"], **fields}


async def scan_ended(client: httpx.AsyncClient) -> None:
    """Follow the scan as the page does, until it is sent to what was found."""
    for _ in range(600):
        state = await client.get(f"{NEXT}/scan")
        if state.status_code != 204:
            assert state.headers["HX-Redirect"] == NEXT
            return
        await asyncio.sleep(0.1)
    raise AssertionError("the scan does not end")


async def test_a_bus_is_added_after_a_scan(admin: httpx.AsyncClient, house: House, file: PlantFile) -> None:
    with line(unit(2), unit(5)) as port:
        begun = await admin.post(f"{NEXT}/scan", data={"act": "scan", "port": port})
        assert (begun.status_code, begun.headers["location"]) == (303, NEXT)
        assert port in (await admin.get(NEXT)).text
        again = await admin.post(f"{NEXT}/scan", data={"act": "scan", "port": "/dev/ttyUSB7"})
        assert again.status_code == 409, "one at a time"
        await scan_ended(admin)
    found = house.services[PortScan].found
    assert found is not None, house.services[PortScan].fault
    page = unescape((await admin.get(NEXT)).text)
    assert "2 units found" in page
    assert "2 Unit 2\n5 Unit 5</textarea>" in page
    data = await typed(admin, NEXT, name="wet-end", port=port, baud="9600", units="5 Nip\n2 Unwind\n")
    review = await admin.post(NEXT, data=data)
    assert (review.status_code, file.text) == (200, TEXT)
    assert '+ <ins>name = "Nip"</ins>' in unescape(review.text)
    done = await admin.post(NEXT, data={**fields_of(review.text), "reason_of_change": "second line"})
    assert done.headers["location"] == "/configuration"
    assert file.text.startswith(TEXT.partition("[[notify")[0])
    bus = load(file.path).bus[1]
    assert (bus.name, bus.port, bus.baud) == ("wet-end", port, 9600)
    assert [(each.id, each.name) for each in bus.unit] == [(5, "Nip"), (2, "Unwind")]
    assert bus.turnaround_ms == found["turnaround_ms"]
    assert bus.checksum_10h == found.get("checksum_10h", bus.checksum_10h)


async def test_port_and_units_are_corrected(admin: httpx.AsyncClient, file: PlantFile) -> None:
    data = await typed(
        admin, FIRST, name="dry-end", port="/dev/ttyUSB3", baud="4800", units="2 Nip 1\n7 Rewind"
    )
    await admin.post(FIRST, data={**data, "confirmed": "true"})
    [bus] = load(file.path).bus
    assert (bus.port, bus.baud) == ("/dev/ttyUSB3", 4800)
    assert [(each.id, each.name) for each in bus.unit] == [(2, "Nip 1"), (7, "Rewind")]
    assert "# Of the nip.\n" in file.text
    assert "hook.key" in file.text
    data = await typed(
        admin, FIRST, name="dry-end", port="/dev/ttyUSB3", baud="4800", units="2 Nip 1\n7 Rewind"
    )
    assert (await admin.post(FIRST, data=data)).status_code == 422, "nothing changed"


@for_each(
    ("fields", "words"),
    [
        ({"units": "Unwind"}, "“Unwind” names no unit"),
        ({"units": "1 Unwind\n1 Nip"}, "“1 Nip” has the address of a line above it"),
        ({"units": "256 Unwind"}, ">256: it must be at most 255"),
        ({"units": f"1 {'x' * 61}"}, "at most 60 characters"),
        ({"name": "Dry End"}, "name"),
        ({"name": "dry-end"}, "dry-end"),
        ({"port": "/dev/null"}, "/dev/null"),
        ({"port": ""}, 'aria-invalid="true"'),
        ({"port": "http://10.0.0.1"}, "socket://"),
        ({"baud": "9601"}, "9600"),
        ({"baud": "x"}, "9600"),
    ],
)
async def test_what_cannot_be_is_named_and_nothing_written(
    admin: httpx.AsyncClient, file: PlantFile, fields: dict[str, str], words: str
) -> None:
    right = {"name": "wet-end", "port": "/dev/ttyUSB3", "baud": "9600", "units": "1 Unwind"}
    data = await typed(admin, NEXT, **(right | fields), confirmed="true")
    page = await admin.post(NEXT, data=data)
    assert page.status_code == 422, page.text
    assert words in unescape(page.text.partition("<main")[2])
    assert file.text == TEXT


async def test_a_file_changed_meanwhile_is_not_overwritten(admin: httpx.AsyncClient, file: PlantFile) -> None:
    data = await typed(admin, NEXT, name="wet-end", port="/dev/ttyUSB3", baud="9600", units="1 Unwind")
    file.path.write_text(f"# By hand.\n{TEXT}")
    page = await admin.post(NEXT, data={**data, "confirmed": "true"})
    assert (page.status_code, file.text) == (409, f"# By hand.\n{TEXT}")
    assert "1 Unwind</textarea>" in page.text


async def test_a_port_that_is_not_scanned(admin: httpx.AsyncClient) -> None:
    for port, words in (
        ("/dev/null", "is the port of a bus already"),
        ("http://10.0.0.1", "socket://"),
        ("COM3", "/dev/"),
        ("/dev/no-such-port", "The scan found no unit: /dev/no-such-port does not exist"),
    ):
        await admin.post(f"{NEXT}/scan", data={"act": "scan", "port": port})
        await scan_ended(admin)
        assert words in unescape((await admin.get(NEXT)).text)
    page = unescape((await admin.get(NEXT, headers={"Accept-Language": "de"})).text)
    assert "/dev/no-such-port fehlt" in page


async def test_a_scan_ends_when_it_is_told_to(admin: httpx.AsyncClient, house: House) -> None:
    scan = house.services[PortScan]
    with line(unit(2)) as port:
        await admin.post(f"{NEXT}/scan", data={"act": "scan", "port": port})
        assert scan.is_running
        await admin.post(f"{NEXT}/scan", data={"act": "stop"})
    assert (scan.is_running, scan.found) == (False, None)


async def test_only_an_admin_and_no_other_bus(admin: httpx.AsyncClient, house: House) -> None:
    engineer = await house.signed_in(Role.ENGINEER)
    assert (await engineer.get(NEXT)).status_code == 403
    assert (await engineer.post(f"{NEXT}/scan", data={"act": "scan", "port": "/dev/x"})).status_code == 403
    assert FIRST not in (await engineer.get("/configuration")).text
    listed = (await admin.get("/configuration")).text
    assert f'href="{FIRST}"' in listed
    assert f'href="{NEXT}"' in listed
    assert (await admin.get("/configuration/bus/2")).status_code == 404


async def test_a_server_without_a_bus_leads_there(tmp_path: Path) -> None:
    config = tmp_path / "lineside.toml"
    config.write_text('[site]\nname = "Mill 7"\n')
    async with complete_app(tmp_path, config=config) as house:
        admin, operator = await house.signed_in(Role.ADMIN), await house.signed_in(Role.OPERATOR)
        assert f'href="{FIRST}"' in (await admin.get("/")).text
        pages = ("/wallboard", "/alarms", "/events", "/trends", "/setpoints", "/sets", "/recipes", "/lines")
        failed = {page: status for page in pages if (status := (await admin.get(page)).status_code) >= 400}
        assert failed == {}
        page = (await operator.get("/")).text
        assert "An admin adds one here" in page
        assert FIRST not in page


def test_the_ports_of_this_machine(tmp_path: Path) -> None:
    by_id = tmp_path / "by-id"
    for name in ("ttyUSB1", "ttyACM0", "ttyS0", "ttyS9", "null"):
        (tmp_path / name).touch()
    found = [Path(port).name for port in ports(by_id, tmp_path)]
    assert found == ["ttyACM0", "ttyUSB1", "ttyS0"]
    by_id.mkdir()
    (by_id / "usb-FTDI").touch()
    assert ports(by_id, tmp_path) == [str(by_id / "usb-FTDI"), str(tmp_path / "ttyS0")]
