"""The API conforms to its description for any input: a bounded run of schemathesis."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass

import httpx
import pytest
import schemathesis
import uvicorn
from hypothesis import HealthCheck, Phase, given, settings
from schemathesis import Case
from schemathesis.schemas import BaseSchema
from schemathesis.specs.openapi.checks import positive_data_acceptance

from app.auth import rules, store
from app.auth.store import Token
from app.database import Database
from app.feature import Services
from app.main import create_app
from app.web.access import Role
from tests.app.complete_app import settings_in

ENDLESS = "GET /api/v1/stream"
"""Its own test reads it."""


@dataclass
class Api:
    """A served app and the token of an engineer."""

    url: str
    token: str

    @property
    def headers(self) -> dict[str, str]:
        return {"Authorization": f"Bearer {self.token}"}


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    app = create_app(settings_in(tmp_path_factory.mktemp("api")))
    services: Services = app.state.services
    token = rules.new_secret()
    key = Token(0, "test", Role.ENGINEER, "test", 0.0, None)
    services[Database].write_now(lambda c: store.add_token(c, rules.secret_hash(token), key))
    server = uvicorn.Server(
        uvicorn.Config(app, port=0, log_level="warning", lifespan="on", ws="websockets-sansio")
    )
    thread = threading.Thread(target=server.run)
    thread.start()
    while not server.started:
        thread.join(0.02)
        assert thread.is_alive(), "the server did not start"
    port = server.servers[0].sockets[0].getsockname()[1]
    yield Api(f"http://127.0.0.1:{port}", token)
    server.should_exit = True
    thread.join()


@pytest.fixture(scope="module")
def api_schema(api: Api) -> BaseSchema:
    document = httpx.get(f"{api.url}/api/v1/openapi.json", headers=api.headers, trust_env=False, timeout=60)
    return schemathesis.openapi.from_dict(document.json())


def test_every_call(api: Api, api_schema: BaseSchema) -> None:
    names = []
    for found in api_schema.get_all_operations():
        operation = found.ok()
        if operation.label == ENDLESS:
            continue
        names.append(operation.label)

        @settings(
            max_examples=settings.default.max_examples // 10,
            phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
        )
        @given(case=operation.as_strategy())
        def check(case: Case) -> None:
            # A made-up time is long ago, and the write rightly refused (503) before its body is read.
            case.headers.pop("Lineside-Sent-At", None)
            response = case.call(base_url=api.url, headers=api.headers)
            assert response.status_code < 500 or response.status_code in (503, 504), response.text
            case.validate_response(response, excluded_checks=[positive_data_acceptance])

        check()
    assert len(names) > 20


def test_the_description_needs_a_login(api: Api) -> None:
    assert httpx.get(f"{api.url}/api/v1/openapi.json", trust_env=False).status_code == 401


def test_it_describes_every_call_of_the_contract(api: Api) -> None:
    document = httpx.get(f"{api.url}/api/v1/openapi.json", headers=api.headers, trust_env=False).json()
    unit = "/api/v1/buses/{bus}/units/{unit}"
    wanted = {
        ("get", "/api/v1/line"),
        ("get", unit),
        ("post", f"{unit}/speed"),
        ("post", f"{unit}/execute"),
        ("post", "/api/v1/buses/{bus}/execute"),
        ("post", "/api/v1/buses/{bus}/speeds"),
        ("put", f"{unit}/analog-output"),
        ("get", f"{unit}/parameters"),
        ("get", "/api/v1/history"),
        ("get", "/api/v1/events"),
    }
    there = {(method, path) for path, calls in document["paths"].items() for method in calls}
    assert wanted <= there
    assert all(
        call["responses"]["default"] for calls in document["paths"].values() for call in calls.values()
    )
