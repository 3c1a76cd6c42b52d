"""An admin restarts the server with what its file has: who may, with which file, and that it serves again."""

from __future__ import annotations

import asyncio
import re
from html import unescape
from pathlib import Path

import httpx
import pytest

from app.core.web.access import Role
from app.system.configuration import service as restart_module
from app.system.configuration.service import Restart
from tests import fork_server
from tests.app.cli.test_serve import CONFIG, only_child, started
from tests.app.complete_app import House
from tests.app.configuration_file import TEXT, PlantFile, house_with_file, plant_file
from tests.e2e.site import eventually
from tests.for_each import for_each
from tests.free_port import free_port

API = "/api/v1/configuration"
PAGE = "/configuration"
CHANGED = TEXT.replace("Unwind", "Unwinder")

house = pytest.fixture(house_with_file)
file = pytest.fixture(plant_file)


@pytest.fixture
def requested(house: House, monkeypatch: pytest.MonkeyPatch) -> asyncio.Event:
    """Whether a restart was requested of whatever runs the server."""
    monkeypatch.setattr(restart_module, "DELAY_S", 0.0)
    return house.services[Restart].offer()


async def restart(client: httpx.AsyncClient, digest: str | None = None) -> httpx.Response:
    known = digest or (await client.get(API)).json()["digest"]
    return await client.post(f"{API}/restart", json={"digest": known, "reason": "new name"})


async def test_an_admin_restarts_it_and_the_audit_log_has_who_and_why(
    house: House, file: PlantFile, requested: asyncio.Event
) -> None:
    file.write(CHANGED)
    admin = await house.program(Role.ADMIN)
    assert (await restart(admin)).status_code == 204
    async with asyncio.timeout(10):
        await requested.wait()
    newest = (await admin.get("/api/v1/events?kind=server")).json()["events"][0]
    assert "restart of the server requested: new name" in newest["what"]


@for_each("role", [Role.VIEWER, Role.OPERATOR, Role.ENGINEER])
async def test_no_other_role_does(house: House, requested: asyncio.Event, role: Role) -> None:
    response = await restart(await house.program(role), "0" * 16)
    assert (response.status_code, requested.is_set()) == (403, False)


async def test_a_file_with_a_fault_does_not_end_the_server_that_runs(
    house: House, file: PlantFile, requested: asyncio.Event
) -> None:
    file.write(TEXT.replace("id = 2", "id = 1"))
    response = await restart(await house.program(Role.ADMIN))
    assert response.status_code == 409
    assert "would not start" in response.json()["detail"]
    assert not requested.is_set()
    page = await (await house.signed_in(Role.ADMIN)).get(PAGE)
    assert f'action="{PAGE}/restart"' not in page.text


async def test_it_restarts_with_the_lines_that_were_seen_or_not_at_all(
    house: House, file: PlantFile, requested: asyncio.Event
) -> None:
    admin = await house.program(Role.ADMIN)
    seen = (await admin.get(API)).json()["digest"]
    file.write(CHANGED)
    response = await restart(admin, seen)
    assert (response.status_code, response.json()["code"], requested.is_set()) == (409, "superseded", False)


async def test_a_server_that_cannot_restart_is_not_ended(house: House, file: PlantFile) -> None:
    """A demonstration, or an app in another server."""
    file.write(CHANGED)
    response = await restart(await house.program(Role.ADMIN))
    assert response.status_code == 409
    assert "cannot restart" in response.json()["detail"]
    page = await (await house.signed_in(Role.ADMIN)).get(PAGE)
    assert "sudo systemctl restart lineside" in page.text
    assert f'action="{PAGE}/restart"' not in page.text


async def test_the_page_shows_what_takes_effect_and_goes_on_to_itself(
    house: House, file: PlantFile, requested: asyncio.Event
) -> None:
    file.write(CHANGED)
    engineer, admin = await house.signed_in(Role.ENGINEER), await house.signed_in(Role.ADMIN)
    assert f'action="{PAGE}/restart"' not in (await engineer.get(PAGE)).text
    page = unescape((await admin.get(PAGE)).text)
    assert '+ <ins>name = "Unwinder"' in page
    form = re.search(rf'<form[^>]*action="{PAGE}/restart".*?</form>', page, re.DOTALL)
    assert form
    fields = dict(re.findall(r'name="([a-z_]+)" value="([^"]*)"', form[0]))
    done = await admin.post(f"{PAGE}/restart", data=fields)
    async with asyncio.timeout(10):
        await requested.wait()
    assert (done.status_code, done.headers["location"]) == (303, PAGE)
    assert "This page connects to it again" in (await admin.get(done.headers["location"])).text


def test_a_server_restarts_in_its_process_with_the_changed_file(tmp_path: Path) -> None:
    """A service manager follows the process; the worker is another one, and the store is written by one."""
    config, port = tmp_path / "lineside.toml", free_port()
    text = CONFIG.format(port=tmp_path / "absent").replace("port = 0", f"port = {port}")
    config.write_text(text, "utf-8")
    begins = ("serve", "--new", "--config", str(config))
    with (
        httpx.Client(trust_env=False, timeout=30) as program,
        started(*begins, as_installed=True) as (process, url),
    ):
        made = fork_server.run("token", "create", "admin", "--role", "admin", "--config", config)
        program.headers["authorization"] = f"Bearer {made.stdout.split()[-1]}"
        worker = only_child(process)
        config.write_text(text.replace("Unwind", "Unwinder"), "utf-8")
        digest = program.get(url + API).json()["digest"]
        assert program.post(f"{url}{API}/restart", json={"digest": digest}).status_code == 204

        def has_new_name() -> bool:
            try:
                return "Unwinder" in program.get(f"{url}/api/v1/line").text
            except httpx.TransportError:
                return False

        assert eventually(has_new_name, "the server serves with the changed file")
        assert process.poll() is None
        assert only_child(process) != worker
        assert program.get(url + API).json()["running"]
        process.terminate()
        assert process.wait(timeout=60) == 0
    proof = fork_server.run("audit", "verify", "--config", config)
    assert proof.returncode == 0, proof.stderr
