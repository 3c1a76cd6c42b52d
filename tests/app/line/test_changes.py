"""Which changes are worth an entry."""

from __future__ import annotations

import pytest

from app.line.live.change_recorder import ChangeDetector, LineEvent
from bus.contract import BusFigures, BusLink, UnitLink, Update
from bus.messages import Message, term
from tests.app.stage import HEALTHY, REMOTE, bus_settings, reading


def seen(*updates: Update, **settings: object) -> list[tuple[str, int | None, str, str]]:
    """Kind, unit, old and new of every change."""
    changes = ChangeDetector(bus_settings(**settings))
    found: list[LineEvent] = []
    for update in updates:
        found += changes.detect(update)
    return [(change.kind, change.unit, str(change.old), str(change.new)) for change in found]


def link(state: str, unit: int = 1) -> UnitLink:
    return UnitLink(unit=unit, at=1.0, link=state, cause=term("no response"))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("before", "after", "change"),
    [
        ((REMOTE, HEALTHY), (0, HEALTHY), ("mode", 1, "REMOTE", "LOCAL")),
        ((0, HEALTHY), (REMOTE, HEALTHY), ("mode", 1, "LOCAL", "REMOTE")),
        ((REMOTE, HEALTHY), (REMOTE, 0), ("estop", 1, "healthy", "active")),
        ((REMOTE, 0), (REMOTE, HEALTHY), ("estop", 1, "active", "healthy")),
        ((REMOTE, HEALTHY), (REMOTE, HEALTHY | 1), ("run", 1, "off", "on")),
    ],
)
def test_a_changed_bit(
    before: tuple[int, int], after: tuple[int, int], change: tuple[str, int, str, str]
) -> None:
    first, second = (reading(1, outputs=outputs, inputs=inputs) for outputs, inputs in (before, after))
    assert seen(first, second) == [change]


def test_the_first_reading_and_an_equal_one_are_no_change() -> None:
    assert seen(reading(1), reading(1, 2000), reading(2, outputs=0), reading(1, outputs=REMOTE | 3)) == []


def test_the_dialect_defines_the_emergency_stop_level() -> None:
    assert seen(reading(1, inputs=HEALTHY), reading(1, inputs=0), estop_healthy=0) == [
        ("estop", 1, "active", "healthy")
    ]


def test_a_unit_lost_and_back_but_not_a_late_response() -> None:
    assert seen(link("online"), link("stale"), link("online")) == []
    assert seen(link("unknown"), link("online"), link("stale"), link("offline"), link("online")) == [
        ("unit", 1, "online", "offline"),
        ("unit", 1, "offline", "online"),
    ]


def test_what_another_program_does_to_the_port_is_one_event() -> None:
    def figures(*diagnosis: Message) -> BusFigures:
        return BusFigures(2.0, 1.0, 1.0, 0.5, 1.0, diagnosis=list(diagnosis))

    changed = Message.of("diagnosis_port_changed", changed=["echo"])
    other = Message.of("diagnosis_port_changed", changed=["1200 baud"])
    echo = Message("diagnosis_echo")
    updates = (figures(echo), figures(changed, echo), figures(changed), figures(other, changed), figures())
    changes = ChangeDetector(bus_settings())
    found = [str(event.what) for update in updates for event in changes.detect(update)]
    assert found == [
        "Another program changed the settings of the port: echo. They were put back.",
        "Another program changed the settings of the port: 1200 baud. They were put back.",
    ]


def test_a_closed_port_is_one_change_and_not_one_for_each_unit() -> None:
    opened, closed = BusLink(at=1.0, link="open"), BusLink(at=2.0, link="closed", cause=term("unplugged"))
    assert seen(opened, link("online"), link("online", 2), closed, link("offline"), link("offline", 2)) == [
        ("bus", None, "open", "closed")
    ]
    assert seen(opened, BusLink(at=1.0, link="open", baud=4800)) == [], "another rate is no news of the port"
    assert seen(opened, closed, opened) == [("bus", None, "open", "closed"), ("bus", None, "closed", "open")]
