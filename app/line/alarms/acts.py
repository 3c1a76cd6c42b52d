"""The acts of people on alarms. The route, the form, the check and the event of an act follow from its
row."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import ConfigDict, Field

from app.core.web.access import Role
from app.core.web.shape import StrictBody
from app.line.alarms import rules
from app.line.alarms.rules import Changed
from app.people.audit.acts import Act
from bus.validation import OneLine

MAX_MINUTES = 720
"""A shift in minutes. An alarm that has to be hidden for longer is taken out of service."""
MINUTE_S = 60
ActReason = Annotated[OneLine, Field(min_length=1, max_length=200)]
Comment = Annotated[OneLine, Field(max_length=200)]


class ActBody(StrictBody):
    """The body of an act. Blanks around a text are removed."""

    model_config = ConfigDict(str_strip_whitespace=True)

    @property
    def remark(self) -> str:
        """The text for the journal and the audit log."""
        raise NotImplementedError

    @property
    def options(self) -> dict[str, Any]:
        """Further arguments of the act's ``change``."""
        return {}


class AlarmCommentRequest(ActBody):
    """A remark for the journal and the audit log."""

    comment: Comment = ""

    @property
    def remark(self) -> str:
        return self.comment


class AlarmReturnRequest(ActBody):
    """A reason for the journal and the audit log."""

    reason: Comment = ""

    @property
    def remark(self) -> str:
        return self.reason


class AlarmOutOfServiceRequest(AlarmReturnRequest):
    """The reason for hiding the alarm."""

    reason: ActReason


class AlarmShelveRequest(AlarmOutOfServiceRequest):
    """The reason for hiding the alarm, and for how long."""

    minutes: Annotated[int, Field(ge=1, le=MAX_MINUTES, description="At most a shift, 720.")]
    once: Annotated[bool, Field(description="Or until its condition has ended, if that is sooner.")] = False

    @property
    def options(self) -> dict[str, Any]:
        return {"for_s": self.minutes * MINUTE_S, "once": self.once}


@dataclass(frozen=True, slots=True)
class AlarmAct(Act):
    """An act of a person on one alarm. ``path``: the end of its routes, after the id of the occurrence;
    ``means``: its description in the API; ``change``: the function that changes the facts, called with the
    options of the ``body``. An act that ``hides`` the alarm needs a reason."""

    path: str
    means: str
    change: Callable[..., Changed]
    body: type[ActBody] = AlarmCommentRequest
    hides: bool = False


ACKNOWLEDGE = AlarmAct(
    "acknowledge_alarm",
    Role.OPERATOR,
    "alarm",
    "event_alarm_acknowledged",
    path="acknowledge",
    means="Acknowledge the occurrence that the id names.",
    change=rules.acknowledge,
    counted=False,
)
SILENCE = AlarmAct(
    "silence_alarm",
    Role.OPERATOR,
    "alarm",
    "event_alarm_silenced",
    path="silence",
    means="End the sound of the occurrence that the id names. It is still to be acknowledged.",
    change=rules.silence,
)
RESET = AlarmAct(
    "reset_alarm",
    Role.OPERATOR,
    "alarm",
    "event_alarm_reset",
    path="reset",
    means="Reset an acknowledged alarm that is latched.",
    change=rules.reset,
)
SHELVE = AlarmAct(
    "shelve_alarm",
    Role.OPERATOR,
    "alarm",
    "event_alarm_shelved",
    path="shelve",
    means="Hide it until a time. It is still detected and recorded.",
    body=AlarmShelveRequest,
    change=rules.shelve,
    hides=True,
)
UNSHELVE = AlarmAct(
    "unshelve_alarm",
    Role.OPERATOR,
    "alarm",
    "event_alarm_unshelved",
    path="unshelve",
    means="Annunciate it again before its time.",
    body=AlarmReturnRequest,
    change=rules.unshelve,
)
REMOVE = AlarmAct(
    "remove_alarm_from_service",
    Role.ENGINEER,
    "alarm",
    "event_alarm_removed",
    path="out-of-service",
    means="Hide it until it is returned to service. It is still detected and recorded.",
    body=AlarmOutOfServiceRequest,
    change=rules.remove_from_service,
    hides=True,
)
RETURN = AlarmAct(
    "return_alarm_to_service",
    Role.ENGINEER,
    "alarm",
    "event_alarm_returned",
    path="in-service",
    means="Annunciate it again.",
    body=AlarmReturnRequest,
    change=rules.return_to_service,
)
ALARM_ACTS = (ACKNOWLEDGE, SILENCE, RESET, SHELVE, UNSHELVE, REMOVE, RETURN)
"""The acts on one alarm; each has its routes."""

SILENCE_SOUNDING = Act("silence_sounding_alarms", Role.OPERATOR, "alarm", "event_alarms_silenced")
"""The act of silencing every alarm that sounds. If only one does, :data:`SILENCE` is recorded instead."""
ADD_OWN = Act("add_own_alarm", Role.ENGINEER, "alarm", "event_own_alarm_added")
CHANGE_OWN = Act("change_own_alarm", Role.ENGINEER, "alarm", "event_own_alarm_changed")
REMOVE_OWN = Act("remove_own_alarm", Role.ENGINEER, "alarm", "event_own_alarm_removed")
ACTS = (*ALARM_ACTS, SILENCE_SOUNDING, ADD_OWN, CHANGE_OWN, REMOVE_OWN)
