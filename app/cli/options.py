"""A command from the signature of a function: each parameter has its option or argument as an annotation."""

from __future__ import annotations

import inspect
import types
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin, get_type_hints

import click

F = TypeVar("F", bound=Callable[..., Any])
SETTINGS = {"show_default": True, "help_option_names": ["-h", "--help"]}


class Option:
    """Declares an option: its names (by default that of the parameter), and what click takes for one. ``min``
    and ``max`` are the range of a number."""

    def __init__(
        self, *names: str, min: int | None = None, max: int | None = None, **attributes: Any
    ) -> None:
        self._names = names
        self._range = (min, max)
        self._attributes = attributes

    def parameter(self, name: str, kind: Any, default: Any) -> click.Parameter:
        """The option of a parameter of type ``kind``; without a default it is required."""
        kind, is_list = _element(kind)
        names = self._names or (f"--{name.replace('_', '-')}",)
        if kind is bool:
            if not self._names and default:
                names = (f"{names[0]}/--no-{names[0][2:]}",)
            return click.Option([name, *names], is_flag=True, default=default, **self._attributes)
        return click.Option(
            [name, *names],
            type=_type_of(kind, *self._range),
            multiple=is_list,
            callback=_listed if is_list else None,
            required=default is inspect.Parameter.empty,
            **_shown(default),
            **self._attributes,
        )


class Argument:
    """Declares an argument, which has its place instead of a name."""

    def __init__(
        self, *, help: str, metavar: str | None = None, convert: Callable[[str], str] | None = None
    ) -> None:
        self._help = help
        self._metavar = metavar
        self._convert = convert

    def parameter(self, name: str, kind: Any, default: Any) -> click.Parameter:
        """The argument of a parameter of type ``kind``; a list takes all that is left."""
        kind, is_list = _element(kind)
        return click.Argument(
            [name],
            help=self._help,
            type=_type_of(kind),
            nargs=-1 if is_list else 1,
            callback=_listed if is_list else self._converted,
            required=default is inspect.Parameter.empty,
            metavar=self._metavar,
        )

    def _converted(self, _context: click.Context, _parameter: click.Parameter, value: Any) -> Any:
        return value if self._convert is None else self._convert(value)


AsJson = Annotated[bool, Option("--json", help="The result as JSON.")]


def command_of(function: Callable[..., Any], name: str | None = None) -> click.Command:
    """The command that calls ``function``; its docstring is the help."""
    return click.Command(
        name or function.__name__.replace("_", "-"),
        callback=function,
        params=parameters_of(function),
        help=inspect.getdoc(function),
        context_settings=SETTINGS,
    )


def parameters_of(function: Callable[..., Any]) -> list[click.Parameter]:
    """The option or the argument of each parameter, in order."""
    hints = get_type_hints(function, include_extras=True)
    found = []
    for name, parameter in inspect.signature(function).parameters.items():
        kind, declared = get_args(hints[name])
        found.append(declared.parameter(name, kind, parameter.default))
    return found


class CommandGroup(click.Group):
    """A command with subcommands, each of them a function. ``alone``: the function of a call without any."""

    def __init__(self, help: str, alone: Callable[..., Any] | None = None) -> None:
        super().__init__(
            help=help,
            callback=alone and _without_subcommand(alone),
            params=parameters_of(alone) if alone else [],
            invoke_without_command=alone is not None,
            context_settings=SETTINGS,
        )

    def add(self, name: str) -> Callable[[F], F]:
        """Make the decorated function the subcommand ``name``."""

        def added(function: F) -> F:
            self.add_command(command_of(function, name))
            return function

        return added


def _without_subcommand(function: Callable[..., Any]) -> Callable[..., Any]:
    def called(**values: Any) -> None:
        if click.get_current_context().invoked_subcommand is None:
            function(**values)

    return called


def _element(kind: Any) -> tuple[Any, bool]:
    """The type of one value, and whether there may be several."""
    if get_origin(kind) in (Union, types.UnionType):
        (kind,) = (each for each in get_args(kind) if each is not types.NoneType)
    if get_origin(kind) is Annotated:
        kind = get_args(kind)[0]
    if get_origin(kind) is list:
        return get_args(kind)[0], True
    return kind, False


def _listed(_: click.Context, __: click.Parameter, values: tuple[Any, ...]) -> list[Any]:
    return list(values)


def _type_of(kind: type, least: int | None = None, most: int | None = None) -> click.ParamType[Any]:
    if kind is Path:
        return click.Path(path_type=Path)
    if (least, most) != (None, None):
        return click.IntRange(least, most) if kind is int else click.FloatRange(least, most)
    return click.types.convert_type(kind)


def _shown(default: Any) -> Mapping[str, Any]:
    """The default, and that an empty one is not in the help."""
    if default is inspect.Parameter.empty:
        return {}
    return {"default": default, "show_default": default not in (None, "")}
