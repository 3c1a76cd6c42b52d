"""The nodes of the lines, in the terms of OPC UA for Machinery (OPC 40001-1): each bus is a machine with its
identification, each unit a component of it, each tag a variable.

The types of the companion specifications keep their node ids, so that clients know them; they are created
here, only as far as they are used. A value has its quality as a status code; `app.system.tags` and the live
state determine values and their ages, as everywhere.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, Literal, NamedTuple

from asyncua import Server, ua

from app.line.live.bus_live import BusLive, UnitLive, unit_link_now
from app.system.opcua.link import StandingAlarm
from app.system.tags import (
    OF_READING,
    SHOWN_PARAMETERS,
    Scale,
    Tag,
    Value,
    other_values,
    reading_values,
    scale_now,
    tags_of,
    unique_names,
)
from bus.contract import UnitLinkState
from bus.instants import UnixTime

Quality = Literal["Good", "UncertainLastUsableValue", "BadNoCommunication", "BadWaitingForInitialData"]
"""The status codes by their names in OPC UA Part 8, 6.3."""
QUALITY: dict[UnitLinkState, Quality] = {
    "online": "Good",
    "stale": "UncertainLastUsableValue",
    "offline": "BadNoCommunication",
    "unknown": "BadWaitingForInitialData",
}
UNITS = {
    "m/min": "2X",
    "m/s": "MTS",
    "m/h": "M60",
    "mm/s": "C16",
    "ft/min": "FR",
    "fpm": "FR",
    "rpm": "RPM",
    "1/min": "RPM",
    "U/min": "RPM",
    "%": "P1",
    "s": "SEC",
    "baud": "J38",
    "N": "NEW",
    "kN": "B47",
    "Nm": "NU",
    "kg": "KGM",
    "kg/h": "E93",
    "V": "VLT",
    "mV": "2Z",
    "A": "AMP",
    "mA": "4K",
    "kW": "KWT",
    "Hz": "HTZ",
    "mm": "MMT",
    "m": "MTR",
    "bar": "BAR",
    "psi": "PS",
    "°C": "CEL",
}
"""The units as labels write them, with their common codes (UNECE Recommendation 20)."""
OTHER_UNIT = -1
"""The id of a unit without a common code (OPC UA Part 8, 5.6.3.3)."""


class Point(NamedTuple):
    """A value with its quality and the time of its source. A bad point has no value."""

    value: Value
    quality: Quality
    at: UnixTime


def unit_id(unit: str) -> int:
    """Return the id of an engineering unit: the characters of its common code as a number (OPC UA Part 8,
    5.6.3.3)."""
    code = UNITS.get(unit)
    return OTHER_UNIT if code is None else int.from_bytes(code.encode(), "big")


def unit_points(bus: BusLive, unit: UnitLive, scale: Scale, alarms: int, now: UnixTime) -> tuple[Point, ...]:
    """Return the values of a unit in the order of its tags. ``alarms``: the number of active ones."""
    link = unit_link_now(bus, unit, now)
    reading = unit.reading
    quality = QUALITY[link]
    values = (None,) * OF_READING if reading is None else reading_values(bus, unit, reading, scale)
    at = now if reading is None else reading.at
    state, active, *parameters = other_values(unit, link, alarms)
    return (
        *(_point(value, quality, at) for value in values),
        Point(state, "Good", now),
        Point(active, "Good", now),
        *_parameter_points(unit, parameters, quality, now),
    )


def alarm_lists(alarms: Sequence[StandingAlarm]) -> tuple[list[Any], ...]:
    """Return the names of alarms, their priorities, whether each is active and acknowledged, and since when
    it stands."""
    return (
        [alarm.name for alarm in alarms],
        [alarm.priority for alarm in alarms],
        [alarm.is_active for alarm in alarms],
        [alarm.is_acknowledged for alarm in alarms],
        [datetime.fromtimestamp(float(alarm.since), UTC) for alarm in alarms],
    )


def _parameter_points(
    unit: UnitLive, values: list[Value], quality: Quality, now: UnixTime
) -> Iterator[Point]:
    """Yield the parameters. One not read since the unit came back may have changed at its keypad."""
    for parameter, value in zip(SHOWN_PARAMETERS, values, strict=True):
        known = unit.parameters.get(parameter.number)
        at = now if known is None else known.at
        is_old = quality == "Good" and not unit.is_current(parameter.number)
        yield _point(value, "UncertainLastUsableValue" if is_old else quality, at)


def _point(value: Value, quality: Quality, at: UnixTime) -> Point:
    if quality.startswith("Bad"):
        return Point(None, quality, at)
    return Point(None, "BadWaitingForInitialData", at) if value is None else Point(value, quality, at)


DEVICES = "http://opcfoundation.org/UA/DI/"
MACHINERY = "http://opcfoundation.org/UA/Machinery/"
UNECE = "http://www.opcfoundation.org/UA/units/un/cefact"
OWN = 1
"""The namespace of the application, which is that of its nodes (OPC UA Part 5, 6.3.1)."""
HAS_ADD_IN = 17604
MAKER, MODEL = "POWERTEC", "DIGIMAX IV"
"""The maker and model of every unit."""
_VARIANTS = {
    "number": ua.VariantType.Double,
    "integer": ua.VariantType.Int64,
    "bit": ua.VariantType.Boolean,
    "text": ua.VariantType.String,
}
_CODES = {
    name: ua.StatusCode(getattr(ua.StatusCodes, name))
    for name in ("Good", "UncertainLastUsableValue", "BadNoCommunication", "BadWaitingForInitialData")
}
_NO_VALUE = ua.Variant(None, ua.VariantType.Null)
_READ = ua.AccessLevel.CurrentRead.mask
_PLAIN = ua.NodeId(ua.ObjectIds.BaseObjectType)
_DATA, _ANALOG = ua.NodeId(ua.ObjectIds.BaseDataVariableType), ua.NodeId(15318)
"""The types of variables: a value, and a value with a unit (*BaseAnalogType*)."""
ALARM_FOLDER = "Alarms"
ALARM_COLUMNS = {
    "Names": ua.VariantType.String,
    "Priorities": ua.VariantType.String,
    "IsActive": ua.VariantType.Boolean,
    "Acknowledged": ua.VariantType.Boolean,
    "Since": ua.VariantType.DateTime,
}
"""The variables of the standing alarms of a unit: lists of one length."""


class Sample(ua.DataValue):
    """A value with its status and times that nobody changes. asyncua deep-copies each value that it delivers,
    at half of its cost: of this class it gets the same object."""

    __slots__ = ()

    def __deepcopy__(self, _: object) -> Sample:
        return self


class Place(NamedTuple):
    """The place of a node: its id, the node above it, its browse name, and the reference to it."""

    node: ua.NodeId
    parent: ua.NodeId
    name: str
    namespace: int = OWN
    reference: int = ua.ObjectIds.HasComponent


@dataclass(slots=True)
class UnitNodes:
    """The variables of a unit in the order of its tags. ``shown``: the points that were last written;
    ``scale``: that of its units and ranges; ``alarms``: those that were last written."""

    bus: BusLive
    unit: UnitLive
    tags: Sequence[Tag]
    ids: list[ua.NodeId]
    scale: Scale | None = None
    shown: list[Point | None] = field(default_factory=list)
    alarms: Sequence[StandingAlarm] | None = None


class LineNodes:
    """The nodes of all buses in the address space of the server."""

    def __init__(self, server: Server, manufacturer: str, serial_number: str) -> None:
        self._server = server
        self._session = server.iserver.isession
        self._manufacturer, self._serial_number = manufacturer, serial_number
        self.units: dict[tuple[str, int], UnitNodes] = {}

    # --- build ---

    async def build(self, buses: Sequence[BusLive]) -> None:
        """Create the nodes of all buses, unit by unit so that the process responds meanwhile."""
        self._di = await self._server.register_namespace(DEVICES)
        self._machinery = await self._server.register_namespace(MACHINERY)
        await self._build_types()
        for bus in buses:
            await self._build_machine(bus)

    async def _build_types(self) -> None:
        types = ua.NodeId(ua.ObjectIds.FolderType)
        self._group = ua.NodeId(1005, self._di)
        self._machine_identification = ua.NodeId(1012, self._machinery)
        self._component_identification = ua.NodeId(1005, self._machinery)
        self._components_type = ua.NodeId(1006, self._machinery)
        item = ua.NodeId(1004, self._machinery)
        made = (
            (self._group, types, "FunctionalGroupType", self._di),
            (item, self._group, "MachineryItemIdentificationType", self._machinery),
            (self._machine_identification, item, "MachineIdentificationType", self._machinery),
            (self._component_identification, item, "MachineryComponentIdentificationType", self._machinery),
            (
                self._components_type,
                ua.NodeId(ua.ObjectIds.BaseObjectType),
                "MachineComponentsType",
                self._machinery,
            ),
        )
        for node, parent, name, namespace in made:
            attributes = ua.ObjectTypeAttributes()
            attributes.IsAbstract = False
            where = Place(node, parent, name, namespace, ua.ObjectIds.HasSubtype)
            await self._add(where, ua.NodeClass.ObjectType, None, attributes)
        machines = ua.NodeId(1001, self._machinery)
        objects = ua.NodeId(ua.ObjectIds.ObjectsFolder)
        folder = ua.NodeId(ua.ObjectIds.FolderType)
        await self._object(
            Place(machines, objects, "Machines", self._machinery, ua.ObjectIds.Organizes), folder
        )
        self._machines = machines

    async def _build_machine(self, bus: BusLive) -> None:
        name = bus.settings.name
        machine = ua.NodeId(name, OWN)
        await self._object(Place(machine, self._machines, name, OWN, ua.ObjectIds.Organizes), _PLAIN)
        await self._identification(
            machine,
            self._machine_identification,
            {
                "Manufacturer": ua.LocalizedText(self._manufacturer),
                "SerialNumber": self._serial_number,
                "ProductInstanceUri": f"{self._server.get_application_uri()}:{name}",
            },
        )
        components = ua.NodeId(f"{name}/Components", OWN)
        where = Place(components, machine, "Components", self._machinery, HAS_ADD_IN)
        await self._object(where, self._components_type)
        units = [(number, unit.settings.name.strip() or str(number)) for number, unit in bus.units.items()]
        for number, unit_name in unique_names(units).items():
            await self._build_unit(bus, bus.units[number], unit_name, components)
            await asyncio.sleep(0)

    async def _build_unit(self, bus: BusLive, unit: UnitLive, name: str, components: ua.NodeId) -> None:
        number = unit.settings.id
        place = f"{bus.settings.name}/{number}"
        component = ua.NodeId(place, OWN)
        await self._object(Place(component, components, name), _PLAIN)
        about = {
            "Manufacturer": ua.LocalizedText(MAKER),
            "Model": ua.LocalizedText(MODEL),
            "SerialNumber": "",
            "ComponentName": ua.LocalizedText(name),
        }
        await self._identification(component, self._component_identification, about)
        tags = tags_of(unit, scale_now(bus, unit))
        folders: set[str] = set()
        ids = []
        for tag in tags:
            folder, _, last = tag.name.rpartition("/")
            parent = ua.NodeId(f"{place}/{folder}", OWN) if folder else component
            if folder and folder not in folders:
                folders.add(folder)
                await self._object(Place(parent, component, folder), self._group)
            ids.append(await self._tag(tag, Place(ua.NodeId(f"{place}/{tag.name}", OWN), parent, last)))
        alarms = ua.NodeId(f"{place}/{ALARM_FOLDER}", OWN)
        for column, variant in ALARM_COLUMNS.items():
            where = Place(ua.NodeId(f"{alarms.Identifier}/{column}", OWN), alarms, column)
            await self._variable(where, _DATA, _NO_VALUE, ua.NodeId(variant.value), is_list=True)
        self.units[bus.settings.name, number] = UnitNodes(bus, unit, tags, ids, shown=[None] * len(tags))

    async def _identification(self, of: ua.NodeId, kind: ua.NodeId, about: dict[str, object]) -> None:
        node = ua.NodeId(f"{of.Identifier}/Identification", OWN)
        await self._object(Place(node, of, "Identification", self._di, HAS_ADD_IN), kind)
        for name, value in about.items():
            variant = ua.Variant(value)
            await self._property(node, name, variant, ua.NodeId(variant.VariantType.value), self._di)

    async def _tag(self, tag: Tag, where: Place) -> ua.NodeId:
        """Create the variable of a tag. A number has a unit and a range, which follow the scale of its unit;
        a parameter has the unit of its integer, if any."""
        data_type = ua.NodeId(_VARIANTS[tag.kind].value)
        has_unit = tag.kind == "number" or bool(tag.unit)
        await self._variable(where, _ANALOG if has_unit else _DATA, _NO_VALUE, data_type, tag.description)
        if has_unit:
            unit = ua.Variant(_unit(tag.unit))
            await self._property(
                where.node, "EngineeringUnits", unit, ua.NodeId(ua.ObjectIds.EUInformation), 0
            )
        if tag.kind == "number":
            await self._property(where.node, "EURange", _NO_VALUE, ua.NodeId(ua.ObjectIds.Range), 0)
        return where.node

    async def _object(self, where: Place, kind: ua.NodeId) -> None:
        attributes = ua.ObjectAttributes()
        attributes.EventNotifier = 0
        await self._add(where, ua.NodeClass.Object, kind, attributes)

    async def _property(
        self, of: ua.NodeId, name: str, value: ua.Variant, data_type: ua.NodeId, namespace: int
    ) -> None:
        node = ua.NodeId(f"{of.Identifier}/{name}", OWN)
        where = Place(node, of, name, namespace, ua.ObjectIds.HasProperty)
        await self._variable(where, ua.NodeId(ua.ObjectIds.PropertyType), value, data_type)

    async def _variable(
        self,
        where: Place,
        kind: ua.NodeId,
        value: ua.Variant,
        data_type: ua.NodeId,
        description: str = "",
        *,
        is_list: bool = False,
    ) -> None:
        attributes = ua.VariableAttributes()
        attributes.Value, attributes.DataType = value, data_type
        attributes.ValueRank = ua.ValueRank.OneDimension if is_list else ua.ValueRank.Scalar
        attributes.ArrayDimensions = [0] if is_list else []
        attributes.AccessLevel = attributes.UserAccessLevel = _READ
        attributes.Historizing = False
        attributes.Description = ua.LocalizedText(description)
        await self._add(where, ua.NodeClass.Variable, kind, attributes)

    async def _add(
        self,
        where: Place,
        node_class: ua.NodeClass,
        kind: ua.NodeId | None,
        attributes: ua.ObjectAttributes | ua.VariableAttributes | ua.ObjectTypeAttributes,
    ) -> None:
        attributes.DisplayName = ua.LocalizedText(where.name)
        attributes.WriteMask = attributes.UserWriteMask = 0
        item = ua.AddNodesItem()
        item.RequestedNewNodeId, item.ParentNodeId = where.node, where.parent
        item.ReferenceTypeId = ua.NodeId(where.reference)
        item.BrowseName = ua.QualifiedName(where.name, where.namespace)
        item.NodeClass, item.NodeAttributes = node_class, attributes
        if kind is not None:
            item.TypeDefinition = kind
        for result in await self._session.add_nodes([item]):
            result.StatusCode.check()

    # --- values ---

    async def write(
        self, place: tuple[str, int], alarms: Sequence[StandingAlarm], now: UnixTime, *, others: bool
    ) -> None:
        """Write the changes of a unit since the last call. ``alarms``: its standing ones; ``others``: more
        than its reading may differ."""
        nodes = self.units[place]
        scale = scale_now(nodes.bus, nodes.unit)
        if scale != nodes.scale:
            nodes.scale = scale
            await self._write_scale(nodes, scale)
        if nodes.alarms != alarms:
            nodes.alarms = alarms
            await self._write_alarms(place, alarms, now)
        active = sum(alarm.is_active for alarm in alarms)
        points = unit_points(nodes.bus, nodes.unit, scale, active, now)
        for index, point in enumerate(points if others else points[:OF_READING]):
            before = nodes.shown[index]
            if before is None or point.value != before.value or point.quality != before.quality:
                nodes.shown[index] = point
                await self._write(nodes.ids[index], nodes.tags[index], point, now)

    async def _write(self, node: ua.NodeId, tag: Tag, point: Point, now: UnixTime) -> None:
        value = _NO_VALUE if point.value is None else ua.Variant(point.value, _VARIANTS[tag.kind])
        times = (datetime.fromtimestamp(float(at), UTC) for at in (point.at, now))
        data = Sample(value, _CODES[point.quality], *times)
        await self._server.write_attribute_value(node, data)

    async def _write_alarms(
        self, place: tuple[str, int], alarms: Sequence[StandingAlarm], now: UnixTime
    ) -> None:
        """Write the standing alarms of a unit, one list for each of their properties."""
        bus, unit = place
        at = datetime.fromtimestamp(float(now), UTC)
        for (column, variant), values in zip(ALARM_COLUMNS.items(), alarm_lists(alarms), strict=True):
            value = ua.Variant(values, variant, is_array=True)
            node = ua.NodeId(f"{bus}/{unit}/{ALARM_FOLDER}/{column}", OWN)
            await self._server.write_attribute_value(node, Sample(value, _CODES["Good"], at, at))

    async def _write_scale(self, nodes: UnitNodes, scale: Scale) -> None:
        """Write the units and ranges of the values of a unit."""
        for node, tag in zip(nodes.ids, tags_of(nodes.unit, scale), strict=True):
            if tag.kind != "number":
                continue
            unit = ua.DataValue(ua.Variant(_unit(tag.unit)))
            await self._server.write_attribute_value(
                ua.NodeId(f"{node.Identifier}/EngineeringUnits", OWN), unit
            )
            if tag.low is None or tag.high is None:
                span = ua.DataValue(_NO_VALUE, _CODES["BadWaitingForInitialData"])
            else:
                span = ua.DataValue(ua.Variant(ua.Range(float(tag.low), float(tag.high))))
            await self._server.write_attribute_value(ua.NodeId(f"{node.Identifier}/EURange", OWN), span)


def _unit(unit: str) -> ua.EUInformation:
    number = unit_id(unit)
    namespace = UNECE if number > 0 else "urn:lineside:units"
    return ua.EUInformation(namespace, number, ua.LocalizedText(unit), ua.LocalizedText(unit))
