"""A unit swap as a person is guided through it, to the very end; the simulator operates the keypad."""

from __future__ import annotations

import re
import signal
from collections.abc import Iterator
from typing import Any

import pytest
from playwright.sync_api import Page, expect

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
        made.line.remote.do("remove", unit=3)
        eventually(lambda: made.unit(3)["link"] == "offline", "the address stops responding")
        made.line.remote.do("spare", parameters={17: 3} | GOOD | {20: SETPOINT})
        eventually(lambda: made.unit(3)["link"] == "online", "the unit of section 3")
        with made.api("engineer") as client:
            taken = client.post("/buses/line/sets", json={"units": [3], "name": "the good one"})
            assert taken.status_code == 201, taken.text
        yield made


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
    page.goto("/swap/line/3")
    page.get_by_role("button", name="Start the replacement of Coater").click()
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
