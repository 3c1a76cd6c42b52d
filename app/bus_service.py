"""All that belongs to one bus: made once for each ``[[bus]]``, so that another server could be its home.

What belongs to the site (people, configuration, the files of events and history) is passed in.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from app.audit.log import EventLog
from app.feed.bus_feed import TIMEOUT_TICKS, BusFeed
from app.feed.channel import Channel
from app.live.change_recorder import ChangeRecorder
from app.live.state.bus_live import BusLive
from app.pipeline import HistoryIntake, Pipeline


class BusService:
    """The live state of one bus, and all that its worker reports and is asked. ``monotonic`` times what is
    kept for a worker that may come back."""

    def __init__(
        self,
        live: BusLive,
        history: HistoryIntake,
        events: EventLog,
        *,
        monotonic: Callable[[], float] = time.monotonic,
        timeout_ticks: int = TIMEOUT_TICKS,
    ) -> None:
        self.live = live
        self.recorder = ChangeRecorder(events, live.settings.name)
        self.pipeline = Pipeline(live, history, self.recorder)
        self.channel = Channel()
        self.feed = BusFeed(self.channel, self.pipeline, monotonic=monotonic, timeout_ticks=timeout_ticks)
