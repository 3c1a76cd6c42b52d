"""Pages and fragments: one strict and escaping Jinja environment for each language, and the pages of the
rail."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from time import time
from typing import Any, NamedTuple

from jinja2 import Environment, FileSystemBytecodeCache, FileSystemLoader, StrictUndefined
from jinja2.bccache import Bucket
from starlette.requests import HTTPConnection
from starlette.responses import HTMLResponse

from app.core.messages import Language, Languages
from app.core.web.access import Caller, Role, caller_of, cookie_of
from app.core.web.assets import Assets
from app.core.web.formats import Formats
from app.core.web.services import service_of
from app.settings import Site
from bus.messages import Message, parameter_name


class Compiled(FileSystemBytecodeCache):
    """A store of compiled templates: compiling those of the first page takes a tenth of a second. One changed
    file is compiled again; a folder that cannot be written costs only that time."""

    def __init__(self, folder: Path) -> None:
        with suppress(OSError):
            folder.mkdir(0o700, parents=True, exist_ok=True)
        super().__init__(str(folder))

    def load_bytecode(self, bucket: Bucket) -> None:
        """Load the compiled form of one template, if it is stored."""
        with suppress(OSError):
            super().load_bytecode(bucket)

    def dump_bytecode(self, bucket: Bucket) -> None:
        with suppress(OSError):
            super().dump_bytecode(bucket)


WEBSOCKET_LINES = (
    'proxy_http_version 1.1; proxy_set_header Upgrade $http_upgrade; proxy_set_header Connection "upgrade";'
)
"""The lines that make nginx pass WebSockets."""


LANGUAGE_COOKIE = "lineside_language"
PagePart = Callable[[Caller | None, Language], Any]
"""A function that returns a part of every page for a reader, in the reader's language, from its first
paint."""


class Templates:
    """The templates and their rendering. In every template: ``t()``, ``tn()``, ``asset()``, ``imports()``,
    ``formats``, ``language``, ``languages``, ``site``, ``page_digest``, ``Role``, ``demo``, ``help_of``, and
    the filters ``parameter``, which names one by its number, and ``isolated``, for a name beside other text;
    in a page or fragment of a request also ``person``, ``request``, ``path``, ``has_lines()``,
    ``page_groups()``, the `parts` of features, and ``may()``, whether the person may send a command or
    perform an act, by its name. ``kept_in``: the folder of compiled templates between two starts."""

    def __init__(
        self,
        folder: Path,
        assets: Assets,
        site: Site,
        *,
        demo: bool = False,
        kept_in: Path | None = None,
        page_digest: str = "",
    ) -> None:
        self.languages = Languages(kept_in=kept_in, time_zone=site.zone)
        self.site = site
        self.page_digest = page_digest
        self._demo = demo
        self.parts: dict[str, PagePart] = {}
        """The parts that features show on every page, by the name of the function in a template."""
        self._roles: dict[str, Role] = {}
        self._assets = assets
        self._loader = FileSystemLoader(folder)
        self._compiled = Compiled(kept_in) if kept_in is not None else None
        self.environment = cache(self._environment)

    def _environment(self, tag: str) -> Environment:
        language = self.languages[tag].on_screen
        environment = Environment(
            loader=self._loader,
            bytecode_cache=self._compiled,
            autoescape=True,
            undefined=StrictUndefined,
            trim_blocks=True,
            lstrip_blocks=True,
        )
        environment.globals |= {
            "t": language.t,
            "tn": language.tn,
            "language": language,
            "languages": self.languages,
            "formats": self.formats(tag),
            "asset": self._assets.url,
            "imports": self._assets.imports,
            "site": self.site,
            "page_digest": self.page_digest,
            "demo": self._demo,
            "Role": Role,
            "help_of": HELP,
            "websocket_lines": WEBSOCKET_LINES,
        }
        environment.filters["parameter"] = lambda number: language.t(parameter_name(number))
        environment.filters["isolated"] = language.isolated
        return environment

    @property
    def is_unreal(self) -> bool:
        """Whether no drive is connected, in a demonstration or by the configuration."""
        return self._demo or self.site.simulated

    def formats(self, tag: str) -> Formats:
        """Return the formatting of numbers and times in a language."""
        return Formats(self.languages[tag].locale, self.site.zone)

    def text(self, tag: str, name: str, /, **context: Any) -> str:
        """Render a template in one language, without a request."""
        return self.environment(tag).get_template(name).render(context)

    def permit(self, roles: Mapping[str, Role]) -> None:
        """Add acts and commands with their roles, by the name that templates give to ``may()``. Raise
        RuntimeError for a name that exists already."""
        if twice := roles.keys() & self._roles.keys():
            raise RuntimeError(f"two commands or acts are named {', '.join(sorted(twice))}")
        self._roles |= roles

    def may(self, person: Caller | None, name: str) -> bool:
        """Return whether ``person`` may send a command or perform an act; each interface refuses others."""
        return person is not None and person.role.includes(self._roles[name])

    def language_of(self, connection: HTTPConnection) -> Language:
        person = caller_of(connection)
        # A browser without an account of its own, as in the demo, remembers the choice itself.
        preferred = (person.language if person else "") or cookie_of(connection, LANGUAGE_COOKIE)
        accepted = connection.headers.get("accept-language", "")
        return self.languages.choose(preferred, accepted, self.site.language)


def templates_of(connection: HTTPConnection) -> Templates:
    return service_of(connection, Templates)


def formats_of(connection: HTTPConnection) -> Formats:
    """Return the formatting of numbers and times for the reader of a page."""
    templates = templates_of(connection)
    return templates.formats(templates.language_of(connection).tag)


def render(
    request: HTTPConnection,
    name: str,
    /,
    *,
    status: int = 200,
    headers: Mapping[str, str] | None = None,
    **context: Any,
) -> HTMLResponse:
    """Render a page or fragment in the language of the request; no cache keeps it."""
    templates = templates_of(request)
    person = caller_of(request)
    language = templates.language_of(request).on_screen
    # The context is given beside these and not merged, so that it cannot replace one of them.
    html = templates.text(
        language.tag,
        name,
        person=person,
        may=partial(templates.may, person),
        request=request,
        path=request.url.path,
        now=time(),
        has_lines=lambda: service_of(request, PageLines).has_several,
        page_groups=lambda: _groups_for(service_of(request, PageLines), partial(templates.may, person)),
        **{name: partial(part, person, language) for name, part in templates.parts.items()},
        **context,
    )
    return HTMLResponse(html, status, {"Cache-Control": "no-store", **(headers or {})})


@dataclass(frozen=True, slots=True)
class PageLines:
    """The lines of the site. ``has_several``: whether there is a choice, counting peers; ``has_own``: whether
    this server has a bus."""

    has_several: bool
    has_own: bool

    @property
    def is_overview(self) -> bool:
        """Whether this server shows only the lines of others."""
        return self.has_several and not self.has_own


class PageLink(NamedTuple):
    """A page in the rail. ``key``: the value that a template sets as ``here``; ``drawing``: in the icons,
    empty for a tab; ``act``: the act that a person must be permitted."""

    key: str
    href: str
    drawing: str
    label: Message
    act: str = ""


class PageGroup(NamedTuple):
    """Pages that stand together in the rail. ``drawing``: that of the one item that stands for all of them if
    they are tabs; empty: each has its own."""

    label: Message
    pages: Sequence[PageLink]
    drawing: str = ""


OF_SERVER = frozenset(("lines", "alarms", "events", "system", "configuration", "users"))
"""The pages of a server that shows only the lines of its peers."""
LINES = PageLink("lines", "/lines", "dense", Message("page_lines"))
"""The page of all lines, only if there are several."""
GROUPS = (
    PageGroup(
        Message("page_group_line"),
        (
            PageLink("line", "/", "line", Message("page_line")),
            PageLink("alarms", "/alarms", "urgent", Message("page_alarms")),
            PageLink("setpoints", "/setpoints", "setpoints", Message("page_setpoints")),
            PageLink("trends", "/trends", "trends", Message("page_trends")),
        ),
    ),
    PageGroup(
        Message("page_group_records"),
        (
            PageLink("shifts", "/shifts", "clock", Message("page_shifts")),
            PageLink("events", "/events", "events", Message("page_events")),
        ),
    ),
    PageGroup(
        Message("page_group_engineering"),
        (
            PageLink("recipes", "/recipes", "recipes", Message("page_recipes")),
            PageLink("sets", "/sets", "sets", Message("page_sets")),
            PageLink("bus", "/bus", "bus", Message("page_bus")),
        ),
    ),
    PageGroup(
        Message("page_system"),
        (
            PageLink("system", "/system", "", Message("page_system")),
            PageLink(
                "configuration", "/configuration", "", Message("page_configuration"), "change_configuration"
            ),
            PageLink("users", "/users", "", Message("page_users"), "add_user"),
        ),
        "server",
    ),
)
"""The groups of the rail. A phone shows the first group's pages; the others are one press away under
*More*."""


HELP = {
    "line": "operator#the-line",
    "unit": "operator#a-unit",
    "setpoints": "operator#several-units-at-once",
    "alarms": "operator#alarms",
    "shifts": "operator#the-shift",
    "trends": "operator#trends",
    "events": "operator#events",
    "recipes": "recipes",
    "sets": "replace-a-drive",
    "bus": "hardware",
    "users": "users",
    "configuration": "configuration",
    "lines": "several-lines",
}
"""The chapter of the help for a page, by its ``key``; for all others the list of chapters."""


def _groups_for(lines: PageLines, may: Callable[[str], bool]) -> list[PageGroup]:
    """Return the groups of pages that a person has; ``may``: whether the person is permitted an act."""
    first = GROUPS[0]
    every = [first._replace(pages=(LINES, *first.pages)) if lines.has_several else first, *GROUPS[1:]]
    shown = [
        group._replace(
            pages=[
                page
                for page in group.pages
                if (not lines.is_overview or page.key in OF_SERVER) and (not page.act or may(page.act))
            ]
        )
        for group in every
    ]
    return [group for group in shown if group.pages]
