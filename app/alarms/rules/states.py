"""The states of an alarm and every transition between them, as tables (ISA-18.2-2016, clause 5.6)."""

from __future__ import annotations

from typing import Literal, NamedTuple, get_args

BaseState = Literal["normal", "unack_active", "ack_active", "rtn_unack", "latched_unack", "latched_ack"]
AlarmState = Literal[BaseState, "shelved", "suppressed", "out_of_service"]
PRESENT_STATES: tuple[AlarmState, ...] = get_args(AlarmState)[1:]
"""All but normal."""
BaseTrigger = Literal["rise", "clear", "acknowledge", "reset", "realarm"]
AlarmTrigger = Literal[
    BaseTrigger, "shelve", "unshelve", "suppress", "unsuppress", "remove", "return", "silence"
]


class BaseFacts(NamedTuple):
    """The three facts that make a base state (OPC UA Part 9: ActiveState, AckedState, LatchedState)."""

    active: bool
    acknowledged: bool
    latched: bool = False


FACTS_OF: dict[BaseState, BaseFacts] = {
    "normal": BaseFacts(active=False, acknowledged=True),
    "unack_active": BaseFacts(active=True, acknowledged=False),
    "ack_active": BaseFacts(active=True, acknowledged=True),
    "rtn_unack": BaseFacts(active=False, acknowledged=False),
    "latched_unack": BaseFacts(active=False, acknowledged=False, latched=True),
    "latched_ack": BaseFacts(active=False, acknowledged=True, latched=True),
}
STATE_OF: dict[BaseFacts, BaseState] = {facts: state for state, facts in FACTS_OF.items()}


class Target(NamedTuple):
    """Where a trigger leads: an alarm that does not latch, and one that does."""

    plain: BaseState
    latching: BaseState


def _both(state: BaseState) -> Target:
    return Target(state, state)


TRANSITIONS: dict[tuple[BaseState, BaseTrigger], Target] = {
    ("normal", "rise"): _both("unack_active"),
    ("unack_active", "acknowledge"): _both("ack_active"),
    ("unack_active", "clear"): Target("rtn_unack", "latched_unack"),
    ("ack_active", "clear"): Target("normal", "latched_ack"),
    ("ack_active", "realarm"): _both("unack_active"),
    ("rtn_unack", "acknowledge"): _both("normal"),
    ("rtn_unack", "rise"): _both("unack_active"),
    ("latched_unack", "acknowledge"): _both("latched_ack"),
    ("latched_unack", "rise"): _both("unack_active"),
    ("latched_ack", "reset"): _both("normal"),
    ("latched_ack", "rise"): _both("unack_active"),
}
"""Every transition between base states; what is not here does not happen."""

ON_RETURN: dict[BaseState, BaseState] = {
    "normal": "normal",
    "unack_active": "unack_active",
    "ack_active": "unack_active",
    "rtn_unack": "normal",
    "latched_unack": "latched_unack",
    "latched_ack": "latched_unack",
}
"""Out of a hidden state (shelved, suppressed, out of service) an alarm comes back as normal or, where its
condition holds, unacknowledged: G, H, I → A or B. Only a reset ends a latch."""
