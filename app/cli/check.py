"""``lineside check``: the configuration, and whether this machine can run it."""

from __future__ import annotations

import click

from app.cli.backup_findings import backup_findings
from app.cli.config_option import LINESIDE_TOML, Config
from app.cli.ending import complain, report
from app.cli.findings import findings
from app.cli.notification_findings import notification_findings
from app.cli.store_findings import store_findings
from app.settings import load
from bus.messages import Message


def check(config: Config = LINESIDE_TOML) -> None:
    """Check the configuration and this machine; faults are listed by file and line. Exit 0 or 1."""
    settings = load(config)
    report(Message.of("check_configuration", file=str(config), site=settings.site.name))
    faults = 0
    found = (
        *findings(settings),
        *store_findings(settings),
        *backup_findings(settings.backup),
        *notification_findings(settings.notify),
    )
    for finding in found:
        faults += finding.is_fault
        if finding.is_fault:
            complain(finding.message)
        else:
            click.echo(f"  {finding.message}")
    if faults:
        raise click.exceptions.Exit(1)
