"""A client generated from the OpenAPI document: every outcome of a command arrives as a typed object."""

from __future__ import annotations

import importlib
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from app.core.database import Database
from app.core.web.api import openapi_document
from app.main import create_app
from bus.contract import UnitOutcome
from tests.app.complete_app import House, served, settings_in
from tests.app.fake_worker import PlayedWorker, responding
from tests.for_each import for_each

pytestmark = pytest.mark.soak
"""To generate it takes longer than all calls; `test_openapi_document` has the responses of commands."""
PACKAGE = "lineside_client"
BUS = "dry-end"


@pytest.fixture(scope="module")
def document(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    app = create_app(settings_in(tmp_path_factory.mktemp("document")))
    try:
        return openapi_document(app)
    finally:
        app.state.services[Database].close()


@pytest.fixture(scope="module")
def package(document: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> Iterator[ModuleType]:
    """The generated package, imported. It warns of nothing."""
    # Half a second of every collection, for a test of `make soak`.
    from openapi_python_client import generate
    from openapi_python_client.config import Config, ConfigFile, MetaType

    folder = tmp_path_factory.mktemp("client")
    source = folder / "openapi.json"
    source.write_text(json.dumps(document), encoding="utf-8")
    # For TOML the generator needs the setting that docs/api.md names.
    options = ConfigFile(post_hooks=[], content_type_overrides={"application/toml": "text/plain"})
    config = Config.from_sources(options, MetaType.NONE, source, "utf-8", True, folder / PACKAGE)
    assert [(error.header, error.detail) for error in generate(config=config)] == []
    sys.path.insert(0, str(folder))
    yield importlib.import_module(PACKAGE)
    sys.path.remove(str(folder))
    for name in [name for name in sys.modules if name.partition(".")[0] == PACKAGE]:
        del sys.modules[name]


class Generated:
    """The generated client of an app, as a person with a role."""

    def __init__(self, package: ModuleType, site: House, role: str) -> None:
        self.client = package.Client(base_url="").set_async_httpx_client(site.http(role))
        self.models: Any = importlib.import_module(f"{PACKAGE}.models")

    async def call(self, module: str, *path: Any, **options: Any) -> Any:
        """One operation, ``tag.operation``; gives what it parsed from the response."""
        operation = importlib.import_module(f"{PACKAGE}.api.{module}")
        response = await operation.asyncio_detailed(*path, client=self.client, **options)
        assert response.parsed is not None or response.status_code == 204
        return response.parsed

    async def set_speed(self, raw: int, **more: Any) -> Any:
        """Set the speed of unit 1."""
        body = self.models.SpeedRequest(raw=raw, **more)
        return await self.call("commands.set_speed", BUS, 1, body=body)


@pytest.fixture
def client(package: ModuleType, site: House) -> Generated:
    return Generated(package, site, "admin")


@pytest.mark.usefixtures("worker")
async def test_it_reads_the_line(client: Generated) -> None:
    line = await client.call("line.get_line")
    assert isinstance(line, client.models.Line)
    (bus,) = line.buses
    assert (bus.name, bus.link, bus.baud) == (BUS, client.models.BusLink.OPEN, 9600)
    unit = bus.units[0]
    assert isinstance(unit, client.models.Unit)
    assert (unit.id, unit.commanded_raw, unit.inputs.estop, len(unit.outputs)) == (1, 1000, False, 6)
    assert await client.call("line.get_unit", BUS, 1) == unit or unit.age_ms >= 0


@for_each("outcome", ["verified", "acknowledged"])
async def test_a_command_that_was_carried_out(client: Generated, worker: PlayedWorker, outcome: str) -> None:
    parts = [UnitOutcome(unit=1, outcome=outcome, sent_at=1.0, attempts=1)]  # type: ignore[arg-type]
    worker.play = responding(outcome, read_back=250, units=parts)
    result = await client.set_speed(250, execute=outcome == "verified")
    assert isinstance(result, client.models.CommandResult)
    assert result.outcome == client.models.Outcome(outcome)
    assert (result.read_back, result.bus, result.unit, result.attempts) == (250, BUS, 1, 1)
    assert result.units.to_dict() == {}


REFUSED = {"unit_error": 128, "units": [UnitOutcome(unit=1, outcome="refused", unit_error=128)]}


@for_each(
    ("outcome", "status", "more"),
    [
        ("refused", 409, REFUSED),
        ("unverified", 504, {"read_back": 240}),
        ("bus_closed", 503, {}),
        ("not_sent", 503, {}),
    ],
)
async def test_a_command_that_was_not(
    client: Generated, worker: PlayedWorker, outcome: str, status: int, more: dict[str, Any]
) -> None:
    worker.play = responding(outcome, **more)
    problem = await client.set_speed(250)
    assert isinstance(problem, client.models.Problem)
    assert (problem.status, problem.code) == (status, client.models.ProblemCode(outcome))
    assert problem.outcome == problem.code
    assert (problem.bus, problem.unit) == (BUS, 1)
    assert problem.unit_error == more.get("unit_error")
    assert problem.read_back == more.get("read_back")
    assert all(
        unit.outcome == client.models.Outcome(outcome)
        for unit in problem.units.additional_properties.values()
    )


@for_each(("role", "status", "code"), [("", 401, "unauthorized"), ("viewer", 403, "forbidden")])
async def test_who_may_not(package: ModuleType, site: House, role: str, status: int, code: str) -> None:
    generated = Generated(package, site, role)
    problem = await generated.set_speed(1)
    assert (problem.status, problem.code) == (status, code)


def test_a_call_of_the_stream_returns(package: ModuleType, tmp_path: Path) -> None:
    operation = importlib.import_module(f"{PACKAGE}.api.line.get_stream")
    with served(tmp_path) as api, package.Client(base_url=api.url, headers=api.headers) as client:
        for options in ({"seconds": 1}, {}):
            assert "event: snapshot" in operation.sync(client=client, **options)
