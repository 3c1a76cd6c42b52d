"""What every page and call shares: rendering, languages, problems, security headers, static files."""

from __future__ import annotations

from app.errors import Problem
from app.web.templating import Templates, render, templates_of

__all__ = ["Problem", "Templates", "render", "templates_of"]
