"""The static files, kept in memory under an address that changes with their content."""

from __future__ import annotations

import gzip
import hashlib
import posixpath
import re
from collections.abc import Iterator
from pathlib import Path

from starlette.requests import Request
from starlette.responses import Response

from app.errors import Problem
from bus.messages import Message

_ROOT = Path(__file__).resolve().parents[3]
_PACKED = Path(__file__).resolve().parents[2] / "_assets"
_STYLES_IMPORT = re.compile(rb'^@import "([\w./-]+)";$', re.MULTILINE)
_STYLES_COMMENT = re.compile(rb"/\*.*?\*/\n?", re.DOTALL)
_MODULE_COMMENT = re.compile(rb"^[ \t]*(?://[^\n]*|/\*(?:(?!\*/).)*\*/[ \t]*)$", re.DOTALL | re.MULTILINE)
"""A comment on complete lines, which no string has to be distinguished from."""
_MODULE_IMPORT = re.compile(r'^(?:import|export)\b(?!\()[^;]*?"(\.[\w./-]+)";$', re.MULTILINE)
_MEDIA_TYPES = {
    ".css": "text/css",
    ".js": "text/javascript",
    ".png": "image/png",
    ".svg": "image/svg+xml",
    ".txt": "text/plain",
    ".webmanifest": "application/manifest+json",
    ".woff2": "font/woff2",
}
"""The media types by suffix: mimetypes would keep the thousand types of the system in memory."""
_TEXT = ("text/", "application/javascript", "application/json", "application/manifest+json", "image/svg+xml")


def _folder(name: str) -> Path:
    """Return a folder of the project: inside the package in a wheel, at its root in a checkout."""
    packed = _PACKED / name
    return packed if packed.is_dir() else _ROOT / name


def templates_dir() -> Path:
    return _folder("templates")


def static_dir() -> Path:
    return _folder("static")


def docs_dir() -> Path:
    return _folder("docs")


def _beside(name: str, path: str) -> str:
    """Return the name of a file that another file names relative to its own place."""
    return posixpath.normpath(posixpath.join(posixpath.dirname(name), path))


def _without_comments(name: str, body: bytes) -> bytes:
    """Return a file without comments. The lines of a module keep their numbers; third-party files keep the
    comments with their licenses."""
    if name.startswith("vendor/"):
        return body
    if name.endswith(".css"):
        return _STYLES_COMMENT.sub(b"", body)
    if name.endswith(".js"):
        return _MODULE_COMMENT.sub(lambda comment: b"\n" * comment[0].count(b"\n"), body)
    return body


class Asset:
    """A file as it is sent, kept as gzip if that is smaller."""

    def __init__(self, body: bytes, media_type: str) -> None:
        self.media_type = media_type
        self.tag = f'"{hashlib.sha256(body).hexdigest()[:16]}"'
        """The tag that identifies the content."""
        self._form: tuple[bytes, bool | None] = (body, None)
        """The content, and whether it is packed; None: not tried yet."""

    @property
    def body(self) -> bytes:
        content, is_packed = self._form
        return gzip.decompress(content) if is_packed else content

    def pack(self) -> bool:
        """Gzip the content with the first call, in any thread; return whether it is kept so."""
        content, is_packed = self._form
        if is_packed is None:
            is_text = self.media_type.startswith(_TEXT)
            packed = gzip.compress(content, 9, mtime=0) if is_text else content
            is_packed = len(packed) < len(content)
            self._form = (packed if is_packed else content, is_packed)
        return is_packed

    def response(self, request: Request, cache_control: str) -> Response:
        """Send the file, gzipped for a client that accepts it, and without content to one that has it
        already."""
        # The tag is weak: the same content may be sent in two encodings (RFC 9110, 8.8.1).
        headers = {"Cache-Control": cache_control, "Vary": "Accept-Encoding", "ETag": f"W/{self.tag}"}
        if self.tag in request.headers.get("if-none-match", ""):
            return Response(status_code=304, headers=headers)
        if not self.pack() or "gzip" not in request.headers.get("accept-encoding", ""):
            return Response(self.body, media_type=self.media_type, headers=headers)
        headers["Content-Encoding"] = "gzip"
        return Response(self._form[0], media_type=self.media_type, headers=headers)


class Assets:
    """The files below one folder. Their address holds one hash of all of them, so that a module's relative
    import stays inside the same version."""

    def __init__(self, folder: Path) -> None:
        self._files = {path.relative_to(folder).as_posix(): path for path in sorted(folder.rglob("*"))}
        self._files = {name: path for name, path in self._files.items() if path.is_file()}
        self._loaded: dict[str, Asset] = {}
        self._imports: dict[str, list[str]] = {}
        self.version = self._digest()

    def _digest(self) -> str:
        digest = hashlib.sha256()
        for name, path in self._files.items():
            digest.update(f"{name}\0{path.stat().st_size}\0".encode())
            digest.update(path.read_bytes())
        return digest.hexdigest()[:12]

    def url(self, name: str) -> str:
        """Return the address of a file, for example ``asset("css/lineside.css")``."""
        return f"/static/{self.version}/{name}"

    def get(self, name: str) -> Asset:
        """Return a file by its name. Raise Problem 404 for an unknown one."""
        if name not in self._files:
            raise Problem(404, "not_found", Message.of("no_such_file", path=name))
        if name not in self._loaded:
            media_type = _MEDIA_TYPES.get(Path(name).suffix, "application/octet-stream")
            self._loaded[name] = Asset(self._read(name), media_type)
        return self._loaded[name]

    def _read(self, name: str) -> bytes:
        """Read a file without comments, which are a quarter of a first visit's bytes; a stylesheet with its
        imports, because a request for every part would keep the first page waiting."""
        body = _without_comments(name, self._files[name].read_bytes())
        if not name.endswith(".css"):
            return body
        return _STYLES_IMPORT.sub(lambda found: self._read(_beside(name, found[1].decode())), body)

    def imports(self, module: str) -> list[str]:
        """Return the addresses of all modules that a module needs before it runs, for a page to request at
        once. Later imports, by a call, are left out. Raise Problem 404."""
        if module not in self._imports:
            needed: dict[str, None] = {}
            self._add_imports(module, needed)
            self._imports[module] = [self.url(name) for name in needed if name != module]
        return self._imports[module]

    def _add_imports(self, module: str, needed: dict[str, None]) -> None:
        for path in _MODULE_IMPORT.findall(self.get(module).body.decode()):
            name = _beside(module, path)
            if name not in needed:
                needed[name] = None
                if name in self._files:
                    self._add_imports(name, needed)

    def __iter__(self) -> Iterator[str]:
        return iter(self._files)
