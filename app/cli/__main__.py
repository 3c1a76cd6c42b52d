"""``python -m app.cli`` is ``lineside``."""

from __future__ import annotations

from app.cli import main

main()
