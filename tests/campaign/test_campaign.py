"""A campaign of faults against a server and its lines, judged by the checker. Root only; needs ser2net."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests import unpacked
from tests.campaign.faults import SETTLE_S, schedule
from tests.campaign.network import Network, call, unusable
from tests.campaign.run import Campaign


@pytest.fixture(scope="module")
def namespaces() -> None:
    if reason := unusable():
        pytest.skip(reason)


def test_a_seed_gives_one_schedule() -> None:
    faults = list(schedule(7, 100))
    assert faults == list(schedule(7, 100))
    assert faults != list(schedule(8, 100))
    assert all(fault.after_s >= SETTLE_S for fault in faults)
    assert len({(fault.kind, fault.target) for fault in faults}) == 9


@pytest.mark.soak
@pytest.mark.usefixtures("namespaces")
def test_machines_reach_each_other_until_they_are_cut_or_separated() -> None:
    reach = "import socket; socket.create_connection(('{}', 7), 0.3)"
    with Network(("one", "other")) as network:
        one, other = network.machines["one"], network.machines["other"]

        def outcome() -> str:
            program = f"try:\n {reach.format(other.address)}\nexcept OSError as e: print(type(e).__name__)"
            return call(*one.inside, "python3", "-c", program).strip()

        assert outcome() == "ConnectionRefusedError"
        network.separate("one", "other")
        assert outcome() == "TimeoutError"
        network.reunite("one", "other")
        assert outcome() == "ConnectionRefusedError"
        network.cut("other")
        assert outcome() != "ConnectionRefusedError"
        network.join("other")
        assert outcome() == "ConnectionRefusedError"


@pytest.mark.soak
@pytest.mark.usefixtures("namespaces")
def test_one_server_keeps_what_it_acknowledged(tmp_path: Path) -> None:
    unpacked.program("ser2net")
    assert Campaign(tmp_path, seed=1).run(20) == 0
