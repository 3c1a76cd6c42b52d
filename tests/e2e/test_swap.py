"""A unit swap as a person is guided through it, to the very end; the simulator operates the keypad."""

from __future__ import annotations

import re
import signal
from collections.abc import Iterator
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from bus.messages import Message
from tests.e2e.conftest import OpensPages
from tests.e2e.limits import PROCEDURE_MS
from tests.e2e.site import Site, eventually
from tests.e2e.site import site as one_site

pytestmark = pytest.mark.soak
OFFICE = {"width": 1280, "height": 900}


GOOD = {1: 1500, 2: 1600, 4: 9000, 5: 100, 6: 33, 7: 44, 9: 444, 10: 6, 11: 7, 12: 8, 15: 11}
GOOD |= {22: 7, 23: 200, 25: 9, 29: 1, 30: 1900, 31: 19000, 38: 5500, 39: 21}
"""What the third unit differs in from one out of its box, beside its address and its setpoint."""
SETPOINT = 1216


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    """Three units at rest; the third is about to die, and a set of it is stored."""
    folder = tmp_path_factory.mktemp("swap")
    # Each request to an address with two units waits for its full timeout.
    with one_site(folder, 3, line_options=("--no-script", "--speedup", "10"), turnaround_ms=250) as made:
        new_section(made, GOOD | {20: SETPOINT})
        with made.api("engineer") as client:
            taken = client.post("/buses/line/sets", json={"units": [3], "name": "the good one"})
            assert taken.status_code == 201, taken.text
        yield made


def new_section(site: Site, parameters: dict[int, int], **traits: Any) -> None:
    """Replace the unit at address 3 by a new one, and wait until the site has its response."""
    line_remote = site.line.remote
    eventually(lambda: not removed(site), "no unit at address 3")
    eventually(lambda: site.unit(3)["link"] == "offline", "the address stops responding")
    line_remote.do("spare", parameters={17: 3} | parameters, **traits)
    eventually(lambda: site.unit(3)["link"] == "online", "the unit of section 3")


def removed(site: Site) -> bool:
    try:
        site.line.remote.do("remove", unit=3)
    except RuntimeError:
        return False
    return True


LEAVE = re.compile("(Cancel|Close) the replacement")


def begin(page: Page) -> None:
    page.goto("/swap/line/3")
    if page.get_by_role("button", name=LEAVE).count():
        leave(page, 3)
        page.goto("/swap/line/3")
    page.get_by_role("button", name="Start the replacement of Coater").click()


def leave(page: Page, unit: int) -> None:
    page.get_by_role("button", name=LEAVE).click()
    expect(page).to_have_url(f"/units/line/{unit}")


def shows(page: Page, text: str) -> None:
    expect(page.locator("#steps [role=status]")).to_contain_text(text, timeout=PROCEDURE_MS)


def keypad(site: Site, place: int, number: int, raw: int) -> None:
    site.line.remote.do("parameter", place=place, number=number, raw=raw)


def events(site: Site, kind: str) -> list[dict[str, Any]]:
    with site.api() as client:
        found: list[dict[str, Any]] = client.get("/events", params={"kind": kind, "limit": 50}).json()[
            "events"
        ]
        return found


@pytest.mark.provokes("WebSocket", "fetch")
def test_from_the_failed_unit_to_the_verified_spare(site: Site, browser_page: OpensPages) -> None:
    line_remote = site.line.remote
    page = browser_page("engineer", viewport=OFFICE)
    begin(page)
    shows(page, "If it is the old unit, switch it off and disconnect it")
    line_remote.do("remove", unit=3)
    shows(page, "No spare responds yet")

    spare = line_remote.do("spare", parameters={18: 48, 19: 0})
    keypad(site, spare, 18, 96)
    shows(page, "set parameter 18 to 96 (9600 baud)")
    line_remote.do("power_cycle", place=spare)
    shows(page, "Two units respond at address 1: the spare still has its factory address")
    site.stop(signal.SIGKILL)
    site.start()
    expect(page.get_by_text(re.compile("begun .* by engineer, from set 1"))).to_be_visible()
    shows(page, "Two units respond at address 1: the spare still has its factory address")
    keypad(site, spare, 17, 3)
    shows(page, "At the keypad of the new unit, set parameter 19 to 1 (REMOTE)")
    line_remote.do("mode", place=spare, to="remote")
    shows(page, "The unit responds and is in REMOTE")

    page.get_by_role("button", name="Review the restore").click()
    expect(page.locator("#restore .outcome[role=status]")).to_contain_text("Nothing has been written")
    expect(page.get_by_text("accelerates in 3.3 s instead of 10.0 s")).to_be_visible()
    page.get_by_role("button", name=re.compile(r"Write \d+ rows to unit 3")).click()
    expect(page.get_by_role("heading", name=re.compile("^Read-back"))).to_be_visible(timeout=PROCEDURE_MS)
    page.get_by_role("link", name="Back to the replacement").click()
    shows(
        page,
        "parameters of the old unit, verified by a full read, except what was not written: Speed Setpoint",
    )
    expect(page.get_by_role("link", name="Open the report")).to_be_visible()

    expect(
        page.get_by_text("The setpoint is not restored: Speed Setpoint (parameter 20) is 0")
    ).to_be_visible()
    assert [line_remote.do("parameter", unit=3, number=number) for number in (6, 9, 22, 20)] == [
        33,
        444,
        7,
        0,
    ]
    [end, start] = events(site, "swap")
    assert (end["what"], end["outcome"], end["unit"]) == ("unit replaced and verified", "verified", 3)
    assert "started" in start["what"]
    for part in (
        "two units respond at address 1",
        "not in REMOTE",
        "in REMOTE",
        "(parameter 6)",
        ("verified by a full read"),
    ):
        assert part in end["message"], end["message"]


def test_a_spare_with_the_older_list_at_the_address_already(site: Site, browser_page: OpensPages) -> None:
    new_section(site, {}, last_parameter=20)
    page = browser_page("engineer", viewport=OFFICE)
    begin(page)
    shows(page, "If it is already the spare, confirm it")
    page.get_by_role("button", name="Confirm the spare").click()
    shows(page, "The unit responds and is in REMOTE")
    page.get_by_role("button", name="Review the restore").click()
    expect(
        page.get_by_role("row", name=re.compile("Minimum Ratio.*this unit does not have it"))
    ).to_be_visible()
    page.get_by_role("button", name=re.compile(r"Write \d+ rows to unit 3")).click()
    proven = page.locator("#restore-progress").get_by_text("equals the set except for the rows left out")
    expect(proven).to_be_visible(timeout=PROCEDURE_MS)
    assert "Minimum Ratio (parameter 38): this unit does not have it" in events(site, "swap")[0]["message"]


def test_two_units_at_the_address_of_the_section(site: Site, browser_page: OpensPages) -> None:
    new_section(site, GOOD)
    page = browser_page("engineer", viewport=OFFICE)
    begin(page)
    shows(page, "A unit responds at address 3")
    site.line.remote.do("spare", parameters={17: 3})
    shows(page, "Two units respond at address 3. Disconnect the old unit")
    eventually(lambda: site.unit(2)["link"] == "online", "the others go on")
    leave(page, 3)
    removed(site)


def test_a_section_without_a_set_becomes_what_its_neighbour_is_or_the_sheet(
    site: Site, browser_page: OpensPages
) -> None:
    page = browser_page("engineer", viewport=OFFICE)
    page.goto("/swap/line/2")
    expect(page.get_by_text("No parameter set of this unit is stored. Use")).to_be_visible()
    begin_it = page.get_by_role("button", name="Start the replacement of Infeed nip")
    begin_it.click()
    refusal = "choose the source of the parameters; the replacement was not started"
    expect(page.get_by_text(refusal)).to_be_visible()
    page.goto("/swap/line/2")
    page.get_by_label("Source of the parameters").select_option("live:line:1")
    begin_it.click()
    expect(page.get_by_text("The set is from unit 1, another section.")).to_be_visible()
    leave(page, 2)
    page.goto("/swap/line/2")
    page.get_by_label("Source of the parameters").select_option("sheet")
    begin_it.click()
    shows(page, "If it is already the spare, confirm it")
    page.get_by_role("button", name="Confirm the spare").click()
    shows(page, "Enter the values of the parameter sheet")
    page.get_by_role("button", name="Read the unit and save it as a set").click()
    heading = page.get_by_role("heading", level=1)
    expect(heading).to_have_text(re.compile(r"^Set \d+$"), timeout=PROCEDURE_MS)
    result = events(site, "swap")[0]
    assert result["what"] == str(Message("event_swap_kept"))
    assert str(Message("entered_from_sheet")) in result["message"]


@pytest.mark.provokes("WebSocket", "fetch", "Failed to fetch")
def test_a_server_killed_in_the_midst_of_a_restore_lists_rows_done(
    site: Site, browser_page: OpensPages
) -> None:
    new_section(site, {})
    page = browser_page("engineer", viewport=OFFICE)
    page.goto("/units/line/3/restore")
    newest = page.locator("#source option", has_text="the good one").get_attribute("value")
    page.get_by_label("From a stored set").select_option(newest)
    page.get_by_role("button", name="Read the unit and show the differences").click()
    site.line.remote.do("fault", kind="slow", rate=1, unit=3)
    page.get_by_role("button", name=f"Write {len(GOOD)} rows to unit 3").click()
    expect(page.get_by_text(re.compile(r"writing: [1-9]\d* of"))).to_be_visible()
    site.stop(signal.SIGKILL)
    expect(page.locator(".gone")).to_be_visible()
    site.line.remote.do("clear")
    site.start()
    expect(
        page.locator("#restore").get_by_text("The restore ended early: the server stopped")
    ).to_be_visible()
    done = page.get_by_role("cell", name="verified", exact=True).count()
    assert 1 <= done < len(GOOD)
    assert done + page.get_by_role("cell", name=re.compile("not sent|not verified")).count() == len(GOOD)
    eventually(lambda: site.unit(3)["link"] == "online", "the unit of section 3")
    page.get_by_role("button", name="Review the remaining rows").click()
    left = page.get_by_role("button", name=re.compile(r"Write \d+ rows to unit 3"))
    expect(left).to_be_visible()
    assert len(GOOD) - done - 1 <= int(left.inner_text().split()[1]) <= len(GOOD) - done
    left.click()
    proven = page.locator("#restore").get_by_text("verified by a full read")
    expect(proven).to_be_visible(timeout=PROCEDURE_MS)
    assert {number: parameter(site, number) for number in GOOD} == GOOD
    page.goto("/units/line/3/restore")
    expect(page.get_by_role("row", name=re.compile("ended early"))).to_have_count(1)


def parameter(site: Site, number: int) -> int:
    return int(site.line.remote.do("parameter", unit=3, number=number))
