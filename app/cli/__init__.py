"""The command ``lineside``. A command's module is read only when that command is asked for."""

from __future__ import annotations

import os
from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperGroup
from typer.main import get_group

from app.cli.loading import loading

COMMANDS: dict[str, tuple[str, str]] = {
    "init": ("init", "Write a commented lineside.toml to start from."),
    "serve": ("serve", "The dashboard and one bus worker for each [[bus]]."),
    "demo": ("demo", "A simulated line and its dashboard, nothing to configure."),
    "worker": ("worker", "One bus worker alone, near the port, for a dashboard elsewhere."),
    "simulate": ("simulate", "Simulated units alone: prints the port to open."),
    "scan": ("scan", "Which addresses answer, at which baud, what they are."),
    "decode": ("decode", "What the frames in some bytes say."),
    "check": ("check", "Read the configuration and say what is wrong."),
    "status": ("status", "Whether the dashboard of a configuration runs."),
    "user": ("user", "Who may sign in: add, list, password, remove."),
    "token": ("token", "Keys for programs: create, list, revoke."),
    "audit": ("audit", "Prove that the audit log is whole: audit verify."),
    "backup": ("backup", "The parameters of a unit or of a bus into a file."),
    "diff": ("diff", "What differs between a unit and a file, or two files."),
    "restore": ("restore", "Write to a unit what a file says and it does not."),
    "backup-store": ("backup_store", "A copy of the whole store of a running dashboard."),
    "restore-store": ("backup_store", "Put such a copy in the place of the present store."),
}
"""Name → module in this package, and its line in the help."""


class Lazy(TyperGroup):
    """Knows every command by name and imports none before it is called."""

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ARG002
        """In the order of the table."""
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:  # noqa: ARG002
        """Import the module and let it register; None for an unknown name."""
        if cmd_name not in COMMANDS:
            return None
        cli = typer.Typer()
        with loading():
            import_module(f"app.cli.{COMMANDS[cmd_name][0]}").register(cli)
        return get_group(cli).commands[cmd_name]

    def format_commands(self, ctx: Any, formatter: Any) -> None:  # noqa: ARG002
        """The table."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, words) for name, (_, words) in COMMANDS.items()])


cli = typer.Typer(
    cls=Lazy,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    no_args_is_help=True,
)


def _print_version(requested: bool) -> None:
    if requested:
        from importlib.metadata import version

        typer.echo(f"lineside {version('lineside')}")
        raise typer.Exit


@cli.callback()
def lineside(
    _: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Which version this is.")
    ] = False,
) -> None:
    """Watch and set a line of DIGIMAX IV drives. Exit codes: 0 done, 1 it did not hold, 2 wrong use."""


def main() -> None:
    """The entry point."""
    from bus.worker.parent import named_parent, tie_to

    if parent := named_parent():
        tie_to(parent)
    # Everything that any command writes is for its user alone.
    os.umask(0o077)
    # Pydantic would read the metadata of everything installed for plugins of its own; we want none.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    cli(prog_name="lineside")
