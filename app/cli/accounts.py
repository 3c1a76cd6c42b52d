"""The commands ``lineside user`` and ``lineside token``: accounts of people and keys for programs, also while
the dashboard runs."""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any, TypeVar

import click

from app.cli.command import config_option, json_option
from app.cli.site import console, reading_site, site_log
from app.core.web.access import PEOPLE_ROLES, Role
from app.people.auth.accounts import Accounts
from app.people.auth.store import Token, User, tokens, users
from app.settings import load
from bus.errors import CallerError
from bus.messages import Message
from bus.validation import composed

T = TypeVar("T")
MAX_LINE = 10_000

user_name = click.argument("name", type=composed, help="The name to log in with.")
token_name = click.argument("name", type=composed, help="Name of the token; unique.")
from_input = click.option("--password-stdin", is_flag=True, help="Read the password from standard input.")


@click.group
def user() -> None:
    """Manage users."""


@click.group
def token() -> None:
    """Manage tokens of programs."""


def with_accounts(config: Path, work: Callable[[Accounts], Coroutine[Any, Any, T]]) -> T:
    """Run ``work`` on the accounts of a site. Raise ConfigurationError, StoreError, CallerError."""
    settings = load(config)
    buses = [bus.name for bus in settings.bus]
    with site_log(settings) as (database, events):
        return asyncio.run(work(Accounts(database, events, buses=buses, site=settings.site.name)))


@user.command("add")
@user_name
@click.option(
    "--role", type=click.Choice(list(map(str, PEOPLE_ROLES))), required=True, help="What the user may do."
)
@from_input
@config_option
def add_user(name: str, role: str, password_stdin: bool, config: Path) -> None:
    """Add a user."""
    store_user(config, name, Role(role), _password(password_stdin))


def store_user(config: Path, name: str, role: Role, password: str) -> None:
    """Add a user. Raise CallerError for a name or a password that is not acceptable."""
    with_accounts(config, lambda accounts: accounts.add_user(name, role, password, by=console()))


@user.command("list")
@config_option
@json_option
def list_users(config: Path, as_json: bool) -> None:
    """List every user: name, role, and whether it is a panel, of a company account, or disabled."""
    with reading_site(load(config)) as connection:
        found = users(connection)
    if as_json:
        click.echo(json.dumps({"users": [_user_shown(each) for each in found]}))
        return
    for each in found:
        states = (
            ("user_is_panel", each.panel),
            ("user_has_company_account", each.company_account is not None),
            ("user_is_disabled", each.disabled),
        )
        marks = [str(Message(code)) for code, is_so in states if is_so]
        click.echo("\t".join([each.name, each.role, *marks]))


@user.command("password")
@user_name
@from_input
@config_option
def set_password(name: str, password_stdin: bool, config: Path) -> None:
    """Set a new password for a user; every session of that user ends."""
    new = _password(password_stdin)
    with_accounts(config, lambda accounts: accounts.set_password(name, new, by=console()))


@user.command("remove")
@user_name
@config_option
def remove_user(name: str, config: Path) -> None:
    """Remove a user; the events of that user are kept."""
    with_accounts(config, lambda accounts: accounts.remove_user(name, by=console()))


def _user_shown(each: User) -> dict[str, Any]:
    return {
        "name": each.name,
        "role": each.role,
        "panel": each.panel,
        "company_account": each.company_account is not None,
        "disabled": each.disabled,
    }


def _token_shown(each: Token) -> dict[str, Any]:
    return {
        "name": each.name,
        "role": each.role,
        "created_by": each.created_by,
        "bus": each.bus,
        "last_day": each.last_day or None,
    }


def _password(from_input: bool) -> str:
    """Return the password that was typed or piped; the accounts check it. A terminal is always prompted: the
    command must not wait without a prompt."""
    if not sys.stdin.isatty():
        if not from_input:
            raise CallerError(Message("password_without_terminal"))
        return sys.stdin.readline(MAX_LINE).rstrip("\r\n")
    return prompted_password()


def prompted_password() -> str:
    """Prompt twice for a password, without echo."""
    typed: str = click.prompt("Password", hide_input=True, confirmation_prompt=True)
    return typed


@token.command("create")
@token_name
@click.option(
    "--role", type=click.Choice(list(map(str, Role))), required=True, help="What the program may do."
)
@click.option("--bus", default="", show_default=False, help="Bus of a token with the role worker.")
@click.option(
    "--expires",
    type=int,
    metavar="DAYS",
    help="Days until it expires; without it, the token does not expire.",
)
@config_option
def create_token(name: str, role: str, bus: str, expires: int | None, config: Path) -> None:
    """Create a bearer token and print it once."""
    secret = with_accounts(
        config,
        lambda accounts: accounts.create_token(name, Role(role), bus=bus, expires_days=expires, by=console()),
    )
    click.echo(secret)


@token.command("list")
@config_option
@json_option
def list_tokens(config: Path, as_json: bool) -> None:
    """List every token: name, role, creator, bus of a worker, day on which it expires."""
    with reading_site(load(config)) as connection:
        found = tokens(connection)
    if as_json:
        click.echo(json.dumps({"tokens": [_token_shown(each) for each in found]}))
        return
    for each in found:
        expires = str(Message.of("token_expires", day=each.last_day)) if each.last_day else ""
        columns = (each.name, each.role, each.created_by, each.bus or "", expires)
        click.echo("\t".join(columns).rstrip())


@token.command("revoke")
@token_name
@config_option
def revoke_token(name: str, config: Path) -> None:
    """Revoke a token."""
    with_accounts(config, lambda accounts: accounts.revoke_token(name, by=console()))
