"""A changed configuration is an event with its changes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from app.main import create_app
from app.people.audit.feature import FILE, change_since_last, differences
from app.people.audit.log import EventLog
from app.people.audit.queries import Filter
from tests.app.complete_app import settings_in

LINE: dict[str, Any] = {
    "site": {"name": "Mill 7"},
    "bus": [
        {"name": "dry-end", "baud": 9600, "unit": [{"id": 1, "name": "Unwind"}, {"id": 2, "name": "Nip"}]}
    ],
}


def test_elements_go_by_their_id_or_name_not_by_their_place() -> None:
    other = {
        "site": {"name": "Mill 8"},
        "bus": [
            {"name": "dry-end", "baud": 4800, "unit": [{"id": 2, "name": "Nip"}, {"id": 3, "name": "Ü"}]}
        ],
    }
    assert differences(LINE, other) == [
        "bus.dry-end.baud: 9600 → 4800",
        "bus.dry-end.unit.1.id: 1 → nothing",
        'bus.dry-end.unit.1.name: "Unwind" → nothing',
        "bus.dry-end.unit.3.id: nothing → 3",
        'bus.dry-end.unit.3.name: nothing → "Ü"',
        'site.name: "Mill 7" → "Mill 8"',
    ]
    assert differences(LINE, LINE) == []


def test_the_first_time_nothing_changed(tmp_path: Path) -> None:
    assert change_since_last(tmp_path, LINE) == ""
    assert change_since_last(tmp_path, LINE) == ""
    (tmp_path / FILE).write_text("nonsense")
    assert change_since_last(tmp_path, LINE) == ""


async def test_a_new_store_is_one_event_without_its_steps(tmp_path: Path) -> None:
    found = []
    for _ in range(2):
        app = create_app(settings_in(tmp_path))
        async with app.state.services.lifespan.running():
            found, _ = await app.state.services[EventLog].page(Filter(kind="server"), 10)
    made = [event for event in found if event["messages"]["what"].code.startswith("event_store")]
    assert [event["what"] for event in made] == ["store created"]


async def test_the_server_notes_it_at_its_start(tmp_path: Path) -> None:
    for name in ("Mill 7", "Mill 7", "Mill 8"):
        app = create_app(settings_in(tmp_path, name=name))
        async with app.state.services.lifespan.running():
            found, _ = await app.state.services[EventLog].page(Filter(kind="configuration"), 10)
    assert [event["message"] for event in found] == ['site.name: "Mill 7" → "Mill 8"']
