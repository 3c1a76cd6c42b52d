"""Remote control of a simulated line: JSON lines over a TCP port of the loopback.

One line is a request, one line its response: ``{"do": "mode", "unit": 3, "to": "local"}`` → ``{"ok": true}``,
or ``{"ok": false, "error": "…"}``. A unit is named by its address ``unit`` or, where two units have the same
address, by its ``place`` on the cable.
"""

from __future__ import annotations

import json
import socketserver
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from bus.catalogue import parameters as numbers
from bus.simulator.faults import EVERY_UNIT, FaultKind
from bus.simulator.line import SimulatedLine
from bus.simulator.plant import Plant
from bus.simulator.record import WireEvent, WireEventKind
from bus.simulator.section import Section
from bus.simulator.serve import LineServer
from bus.simulator.unit import FACTORY, Memory, Mode, Traits, Unit

ControlRequest = dict[str, Any]


@contextmanager
def control_port(server: LineServer, port: int = 0) -> Iterator[int]:
    """Serve control requests for the line of ``server``; gives the TCP port."""

    class ControlHandler(socketserver.StreamRequestHandler):
        def handle(self) -> None:
            for text in self.rfile:
                self.wfile.write(json.dumps(_respond(server, text)).encode() + b"\n")

    with socketserver.ThreadingTCPServer(("127.0.0.1", port), ControlHandler) as listener:
        listener.daemon_threads = True
        threading.Thread(target=listener.serve_forever, name="control", daemon=True).start()
        try:
            yield int(listener.server_address[1])
        finally:
            listener.shutdown()


def _respond(server: LineServer, text: bytes) -> ControlRequest:
    try:
        request = json.loads(text)
        return {"ok": True, "result": _carry_out(server, request)}
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        return {"ok": False, "error": f"{type(error).__name__}: {error}"}


def _carry_out(server: LineServer, request: ControlRequest) -> object:
    match request["do"]:
        case "unplug":
            server.unplug()
        case "plug":
            server.plug()
        case "port":
            return server.port.name
        case _:
            return server.call(lambda line: _change_line(line, request))
    return None


def _change_line(line: SimulatedLine, request: ControlRequest) -> object:
    match request["do"]:
        case "fault":
            kind, rate = FaultKind(request["kind"]), float(request["rate"])
            line.faults.set(kind, rate, request.get("unit", EVERY_UNIT))
        case "clear":
            line.faults.clear()
        case "record":
            kinds = map(WireEventKind, request.get("kinds", []))
            return [_entry(each) for each in line.record.since(request.get("since", 0), *kinds)]
        case "spare":
            # JSON has texts alone as keys.
            changed = {int(number): int(raw) for number, raw in request.get("parameters", {}).items()}
            traits = Traits(last_parameter=request.get("last_parameter", len(FACTORY)))
            line.plant.sections.append(Section(Unit(Memory(changed), traits)))
            return len(line.plant.sections) - 1
        case _:
            plant = line.plant
            unit = plant.units[request["place"]] if "place" in request else plant.unit(request["unit"])
            return _change_unit(plant, unit, request)
    return None


def _change_unit(plant: Plant, unit: Unit, request: ControlRequest) -> object:
    match request["do"]:
        case "mode":
            unit.memory[numbers.CONTROL_MODE] = Mode[request["to"].upper()]
        case "input":
            setattr(unit.inputs, request["input"], bool(request["on"]))
        case "parameter":
            if "raw" in request:
                unit.memory[request["number"]] = int(request["raw"])
            return unit.memory[request["number"]]
        case "power_cycle":
            unit.power_up()
        case "remove":
            plant.sections = [section for section in plant.sections if section.unit is not unit]
        case "state":
            return {
                "commanded": unit.commanded,
                "actual": unit.measured.actual,
                "setpoint": unit.setpoint,
                "outputs": unit.outputs,
                "mode": unit.mode.name.lower(),
            }
        case other:
            raise ValueError(f"there is no action {other}")
    return None


def _entry(entry: WireEvent) -> ControlRequest:
    known = {"number": entry.number, "at": entry.at, "what": entry.what, "unit": entry.unit}
    return {**known, "hex": entry.data.hex(" ")}
