"""``pytest --processes N``: every test once, each process with its own fixtures and output, and no end of a
process that is not seen.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PASSING = """
def test_one(tmp_path, alone):
    (tmp_path / "file").write_text("", "utf-8")

def test_two(alone):
    pass
"""
CONFTEST = """
import os, pathlib, pytest

@pytest.fixture(scope="session")
def alone():
    pathlib.Path("begun").open("a").write(f"{os.getpid()}\\n")
    yield
    pathlib.Path("ended").open("a").write(f"{os.getpid()}\\n")
"""


def run(folder: Path, *options: str, **files: str) -> subprocess.CompletedProcess[str]:
    """Run pytest on these test files."""
    (folder / "conftest.py").write_text(CONFTEST, "utf-8")
    for name, text in files.items():
        (folder / f"test_{name}.py").write_text(text, "utf-8")
    command = (sys.executable, "-m", "pytest", "-p", "tests.processes", "-p", "no:cacheprovider", *options)
    environment = os.environ | {"PYTHONPATH": str(ROOT), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)


def test_every_test_runs_once_and_each_process_has_its_fixtures_to_its_end(tmp_path: Path) -> None:
    """A fixture of the session is made once a process, not once a file."""
    result = run(tmp_path, "--processes=2", "-q", **{f"file_{number}": PASSING for number in range(9)})
    assert "18 passed" in result.stdout, result.stdout + result.stderr
    assert result.returncode == pytest.ExitCode.OK
    begun = (tmp_path / "begun").read_text("utf-8").split()
    assert len(set(begun)) == len(begun) <= 2
    assert sorted((tmp_path / "ended").read_text("utf-8").split()) == sorted(begun)


def test_a_failure_is_reported_with_the_output_of_that_test(tmp_path: Path) -> None:
    """All that is printed at the same time, by processes or by what they start, stays apart."""
    failing = (
        "import os\ndef test_it():\n    for _ in range(4): os.system('echo from {0}')\n    assert 0, '{0}'"
    )
    result = run(
        tmp_path, "--processes=3", **{name: failing.format(name) for name in ("north", "south", "west")}
    )
    assert "3 failed" in result.stdout
    assert result.returncode == pytest.ExitCode.TESTS_FAILED
    for section in result.stdout.split("Captured stdout call")[1:]:
        assert len({line for line in section.splitlines() if line.startswith("from ")}) == 1


def test_a_process_that_ends_fails_the_run_and_names_its_test(tmp_path: Path) -> None:
    """Nothing of what it had left is taken for passed."""
    killed = "import os\ndef test_it(): os.kill(os.getpid(), 9)"
    result = run(tmp_path, "--processes=2", "-q", killed=killed, other=PASSING)
    assert result.returncode == pytest.ExitCode.TESTS_FAILED
    assert "ended with -9, while it ran test_killed.py::test_it" in result.stdout


def test_what_cannot_be_collected_runs_nothing(tmp_path: Path) -> None:
    """As in one process."""
    result = run(tmp_path, "--processes=2", broken="import nothing_of_this_name", other=PASSING)
    assert result.returncode == pytest.ExitCode.INTERRUPTED
    assert "1 error" in result.stdout
