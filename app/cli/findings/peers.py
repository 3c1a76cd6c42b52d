"""Whether the peers that a configuration names can be read from this machine."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator

from app.cli.findings.machine import Finding
from app.core.server.settings import can_others_read
from app.settings import Settings
from app.system.peers.client import fault_of
from app.system.peers.settings import PeerSettings
from bus.messages import Message


def peer_findings(settings: Settings) -> Iterator[Finding]:
    """The files of their tokens, and each peer, which is read once."""
    for peer in settings.peer:
        if can_others_read(peer.token_file):
            yield Finding(Message.of("check_secret_open", path=str(peer.token_file)))
        if peer.is_in_clear:
            yield Finding(Message.of("check_peer_in_clear", peer=peer.name, url=peer.url))
    for peer, fault in peer_faults(settings):
        if fault is None:
            yield Finding(Message.of("check_peer", peer=peer.name, url=peer.url))
        else:
            yield Finding(Message.of("peer_not_read", peer=peer.name, reason=fault), is_fault=True)


def peer_faults(settings: Settings) -> list[tuple[PeerSettings, Message | None]]:
    """Read each peer once, all at a time; None for one that can be read."""

    async def read() -> list[Message | None]:
        return await asyncio.gather(*map(fault_of, settings.peer))

    return list(zip(settings.peer, asyncio.run(read()) if settings.peer else (), strict=True))
