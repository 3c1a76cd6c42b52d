"""``make soak``: the tests that take long and measure, then each property with many random examples.

In the end it prints what ran, in how long, and what failed. Both halves run, also where the first fails.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path
from xml.etree import ElementTree

ROOT = Path(__file__).resolve().parent.parent
MAX_MINUTES = 60.0
"""On two cores, with nothing beside it."""
HALVES = {
    "long tests": ("-m", "soak", "-s"),
    "properties with random examples": ("-m", "hypothesis", "--hypothesis-profile=soak", "--processes", "2"),
}


def run_half(options: tuple[str, ...], report: Path) -> int:
    """Run one half and return the exit code of pytest."""
    command = [sys.executable, "-m", "pytest", *options, f"--junitxml={report}"]
    return subprocess.run(command, cwd=ROOT).returncode


def table_of(report: ElementTree.Element) -> list[str]:
    """Each test file: its tests, how many of them failed, and how long they took; the longest first."""
    files: defaultdict[str, list[ElementTree.Element]] = defaultdict(list)
    for case in report.iter("testcase"):
        files[case.get("classname", "").removeprefix("tests.").replace(".", "/")].append(case)
    rows = [(sum(float(case.get("time", 0)) for case in cases), file) for file, cases in files.items()]
    return [_row(file, files[file], took_s) for took_s, file in sorted(rows, reverse=True)]


def _row(file: str, cases: list[ElementTree.Element], took_s: float) -> str:
    failed = sum(case.find("failure") is not None or case.find("error") is not None for case in cases)
    return f"  {file:<45}{len(cases):4} tests,{failed:3} failed,{took_s:6.0f} s"


def main() -> int:
    """Exit with 1 where a test of one half failed."""
    lines, codes, begun = [], [], time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        for name, options in HALVES.items():
            report, started = Path(folder) / "report.xml", time.monotonic()
            report.unlink(missing_ok=True)
            codes.append(run_half(options, report))
            minutes = (time.monotonic() - started) / 60
            lines.append(f"{name}: {minutes:.1f} min{'' if codes[-1] == 0 else ', not passed'}")
            if report.exists():
                lines += table_of(ElementTree.parse(report).getroot())
    minutes = (time.monotonic() - begun) / 60
    print("\nmake soak ran", *lines, f"in all {minutes:.1f} of at most {MAX_MINUTES:.0f} min", sep="\n")
    return int(any(codes))


if __name__ == "__main__":
    sys.exit(main())
