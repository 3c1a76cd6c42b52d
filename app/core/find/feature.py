"""Find anything: pages and actions here, and what later features add."""

from __future__ import annotations

from app.core.find import pages
from app.core.find.finders import Finders, FixedPlace
from app.core.web.rendering.navigation import PAGES
from app.feature import Feature, Services
from bus.messages import Message

ACTIONS = (
    FixedPlace(Message("find_set_units"), "/setpoints", "SetLine"),
    FixedPlace(Message("find_save_recipe"), "/recipes", "save_recipe"),
    FixedPlace(Message("find_save_set"), "/sets", "save_parameter_set"),
    FixedPlace(Message("find_write_note"), "/shifts/present", "write_shift_note"),
    FixedPlace(Message("find_add_alarm"), "/alarms/own", "add_own_alarm"),
    FixedPlace(Message("find_wallboard"), "/wallboard"),
    FixedPlace(Message("find_scan_bus"), "/bus#scan"),
    FixedPlace(Message("find_add_user"), "/users#add", "add_user"),
    FixedPlace(Message("find_change_password"), "/account"),
)


def make(services: Services) -> None:
    finders = services.add(Finders())
    finders.add_links("find_pages", [FixedPlace(page.label, page.href, page.act) for page in PAGES])
    finders.add_links("find_actions", ACTIONS)


FEATURE = Feature(make, (pages.router,))
