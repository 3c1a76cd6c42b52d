"""The log of a process, where it can be written and where it cannot."""

from __future__ import annotations

import errno
import io

from bus.worker.log import BestEffortStream


class FullDisk(io.StringIO):
    full = True

    def write(self, text: str) -> int:
        if self.full:
            raise OSError(errno.EFBIG, "File too large")
        return super().write(text)

    def flush(self) -> None:
        if self.full:
            raise OSError(errno.ENOSPC, "No space left on device")


def test_a_full_disk_costs_lines_and_raises_nothing() -> None:
    disk = FullDisk()
    log = BestEffortStream(disk)
    print("lost", file=log, flush=True)
    disk.full = False
    print("kept", file=log, flush=True)
    assert disk.getvalue() == "kept\n"
    disk.close()
    print("the pipe is closed", file=log, flush=True)
