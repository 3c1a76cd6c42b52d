"""The pages of the configuration: a change is reviewed, written, and found among the versions."""

from __future__ import annotations

import re
from html import unescape
from pathlib import Path

import httpx
import pytest

import app.system.configuration.service as service_module
from app.core.web.access import Role
from app.system.configuration.service import ConfigurationFile
from tests.app.complete_app import House, complete_app
from tests.app.configuration_file import (
    TEXT,
    UNIT,
    PlantFile,
    fields_of,
    form_of,
    house_with_file,
    plant_file,
)
from tests.for_each import for_each

house = pytest.fixture(house_with_file)
file = pytest.fixture(plant_file)


@pytest.fixture
async def engineer(house: House) -> httpx.AsyncClient:
    return await house.signed_in(Role.ENGINEER)


async def test_a_unit_is_renamed_after_a_review(engineer: httpx.AsyncClient, file: PlantFile) -> None:
    review = await engineer.post(UNIT, data=await form_of(engineer, name="Unwinder"))
    assert review.status_code == 200
    assert "\u2212 <del>name = &#34;Unwind&#34;" in review.text
    assert '+ <ins>name = "Unwinder"   # as people call it</ins>' in unescape(review.text)
    assert file.text == TEXT
    confirmed = {**fields_of(review.text), "reason_of_change": "as on the drawing"}
    done = await engineer.post(UNIT, data=confirmed)
    assert (done.status_code, done.headers["location"]) == (303, "/configuration")
    assert file.text == TEXT.replace('"Unwind" ', '"Unwinder" ')
    page = (await engineer.get(done.headers["location"])).text
    row = page[page.index("dry-end · 1 · Unwinder") :]
    assert "Version 2 is written. It takes effect at the next start of the server." in row[:1000]
    assert "The server runs with an older configuration than the file." in page
    assert "as on the drawing" in page
    waiting = page[page.index("Waiting for the next start") :]
    assert "<del>name = &#34;Unwind&#34;" in waiting
    assert "sudo systemctl restart lineside" in waiting
    file.path.write_text(f"# By hand.\n{TEXT}")
    assert "Waiting for the next start" not in (await engineer.get("/configuration")).text
    assert "the-engineer" in page


async def test_a_review_leads_back_to_what_was_typed_and_a_move_drops_none_of_it(
    engineer: httpx.AsyncClient, file: PlantFile
) -> None:
    review = await engineer.post(UNIT, data=await form_of(engineer, name="Unwinder"))
    again = await engineer.post(UNIT, data={**fields_of(review.text), "again": "true"})
    assert (again.status_code, 'value="Unwinder"' in again.text) == (200, True)
    assert "Write the file" not in again.text
    second = UNIT.replace("unit.0", "unit.1")
    moved = await engineer.post(second, data=await form_of(engineer, second, act="up", name="Nip 2"))
    assert (moved.status_code, 'value="Nip 2"' in moved.text) == (422, True)
    assert "is not part of a move" in moved.text
    assert file.text == TEXT


async def test_a_fault_is_at_its_field_and_what_was_typed_stays(
    engineer: httpx.AsyncClient, file: PlantFile
) -> None:
    same = await engineer.post(UNIT, data=await form_of(engineer))
    assert (same.status_code, "Nothing differs from the file." in same.text) == (422, True)
    typed = await form_of(engineer, name="x" * 61, group="Calender", confirmed="true")
    page = await engineer.post(UNIT, data=typed)
    assert page.status_code == 422
    field = page.text[page.text.index('id="field-name"') :]
    assert 'aria-invalid="true"' in field[:400]
    assert "at most 60 characters" in field[:800]
    assert 'value="Calender"' in page.text
    assert file.text == TEXT


async def test_the_limits_of_a_draw_have_a_field_each_with_the_comma_of_the_reader(
    engineer: httpx.AsyncClient,
) -> None:
    path, german = "/configuration/tables/bus.0.unit.1", {"Accept-Language": "de"}
    typed = await form_of(engineer, path)
    both = {**typed, "draw_percent": ["-1,5", "2,5"]}
    review = unescape((await engineer.post(path, data=both, headers=german)).text)
    assert "<ins>draw_percent = [-1.5, 2.5]</ins>" in review
    assert "<ins>draw_percent = [-1.5, 2.5]</ins>" in (await engineer.post(path, data=both)).text
    one = await engineer.post(path, data={**typed, "draw_percent": ["-1,5", ""]}, headers=german)
    shown = re.findall(r'name="draw_percent"[^>]*value="([^"]*)"', one.text)
    assert (one.status_code, shown) == (422, ["-1,5", ""])


async def test_a_table_is_changed_in_the_drawer_of_the_list(house: House, file: PlantFile) -> None:
    admin = await house.signed_in(Role.ADMIN)
    path, drawer = "/configuration/tables/notify", {"HX-Request": "true"}
    shown = (await admin.get(f"{path}?field=flood", headers=drawer)).text
    assert "<html" not in shown
    assert shown.index("autofocus") > shown.index('id="field-flood"')
    fields = {**fields_of(shown), "act": "change"}
    refused = await admin.post(path, data={**fields, "flood": "0"}, headers=drawer)
    assert refused.status_code == 422
    assert "it must be at least 1" in refused.text
    review = await admin.post(path, data={**fields, "flood": "20"}, headers=drawer)
    assert "<html" not in review.text
    done = await admin.post(path, data=fields_of(review.text), headers=drawer)
    assert done.headers["hx-redirect"] == "/configuration"
    assert "flood = 20" in file.text


async def test_a_file_changed_by_hand_is_shown_with_what_was_typed(
    engineer: httpx.AsyncClient, file: PlantFile
) -> None:
    typed = await form_of(engineer, name="Unwinder", confirmed="true")
    by_hand = TEXT.replace("id = 1 ", 'group = "Dry"\nid = 1 ')
    file.write(by_hand)
    page = await engineer.post(UNIT, data=typed)
    assert page.status_code == 409
    assert "was changed since you began. Nothing was written." in page.text
    assert '+ <ins>group = "Dry"' in unescape(page.text)
    kept = fields_of(page.text)
    assert (kept["name"], kept["group"]) == ("Unwinder", "Dry")
    assert file.text == by_hand
    await engineer.post(UNIT, data={**kept, "act": "change", "confirmed": "true"})
    assert file.text == by_hand.replace('"Unwind" ', '"Unwinder" ')


async def test_a_unit_that_was_moved_or_removed_by_hand_is_followed(
    engineer: httpx.AsyncClient, file: PlantFile
) -> None:
    typed = await form_of(engineer, name="Unwinder")
    first = TEXT[TEXT.index("[[bus.unit]]") : TEXT.index("# Of the nip")]
    file.write(TEXT.replace(first, "").replace("[[notify", f"{first}[[notify"))
    page = await engineer.post(UNIT, data=typed)
    assert page.status_code == 409
    assert 'action="/configuration/tables/bus.0.unit.1"' in page.text
    assert 'value="Unwinder"' in page.text
    file.write(TEXT.replace(first, ""))
    page = await engineer.post(UNIT, data=typed)
    assert page.status_code == 409
    assert "<dd>Unwinder</dd>" in page.text


async def test_a_unit_moves_up(engineer: httpx.AsyncClient, file: PlantFile) -> None:
    second = "/configuration/tables/bus.0.unit.1"
    typed = {**await form_of(engineer, second), "act": "up", "confirmed": "true"}
    assert (await engineer.post(second, data=typed)).status_code == 303
    text = file.text
    assert text.index("# Of the nip.\n[[bus.unit]]\nid = 2") < text.index("[[bus.unit]]\nid = 1 ")


async def test_an_alarm_is_added_changed_and_removed(engineer: httpx.AsyncClient, file: PlantFile) -> None:
    path = "/configuration/tables/alarm.0"
    typed = {"name": "Slow", "bus": "dry-end", "unit": "1", "value": "actual", "below": "80.5"}
    added = await form_of(engineer, path, **typed, confirmed="true")
    assert (await engineer.post(path, data=added)).status_code == 303
    assert file.text == (
        f'{TEXT}\n[[alarm]]\nname = "Slow"\nbus = "dry-end"\nunit = 1\nvalue = "actual"\nbelow = 80.5\n'
    )
    changed = await form_of(engineer, path, priority="high", latch="true", confirmed="true", value="actual")
    await engineer.post(path, data=changed)
    assert 'below = 80.5\npriority = "high"\nlatch = true\n' in file.text
    assert "dry-end · 1 · Slow" in (await engineer.get("/configuration")).text
    removed = {**await form_of(engineer, path), "act": "remove", "confirmed": "true"}
    await engineer.post(path, data=removed)
    assert file.text == f"{TEXT}\n"


async def test_people_on_duty(engineer: httpx.AsyncClient, house: House, file: PlantFile) -> None:
    admin = await house.signed_in(Role.ADMIN)
    smtp, group = "/configuration/tables/notify.smtp", "/configuration/tables/notify.group.0"
    server = {"host": "mail.plant.example", "sender": "lineside@plant.example", "confirmed": "true"}
    assert (await admin.post(smtp, data=await form_of(admin, smtp, **server))).status_code == 303
    people = await form_of(engineer, group, name="night", to="a@plant.example, b@plant.example")
    await engineer.post(group, data={**people, "confirmed": "true"})
    duty = f"{group}.duty.0"
    roster = await form_of(engineer, duty, starts="22:00", ends="06:00", to="c@plant.example")
    done = await engineer.post(duty, data={**roster, "days": ["mon", "tue"], "confirmed": "true"})
    assert done.status_code == 303
    assert file.text.endswith(
        '[[notify.group]]\nname = "night"\nto = ["a@plant.example", "b@plant.example"]\n\n'
        '[[notify.group.duty]]\ndays = ["mon", "tue"]\nstarts = "22:00"\nends = "06:00"\n'
        'to = ["c@plant.example"]\n'
    )


async def test_a_version_is_compared_and_rolled_back(house: House, file: PlantFile) -> None:
    admin = await house.signed_in(Role.ADMIN)
    await admin.post(UNIT, data=await form_of(admin, name="Unwinder", confirmed="true"))
    engineer, shown = await house.signed_in(Role.ENGINEER), "/configuration/versions/1"
    assert "roll-back" not in (await engineer.get(shown)).text
    version = await admin.get(shown)
    assert '+ <ins>name = "Unwinder"' in unescape(version.text)
    back = "/configuration/versions/1/roll-back"
    review = await admin.post(back, data=fields_of(version.text))
    assert '+ <ins>name = "Unwind" ' in unescape(review.text)
    done = await admin.post(back, data={**fields_of(review.text), "reason_of_change": "wrong unit"})
    assert done.headers["location"] == "/configuration"
    assert file.text == TEXT
    assert "rolled back" in (await admin.get("/configuration")).text


async def test_a_secret_is_on_no_page(house: House, file: PlantFile) -> None:
    admin = await house.signed_in(Role.ADMIN)
    await admin.get("/configuration")
    file.write(TEXT.replace("s3cret", "0ther"))
    for path in ("/configuration", "/configuration/versions/1", "/configuration/versions/2"):
        page = (await admin.get(path)).text
        assert "s3cret" not in page
        assert "0ther" not in page
    assert "+ <ins>url = ***" in (await admin.get("/configuration/versions/1")).text


async def test_a_file_that_cannot_be_written_is_offered_as_a_text(
    house: House, engineer: httpx.AsyncClient, file: PlantFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(service_module.os, "access", lambda *_: False)
    assert "The server cannot write the file." in (await engineer.get("/configuration")).text
    page = (await engineer.post(UNIT, data=await form_of(engineer, name="Unwinder", confirmed=""))).text
    owner = house.services[ConfigurationFile].owner
    assert f"cannot write {file.path}. Its owner, {owner}, can replace the file" in page
    assert "Write the file" not in page
    assert 'name = "Unwinder"   # as people call it' in unescape(page)
    assert "s3cret" not in page
    assert "hold secrets" in page


async def test_a_broken_file_is_named_with_its_fault(engineer: httpx.AsyncClient, file: PlantFile) -> None:
    file.write("[site\n")
    page = await engineer.get("/configuration")
    assert page.status_code == 200
    assert "lineside.toml:1" in page.text


async def test_without_a_file(tmp_path: Path) -> None:
    async with complete_app(tmp_path) as house:
        page = await (await house.signed_in(Role.ENGINEER)).get("/configuration")
        assert page.status_code == 200
        assert "started without a configuration file" in page.text


@for_each(
    "name",
    ["server", "bus.0", "bus.0.unit.9", "alarm.1", "notify.webhook.0", "notify.group.0.duty.0", "x" * 99],
)
async def test_no_other_table(engineer: httpx.AsyncClient, name: str) -> None:
    assert (await engineer.get(f"/configuration/tables/{name}")).status_code == 404


async def test_choices_have_their_words(engineer: httpx.AsyncClient, file: PlantFile) -> None:
    smtp = '[notify.smtp]\nhost = "h"\nsender = "a@b.example"\n'
    file.write(f'{TEXT}{smtp}[[notify.group]]\nname = "all"\nto = ["a@b.example"]\n')
    assert "<span>Monday</span>" in (await engineer.get("/configuration/tables/notify.group.0.duty.0")).text
    alarms = (await engineer.get("/configuration/tables/built_in_alarm.0")).text
    assert '<option value="deviation">Speed deviates</option>' in alarms


async def test_the_page_system_leads_there_for_those_who_may(
    house: House, engineer: httpx.AsyncClient
) -> None:
    assert 'href="/configuration"' in (await engineer.get("/system")).text
    operator = await house.signed_in(Role.OPERATOR)
    assert 'href="/configuration"' not in (await operator.get("/system")).text
