"""``make soak`` runs both of its halves and reports."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests import soak

REPORT = """<testsuites><testsuite>
<testcase classname="tests.app.test_a" name="one" time="61.5"/>
<testcase classname="tests.app.test_a" name="two" time="1.0"><failure/></testcase>
<testcase classname="tests.app.test_b" name="one" time="90.0"><error/></testcase>
</testsuite></testsuites>"""


@pytest.mark.parametrize(("codes", "exit_code"), [([0, 0], 0), ([1, 0], 1), ([0, 1], 1)])
def test_both_halves_run_and_the_exit_code_is_of_both(
    codes: list[int], exit_code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    given = iter(codes)

    def run_half(_options: tuple[str, ...], report: Path) -> int:
        report.write_text(REPORT)
        return next(given)

    monkeypatch.setattr(soak, "run_half", run_half)
    assert soak.main() == exit_code
    assert list(given) == [], "both have run"
    printed = capsys.readouterr().out
    assert printed.count(", not passed") == exit_code
    assert [line.split() for line in printed.splitlines() if "test_" in line][:2] == [
        ["app/test_b", "1", "tests,", "1", "failed,", "90", "s"],
        ["app/test_a", "2", "tests,", "1", "failed,", "62", "s"],
    ]
    assert "in all 0.0 of at most 60 min" in printed
