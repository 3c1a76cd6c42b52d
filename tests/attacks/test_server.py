"""Attacks on a running server: others are served meanwhile, and it is over when they stop.

Short here; ``make soak`` attacks in every way and prints what others notice.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.attacks.attackers import ATTACKS
from tests.attacks.measure import EVENTS, HEADING, Measured, add_worker_token, fill_the_log, measure
from tests.e2e.site import Site, site

SHORT_S = 1.0
LONG_S = 20.0
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


@pytest.mark.parametrize("attack", SHORT)
def test_others_are_served_meanwhile(target: Site, attack: str) -> None:
    """How long they wait, and what the attack costs the server, is measured below."""
    measured = measure(target, attack, SHORT_S, warm_s=0.0, settle_s=0.0)
    assert measured.health.served, measured.health.failed
    assert measured.command.served, measured.command.failed


@pytest.fixture(scope="module")
def old_target(target: Site) -> Site:
    """With the events of years."""
    fill_the_log(target, EVENTS)
    return target


@pytest.mark.soak
@pytest.mark.parametrize("attack", ATTACKS)
def test_no_client_waits_long_meanwhile(old_target: Site, table: list[Measured], attack: str) -> None:
    measured = measure(old_target, attack, LONG_S)
    table.append(measured)
    assert measured.faults == []
    assert measured.is_quick, measured.row
