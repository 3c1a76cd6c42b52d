"""``lineside token``: keys for programs."""

from __future__ import annotations

from typing import Annotated

import typer

from app.cli.accounts import ORIGIN, who_calls, with_accounts
from app.cli.ending import ending
from app.cli.serve import LINESIDE_TOML, Config
from app.web.access import Role, role_named

tokens = typer.Typer(help="Keys for programs.", no_args_is_help=True)

Name = Annotated[str, typer.Argument(help="What the token is for; unique.")]


def register(cli: typer.Typer) -> None:
    """Add the group."""
    cli.add_typer(tokens, name="token")


@tokens.command()
def create(
    name: Name,
    role: Annotated[str, typer.Option(help=f"One of {', '.join(Role)}.")],
    config: Config = LINESIDE_TOML,
) -> None:
    """Create a bearer token and print it, this once."""
    with ending():
        chosen = role_named(role, Role)
        typer.echo(
            with_accounts(
                config, lambda accounts: accounts.create_token(name, chosen, by=who_calls(), origin=ORIGIN)
            )
        )


@tokens.command(name="list")
def list_all(config: Config = LINESIDE_TOML) -> None:
    """Every token: name, role, who created it."""
    with ending():
        for token in with_accounts(config, lambda accounts: accounts.tokens()):
            typer.echo(f"{token.name}\t{token.role}\t{token.created_by}")


@tokens.command()
def revoke(name: Name, config: Config = LINESIDE_TOML) -> None:
    """Refuse a token from now on."""
    with ending():
        with_accounts(config, lambda accounts: accounts.revoke_token(name, by=who_calls(), origin=ORIGIN))
