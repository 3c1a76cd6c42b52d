"""Every pure module has a test file."""

from __future__ import annotations

import pytest

from tests.covered import ROOT, TESTS, modules, own_tests


@pytest.mark.parametrize("module", modules())
def test_a_pure_module_has_its_tests(module: str) -> None:
    assert (ROOT / own_tests(module)).is_file()


def test_the_named_modules_exist() -> None:
    assert set(TESTS) <= set(modules())
