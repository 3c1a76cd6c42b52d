"""``python -m docs.generated``: write the chapters on command line and metrics, and the table of roles."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import click

from app.cli import cli
from app.core.web.access import PEOPLE_ROLES, Role
from app.line.commands.catalogue import COMMANDS
from app.line.history.status import HistoryStatus
from app.main import FEATURES
from app.people.audit.anchor import AnchorStatus
from app.system.metrics.families import LineCollector, Measured
from app.system.metrics.feature import OUTCOMES
from app.system.opcua.link import Status
from app.system.postgresql.publisher import PublisherStatus
from bus.instants import UnixTime

GUIDE = Path(__file__).parent / "guide"
SECURITY = Path(__file__).parent / "security.md"
ROLES_HEAD = "| role | may |\n|---|---|\n"
SUFFIX = {"counter": "_total", "info": "_info"}
"""What Prometheus adds to the name of a metric of a type."""
COMMAND_LINE = """# The command line

`lineside --version` prints the release. Each command explains itself with `-h` or `--help`; each that prints
facts prints them with `--json` for programs. The shell completes commands and options after one line in its
start file:

- bash, `~/.bashrc`: `eval "$(_LINESIDE_COMPLETE=bash_source lineside)"`
- zsh, `~/.zshrc`: `eval "$(_LINESIDE_COMPLETE=zsh_source lineside)"`
- fish, `~/.config/fish/config.fish`: `_LINESIDE_COMPLETE=fish_source lineside | source`
"""
METRICS = """# Metrics

`GET /metrics` is for Prometheus, with the token of a viewer. A counter begins with 0 when the server, or for
the wire its bus worker, starts. A unit that is not online has no speed and no draw, so that a graph shows a
gap. `process_…` is the server itself.

`docs/deploy` has [a scrape](../deploy/prometheus/prometheus.yml),
[rules for alerts](../deploy/prometheus/lineside.rules.yml) on servers, wires and disks, and
[a dashboard for Grafana](../deploy/grafana/lineside.json).

| metric | type | labels | is |
|---|---|---|---|
"""


def command_line() -> str:
    """The chapter on the command line: each command with its options."""
    context = click.Context(cast(click.Command, cli), info_name="lineside", **cli.context_settings)
    return COMMAND_LINE + "".join(_commands(context, cast(click.Group, cli)))


def _commands(above: click.Context, group: click.Group) -> Iterator[str]:
    for name in group.list_commands(above):
        _, command, _ = group.resolve_command(above, [name])
        assert command is not None
        context = click.Context(command, parent=above, info_name=name)
        yield f"\n## {context.command_path}\n\n{_words(command.help)}\n"
        rows = [row for each in command.params for row in _parameter(context, each)]
        if rows:
            yield "\n| option | is |\n|---|---|\n" + "".join(rows)
        if isinstance(command, click.Group):
            yield from _commands(context, command)


def _parameter(context: click.Context, parameter: click.Parameter) -> Iterator[str]:
    if isinstance(parameter, click.Argument):
        yield f"| `{parameter.make_metavar(context)}` | {_words(getattr(parameter, 'help', ''))} |\n"
    elif shown := parameter.get_help_record(context):
        yield f"| `{_words(shown[0])}` | {_words(shown[1])} |\n"


def _words(text: str | None) -> str:
    return " ".join((text or "").split()).replace("|", "\\|")


def metrics() -> str:
    """The chapter on the metrics: each with its type and labels."""
    return METRICS + "".join(
        f"| `{_name(family)}` | {family.type} | {_labels(family)} | {family.documentation} |\n"
        for family in LineCollector(_nothing()).collect()
    )


def metric_names() -> set[str]:
    """Every metric of our own, as Prometheus names it."""
    return {_name(family) for family in LineCollector(_nothing()).collect()}


def _name(family: Any) -> str:
    return f"{family.name}{SUFFIX.get(family.type, '')}"


def _labels(family: Any) -> str:
    names = family._labelnames or (family.samples[0].labels if family.samples else ())
    return ", ".join(f"`{name}`" for name in names)


def _nothing() -> Measured:
    """What is measured of a server without buses, which has every family of metrics."""
    sources = {
        "live": SimpleNamespace(buses={}),
        "commands": dict.fromkeys(OUTCOMES, 0),
        "alarms": SimpleNamespace(
            present=list, buses={}, list_of=lambda _: SimpleNamespace(annunciated=Counter())
        ),
        "pages": 0,
        "anchor": AnchorStatus(),
        "history": HistoryStatus(),
        "newest_backup": UnixTime(0.0),
        "publisher": PublisherStatus("", UnixTime(0.0)),
        "nodes": (),
        "opcua": (SimpleNamespace(status=Status(), restarts=0),),
        "data": GUIDE,
    }
    return Measured(**cast(dict[str, Any], sources))


def security() -> str:
    """The chapter on security, its table of roles from the acts and commands that there are."""
    before, head, rest = SECURITY.read_text(encoding="utf-8").partition(ROLES_HEAD)
    after = rest.partition("\n\n")[2]
    rows = "\n".join(f"| {role} | {_operations(role)} |" for role in PEOPLE_ROLES)
    return f"{before}{head}{rows}\n\n{after}"


def _operations(role: Role) -> str:
    names = [act.name for feature in FEATURES for act in feature.acts if act.role == role]
    names += [_snake(request.__name__) for request, kind in COMMANDS.items() if kind.role == role]
    reads = ["read everything but secrets, accounts and the configuration"] if role == Role.VIEWER else []
    return ", ".join([*reads, *(f"`{name}`" for name in sorted(names))])


def _snake(name: str) -> str:
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()


CHAPTERS = {
    GUIDE / "command-line.md": command_line,
    GUIDE / "metrics.md": metrics,
    SECURITY: security,
}

if __name__ == "__main__":
    for path, written in CHAPTERS.items():
        path.write_text(written(), encoding="utf-8")
