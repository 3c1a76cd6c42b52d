"""What the files of a site hold of its operation and what its peers respond, as lines and as JSON."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any
from zoneinfo import ZoneInfo

from app.cli.findings.peers import peer_faults
from app.cli.site.facts import (
    BackupFacts,
    CertificateFacts,
    DiskFacts,
    PublisherFacts,
    backup_facts,
    certificate_facts,
    disk_facts,
    publisher_facts,
)
from app.core.web.shape import iso, maybe_shown
from app.line.history.status import MAX_DAYS
from app.records.handover.rules.shifts import site_time
from app.settings import Settings
from app.system.peers.settings import PeerSettings
from app.version import VERSION
from bus.instants import UnixTime
from bus.messages import Message, number

MB, GB = 1e6, 1e9
HOUR_S = 3600.0


@dataclass(frozen=True, slots=True)
class SiteFacts:
    """All of it, at one moment."""

    disk: DiskFacts
    certificates: list[CertificateFacts]
    backup: BackupFacts | None
    publisher: PublisherFacts | None
    peers: list[tuple[PeerSettings, Message | None]]
    now: UnixTime


def site_facts(settings: Settings, now: UnixTime) -> SiteFacts:
    """Read the files of a site, and each of its peers once."""
    disk, certificates = disk_facts(settings, now), certificate_facts(settings)
    backup, publisher = backup_facts(settings, now), publisher_facts(settings)
    return SiteFacts(disk, certificates, backup, publisher, peer_faults(settings), now)


def facts_lines(settings: Settings, facts: SiteFacts) -> Iterator[Message]:
    """One line for each fact."""
    yield Message.of("dashboard_store", path=str(settings.server.store))
    for name, size in facts.disk.stores.items():
        yield Message.of("status_store", name=name, size=number(f"{size / MB:.1f}"))
    yield _disk_line(facts.disk)
    for each in facts.certificates:
        if each.ends_at is None:
            yield Message.of("status_certificate_unreadable", file=each.file)
        else:
            yield Message.of("status_certificate", file=each.file, day=_day(each.ends_at))
    zone = ZoneInfo(settings.site.zone)
    yield _backup_line(facts.backup, facts.now, zone)
    if facts.publisher is not None:
        yield _publisher_line(facts.publisher, facts.now, zone)
    for peer, fault in facts.peers:
        if fault is None:
            yield Message.of("check_peer", peer=peer.name, url=peer.url)
        else:
            yield Message.of("peer_not_read", peer=peer.name, reason=fault)


def facts_json(settings: Settings, facts: SiteFacts) -> dict[str, Any]:
    """The same facts for programs: bytes, days, ISO 8601."""
    backup, publisher = facts.backup, facts.publisher
    return {
        "site": settings.site.name,
        "version": VERSION,
        "configured": [
            {"name": bus.name, "port": bus.port, "baud": bus.baud, "units": len(bus.unit)}
            for bus in settings.bus
        ],
        "stores": facts.disk.stores,
        "disk_free": facts.disk.free,
        "disk_days": None if facts.disk.days is None else round(facts.disk.days, 1),
        "certificates": [
            {"file": each.file, "ends": None if each.ends_at is None else iso(each.ends_at)}
            for each in facts.certificates
        ],
        "backup": None
        if backup is None
        else {
            "folder": backup.folder,
            "is_there": backup.is_there,
            "fault": None if backup.fault is None else str(backup.fault),
            "newest": None if backup.newest is None else iso(backup.newest),
            "next": iso(backup.next),
        },
        "publisher": None
        if publisher is None
        else {
            "database": publisher.place,
            "until": None if publisher.until is None else iso(publisher.until),
            "lag_s": None if publisher.until is None else max(0, int(facts.now - publisher.until)),
        },
        "peers": [
            {"name": peer.name, "url": peer.url, "fault": maybe_shown(fault)} for peer, fault in facts.peers
        ],
    }


def _disk_line(disk: DiskFacts) -> Message:
    free = number(f"{disk.free / GB:.1f}")
    if disk.days is None:
        return Message.of("status_disk_unknown", free=free)
    code = "status_disk_long" if disk.days >= MAX_DAYS else "status_disk"
    return Message.of(code, free=free, n=int(disk.days))


def _backup_line(backup: BackupFacts | None, now: UnixTime, zone: ZoneInfo) -> Message:
    if backup is None:
        return Message("status_no_backup")
    if backup.fault is not None:
        return Message.of("status_backup_fault", reason=backup.fault)
    due = site_time(backup.next, zone)
    if backup.newest is None:
        return Message.of("status_backup_first", folder=backup.folder, due=due)
    newest, hours = site_time(backup.newest, zone), int((now - backup.newest) / HOUR_S)
    return Message.of("status_backup", newest=newest, hours=hours, due=due)


def _publisher_line(publisher: PublisherFacts, now: UnixTime, zone: ZoneInfo) -> Message:
    if publisher.until is None:
        return Message.of("status_publisher_first", place=publisher.place)
    lag = max(0, int(now - publisher.until))
    until = site_time(publisher.until, zone)
    return Message.of("status_publisher", place=publisher.place, until=until, seconds=lag)


def _day(at: UnixTime) -> str:
    return datetime.fromtimestamp(float(at), UTC).date().isoformat()
