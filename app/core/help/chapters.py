"""The chapters of the handbook, in the order of their list. Pure.

Each is a Markdown file of docs/, which the repository shows as well as the page *Help*.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import PurePosixPath

from bus.messages import Message, term

LEARN, DO, LOOK_UP, UNDERSTAND = (
    term("Get started"),
    term("How to"),
    term("Reference"),
    term("Background"),
)


@dataclass(frozen=True, slots=True)
class Chapter:
    """``file``: below docs/; ``group``: its part of the list; ``languages``: those in which it is written
    besides English, each as a file ``name.LANGUAGE.md``."""

    file: str
    group: Message
    languages: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """What its address ends with."""
        return str(PurePosixPath(self.file).with_suffix("")).removeprefix("guide/")

    @property
    def is_one_page(self) -> bool:
        """Whether it is printed on one page."""
        return self.name.removesuffix("-page") in WITH_A_PAGE

    def file_in(self, language: str) -> str:
        """The file for a reader of this language."""
        return self.file.removesuffix(".md") + f".{language}.md" if language in self.languages else self.file


GERMAN = ("de",)
WITH_A_PAGE = ("operator", "electrician", "engineer", "administrator")
"""Those who have one page to print."""
CHAPTERS = (
    Chapter("guide/tutorial.md", LEARN),
    Chapter("guide/operator.md", LEARN, GERMAN),
    *(Chapter(f"guide/{role}-page.md", LEARN, GERMAN) for role in WITH_A_PAGE),
    Chapter("guide/troubleshooting.md", DO, GERMAN),
    Chapter("hardware.md", DO),
    Chapter("guide/recipes.md", DO),
    Chapter("guide/own-alarms.md", DO),
    Chapter("guide/reports.md", DO),
    Chapter("guide/replace-a-drive.md", DO),
    Chapter("guide/several-lines.md", DO),
    Chapter("guide/users.md", DO),
    Chapter("guide/company-accounts.md", DO),
    Chapter("guide/backup.md", DO),
    Chapter("spare.md", DO),
    Chapter("tls.md", DO),
    Chapter("containers.md", DO),
    Chapter("scale.md", DO),
    Chapter("plant-database.md", DO),
    Chapter("configuration.md", LOOK_UP),
    Chapter("alarms.md", LOOK_UP),
    Chapter("guide/command-line.md", LOOK_UP),
    Chapter("api.md", LOOK_UP),
    Chapter("guide/metrics.md", LOOK_UP),
    Chapter("guide/protocol.md", LOOK_UP),
    Chapter("glossary.md", LOOK_UP),
    Chapter("safety.md", UNDERSTAND),
    Chapter("security.md", UNDERSTAND),
    Chapter("audit.md", UNDERSTAND),
    Chapter("architecture.md", UNDERSTAND),
)
BY_NAME = {chapter.name: chapter for chapter in CHAPTERS}
BY_FILE = {name: chapter for chapter in CHAPTERS for name in (chapter.file, *map(chapter.file_in, GERMAN))}
