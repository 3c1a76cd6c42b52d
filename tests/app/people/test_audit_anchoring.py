"""The anchor: the head of the log on a medium of the site, and the report while it is absent."""

from __future__ import annotations

import asyncio
import json
import os
import threading
from collections.abc import AsyncIterator
from contextlib import closing
from pathlib import Path
from typing import Any

import httpx
import pytest

from app.core.database import Database
from app.core.database.connection import open_for_reading
from app.core.messages import Languages
from app.core.web.access import Role
from app.core.web.formats import Formats
from app.main import create_app
from app.people.audit import anchor as module
from app.people.audit.anchor import (
    AnchorError,
    Anchoring,
    AnchorStatus,
    anchor_line,
    anchor_notice,
    append_line,
    newest_anchor,
    read_anchor_file,
    read_anchors,
)
from app.people.audit.entry import Head, KeyRing
from app.people.audit.log import EventLog, Filter
from app.people.audit.settings import Audit
from app.people.auth.accounts import Accounts
from bus.messages import Message
from tests.administrator import BY
from tests.app.complete_app import settings_in

RING = KeyRing((b"k" * 32,))


class Scene:
    """A log and its anchor."""

    def __init__(self, folder: Path) -> None:
        self.database = Database(folder / "lineside.db")
        self.events = EventLog(self.database)
        self.path = folder / "anchor"
        self.anchoring = self.started()

    def started(self) -> Anchoring:
        """The anchoring of a server that starts now."""
        return Anchoring(self.events, self.path, clock=lambda: 1_700_000_000.0)

    async def happen(self, times: int = 1) -> None:
        for _ in range(times):
            await self.events.record(kind="estop", what="e-stop")

    def lines(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in self.path.read_bytes().splitlines()]

    async def logged_events(self) -> list[tuple[str, str]]:
        """The events about the audit itself, oldest first."""
        found, _ = await self.events.page(Filter(kind="audit"), 100)
        return [(event["what"], event["message"]) for event in reversed(found)]

    async def attack(self, statement: str) -> None:
        def work(connection: Any) -> None:
            for (name,) in connection.execute(
                "SELECT name FROM sqlite_master WHERE type = 'trigger'"
            ).fetchall():
                connection.execute(f"DROP TRIGGER {name}")
            connection.execute(statement)

        await self.database.write(work)


@pytest.fixture
async def scene(tmp_path: Path) -> AsyncIterator[Scene]:
    made = Scene(tmp_path)
    yield made
    made.database.close()


async def test_the_head_is_added_when_it_changed(scene: Scene) -> None:
    await scene.happen(3)
    for _ in range(2):
        await scene.anchoring.export()
    await scene.happen()
    await scene.anchoring.export()
    assert [(line["id"], line["time"]) for line in scene.lines()] == [
        (3, "2023-11-14T22:13:20Z"),
        (4, "2023-11-14T22:13:20Z"),
    ]
    assert scene.path.stat().st_mode & 0o777 == 0o600
    anchors = read_anchors(scene.path.read_bytes().splitlines(), scene.events.keys.ring)
    assert (await scene.events.proof.verify(anchors.hashes)).anchored == 4


async def test_a_file_that_can_only_be_added_to_is_enough(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is opened for appending, never cut, never replaced."""
    flags: list[int] = []
    opening = os.open

    def watch(path: Any, wanted: int, *rest: Any) -> int:
        if path == scene.path:
            flags.append(wanted)
        return opening(path, wanted, *rest)

    monkeypatch.setattr(os, "open", watch)
    await scene.happen()
    await scene.anchoring.export()
    first = scene.path.stat().st_ino
    await scene.happen()
    await scene.anchoring.export()
    assert scene.path.stat().st_ino == first
    assert len(flags) == 2
    assert all(wanted & os.O_APPEND and not wanted & os.O_TRUNC for wanted in flags)


async def test_a_failed_export_is_reported_once_and_made_up_for(scene: Scene) -> None:
    await scene.happen()
    scene.path.mkdir()
    for _ in range(3):
        await scene.anchoring.export()
    assert str(scene.anchoring.status.unwritten) == "Is a directory"
    assert await scene.logged_events() == [("audit anchor not written", "Is a directory")]
    scene.path.rmdir()
    await scene.anchoring.export()
    assert scene.anchoring.status.unwritten is None
    assert (await scene.logged_events())[-1] == ("audit anchor written again", "")
    assert scene.lines()[-1]["id"] == 2


async def test_a_medium_that_hangs_holds_nothing_up(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    released = threading.Event()
    monkeypatch.setattr(module, "append_line", lambda *_: released.wait())
    await scene.happen()
    for _ in range(2):
        await asyncio.wait_for(scene.anchoring.export(within_s=0.01), 30)
    assert str(scene.anchoring.status.unwritten) == "it does not respond"
    released.set()
    monkeypatch.undo()
    while scene.anchoring.status.unwritten:
        await scene.anchoring.export()
    assert scene.lines()[-1]["id"] == 2


async def test_a_link_is_not_followed(scene: Scene, tmp_path: Path) -> None:
    scene.path.symlink_to(tmp_path / "elsewhere")
    await scene.happen()
    await scene.anchoring.export()
    assert str(scene.anchoring.status.unwritten) == "it is a link"
    assert not (tmp_path / "elsewhere").exists()


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE events SET what = 'nothing happened' WHERE id = 4",
        "DELETE FROM events WHERE id = 4",
        "UPDATE events_head SET id = 4, hash = (SELECT hash FROM events WHERE id = 4)",
    ],
)
async def test_a_log_that_was_altered_is_not_anchored(scene: Scene, statement: str) -> None:
    await scene.happen(2)
    await scene.anchoring.export()
    await scene.happen(3)
    await scene.attack(statement)
    for _ in range(2):
        await scene.anchoring.export()
    assert scene.anchoring.status.altered
    assert [line["id"] for line in scene.lines()] == [2]
    altered = [message for what, message in await scene.logged_events() if what == "audit log altered"]
    assert len(altered) == 1
    assert altered[0].endswith("; lineside audit verify names the entry")


async def test_a_server_that_starts_compares_the_log_with_its_anchor(scene: Scene) -> None:
    await scene.happen(5)
    await scene.anchoring.export()
    again = scene.started()
    await again.export()
    assert not again.status.altered
    await scene.attack("DELETE FROM events WHERE id = 5")
    again = scene.started()
    await again.export()
    assert str(again.status.altered) == "the log ends at entry 4, but 5 were written"


async def test_a_long_log_is_verified_without_blocking_the_event_loop(scene: Scene) -> None:
    """In chunks: between two of them others have their turn, and the store can be written."""
    turns = 0

    async def count() -> None:
        nonlocal turns
        while True:
            turns += 1
            await asyncio.sleep(0)

    await scene.happen(1)
    for _ in range(3):
        await scene.events.intend_together(
            [{"who": "a", "origin": "api", "bus": "b", "unit": 1, "what": "x"} for _ in range(700)]
        )
    counting = asyncio.create_task(count())
    verdict, _ = await asyncio.gather(scene.events.proof.verify(), scene.happen())
    counting.cancel()
    assert (verdict.broken, verdict.entries >= 2101) == (None, True)
    assert turns > 1


def test_lines_that_a_power_failure_cut_off_take_no_others_with_them(tmp_path: Path) -> None:
    path = tmp_path / "anchor"
    complete = anchor_line(Head(1, "a" * 64), 1.0, RING)
    path.write_bytes(complete + complete[:40])
    append_line(path, anchor_line(Head(2, "b" * 64), 2.0, RING))
    anchors = read_anchors(path.read_bytes().splitlines(), RING)
    assert anchors.hashes == {1: "a" * 64, 2: "b" * 64}
    assert (anchors.unreadable, anchors.forged) == (1, None)
    assert newest_anchor(path, RING) == Head(2, "b" * 64)


def test_a_line_made_without_the_key_is_named() -> None:
    good = anchor_line(Head(1, "a" * 64), 1.0, RING)
    for forged in (
        good.replace(b'"id":1', b'"id":2'),
        anchor_line(Head(2, "b" * 64), 2.0, KeyRing((b"s" * 32,))),
        anchor_line(Head(1, "b" * 64), 2.0, RING),
    ):
        assert read_anchors([good, forged], RING).forged == 2


def test_something_that_is_no_file_is_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fifo")
    with pytest.raises(AnchorError, match="it is not a file"):
        append_line(tmp_path / "fifo", b"x\n")


async def test_the_server_anchors_its_last_entry_when_it_ends(tmp_path: Path) -> None:
    settings = settings_in(tmp_path).model_copy(update={"audit": Audit(anchor=tmp_path / "anchor")})
    services = create_app(settings).state.services
    async with services.lifespan.running():
        ring = services[EventLog].keys.ring
    anchors = read_anchor_file(tmp_path / "anchor", ring)
    with closing(open_for_reading(settings.server.store)) as connection:
        what, last = connection.execute("SELECT what, id FROM events ORDER BY id DESC").fetchone()
    assert (what, last) == ("server stopped", max(anchors.hashes))


async def test_a_running_server_anchors_its_head_every_minute(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert module.EVERY_S == 60.0
    monkeypatch.setattr(module, "EVERY_S", 0.01)
    path = tmp_path / "anchor"
    settings = settings_in(tmp_path).model_copy(update={"audit": Audit(anchor=path)})
    services = create_app(settings).state.services
    async with services.lifespan.running(), asyncio.timeout(60):
        for _ in range(2):
            number = await services[EventLog].record(kind="estop", what="e-stop")
            ring = services[EventLog].keys.ring
            while not path.exists() or max(read_anchor_file(path, ring).hashes, default=0) < number:  # noqa: ASYNC110
                await asyncio.sleep(0.01)


async def test_audit_faults_are_on_the_page_and_in_the_metrics(tmp_path: Path) -> None:
    settings = settings_in(tmp_path).model_copy(update={"audit": Audit(anchor=tmp_path)})
    app = create_app(settings)
    services = app.state.services
    async with services.lifespan.running():
        await services[Anchoring].export()
        token = await services[Accounts].create_token("plc", Role.VIEWER, **BY)
        headers = {"Authorization": f"Bearer {token}"}
        transport = httpx.ASGITransport(app)
        async with httpx.AsyncClient(transport=transport, base_url="http://plant", headers=headers) as client:
            metrics = (await client.get("/metrics")).text
            page = (await client.get("/", headers={"Accept-Language": "de"})).text
    assert "lineside_audit_degraded 1.0" in metrics
    assert "ist das Audit-Protokoll nicht verankert. Ursache: Is a directory" in page


def test_an_altered_log_is_reported_before_all_else() -> None:
    language = Languages()["en"]
    formats = Formats(language.locale, "UTC")
    status = AnchorStatus(Message("anchor_is_link"), Message("anchor_no_file"), 1_700_000_000.0)
    assert "was altered" in str(anchor_notice(status, formats, 1_700_000_100.0))
    assert anchor_notice(AnchorStatus(), formats, 1_700_000_100.0) is None
