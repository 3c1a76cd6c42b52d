"""The feature of the plant's broker, if one is configured: the lines' nodes, the overview of others."""

from __future__ import annotations

import socket
from functools import partial

from app.core.database import Database
from app.core.messages import DEFAULT
from app.core.web.templating import Templates
from app.feature import Feature, Services
from app.line.alarms.alarm import Alarm
from app.line.alarms.line_alarms import LineAlarms, SiteAlarms
from app.line.conditions.catalogue import BROKER_LOST
from app.line.history.service import History
from app.line.live.bus_live import LiveState
from app.line.live.fields import Translator
from app.settings import Settings
from app.system.mqtt.node import EdgeNode
from app.system.mqtt.overview import BrokerLines, LineDocuments
from app.system.mqtt.session import Nodes, NodeSession
from app.system.mqtt.settings import identifier_of
from app.system.peers.board import LineTiles
from bus.instants import unix_now


def make(services: Services) -> None:
    settings = services.settings
    if settings.mqtt is None:
        services.add(Nodes())
        return
    board, templates = services[LineTiles].board, services[Templates]
    english = Translator(templates.languages[DEFAULT], templates.formats(DEFAULT))
    group = settings.mqtt.group or identifier_of(settings.site.name)
    documents = LineDocuments(board, english, _page(settings))
    nodes = services.add(
        Nodes(_session(services, name, group, documents) for name in services[LiveState].buses)
    )
    services[LineAlarms].subscribe(partial(_note_alarm, {each.node.name: each for each in nodes}))
    for each in nodes:
        services.lifespan.add("MQTT node", each.follow, end=each.end)
    if settings.mqtt.overview:
        own = frozenset(each.node.document_topic for each in nodes)
        lines = nodes.overview = BrokerLines(settings.mqtt, board, own)
        services.lifespan.add("lines of the broker", lines.follow)
    services[SiteAlarms].watch("broker_lost", lambda: BROKER_LOST.holds(nodes.fault) and nodes.fault)


def _session(services: Services, name: str, group: str, documents: LineDocuments) -> NodeSession:
    settings = services.settings
    assert settings.mqtt is not None
    node = EdgeNode(
        services[LiveState].buses[name],
        group,
        partial(services[LineAlarms].count_active, name),
        settings.mqtt.deadband,
    )
    return NodeSession(
        settings.mqtt,
        node,
        services[Database],
        services[History],
        lambda: documents.document(name, unix_now()),
        settings.history.raw_days,
    )


def _note_alarm(nodes: dict[str, NodeSession], alarm: Alarm) -> None:
    definition = alarm.definition
    if definition.bus in nodes and definition.unit is not None:
        nodes[definition.bus].note_unit(definition.unit)


def _page(settings: Settings) -> str:
    """Return the address of this server's pages for people: that in its messages, else by the name of the
    machine."""
    if settings.notify.dashboard_url:
        return settings.notify.dashboard_url.rstrip("/")
    scheme = "http" if settings.server.tls is None else "https"
    return f"{scheme}://{socket.gethostname()}:{settings.server.port}"


FEATURE = Feature(make)
