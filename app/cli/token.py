"""``lineside token``: keys for programs."""

from __future__ import annotations

from typing import Annotated

import typer

from app.auth.accounts import Accounts
from app.cli.accounts import console, with_accounts
from app.cli.serve import LINESIDE_TOML, Config
from app.web.access import Role, role_named
from bus.messages import Message

token = typer.Typer(help="Manage tokens of programs.", no_args_is_help=True)

TokenName = Annotated[str, typer.Argument(help="Name of the token; unique.")]


@token.command()
def create(
    name: TokenName,
    role: Annotated[str, typer.Option(help=f"One of {', '.join(Role)}.")],
    bus: Annotated[str, typer.Option(help="Bus of a token with the role worker.")] = "",
    expires: Annotated[
        int | None,
        typer.Option(metavar="DAYS", help="Days until it expires; without it, the token does not expire."),
    ] = None,
    config: Config = LINESIDE_TOML,
) -> None:
    """Create a bearer token and print it once."""
    chosen = role_named(role, Role)

    async def work(accounts: Accounts) -> str:
        return await accounts.create_token(name, chosen, bus=bus, expires_days=expires, by=console())

    typer.echo(with_accounts(config, work))


@token.command(name="list")
def list_all(config: Config = LINESIDE_TOML) -> None:
    """List every token: name, role, creator, bus of a worker, day on which it expires."""
    for each in with_accounts(config, lambda accounts: accounts.tokens()):
        expires = str(Message.of("token_expires", day=each.last_day)) if each.last_day else ""
        columns = (each.name, each.role, each.created_by, each.bus or "", expires)
        typer.echo("\t".join(columns).rstrip())


@token.command()
def revoke(name: TokenName, config: Config = LINESIDE_TOML) -> None:
    """Revoke a token."""
    with_accounts(config, lambda accounts: accounts.revoke_token(name, by=console()))
