"""Saved views of the trends page: of one person, or shared with all."""

from __future__ import annotations

from dataclasses import dataclass
from urllib.parse import parse_qsl, urlencode

from app.core.database import Database, StoreConnection
from app.core.database.connection import upsert
from app.core.web.access import Person, Role
from app.errors import Problem
from app.people.audit.acts import Act
from app.people.audit.log import EventLog
from bus.instants import unix_now
from bus.messages import Message

MAX_OF_PERSON = 50
MAX_SHARED = 200
MAX_OF_SITE = 10_000
MAX_NAME = 80
MAX_QUERY = 4000
_MEMBERS = frozenset({"s", "span", "from", "to", "preset", "scale", "marks", "compare"})
"""The parameters of a page's address that are saved; its cursors are not."""
_COLUMNS = "id, sender, owner, name, query, shared"


@dataclass(frozen=True, slots=True)
class TrendView:
    """``query``: address of the page, without its path. ``sender``: whose it is, ``owner``: their name."""

    id: int
    sender: str
    owner: str
    name: str
    query: str
    shared: bool


class TrendViews:
    """The table of saved views. A view saved again under its name replaces the earlier one."""

    def __init__(self, database: Database) -> None:
        self._database = database

    async def seen_by(self, person: Person) -> list[TrendView]:
        """Return the views of a person, then those that others share, by name. Raises StoreError."""

        def read(connection: StoreConnection) -> list[TrendView]:
            query = f"SELECT {_COLUMNS} FROM trend_view WHERE sender = ? OR shared = 1"
            return [_view(row) for row in connection.execute(query, (person.sender,))]

        found = await self._database.read(read)
        return sorted(found, key=lambda view: (view.sender != person.sender, view.name.casefold()))

    async def save(self, person: Person, events: EventLog, name: str, query: str, *, shared: bool) -> str:
        """Save a view, and return its address. Raises Problem 403 for one to share, 409 and 422."""
        if shared:
            SHARE.check(person)
        name, address = name.strip(), clean(query)
        if not 1 <= len(name) <= MAX_NAME:
            raise Problem(422, "invalid", Message.of("view_name_length", most=MAX_NAME))

        def write(connection: StoreConnection) -> None:
            _refuse_full(connection, person.sender, name, shared=shared)
            put = upsert("trend_view", ("sender", "name"), ("owner", "query", "shared", "saved_at"))
            values = (person.sender, name, person.name, address, int(shared), unix_now())
            connection.execute(put, values)

        if shared:
            await events.record(**SHARE.by(person, name=name), also=write)
        else:
            await self._database.write(write)
        return address

    async def delete(self, person: Person, events: EventLog, number: int) -> None:
        """Delete a view. Raises Problem 404, and 403 for the shared one of another person."""

        def find(connection: StoreConnection) -> TrendView | None:
            row = connection.execute(f"SELECT {_COLUMNS} FROM trend_view WHERE id = ?", (number,)).fetchone()
            return None if row is None else _view(row)

        def remove(connection: StoreConnection) -> None:
            connection.execute("DELETE FROM trend_view WHERE id = ?", (number,))

        view = await self._database.read(find)
        is_own = view is not None and view.sender == person.sender
        if view is None or not (is_own or view.shared):
            raise Problem(404, "not_found", Message("view_unknown"))
        if not is_own:
            DELETE_SHARED.check(person)
        if view.shared:
            await events.record(**DELETE_SHARED.by(person, name=view.name), also=remove)
        else:
            await self._database.write(remove)


def clean(query: str) -> str:
    """The members of an address of the page that are saved. Raises Problem 422 for none."""
    if len(query) <= MAX_QUERY:
        members = [(name, value) for name, value in parse_qsl(query) if name in _MEMBERS]
        address = urlencode(members)
        if members and len(address) <= MAX_QUERY:
            return address
    raise Problem(422, "invalid", Message("view_malformed"))


def _view(row: tuple[int, str, str, str, str, int]) -> TrendView:
    number, sender, owner, name, query, shared = row
    return TrendView(number, sender, owner, name, query, bool(shared))


def _refuse_full(connection: StoreConnection, sender: str, name: str, *, shared: bool) -> None:
    """Raises Problem 409 where one more would be too many."""

    def count(condition: str, *values: object) -> int:
        query = f"SELECT count(*) FROM trend_view WHERE NOT (sender = ? AND name = ?) AND {condition}"
        return int(connection.execute(query, (sender, name, *values)).fetchone()[0])

    if count("sender = ?", sender) >= MAX_OF_PERSON:
        raise Problem(409, "too_many", Message.of("views_of_person_full", n=MAX_OF_PERSON))
    if (shared and count("shared = 1") >= MAX_SHARED) or count("1 = 1") >= MAX_OF_SITE:
        raise Problem(409, "too_many", Message("views_of_site_full"))


SHARE = Act("share_view", Role.OPERATOR, "configuration", "event_view_shared")
DELETE_SHARED = Act("delete_shared_view", Role.ENGINEER, "configuration", "event_view_deleted")
"""Deletes the shared view of another person; everyone deletes their own."""
ACTS = (SHARE, DELETE_SHARED)
