"""Check that the tests of each pure module reach every line and branch of it: ``python -m tests.covered``.

The modules are the wire protocol, the catalogue, every ``rules`` and the kinds of commands. Only the tests
of a module itself count, not what another test reaches by the way. Exits with 1 if a line or branch is not
reached.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PURE = (
    *("bus/wire/*.py", "bus/catalogue/*.py"),
    *(
        "app/*/*/rules.py",
        "app/line/alarms/performance.py",
        "app/line/commands/catalogue.py",
        "app/line/conditions/*.py",
    ),
)
TESTS = {
    "bus/catalogue/parameters.py": ("tests/bus/test_catalogue_parameters.py",),
    "app/records/notification/rules.py": ("tests/app/records/test_notification_rules.py",),
    "app/line/alarms/rules.py": ("tests/app/line/test_alarm_rules.py",),
    "app/line/alarms/performance.py": ("tests/app/line/test_alarm_journal.py",),
    "app/line/conditions/catalogue.py": ("tests/app/line/test_condition_rows.py",),
    "app/line/conditions/condition.py": (
        "tests/app/line/test_condition_rows.py",
        "tests/app/line/test_draw.py",
    ),
    "app/line/conditions/unit.py": ("tests/app/line/test_condition_rows.py",),
    "app/records/handover/rules.py": (
        "tests/app/records/test_shift_pictures.py",
        "tests/app/records/test_shifts.py",
    ),
    "app/people/auth/rules.py": ("tests/app/people/test_auth_rules.py",),
    "app/line/commands/catalogue.py": ("tests/app/line/test_command_rules.py",),
    "app/line/commands/rules.py": ("tests/app/line/test_command_rules.py",),
    "app/records/reports/rules.py": ("tests/app/records/test_shifts.py",),
    "app/engineering/recipes/rules.py": ("tests/app/engineering/test_recipes.py",),
    "app/engineering/swap/rules.py": ("tests/app/engineering/test_swap.py",),
}
"""The tests of a module, where they are not in ``tests/bus/test_<module>.py``."""


def modules() -> list[str]:
    """Every pure module that holds code, by its path in the repository."""
    found = (path for pattern in PURE for path in ROOT.glob(pattern) if path.name != "__init__.py")
    return sorted(str(path.relative_to(ROOT)) for path in found)


def own_tests(module: str) -> tuple[str, ...]:
    """The test files of a module."""
    return TESTS.get(module, (f"tests/bus/test_{Path(module).stem}.py",))


def is_covered(module: str, folder: Path) -> bool:
    """Run the tests of a module and print what they do not reach of it."""
    coverage = [sys.executable, "-m", "coverage"]
    data = f"--data-file={folder / 'coverage'}"
    pytest = ["-m", "pytest", "-q", "-p", "pytest_asyncio.plugin", *own_tests(module)]
    report = ["report", data, "--show-missing", "--skip-covered", "--fail-under=100", "--precision=2"]
    # The other plugins take longer to load than these tests to run.
    environment = {**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    print(f"\n{module}: {' '.join(own_tests(module))}", flush=True)
    run = [*coverage, "run", "--branch", f"--include={module}", data, *pytest]
    if subprocess.run(run, cwd=ROOT, env=environment).returncode:
        return False
    return not subprocess.run([*coverage, *report], cwd=ROOT).returncode


def main(chosen: Sequence[str]) -> int:
    """Check these modules, all by default, and return the exit code."""
    with tempfile.TemporaryDirectory() as folder:
        short = [module for module in chosen or modules() if not is_covered(module, Path(folder))]
    for module in short:
        print(f"not covered by {' '.join(own_tests(module))}: {module}")
    return 1 if short else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
