"""Every pure module has a test file."""

from __future__ import annotations

import pytest

from tests.covered import ROOT, TESTS, modules, own_tests


@pytest.mark.parametrize("module", modules())
def test_a_pure_module_has_its_tests(module: str) -> None:
    assert all((ROOT / tests).is_file() for tests in own_tests(module))


def test_the_named_modules_exist() -> None:
    assert set(TESTS) <= set(modules())
