"""``POST /api/v1/alarms/simulate``: what an alarm would have done."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter
from pydantic import AwareDatetime, ConfigDict, Field

from app.alarms.performance_api import month_at_most
from app.alarms.settings import OwnValue
from app.alarms.simulation.outcome import AlarmSimulation
from app.alarms.simulation.proposal import proposed
from app.alarms.simulation.simulator import Simulator
from app.conditions.priority import AlarmPriority
from app.history.api.spans import HistoryOf
from app.web.access import Engineer
from app.web.api_route import ApiRoute
from app.web.services import service
from app.web.shape import StrictBody

router = APIRouter(prefix="/api/v1/alarms", tags=["alarms"], route_class=ApiRoute)

SimulatorOf = Annotated[Simulator, service(Simulator)]
WrittenLimit = Annotated[str | int | float, Field(description='As the unit displays it: "80.0" or 80.')]
WrittenDelay = Annotated[float | int, Field(description="Seconds, up to a day.")]


class WrittenAlarmBody(StrictBody):
    """An alarm as ``[[alarm]]`` of lineside.toml has it."""

    model_config = ConfigDict(str_strip_whitespace=True)

    bus: Annotated[str, Field(max_length=80)]
    unit: Annotated[int, Field(description="Address of the unit (#17), 1 to 255.")]
    value: OwnValue
    above: WrittenLimit | None = None
    below: WrittenLimit | None = None
    deadband: WrittenLimit = 0
    change_per_s: WrittenLimit | None = None
    state: Annotated[str | None, Field(description="on or off, for an input or an output.")] = None
    on_delay_s: WrittenDelay = 0
    off_delay_s: WrittenDelay = 0
    priority: AlarmPriority = "medium"
    latch: bool = False

    def written(self) -> dict[str, Any]:
        """The keys of ``[[alarm]]`` that were given."""
        beside = {"since", "until", "version", "reason"}
        return self.model_dump(exclude_unset=True, exclude_none=True, exclude=beside)


class AlarmSimulationRequest(WrittenAlarmBody):
    """An alarm as ``[[alarm]]`` of lineside.toml has it, and a span; the last week by default."""

    model_config = ConfigDict(populate_by_name=True)

    name: Annotated[str, Field(max_length=200)] = "Proposed"
    since: Annotated[AwareDatetime | None, Field(alias="from", strict=False)] = None
    until: Annotated[AwareDatetime | None, Field(alias="to", strict=False)] = None


@router.post("/simulate")
async def simulate_alarm(
    person: Engineer, simulator: SimulatorOf, history: HistoryOf, body: AlarmSimulationRequest
) -> AlarmSimulation:
    """What an alarm of the site would have done over stored history. Nothing is changed."""
    buses = list(history.buses.values())
    settings = proposed({"name": body.name, **body.written()}, buses)
    span = month_at_most(body.since, body.until)
    return await simulator.run(history.buses[settings.bus], settings, *span, person.account)
