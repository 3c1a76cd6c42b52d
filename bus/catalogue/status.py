"""The bits of ST2 and ST1, the two status bytes in the response to 81h (manual, Read speed and status)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

OUTPUT_NUMBERS = range(1, 7)


@dataclass(frozen=True, slots=True)
class StatusBits:
    """ST2 and ST1 as words. ``outputs[0]`` is auxiliary output 1."""

    at_speed: bool
    remote: bool
    outputs: tuple[bool, bool, bool, bool, bool, bool]
    run: bool
    estop_active: bool
    """An emergency stop is active, whichever level means that in this dialect."""
    preset: bool
    reverse: bool
    up: bool
    down: bool
    follower: bool

    @property
    def inputs(self) -> dict[str, bool]:
        """The inputs of ST1 by the names that programs are given."""
        return {
            "run": self.run,
            "estop": self.estop_active,
            "preset": self.preset,
            "reverse": self.reverse,
            "up": self.up,
            "down": self.down,
            "slave": self.follower,
        }


@lru_cache(maxsize=4096)
def status_bits(outputs: int, inputs: int, estop_healthy: int = 1) -> StatusBits:
    """``outputs`` is ST2, ``inputs`` is ST1; ``estop_healthy`` is the dialect's level of a healthy chain."""
    one, two, three, four, five, six, remote, at_speed = (_bit(outputs, position) for position in range(8))
    run, estop, preset, reverse, up, down, follower = (_bit(inputs, position) for position in range(7))
    auxiliary = (one, two, three, four, five, six)
    estop_active = estop != bool(estop_healthy)
    return StatusBits(at_speed, remote, auxiliary, run, estop_active, preset, reverse, up, down, follower)


def output_is_on(outputs: int, number: int) -> bool:
    """Whether auxiliary output ``number`` (1-6) is on in ST2."""
    return _bit(outputs, number - 1)


def _bit(byte: int, position: int) -> bool:
    return bool(byte >> position & 1)
