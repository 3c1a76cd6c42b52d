"""A device server that speaks RFC 2217: pySerial's own port manager between a socket and a serial port."""

from __future__ import annotations

import select
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType

import serial
import serial.rfc2217

LOOK_S = 0.02
Passing = Callable[[bytes], bytes]


class _PortWithoutPins(serial.Serial):
    """A pseudo-terminal without the modem lines that the port manager reads."""

    cts = dsr = ri = cd = property(lambda _: False)

    def _update_rts_state(self) -> None:
        """There is none."""

    def _update_dtr_state(self) -> None:
        """There is none."""


class DeviceServer:
    """``with DeviceServer(port) as server``: one host at a time, as such boxes have it."""

    def __init__(self, port: str) -> None:
        self._port = port
        self._stopping = threading.Event()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._number = self._listener.getsockname()[1]
        self._host: socket.socket | None = None
        self.bauds: list[int] = []
        """What hosts have set the port to."""
        self._thread = threading.Thread(target=self._run, daemon=True)

    @property
    def url(self) -> str:
        return f"rfc2217://127.0.0.1:{self._number}"

    def __enter__(self) -> DeviceServer:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stopping.set()
        self.hang_up()
        self._listener.close()
        self._thread.join()

    def hang_up(self) -> None:
        """End the present connection."""
        host, self._host = self._host, None
        if host is not None:
            with suppress(OSError):
                host.shutdown(socket.SHUT_RDWR)

    def write(self, data: bytes) -> None:
        """The port manager's way to the host."""
        if self._host is not None:
            with suppress(OSError):
                self._host.sendall(data)

    def _run(self) -> None:
        self._listener.settimeout(LOOK_S)
        while not self._stopping.is_set():
            with suppress(OSError):
                host, _ = self._listener.accept()
                with host, _PortWithoutPins(self._port, timeout=0) as port:
                    self._serve(host, port)

    def _serve(self, host: socket.socket, port: serial.Serial) -> None:
        self._host = host
        to_port, to_host = self._passing(port)
        while not self._stopping.is_set() and self._host is host:
            ready, _, _ = select.select([host, port], [], [], LOOK_S)
            if host in ready:
                data = host.recv(1024)
                if not data:
                    return
                port.write(to_port(data))
            if port.baudrate not in self.bauds:
                self.bauds.append(port.baudrate)
            if port in ready and (waiting := port.read(1024)):
                self.write(to_host(waiting))

    def _passing(self, port: serial.Serial) -> tuple[Passing, Passing]:
        """What becomes of bytes on their way to the port, and on their way to the host."""
        manager = serial.rfc2217.PortManager(port, self)
        return lambda data: b"".join(manager.filter(data)), lambda data: b"".join(manager.escape(data))
