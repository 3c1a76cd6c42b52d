"""Signing a shift over, as page and API, by those who may and may not, in one process. 0.3 s a test."""

from __future__ import annotations

import asyncio
import hashlib
import sqlite3
from collections.abc import AsyncIterator
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest
from click.testing import CliRunner

from app.cli import cli
from app.core.database import Database, StoreConnection
from app.core.database.migration import MIGRATIONS
from app.core.web.access import Person, Role
from app.errors import Problem
from app.people.audit.log import EventLog
from app.records.handover.service import Handover, ShiftSignRequest, Signing
from app.records.handover.sheet import write_sheet
from app.records.handover.signatures import missing_signatures
from bus.instants import UnixTime
from tests.app.complete_app import PASSWORD, House, complete_app
from tests.app.played_line import BUS, played_line
from tests.for_each import for_each

API = "/api/v1/shifts"


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    async with complete_app(tmp_path, time_zone="Europe/Berlin") as house:
        await played_line(house.services)
        yield house


async def last(client: httpx.AsyncClient) -> str:
    """The shift that ended last."""
    start: str = (await client.get(API)).json()["shifts"][1]["start"]
    return start


async def sheet(client: httpx.AsyncClient) -> dict[str, Any]:
    found: dict[str, Any] = (await client.get(f"{API}/{await last(client)}")).json()
    return found


async def sign(client: httpx.AsyncClient, **body: Any) -> httpx.Response:
    return await client.post(f"{API}/{await last(client)}/sign", json=body)


async def note(client: httpx.AsyncClient, text: str) -> httpx.Response:
    start = await last(client)
    return await client.post(f"{API}/{start}/notes", json={"text": text, "time": start})


def code(response: httpx.Response) -> tuple[int, str]:
    return response.status_code, response.json()["code"]


async def test_two_people_sign_one_after_the_other_and_the_audit_log_names_the_sheet(house: House) -> None:
    ann, bob = await house.signed_in(Role.OPERATOR, "ann"), await house.signed_in(Role.OPERATOR, "bob")
    await note(ann, "Felt changed")
    assert code(await sign(bob, part="coming")) == (409, "not_signed")
    over = await sign(ann, part="leaving")
    assert (over.status_code, over.json()["leaving"]["who"], over.json()["coming"]) == (200, "ann", None)
    assert code(await sign(ann, part="coming")) == (409, "same_person")
    wrong = await sign(bob, part="coming", digest="0" * 64)
    assert code(wrong) == (409, "superseded")
    taken = (await sign(bob, part="coming", digest=over.json()["digest"])).json()
    assert (taken["coming"]["who"], taken["altered"]) == ("bob", False)
    exact = await bob.get(f"{API}/{await last(bob)}/sheet.json")
    assert hashlib.sha256(exact.content).hexdigest() == taken["digest"]
    newest, first, *_ = await house.events("shift")
    assert (newest["who"], first["who"]) == ("bob", "ann")
    assert all(taken["digest"] in event["what"] for event in (newest, first))
    assert (await house.services[EventLog].proof.verify()).broken is None


async def test_a_second_signing_is_refused_with_who_signed_and_when(house: House) -> None:
    ann, bob = await house.signed_in(Role.OPERATOR, "ann"), await house.signed_in(Role.OPERATOR, "bob")
    signed = (await sign(ann, part="leaving")).json()["leaving"]
    for client in (ann, bob):
        refused = await sign(client, part="leaving")
        assert code(refused) == (409, "already_signed")
        assert (refused.json()["who"], refused.json()["time"]) == ("ann", signed["at"])
        assert refused.json()["detail"].startswith("ann signed as the leaving person on ")
    assert len(await house.events("shift")) == 1


async def test_of_two_who_sign_at_once_one_wins_and_the_other_reads_who(house: House) -> None:
    people = [await house.signed_in(Role.OPERATOR, name) for name in ("ann", "bob", "cid", "dan")]
    results = await asyncio.gather(*(sign(each, part="leaving") for each in people))
    (won,) = [each for each in results if each.status_code == 200]
    lost = [each for each in results if each.status_code != 200]
    assert {code(each) for each in lost} == {(409, "already_signed")}
    assert {each.json()["who"] for each in lost} == {won.json()["leaving"]["who"]}
    assert len(await house.events("shift")) == 1


async def test_a_signed_sheet_does_not_change_with_what_it_was_made_from(house: House) -> None:
    ann = await house.signed_in(Role.OPERATOR, "ann")
    await note(ann, "Felt changed")
    await sign(ann)
    before = await sheet(ann)
    late = (await note(ann, "Wire, not felt")).json()
    await house.services[EventLog].record(
        kind="limits", what="limits", bus=BUS, at=UnixTime(house.services[Handover].present().start - 60.0)
    )
    after = await sheet(ann)
    assert [each["text"] for each in after["later_notes"]] == ["Wire, not felt"]
    assert {**after, "later_notes": []} == before
    page = (await ann.get(f"/shifts/{await last(ann)}")).text
    assert "Notes since the signature" in page
    corrected = await ann.post(
        f"{API}/{await last(ann)}/notes", json={"text": "Roll", "corrects": late["id"]}
    )
    assert corrected.status_code == 201


async def test_a_sheet_that_an_earlier_version_signed_states_nothing_of_suppressed_alarms(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    ann = await house.signed_in(Role.OPERATOR, "ann")

    def as_before(*given: Any) -> dict[str, Any]:
        return {name: value for name, value in write_sheet(*given).items() if name != "suppressed"}

    monkeypatch.setattr("app.records.handover.service.write_sheet", as_before)
    await sign(ann)
    monkeypatch.undo()
    found = await sheet(ann)
    assert "suppressed" not in found
    assert found["signed"]["altered"] is False
    page = await ann.get(f"/shifts/{await last(ann)}")
    assert page.status_code == 200
    assert 'id="shelved"' in page.text
    assert 'id="suppressed"' not in page.text
    assert (await ann.get(f"{API}/{await last(ann)}/sheet.html")).status_code == 200


async def test_another_person_signs_at_a_panel_with_name_and_password(house: House) -> None:
    ann, program = await house.signed_in(Role.OPERATOR, "ann"), await house.program(Role.OPERATOR)
    await house.add("bob", Role.ENGINEER)
    await house.add("vic", Role.VIEWER)
    assert code(await sign(program)) == (403, "forbidden")
    assert code(await sign(program, name="ann", password="not it")) == (401, "unauthorized")
    assert code(await sign(program, name="ann")) == (401, "unauthorized")
    assert code(await sign(program, name="vic", password=PASSWORD)) == (403, "forbidden")
    assert (await sheet(ann))["signed"] is None
    assert (await sign(program, name="ann", password=PASSWORD)).json()["leaving"]["who"] == "ann"
    assert code(await sign(ann)) == (409, "same_person")
    form = {"part": "coming", "name": "bob", "password": PASSWORD}
    done = await ann.post(f"/shifts/{await last(ann)}/sign", data=form)
    assert done.status_code == 303
    assert (await sheet(ann))["signed"]["coming"]["who"] == "bob"
    assert "the-viewer" not in str(await house.events("shift"))


async def test_who_may_not_sign_signs_nothing(house: House) -> None:
    viewer, operator = await house.signed_in(Role.VIEWER), await house.signed_in(Role.OPERATOR)
    assert (await sign(viewer)).status_code == 403
    foreign = {"Origin": "https://evil.example"}
    start = await last(operator)
    assert (await operator.post(f"{API}/{start}/sign", headers=foreign)).status_code == 403
    present = (await operator.get(API)).json()["shifts"][0]["start"]
    early = await operator.post(f"{API}/{present}/sign", json={"at": "2020-01-01T00:00:00Z"})
    assert early.status_code == 422
    assert (await sign(operator, part="both")).status_code == 422
    assert (await sheet(operator))["signed"] is None


@for_each("role", [Role.VIEWER, Role.WORKER])
async def test_a_caller_without_a_route_needs_the_role_too(house: House, role: Role) -> None:
    ann = await house.signed_in(Role.OPERATOR, "ann")
    shift = await house.services[Handover].shift_of(datetime.fromisoformat(await last(ann)))
    for request in (ShiftSignRequest(), ShiftSignRequest(name="ann", password=PASSWORD)):
        with pytest.raises(Problem, match="role operator") as refused:
            await house.services[Signing].sign(Person("vic", role, "session"), "192.0.2.7", shift, request)
        assert (refused.value.status, refused.value.code) == (403, "forbidden")
    assert (await sheet(ann))["signed"] is None
    assert await house.events("shift") == []


async def test_a_shift_is_signed_from_half_an_hour_before_its_end_on(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    operator = await house.signed_in(Role.OPERATOR)
    shift, services = house.services[Handover].present(), house.services
    path = f"{API}/{(await operator.get(API)).json()['shifts'][0]['start']}"
    for seconds, status in ((-1801.0, 409), (-1799.0, 200)):
        for each in (services[Handover], services[Signing]):
            monkeypatch.setattr(each, "_clock", lambda seconds=seconds: UnixTime(shift.end + seconds))
        assert (await operator.post(f"{path}/sign")).status_code == status
    found = (await operator.get(path)).json()
    assert found["until"] < found["end"]
    assert found["until"] == found["made_at"]


async def test_a_sheet_that_was_altered_in_the_store_is_reported_and_not_signed(
    house: House, tmp_path: Path
) -> None:
    ann, bob = await house.signed_in(Role.OPERATOR, "ann"), await house.signed_in(Role.OPERATOR, "bob")
    await note(ann, "Felt changed")
    await sign(ann)
    with sqlite3.connect(tmp_path / "data" / "lineside.db") as store:
        with pytest.raises(sqlite3.IntegrityError):
            store.execute("UPDATE shift_sheet SET sheet = x'7b7d'")
        with pytest.raises(sqlite3.IntegrityError):
            store.execute("DELETE FROM shift_signature")
        store.execute("DROP TRIGGER shift_sheet_stays_as_signed")
        altered = (await ann.get(f"{API}/{await last(ann)}/sheet.json")).content.replace(b"Felt", b"Wire")
        store.execute("UPDATE shift_sheet SET sheet = ?", (altered,))
    assert (await sheet(ann))["signed"]["altered"] is True
    assert code(await sign(bob)) == (409, "not_in_state")
    assert "Do not rely on it" in (await bob.get(f"/shifts/{await last(bob)}")).text


@pytest.mark.parametrize("lost", ["both", "coming", "sheet"])
async def test_signatures_that_are_gone_from_the_store_are_found_by_the_log(
    house: House, tmp_path: Path, lost: str
) -> None:
    ann, bob = await house.signed_in(Role.OPERATOR, "ann"), await house.signed_in(Role.OPERATOR, "bob")
    await sign(ann)
    await sign(bob)
    assert (await sheet(ann))["missing_signatures"] == []
    (tmp_path / "data.toml").write_text('[server]\ndata = "data"\n')
    verify = ["audit", "verify", "--config", str(tmp_path / "data.toml")]
    assert (await asyncio.to_thread(CliRunner().invoke, cli, verify)).exit_code == 0
    which = "WHERE part = 'coming'" if lost == "coming" else ""

    def lose(store: StoreConnection) -> None:
        store.execute("DROP TRIGGER shift_signature_stays")
        store.execute("DROP TRIGGER shift_sheet_stays")
        store.execute(f"DELETE FROM shift_signature {which}")
        if lost == "sheet":
            store.execute("DELETE FROM shift_sheet")

    await house.services[Database].write(lose)
    names = ["bob"] if lost == "coming" else ["ann", "bob"]
    found = await sheet(ann)
    assert [each["who"] for each in found["missing_signatures"]] == names
    for client in (ann, bob):
        refused = await sign(client)
        assert code(refused) == (409, "not_in_state")
        assert ", ".join(names) in refused.json()["detail"]
    page = (await ann.get(f"/shifts/{await last(ann)}")).text
    assert "signatures of this shift that are gone from the store" in page
    assert "Not signed." not in page
    assert "gone from the store" in (await ann.get(f"{API}/{await last(ann)}/sheet.html")).text
    done = await asyncio.to_thread(CliRunner().invoke, cli, verify)
    assert done.exit_code == 1
    assert f"states that {names[0]} signed the shift of " in done.stderr


def test_a_store_of_an_earlier_version_lacks_no_signature() -> None:
    with sqlite3.connect(":memory:") as store:
        store.row_factory = sqlite3.Row
        for step in ("0002_events.sql", "0031_audit_seals.sql"):
            store.executescript((MIGRATIONS / step).read_text())
        assert missing_signatures(store) == []
        store.executescript((MIGRATIONS / "0050_event_messages.sql").read_text())
        assert missing_signatures(store) == []


async def test_the_file_needs_no_server_and_is_no_page_of_it(house: House) -> None:
    ann = await house.signed_in(Role.OPERATOR, "ann")
    await note(ann, "<script>alert(1)</script>")
    path = f"{API}/{await last(ann)}/sheet.html"
    assert "Not signed" in (await ann.get(path)).text
    assert (await ann.get(path.replace("html", "json"))).status_code == 409
    await sign(ann)
    file = await ann.get(path)
    assert "&lt;script&gt;alert(1)" in file.text
    assert "<script" not in file.text
    assert not [each for each in (" src=", " href=", "url(", "@import") if each in file.text]
    assert "sandbox" in file.headers["content-security-policy"]
    assert file.headers["content-disposition"].startswith('attachment; filename="shift-')
    assert file.headers["x-content-type-options"] == "nosniff"
    assert "<b>ann</b>" in file.text


@for_each("hour", [3, 10, 15, 23])
async def test_a_signed_shift_keeps_its_times_when_others_are_configured(
    house: House, monkeypatch: pytest.MonkeyPatch, hour: int
) -> None:
    """Also one that began within the shift that is the present one by the new times."""
    yesterday = datetime.now(house.services[Handover].zone) - timedelta(days=1)
    at = UnixTime(yesterday.replace(hour=hour, minute=30).timestamp())
    monkeypatch.setattr(house.services[Handover], "_clock", lambda: at)
    ann = await house.signed_in(Role.OPERATOR, "ann")
    start = await last(ann)
    await sign(ann)
    monkeypatch.setattr(house.services[Handover], "_starts", [1])
    listed = (await ann.get(API)).json()["shifts"]
    (signed,) = [each for each in listed if each["leaving"]]
    assert signed["start"] == start
    assert (await ann.get(f"{API}/{start}")).json()["signed"]["leaving"]["who"] == "ann"


async def test_the_page_signs_for_the_user_of_the_session_in_both_languages(house: House) -> None:
    ann, bob = await house.signed_in(Role.OPERATOR, "ann"), await house.signed_in(Role.OPERATOR, "bob")
    path = f"/shifts/{await last(ann)}"
    assert "Hand over shift: ann" in (await ann.get(path)).text
    assert (await ann.post(f"{path}/sign", data={"part": "leaving"})).status_code == 303
    bob.headers["Accept-Language"] = "de"
    assert "Schicht übernehmen: bob" in (await bob.get(path)).text
    refused = await bob.post(f"{path}/sign", data={"part": "leaving"})
    assert refused.status_code == 409
    assert "ann hat am" in refused.text
    digest = (await sheet(bob))["signed"]["digest"]
    assert (await bob.post(f"{path}/sign", data={"part": "coming", "digest": digest})).status_code == 303
    text = (await bob.get(path)).text
    assert "Schicht übernehmen" not in text
    assert digest in text
    assert "bob" in (await bob.get("/shifts")).text


async def test_a_shift_is_handed_over_early_only_with_a_reason(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    operator = await house.signed_in(Role.OPERATOR)
    present = (await operator.get(API)).json()["shifts"][0]["start"]
    begun = UnixTime(datetime.fromisoformat(present).timestamp() + 60)
    monkeypatch.setattr(house.services[Signing], "_clock", lambda: begun)
    refused = await operator.post(f"{API}/{present}/sign", json={"reason": " "})
    assert code(refused) == (409, "not_in_state")
    assert "earlier only with a reason" in (await operator.get(f"/shifts/{present}")).text
    assert (await operator.post(f"{API}/{present}/sign", json={"reason": "Ill"})).status_code == 200
    (event,) = await house.events("shift")
    assert event["message"] == "Ill"
    assert "Reason: Ill" in (await operator.get(f"/shifts/{present}")).text
