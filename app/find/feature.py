"""Find anything: pages and actions here, and what later features add."""

from __future__ import annotations

from app.feature import Feature, Services
from app.find import pages
from app.find.finders import Finders, Link
from app.web.navigation import PAGES
from bus.messages import Message

ACTIONS = (
    Link(Message("find_set_units"), "/setpoints", "SetLine"),
    Link(Message("find_save_recipe"), "/recipes", "save_recipe"),
    Link(Message("find_save_set"), "/sets", "save_parameter_set"),
    Link(Message("find_write_note"), "/shifts/present", "write_shift_note"),
    Link(Message("find_add_alarm"), "/alarms/own", "add_own_alarm"),
    Link(Message("find_wallboard"), "/wallboard"),
    Link(Message("find_scan_bus"), "/bus#scan"),
    Link(Message("find_add_user"), "/users#add", "add_user"),
    Link(Message("find_change_password"), "/account"),
)


def make(services: Services) -> None:
    finders = services.add(Finders())
    finders.add_links("find_pages", [Link(page.label, page.href, page.act) for page in PAGES])
    finders.add_links("find_actions", ACTIONS)


FEATURE = Feature(make, (pages.router,))
