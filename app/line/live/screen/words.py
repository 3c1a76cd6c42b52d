"""Fixed words of live states, in English, of which each reading shows some: `Language.term` translates a word
20 times as fast as a message.
"""

from __future__ import annotations

from app.core.web.rendering.formats import UNKNOWN
from app.line.live.state.motion import MotionState
from bus.contract import Stage

STATE_WORDS: dict[MotionState, str] = {
    "": "not known",
    "at_speed": "at speed",
    "at_zero": "at zero",
    "ramping_up": "ramping up",
    "ramping_down": "ramping down",
    "off_speed": "off speed",
    "stopped": "stopped",
    "stopping": "still turning",
    "turning": "turning without run",
}
TURNING = "turning"
"""Beside a cause that names the run input."""
STOPPED_WITH_RUN = "stopped with run input on"
MODE_WORDS = {"": UNKNOWN, "remote": "REMOTE", "local": "LOCAL", "keylock": "KEYLOCK"}
STAGE_WORDS: dict[Stage, str] = {
    "waiting": "waiting for the bus",
    "sent": "sent",
    "searching": "addresses scanned:",
    "acknowledged": "acknowledged",
    "proving": "reading back",
}
