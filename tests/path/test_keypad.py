"""A value is executed as its unit shows it, also after its scale was changed at the keypad.

Over the API, through the server, the worker and a pseudo-terminal, with units written from the manual alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from tests.path.dashboard import Dashboard, dashboard
from tests.path.independent_unit import FACTORY, Unit

FIRST, SECOND = 1, 2
SCALE = {number: FACTORY[number] for number in (2, 3, 8)}
REFUSED_WITH = {"outcome": "refused", "code": "refused", "unit_error": None}


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Dashboard]:
    units = [Unit(number, commanded=500, actual=500) for number in (FIRST, SECOND)]
    with dashboard(tmp_path_factory.mktemp("plant"), units) as made:
        yield made


@pytest.fixture
def units(plant: Dashboard) -> dict[int, Unit]:
    units = plant.cable.units
    for number, unit in units.items():
        unit.commanded = unit.actual = 500
        if unit.values != unit.values | SCALE:
            unit.values |= SCALE
            body = plant.bus("GET", f"/units/{number}/parameters?refresh=true", role="viewer")
            assert body.status_code == 200, body.text
        plant.see(number, "its scale again", lambda shown: shown["commanded"] == "50.0")
        unit.writes.clear()
    return units


def newest_events(plant: Dashboard, count: int) -> list[dict[str, Any]]:
    found = plant.call("GET", f"/events?limit={count}&kind=command", role="viewer").json()["events"]
    return list(found)


def test_ten_times_what_was_typed_is_refused_and_nothing_is_sent(
    plant: Dashboard, units: dict[int, Unit]
) -> None:
    units[FIRST].values |= {2: 2000, 3: 0}
    response = plant.bus("POST", "/units/1/speed", {"value": "100.0"})
    assert response.status_code == 409, response.text
    assert response.json().items() >= REFUSED_WITH.items()
    assert "(parameter 3) was 1 and is 0 now" in response.json()["detail"]
    assert "(parameter 2) was 20000 and is 2000 now" in response.json()["detail"]
    assert units[FIRST].writes == []
    # The scale that the refusal has read is that of the next value.
    assert plant.bus("POST", "/units/1/speed", {"value": "100.0"}).status_code == 422
    verified = plant.bus("POST", "/units/1/speed", {"value": "100"})
    assert (verified.status_code, units[FIRST].commanded) == (200, 100)
    assert plant.unit(FIRST)["commanded"] in ("100", "500")


def test_a_parameter_in_display_units_is_refused(plant: Dashboard, units: dict[int, Unit]) -> None:
    units[SECOND].values[3] = 2
    response = plant.bus("PUT", "/units/2/parameters/12", {"value": "2.5"}, role="engineer")
    assert response.json().items() >= REFUSED_WITH.items(), response.text
    assert units[SECOND].writes == []


def test_what_was_given_raw_is_sent_and_recorded_as_the_unit_shows_it(
    plant: Dashboard, units: dict[int, Unit]
) -> None:
    units[FIRST].values[3] = 0
    verified = plant.bus("POST", "/units/1/speed", {"raw": 700})
    assert (verified.status_code, verified.json()["read_back"], units[FIRST].commanded) == (200, 700, 700)
    event = newest_events(plant, 1)[0]
    assert (event["old"], event["new"], event["new_raw"], event["outcome"]) == ("500", "700", 700, "verified")
