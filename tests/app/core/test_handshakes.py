"""How quickly one account may open WebSockets."""

from __future__ import annotations

from app.core.server.admission.handshakes import (
    A_SECOND,
    MAX_AT_ONCE,
    MAX_TOGETHER,
    MAX_TOGETHER_A_SECOND,
    Handshakes,
)


def test_all_pages_of_a_plant_come_back_quickly_and_more_are_delayed() -> None:
    handshakes = Handshakes()
    waits = [handshakes.wait_s("ann", 0.0) for _ in range(MAX_AT_ONCE + 600)]
    assert waits[:MAX_TOGETHER] == [0.0] * MAX_TOGETHER
    assert waits[MAX_AT_ONCE - 1] == (MAX_AT_ONCE - MAX_TOGETHER) / MAX_TOGETHER_A_SECOND
    assert waits[-1] == 600 / A_SECOND


def test_pages_that_come_one_after_the_other_do_not_wait() -> None:
    handshakes = Handshakes()
    assert {handshakes.wait_s("ann", n / MAX_TOGETHER_A_SECOND) for n in range(MAX_AT_ONCE)} == {0.0}


def test_others_do_not_wait_and_the_delay_ends() -> None:
    handshakes = Handshakes()
    for _ in range(2 * MAX_AT_ONCE):
        handshakes.wait_s("ann", 0.0)
    assert handshakes.wait_s("ben", 0.0) == 0.0
    assert handshakes.wait_s("ann", 0.0) > 1.0
    assert handshakes.wait_s("ann", 1e3) == 0.0
