"""What the metrics are taken from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from app.audit.anchoring import AnchorStatus
from app.live.browsers.hub import Hub
from app.live.state.bus_live import LiveState
from app.metrics.counts import Counts


@dataclass(frozen=True, slots=True)
class MetricSources:
    """``anchor``: how well the audit log is anchored now."""

    live: LiveState
    hub: Hub
    counts: Counts
    anchor: Callable[[], AnchorStatus]
