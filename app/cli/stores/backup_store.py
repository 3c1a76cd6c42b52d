"""``lineside backup-store``: a backup of everything a site keeps, added to a folder of backups or as one
file."""

from __future__ import annotations

import json
from pathlib import Path

import click

from app.cli.ending import report
from app.cli.options import PATH, config_option, json_option
from app.settings import load
from app.system.backup.archive import write_archive
from app.system.backup.files import files_of
from app.system.backup.folder import write_to_folder
from bus.instants import unix_now
from bus.messages import Message


@click.command
@click.argument(
    "file", type=PATH, help="A folder of backups of this site, or a file to write; it must not exist yet."
)
@config_option
@json_option
def backup_store(file: Path, config: Path, as_json: bool) -> None:
    """Copy every store (events, users, sets, history, pictures) of this configuration while the dashboard
    runs, with the archived events, the configuration and its versions; with [backup] key_file also,
    encrypted, the key of the audit log, certificates and files of passwords. Into a folder of backups it
    writes only what is new there, and removes the backups that [backup] does not keep."""
    settings = load(config)
    if file.is_dir():
        done = write_to_folder(settings, file, unix_now())
    else:
        done = write_archive(settings.server.data, file, files_of(settings), settings.audit.archive)
    if as_json:
        click.echo(json.dumps(done._asdict()))
        return
    report(Message.of("stores_backed_up", file=done.file, names=[*done.stores, *done.events]))
    if done.events_absent:
        report(Message.of("backup_without_events", files=[*done.events_absent]))
    if done.left_out:
        report(Message.of("backup_leaves_out", files=[*done.left_out]))
    if done.damaged:
        report(Message.of("backup_contents_lost", n=len(done.damaged)))
