"""Run the browser tests many times and count in how many runs each failed.

``python -m tests.flaky 20`` runs them 20 times; arguments of pytest may follow. Exits with 1 if any failed.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

BROWSER_TESTS = ("tests/e2e",)
PASSED, FAILED = 0, 1
"""Exit codes of pytest; any other means that a run did not reach its end."""


def main(arguments: Sequence[str]) -> int:
    """Run the tests, print how often each failed, and return the exit code."""
    runs, options = int(arguments[0]), arguments[1:] or BROWSER_TESTS
    failures: Counter[str] = Counter()
    for run in range(1, runs + 1):
        print(f"\nrun {run} of {runs}", flush=True)
        failures.update(failed_tests(options))
    print(summary(failures, runs))
    return 1 if failures else 0


def failed_tests(options: Sequence[str]) -> list[str]:
    """Run pytest once; the name of each test that failed, or of the run if it was cut short."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.xml"
        command = [sys.executable, "-m", "pytest", "-q", f"--junit-xml={report}", *options]
        status = subprocess.run(command).returncode
        if status not in (PASSED, FAILED):
            return [f"(pytest ended with exit code {status})"]
        tests = ElementTree.parse(report).iter("testcase")
        failed = {
            name_of(test)
            for test in tests
            if test.find("failure") is not None or test.find("error") is not None
        }
    return sorted(failed)


def name_of(test: ElementTree.Element) -> str:
    """As ``tests.e2e.test_clock::test_name[parameter]``."""
    return f"{test.get('classname')}::{test.get('name')}"


def summary(failures: Counter[str], runs: int) -> str:
    """A line for each test that failed, the most frequent first."""
    if not failures:
        return f"failures in {runs} runs: none"
    return "\n".join(f"failed in {count} of {runs} runs: {name}" for name, count in failures.most_common())


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
