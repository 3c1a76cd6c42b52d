"""A local serial port, through pySerial and pyserial-asyncio."""

from __future__ import annotations

import asyncio
import fcntl
import os
import select
import termios
import time
from array import array
from contextlib import suppress
from typing import Any

import serial
import serial_asyncio

from bus.errors import WireError
from bus.line.port.open_error import in_use, is_pseudo_terminal, users_of, why_not
from bus.line.port.port import OpenPort, PartlySent, PortProtocol, PortUnavailable, Receiver
from bus.line.port.port_settings import PortSettings
from bus.messages import Message

_TIOCGEXCL = 0x80045440
"""Linux, 3.8 and newer; the standard library does not name it."""
COMPARE_S = 60.0
"""Between two looks at the modem lines and the like, and at once after a request without a response."""


class DevicePort:
    def __init__(self, instance: DeviceSerial, transport: Any, protocol: PortProtocol, name: str) -> None:
        self._serial = instance
        self._descriptor = instance.fileno()
        self._settings = instance.settings = PortSettings(instance.fileno())
        self._is_silent, self._compared_at = False, time.monotonic()
        self._transport = transport
        self._protocol = protocol
        self._name = name

    def write(self, data: bytes) -> None:
        """Straight to the descriptor: the transport would wait for the loop's next turn."""
        try:
            self._settings.restore()
            written = os.write(self._descriptor, data)
        except BlockingIOError as error:
            raise WireError(Message.of("port_blocked", port=self._name)) from error
        except (termios.error, OSError) as error:
            reason = os.strerror(error.args[0] or 0)
            raise WireError(Message.of("port_gone_error", port=self._name, error=reason)) from error
        if written != len(data):
            raise PartlySent(Message.of("port_partly_sent", port=self._name, sent=written, all=len(data)))

    def drop_output(self) -> None:
        """After a request without a response."""
        self._is_silent = True
        with suppress(termios.error, OSError):
            termios.tcflush(self._descriptor, termios.TCOFLUSH)

    def retune(self, baud: int) -> None:
        try:
            self._serial.baudrate = baud
            self._settings.keep()
        except (serial.SerialException, termios.error, OSError, ValueError) as error:
            message = Message.of("port_baud_refused", port=self._name, baud=baud, error=str(error))
            raise WireError(message) from error

    def check(self) -> list[str]:
        try:
            self._settings.restore()
            if self._is_silent or time.monotonic() - self._compared_at >= COMPARE_S:
                self._is_silent, self._compared_at = False, time.monotonic()
                self._settings.restore_controls()
        except (termios.error, OSError) as error:
            raise WireError(Message.of("adapter_gone", port=self._name)) from error
        if is_claimed(self._descriptor, self._name):
            raise WireError(in_use(self._name))
        return self._settings.take_changed()

    def close(self) -> None:
        if self._protocol.closed:
            return
        self._protocol.closed = True
        self.drop_output()
        # Once it closes after a failed read, abort() would have pyserial-asyncio 0.6 close it a second time.
        if not self._transport.is_closing():
            self._transport.abort()


async def open_device(path: str, baud: int, receiver: Receiver) -> OpenPort:
    """Open the device at ``path``. Raises PortUnavailable."""
    loop = asyncio.get_running_loop()
    try:
        instance = DeviceSerial(path, baudrate=baud, timeout=0, write_timeout=0, exclusive=True)
    except (serial.SerialException, termios.error, OSError, ValueError) as error:
        raise PortUnavailable(why_not(path, error)) from error
    if is_claimed(instance.fileno(), path):
        instance.close()
        raise PortUnavailable(in_use(path))
    # An FTDI adapter would keep bytes for 16 ms; ports that know no such setting refuse it.
    with suppress(ValueError, OSError, NotImplementedError, AttributeError):
        instance.set_low_latency_mode(True)
    protocol = PortProtocol(receiver, Message.of("adapter_gone", port=path))
    transport, _ = await serial_asyncio.connection_for_serial(loop, lambda: protocol, instance)
    try:
        await protocol.made
    except asyncio.CancelledError:
        transport.abort()
        raise
    return DevicePort(instance, transport, protocol, path)


def is_claimed(descriptor: int, path: str) -> bool:
    """Return whether another program claims the port exclusively (ioctl_tty(2), TIOCEXCL; nothing here does).
    Root may open such a port all the same, and one that is open already stays so: two hosts on one line.

    The claim ends with the last descriptor of the device. On a pseudo-terminal the simulator of the line may
    keep one, so there it applies while another process has it open.
    """
    claimed = array("i", [0])
    with suppress(OSError):
        fcntl.ioctl(descriptor, _TIOCGEXCL, claimed)
    return bool(claimed[0]) and (not is_pseudo_terminal(path) or bool(users_of(path)))


class DeviceSerial(serial.Serial):
    """A serial device that gives nothing which came in under foreign settings, and that never waits."""

    settings: PortSettings | None = None
    """Until a DevicePort has it, nothing is requested."""

    def read(self, size: int = 1) -> bytes:
        """Return the available bytes, none that came in under foreign settings.

        The loop has seen that there are some, so this is not checked again.
        """
        try:
            data = os.read(self.fileno(), size)
            if self.settings is not None and self.settings.restore():
                return b""
        except BlockingIOError:
            return b""
        except (termios.error, OSError) as error:
            number = error.args[0] or 0
            raise serial.SerialException(number, os.strerror(number)) from error
        if not data and select.select([self.fileno()], [], [], 0)[0]:
            raise serial.SerialException("the port is ready but has no device: the adapter was unplugged")
        return data

    def flush(self) -> None:
        """pyserial-asyncio would wait on its loop until every byte has left."""
        with suppress(termios.error, serial.SerialException, OSError):
            self.reset_output_buffer()
