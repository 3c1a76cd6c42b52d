"""``lineside check``: the configuration, and whether this machine can run it."""

from __future__ import annotations

import asyncio
import json
import os
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path

import click

from app.cli.ending import complain, report
from app.cli.findings import machine, stores
from app.cli.findings.backup import backup_findings
from app.cli.findings.machine import Finding, fault, user
from app.cli.options import config_option, json_option
from app.cli.setup.rights import become_owner_of
from app.core.server.settings import SecretFileError, can_others_read, read_secret_text
from app.core.web.shape import message_shown
from app.people.auth.settings import OidcSettings
from app.people.auth.single_sign_on import provider_of, require_package
from app.records.notification.plan import NotificationEndpoint, NotificationPlan
from app.records.notification.rules import NotDeliveredError
from app.records.notification.senders import apprise_service, reach_hook, reach_mail_server
from app.records.notification.settings import AppriseSettings, NotifySettings, WebhookSettings
from app.settings import Settings, load
from bus.errors import LinesideError
from bus.messages import Message

CHECK_S = 15.0


@click.command
@config_option
@click.option(
    "--live",
    is_flag=True,
    help="Try what the configuration names: ports, folders, certificates, address, store. Nothing is"
    " sent to a unit, and a running Lineside is left alone.",
)
@json_option
def check(config: Path, live: bool, as_json: bool) -> None:
    """Check the configuration and this machine; faults are listed by file and line. Exit 0 or 1."""
    settings = load(config)
    found = [*found_of(settings, config.absolute(), live=live)]
    if as_json:
        shown = [{"fault": each.is_fault, **message_shown(each.message)} for each in found]
        click.echo(json.dumps({"config": str(config), "site": settings.site.name, "findings": shown}))
    else:
        report(Message.of("check_configuration", file=str(config), site=settings.site.name))
        for finding in found:
            _print(finding)
    if any(finding.is_fault for finding in found):
        raise click.exceptions.Exit(1)


def found_of(settings: Settings, config: Path, *, live: bool) -> Iterator[Finding]:
    """Judge with the rights of the service, also where root calls: what it may not read is a fault."""
    if live:
        from app.cli.findings import live as trials

        # Root sees the programs of every user.
        users = trials.port_users(settings)
    become_owner_of(settings.server.data)
    if not os.access(config, os.R_OK):
        yield fault("live_configuration_unreadable", user=user(), file=str(config))
    for row in (*OF_MACHINE, *OF_NETWORK):
        yield from row(settings)
    if live:
        from app.cli.findings.peers import peer_findings
        from app.cli.findings.postgresql import postgresql_findings

        yield from trials.live_findings(settings, users)
        yield from postgresql_findings(settings)
        yield from peer_findings(settings)


def _print(finding: Finding) -> None:
    if finding.is_fault:
        complain(finding.message)
    else:
        click.echo(f"  {finding.message}")


def oidc(settings: Settings) -> Iterator[Finding]:
    """The package, the file of the secret, and the provider of company accounts, which is only read."""
    if (wanted := settings.oidc) is None:
        return
    try:
        require_package()
    except LinesideError as error:
        yield Finding(error.message, is_fault=True)
        return
    try:
        read_secret_text(wanted.client_secret_file)
    except SecretFileError as error:
        yield Finding(error.message, is_fault=True)
    if can_others_read(wanted.client_secret_file):
        yield Finding(Message.of("check_secret_open", path=str(wanted.client_secret_file)))
    reason = asyncio.run(_fault_of(wanted))
    if reason is not None:
        yield fault("check_oidc_failed", issuer=wanted.issuer, reason=reason)
    else:
        yield Finding(Message.of("check_oidc", issuer=wanted.issuer))


async def _fault_of(settings: OidcSettings) -> Message | None:
    provider = provider_of(settings)
    try:
        await provider.refresh()
    finally:
        await provider.close()
    return provider.fault


def notification(site: Settings) -> Iterator[Finding]:
    """The mail server, each program, each roster, and the files of secrets. Nothing is sent."""
    settings = site.notify
    plan = NotificationPlan(settings)
    for name in plan.rosters:
        yield from (Finding(message, is_fault=True) for message in plan.gaps(name))
    if plan.endpoints and settings.dashboard_url is None:
        yield Finding(Message("check_notify_no_links"))
    for path in _secret_files(settings):
        if can_others_read(path):
            yield Finding(Message.of("check_secret_open", path=str(path)))
    if settings.smtp is not None:
        place = f"{settings.smtp.host}:{settings.smtp.port}"
        reached = Message.of("check_notify_mail", address=place)
        yield _tried(place, reach_mail_server(settings.smtp), reached)
    for endpoint in plan.endpoints.values():
        if endpoint.settings is not None:
            reached = Message.of(f"check_notify_{endpoint.kind}", address=endpoint.address)
            yield _tried(endpoint.address, _reach(endpoint), reached)


async def _reach(endpoint: NotificationEndpoint) -> None:
    match endpoint.settings:
        case WebhookSettings() as settings:
            await reach_hook(settings)
        case AppriseSettings() as settings:
            apprise_service(settings)


def _tried(address: str, attempt: Awaitable[None], reached: Message) -> Finding:
    try:
        asyncio.run(_bounded(attempt))
    except LinesideError as error:
        message = Message.of("check_notify_failed", address=address, reason=error.message)
        return Finding(message, is_fault=True)
    return Finding(reached)


async def _bounded(attempt: Awaitable[None]) -> None:
    try:
        async with asyncio.timeout(CHECK_S):
            await attempt
    except TimeoutError:
        raise NotDeliveredError(Message.of("notify_took_too_long", seconds=round(CHECK_S))) from None


def _secret_files(settings: NotifySettings) -> Iterator[Path]:
    smtp = settings.smtp
    found = [
        None if smtp is None else smtp.password_file,
        *(path for hook in settings.webhook for path in (hook.secret_file, hook.url_file)),
        *(each.url_file for each in settings.apprise),
    ]
    yield from (path for path in found if path is not None)


OF_MACHINE: tuple[Callable[[Settings], Iterator[Finding]], ...] = (
    machine.former_settings,
    machine.address,
    stores.encryption,
    machine.data,
    stores.key,
    stores.anchor,
    stores.archive,
    machine.buses,
    stores.certificates,
    stores.disk,
    stores.stores,
    backup_findings,
    machine.service,
)
OF_NETWORK = (oidc, notification)
"""These call other machines."""
