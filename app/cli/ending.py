"""Exit codes of a command: 0 done, 1 failed, 2 wrong use; errors in one line on standard error."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import typer

from bus.errors import CallerError, LinesideError


@contextmanager
def ending() -> Iterator[None]:
    """Turn the errors of this project into a text and an exit code."""
    try:
        yield
    except CallerError as error:
        typer.echo(f"lineside: {error}", err=True)
        raise typer.Exit(2) from error
    except (LinesideError, OSError) as error:
        typer.echo(f"lineside: {error}", err=True)
        raise typer.Exit(1) from error
