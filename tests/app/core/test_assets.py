"""Static files as they are sent, and templates that stay compiled between two starts."""

from __future__ import annotations

import gzip
import re
import subprocess
from pathlib import Path

import pytest
from jinja2 import DictLoader, Environment
from starlette.requests import Request

from app.core.web.access import Role
from app.core.web.assets import Assets, static_dir, templates_dir
from app.core.web.templating import Compiled
from app.errors import Problem
from tests.app.complete_app import House
from tests.for_each import for_each

TSC = Path(__file__).resolve().parents[3] / "node_modules" / ".bin" / "tsc"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "js").mkdir()
    (tmp_path / "js" / "a.js").write_text("export const a = 1;\n" * 50)
    (tmp_path / "logo.png").write_bytes(b"\x89PNG" + bytes(100))
    return tmp_path


def request(accept_encoding: str = "gzip, br") -> Request:
    headers = [(b"accept-encoding", accept_encoding.encode())]
    return Request({"type": "http", "method": "GET", "path": "/", "headers": headers})


def test_the_address_changes_with_any_file(folder: Path) -> None:
    before = Assets(folder).url("js/a.js")
    assert before == Assets(folder).url("js/a.js")
    (folder / "logo.png").write_bytes(b"other")
    after = Assets(folder).url("js/a.js")
    assert before != after
    assert after.endswith("/js/a.js"), "so that a module's relative import stays in its version"


def test_text_is_packed_for_who_takes_it(folder: Path) -> None:
    packed = Assets(folder).get("js/a.js").response(request(), "no-cache")
    assert packed.headers["content-encoding"] == "gzip"
    assert packed.headers["vary"] == "Accept-Encoding"
    assert gzip.decompress(bytes(packed.body)) == (folder / "js" / "a.js").read_bytes()
    plain = Assets(folder).get("js/a.js").response(request(""), "no-cache")
    assert "content-encoding" not in plain.headers
    picture = Assets(folder).get("logo.png").response(request(), "no-cache")
    assert "content-encoding" not in picture.headers


@for_each("name", ["../secret", "js/../../secret", "/etc/passwd", "js", "", "js/b.js"])
def test_only_what_was_there_at_the_start_is_served(folder: Path, name: str) -> None:
    (folder.parent / "secret").write_text("x")
    with pytest.raises(Problem) as caught:
        Assets(folder).get(name)
    assert caught.value.status == 404


async def test_a_stylesheet_needs_no_sign_in(house: House) -> None:
    url = house.services[Assets].url("css/tokens.css")
    result = await house.client().get(url)
    assert result.status_code == 200
    assert result.headers["content-type"].startswith("text/css")
    assert result.headers["cache-control"] == "public, max-age=31536000, immutable"
    other = await house.client().get("/static/older/css/tokens.css")
    assert (other.status_code, other.headers["cache-control"]) == (200, "no-cache")


async def test_every_file_that_the_frame_requests_exists(house: House) -> None:
    page = (await house.client().get("/login")).text
    urls = [part.split('"')[0] for part in page.split('"/static/')[1:]]
    assert urls
    for url in urls:
        path = "/static/" + url.split("#")[0]
        if "/vendor/" not in path:
            assert (await house.client().get(path)).status_code == 200, path


def test_the_folders_are_found() -> None:
    assert (static_dir() / "css").is_dir()
    assert (templates_dir() / "base.html").is_file()


def test_a_stylesheet_is_sent_with_what_it_imports_in_its_place(tmp_path: Path) -> None:
    (tmp_path / "css" / "parts").mkdir(parents=True)
    (tmp_path / "css" / "all.css").write_text('@import "first.css";\n@import "parts/last.css";\n')
    (tmp_path / "css" / "first.css").write_text("a {}\n")
    (tmp_path / "css" / "parts" / "last.css").write_text('@import "../first.css";\nb {}\n')
    assert Assets(tmp_path).get("css/all.css").body.split() == b"a {} a {} b {}".split()


def test_every_import_of_a_stylesheet_exists() -> None:
    assets = Assets(static_dir())
    for name in assets:
        if name.endswith(".css"):
            assert b"@import" not in assets.get(name).body, name


def test_all_that_a_module_imports_is_known_at_once(tmp_path: Path) -> None:
    (tmp_path / "js").mkdir()
    main = 'import "../vendor/far.js";\nimport {\n  a,\n} from "./a.js";\nconst c = () => import("./c.js");\n'
    (tmp_path / "js" / "main.js").write_text(main)
    (tmp_path / "js" / "a.js").write_text('import * as b from "./b.js";\nexport { c } from "./d.js";\n')
    (tmp_path / "js" / "b.js").write_text('import { round } from "./main.js";\n')
    (tmp_path / "js" / "d.js").write_text('// import "./comment.js";\n')
    assets = Assets(tmp_path)
    wanted = {assets.url(name) for name in ("vendor/far.js", "js/a.js", "js/b.js", "js/d.js")}
    assert set(assets.imports("js/main.js")) == wanted


async def test_a_page_preloads_exactly_the_imports_of_its_first_module(house: House) -> None:
    client = await house.program(Role.VIEWER)
    for path, first, beside in (("/", "main", ("faceplate", "tile-spark")), ("/trends", "trends", ())):
        page = (await client.get(path)).text
        request = re.findall(r'<link rel="modulepreload" href="([^"]+)">', page)
        assert request == house.services[Assets].imports(f"js/{first}.js")
        assert re.findall(r'<script type="module" src="([^"]+)">', page) == [
            house.services[Assets].url(f"js/{first}.js"),
            *[house.services[Assets].url(f"js/{name}.js") for name in beside],
        ]


def test_files_are_sent_without_comments_and_lines_keep_their_numbers(tmp_path: Path) -> None:
    (tmp_path / "vendor").mkdir()
    styles, module = (
        "/* why */\na { top: 0; /* 1 */ }\n",
        "/** What\n * is. */\nlet a; // b\n  // c\n/* d */ a = 1;\n",
    )
    for name, text in {"a.css": styles, "a.js": module, "vendor/a.js": module}.items():
        (tmp_path / name).write_text(text)
    assets = Assets(tmp_path)
    assert assets.get("a.css").body == b"a { top: 0;  }\n"
    assert assets.get("a.js").body == b"\n\nlet a; // b\n\n/* d */ a = 1;\n"
    assert assets.get("vendor/a.js").body == module.encode()


def compiled(folder: Path, modules: dict[str, bytes]) -> dict[str, str]:
    """What the compiler of TypeScript, which knows strings and templates from comments, makes of modules."""
    for name, text in modules.items():
        (folder / "from" / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / "from" / name).write_bytes(text)
    options = "--allowJs --noCheck --noResolve --removeComments --target esnext --module esnext"
    call = [
        TSC,
        *options.split(),
        "--rootDir",
        "from",
        "--outDir",
        "to",
        *(f"from/{name}" for name in modules),
    ]
    subprocess.run(call, cwd=folder, check=True)
    return {name: (folder / "to" / name).read_text() for name in modules}


def test_without_its_comments_every_module_is_the_same_program(tmp_path: Path) -> None:
    assets = Assets(static_dir())
    names = [name for name in assets if name.endswith(".js") and not name.startswith("vendor/")]
    sent = {name: assets.get(name).body for name in names}
    kept = {name: (static_dir() / name).read_bytes() for name in names}
    assert sent != kept
    beside = {f"sent/{name}": text for name, text in sent.items()}
    made = compiled(tmp_path, beside | {f"kept/{name}": text for name, text in kept.items()})
    for name in names:
        assert made[f"sent/{name}"] == made[f"kept/{name}"], name


def test_no_string_of_a_stylesheet_looks_like_a_comment() -> None:
    styles = [path for path in static_dir().rglob("*.css") if "vendor" not in path.parts]
    assert styles
    assert [path.name for path in styles if re.search(r"\"[^\"\n]*/\*[^\"\n]*\"", path.read_text())] == []


async def test_a_first_visit_of_a_unit_page_is_light(house: House) -> None:
    assets = house.services[Assets]
    shown = await (await house.program(Role.OPERATOR)).get("/units/dry-end/1")
    assert shown.status_code == 200
    urls = set(re.findall(r'(?:href|src)="([^"]+\.(?:css|js))"', shown.text))
    modules = [url.removeprefix(assets.url("")) for url in urls if url.endswith(".js")]
    urls = urls.union(*(assets.imports(module) for module in modules if not module.startswith("vendor/")))
    names = [url.removeprefix(assets.url("")) for url in urls]
    weight = {
        name: len(gzip.compress(assets.get(name).body, 9))
        for name in names
        if name.startswith(("css/", "js/"))
    }
    assert sum(weight.values()) <= 50 * 1024, weight


def rendered(source: str, folder: Path) -> str:
    """As a process just started renders it."""
    loader = DictLoader({"page.html": source})
    return Environment(loader=loader, bytecode_cache=Compiled(folder)).get_template("page.html").render()


def test_stored_templates_are_used(tmp_path: Path) -> None:
    assert rendered("one", tmp_path / "kept") == "one"
    (kept,) = (tmp_path / "kept").iterdir()
    kept.write_bytes(kept.read_bytes().replace(b"one", b"two"))
    assert rendered("one", tmp_path / "kept") == "two"


def test_a_changed_source_is_compiled_again(tmp_path: Path) -> None:
    assert rendered("one", tmp_path) == "one"
    assert rendered("two", tmp_path) == "two"


def test_a_broken_file_and_a_folder_that_cannot_be_written_do_no_harm(tmp_path: Path) -> None:
    rendered("one", tmp_path)
    for kept in tmp_path.iterdir():
        kept.write_bytes(kept.read_bytes()[:-5])
    assert rendered("one", tmp_path) == "one"
    (tmp_path / "file").write_text("")
    assert rendered("one", tmp_path / "file") == "one"


def test_every_icon_that_a_template_names_is_drawn() -> None:
    sprite = (static_dir() / "icons" / "sprite.svg").read_text(encoding="utf-8")
    templates = "".join(path.read_text(encoding="utf-8") for path in templates_dir().rglob("*.html"))
    calls = re.findall(r"\bicon(\([^)]*)\)", templates)
    named = {name for call in calls for name in re.findall(r'(?:^\(|else )"([a-z-]+)"', call)}
    assert {"zero", "high"} <= named
    assert [name for name in sorted(named) if f'<symbol id="{name}"' not in sprite] == []
