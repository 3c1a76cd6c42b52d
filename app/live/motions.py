"""The motions of all units, shared by all languages: each sees every reading once."""

from __future__ import annotations

from collections.abc import Sequence

from app.live.abnormal import conditions_of
from app.live.fields import bits_of
from app.live.motion import Motion
from app.live.state import BusLive, LiveState


def motions_for(live: LiveState) -> dict[tuple[str, int], Motion]:
    """One for each unit, by bus and address."""
    return {(name, number): Motion() for name, bus in live.buses.items() for number in bus.units}


def watch_motions(
    motions: dict[tuple[str, int], Motion], bus_name: str, bus: BusLive, units: Sequence[int], scan_s: float
) -> None:
    """Let the motions see the newest readings of these units."""
    for number in units:
        reading = bus.units[number].reading
        if reading is not None:
            bits, motion = bits_of(bus, reading), motions[bus_name, number]
            state = motion.see(reading, at_speed=bits.at_speed, scan_s=scan_s)
            motion.note(reading.at, conditions_of(bits, reading, state))
