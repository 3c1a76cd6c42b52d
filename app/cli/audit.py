"""``lineside audit verify``: proof that no entry of the event log was changed, removed or cut off."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import typer

from app.audit.chain import Verdict
from app.audit.store import prove
from app.cli.ending import ending
from app.cli.serve import LINESIDE_TOML, Config
from app.database.connection import open_for_reading
from app.database.words import in_words
from app.errors import StoreError
from app.settings import load

audits = typer.Typer(help="The event log.", no_args_is_help=True)


def register(cli: typer.Typer) -> None:
    """Add the group."""
    cli.add_typer(audits, name="audit")


@audits.callback()
def audit() -> None:
    """The event log."""


@audits.command()
def verify(config: Config = LINESIDE_TOML) -> None:
    """Walk the whole log. Exit 0 when it is whole, 1 naming the first entry that is not."""
    with ending():
        store = load(config).server.store
        verdict = _verdict(store)
        if verdict.broken is not None:
            raise StoreError(
                f"the audit log is broken at entry {verdict.broken}: {verdict.fault}; compare a backup"
            )
    typer.echo(f"the audit log is whole: {verdict.entries} entries")


def _verdict(store: Path) -> Verdict:
    """From the file as it is: nothing is brought up to date, nothing is written."""
    if not store.exists():
        raise StoreError(f"there is no store {store}; nothing was served with this configuration yet")
    with in_words(store), closing(open_for_reading(store)) as connection:
        return prove(connection)
