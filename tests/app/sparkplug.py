"""A Sparkplug B host application, written from the specification (3.0) alone: it knows nothing of the node.

It reads payloads by the field numbers of the published schema, and notes what a node may not do.
"""

from __future__ import annotations

import struct
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

PAYLOAD = {1: "timestamp", 2: "metrics", 3: "seq"}
METRIC = {
    **{1: "name", 2: "alias", 3: "timestamp", 4: "datatype", 5: "is_historical", 7: "is_null"},
    **{9: "properties", 10: "int", 11: "long", 13: "double", 14: "boolean", 15: "string"},
}
PROPERTY = {1: "type", 2: "is_null", 3: "int", 6: "double", 7: "boolean", 8: "string"}


def fields(content: bytes) -> Iterator[tuple[int, Any]]:
    """Return the fields of a Protocol Buffers message: numbers as int, float or bytes."""
    at = 0

    def varint() -> int:
        nonlocal at
        value = shift = 0
        while True:
            byte = content[at]
            at += 1
            value |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                return value

    while at < len(content):
        key = varint()
        match key & 7:
            case 0:
                yield key >> 3, varint()
            case 1:
                yield key >> 3, struct.unpack_from("<d", content, at)[0]
                at += 8
            case 2:
                length = varint()
                assert at + length <= len(content), "cut"
                yield key >> 3, content[at : at + length]
                at += length
            case kind:
                raise AssertionError(f"wire type {kind}")


def named(content: bytes, names: dict[int, str]) -> dict[str, Any]:
    return {names[number]: value for number, value in fields(content)}


def decoded(payload: bytes) -> dict[str, Any]:
    """Return a payload with its metrics."""
    known = {PAYLOAD[number]: value for number, value in fields(payload) if number != 2}
    known["metrics"] = [metric(value) for number, value in fields(payload) if number == 2]
    return known


def metric(content: bytes) -> dict[str, Any]:
    found = named(content, METRIC)
    for name in ("name", "string"):
        if name in found:
            found[name] = found[name].decode()
    if "properties" in found:
        parts = list(fields(found["properties"]))
        keys = [value.decode() for number, value in parts if number == 1]
        values = [property_value(value) for number, value in parts if number == 2]
        assert len(keys) == len(values)
        found["properties"] = dict(zip(keys, values, strict=True))
    found["value"] = value_of(found)
    return found


def property_value(content: bytes) -> Any:
    found = named(content, PROPERTY)
    return found["string"].decode() if "string" in found else value_of(found)


def value_of(found: dict[str, Any]) -> Any:
    if "boolean" in found:
        return bool(found["boolean"])
    return next((found[name] for name in ("int", "long", "double", "string") if name in found), None)


@dataclass
class Host:
    """What a host knows of one node after each message. ``values``: of each device that is alive, by name;
    ``readings``: every value of every device with its time in ms and whether it is historical."""

    node: str
    group: str
    faults: list[str] = field(default_factory=list)
    bd_seq: int | None = None
    is_alive: bool = False
    births: int = 0
    values: dict[str, dict[str, Any]] = field(default_factory=dict)
    properties: dict[tuple[str, str], dict[str, Any]] = field(default_factory=dict)
    readings: dict[tuple[str, str], list[tuple[int, Any, bool]]] = field(
        default_factory=lambda: defaultdict(list)
    )
    _seq: int = 0
    _aliases: dict[int, tuple[str, str]] = field(default_factory=dict)

    def take(self, topic: str, payload: bytes) -> None:
        """Check and apply a message of the group."""
        parts = topic.split("/")
        if parts[:2] != ["spBv1.0", self.group] or parts[3] != self.node:
            self.faults.append(f"topic {topic}")
            return
        kind, device = parts[2], "/".join(parts[4:])
        content = decoded(payload)
        if kind == "NDEATH":
            self._death(content)
            return
        if kind == "NBIRTH":
            self._birth(content)
            return
        if not self.is_alive:
            self.faults.append(f"{kind} of a node that is dead")
            return
        self._count(kind, content)
        getattr(self, f"_{kind.lower()}")(device, content)

    def _death(self, content: dict[str, Any]) -> None:
        found = [(each["name"], each["value"]) for each in content["metrics"]]
        if "seq" in content or (self.is_alive and found != [("bdSeq", self.bd_seq)]):
            self.faults.append(f"NDEATH with {found}, not {self.bd_seq}")
        self.is_alive, self.values = False, {}

    def _birth(self, content: dict[str, Any]) -> None:
        metrics = {each["name"]: each for each in content["metrics"]}
        if content["seq"] != 0:
            self.faults.append(f"NBIRTH with sequence number {content['seq']}")
        if metrics.get("Node Control/Rebirth", {}).get("value") is not False:
            self.faults.append("NBIRTH without rebirth")
        self.bd_seq, self.is_alive, self._seq = metrics["bdSeq"]["value"], True, 0
        self.births += 1
        self.values, self._aliases = {}, {}

    def _count(self, kind: str, content: dict[str, Any]) -> None:
        expected = (self._seq + 1) % 256
        if content["seq"] != expected:
            self.faults.append(f"{kind} with sequence number {content['seq']}, not {expected}")
        self._seq = content["seq"]

    def _dbirth(self, device: str, content: dict[str, Any]) -> None:
        self.values[device] = {}
        for each in content["metrics"]:
            known = self._aliases.setdefault(each["alias"], (device, each["name"]))
            if known != (device, each["name"]):
                self.faults.append(f"alias {each['alias']} twice")
            if "datatype" not in each:
                self.faults.append(f"{each['name']} without a type")
            self.properties[device, each["name"]] = each.get("properties", {})
            self._value(device, each["name"], each)
        names = [each["name"].casefold() for each in content["metrics"]]
        if len(set(names)) != len(names):
            self.faults.append("a name twice")

    def _ddeath(self, device: str, _: dict[str, Any]) -> None:
        if self.values.pop(device, None) is None:
            self.faults.append(f"DDEATH of {device}, which is dead")

    def _ddata(self, device: str, content: dict[str, Any]) -> None:
        for each in content["metrics"]:
            owner, name = self._aliases.get(each["alias"], ("", ""))
            if "name" in each or owner != device or device not in self.values:
                self.faults.append(f"data of {device}: {each}")
                continue
            self._value(device, name, each)

    def _value(self, device: str, name: str, each: dict[str, Any]) -> None:
        if (each["value"] is None) != bool(each.get("is_null")):
            self.faults.append(f"null of {name}")
        is_historical = bool(each.get("is_historical"))
        self.readings[device, name].append((each["timestamp"], each["value"], is_historical))
        if not is_historical:
            self.values[device][name] = each["value"]
