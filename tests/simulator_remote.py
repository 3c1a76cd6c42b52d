"""Control of a simulated line in another process."""

from __future__ import annotations

import json
import socket
from typing import Any


class Remote:
    """The other end of ``control_port``, in another process."""

    def __init__(self, port: int) -> None:
        self._socket = socket.create_connection(("127.0.0.1", port))
        self._stream = self._socket.makefile("rw", encoding="utf-8")

    def do(self, action: str, **details: object) -> Any:
        """Return the result of ``action``. Raises RuntimeError with the line's error text."""
        self._stream.write(json.dumps({"do": action, **details}) + "\n")
        self._stream.flush()
        response = json.loads(self._stream.readline())
        if not response["ok"]:
            raise RuntimeError(response["error"])
        return response.get("result")

    def close(self) -> None:
        self._stream.close()
        self._socket.close()
