"""pymodbus' asynchronous client in a bare loop, reading as many bytes as a DIGIMAX status response has."""

from __future__ import annotations

import asyncio
import sys
from contextlib import suppress

from pymodbus.client import AsyncModbusSerialClient
from pymodbus.exceptions import ModbusException

from benchmarks.modbus_line import REGISTERS


async def poll(port: str, units: int) -> None:
    client = AsyncModbusSerialClient(port, baudrate=9600, timeout=0.1, retries=0)
    await client.connect()
    while True:
        for unit in range(1, units + 1):
            with suppress(ModbusException):
                await client.read_holding_registers(0, count=REGISTERS, device_id=unit)


if __name__ == "__main__":
    asyncio.run(poll(sys.argv[1], int(sys.argv[2])))
