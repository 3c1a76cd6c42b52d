"""``lineside check``: the configuration, whether this machine can run it, and whether what it names
responds."""

from __future__ import annotations

import asyncio
import json
import os
from collections.abc import Awaitable, Iterator
from pathlib import Path
from secrets import token_hex

import click

from app.cli import check_live
from app.cli.findings import OF_MACHINE, Check, Finding, fault, info, user
from app.cli.options import config_option, json_option
from app.cli.process import become_owner_of, complain, report
from app.cli.status import peer_faults
from app.core.database.connection import examining, has_table
from app.core.server.settings import SecretFileError, can_others_read, read_secret_text
from app.core.web.shape import message_shown
from app.errors import StoreError
from app.people.auth.settings import OidcSettings
from app.people.auth.single_sign_on import provider_of, require_package
from app.records.notification.plan import NotificationEndpoint, NotificationPlan
from app.records.notification.rules import NotDeliveredError
from app.records.notification.senders import apprise_service, reach_hook, reach_mail_server
from app.records.notification.settings import AppriseSettings, NotifySettings, WebhookSettings
from app.settings import Settings, load
from app.system.postgresql.destination import Destination
from app.system.postgresql.outbox import read_identity
from app.system.postgresql.publisher import PublisherStatus
from bus.errors import LinesideError
from bus.instants import unix_now
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
    found = [*_found_of(settings, config.absolute(), live=live)]
    if as_json:
        shown = [{"fault": each.is_fault, **message_shown(each.message)} for each in found]
        click.echo(json.dumps({"config": str(config), "site": settings.site.name, "findings": shown}))
    else:
        report(Message.of("check_configuration", file=str(config), site=settings.site.name))
        for finding in found:
            if finding.is_fault:
                complain(finding.message)
            else:
                click.echo(f"  {finding.message}")
    if any(finding.is_fault for finding in found):
        raise click.exceptions.Exit(1)


def _found_of(settings: Settings, config: Path, *, live: bool) -> Iterator[Finding]:
    """Check with the rights of the service, also if root calls: what the service may not read is a fault."""
    users = check_live.port_users(settings) if live else {}  # root sees the programs of every user
    become_owner_of(settings.server.data)
    if not os.access(config, os.R_OK):
        yield fault("live_configuration_unreadable", user=user(), file=str(config))
    for each in (*OF_MACHINE, *OF_NETWORK):
        yield from each(settings)
    if live:
        yield from check_live.live_findings(settings, users)
        yield from postgresql(settings)
        yield from peers(settings)


def _open_secrets(*files: Path | None) -> Iterator[Finding]:
    """Name the files of secrets that every user of this machine can read."""
    yield from (info("check_secret_open", path=str(path)) for path in files if path and can_others_read(path))


def oidc(settings: Settings) -> Iterator[Finding]:
    """Try the package, the file of the secret, and the provider of company accounts, which is only read."""
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
    yield from _open_secrets(wanted.client_secret_file)
    reason = asyncio.run(_provider_fault(wanted))
    if reason is not None:
        yield fault("check_oidc_failed", issuer=wanted.issuer, reason=reason)
    else:
        yield info("check_oidc", issuer=wanted.issuer)


async def _provider_fault(settings: OidcSettings) -> Message | None:
    provider = provider_of(settings)
    try:
        await provider.refresh()
    finally:
        await provider.close()
    return provider.fault


def notification(site: Settings) -> Iterator[Finding]:
    """Try the mail server, each program, each roster, and the files of secrets. Nothing is sent."""
    settings = site.notify
    plan = NotificationPlan(settings)
    for name in plan.rosters:
        yield from (Finding(message, is_fault=True) for message in plan.gaps(name))
    if plan.endpoints and settings.dashboard_url is None:
        yield info("check_notify_no_links")
    yield from _open_secrets(*_secret_files(settings))
    if settings.smtp is not None:
        place = f"{settings.smtp.host}:{settings.smtp.port}"
        yield _tried(place, reach_mail_server(settings.smtp), "mail")
    for endpoint in plan.endpoints.values():
        if endpoint.settings is not None:
            yield _tried(endpoint.address, _reach(endpoint), endpoint.kind)


async def _reach(endpoint: NotificationEndpoint) -> None:
    match endpoint.settings:
        case WebhookSettings() as settings:
            await reach_hook(settings)
        case AppriseSettings() as settings:
            apprise_service(settings)


def _tried(address: str, attempt: Awaitable[None], kind: str) -> Finding:
    try:
        asyncio.run(_bounded(attempt))
    except LinesideError as error:
        return fault("check_notify_failed", address=address, reason=error.message)
    return Finding(Message.of(f"check_notify_{kind}", address=address))


async def _bounded(attempt: Awaitable[None]) -> None:
    try:
        async with asyncio.timeout(CHECK_S):
            await attempt
    except TimeoutError:
        raise NotDeliveredError(Message.of("notify_took_too_long", seconds=round(CHECK_S))) from None


def _secret_files(settings: NotifySettings) -> Iterator[Path | None]:
    yield None if settings.smtp is None else settings.smtp.password_file
    for hook in settings.webhook:
        yield from (hook.secret_file, hook.url_file)
    yield from (each.url_file for each in settings.apprise)


def postgresql(settings: Settings) -> Iterator[Finding]:
    """Try the plant's database: the file of its password, the server, the rights, the tables, and the
    clocks."""
    to = settings.postgresql
    if to is None:
        return
    yield from _open_secrets(to.password_file)
    destination = Destination(to, settings.site.name, _identity(settings), settings.bus)
    try:
        ahead = destination.examine()
    except StoreError as error:
        yield Finding(error.message, is_fault=True)
        return
    finally:
        destination.abandon()
    yield info("check_postgresql", place=to.place, schema=to.db_schema)
    notice = PublisherStatus(to.place, unix_now(), clock_ahead_s=ahead).notice
    if notice is not None:
        yield Finding(notice, is_fault=True)


def _identity(settings: Settings) -> str:
    """Return the identity in the store; before its first start a server has none that a database knows."""
    try:
        with examining(settings.server.store) as connection:
            if has_table(connection, "publisher_identity"):
                return read_identity(connection)
    except StoreError:
        pass  # found by the check of the stores
    return token_hex(16)


def peers(settings: Settings) -> Iterator[Finding]:
    """Read each peer once, and look at the files of their tokens."""
    for peer in settings.peer:
        yield from _open_secrets(peer.token_file)
        if peer.is_in_clear:
            yield info("check_peer_in_clear", peer=peer.name, url=peer.url)
    for peer, reason in peer_faults(settings):
        if reason is None:
            yield info("check_peer", peer=peer.name, url=peer.url)
        else:
            yield fault("peer_not_read", peer=peer.name, reason=reason)


OF_NETWORK: tuple[Check, ...] = (oidc, notification)
"""The checks that call other machines."""
