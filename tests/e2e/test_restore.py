"""A restore stopped half way lists the rows done, and a second run finishes the rest; bad files write
none.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from playwright.sync_api import Locator, Page, expect

from app.cli import cli
from tests.e2e.conftest import OpensPages
from tests.e2e.limits import PROCEDURE_MS, PROCEDURE_S
from tests.e2e.site import Site, eventually

OFFICE = {"width": 1280, "height": 900}
PHONE = {"width": 360, "height": 740}
HALL = {"width": 1920, "height": 1080}
NUMBERS = (5, 6, 7, 9, 10, 11, 12, 15, 22, 23, 25, 39)
"""Changed at the keypad, each by one."""


@pytest.fixture(scope="module")
def site(line_server: Callable[..., Site]) -> Site:
    """Two units at rest, and a set of the second."""
    made = line_server(2, line_options=("--no-script", "--speedup", "10"), turnaround_ms=1000)
    with made.api("engineer") as client:
        taken = client.post("/buses/line/sets", json={"units": [2], "name": "as it was"})
        assert taken.status_code == 201, taken.text
    return made


@pytest.fixture(autouse=True)
def repaired_afterwards(site: Site) -> Iterator[None]:
    """Whatever a test did to the line, and wherever it ended."""
    yield
    site.line.remote.do("clear")
    site.line.remote.do("plug")


def parameter(site: Site, number: int, **raw: int) -> int:
    return int(site.line.remote.do("parameter", unit=2, number=number, **raw))


def changed_at_the_panel(site: Site) -> dict[int, int]:
    """The rows of the set, after each of them has been changed in the unit."""
    wanted = {number: parameter(site, number) for number in NUMBERS}
    for number, raw in wanted.items():
        parameter(site, number, raw=raw + 1)
    return wanted


def review(page: Page) -> None:
    page.goto("/units/line/2/restore")
    newest = page.locator("#source option", has_text="as it was").first.get_attribute("value")
    page.get_by_label("From a stored set").select_option(newest)
    page.get_by_role("button", name="Read the unit and show the differences").click()


def outcomes(page: Page) -> dict[int, str]:
    """Return number → result in the table of rows."""
    rows = page.get_by_role("table", name="Rows to write").locator("tbody tr")
    row_texts = rows.evaluate_all(
        "rows => rows.map(row => [row.cells[0].innerText, row.cells[row.cells.length - 1].innerText])"
    )
    return {int(number): outcome.strip() for number, outcome in row_texts}


def cancel(site: Site, page: Page) -> None:
    assert site.units == 2
    page.get_by_role("button", name="Stop after this row").click()


def pull_the_cable(site: Site, page: Page) -> None:
    expect(page.locator("#restore .outcome")).to_be_visible()
    site.line.remote.do("unplug")


def cut_the_drop(site: Site, page: Page) -> None:
    expect(page.locator("#restore .outcome")).to_be_visible()
    site.line.remote.do("fault", kind="dead", rate=1, unit=2)


@pytest.mark.soak
@pytest.mark.parametrize(
    ("fault", "cause"),
    [
        (cancel, "canceled by engineer after"),
        (pull_the_cable, "The restore ended early"),
        (cut_the_drop, r"\(parameter \d+\): |its time was over"),
    ],
    ids=lambda given: getattr(given, "__name__", ""),
)
def test_a_restore_stopped_half_way_lists_rows_done_and_a_second_run_finishes(
    site: Site, browser_page: OpensPages, fault: Callable[[Site, Page], None], cause: str
) -> None:
    line_remote, wanted = site.line.remote, changed_at_the_panel(site)
    page = browser_page("engineer", viewport=OFFICE)
    review(page)
    line_remote.do("fault", kind="late", rate=1, unit=2)
    page.get_by_role("button", name=f"Write {len(wanted)} rows to unit 2").click()
    expect(page.get_by_text(re.compile(r"writing: [1-9]\d* of"))).to_be_visible()
    fault(site, page)
    early = page.locator("#restore .outcome").filter(has_text="The restore ended early")
    expect(early).to_contain_text(re.compile(cause), timeout=PROCEDURE_MS)
    result = outcomes(page)
    line_remote.do("clear")
    assert set(result) == set(wanted)
    done = {number for number, outcome in result.items() if outcome == "verified"}
    untouched = {number for number, outcome in result.items() if outcome.startswith("not sent")}
    assert 1 <= len(done) < len(wanted)
    assert len(done | untouched) >= len(wanted) - 1, result
    assert {number for number in wanted if parameter(site, number) == wanted[number]} - done <= set(
        result
    ) - done - untouched
    assert all(parameter(site, number) == wanted[number] for number in done)
    if fault is pull_the_cable:
        line_remote.do("plug")
    left = page.get_by_role("button", name=re.compile(r"Write \d+ rows to unit 2"))
    eventually(lambda: requested_again(page, left), "the unit responds again", within=PROCEDURE_S)
    assert set(outcomes(page)) == {number for number in wanted if parameter(site, number) != wanted[number]}
    left.click()
    expect_proof(page)
    assert {number: parameter(site, number) for number in wanted} == wanted


def expect_proof(page: Page) -> None:
    """Wait for the end of a restore that wrote all rows."""
    proven = page.locator("#restore").get_by_text("verified by a full read")
    expect(proven).to_be_visible(timeout=PROCEDURE_MS)


def requested_again(page: Page, left: Locator) -> bool:
    """Request the remaining rows; where the unit does not respond yet, check the message and go back."""
    page.get_by_role("button", name="Review the remaining rows").click()
    refused = page.get_by_role("heading", name=re.compile("Request refused|Not possible now"))
    expect(left.or_(refused)).to_be_visible(timeout=PROCEDURE_MS)
    if left.count():
        return True
    page.go_back()
    return False


@pytest.mark.soak
def test_by_keyboard_alone_to_the_proof_which_prints(
    site: Site, browser_page: OpensPages, axe: Callable[..., list[str]]
) -> None:
    changed_at_the_panel(site)
    page = browser_page("engineer", viewport=PHONE)
    page.goto("/units/line/2/restore")
    tab_to(page, "From a stored set")
    page.keyboard.type(page.locator("#source option", has_text="as it was").first.inner_text()[:24])
    expect(page.locator("#source option:checked")).to_contain_text("as it was")
    tab_to(page, "Read the unit and show the differences")
    page.keyboard.press("Enter")
    expect(page.locator("#restore .outcome[role=status]")).to_contain_text("Nothing has been written")
    assert as_it_should_be(page, axe) == []
    tab_to(page, f"Write {len(NUMBERS)} rows to unit 2")
    page.keyboard.press("Enter")
    expect_proof(page)
    assert as_it_should_be(page, axe) == []
    page.emulate_media(media="print")
    proof = page.get_by_role("table", name="Read-back")
    expect(proof.locator("tbody tr")).to_have_count(40)
    expect(proof.locator("tbody tr").last).to_be_visible()
    expect(page.get_by_role("link", name="Open the unit")).not_to_be_visible()
    assert page.pdf(format="A4").startswith(b"%PDF")


def test_a_setpoint_is_left_out_until_it_is_ticked(site: Site, shared_page: OpensPages) -> None:
    """A running unit has drifted in a ramp, and its operator has set another speed since."""
    with site.api("engineer") as client:
        golden = client.post("/buses/line/sets", json={"units": [2], "name": "as it ought to be"}).json()[
            "id"
        ]
        client.post(f"/sets/{golden}/golden", json={"unit": 2}).raise_for_status()
    ramp, speed = parameter(site, 6), parameter(site, 20)
    parameter(site, 6, raw=ramp + 1)
    parameter(site, 20, raw=speed - 100)
    site.line.remote.do("input", unit=2, input="run", on=True)
    eventually(lambda: site.unit(2)["inputs"]["run"], "the run input is seen")
    page = shared_page("engineer", viewport=OFFICE)
    page.goto("/units/line/2/restore")
    expect(page.locator("#source option:checked")).to_contain_text("golden set · as it ought to be")
    page.get_by_role("button", name="Read the unit and show the differences").click()
    expect(page.locator("#restore .outcome[role=status]")).to_contain_text("1 row would be written")
    expect(page.get_by_text("The Run input is on: a marked row takes effect as soon")).to_be_visible()
    row = page.get_by_role("table", name="Setpoints").get_by_role("row", name="Speed Setpoint")
    expect(row).to_contain_text("Changes the machine's speed now")
    tick = page.get_by_role("checkbox", name="Write Speed Setpoint (parameter 20)")
    expect(tick).not_to_be_checked()
    mark = len(writes(site))
    page.get_by_role("button", name="Write 1 row to unit 2").click()
    expect_proof(page)
    left_out = page.get_by_role("table", name="Left out").get_by_role("row", name="Speed Setpoint")
    expect(left_out).to_contain_text("Changes the machine's speed now")
    assert (parameter(site, 6), parameter(site, 20), len(writes(site))) == (ramp, speed - 100, mark + 1)

    review(page)
    button = page.get_by_role("button", name=re.compile(r"Write \d+ rows? to unit 2"))
    expect(button).to_be_disabled()
    tick.check()
    expect(button).to_have_text("Write 1 row to unit 2")
    button.click()
    expect_proof(page)
    assert (parameter(site, 20), len(writes(site))) == (speed, mark + 2)


@pytest.mark.soak
def test_the_commands_in_a_cron_job_report_by_their_exit_codes(site: Site, tmp_path: Path) -> None:
    """Without a terminal there is no prompt: nothing is written unless --yes was given."""
    file = tmp_path / "unit2.toml"
    runner = CliRunner()

    def lineside(*arguments: str) -> Result:
        return runner.invoke(cli, arguments)

    done = lineside("backup", *to(site, 2), "--out", str(file), "--json")
    assert (done.exit_code, json.loads(done.stdout)["units"]) == (0, [2]), done.stderr
    done = lineside("diff", *to(site, 2), str(file), "--json")
    assert (done.exit_code, json.loads(done.stdout)) == (0, [])
    parameter(site, 6, raw=parameter(site, 6) + 1)
    done = lineside("diff", *to(site, 2), str(file), "--json")
    assert (done.exit_code, [row["number"] for row in json.loads(done.stdout)]) == (1, [6])
    mark = len(writes(site))
    done = lineside("restore", *to(site, 2), str(file), "--json")
    assert (done.exit_code, "nothing was written" in done.stderr) == (1, True)
    assert len(writes(site)) == mark
    site.line.remote.do("mode", unit=2, to="local")
    eventually(lambda: site.unit(2)["mode"] == "LOCAL", "LOCAL is seen")
    done = lineside("restore", *to(site, 2), str(file), "--json", "--yes")
    assert done.exit_code == 1
    assert {row["number"]: row["outcome"] for row in json.loads(done.stdout)}[6] == "left_out"
    site.line.remote.do("mode", unit=2, to="remote")
    eventually(lambda: site.unit(2)["mode"] == "REMOTE", "REMOTE is seen")
    done = lineside("restore", *to(site, 2), str(file), "--json", "--yes")
    assert (done.exit_code, [row["outcome"] for row in json.loads(done.stdout)]) == (0, ["verified"])
    assert len(writes(site)) == mark + 1
    parameter(site, 20, raw=parameter(site, 20) - 10)
    for chosen, outcome in (((), "left_out"), (("--include", "20"), "verified")):
        done = lineside("restore", *to(site, 2), str(file), "--json", "--yes", *chosen)
        result = [(row["number"], row["outcome"]) for row in json.loads(done.stdout)]
        assert (done.exit_code, result) == (0, [(20, outcome)]), done.stderr
    assert len(writes(site)) == mark + 2
    assert lineside("restore", *to(site, 2)).exit_code == 2


def writes(site: Site) -> list[dict[str, Any]]:
    entries = site.line.remote.do("record", kinds=["acted"])
    return [entry for entry in entries if bytes.fromhex(entry["hex"])[1] == 0x86]


def to(site: Site, unit: int) -> list[str]:
    return ["--url", site.url, "--token", site.tokens["engineer"], "--bus", "line", "--unit", str(unit)]


def as_it_should_be(page: Page, axe: Callable[..., list[str]]) -> list[Any]:
    """What axe objects to, on the phone and in the hall, and whether the page is wider than its screen."""
    faults: list[Any] = []
    for size in (HALL, PHONE):
        page.set_viewport_size(size)  # type: ignore[arg-type]
        faults += axe(page)
        if page.evaluate("document.documentElement.scrollWidth > window.innerWidth"):
            faults.append(f"wider than {size['width']}")
    return faults


def tab_to(page: Page, name: str) -> None:
    """Press Tab until the focus is on what bears this name."""
    bears = """name => {
      const focus = document.activeElement;
      const texts = focus.matches("a, button, input, select") ? [focus, ...(focus.labels ?? [])] : [];
      return texts.some(one => one.innerText.includes(name));
    }"""
    for _ in range(80):
        page.keyboard.press("Tab")
        if page.evaluate(bears, name):
            return
    raise AssertionError(f"the keyboard does not reach {name!r}")
