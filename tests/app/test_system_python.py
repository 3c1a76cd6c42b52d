"""Backup and restore with the ``python3`` that the system ships, such as 3.11.2 of Debian 12: its library
may lack what a newer release of the same version has.
"""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SYSTEM_PYTHON = Path("/usr/bin/python3")
TESTS = (
    "tests/app/cli/test_backup_store.py",
    "tests/attacks/test_restored_store.py",
    "tests/attacks/test_backup_archive.py",
)


def why_not() -> str:
    """Why it cannot run these tests with the packages of this environment; empty: it can."""
    if not SYSTEM_PYTHON.exists():
        return f"there is no {SYSTEM_PYTHON}"
    if SYSTEM_PYTHON.resolve() == Path(sys.executable).resolve():
        return "all tests run with it"
    words = [SYSTEM_PYTHON, "-c", "import sys, sqlite3; print(*sys.version_info[:2])"]
    probed = subprocess.run(words, capture_output=True, text=True, check=False)
    if probed.stdout.split() != [str(number) for number in sys.version_info[:2]]:
        return "it is of another version, for which the packages are not built"
    return ""


@pytest.mark.soak
@pytest.mark.skipif(bool(why_not()), reason=why_not())
def test_stores_are_backed_up_and_restored_by_the_systems_python() -> None:
    packages = sysconfig.get_paths()
    path = os.pathsep.join([str(ROOT), packages["purelib"], packages["platlib"]])
    words = [SYSTEM_PYTHON, "-m", "pytest", "-q", "-p", "no:cacheprovider", *TESTS]
    done = subprocess.run(
        words, cwd=ROOT, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
