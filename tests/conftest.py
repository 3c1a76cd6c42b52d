"""What holds for every test: examples are the same in every run, and none has a time limit of its own.
The tests of whole sites come first: the many small ones fill the time in which the last of those wait."""

from __future__ import annotations

import pytest
from hypothesis import settings

settings.register_profile("lineside", derandomize=True, deadline=None, max_examples=60)
settings.load_profile("lineside")

WHOLE_SITES = {"e2e", "path"}


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """With ``--no-loadscope-reorder``, xdist hands out files in this order."""
    items.sort(key=lambda item: item.path.parent.name not in WHOLE_SITES)
