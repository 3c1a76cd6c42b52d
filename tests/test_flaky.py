"""``make flaky`` counts in how many runs each test failed."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from tests.flaky import failed_tests, main, summary

EVERY_SECOND_RUN = """
from pathlib import Path

import pytest

@pytest.mark.parametrize("text", ["a", "b"])
def test_passes(text):
    pass

def test_fails_every_second_run():
    mark = Path(__file__).with_name("ran")
    if mark.exists():
        mark.unlink()
        pytest.fail("ran before")
    mark.touch()

@pytest.fixture
def broken():
    raise RuntimeError("no server")

def test_has_a_broken_fixture(broken):
    pass
"""
OPTIONS = ("-p", "no:cacheprovider", "--noconftest")


@pytest.fixture(autouse=True)
def no_plugins(monkeypatch: pytest.MonkeyPatch) -> None:
    """The plugins of this environment take seconds to load."""
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")


def test_each_test_is_counted_once_for_each_run_in_which_it_failed(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "test_sometimes.py").write_text(EVERY_SECOND_RUN)
    # Without it names depend on where the repository is.
    assert main(["2", *OPTIONS, f"--rootdir={tmp_path}", str(tmp_path)]) == 1
    assert capfd.readouterr().out.splitlines()[-2:] == [
        "failed in 2 of 2 runs: test_sometimes::test_has_a_broken_fixture",
        "failed in 1 of 2 runs: test_sometimes::test_fails_every_second_run",
    ]


def test_a_run_that_was_cut_short_is_a_failure(tmp_path: Path) -> None:
    (tmp_path / "test_broken.py").write_text("import no_such_module\n")
    assert failed_tests([*OPTIONS, str(tmp_path)]) == ["(pytest ended with exit code 2)"]


def test_no_failure_is_reported_as_such(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "test_always.py").write_text("def test_passes():\n    pass\n")
    assert main(["1", *OPTIONS, str(tmp_path)]) == 0
    assert capfd.readouterr().out.splitlines()[-1] == "failures in 1 runs: none"
    assert summary(Counter({"a": 1, "b": 3}), 3).startswith("failed in 3 of 3 runs: b")
