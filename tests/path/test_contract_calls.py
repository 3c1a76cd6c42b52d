"""Every call of the contract, with its statuses, against units that were written from the manual alone."""

from __future__ import annotations

import json
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

from tests import fork_server
from tests.path.dashboard import Dashboard, dashboard
from tests.path.independent_unit import FACTORY, Unit

MASTER, SIXTEEN, LOCAL, OLD, DEAD, ODD = 1, 16, 3, 4, 5, 6


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Dashboard]:
    units = [
        Unit(MASTER, commanded=1234, actual=1230, analog_in=51),
        Unit(SIXTEEN, reply_bytes=4),
        Unit(LOCAL, remote=False),
        Unit(OLD, highest_parameter=30),
        Unit(DEAD, off=True),
        Unit(ODD),
    ]
    with dashboard(tmp_path_factory.mktemp("plant"), units) as made:
        yield made


@pytest.fixture
def units(plant: Dashboard) -> Iterator[dict[int, Unit]]:
    """The units, with nothing remembered of what was written before, and healthy again afterwards."""
    for unit in plant.cable.units.values():
        unit.writes.clear()
    yield plant.cable.units
    for unit in plant.cable.units.values():
        unit.deaf_to.clear()
        unit.mute_on.clear()


def problem(response: Any, status: int, code: str) -> dict[str, Any]:
    """Check that the response is this problem."""
    assert response.status_code == status, response.text
    assert response.headers["content-type"].startswith("application/problem+json")
    result: dict[str, Any] = response.json()
    assert result["code"] == code
    assert result["status"] == status
    assert result["detail"]
    return result


def result_of(response: Any, outcome: str, status: int = 200) -> dict[str, Any]:
    """Check that the response has this outcome."""
    assert response.status_code == status, response.text
    result: dict[str, Any] = response.json()
    assert result["outcome"] == outcome
    assert result["code"] == outcome
    return result


def test_the_line(plant: Dashboard) -> None:
    line = plant.call("GET", "/line", role="viewer").json()
    assert line["site"] == "Paper machine 2"
    bus = line["buses"][0]
    assert (bus["name"], bus["port"], bus["baud"]) == ("dry-end", str(plant.cable.path), 9600)
    assert bus["link"] == "open"
    assert [unit["id"] for unit in bus["units"]] == [MASTER, SIXTEEN, LOCAL, OLD, DEAD, ODD]


def test_a_unit(plant: Dashboard) -> None:
    unit = plant.see(MASTER, "online", lambda shown: shown["link"] == "online")
    assert (unit["id"], unit["name"], unit["decimals"]) == (MASTER, "Unit 1", 1)
    assert (unit["commanded_raw"], unit["commanded"]) == (1234, "123.4")
    assert (unit["actual_raw"], unit["actual"]) == (1230, "123.0")
    assert (unit["analog_raw"], unit["analog"]) == (51, 102.0)
    assert (unit["at_speed"], unit["remote"]) == (True, True)
    assert unit["outputs"] == [False] * 6
    expected = {"run": False, "estop": False, "preset": False, "reverse": False}
    assert unit["inputs"] == {**expected, "up": False, "down": False, "slave": False}
    assert datetime.fromisoformat(unit["read_at"]).tzinfo is not None
    assert 0 <= unit["age_ms"] < 60_000


def test_inputs_follow_the_unit(plant: Dashboard, units: dict[int, Unit]) -> None:
    for bit, name in enumerate(("run", "estop", "preset", "reverse", "up", "down", "slave")):
        units[ODD].inputs = 0b10 ^ (1 << bit)
        plant.see(ODD, name, lambda shown, name=name: shown["inputs"][name])  # type: ignore[misc]
    units[ODD].inputs = 0b10


def test_a_local_unit_is_shown_so(plant: Dashboard) -> None:
    assert plant.see(LOCAL, "read", lambda shown: shown["link"] == "online")["remote"] is False


def test_a_unit_that_never_responded_is_unknown_and_all_null(plant: Dashboard) -> None:
    unit = plant.unit(DEAD)
    assert unit["link"] == "unknown"
    nulls = ("read_at", "age_ms", "commanded_raw", "actual_raw", "commanded", "actual", "decimals")
    assert [unit[name] for name in nulls] == [None] * len(nulls)
    assert [unit[name] for name in ("analog", "at_speed", "remote", "outputs", "inputs")] == [None] * 5


def test_set_speed_is_verified_and_shown(plant: Dashboard, units: dict[int, Unit]) -> None:
    result = result_of(
        plant.bus("POST", "/units/1/speed?frames=true", {"raw": 4099, "execute": True}, "operator"),
        "verified",
    )
    assert result["read_back"] == 4099
    assert result["frames"]
    assert units[MASTER].commanded == 4099
    assert [(command, data.hex()) for command, _, data in units[MASTER].writes] == [(0x84, "00001003")]
    assert plant.unit(MASTER)["commanded_raw"] == 4099


def test_set_speed_by_value_in_the_units_decimals(plant: Dashboard, units: dict[int, Unit]) -> None:
    result_of(plant.bus("POST", "/units/16/speed", {"value": "1234.5", "execute": True}), "verified")
    assert units[SIXTEEN].commanded == 12345


def test_ten_times_what_was_typed_is_refused_and_nothing_is_sent(
    plant: Dashboard, units: dict[int, Unit]
) -> None:
    """Its scale was changed at the keypad."""
    units[ODD].values |= {2: 2000, 3: 0}
    result = problem(plant.bus("POST", "/units/6/speed", {"value": "100.0"}), 409, "refused")
    assert result["unit_error"] is None
    assert "(parameter 3) was 1 and is 0 now" in result["detail"]
    assert "(parameter 2) was 20000 and is 2000 now" in result["detail"]
    assert units[ODD].writes == []
    # The scale that the refusal has read is that of the next value.
    assert plant.bus("POST", "/units/6/speed", {"value": "100.0"}).status_code == 422
    result_of(plant.bus("POST", "/units/6/speed", {"value": "100"}), "verified")
    assert units[ODD].commanded == 100
    units[ODD].values |= {2: 20000, 3: 1}
    assert plant.bus("GET", "/units/6/parameters?refresh=true").status_code == 200


def test_stage_and_execute(plant: Dashboard, units: dict[int, Unit]) -> None:
    before = units[MASTER].commanded
    result_of(plant.bus("POST", "/units/1/speed", {"raw": 777, "execute": False}, "operator"), "acknowledged")
    assert (units[MASTER].staged, units[MASTER].commanded) == (777, before)
    result_of(plant.bus("POST", "/units/1/execute", role="operator"), "verified")
    assert units[MASTER].commanded == 777
    assert [command for command, _, _ in units[MASTER].writes] == [0x82, 0x83]


def test_a_unit_in_local_refuses(plant: Dashboard) -> None:
    for method, path, body in (
        ("POST", "/units/3/speed", {"raw": 5, "execute": True}),
        ("POST", "/units/3/speed", {"raw": 5, "execute": False}),
        ("POST", "/units/3/execute", None),
        ("PUT", "/units/3/outputs/1", {"on": True}),
        ("PUT", "/units/3/analog-output", {"raw": 350}),
        ("PUT", "/units/3/parameters/6", {"raw": 60}),
    ):
        result = problem(plant.bus(method, path, body), 409, "refused")
        assert (result["outcome"], result["unit_error"]) == ("refused", 128)
        assert "REMOTE" in result["unit_error_name"]


def test_an_engineers_limit_above_the_maximum_leaves_the_refusal_to_the_unit(plant: Dashboard) -> None:
    assert plant.bus("PUT", "/units/1/limits", {"highest": 25000}).status_code == 200
    try:
        result = problem(plant.bus("POST", "/units/1/speed", {"raw": 20001, "execute": True}), 409, "refused")
        assert result["unit_error"] == 129
    finally:
        assert plant.bus("PUT", "/units/1/limits", {}).status_code == 200


def test_a_unit_that_does_not_respond_is_unverified(plant: Dashboard) -> None:
    for method, path, body in (
        ("POST", "/units/5/speed", {"raw": 5, "execute": True}),
        ("POST", "/units/5/speed", {"value": "5.0", "execute": True}),
        ("POST", "/units/5/execute", None),
        ("PUT", "/units/5/outputs/1", {"on": True}),
        ("PUT", "/units/5/parameters/6", {"raw": 60}),
        ("GET", "/units/5/parameters?refresh=true", None),
    ):
        problem(plant.bus(method, path, body), 504, "unverified")


def test_a_speed_that_is_not_taken_is_unverified_with_what_was_read(
    plant: Dashboard, units: dict[int, Unit]
) -> None:
    units[ODD].deaf_to = {0x84}
    result = problem(plant.bus("POST", "/units/6/speed", {"raw": 2222, "execute": True}), 504, "unverified")
    assert result["read_back"] == units[ODD].commanded != 2222


def test_a_lost_acknowledgement_is_settled_by_the_read_back(plant: Dashboard, units: dict[int, Unit]) -> None:
    units[ODD].mute_on = {0x84}
    result_of(plant.bus("POST", "/units/6/speed", {"raw": 3333, "execute": True}), "verified")
    assert units[ODD].commanded == 3333


def test_outputs(plant: Dashboard, units: dict[int, Unit]) -> None:
    for number in range(1, 7):
        result_of(plant.bus("PUT", f"/units/1/outputs/{number}", {"on": True}, "operator"), "verified")
        assert plant.unit(MASTER)["outputs"] == [True] * number + [False] * (6 - number)
    result_of(plant.bus("PUT", "/units/1/outputs/2", {"on": False}, "operator"), "verified")
    assert units[MASTER].outputs == 0b111101
    units[ODD].deaf_to = {0x87}
    problem(plant.bus("PUT", "/units/6/outputs/2", {"on": True}), 504, "unverified")


def test_analog_output_is_acknowledged_never_verified(plant: Dashboard, units: dict[int, Unit]) -> None:
    result_of(plant.bus("PUT", "/units/1/analog-output", {"raw": 350}, "engineer"), "acknowledged")
    assert units[MASTER].analog_out == 350


def test_analog_output_that_is_not_set_for_the_link(plant: Dashboard) -> None:
    result_of(plant.bus("PUT", "/units/6/parameters/28", {"raw": 1}), "verified")
    result = problem(plant.bus("PUT", "/units/6/analog-output", {"raw": 350}), 409, "refused")
    assert result["unit_error"] == 135
    result_of(plant.bus("PUT", "/units/6/parameters/28", {"raw": 2}), "verified")


def test_parameters(plant: Dashboard) -> None:
    for number in (MASTER, SIXTEEN):
        rows = plant.bus("GET", f"/units/{number}/parameters?refresh=true", role="viewer").json()
        assert [row["number"] for row in rows] == list(range(1, 41))
        raws = {row["number"]: row["raw"] for row in rows}
        expected = {**FACTORY, 17: number, 21: None}
        changed = {key: (raws[key], expected[key]) for key in expected if raws[key] != expected[key]}
        assert changed == {}
        assert all(row["available"] and row["read_at"] for row in rows)
    ramp = rows[5]
    wanted = {"name": "Acceleration Ramp Rate", "raw": 50, "value": "5.0", "unit": "s", "min": 0, "max": 9999}
    assert ramp.items() >= wanted.items()
    assert "4711" not in str(rows[20])


def test_a_unit_with_fewer_parameters(plant: Dashboard) -> None:
    rows = plant.bus("GET", "/units/4/parameters?refresh=true").json()
    assert [row["number"] for row in rows if row["available"] is False] == list(range(31, 41))
    assert rows[30]["raw"] is None
    result = problem(plant.bus("PUT", "/units/4/parameters/31", {"raw": 5}), 409, "refused")
    assert result["unit_error"] == 130


def test_a_written_parameter_is_shown_as_read_back(plant: Dashboard, units: dict[int, Unit]) -> None:
    result = result_of(plant.bus("PUT", "/units/1/parameters/16", {"raw": 0}, "engineer"), "verified")
    assert result["read_back"] == 0
    assert units[MASTER].writes[-1][2] == bytes([16, 0, 0, 0, 0])
    rows = plant.bus("GET", "/units/1/parameters").json()
    assert rows[15]["raw"] == 0
    result_of(plant.bus("PUT", "/units/1/parameters/16", {"raw": 1}), "verified")
    units[ODD].deaf_to = {0x86}
    result = problem(plant.bus("PUT", "/units/6/parameters/6", {"raw": 77}), 504, "unverified")
    assert result["read_back"] == FACTORY[6]


def test_changed_decimals_change_shown_values(plant: Dashboard) -> None:
    result_of(plant.bus("PUT", "/units/16/parameters/3", {"raw": 2}), "verified")
    unit = plant.see(SIXTEEN, "with two decimals", lambda shown: shown["decimals"] == 2)
    assert unit["commanded"] == f"{unit['commanded_raw'] / 100:.2f}"
    result_of(plant.bus("PUT", "/units/16/parameters/3", {"raw": 1}), "verified")


def test_dangerous_parameters_need_a_confirmation(plant: Dashboard, units: dict[int, Unit]) -> None:
    for number, raw in ((18, 48), (19, 0), (27, 1)):
        result = problem(plant.bus("PUT", f"/units/6/parameters/{number}", {"raw": raw}), 409, "dangerous")
        assert result["outcome"] == "dangerous"
    assert units[ODD].writes == []
    result_of(plant.bus("PUT", "/units/6/parameters/27", {"raw": 1, "confirm": True}), "verified")
    result_of(plant.bus("PUT", "/units/6/parameters/27", {"raw": 0, "confirm": True}), "verified")


def test_setpoints_of_several_as_one(plant: Dashboard, units: dict[int, Unit]) -> None:
    setpoints = {"1": {"raw": 1500}, "16": {"raw": 1600}, "6": {"value": "170.0"}}
    result = result_of(plant.bus("POST", "/speeds", {"setpoints": setpoints}, "operator"), "verified")
    assert {key: unit["outcome"] for key, unit in result["units"].items()} == dict.fromkeys(
        ("1", "16", "6"), "verified"
    )
    assert [units[number].commanded for number in (MASTER, SIXTEEN, ODD)] == [1500, 1600, 1700]
    for number in (MASTER, SIXTEEN, ODD):
        assert [command for command, _, _ in units[number].writes] == [0x82, 0x83]


@pytest.mark.parametrize(
    ("stopper", "outcome", "status"), [(LOCAL, "refused", 409), (DEAD, "unverified", 504)]
)
def test_nothing_is_broadcast_unless_all_acknowledge(
    plant: Dashboard, units: dict[int, Unit], stopper: int, outcome: str, status: int
) -> None:
    before = units[MASTER].commanded
    setpoints = {"1": {"raw": 9999}, str(stopper): {"raw": 9999}}
    result = problem(plant.bus("POST", "/speeds", {"setpoints": setpoints}), status, outcome)
    assert result["units"][str(stopper)]["outcome"] in (outcome, "not_sent")
    assert result["units"]["1"]["outcome"] != "verified"
    assert units[MASTER].commanded == before
    assert not any(command == 0x83 for unit in units.values() for command, _, _ in unit.writes)
    assert units[MASTER].staged in (None, before)


def test_execute_all(plant: Dashboard, units: dict[int, Unit]) -> None:
    units[LOCAL].remote, units[DEAD].off = True, False
    plant.see(DEAD, "heard", lambda shown: shown["link"] == "online")
    for number, raw in ((MASTER, 2100), (ODD, 2200)):
        result_of(plant.bus("POST", f"/units/{number}/speed", {"raw": raw, "execute": False}), "acknowledged")
    result = result_of(plant.bus("POST", "/execute", role="operator"), "verified")
    assert (units[MASTER].commanded, units[ODD].commanded) == (2100, 2200)
    assert result["units"]["1"]["read_back"] == 2100
    units[LOCAL].remote, units[DEAD].off = False, True


def test_the_trace_shows_what_was_sent(plant: Dashboard) -> None:
    result_of(plant.bus("POST", "/units/1/speed", {"raw": 2700, "execute": True}), "verified")
    frames = plant.bus("GET", "/trace?limit=500").json()["frames"]
    assert "10 02 01 84 00 00 0A 8C 10 03 E5" in [frame["hex"] for frame in frames]
    text = plant.bus("GET", "/trace?seconds=60").text
    assert "10 02 01 84 00 00 0A 8C 10 03 E5" in text
    path = Path(plant.folder / "trace.txt")
    path.write_text(text)
    read = fork_server.run("decode", "--json", "--file", path)
    decoded = json.loads(read.stdout)
    kept = [line for line in text.splitlines() if line.split("\t")[2]]
    assert len(decoded) >= len(kept), "every frame of it that is no secret, complete"
    assert all(frame["checksum_ok"] for frame in decoded)
    assert {frame["uid"] for frame in decoded if frame["fields"].get("raw") == 2700} == {1}
