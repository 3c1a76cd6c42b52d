"""A device server that goes away while a write is under way, and comes back: every outcome is true."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import serial

from tests.bus.rfc2217_server import DeviceServer, Passing
from tests.path.dashboard import Dashboard, dashboard
from tests.path.independent_unit import Cable, Unit

SET = 0x84


class PlainServer(DeviceServer):
    """A server that passes the bytes on unchanged."""

    @property
    def url(self) -> str:
        """For lineside.toml."""
        return super().url.replace("rfc2217://", "socket://")

    def _passing(self, _port: serial.Serial) -> tuple[Passing, Passing]:
        return bytes, bytes


class Served(Cable):
    """A cable behind a device server."""

    kind: type[DeviceServer]

    def __init__(self, path: Path, units: list[Unit]) -> None:
        super().__init__(path, units)
        self.server = self.kind(str(path))

    @property
    def port(self) -> str:
        """The device server's address."""
        return self.server.url

    def plug(self) -> None:
        """With its server."""
        super().plug()
        self.server.__enter__()

    def pull(self) -> None:
        """With its server."""
        self.server.__exit__(None, None, None)
        super().pull()


class ServedPlain(Served):
    """``socket://``"""

    kind = PlainServer


class ServedByRfc2217(Served):
    """``rfc2217://``"""

    kind = DeviceServer


class Witness(Unit):
    """At its first 84h the server closes: before or after the unit has carried it out."""

    cable: Served
    deaf = False
    armed = False

    def respond(self, body: bytes) -> bytes | None:
        """As any unit does, but for the one time."""
        if not (self.armed and body[0] == self.address and body[1] == SET):
            return super().respond(body)
        self.armed = False
        self.cable.server.hang_up()
        return None if self.deaf else super().respond(body)


@pytest.fixture(params=[ServedPlain, ServedByRfc2217], ids=["socket", "rfc2217"], scope="module")
def plant(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Dashboard]:
    if request.param is ServedByRfc2217:
        pytest.importorskip("serialx")
    witness = Witness(1, commanded=1000, actual=1000)
    folder = tmp_path_factory.mktemp("served")
    with dashboard(folder, [witness, Unit(2)], cable_of=request.param) as made:
        assert isinstance(made.cable, Served)
        witness.cable = made.cable
        yield made


@pytest.mark.parametrize(
    ("deaf", "timeout_s"), [(False, 0.6), (True, 10.0)], ids=["carried out", "not carried out"]
)
def test_it_goes_away_while_a_write_is_on_its_way(plant: Dashboard, deaf: bool, timeout_s: float) -> None:
    unit = plant.cable.units[1]
    assert isinstance(unit, Witness)
    _wait_for_responses(plant)
    unit.writes.clear()
    wanted = unit.commanded + 1
    unit.deaf, unit.armed = deaf, True
    result = plant.bus("POST", "/units/1/speed", {"raw": wanted, "timeout_s": timeout_s}).json()
    assert not unit.armed, f"the write did not come so far: {result}"
    assert result["outcome"] in ("verified", "unverified"), "it left, so nothing else is known to be so"
    if result["outcome"] == "verified":
        assert (result["read_back"], unit.commanded) == (wanted, wanted)
    done = len(unit.writes)
    _wait_for_responses(plant)
    assert len(unit.writes) == done, "nothing is sent once the result was reported"
    event = plant.call("GET", "/events?kind=command&limit=1").json()["events"][0]
    assert event["outcome"] == result["outcome"]


def _wait_for_responses(plant: Dashboard) -> None:
    """Wait until both units were read after the call, so that pending requests have been sent."""
    for number in (1, 2, 1, 2):
        before: Any = plant.unit(number)["read_at"]
        plant.see(
            number,
            "read again",
            lambda shown, before=before: shown["link"] == "online" and shown["read_at"] != before,  # type: ignore[misc]
        )
