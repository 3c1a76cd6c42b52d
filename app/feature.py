"""The registration of a feature, and the services that it is made from."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime
from zoneinfo import ZoneInfo

from fastapi import APIRouter

from app.core.lifespan import Lifespan
from app.core.web.services import Registry
from app.people.audit.acts import Act
from app.settings import Settings


class Services(Registry):
    """The services of a site, with a registry for each bus, and the lifespan that they run in.

    ``demo``: requests from this machine are signed in. ``worker_tokens``: by bus, the token with which the
    server's own worker opens /feed.
    """

    def __init__(self, settings: Settings, *, demo: bool, worker_tokens: Mapping[str, str]) -> None:
        super().__init__((settings,), {bus.name: () for bus in settings.bus})
        self.settings = settings
        self.demo = demo
        self.worker_tokens = worker_tokens
        self.lifespan = Lifespan()

    def local_time(self) -> datetime:
        """Return the present time in the zone of the site."""
        return datetime.now(ZoneInfo(self.settings.site.zone))


@dataclass(frozen=True, slots=True)
class Feature:
    """A part of the app that registers itself. ``make`` makes its services from those of earlier features,
    those of a bus in ``services.buses``, adds each, and adds their works to the lifespan of the server.
    ``acts`` are the acts of people in it, named in templates by ``may()``."""

    make: Callable[[Services], None]
    routers: tuple[APIRouter, ...] = ()
    acts: tuple[Act, ...] = ()
