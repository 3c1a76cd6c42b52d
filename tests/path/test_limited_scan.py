"""A bus whose scan the configuration limits: slow readings are live, and a dead unit is still found."""

from __future__ import annotations

from pathlib import Path

from tests.path.dashboard import dashboard
from tests.path.independent_unit import Unit


def test_slow_readings_are_live_and_commands_take_their_turn_at_once(tmp_path: Path) -> None:
    units = [Unit(1), Unit(2)]
    with dashboard(tmp_path, units, bus_toml="max_scan_hz = 0.25") as plant:
        old = plant.see(2, "live", lambda shown: shown["link"] == "online" and shown["age_ms"] > 2500)
        assert old["actual_raw"] == 0
        assert plant.line()["scan_hz"] == 0.25
        result = plant.bus("POST", "/units/1/speed", {"raw": 1200, "execute": True}, "operator").json()
        assert result["outcome"] == "verified", result
        units[1].off = True
        plant.see(2, "offline", lambda shown: shown["link"] == "offline")
        assert plant.unit(1)["link"] == "online"
