"""The rules for names, passwords, PINs, redirects and sessions."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.core.web.access import Role
from app.people.auth import rules
from app.people.auth.settings import Sessions
from bus.errors import CallerError


@pytest.mark.parametrize(
    "name", ["ann", "Jürgen.W", "shift-2", "a@b", "x" * 40, "Łukasz", "Strauß", "Nguyễn"]
)
def test_good_names(name: str) -> None:
    rules.check_name(name)


@pytest.mark.parametrize(
    "name",
    [
        "",
        "a b",
        "a/b",
        "<b>",
        "x" * 41,
        "a\n",
        "\u0430dmin",
        "ad\u200bmin",
        "\uff41dmin",
        "adm\u0131n",
        "u\u0308",
        "ﬁn",
    ],
)
def test_bad_names(name: str) -> None:
    with pytest.raises(CallerError, match="1 to 40 letters"):
        rules.check_name(name)


@pytest.mark.parametrize(
    ("name", "other"),
    [
        ("ADMIN", "admin"),
        ("AIice", "Alice"),
        ("adm1n", "admin"),
        ("Jurgen", "Jürgen"),
        ("STRAUSS", "Strauß"),
        ("b0b", "bob"),
    ]
    + [("admin", old) for old in ("ad\u200bmin", "\uff41dmin", "a\u0301dmin")],
)
def test_a_name_that_looks_like_another_is_refused(name: str, other: str) -> None:
    """``other`` may be of before there was a rule for letters."""
    with pytest.raises(CallerError, match=f"looks like '{other}'"):
        rules.check_distinct(name, ["ann", other])


def test_names_that_differ_stand_beside_each_other() -> None:
    rules.check_distinct("shift-2", ["shift-1", "shift.2", "shift-20", "ann", "shift-2"])


@pytest.mark.parametrize("path", ["//evil", "/\\evil", "https://evil", "", "evil", "/a\nb", "\\/evil"])
def test_a_redirect_never_leaves_us(path: str) -> None:
    assert not rules.is_own_path(path)


def test_a_redirect_to_our_own_page() -> None:
    assert rules.is_own_path("/units/dry-end/1?x=1#y")


@given(st.floats(0, 1e6), st.floats(0, 1e6))
def test_a_session_ends_by_the_earlier_of_two(created: float, later: float) -> None:
    lifetime = rules.Lifetime(idle_s=100, absolute_s=1000)
    ends = lifetime.ends_at(created, created + later)
    assert ends == min(created + later + 100, created + 1000)


def test_secrets_are_long_and_never_the_same() -> None:
    secrets = {rules.new_secret() for _ in range(100)}
    assert len(secrets) == 100
    assert {len(secret) for secret in secrets} == {rules.SECRET_LENGTH}


@pytest.mark.parametrize(
    ("role", "includes"),
    [
        (Role.VIEWER, "viewer"),
        (Role.OPERATOR, "viewer operator"),
        (Role.ENGINEER, "viewer operator engineer"),
        (Role.ADMIN, "viewer operator engineer admin"),
        (Role.WORKER, "worker"),
    ],
)
def test_what_each_role_includes(role: Role, includes: str) -> None:
    assert {str(other) for other in Role if role.includes(other)} == set(includes.split())
    assert role.includes("viewer") is ("viewer" in includes)


def test_lifetimes_are_in_seconds() -> None:
    sessions = Sessions(idle_hours=2, total_days=3, panel_idle_days=4, panel_total_days=5)
    assert rules.lifetime(sessions, panel=False) == rules.Lifetime(7_200, 259_200)
    assert rules.lifetime(sessions, panel=True) == rules.Lifetime(345_600, 432_000)


@pytest.mark.parametrize("role", Role)
def test_a_panel_is_operator_at_most(role: Role) -> None:
    if role in (Role.VIEWER, Role.OPERATOR):
        rules.check_panel_role(role)
    else:
        with pytest.raises(CallerError, match=f"operator at most; the role {role}"):
            rules.check_panel_role(role)


@pytest.mark.parametrize(
    ("role", "bus", "refusal"),
    [
        (Role.WORKER, "dry", ""),
        (Role.ADMIN, "", ""),
        (Role.ADMIN, "dry", "a token with the role admin has no bus"),
        (Role.WORKER, "", "give one of dry, wet"),
        (Role.WORKER, "west", "there is no bus 'west'; there are: dry, wet"),
    ],
)
def test_a_workers_token_is_for_one_bus_and_no_other_is(role: Role, bus: str, refusal: str) -> None:
    if not refusal:
        rules.check_token_bus(role, bus, ["dry", "wet"])
        return
    with pytest.raises(CallerError, match=refusal):
        rules.check_token_bus(role, bus, ["dry", "wet"])


def test_a_site_without_a_bus_reports_it() -> None:
    with pytest.raises(CallerError, match="there are: none"):
        rules.check_token_bus(Role.WORKER, "dry", [])


@pytest.mark.parametrize(("days", "expiry"), [(None, None), (1, 86_500.0), (3650, 315_360_100.0)])
def test_a_token_expires_after_its_days(days: int | None, expiry: float | None) -> None:
    assert rules.token_expiry(100.0, days) == expiry


@pytest.mark.parametrize("days", [0, -1, 3651])
def test_a_token_lasts_from_one_day_to_ten_years(days: int) -> None:
    with pytest.raises(CallerError, match=f"1 to 3650 days; {days} is out of range"):
        rules.token_expiry(100.0, days)


def test_a_home_page_is_ours() -> None:
    rules.check_home("/units/dry-end/1")
    with pytest.raises(CallerError, match="a path on this server"):
        rules.check_home("//evil")


def test_the_hash_of_a_secret_is_sha_256() -> None:
    expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    assert rules.secret_hash("abc").hex() == expected
