"""``make soak`` runs both of its halves and reports; its tests name nothing that is gone.

Each of them also has a smallest size that ``make test`` runs (`tests.sizes`), or is a walk through pages that
takes too long for that: then the texts that it looks for are compared with those that there are.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests import soak, soak_texts

REPORT = """<testsuites><testsuite>
<testcase classname="tests.app.test_a" name="one" time="61.5"/>
<testcase classname="tests.app.test_a" name="two" time="1.0"><failure/></testcase>
<testcase classname="tests.app.test_b" name="one" time="90.0"><error/></testcase>
</testsuite></testsuites>"""


def files() -> list[Path]:
    return [path for path in soak_texts.ROOT.glob("tests/*/test_*.py") if soak_texts.SOAK in path.read_text()]


@pytest.mark.parametrize("file", files(), ids=lambda file: file.stem)
def test_the_texts_that_it_looks_for_exist(file: Path) -> None:
    assert soak_texts.unknown_texts(file) == []


def test_a_text_that_is_gone_is_found(tmp_path: Path) -> None:
    file = tmp_path / "test_page.py"
    file.write_text(
        "@pytest.mark.soak\n"
        "def test_it(page):\n"
        "    page.get_by_text('Review the remaining rows')\n"
        "    page.get_by_role('button', name='Write 7 rows to unit 2')\n"
        "    page.get_by_text('Zebras graze behind dryers')\n"
        "def test_other(page):\n"
        "    page.get_by_text('Another herd of zebras')\n"
    )
    assert soak_texts.unknown_texts(file) == ["test_page.py:5: Zebras graze behind dryers"]


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
