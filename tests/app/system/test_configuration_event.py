"""A changed configuration is an event with its changes."""

from __future__ import annotations

from pathlib import Path

from app.main import create_app
from app.people.audit.log import EventLog, Filter
from app.settings import load
from tests.app.complete_app import settings_in


async def test_a_new_store_is_one_event_without_its_steps(tmp_path: Path) -> None:
    found = []
    for _ in range(2):
        app = create_app(settings_in(tmp_path))
        async with app.state.services.lifespan.running():
            found, _ = await app.state.services[EventLog].page(Filter(kind="server"), 10)
    made = [event for event in found if event["messages"]["what"].code.startswith("event_store")]
    assert [event["what"] for event in made] == ["store created"]


async def test_a_file_changed_while_the_server_was_off_is_an_event_with_its_lines(tmp_path: Path) -> None:
    file = tmp_path / "lineside.toml"
    for name in ("Mill 7", "Mill 7", "Mill 8"):
        file.write_text(f'[site]\nname = "{name}"\n')
        app = create_app(load(file))
        async with app.state.services.lifespan.running():
            found, _ = await app.state.services[EventLog].page(Filter(kind="configuration"), 10)
    assert [event["message"] for event in found] == ['- name = "Mill 7"; + name = "Mill 8"']
