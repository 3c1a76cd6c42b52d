"""``lineside check``: the configuration, and whether this machine can run it."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import click

from app.cli.config_option import LINESIDE_TOML, Config
from app.cli.ending import complain, report
from app.cli.findings.backup import backup_findings
from app.cli.findings.certificates import certificate_findings
from app.cli.findings.machine import Finding, fault, findings, user
from app.cli.findings.notification import notification_findings
from app.cli.findings.oidc import oidc_findings
from app.cli.findings.service import service_findings
from app.cli.findings.stores import store_findings
from app.cli.options import AsJson, Option
from app.cli.setup.rights import become_owner_of
from app.settings import Settings, load
from app.web.api.shape import message_shown
from bus.messages import Message


def check(
    config: Config = LINESIDE_TOML,
    live: Annotated[
        bool,
        Option(
            help="Try what the configuration names: ports, folders, certificates, address, store. Nothing is"
            " sent to a unit, and a running Lineside is left alone."
        ),
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Check the configuration and this machine; faults are listed by file and line. Exit 0 or 1."""
    settings = load(config)
    found = [*_findings(settings, config.absolute(), live=live)]
    if as_json:
        shown = [{"fault": each.is_fault, **message_shown(each.message)} for each in found]
        click.echo(json.dumps({"config": str(config), "site": settings.site.name, "findings": shown}))
    else:
        report(Message.of("check_configuration", file=str(config), site=settings.site.name))
        for finding in found:
            _print(finding)
    if any(finding.is_fault for finding in found):
        raise click.exceptions.Exit(1)


def _findings(settings: Settings, config: Path, *, live: bool) -> Iterator[Finding]:
    """Judge with the rights of the service, also where root calls: what it may not read is a fault."""
    if live:
        from app.cli.findings.ports import port_users

        # Root sees the programs of every user.
        users = port_users(settings)
    become_owner_of(settings.server.data)
    if not os.access(config, os.R_OK):
        yield fault("live_configuration_unreadable", user=user(), file=str(config))
    yield from findings(settings)
    yield from certificate_findings(settings)
    yield from store_findings(settings)
    yield from backup_findings(settings)
    yield from oidc_findings(settings.oidc)
    yield from notification_findings(settings.notify)
    yield from service_findings()
    if live:
        from app.cli.findings.live import live_findings
        from app.cli.findings.peers import peer_findings
        from app.cli.findings.postgresql import postgresql_findings

        yield from live_findings(settings, users)
        yield from postgresql_findings(settings)
        yield from peer_findings(settings)


def _print(finding: Finding) -> None:
    if finding.is_fault:
        complain(finding.message)
    else:
        click.echo(f"  {finding.message}")
