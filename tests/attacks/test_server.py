"""Attacks on a running server: others are served meanwhile, and it is over when they stop.

``make test`` carries out each once, briefly; ``make soak`` measures and prints what others notice. A new
one is a row in `tests.attacks.attackers` and needs nothing else.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.attacks.attackers import ATTACKS, EACH
from tests.attacks.measure import (
    EVENTS,
    HEADING,
    MAX_GROWTH_MIB,
    Measured,
    add_worker_token,
    attacking,
    fill_the_log,
    health_request,
    measure,
)
from tests.e2e.site import Site, site
from tests.sizes import sizes

BRIEF_S = 0.02
SHORT_S = 1.0
LONG_S = 8.0
TRIES = 3
"""Other work on the machine lengthens waits for a while, and what the server does wrong each time."""
SHORT = (
    "bodies without an end",
    "snapshots without end",
    "keys by the thousand",
    "searches",
    "chunks of a byte",
    "health by 64 connections",
    "empty messages before hello",
)


@pytest.fixture(scope="module")
def target(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    with site(tmp_path_factory.mktemp("attacked"), 2) as target:
        add_worker_token(target)
        yield target


@pytest.fixture(scope="module")
def table() -> Iterator[list[Measured]]:
    """Of all that was measured, printed at the end."""
    measured: list[Measured] = []
    yield measured
    print("\n" + HEADING, *(each.row for each in measured), sep="\n")


@pytest.mark.parametrize("attack", sizes(SHORT[0], *SHORT[1:]))
def test_others_are_served_meanwhile(target: Site, attack: str) -> None:
    """How long they wait, and what the attack costs the server, is measured below."""
    measured = measure(target, attack, SHORT_S, warm_s=0.0, settle_s=0.0)
    assert measured.health.served, measured.health.failed
    assert measured.command.served, measured.command.failed


def test_each_attack_can_be_carried_out(target: Site) -> None:
    with attacking(target, EACH, BRIEF_S):
        pass
    health_request(target)()


@pytest.fixture(scope="module")
def old_target(target: Site) -> Site:
    """With the events of years."""
    fill_the_log(target, EVENTS)
    return target


@pytest.mark.soak
@pytest.mark.parametrize("attack", ATTACKS)
def test_no_client_waits_long_meanwhile(old_target: Site, table: list[Measured], attack: str) -> None:
    for _ in range(TRIES):
        measured = measure(old_target, attack, LONG_S)
        table.append(measured)
        assert measured.faults == []
        assert measured.growth_mib <= MAX_GROWTH_MIB
        if measured.is_quick:
            return
    pytest.fail(measured.row)
