from __future__ import annotations

import pytest

from app.line.live.hub import FEW_PAGES, FLOOD, MAX_SENDS_S, WINDOW_S, Flow


def flow() -> tuple[Flow, list[float]]:
    now = [100.0]
    return Flow(lambda: now[0]), now


def test_what_one_wire_brings_is_never_held_up() -> None:
    made, now = flow()
    for _ in range(200):
        now[0] += 1 / 38.4
        made.came()
        assert made.pause_s() == 0.0


def test_a_flood_is_sent_once_per_window_until_it_is_over() -> None:
    made, now = flow()
    made.came(FLOOD + 1)
    assert made.pause_s() == 0.0, "a burst is sent at once"
    made.sent()
    assert made.pause_s() == WINDOW_S, "and what follows it later"
    now[0] += WINDOW_S
    made.came()
    made.sent()
    assert made.pause_s() == WINDOW_S, "the next window begins flooded"
    now[0] += WINDOW_S
    made.came()
    made.sent()
    assert made.pause_s() == 0.0, "that window was quiet"


def test_very_many_pages_share_what_the_server_can_send() -> None:
    made, now = flow()
    made.share(200)
    made.came()
    assert made.pause_s() == 0.0, "the first is sent at once"
    made.sent()
    made.came()
    assert made.pause_s() == pytest.approx(200 / MAX_SENDS_S)
    now[0] += 1.01 * 200 / MAX_SENDS_S
    assert made.pause_s() == 0.0


def test_a_few_pages_get_every_response() -> None:
    made, _now = flow()
    made.share(200)
    made.share(FEW_PAGES)
    made.sent()
    made.came()
    assert made.pause_s() == 0.0
