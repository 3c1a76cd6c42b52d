"""What is asked of names, passwords, PINs, redirects and sessions."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.auth import rules
from app.web.access import Role
from bus.errors import CallerError


@pytest.mark.parametrize("name", ["ann", "Jürgen.W", "shift-2", "a@b", "x" * 40])
def test_good_names(name: str) -> None:
    rules.check_name(name)


@pytest.mark.parametrize("name", ["", "a b", "a/b", "<b>", "x" * 41, "a\n"])
def test_bad_names(name: str) -> None:
    with pytest.raises(CallerError, match="1 to 40 letters"):
        rules.check_name(name)


@pytest.mark.parametrize("path", ["//evil", "/\\evil", "https://evil", "", "evil", "/a\nb", "\\/evil"])
def test_a_redirect_never_leaves_us(path: str) -> None:
    assert not rules.is_own_path(path)


def test_a_redirect_to_our_own_page() -> None:
    assert rules.is_own_path("/units/dry-end/1?x=1#y")


@given(st.floats(0, 1e6), st.floats(0, 1e6))
def test_a_session_ends_by_the_earlier_of_two(created: float, later: float) -> None:
    lifetime = rules.Lifetime(idle_s=100, whole_s=1000)
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
