"""``lineside user``: who may sign in."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from app.cli.accounts import console, with_accounts
from app.cli.serve import LINESIDE_TOML, Config
from app.web.access import PEOPLE_ROLES, role_named
from bus.messages import Message

LONGEST_LINE = 10_000

user = typer.Typer(help="Manage users.", no_args_is_help=True)

UserName = Annotated[str, typer.Argument(help="The name to log in with.")]
FromInput = Annotated[bool, typer.Option("--password-stdin", help="Read the password from standard input.")]


@user.command()
def add(
    name: UserName,
    role: Annotated[str, typer.Option(help=f"One of {', '.join(PEOPLE_ROLES)}.")],
    password_stdin: FromInput = False,
    config: Config = LINESIDE_TOML,
) -> None:
    """Add a user."""
    chosen, password = role_named(role), _password(password_stdin)
    with_accounts(config, lambda accounts: accounts.add_user(name, chosen, password, by=console()))


@user.command(name="list")
def list_all(config: Config = LINESIDE_TOML) -> None:
    """List every user: name, role, and whether it is a panel or disabled."""
    for each in with_accounts(config, lambda accounts: accounts.users()):
        states = (("user_is_panel", each.panel), ("user_is_disabled", each.disabled))
        marks = [str(Message(code)) for code, is_so in states if is_so]
        typer.echo("\t".join([each.name, each.role, *marks]))


@user.command()
def password(name: UserName, password_stdin: FromInput = False, config: Config = LINESIDE_TOML) -> None:
    """Set a new password of a user; every session of that user ends."""
    new = _password(password_stdin)
    with_accounts(config, lambda accounts: accounts.set_password(name, new, by=console()))


@user.command()
def remove(name: UserName, config: Config = LINESIDE_TOML) -> None:
    """Remove a user; the events of that user are kept."""
    with_accounts(config, lambda accounts: accounts.remove_user(name, by=console()))


def _password(from_input: bool) -> str:
    """Whether it may be chosen is judged where it is stored, for the pages alike. A terminal is prompted in
    any case: it must not wait without a prompt."""
    if from_input and not sys.stdin.isatty():
        return sys.stdin.readline(LONGEST_LINE).rstrip("\r\n")
    typed: str = typer.prompt("Password", hide_input=True, confirmation_prompt=True)
    return typed
