"""A probe for an OPC UA server at a port, by the protocol's first message (OPC UA Part 6, 7.1)."""

from __future__ import annotations

import asyncio
import struct

WITHIN_S = 10.0
MAX_ACKNOWLEDGE = 28
EVERY_ADDRESS = {"0.0.0.0": "127.0.0.1", "::": "::1"}


async def is_opcua_server(host: str, port: int) -> bool:
    """Return whether an OPC UA server listens there: it acknowledges a hello. Raise OSError if nothing
    listens."""
    host = EVERY_ADDRESS.get(host, host)
    reader, writer = await asyncio.open_connection(host, port)
    try:
        writer.write(_hello(f"opc.tcp://{host}:{port}/"))
        async with asyncio.timeout(WITHIN_S):
            return (await reader.read(MAX_ACKNOWLEDGE)).startswith(b"ACKF")
    except TimeoutError:
        return False
    finally:
        writer.close()


def _hello(url: str) -> bytes:
    """Return a hello with the usual sizes of buffers, for messages of any size."""
    text = url.encode()
    body = struct.pack("<5Ii", 0, 65_535, 65_535, 0, 0, len(text)) + text
    return b"HELF" + struct.pack("<I", 8 + len(body)) + body
