"""pySerial as a loop needs it: read only on demand, each read returns at once, closing never waits."""

from __future__ import annotations

import os
import select
import termios
from contextlib import suppress
from typing import Any

import serial


class GatedSerial(serial.Serial):
    """The loop watches a gate in front of the port and not the port itself.

    The gate is an epoll descriptor in which the port is the only one. To open or to close it is one system
    call; to take a descriptor out of uvloop and to put it back is eight, 38 times a second.
    """

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        self._gate = select.epoll()
        super().__init__(*arguments, **settings)
        assert self.fd is not None
        self.device: int = self.fd
        self._gate.register(self.device, select.EPOLLIN)

    def fileno(self) -> int:
        """What becomes readable when there is something that is wanted, or the port is gone."""
        return self._gate.fileno()

    def listen(self, *, now: bool) -> None:
        """Open the gate or close it."""
        if self.is_open:
            self._gate.modify(self.device, select.EPOLLIN if now else 0)

    def read(self, size: int = 1) -> bytes:
        """Return the available bytes. The loop has seen that there are some, so this is not checked again."""
        try:
            data = os.read(self.device, size)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise serial.SerialException(error.errno, os.strerror(error.errno or 0)) from error
        if not data and select.select([self.device], [], [], 0)[0]:
            raise serial.SerialException("the port is ready but has no device: the adapter was unplugged")
        return data

    def flush(self) -> None:
        """pyserial-asyncio would wait on its loop until every byte has left."""
        with suppress(termios.error, serial.SerialException, OSError):
            self.reset_output_buffer()

    def close(self) -> None:
        """Give the device back, and the gate."""
        super().close()
        self._gate.close()
