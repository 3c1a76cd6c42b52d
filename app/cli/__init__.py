"""The command ``lineside``. A command's module is imported only when that command runs."""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from types import ModuleType, SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import click

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

COMMANDS: dict[str, tuple[str, str]] = {
    "init": ("setup.init", "Write a commented lineside.toml to start from."),
    "serve": ("serving.serve", "Serve the dashboard and run one bus worker for each [[bus]]."),
    "demo": ("simulated.demo", "Run a simulated line and its dashboard; no configuration needed."),
    "worker": ("serving.worker", "Run one bus worker near the port, for a dashboard on another machine."),
    "simulate": ("simulated.simulate", "Run simulated units only and print the port to open."),
    "scan": ("wire.scan", "Find the addresses that respond, their baud rate and device."),
    "decode": ("wire.decode", "Decode the frames in some bytes."),
    "check": ("findings.check", "Check the configuration and list its faults."),
    "install-service": ("setup.install_service", "Install the dashboard as a service of systemd."),
    "status": ("site.status", "Show whether the dashboard of a configuration runs."),
    "report": ("site.report", "Show the hand-over report of a shift."),
    "support-bundle": (
        "site.support_bundle",
        "Write what helps to find a fault into one file, without secrets.",
    ),
    "user": ("setup.accounts", "Manage users: add, list, password, remove."),
    "token": ("setup.accounts", "Manage tokens of programs: create, list, revoke."),
    "certificate": ("setup.certificate", "Create and renew certificates of server and workers: create."),
    "audit": ("site.audit", "Verify the event log: verify, rotate-key."),
    "publish": ("stores.publish", "Fill a past into the plant's database."),
    "backup": ("api.parameters", "Write the parameters of a unit or a bus to a file."),
    "diff": ("api.parameters", "Show the differences of a unit and a file, or of two files."),
    "restore": ("api.parameters", "Write the rows of a file that differ to a unit."),
    "backup-store": ("stores.backup_store", "Copy the stores of a running dashboard into one file."),
    "restore-store": ("stores.restore_store", "Replace the current stores with a backup."),
}
"""Name → module in this package, which has the click command of that name, and its line in the help."""

WITHDRAWN = {"home": "home_withdrawn", "migrate-store": "migrate_store_of_former_version"}
"""Name of a former command → the code of the message that names what takes its place."""


@contextmanager
def loading() -> Iterator[None]:
    """Hold the garbage collector back while code is imported, and keep what was loaded out of every later
    collection: that takes a fourteenth of the start, and later pauses of 50 ms."""
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


class Lazy(click.Group):
    """Knows every command by name and imports none before it is called. The errors of a command end in one
    line and an exit code here."""

    def list_commands(self, ctx: click.Context | None) -> list[str]:  # noqa: ARG002
        return list(COMMANDS)

    def get_command(self, ctx: click.Context | None, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        """Import the module of a command; None for an unknown name. Raises click.UsageError for a former
        one."""
        if cmd_name in WITHDRAWN:
            from bus.messages import Message

            raise click.UsageError(str(Message(WITHDRAWN[cmd_name])))
        if cmd_name not in COMMANDS:
            return None
        with loading():
            module = import_module(f"app.cli.{COMMANDS[cmd_name][0]}")
        command: click.Command = getattr(module, cmd_name.replace("-", "_"))
        return command

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """The commands that begin so, each with its line in the help; no module is imported for it."""
        from click.shell_completion import CompletionItem

        found = [(name, words) for name, (_, words) in COMMANDS.items() if name.startswith(incomplete)]
        options = click.Command.shell_complete(self, ctx, incomplete)
        return [*(CompletionItem(name, help=words) for name, words in found), *options]

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command, and end in words."""
        from app.cli.ending import ending  # not for --help and --version, which take no command

        with ending():
            return super().invoke(ctx)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        """List every command without its module."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, words) for name, (_, words) in COMMANDS.items()])


def _print_version(ctx: click.Context, _: click.Parameter, requested: bool) -> None:
    if requested:
        from app.version import VERSION

        click.echo(f"lineside {VERSION}")
        ctx.exit()


cli = Lazy(
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
    # Everything that any command writes is for its user alone.
    os.umask(0o077)
    # Pydantic would read the metadata of all installed packages for its plugins; there are none.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    # FastAPI would load the former version of Pydantic, 2 MiB, to refuse its models; there are none.
    sys.modules.setdefault("pydantic.v1", cast(ModuleType, None))
    # Uvicorn would load its command line and multiprocessing; this server is started without.
    uvicorn_main = SimpleNamespace(Server=None, main=None, run=None)
    sys.modules.setdefault("uvicorn.main", cast(ModuleType, uvicorn_main))
    cli(prog_name="lineside")
