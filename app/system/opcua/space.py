"""The nodes of the lines, in the terms of OPC UA for Machinery (OPC 40001-1): each bus a machine with its
identification, each unit a component of it, each tag a variable.

The types of the companion specifications have the node ids of these, so that clients know them; they are made
here, only as far as they are used.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime

from asyncua import Server, ua

from app.line.live.bus_live import BusLive, UnitLive
from app.system.opcua.values import Point, unit_id, unit_points
from app.system.tags import OF_READING, Scale, Tag, scale_now, tags_of, unique_names
from bus.instants import UnixTime

DEVICES = "http://opcfoundation.org/UA/DI/"
MACHINERY = "http://opcfoundation.org/UA/Machinery/"
UNECE = "http://www.opcfoundation.org/UA/units/un/cefact"
OWN = 1
"""The namespace of the application, which is that of its nodes (OPC UA Part 5, 6.3.1)."""
HAS_ADD_IN = 17604
BASE_ANALOG_TYPE = 15318
MAKER, MODEL = "POWERTEC", "DIGIMAX IV"
"""Of every unit."""
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


class Sample(ua.DataValue):
    """A value with its status and times that nobody changes. asyncua copies each that it delivers in depth,
    which is half of its cost: of this one it gets the same."""

    __slots__ = ()

    def __deepcopy__(self, _: object) -> Sample:
        return self


@dataclass(slots=True)
class UnitNodes:
    """The variables of a unit in the order of its tags. ``shown``: what was written to each last; ``scale``:
    that of its units and ranges."""

    bus: BusLive
    unit: UnitLive
    tags: Sequence[Tag]
    ids: list[ua.NodeId]
    scale: Scale | None = None
    shown: list[Point | None] = field(default_factory=list)


class LineNodes:
    """The nodes of all buses."""

    def __init__(self, server: Server, manufacturer: str, serial_number: str) -> None:
        self._server = server
        self._session = server.iserver.isession
        self._manufacturer, self._serial_number = manufacturer, serial_number
        self.units: dict[tuple[str, int], UnitNodes] = {}

    # --- build ---

    async def build(self, buses: Sequence[BusLive]) -> None:
        """Make all nodes, a unit at a time."""
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
            await self._add(
                node,
                parent,
                ua.ObjectIds.HasSubtype,
                name,
                namespace,
                ua.NodeClass.ObjectType,
                None,
                attributes,
            )
        machines = ua.NodeId(1001, self._machinery)
        objects = ua.NodeId(ua.ObjectIds.ObjectsFolder)
        await self._object(machines, objects, ua.ObjectIds.Organizes, "Machines", self._machinery)
        self._machines = machines

    async def _build_machine(self, bus: BusLive) -> None:
        name = bus.settings.name
        machine = ua.NodeId(name, OWN)
        plain = ua.NodeId(ua.ObjectIds.BaseObjectType)
        await self._object(machine, self._machines, ua.ObjectIds.Organizes, name, OWN, plain)
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
        kind = self._components_type
        await self._object(components, machine, HAS_ADD_IN, "Components", self._machinery, kind)
        units = [(number, unit.settings.name.strip() or str(number)) for number, unit in bus.units.items()]
        for number, unit_name in unique_names(units).items():
            await self._build_unit(bus, bus.units[number], unit_name, components)
            await asyncio.sleep(0)

    async def _build_unit(self, bus: BusLive, unit: UnitLive, name: str, components: ua.NodeId) -> None:
        number = unit.settings.id
        place = f"{bus.settings.name}/{number}"
        component = ua.NodeId(place, OWN)
        plain = ua.NodeId(ua.ObjectIds.BaseObjectType)
        await self._object(component, components, ua.ObjectIds.HasComponent, name, OWN, plain)
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
            if folder and folder not in folders:
                folders.add(folder)
                group = ua.NodeId(f"{place}/{folder}", OWN)
                await self._object(group, component, ua.ObjectIds.HasComponent, folder, OWN, self._group)
            parent = ua.NodeId(f"{place}/{folder}", OWN) if folder else component
            ids.append(await self._tag(tag, ua.NodeId(f"{place}/{tag.name}", OWN), parent, last))
        nodes = UnitNodes(bus, unit, tags, ids, shown=[None] * len(tags))
        self.units[bus.settings.name, number] = nodes

    async def _identification(self, of: ua.NodeId, kind: ua.NodeId, about: dict[str, object]) -> None:
        node = ua.NodeId(f"{of.Identifier}/Identification", OWN)
        await self._object(node, of, HAS_ADD_IN, "Identification", self._di, kind)
        for name, value in about.items():
            where = ua.NodeId(f"{node.Identifier}/{name}", OWN)
            variant = ua.Variant(value)
            await self._property(where, node, name, variant, ua.NodeId(variant.VariantType.value), self._di)

    async def _tag(self, tag: Tag, node: ua.NodeId, parent: ua.NodeId, name: str) -> ua.NodeId:
        """Make the variable of a tag. A number has a unit and a range, which follow the scale of its unit; a
        parameter has the unit of its integer, if it has one."""
        variant = _VARIANTS[tag.kind]
        has_unit = tag.kind == "number" or bool(tag.unit)
        kind = BASE_ANALOG_TYPE if has_unit else ua.ObjectIds.BaseDataVariableType
        await self._variable(
            node,
            parent,
            ua.ObjectIds.HasComponent,
            name,
            OWN,
            ua.NodeId(kind),
            _NO_VALUE,
            ua.NodeId(variant.value),
            tag.description,
        )
        if has_unit:
            where = ua.NodeId(f"{node.Identifier}/EngineeringUnits", OWN)
            data_type = ua.NodeId(ua.ObjectIds.EUInformation)
            await self._property(where, node, "EngineeringUnits", ua.Variant(_unit(tag.unit)), data_type, 0)
        if tag.kind == "number":
            where = ua.NodeId(f"{node.Identifier}/EURange", OWN)
            data_type = ua.NodeId(ua.ObjectIds.Range)
            await self._property(where, node, "EURange", _NO_VALUE, data_type, 0)
        return node

    async def _object(
        self,
        node: ua.NodeId,
        parent: ua.NodeId,
        reference: int,
        name: str,
        namespace: int,
        kind: ua.NodeId | None = None,
    ) -> None:
        attributes = ua.ObjectAttributes()
        attributes.EventNotifier = 0
        folder = kind or ua.NodeId(ua.ObjectIds.FolderType)
        await self._add(node, parent, reference, name, namespace, ua.NodeClass.Object, folder, attributes)

    async def _property(
        self,
        node: ua.NodeId,
        parent: ua.NodeId,
        name: str,
        value: ua.Variant,
        data_type: ua.NodeId,
        namespace: int,
    ) -> None:
        kind = ua.NodeId(ua.ObjectIds.PropertyType)
        reference = ua.ObjectIds.HasProperty
        await self._variable(node, parent, reference, name, namespace, kind, value, data_type)

    async def _variable(
        self,
        node: ua.NodeId,
        parent: ua.NodeId,
        reference: int,
        name: str,
        namespace: int,
        kind: ua.NodeId,
        value: ua.Variant,
        data_type: ua.NodeId,
        description: str = "",
    ) -> None:
        attributes = ua.VariableAttributes()
        attributes.Value, attributes.DataType, attributes.ValueRank = value, data_type, ua.ValueRank.Scalar
        attributes.AccessLevel = attributes.UserAccessLevel = _READ
        attributes.Historizing = False
        attributes.Description = ua.LocalizedText(description)
        await self._add(node, parent, reference, name, namespace, ua.NodeClass.Variable, kind, attributes)

    async def _add(
        self,
        node: ua.NodeId,
        parent: ua.NodeId,
        reference: int,
        name: str,
        namespace: int,
        node_class: ua.NodeClass,
        kind: ua.NodeId | None,
        attributes: ua.ObjectAttributes | ua.VariableAttributes | ua.ObjectTypeAttributes,
    ) -> None:
        attributes.DisplayName = ua.LocalizedText(name)
        attributes.WriteMask = attributes.UserWriteMask = 0
        item = ua.AddNodesItem()
        item.RequestedNewNodeId, item.ParentNodeId = node, parent
        item.ReferenceTypeId = ua.NodeId(reference)
        item.BrowseName = ua.QualifiedName(name, namespace)
        item.NodeClass, item.NodeAttributes = node_class, attributes
        if kind is not None:
            item.TypeDefinition = kind
        for result in await self._session.add_nodes([item]):
            result.StatusCode.check()

    # --- values ---

    async def write(self, place: tuple[str, int], alarms: int, now: UnixTime, *, others: bool) -> None:
        """Write what changed of a unit since the last call. ``others``: not only its reading may differ."""
        nodes = self.units[place]
        scale = scale_now(nodes.bus, nodes.unit)
        if scale != nodes.scale:
            nodes.scale = scale
            await self._write_scale(nodes, scale)
        points = unit_points(nodes.bus, nodes.unit, scale, alarms, now)
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
