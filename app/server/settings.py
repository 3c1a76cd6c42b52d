"""``[server.tls]`` of lineside.toml."""

from __future__ import annotations

from pathlib import Path

from bus.settings import StrictModel


class TlsSettings(StrictModel):
    """HTTPS and WSS. PEM files, relative to the configuration; absolute once loaded."""

    certificate: Path
    """The server's certificate, and after it those that lead to its authority."""
    key: Path
    client_ca: Path | None = None
    """The authority of the workers: each must show a certificate that it has signed."""

    @property
    def files(self) -> tuple[Path, ...]:
        return (self.certificate, self.key, *([self.client_ca] if self.client_ca else []))

    def in_folder(self, folder: Path) -> TlsSettings:
        """With absolute paths."""
        paths = {name: folder / value.expanduser() for name, value in self if isinstance(value, Path)}
        return self.model_copy(update=paths)
