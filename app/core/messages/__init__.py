"""The texts for people in each language: one gettext catalog, a ``.po`` file of this folder, for each."""

from __future__ import annotations

from app.core.messages.languages import DEFAULT, Language, Languages

__all__ = ["DEFAULT", "Language", "Languages"]
