"""minimalmodbus in a bare loop, reading as many bytes as a DIGIMAX status response has."""

from __future__ import annotations

import sys
from contextlib import suppress

import minimalmodbus

from benchmarks.modbus_line import REGISTERS


def poll(port: str, units: int) -> None:
    instruments = [minimalmodbus.Instrument(port, unit) for unit in range(1, units + 1)]
    for instrument in instruments:
        instrument.serial.baudrate = 9600
        instrument.serial.timeout = 0.1
    while True:
        for instrument in instruments:
            with suppress(minimalmodbus.ModbusException):
                instrument.read_registers(0, REGISTERS)


if __name__ == "__main__":
    poll(sys.argv[1], int(sys.argv[2]))
