"""A local serial port, through pyserial-asyncio."""

from __future__ import annotations

import asyncio
import fcntl
import os
import termios
from array import array
from contextlib import suppress
from typing import Any

import serial
import serial_asyncio

from bus.errors import WireError
from bus.line.port.device_users import is_played, users_of
from bus.line.port.gated_serial import GatedSerial
from bus.line.port.open_error import in_use, why_not
from bus.line.port.port import OpenPort, PartlySent, PortUnavailable, Receiver
from bus.line.port.port_protocol import PortProtocol
from bus.messages import Message

_TIOCGEXCL = 0x80045440
"""Linux, 3.8 and newer; the standard library does not name it."""


class DevicePort:
    """An open one."""

    def __init__(self, instance: GatedSerial, transport: Any, protocol: PortProtocol, name: str) -> None:
        self._serial = instance
        self._descriptor = instance.device
        self._transport = transport
        self._protocol = protocol
        self._name = name

    def write(self, data: bytes) -> None:
        """Straight to the descriptor: the transport would wait for the loop's next turn."""
        try:
            written = os.write(self._descriptor, data)
        except BlockingIOError as error:
            raise WireError(Message.of("port_blocked", port=self._name)) from error
        except OSError as error:
            reason = os.strerror(error.errno or 0)
            raise WireError(Message.of("port_gone_error", port=self._name, error=reason)) from error
        if written != len(data):
            raise PartlySent(Message.of("port_partly_sent", port=self._name, sent=written, all=len(data)))

    def listen(self, *, now: bool) -> None:
        self._serial.listen(now=now)

    def drop_output(self) -> None:
        with suppress(termios.error, OSError):
            termios.tcflush(self._descriptor, termios.TCOFLUSH)

    def retune(self, baud: int) -> None:
        try:
            self._serial.baudrate = baud
        except (serial.SerialException, termios.error, OSError, ValueError) as error:
            message = Message.of("port_baud_refused", port=self._name, baud=baud, error=str(error))
            raise WireError(message) from error

    def check(self) -> None:
        try:
            termios.tcgetattr(self._descriptor)
        except (termios.error, OSError) as error:
            raise WireError(Message.of("adapter_gone", port=self._name)) from error
        if _is_claimed(self._descriptor, self._name):
            raise WireError(in_use(self._name))

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
        instance = GatedSerial(path, baudrate=baud, timeout=0, write_timeout=0, exclusive=True)
    except (serial.SerialException, termios.error, OSError, ValueError) as error:
        raise PortUnavailable(why_not(path, error)) from error
    if _is_claimed(instance.device, path):
        instance.close()
        raise PortUnavailable(in_use(path))
    _prefer_low_latency(instance)
    protocol = PortProtocol(receiver, Message.of("adapter_gone", port=path))
    transport, _ = await serial_asyncio.connection_for_serial(loop, lambda: protocol, instance)
    try:
        await protocol.made
    except asyncio.CancelledError:
        transport.abort()
        raise
    return DevicePort(instance, transport, protocol, path)


def _is_claimed(descriptor: int, path: str) -> bool:
    """Return whether another program claims the port exclusively (ioctl_tty(2), TIOCEXCL; nothing here does).
    Root may open such a port all the same, and one that is open already stays so: two hosts on one line.

    The claim ends with the last descriptor of the device. On a pseudo-terminal the simulator of the line may
    keep one, so there it applies while another process has it open.
    """
    claimed = array("i", [0])
    with suppress(OSError):
        fcntl.ioctl(descriptor, _TIOCGEXCL, claimed)
    return bool(claimed[0]) and (not is_played(path) or bool(users_of(path)))


def _prefer_low_latency(instance: GatedSerial) -> None:
    """An FTDI adapter would keep bytes for 16 ms; ports that know no such setting refuse it."""
    with suppress(ValueError, OSError, NotImplementedError, AttributeError):
        instance.set_low_latency_mode(True)
