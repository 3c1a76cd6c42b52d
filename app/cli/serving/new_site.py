"""``lineside serve --new``: a new site where the former store is missing, empty or damaged."""

from __future__ import annotations

import time
from contextlib import closing

from app.cli.serving.serve import check_store
from app.cli.setup.rights import become_owner_of
from app.cli.site.log import open_log, record
from app.core.database import Database
from app.core.database.files import in_words
from app.core.database.migration import presence_of, put_aside
from app.errors import StoreError
from app.people.audit.keys import find_key_file
from app.settings import Settings
from bus.messages import Message


def begin_new_site(settings: Settings) -> None:
    """Make a new store and a new key, with an entry in the new audit log; what is left of the former site is
    kept under other names. Raises StoreError, also where the former store can be used or the configured
    anchor is of the former site."""
    check_store(settings, new=True)
    if settings.audit.anchor is not None and settings.audit.anchor.exists():
        # It may be on a medium that is written once, and would contradict the new log at each start.
        raise StoreError(Message.of("anchor_of_former_site", path=str(settings.audit.anchor)))
    become_owner_of(settings.server.data)
    store, key = settings.server.store, find_key_file(settings.key_files)
    presence = presence_of(store)
    with in_words(store):
        if presence == "damaged":
            put_aside(store)
        if key is not None:
            # Two stores cannot share a key file: it states how far the log of its store was.
            stamp = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
            key.rename(key.with_name(f"{key.name}.before-{stamp}"))
    with closing(Database(store)) as database:
        what = Message.of("event_site_begun", store=Message(f"store_was_{presence}"))
        record(open_log(database, settings.key_files), "server", what)
