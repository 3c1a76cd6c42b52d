"""Remote control of a simulated line: JSON lines over a TCP port of the loopback.

One line is a request, one line its response: ``{"do": "mode", "unit": 3, "to": "local"}`` → ``{"ok": true}``,
or ``{"ok": false, "error": "…"}``. The tables ``_ON_LINE`` and ``_ON_SERVER`` list the actions.
"""

from __future__ import annotations

import json
import socketserver
import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from bus.catalogue import numbers
from bus.simulator.faults import EVERY_UNIT, FaultKind
from bus.simulator.line import SimulatedLine
from bus.simulator.record import Happened
from bus.simulator.section import Section
from bus.simulator.serve import LineServer
from bus.simulator.unit import FACTORY, Memory, Mode, Traits, Unit

ControlRequest = dict[str, Any]


class SimulatorControl:
    """Serves control requests for the line of ``server`` until ``close``."""

    def __init__(self, server: LineServer, port: int = 0) -> None:
        class ControlHandler(socketserver.StreamRequestHandler):
            def handle(self) -> None:
                for text in self.rfile:
                    self.wfile.write(json.dumps(_respond(server, text)).encode() + b"\n")

        self._listener = socketserver.ThreadingTCPServer(("127.0.0.1", port), ControlHandler)
        self._listener.daemon_threads = True
        self._thread = threading.Thread(target=self._listener.serve_forever, name="control", daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        return int(self._listener.server_address[1])

    def close(self) -> None:
        self._listener.shutdown()
        self._listener.server_close()


def _respond(server: LineServer, text: bytes) -> ControlRequest:
    try:
        request = json.loads(text)
        return {"ok": True, "result": _carry_out(server, request)}
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        return {"ok": False, "error": f"{type(error).__name__}: {error}"}


def _carry_out(server: LineServer, request: ControlRequest) -> object:
    action = request["do"]
    if action in _ON_SERVER:
        return _ON_SERVER[action](server)
    return server.call(lambda line: _ON_LINE[action](line, request))


def _unit(line: SimulatedLine, request: ControlRequest) -> Unit:
    """By its ``unit`` address, or by its ``place`` on the cable where two have the same address."""
    return line.plant.units[request["place"]] if "place" in request else line.plant.unit(request["unit"])


def _mode(line: SimulatedLine, request: ControlRequest) -> None:
    _unit(line, request).memory[numbers.CONTROL_MODE] = Mode[request["to"].upper()]


def _input(line: SimulatedLine, request: ControlRequest) -> None:
    inputs = _unit(line, request).inputs
    getattr(inputs, request["input"])
    setattr(inputs, request["input"], bool(request["on"]))


def _parameter(line: SimulatedLine, request: ControlRequest) -> int:
    memory = _unit(line, request).memory
    if "raw" in request:
        memory[request["number"]] = int(request["raw"])
    return memory[request["number"]]


def _remove(line: SimulatedLine, request: ControlRequest) -> None:
    unit = _unit(line, request)
    line.plant.sections = [section for section in line.plant.sections if section.unit is not unit]


def _spare(line: SimulatedLine, request: ControlRequest) -> int:
    """A unit with factory values but for ``parameters`` joins the cable; its place there."""
    changed = {int(number): int(raw) for number, raw in request.get("parameters", {}).items()}
    traits = Traits(
        last_parameter=request.get("last_parameter", len(FACTORY)),
        baud_changes=request.get("baud_changes", "at power-up"),
    )
    line.plant.sections.append(Section(Unit(Memory(changed), traits)))
    return len(line.plant.sections) - 1


def _traits(line: SimulatedLine, request: ControlRequest) -> None:
    unit = _unit(line, request)
    unit.traits = replace(unit.traits, baud_changes=request["baud_changes"])


def _fault(line: SimulatedLine, request: ControlRequest) -> None:
    line.faults.set(FaultKind(request["kind"]), float(request["rate"]), request.get("unit", EVERY_UNIT))


def _state(line: SimulatedLine, request: ControlRequest) -> ControlRequest:
    unit = _unit(line, request)
    return {
        "commanded": unit.commanded,
        "actual": unit.measured.actual,
        "entered": unit.entered,
        "setpoint": unit.setpoint,
        "outputs": unit.outputs,
        "analog_output": unit.analog_output,
        "mode": unit.mode.name.lower(),
        "baud": unit.baud,
    }


def _record(line: SimulatedLine, request: ControlRequest) -> list[ControlRequest]:
    kinds = [Happened(kind) for kind in request.get("kinds", [])]
    entries = line.record.since(request.get("since", 0), *kinds)
    return [
        {
            "number": each.number,
            "at": each.at,
            "what": each.what,
            "unit": each.unit,
            "hex": each.data.hex(" "),
        }
        for each in entries
    ]


_ON_LINE: dict[str, Callable[[SimulatedLine, ControlRequest], object]] = {
    "mode": _mode,
    "input": _input,
    "parameter": _parameter,
    "power_cycle": lambda line, request: _unit(line, request).power_up(),
    "remove": _remove,
    "spare": _spare,
    "traits": _traits,
    "fault": _fault,
    "clear": lambda line, _request: line.faults.clear(),
    "hands_off": lambda line, _request: setattr(line.plant, "script", None),
    "state": _state,
    "record": _record,
}
_ON_SERVER: dict[str, Callable[[LineServer], object]] = {
    "unplug": LineServer.unplug,
    "plug": LineServer.plug,
    "port": lambda server: server.port.name,
}
