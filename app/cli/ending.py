"""Exit codes of a command: 0 done, 1 failed, 2 wrong use; what it reports, in English."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

import click

from bus.errors import CallerError, LinesideError
from bus.messages import Message, ParamValue


@contextmanager
def ending() -> Iterator[None]:
    """Turn the errors of this project into a text and an exit code."""
    try:
        yield
    except CallerError as error:
        complain(error.message)
        raise click.exceptions.Exit(2) from error
    except LinesideError as error:
        complain(error.message)
        raise click.exceptions.Exit(1) from error
    except click.Abort:
        if sys.stdin.isatty():
            raise
        complain(Message("prompt_without_response"))
        raise click.exceptions.Exit(2) from None
    except BrokenPipeError:
        raise  # the reader of the output has left: click ends without a message
    except OSError as error:
        complain(Message.of("system_error", error=str(error)))
        raise click.exceptions.Exit(1) from error


def wrong_option(option: str, code: str, **params: ParamValue) -> click.BadParameter:
    """A value of ``option`` that cannot be, by the code of its message: exit code 2."""
    return click.BadParameter(str(Message(code, params)), param_hint=option)


def report(message: Message, *, err: bool = False) -> None:
    """A line of standard output, or of standard error."""
    click.echo(str(message), err=err)


def complain(reason: Message) -> None:
    """A line of standard error that names the program, as Unix tools do."""
    report(Message.of("command_failed", reason=reason), err=True)
