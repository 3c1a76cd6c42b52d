"""``lineside check``: the configuration, and whether this machine can run it."""

from __future__ import annotations

import json

import click

from app.cli.backup_findings import backup_findings
from app.cli.config_option import LINESIDE_TOML, Config
from app.cli.ending import complain, report
from app.cli.findings import Finding, findings
from app.cli.notification_findings import notification_findings
from app.cli.options import AsJson
from app.cli.service_findings import service_findings
from app.cli.store_findings import store_findings
from app.settings import load
from app.web.shape import message_shown
from bus.messages import Message


def check(config: Config = LINESIDE_TOML, as_json: AsJson = False) -> None:
    """Check the configuration and this machine; faults are listed by file and line. Exit 0 or 1."""
    settings = load(config)
    found = [
        *findings(settings),
        *store_findings(settings),
        *backup_findings(settings.backup, settings.server.data),
        *notification_findings(settings.notify),
        *service_findings(),
    ]
    if as_json:
        shown = [{"fault": each.is_fault, **message_shown(each.message)} for each in found]
        click.echo(json.dumps({"config": str(config), "site": settings.site.name, "findings": shown}))
    else:
        report(Message.of("check_configuration", file=str(config), site=settings.site.name))
        for finding in found:
            _print(finding)
    if any(finding.is_fault for finding in found):
        raise click.exceptions.Exit(1)


def _print(finding: Finding) -> None:
    if finding.is_fault:
        complain(finding.message)
    else:
        click.echo(f"  {finding.message}")
