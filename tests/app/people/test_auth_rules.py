"""The rules for names, passwords, PINs, redirects and sessions, and how soon a sign-in may be tried again."""

from __future__ import annotations

import string
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.core.web.access import Role
from app.people.auth import rules
from app.people.auth.passwords import check_password, check_pin, is_easy_password, is_easy_pin
from app.people.auth.settings import Sessions
from app.people.auth.sign_in import (
    FIRST_WAIT_S,
    FORGOTTEN_AFTER_S,
    FREE,
    FREE_OF_PANEL,
    MAX_WAIT_S,
    OF_ADDRESS,
    OF_ADDRESS_WINDOW_S,
    OF_NAME,
    OF_NAME_EVERY_S,
    OF_PANEL_EVERY_S,
    Attempt,
    Throttle,
)
from bus.errors import CallerError
from tests.for_each import for_each


def test_good_names() -> None:
    for name in ("ann", "Jürgen.W", "shift-2", "a@b", "x" * 40, "Łukasz", "Strauß", "Nguyễn"):
        rules.check_name(name)


def test_bad_names() -> None:
    invisible = ("\u0430dmin", "ad\u200bmin", "\uff41dmin", "adm\u0131n", "u\u0308", "ﬁn")
    for name in ("", "a b", "a/b", "<b>", "x" * 41, "a\n", *invisible):
        with pytest.raises(CallerError, match="1 to 40 letters"):
            rules.check_name(name)


def test_a_name_that_looks_like_another_is_refused() -> None:
    pairs = {"AIice": "Alice", "adm1n": "admin", "Jurgen": "Jürgen", "STRAUSS": "Strauß", "b0b": "bob"}
    # Of before there was a rule for letters.
    former = [("admin", old) for old in ("ad\u200bmin", "\uff41dmin", "a\u0301dmin")]
    for name, other in (*pairs.items(), *former):
        with pytest.raises(CallerError, match=f"looks like '{other}'"):
            rules.check_distinct(name, ["ann", other])
    rules.check_distinct("shift-2", ["shift-1", "shift.2", "shift-20", "ann", "shift-2"])


def test_a_redirect_never_leaves_us() -> None:
    for path in ("//evil", "/\\evil", "https://evil", "", "evil", "/a\nb", "\\/evil"):
        assert not rules.is_own_path(path), path
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


def test_lifetimes_are_in_seconds() -> None:
    sessions = Sessions(idle_hours=2, total_days=3, panel_idle_days=4, panel_total_days=5)
    assert rules.lifetime(sessions, panel=False) == rules.Lifetime(7_200, 259_200)
    assert rules.lifetime(sessions, panel=True) == rules.Lifetime(345_600, 432_000)


def test_a_panel_is_operator_at_most() -> None:
    for role in (Role.VIEWER, Role.OPERATOR):
        rules.check_panel_role(role)
    for role in (Role.ENGINEER, Role.ADMIN, Role.WORKER):
        with pytest.raises(CallerError, match=f"operator at most; the role {role}"):
            rules.check_panel_role(role)


def test_a_workers_token_is_for_one_bus_and_no_other_is() -> None:
    rules.check_token_bus(Role.WORKER, "dry", ["dry", "wet"])
    rules.check_token_bus(Role.ADMIN, "", ["dry", "wet"])
    for role, bus, buses, refusal in (
        (Role.ADMIN, "dry", ["dry", "wet"], "a token with the role admin has no bus"),
        (Role.WORKER, "", ["dry", "wet"], "give one of dry, wet"),
        (Role.WORKER, "west", ["dry", "wet"], "there is no bus 'west'; there are: dry, wet"),
        (Role.WORKER, "dry", [], "there are: none"),
    ):
        with pytest.raises(CallerError, match=refusal):
            rules.check_token_bus(role, bus, buses)


def test_a_token_lasts_from_one_day_to_ten_years() -> None:
    assert [rules.token_expiry(100.0, days) for days in (None, 1, 3650)] == [None, 86_500.0, 315_360_100.0]
    for days in (0, -1, 3651):
        with pytest.raises(CallerError, match=f"1 to 3650 days; {days} is out of range"):
            rules.token_expiry(100.0, days)


def test_a_home_page_is_ours() -> None:
    rules.check_home("/units/dry-end/1")
    with pytest.raises(CallerError, match="a path on this server"):
        rules.check_home("//evil")


def test_the_hash_of_a_secret_is_sha_256() -> None:
    expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    assert rules.secret_hash("abc").hex() == expected


FULL_WIDTH = "".join(chr(ord(sign) + 0xFEE0) for sign in "password1234")


GOOD = (
    *("collect house bakery stable", "dampf-walze-kiesel", "Tq8#fL2vXw0p", "blue-tiger-77"),
    *("kugelschreiber", "The quiet brown fox", "another long one", "öl für die Walze"),
    *("4 Walzen, 2 Motoren", "\N{SNOWMAN}" * 3 + "abgeht wie"),
)


EASY = (
    *("passwordpassword", "password1234", "P@ssw0rd1234", "Passwort2026", "Kennwort!2026", "administrator1"),
    *("qwertyuiop12", "qwertzuiop12", "1q2w3e4r5t6y", "1qaz2wsx3edc", "zaq12wsxcde3", "qazwsxedcrfv"),
    *("abcdefghijkl", "zyxwvutsrqpo", "123456789012", "098765432109", "aaaaaaaaaaaa", "aabbaabbaabb"),
    *("abcabcabcabc", "xk4!xk4!xk4!", "hunter2hunter2", "Winter2025Winter2025", "Sommer2026!!"),
    *("letmein12345", "changeme1234", "iloveyou1234", "manchesterunited", "trustno1trustno1"),
    *("lineside-test-2026", "correcthorsebatterystaple", "Correct Horse Battery Staple 1"),
    *("c0rrect-h0rse-battery-staple", "The quick brown fox", "asdfghjkl;'1"),
    *("P a s s w o r d", "p-a-s-s-w-o-r-d", "pässwörter12", "pass\u200bword\u20601234", FULL_WIDTH),
)


@for_each("password", GOOD)
def test_good_passwords(password: str) -> None:
    check_password(password, user="ann", site="Mill 7")


@for_each("password", EASY)
def test_easy_passwords(password: str) -> None:
    with pytest.raises(CallerError, match="easy to guess"):
        check_password(password, user="ann", site="Mill 7")


def test_the_length() -> None:
    for length in (0, 11, 257, 100_000):
        with pytest.raises(CallerError, match="12 to 256 characters"):
            check_password("x" * length, user="ann", site="Mill 7")


def test_neither_user_nor_site_stands_in_it() -> None:
    for user, password, named in (
        ("annabel", "xk-AnnaBel-7-qr", "user name"),
        ("j.doe", "my-J-Doe-is-fine", "user name"),
        ("annabel", "xk-Ännabel-7-qr", "user name"),
        ("jürgen", "xk-Jurgen-7-qrt", "user name"),
        ("eve", "we go to mill #7 at six", "name of the site"),
    ):
        with pytest.raises(CallerError, match=f"contains the {named}"):
            check_password(password, user=user, site="Mill 7")
    check_password("an annex of the mill", user="ann", site="Mill 7")


EASY_PINS = (
    *("000000", "123456", "654321", "121212", "123123", "112233", "147258", "159357", "123321", "111222"),
    *("020202", "20262026", "1984719847", "246810", "135790", "010190", "19901231", "12311990", "900131"),
)


def test_pins() -> None:
    for pin in ("", "0000", "12345", "1" * 13, "12a456", "123 456", "١٢٣٤٥٦"):
        with pytest.raises(CallerError, match="6 to 12 digits"):
            check_pin(pin)
    for pin in EASY_PINS:
        with pytest.raises(CallerError, match="easy to guess"):
            check_pin(pin)
    for pin in ("471193", "908172", "271828", "60221407"):
        check_pin(pin)


@given(st.text(max_size=300))
def test_every_text_is_judged(text: str) -> None:
    is_easy_password(text)
    is_easy_pin(text)


def test_a_random_password_is_never_easy() -> None:
    random, signs = Random(1), string.ascii_letters + string.digits
    assert not any(is_easy_password("".join(random.choices(signs, k=16))) for _ in range(500))


ANN = Attempt("ann", "192.0.2.1")


OWN = Attempt("ann", "her browser", own_browser=True)


COLLEAGUE = Attempt("ann", "192.0.2.1", used_network=True)


def fail(throttle: Throttle, attempt: Attempt, now: float, times: int = 1) -> None:
    for _ in range(times):
        throttle.begin(attempt, now)
        throttle.failed(attempt, now)


def test_a_name_at_one_place_waits_twice_as_long_each_time() -> None:
    throttle, now, waits = Throttle(), 0.0, []
    for _ in range(FREE):
        assert throttle.wait_s(OWN, now) == 0.0
        fail(throttle, OWN, now)
    for _ in range(10):
        waits.append(throttle.wait_s(OWN, now))
        now += waits[-1]
        assert throttle.wait_s(OWN, now) == 0.0
        fail(throttle, OWN, now)
    assert waits[:3] == [FIRST_WAIT_S, 2 * FIRST_WAIT_S, 4 * FIRST_WAIT_S]
    assert waits[-1] == MAX_WAIT_S


def test_a_panel_waits_sooner() -> None:
    throttle, panel = Throttle(), Attempt("p1", "192.0.2.1", panel=True, own_browser=True)
    fail(throttle, panel, 0.0, FREE_OF_PANEL)
    assert throttle.wait_s(panel, 0.0) == FIRST_WAIT_S


def test_it_is_forgotten_after_a_quarter_of_an_hour_and_with_the_right_secret() -> None:
    throttle = Throttle()
    fail(throttle, OWN, 0.0, 20)
    assert throttle.wait_s(OWN, MAX_WAIT_S - 1) > 0
    fail(throttle, OWN, FORGOTTEN_AFTER_S + 1)
    assert throttle.wait_s(OWN, FORGOTTEN_AFTER_S + 1) == 0.0
    fail(throttle, OWN, FORGOTTEN_AFTER_S + 1, 20)
    throttle.succeeded(OWN, FORGOTTEN_AFTER_S + 2)
    assert throttle.wait_s(OWN, FORGOTTEN_AFTER_S + 2) == 0.0


def test_who_signs_in_leaves_what_was_tried_from_the_network() -> None:
    """Others who share it would learn from their next try that there is such a user."""
    throttle = Throttle()
    fail(throttle, COLLEAGUE, 0.0, FREE)
    assert throttle.wait_s(OWN, 0.0) == 0.0
    throttle.succeeded(COLLEAGUE, 0.0)
    throttle.succeeded(OWN, 0.0)
    assert throttle.wait_s(COLLEAGUE, 0.0) == FIRST_WAIT_S


def test_wrong_tries_in_a_browser_of_the_name_count_there_alone() -> None:
    throttle = Throttle()
    fail(throttle, OWN, 0.0, OF_ADDRESS)
    assert throttle.wait_s(OWN, 0.0) == MAX_WAIT_S
    assert throttle.wait_s(ANN, 0.0) == throttle.wait_s(COLLEAGUE, 0.0) == 0.0
    assert throttle.wait_s(Attempt("bob", OWN.place), 0.0) == 0.0


def test_others_at_the_same_place_do_not_wait() -> None:
    throttle = Throttle()
    fail(throttle, ANN, 0.0, FREE + 1)
    assert throttle.wait_s(ANN, 0.0) > 0
    assert throttle.wait_s(Attempt("bob", ANN.place), 0.0) == 0.0


def test_a_place_that_tries_many_names_waits_except_for_its_own() -> None:
    throttle = Throttle()
    for number in range(OF_ADDRESS):
        fail(throttle, Attempt(f"name{number}", ANN.place), 0.0)
    fresh = Attempt("fresh", ANN.place)
    assert throttle.wait_s(COLLEAGUE, 0.0) == throttle.wait_s(fresh, 0.0)
    assert throttle.wait_s(fresh, 0.0) == OF_ADDRESS_WINDOW_S / OF_ADDRESS
    assert throttle.wait_s(fresh, OF_ADDRESS_WINDOW_S / OF_ADDRESS) == 0.0
    assert throttle.wait_s(OWN, 0.0) == 0.0
    assert throttle.wait_s(Attempt("fresh", "192.0.2.2"), 0.0) == 0.0


@for_each(("panel", "every_s"), [(False, OF_NAME_EVERY_S), (True, OF_PANEL_EVERY_S)])
def test_many_places_that_try_one_name_get_one_try_in_a_while(panel: bool, every_s: float) -> None:
    throttle, tried, now = Throttle(), 0, 0.0
    while now < 3600.0:
        attempt = Attempt("ann", f"place{now}", panel)
        if throttle.wait_s(attempt, now) == 0.0:
            fail(throttle, attempt, now)
            tried += 1
        now += 1.0
    assert tried <= OF_NAME + 3600.0 / every_s
    assert throttle.wait_s(Attempt("ann", "her browser", panel, own_browser=True), now) == 0.0
    assert throttle.wait_s(Attempt("ann", "the office", panel, used_network=True), now) == 0.0
    assert throttle.wait_s(Attempt("bob", "place0", panel), now) == 0.0


def test_many_at_once_are_not_each_the_last_that_is_allowed() -> None:
    throttle = Throttle()
    begun = 0
    for number in range(100):
        attempt = Attempt("ann", f"place{number}")
        if throttle.wait_s(attempt, 0.0) == 0.0:
            throttle.begin(attempt, 0.0)
            begun += 1
    assert begun == OF_NAME


def test_who_signs_in_from_a_new_place_uses_up_nothing() -> None:
    throttle = Throttle()
    for number in range(100):
        attempt = Attempt("ann", f"place{number}")
        assert throttle.wait_s(attempt, 0.0) == 0.0
        throttle.begin(attempt, 0.0)
        throttle.succeeded(attempt, 0.0)


@given(st.lists(st.tuples(st.text(max_size=3), st.text(max_size=3), st.booleans()), max_size=200))
def test_memory_is_bounded(attempts: list[tuple[str, str, bool]]) -> None:
    throttle = Throttle(most=10)
    for number, (name, place, known) in enumerate(attempts):
        fail(throttle, Attempt(name, place, own_browser=known), float(number))
    assert (
        max(len(kept) for kept in (throttle._pairs, throttle._places, throttle._names, throttle._panels))
        <= 10
    )


def test_the_oldest_are_forgotten_first() -> None:
    throttle = Throttle(most=10)
    fail(throttle, OWN, 0.0, FREE)
    for number in range(9):
        fail(throttle, Attempt(f"name{number}", "x", own_browser=True), 1.0)
    assert throttle.wait_s(OWN, 1.0) > 0
    fail(throttle, Attempt("one more", "x", own_browser=True), 1.0)
    assert throttle.wait_s(OWN, 1.0) == 0.0
