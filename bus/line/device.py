"""A local serial port, through pySerial and pyserial-asyncio, whose settings are kept as they were set.

Every program that may open the device can change its settings for all others: a terminal, a getty, a modem
prober. With foreign settings responses vanish for good, and with *echo* the kernel sends each response back
onto the wire. Comparing them costs 5 microseconds, so that is done before each request and after each read.
"""

from __future__ import annotations

import asyncio
import fcntl
import os
import select
import struct
import termios
import time
from array import array
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import serial
import serial_asyncio

from bus.errors import WireError
from bus.line.port import (
    OpenPort,
    PartlySent,
    PortProtocol,
    PortUnavailable,
    Receiver,
    in_use,
    is_pseudo_terminal,
    users_of,
    why_not,
)
from bus.messages import Message

IFLAG, OFLAG, CFLAG, LFLAG, _, OSPEED, CC = range(7)
"""The indexes of the list that ``termios.tcgetattr`` returns."""
_FLAGS = {
    IFLAG: "IGNBRK BRKINT IGNPAR PARMRK INPCK ISTRIP INLCR IGNCR ICRNL IUCLC IXON IXANY IXOFF IMAXBEL",
    OFLAG: "OPOST OLCUC ONLCR OCRNL ONOCR ONLRET OFILL OFDEL",
    CFLAG: "CSTOPB CREAD PARENB PARODD HUPCL CLOCAL CRTSCTS",
    LFLAG: "ISIG ICANON XCASE ECHO ECHOE ECHOK ECHONL NOFLSH TOSTOP ECHOCTL ECHOPRT ECHOKE FLUSHO IEXTEN",
}
"""The flags of each field, as termios(3) and, in lower case, stty(1) name them."""
_SIZES = {termios.CS5: "cs5", termios.CS6: "cs6", termios.CS7: "cs7", termios.CS8: "cs8"}
_SPEEDS = {getattr(termios, name): name[1:] for name in dir(termios) if name[1:].isdigit() and name[0] == "B"}
_COUNTS = {termios.VMIN: "min", termios.VTIME: "time"}
"""The only control characters that mean anything to a raw port."""


def differences(wanted: list[object], found: list[object]) -> list[str]:
    """Return how ``found`` differs from ``wanted``, both from ``tcgetattr``, in words of stty(1). Pure."""
    return list(_differences(wanted, found))


def _differences(wanted: list, found: list) -> Iterator[str]:  # type: ignore[type-arg]
    if wanted[OSPEED] != found[OSPEED]:
        yield f"{_SPEEDS.get(found[OSPEED], '?')} baud"
    if (size := found[CFLAG] & termios.CSIZE) != wanted[CFLAG] & termios.CSIZE:
        yield _SIZES[size]
    for field, names in _FLAGS.items():
        for name in names.split():
            flag = getattr(termios, name, 0)
            if (wanted[field] ^ found[field]) & flag:
                yield name.lower() if found[field] & flag else f"-{name.lower()}"
    for index, name in _COUNTS.items():
        count = found[CC][index]
        count = ord(count) if isinstance(count, bytes) else count
        if count != wanted[CC][index]:
            yield f"{name} {count}"


@dataclass(frozen=True, slots=True)
class _Control:
    """A setting that termios does not hold. ``get`` and ``set`` are ioctl_tty(2) requests, whose argument of
    ``size`` bytes has an integer at ``offset``, of which ``mask`` is the kept part."""

    name: str
    get: int
    set: int
    size: int = 4
    offset: int = 0
    mask: int = 0xFFFF_FFFF

    def read(self, descriptor: int) -> int | None:
        """Return the kept part, or None if the device has no such setting."""
        with suppress(OSError):
            return int(struct.unpack_from("I", self._argument(descriptor), self.offset)[0]) & self.mask
        return None

    def write(self, descriptor: int, value: int) -> None:
        with suppress(OSError):
            argument = bytearray(self._argument(descriptor))
            (found,) = struct.unpack_from("I", argument, self.offset)
            struct.pack_into("I", argument, self.offset, (found & ~self.mask) | value)
            fcntl.ioctl(descriptor, self.set, bytes(argument))

    def _argument(self, descriptor: int) -> bytes:
        return fcntl.ioctl(descriptor, self.get, bytes(self.size))


_RS485_ENABLED = 1
_RS485 = _Control("rs485", 0x542E, 0x542F, size=32)
"""The ioctls of Linux, which the standard library does not name."""
_MODEM_LINES = _Control(
    "dtr/rts", termios.TIOCMGET, termios.TIOCMSET, mask=termios.TIOCM_DTR | termios.TIOCM_RTS
)
_CONTROLS = (
    _Control("line discipline", termios.TIOCGETD, termios.TIOCSETD),
    _RS485,
    _MODEM_LINES,
    # ASYNC_LOW_LATENCY of serial_struct: an FTDI adapter's latency timer.
    _Control("low_latency", termios.TIOCGSERIAL, termios.TIOCSSERIAL, size=128, offset=16, mask=0x2000),
)


class PortSettings:
    """The settings of an open device, by its descriptor, without those that the device does not have."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._changed: dict[str, None] = {}
        self.keep()

    def keep(self) -> None:
        """Make the port raw, whatever was set before, and keep its settings so. Raise termios.error."""
        attributes = termios.tcgetattr(self._descriptor)
        attributes[IFLAG] = attributes[OFLAG] = attributes[LFLAG] = 0
        termios.tcsetattr(self._descriptor, termios.TCSANOW, attributes)
        termios.tcflow(self._descriptor, termios.TCOON)
        self._wanted = termios.tcgetattr(self._descriptor)
        controls = {each: each.read(self._descriptor) for each in _CONTROLS}
        if (controls[_RS485] or 0) & _RS485_ENABLED:
            # In this mode the kernel itself switches RTS.
            controls[_MODEM_LINES] = None
        self._controls = {each: value for each, value in controls.items() if value is not None}

    def restore(self) -> bool:
        """Restore what another program changed; return whether anything had changed.

        Bytes received meanwhile are dropped: *istrip* clears the highest bit of each byte, and an even number
        of cleared bits leaves the checksum right. Raise termios.error if the port is gone.
        """
        found = termios.tcgetattr(self._descriptor)
        if found == self._wanted:
            return False
        self._changed |= dict.fromkeys(differences(self._wanted, found))
        termios.tcsetattr(self._descriptor, termios.TCSANOW, self._wanted)
        termios.tcflow(self._descriptor, termios.TCOON)
        termios.tcflush(self._descriptor, termios.TCIFLUSH)
        self.restore_controls()
        return True

    def restore_controls(self) -> None:
        """Restore the settings that termios does not hold; with a USB adapter each may take a millisecond."""
        for control, wanted in self._controls.items():
            found = control.read(self._descriptor)
            if found is not None and found != wanted:
                self._changed[control.name] = None
                control.write(self._descriptor, wanted)

    def take_changed(self) -> list[str]:
        """Return the settings restored since the last call, in the words of stty(1)."""
        changed, self._changed = list(self._changed), {}
        return changed


_TIOCGEXCL = 0x80045440
"""The request of Linux 3.8 and newer, which the standard library does not name."""
COMPARE_S = 60.0
"""Seconds between comparisons of the modem lines and the like, which also follow each missing response."""


class DevicePort:
    def __init__(self, instance: GatedSerial, transport: Any, protocol: PortProtocol, name: str) -> None:
        self._serial = instance
        self._descriptor = instance.device
        self._settings = instance.settings = PortSettings(instance.device)
        self._is_silent, self._compared_at = False, time.monotonic()
        self._transport = transport
        self._protocol = protocol
        self._name = name

    def write(self, data: bytes) -> None:
        """Write straight to the descriptor, because the transport would wait for the loop's next turn."""
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

    def listen(self, *, now: bool) -> None:
        self._serial.listen(now=now)

    def drop_output(self) -> None:
        """Drop bytes that have not left yet, after a request without a response."""
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
        # After a failed read it closes by itself, and abort() would have pyserial-asyncio 0.6 close it twice.
        if not self._transport.is_closing():
            self._transport.abort()


async def open_device(path: str, baud: int, receiver: Receiver) -> OpenPort:
    """Open the device at ``path``. Raise PortUnavailable if that fails."""
    loop = asyncio.get_running_loop()
    try:
        instance = GatedSerial(path, baudrate=baud, timeout=0, write_timeout=0, exclusive=True)
    except (serial.SerialException, termios.error, OSError, ValueError) as error:
        raise PortUnavailable(why_not(path, error)) from error
    if is_claimed(instance.device, path):
        instance.close()
        raise PortUnavailable(in_use(path))
    # An FTDI adapter would keep bytes for 16 ms; ports without this setting refuse it.
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
    """Return whether another program claims the port exclusively (ioctl_tty(2), TIOCEXCL); nothing here does.

    Root may open such a port all the same, and a port that is open already stays so: two hosts on one line.
    The claim ends with the last descriptor of the device. The simulator of the line may keep one of a
    pseudo-terminal, so there the claim counts only while another process has it open.
    """
    claimed = array("i", [0])
    with suppress(OSError):
        fcntl.ioctl(descriptor, _TIOCGEXCL, claimed)
    return bool(claimed[0]) and (not is_pseudo_terminal(path) or bool(users_of(path)))


class GatedSerial(serial.Serial):
    """A port of pySerial that the event loop watches through a gate.

    The gate is an epoll descriptor that holds only the port. Opening or closing it is one system call;
    removing a descriptor from uvloop and adding it again is eight, 38 times a second.
    """

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        self._gate = select.epoll()
        super().__init__(*arguments, **settings)
        assert self.fd is not None
        self.device: int = self.fd
        self._gate.register(self.device, select.EPOLLIN)
        self.settings: PortSettings | None = None
        """The settings to restore when bytes come in; None before a DevicePort is made."""

    def fileno(self) -> int:
        """Return the descriptor of the gate, readable when wanted bytes have come in or the port is gone."""
        return self._gate.fileno()

    def listen(self, *, now: bool) -> None:
        if self.is_open:
            self._gate.modify(self.device, select.EPOLLIN if now else 0)

    def read(self, size: int = 1) -> bytes:
        """Return the available bytes, without those that came in under foreign settings.

        The event loop calls this only when there are some, so this is not checked again.
        """
        try:
            data = os.read(self.device, size)
            if self.settings is not None and self.settings.restore():
                return b""
        except BlockingIOError:
            return b""
        except (termios.error, OSError) as error:
            number = error.args[0] or 0
            raise serial.SerialException(number, os.strerror(number)) from error
        if not data and select.select([self.device], [], [], 0)[0]:
            raise serial.SerialException("the port is ready but has no device: the adapter was unplugged")
        return data

    def flush(self) -> None:
        """Drop what has not left; pyserial-asyncio would block its loop until everything has."""
        with suppress(termios.error, serial.SerialException, OSError):
            self.reset_output_buffer()

    def close(self) -> None:
        super().close()
        self._gate.close()
