"""``lineside user`` and ``lineside token``: who may sign in, and keys for programs. The dashboard may run."""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Annotated, Any, TypeVar

import click

from app.auth.accounts import Accounts
from app.auth.store import Token, User, tokens, users
from app.cli.config_option import LINESIDE_TOML, Config
from app.cli.options import Argument, AsJson, CommandGroup, Option
from app.cli.site.log import console, site_log
from app.cli.site.reading import reading_site
from app.settings import load
from app.web.admission.access import PEOPLE_ROLES, Role, role_named
from bus.errors import CallerError
from bus.messages import Message
from bus.text import composed

T = TypeVar("T")
MAX_LINE = 10_000

user = CommandGroup(help="Manage users.")
token = CommandGroup(help="Manage tokens of programs.")

UserName = Annotated[str, Argument(help="The name to log in with.", convert=composed)]
FromInput = Annotated[bool, Option("--password-stdin", help="Read the password from standard input.")]
TokenName = Annotated[str, Argument(help="Name of the token; unique.", convert=composed)]


def with_accounts(config: Path, work: Callable[[Accounts], Coroutine[Any, Any, T]]) -> T:
    """Run ``work`` on the accounts. Raises ConfigurationError, StoreError, CallerError in words."""
    settings = load(config)
    buses = [bus.name for bus in settings.bus]
    with site_log(settings) as (database, events):
        return asyncio.run(work(Accounts(database, events, buses=buses, site=settings.site.name)))


@user.add("add")
def add_user(
    name: UserName,
    role: Annotated[str, Option(help=f"One of {', '.join(PEOPLE_ROLES)}.")],
    password_stdin: FromInput = False,
    config: Config = LINESIDE_TOML,
) -> None:
    """Add a user."""
    store_user(config, name, role_named(role), _password(password_stdin))


def store_user(config: Path, name: str, role: Role, password: str) -> None:
    """Raises CallerError for a name or a password that cannot be chosen."""
    with_accounts(config, lambda accounts: accounts.add_user(name, role, password, by=console()))


@user.add("list")
def list_users(config: Config = LINESIDE_TOML, as_json: AsJson = False) -> None:
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


@user.add("password")
def set_password(name: UserName, password_stdin: FromInput = False, config: Config = LINESIDE_TOML) -> None:
    """Set a new password of a user; every session of that user ends."""
    new = _password(password_stdin)
    with_accounts(config, lambda accounts: accounts.set_password(name, new, by=console()))


@user.add("remove")
def remove_user(name: UserName, config: Config = LINESIDE_TOML) -> None:
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
    """Whether it may be chosen is judged where it is stored, for the pages alike. A terminal is prompted in
    any case: it must not wait without a prompt."""
    if not sys.stdin.isatty():
        if not from_input:
            raise CallerError(Message("password_without_terminal"))
        return sys.stdin.readline(MAX_LINE).rstrip("\r\n")
    return prompted_password()


def prompted_password() -> str:
    """What a terminal is prompted for twice, without echo."""
    typed: str = click.prompt("Password", hide_input=True, confirmation_prompt=True)
    return typed


@token.add("create")
def create_token(
    name: TokenName,
    role: Annotated[str, Option(help=f"One of {', '.join(Role)}.")],
    bus: Annotated[str, Option(help="Bus of a token with the role worker.")] = "",
    expires: Annotated[
        int | None,
        Option(metavar="DAYS", help="Days until it expires; without it, the token does not expire."),
    ] = None,
    config: Config = LINESIDE_TOML,
) -> None:
    """Create a bearer token and print it once."""
    chosen = role_named(role, Role)
    secret = with_accounts(
        config,
        lambda accounts: accounts.create_token(name, chosen, bus=bus, expires_days=expires, by=console()),
    )
    click.echo(secret)


@token.add("list")
def list_tokens(config: Config = LINESIDE_TOML, as_json: AsJson = False) -> None:
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


@token.add("revoke")
def revoke_token(name: TokenName, config: Config = LINESIDE_TOML) -> None:
    """Revoke a token."""
    with_accounts(config, lambda accounts: accounts.revoke_token(name, by=console()))
