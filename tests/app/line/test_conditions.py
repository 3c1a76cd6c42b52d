"""What the bits mean, in one table: events, causes and onsets all read it."""

from __future__ import annotations

import pytest

from app.line.live.unit_status import conditions_of
from bus.catalogue.values import status_bits
from bus.contract import Reading

AT_SPEED, REMOTE, RUN, HEALTHY = 0x80, 0x40, 0x01, 0x02


@pytest.mark.parametrize(
    ("outputs", "inputs", "actual", "holding"),
    [
        (AT_SPEED | REMOTE, RUN | HEALTHY, 0, set()),
        (AT_SPEED | REMOTE, RUN | HEALTHY, 5, {"turning"}),
        (AT_SPEED | REMOTE, HEALTHY, 0, {"run_off"}),
        (AT_SPEED | REMOTE, RUN, 0, {"estop_active"}),
        (AT_SPEED, RUN | HEALTHY, 0, {"not_in_remote"}),
        (REMOTE, RUN | HEALTHY, 0, {"not_at_speed"}),
        (0, 0, 1, {"estop_active", "run_off", "not_in_remote", "not_at_speed", "turning"}),
    ],
)
def test_each_bit_is_one_condition(outputs: int, inputs: int, actual: int, holding: set[str]) -> None:
    reading = Reading(1, 0.0, 500, actual, analog=0, outputs=outputs, inputs=inputs)
    assert conditions_of(status_bits(outputs, inputs), reading) == holding


def test_the_level_of_the_e_stop_bit_is_the_dialects() -> None:
    reading = Reading(1, 0.0, 500, 0, analog=0, outputs=AT_SPEED | REMOTE, inputs=RUN)
    assert conditions_of(status_bits(reading.outputs, reading.inputs, estop_healthy=0), reading) == set()
