"""The settings of a local serial device, kept as they were set when it was opened.

Every program that may open the device can change them for all others: a terminal, a getty, a modem prober.
With foreign settings responses vanish for good, and with *echo* the kernel sends each response back onto the
wire. Comparing them costs 5 microseconds, so that is done before each request and after each read.
"""

from __future__ import annotations

import fcntl
import struct
import termios
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

IFLAG, OFLAG, CFLAG, LFLAG, _, OSPEED, CC = range(7)
"""Of what ``termios.tcgetattr`` gives."""
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
    """How ``found`` differs from ``wanted``, both of ``tcgetattr``, in the words of stty(1). Pure."""
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
    """A setting beside those of termios, where the device has it: ``get`` and ``set`` are ioctl_tty(2)
    requests, ``mask`` is what is kept of the integer at ``offset`` in their argument of ``size`` bytes."""

    name: str
    get: int
    set: int
    size: int = 4
    offset: int = 0
    mask: int = 0xFFFF_FFFF

    def read(self, descriptor: int) -> int | None:
        """The kept part; None where the device has no such setting."""
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
"""Linux; the standard library names neither request."""
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
    """Of an open device, by its descriptor. A setting that it does not have is left out."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._changed: dict[str, None] = {}
        self.keep()

    def keep(self) -> None:
        """Make the port raw, whatever was set before, and keep its settings so. Raises termios.error."""
        attributes = termios.tcgetattr(self._descriptor)
        attributes[IFLAG] = attributes[OFLAG] = attributes[LFLAG] = 0
        termios.tcsetattr(self._descriptor, termios.TCSANOW, attributes)
        termios.tcflow(self._descriptor, termios.TCOON)
        self._wanted = termios.tcgetattr(self._descriptor)
        controls = {each: each.read(self._descriptor) for each in _CONTROLS}
        if (controls[_RS485] or 0) & _RS485_ENABLED:
            # The kernel itself switches RTS then.
            controls[_MODEM_LINES] = None
        self._controls = {each: value for each, value in controls.items() if value is not None}

    def restore(self) -> bool:
        """Put back what another program changed; return whether there was anything.

        What came in meanwhile is dropped: *istrip* takes the highest bits of bytes, and an even number of
        them leaves the checksum right. Raises termios.error where the port is gone.
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
        """Put back what is beside the settings of termios; with a USB adapter each may take a millisecond."""
        for control, wanted in self._controls.items():
            found = control.read(self._descriptor)
            if found is not None and found != wanted:
                self._changed[control.name] = None
                control.write(self._descriptor, wanted)

    def take_changed(self) -> list[str]:
        """What was put back since the last call, in the words of stty(1)."""
        changed, self._changed = list(self._changed), {}
        return changed
