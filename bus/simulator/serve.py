"""A simulated line at a real port, served by one thread, and its remote control over TCP.

The thread sleeps until shortly before the next byte is due and watches the clock for the rest, so the host
never gets a byte before a UART would have given it, and hardly later.

The remote control takes JSON lines: ``{"do": "mode", "unit": 3, "to": "local"}`` → ``{"ok": true}``, or
``{"ok": false, "error": "…"}``. A unit is named by its address ``unit`` or, if two units have the same
address, by its ``place`` on the cable.
"""

from __future__ import annotations

import ctypes
import json
import os
import queue
import select
import socketserver
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from typing import Any, TypeVar

from bus.catalogue import parameters as numbers
from bus.simulator.line import EVERY_UNIT, FaultKind, SimulatedLine, WireEvent, WireEventKind
from bus.simulator.plant import Plant, Section
from bus.simulator.ports import Port, Wake
from bus.simulator.unit import FACTORY, Memory, Mode, Traits, Unit

T = TypeVar("T")

WATCH_S = 150e-6
"""The seconds before a frame's last byte is due when the thread stops sleeping: its wake-up time."""
LISTEN_S = 500e-6
"""The seconds after a byte for which the thread stays awake, to know when the next request came."""
_PR_SET_TIMERSLACK = 29


class LineServer:
    """A server of ``line`` at ``port`` while it is entered; on leaving, its units are off and the port is
    gone."""

    def __init__(self, line: SimulatedLine, port: Port) -> None:
        self.line = line
        self.port = port
        self._calls: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._waked, self._waker = os.pipe()
        self._stopping = False
        self._listening_until = 0.0
        self._thread = threading.Thread(target=self._run, name="simulated line", daemon=True)

    def __enter__(self) -> LineServer:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopping = True
        os.write(self._waker, b".")
        self._thread.join()
        self.port.unplug()
        os.close(self._waked)
        os.close(self._waker)

    def call(self, change: Callable[[SimulatedLine], T]) -> T:
        """Run ``change`` on the line between two bytes, in its own thread; return its result."""
        future: Future[T] = Future()

        def run() -> None:
            try:
                future.set_result(change(self.line))
            except Exception as error:
                future.set_exception(error)

        self._calls.put(run)
        os.write(self._waker, b".")
        return future.result(timeout=10)

    def unplug(self) -> None:
        """Pull the cable: the host's port is gone, with everything under way."""

        def pull(line: SimulatedLine) -> None:
            self.port.unplug()
            line.unplug()

        self.call(pull)

    def plug(self) -> None:
        """Put the cable back; a pseudo-terminal comes back under another name behind the same link."""
        self.call(lambda _line: self.port.plug())

    def _run(self) -> None:
        _sharpen_timer()
        while not self._stopping:
            reply = self.line.advance(time.monotonic())
            if reply:
                self.port.write(reply)
            self._wait(self.line.wake())

    def _wait(self, wake: Wake) -> None:
        now = time.monotonic()
        sleep = 0.0 if now < self._listening_until else wake.at - now - WATCH_S * wake.sharp
        ready, _, _ = select.select([self._waked, *self.port.descriptors()], [], [], max(sleep, 0.0))
        if not ready:
            if wake.sharp and sleep > 0.0:
                while time.monotonic() < wake.at:
                    pass
                self._listening_until = wake.at + LISTEN_S
            return
        if self._waked in ready:
            os.read(self._waked, 64)
            while not self._calls.empty():
                self._calls.get()()
        else:
            now, data = time.monotonic(), self.port.read()
            if data:
                self.line.receive(now, data, self.port.host_baud())


def _sharpen_timer() -> None:
    """Set the thread's timer slack on Linux to the minimum; the usual 50 µs is two percent of a byte time."""
    prctl: Any = getattr(ctypes.CDLL(None), "prctl", None)
    if prctl is not None:
        prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)


ControlRequest = dict[str, Any]


@contextmanager
def control_port(server: LineServer, port: int = 0) -> Iterator[int]:
    """Serve control requests for the line of ``server``; yield the TCP port."""

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
            # Keys in JSON are always texts.
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
