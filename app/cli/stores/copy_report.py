"""What ``migrate-store`` shows of a copy: on a terminal how far it is, then one line for each table."""

from __future__ import annotations

import json
import sys
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import click

from app.cli.ending import report
from app.database.copying.site import CopyStep
from app.errors import StoreError
from app.web.api.shape import message_shown
from bus.instants import Monotonic, monotonic_now
from bus.messages import Message

MB = 1_000_000
SHOW_EVERY_S = 0.5


def is_terminal() -> bool:
    """Whether a person can see a line change."""
    return sys.stderr.isatty()


class CopyReport(ABC):
    """Collects the tables of a copy."""

    def __init__(self) -> None:
        self._tables: dict[tuple[str, str], CopyStep] = {}
        self._began: Monotonic = monotonic_now()

    def show(self, step: CopyStep) -> None:
        """A table is that far."""
        if step.progress.is_done:
            key = step.part.name, step.progress.table
            is_news = self._tables.get(key) != step
            self._tables[key] = step
            if is_news:
                self._table(step)

    def require_equal(self) -> None:
        """Raises StoreError where the sides differ."""
        if differing := [_name(step) for step in self._tables.values() if not step.progress.holds]:
            raise StoreError(Message.of("copy_differs", tables=differing))

    @property
    def _rows(self) -> int:
        return sum(step.progress.source.rows for step in self._tables.values())

    @abstractmethod
    def _table(self, step: CopyStep) -> None:
        """A table is done."""

    @abstractmethod
    def end_running(self, servers: Sequence[str]) -> None:
        """What there is is copied, while these servers go on."""

    @abstractmethod
    def end_finished(
        self, changes: Sequence[Message], proof: Sequence[Message], fault: Message | None
    ) -> None:
        """The copy is finished. Raises StoreError where the audit log does not hold."""

    def _running(self, servers: Sequence[str]) -> Message:
        seconds = round(monotonic_now() - self._began)
        return Message.of("copy_running", servers=[*servers], rows=self._rows, seconds=seconds)

    def _finished(self) -> Message:
        return Message.of("copy_finished", tables=len(self._tables), rows=self._rows)


class TextReport(CopyReport):
    """Lines for a person."""

    def __init__(self) -> None:
        super().__init__()
        self._shown = self._table_began = self._began
        self._at = 0
        self._is_terminal = is_terminal()

    def show(self, step: CopyStep) -> None:
        super().show(step)
        now, source = monotonic_now(), step.progress.source
        if source.rows == 0 or step.progress.is_done:
            self._table_began, self._at = now, source.size
        elif self._is_terminal and now - self._shown >= SHOW_EVERY_S:
            self._shown = now
            click.echo(f"\r\x1b[K{self._progress(step, now)}", err=True, nl=False)

    def _progress(self, step: CopyStep, now: Monotonic) -> Message:
        source, elapsed = step.progress.source, max(now - self._table_began, 0.001)
        left = round(elapsed * max(step.total - source.rows, 0) / source.rows)
        return Message.of(
            "copy_progress",
            table=_name(step),
            rows=source.rows,
            total=step.total,
            percent=min(100, 100 * source.rows // max(1, step.total)),
            size=source.size // MB,
            rate=round((source.size - self._at) / MB / elapsed),
            left=f"{left // 60}:{left % 60:02}",
        )

    def _table(self, step: CopyStep) -> None:
        if self._is_terminal:
            click.echo("\r\x1b[K", err=True, nl=False)
        source, target = step.progress.source, step.progress.target
        code = "copy_table" if step.progress.holds else "copy_table_differs"
        if not step.is_verified:
            code = "copy_table_running"
        report(
            Message.of(
                code,
                table=_name(step),
                rows=source.rows,
                size=source.size,
                digest=source.digest or "-",
                other_rows=target.rows,
                other_digest=target.digest or "-",
            )
        )

    def end_running(self, servers: Sequence[str]) -> None:
        report(self._running(servers))

    def end_finished(
        self, changes: Sequence[Message], proof: Sequence[Message], fault: Message | None
    ) -> None:
        for line in (*proof, self._finished(), *changes):
            report(line)
        _require_log(fault)


class JsonReport(CopyReport):
    """One JSON object in a line for each table, and one at the end."""

    def _table(self, step: CopyStep) -> None:
        source, target = step.progress.source, step.progress.target
        shown = {"store": step.part.name, "table": step.progress.table}
        if not step.is_verified:
            self._print({**shown, "rows": source.rows, "bytes": source.size, "equal": None})
            return
        sides = {
            name: {"rows": side.rows, "bytes": side.size, "digest": side.digest}
            for name, side in (("source", source), ("target", target))
        }
        self._print({**shown, **sides, "equal": step.progress.holds})

    def end_running(self, servers: Sequence[str]) -> None:
        self._print({"finished": False, "servers": [*servers], **message_shown(self._running(servers))})

    def end_finished(
        self, changes: Sequence[Message], proof: Sequence[Message], fault: Message | None
    ) -> None:
        lines = {"audit": [message_shown(line) for line in (*proof, *([fault] if fault else []))]}
        shown = {"finished": True, "audit_holds": fault is None, **lines}
        self._print(
            {**shown, "changes": [message_shown(line) for line in changes], **message_shown(self._finished())}
        )
        _require_log(fault)

    def _print(self, document: dict[str, Any]) -> None:
        click.echo(json.dumps(document))


def _name(step: CopyStep) -> str:
    return f"{step.part.name}.{step.progress.table}"


def _require_log(fault: Message | None) -> None:
    if fault is not None:
        raise StoreError(Message.of("copy_log_broken", reason=fault))
