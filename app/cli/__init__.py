"""The command ``lineside``. A command's module is imported only when the command runs."""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from types import ModuleType, SimpleNamespace
from typing import Any, cast

import click

COMMANDS: dict[str, tuple[str, str]] = {
    "init": ("init", "Write a commented lineside.toml to start from."),
    "serve": ("serve", "Serve the dashboard and run one bus worker for each [[bus]]."),
    "demo": ("demo", "Run a simulated line and its dashboard; no configuration needed."),
    "worker": ("serve", "Run one bus worker near the port, for a dashboard on another machine."),
    "simulate": ("wire", "Run simulated units only and print the port to open."),
    "scan": ("wire", "Find the addresses that respond, their baud rate and device."),
    "decode": ("wire", "Decode the frames in some bytes."),
    "check": ("check", "Check the configuration and list its faults."),
    "install-service": ("install_service", "Install the dashboard as a service of systemd."),
    "status": ("status", "Show whether the dashboard of a configuration runs."),
    "report": ("report", "Show the hand-over report of a shift."),
    "support-bundle": ("support_bundle", "Write what helps to find a fault into one file, without secrets."),
    "user": ("accounts", "Manage users: add, list, password, remove."),
    "token": ("accounts", "Manage tokens of programs: create, list, revoke."),
    "certificate": ("certificate", "Create and renew certificates of server and workers: create."),
    "audit": ("audit", "Verify the event log: verify, rotate-key."),
    "publish": ("publish", "Fill a past into the plant's database."),
    "backup": ("parameters", "Write the parameters of a unit or a bus to a file."),
    "diff": ("parameters", "Show the differences of a unit and a file, or of two files."),
    "restore": ("parameters", "Write the rows of a file that differ to a unit."),
    "backup-store": ("backup_store", "Copy the stores of a running dashboard into one file."),
    "restore-store": ("backup_store", "Replace the current stores with a backup."),
}
"""The module in this package with the click command of a name, and the command's line in the help."""

WITHDRAWN = {"home": "home_withdrawn", "migrate-store": "migrate_store_of_former_version"}
"""The code of the message that names the replacement of a former command, by the command's name."""


@contextmanager
def loading() -> Iterator[None]:
    """Keep the garbage collector off while code is imported, and keep what was loaded out of every later
    collection: that saves a fourteenth of the start, and later pauses of 50 ms."""
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


class Lazy(click.Group):
    """The group of all commands, which lists them by their lines of `COMMANDS` and imports the module of the
    called command. Errors of a command end in one line and an exit code."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        return list(self.commands)  # keep this order; click would sort the names

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Import the command at the start of ``args``. Raise click.UsageError for an unknown or a former
        command."""
        if args[0] in WITHDRAWN and not ctx.resilient_parsing:
            from bus.messages import Message

            raise click.UsageError(str(Message(WITHDRAWN[args[0]])))
        name, command, rest = super().resolve_command(ctx, args)
        if name is not None:
            with loading():
                module = import_module(f"app.cli.{COMMANDS[name][0]}")
            command = getattr(module, name.replace("-", "_"))
        return name, command, rest

    def invoke(self, ctx: click.Context) -> Any:
        from app.cli.command import ending  # not for --help and --version, which take no command

        with ending():
            return super().invoke(ctx)


def _print_version(ctx: click.Context, _: click.Parameter, requested: bool) -> None:
    if requested:
        from app.version import VERSION

        click.echo(f"lineside {VERSION}")
        ctx.exit()


cli = Lazy(
    commands=[click.Command(name, short_help=words) for name, (_, words) in COMMANDS.items()],
    help="Monitor and command a line of DIGIMAX IV drives. Exit codes: 0 done, 1 failed, 2 wrong use.",
    params=[
        click.Option(
            ["--version"],
            is_flag=True,
            is_eager=True,
            expose_value=False,
            callback=_print_version,
            help="Show the version.",
        )
    ],
    context_settings={"help_option_names": ["-h", "--help"], "show_default": True},
)


def main() -> None:
    from bus.worker.process import named_parent, tie_to

    if parent := named_parent():
        tie_to(parent)
    # All files that a command writes are for its user alone.
    os.umask(0o077)
    # Pydantic would read the metadata of all installed packages for plugins; there are none.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    # FastAPI would load the former version of Pydantic, 2 MiB, only to refuse its models.
    sys.modules.setdefault("pydantic.v1", cast(ModuleType, None))
    # Uvicorn would load its command line and multiprocessing; this server starts without them.
    uvicorn_main = SimpleNamespace(Server=None, main=None, run=None)
    sys.modules.setdefault("uvicorn.main", cast(ModuleType, uvicorn_main))
    cli(prog_name="lineside")
