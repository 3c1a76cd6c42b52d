"""How quickly one account may open WebSockets."""

from __future__ import annotations

from app.server.handshakes import A_SECOND, MOST_AT_ONCE, Handshakes


def test_all_pages_of_a_plant_come_back_at_once_and_more_are_delayed() -> None:
    handshakes = Handshakes()
    assert {handshakes.wait_s("ann", 0.0) for _ in range(MOST_AT_ONCE)} == {0.0}
    waits = [handshakes.wait_s("ann", 0.0) for _ in range(3)]
    assert waits == [1 / A_SECOND, 2 / A_SECOND, 3 / A_SECOND]


def test_others_do_not_wait_and_the_delay_ends() -> None:
    handshakes = Handshakes()
    for _ in range(2 * MOST_AT_ONCE):
        handshakes.wait_s("ann", 0.0)
    assert handshakes.wait_s("ben", 0.0) == 0.0
    assert handshakes.wait_s("ann", 0.0) > 1.0
    assert handshakes.wait_s("ann", 1e3) == 0.0
