"""The operator password (#21) is in parameter sets alone: in no store, log, trace or response beside them."""

from __future__ import annotations

import re
import shutil
import sqlite3
import zlib
from collections.abc import Iterator
from contextlib import closing, contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import httpx
import pytest
from babel.messages.mofile import read_mo

from app.core.messages.languages import DIGEST_BYTES
from tests.e2e.limits import PROCEDURE_S
from tests.e2e.site import PASSWORD, Site, eventually, site

BY_API, BY_PAGE, BY_BATCH, BY_FILE, REFUSED = 73_195, 58_273, 64_938, 81_467, 739_418
"""None has a byte 10h, which is doubled on the wire."""
SECRETS = (BY_API, BY_PAGE, BY_BATCH, BY_FILE, REFUSED)
SETS = {"parameter_set_row"}
UNIT = "/buses/line/units/1"
IDS = re.compile(r'name="(id|raw|scale|reviewed_at)" value="([^"]*)"')


@pytest.fixture(scope="module")
def lived(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Site, list[str]]]:
    """Yield a site whose unit has had every password, in every way; and the server's responses meanwhile."""
    folder = tmp_path_factory.mktemp("secret")
    with site(folder, 1, line_options=("--no-script", "--speedup", "10")) as made:
        texts: list[str] = []
        with made.api("engineer") as api, _signed_in(made) as page:
            for client in (api, page):
                client.event_hooks["response"].append(lambda response: texts.append(_text(response)))
            _live(api, page)
        made.stop()
        yield made, texts


def _text(response: httpx.Response) -> str:
    response.read()
    path = response.request.url.path
    # A person's input is shown to that person again, for review, and a form carries it to the second step. A
    # document with secrets is requested as such.
    return "" if path.endswith(("/review", "/document")) else response.text


@contextmanager
def _signed_in(made: Site) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=made.url, headers={"Origin": made.url}, timeout=60, trust_env=False) as client:
        assert client.post("/login", data={"name": "engineer", "password": PASSWORD}).status_code == 303
        yield client


def _live(api: httpx.Client, page: httpx.Client) -> None:
    kept = _by_api(api)
    _by_page(page)
    _by_batch(page)
    _by_restore(api, kept)
    _by_swap(api, page, kept)
    _look_everywhere(api, page)


def _by_api(api: httpx.Client) -> int:
    """Gives the set that holds the password."""

    def write(key: str) -> str:
        wrote = api.put(f"{UNIT}/parameters/21", json={"raw": BY_API}, headers={"Idempotency-Key": key})
        return str(wrote.json()["outcome"])

    keys = [str(number) for number in range(5)]
    # While a machine is busy, a unit may not respond in time to the read-back.
    verified = next(key for key in keys if write(key) == "verified")
    assert write(verified) == "verified"
    assert api.put(f"{UNIT}/parameters/21", json={"raw": REFUSED}).status_code == 422
    assert api.put(f"{UNIT}/parameters/21", json={"value": f"{BY_API}x"}).status_code == 422
    assert api.get(f"{UNIT}/parameters", params={"refresh": "true"}).status_code == 200
    taken = api.post("/buses/line/sets", json={"units": [1], "name": "with the password"})
    assert taken.status_code == 201, taken.text
    return int(taken.json()["id"])


def _by_page(page: httpx.Client) -> None:
    where = "/units/line/1/parameters"
    review = page.post(f"{where}/21/review", data={"value": str(BY_PAGE)})
    form = dict(IDS.findall(review.text))
    done = page.post(f"{where}/21", data=form)
    assert "verified" in done.text, done.text
    assert page.post(f"{where}/read").status_code == 200


def _by_batch(page: httpx.Client) -> None:
    typed = {"number": "21", "unit-1": str(BY_BATCH)}
    assert page.get("/batch/line", params={"number": 21}).status_code == 200
    review = page.post("/batch/line/review", data=typed)
    assert "verified" in page.post("/batch/line/write", data=typed | dict(IDS.findall(review.text))).text


def _by_restore(api: httpx.Client, kept: int) -> None:
    document = api.get(f"/sets/{kept}/document", params={"secrets": "true"}).text
    plan = api.post(f"{UNIT}/restores", json={"document": document.replace(str(BY_API), str(BY_FILE))})
    _carry_out(api, plan.json()["id"])
    refused = api.post(f"{UNIT}/restores", json={"document": document.replace(str(BY_API), str(REFUSED))})
    assert refused.status_code in (201, 422), refused.text


def _carry_out(api: httpx.Client, restore: str) -> None:
    assert api.post(f"/restores/{restore}/start").status_code == 202
    eventually(
        lambda: api.get(f"/restores/{restore}").json()["state"] == "equal",
        "the unit restored",
        within=PROCEDURE_S,
    )


def _by_swap(api: httpx.Client, page: httpx.Client, kept: int) -> None:
    """A spare gets the password of the set: here the unit itself, whose password was changed by a file."""
    assert page.post("/swap/line/1", data={"source": f"set:{kept}:1"}).status_code == 303
    assert page.get("/swap/line/1/look").status_code == 200
    assert page.post("/swap/line/1/spare").status_code == 303
    planned = page.post("/swap/line/1/restore")
    assert planned.status_code == 303, planned.text
    _carry_out(api, planned.headers["location"].rpartition("/")[2])


def _look_everywhere(api: httpx.Client, page: httpx.Client) -> None:
    for path in (
        *("/line", UNIT, f"{UNIT}/parameters", f"{UNIT}/drift", "/events?limit=1000", "/events.csv"),
        *("/buses/line/trace?seconds=3000", "/buses/line/trace?limit=2000", "/sets", "/events/proof"),
    ):
        api.get(path)
    for path in (
        "/",
        "/events",
        "/units/line/1",
        "/units/line/1/parameters",
        "/sets",
        "/swap/line/1",
        "/metrics",
    ):
        page.get(path)


def test_no_response_names_it(lived: tuple[Site, list[str]]) -> None:
    _, texts = lived
    assert len(texts) > 30
    assert [text for text in texts if _names(text)] == []


def test_no_log_names_it(lived: tuple[Site, list[str]]) -> None:
    made, _ = lived
    log = (made.folder / "serve.log").read_text()
    assert "command" in log
    assert not _names(log)


def test_only_parameter_sets_hold_it(lived: tuple[Site, list[str]]) -> None:
    made, _ = lived
    found, in_sets = [], 0
    for store in (made.folder / "data").glob("*.db"):
        for table, row in _rows(store):
            holds = [name for name, value in row.items() if _holds(value)]
            in_sets += bool(holds) and table in SETS
            found += [] if table in SETS or not holds else [(store.name, table, row)]
    assert found == []
    assert in_sets, "the search can find the secret"


def test_no_other_file_holds_it(lived: tuple[Site, list[str]], tmp_path: Path) -> None:
    """Without the sets, and without what SQLite has left in free pages, no byte of it is left."""
    made, _ = lived
    data = shutil.copytree(made.folder / "data", tmp_path / "data")
    with closing(sqlite3.connect(data / "lineside.db")) as connection:
        connection.executescript(
            "DROP TRIGGER parameter_set_row_stays; DELETE FROM parameter_set_row; VACUUM; "
            "PRAGMA wal_checkpoint(TRUNCATE)"
        )
    files = [path for path in made.folder.rglob("*") if path.is_file() and data not in path.parents]
    files = [path for path in files if path.name not in ("lineside.db", "lineside.db-wal")] + [
        data / "lineside.db"
    ]
    assert len(files) > 5
    assert [path.name for path in files if _holds(_content(path))] == []


def _content(path: Path) -> bytes | str:
    """Of a compiled catalog its texts: among its thousands of offsets any number may stand by chance."""
    content = path.read_bytes()
    if path.suffix != ".mo":
        return content
    return "\n".join(f"{each.id} {each.string}" for each in read_mo(BytesIO(content[DIGEST_BYTES:])))


def _rows(store: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    with closing(sqlite3.connect(f"file:{store}?mode=ro", uri=True)) as connection:
        connection.row_factory = sqlite3.Row
        tables = connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'").fetchall()
        for (table,) in tables:
            for row in connection.execute(f'SELECT * FROM "{table}"'):
                yield table, dict(row)


def _holds(value: Any) -> bool:
    if isinstance(value, int):
        return value in SECRETS
    if isinstance(value, bytes):
        return (
            _names(value.decode("latin-1"))
            or any(_packed(number) in value for number in SECRETS)
            or _in_packed(value)
        )
    return isinstance(value, str) and _names(value)


def _in_packed(value: bytes) -> bool:
    try:
        return _holds(zlib.decompress(value))
    except zlib.error:
        return False


def _packed(number: int) -> bytes:
    return number.to_bytes(4, "big")


def _names(text: str) -> bool:
    """In decimal, or as the bytes on the wire in hexadecimal, not as a part of a longer number."""
    return _PATTERN.search(text) is not None


def _written(number: int) -> list[str]:
    octets = _packed(number).lstrip(b"\0")
    return [str(number), *(separator.join(f"{octet:02x}" for octet in octets) for separator in (" ", ""))]


_PATTERN = re.compile(
    rf"(?<![0-9a-f.])(?:{'|'.join(form for number in SECRETS for form in _written(number))})(?![0-9a-f])",
    re.I,
)
