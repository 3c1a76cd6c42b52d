"""The limits in the documentation are those that hold: each is read from its document."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from app.core.server import addresses, connections, gate
from app.core.web import api as api_route
from app.core.web import request_rules as bounds
from app.line.live.api import routes as line_stream
from app.people.audit import acts
from app.people.auth import pages, passwords, rights, rules, sign_in, store

DOCS = Path(__file__).parents[2] / "docs"
SIGN_IN = "| limit | value |"
KB = 1024
NUMBER = r"([0-9]+(?:[,.][0-9]+)*)"


def words(document: str) -> str:
    """A document without line breaks."""
    return " ".join((DOCS / document).read_text().split())


def numbers(document: str, text: str) -> list[float]:
    """The numbers at the places of ``{}`` in a statement of the document."""
    found = re.search(re.escape(text).replace(r"\{\}", NUMBER), words(document))
    assert found, f"{document} does not state: {text}"
    return [float(each.replace(",", "")) for each in found.groups()]


STATED: list[tuple[str, str, tuple[float, ...]]] = [
    (
        "api.md",
        "Connections without a valid credential are {} for each address (of IPv6, each /{}) and {} in all, "
        "an account has {}, and all together are {};",
        (
            connections.MAX_OF_ADDRESS,
            addresses.SUBNET_BITS,
            connections.MAX_STRANGERS,
            connections.MAX_OF_ACCOUNT,
            connections.MAX_IN_ALL,
        ),
    ),
    (
        "api.md",
        "an account makes {} changes other than commands (of alarms, sets, limits, control, users) at once, "
        "then {} a second.",
        (acts.MAX_ACTS, acts.ACTS_PER_S),
    ),
    (
        "api.md",
        "A body is at most {} kB, with a file of parameter sets {} MB (413); an object has at most {} "
        "members; an address has at most {} characters of path and {} of query (414); "
        "headers have at most {} kB and there are at most {} (431).",
        (
            bounds.MAX_PLAIN_BODY_BYTES / KB,
            bounds.MAX_BODY_BYTES / KB / KB,
            api_route.MAX_MEMBERS,
            bounds.MAX_PATH,
            bounds.MAX_QUERY,
            gate.MAX_HEAD_BYTES / KB,
            gate.MAX_HEADERS,
        ),
    ),
    (
        "api.md",
        "Headers have {} s to arrive; a body may fall {} s behind {} kB/s and takes at most "
        "{} minutes (408).",
        (
            connections.WITHIN_S[connections.Awaited.HEAD],
            connections.WITHIN_S[connections.Awaited.BODY],
            connections.MIN_RATE / 1000,
            connections.MAX_BODY_S / 60,
        ),
    ),
    (
        "api.md",
        "An idle connection is closed after {} s ({} s before its first request).",
        (connections.WITHIN_S[connections.Awaited.NEXT], connections.WITHIN_S[connections.Awaited.FIRST]),
    ),
    (
        "api.md",
        "An account may have {} streams open, an address {} (429).",
        (line_stream.MAX_STREAMS_OF_ACCOUNT, line_stream.MAX_STREAMS_OF_ADDRESS),
    ),
    ("safety.md", "Passwords have at least {} characters", (passwords.MIN_PASSWORD,)),
]


@pytest.mark.parametrize(("document", "text", "real"), STATED, ids=[text[:40] for _, text, _ in STATED])
def test_a_limit_in_the_text_is_the_real_one(document: str, text: str, real: tuple[float, ...]) -> None:
    assert numbers(document, text) == list(real)


def test_every_limit_of_signing_in_is_documented_with_its_value() -> None:
    table = (DOCS / "safety.md").read_text().partition(SIGN_IN)[2].partition("\n\n")[0]
    rows = re.findall(rf"^\| (?!-).* \| {NUMBER} \|$", table, re.MULTILINE)
    assert [float(value) for value in rows] == [
        sign_in.FREE,
        sign_in.FREE_OF_PANEL,
        sign_in.FIRST_WAIT_S,
        sign_in.MAX_WAIT_S,
        sign_in.FORGOTTEN_AFTER_S,
        sign_in.OF_ADDRESS,
        sign_in.OF_ADDRESS_WINDOW_S,
        sign_in.OF_NAME,
        sign_in.OF_NAME_EVERY_S,
        sign_in.OF_PANEL_EVERY_S,
        sign_in.MAX_WAITING_OF_PLACE,
        sign_in.MAX_WAITING,
        pages.DEVICE_KNOWN_S / rules.DAY,
        store.MAX_PLACES,
        rights.RECHECK_S,
        rights.WATCH_EVERY_S * 1000,
    ]
    assert len(rows) == table.count("\n|") - 1, "a row without a number"
