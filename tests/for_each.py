"""``@for_each(names, cases)`` runs a test for each case in turn; ``parametrize`` would make a test of each.

All cases have the same fixtures, so it is for those that leave an app as it was: what is refused, or read.
To make an app for each takes most of the time of such a test.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import wraps
from typing import Any


def for_each(names: str | tuple[str, ...], cases: Iterable[Any]) -> Callable[[Any], Any]:
    """Run the decorated test with each case as the arguments of these names."""
    named = [name.strip() for name in names.split(",")] if isinstance(names, str) else list(names)
    given = [dict(zip(named, _values(case, len(named)), strict=True)) for case in cases]
    assert given

    def decorate(test: Any) -> Any:
        if inspect.iscoroutinefunction(test):

            @wraps(test)
            async def run_each(**fixtures: Any) -> None:
                for case in given:
                    with _named(case):
                        await test(**fixtures, **case)
        else:

            @wraps(test)
            def run_each(**fixtures: Any) -> None:
                for case in given:
                    with _named(case):
                        test(**fixtures, **case)

        signature = inspect.signature(test)
        left = [parameter for name, parameter in signature.parameters.items() if name not in named]
        run_each.__signature__ = signature.replace(parameters=left)  # type: ignore[union-attr]
        return run_each

    return decorate


def _values(case: Any, count: int) -> tuple[Any, ...]:
    """Return the values of a case: itself, the elements of a tuple, or those of a ``pytest.param``."""
    if hasattr(case, "marks"):
        assert not case.marks
        return tuple(case.values)
    return (case,) if count == 1 else tuple(case)


@contextmanager
def _named(case: Mapping[str, Any]) -> Iterator[None]:
    """Name the case in the traceback of its failure."""
    try:
        yield
    except BaseException as error:
        error.add_note(f"in the case {dict(case)!r:.2000}")
        raise
