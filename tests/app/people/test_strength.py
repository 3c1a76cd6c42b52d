"""Which passwords and PINs are refused, and that the reason is the right one."""

from __future__ import annotations

import string
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.people.auth.passwords import check_password, check_pin, is_easy_password, is_easy_pin
from bus.errors import CallerError

FULL_WIDTH = "".join(chr(ord(sign) + 0xFEE0) for sign in "password1234")
GOOD = (
    *(
        "collect house bakery stable",
        "dampf-walze-kiesel",
        "Tq8#fL2vXw0p",
        "blue-tiger-77",
        "kugelschreiber",
    ),
    *(
        "The quiet brown fox",
        "another long one",
        "öl für die Walze",
        "4 Walzen, 2 Motoren",
        "\N{SNOWMAN}" * 3 + "abgeht wie",
    ),
)
EASY = (
    *("passwordpassword", "password1234", "P@ssw0rd1234", "Passwort2026", "Kennwort!2026", "administrator1"),
    *(
        "qwertyuiop12",
        "qwertzuiop12",
        "1q2w3e4r5t6y",
        "1qaz2wsx3edc",
        "zaq12wsxcde3",
        "qazwsxedcrfv",
        "asdfghjkl;'1",
    ),
    *("abcdefghijkl", "zyxwvutsrqpo", "123456789012", "098765432109", "aaaaaaaaaaaa", "aabbaabbaabb"),
    *("abcabcabcabc", "xk4!xk4!xk4!", "hunter2hunter2", "Winter2025Winter2025", "Sommer2026!!"),
    *(
        "letmein12345",
        "changeme1234",
        "iloveyou1234",
        "manchesterunited",
        "trustno1trustno1",
        "lineside-test-2026",
        "correcthorsebatterystaple",
        "Correct Horse Battery Staple 1",
        "c0rrect-h0rse-battery-staple",
        "The quick brown fox",
    ),
    *("P a s s w o r d", "p-a-s-s-w-o-r-d", "pässwörter12", "pass\u200bword\u20601234", FULL_WIDTH),
)


@pytest.mark.parametrize("password", GOOD)
def test_good_passwords(password: str) -> None:
    check_password(password, user="ann", site="Mill 7")


@pytest.mark.parametrize("password", EASY)
def test_easy_passwords(password: str) -> None:
    with pytest.raises(CallerError, match="easy to guess"):
        check_password(password, user="ann", site="Mill 7")


@pytest.mark.parametrize("length", [0, 1, 11, 257, 100_000])
def test_the_length(length: int) -> None:
    with pytest.raises(CallerError, match="12 to 256 characters"):
        check_password("x" * length, user="ann", site="Mill 7")


@pytest.mark.parametrize(
    ("user", "password", "named"),
    [
        ("annabel", "xk-AnnaBel-7-qr", "user name"),
        ("j.doe", "my-J-Doe-is-fine", "user name"),
        ("annabel", "xk-Ännabel-7-qr", "user name"),
        ("jürgen", "xk-Jurgen-7-qrt", "user name"),
        ("ann", "an annex of the mill", ""),
        ("eve", "we go to mill #7 at six", "name of the site"),
    ],
)
def test_neither_user_nor_site_stands_in_it(user: str, password: str, named: str) -> None:
    if not named:
        check_password(password, user=user, site="Mill 7")
        return
    with pytest.raises(CallerError, match=f"contains the {named}"):
        check_password(password, user=user, site="Mill 7")


@pytest.mark.parametrize("pin", ["", "0000", "12345", "1" * 13, "12a456", "123 456", "١٢٣٤٥٦"])
def test_invalid_pins(pin: str) -> None:
    with pytest.raises(CallerError, match="6 to 12 digits"):
        check_pin(pin)


@pytest.mark.parametrize(
    "pin",
    [
        "000000",
        "123456",
        "654321",
        "121212",
        "123123",
        "112233",
        "147258",
        "159357",
        "123321",
        "111222",
        "020202",
        "20262026",
        "1984719847",
        "246810",
        "135790",
        "010190",
        "19901231",
        "12311990",
        "900131",
    ],
)
def test_easy_pins(pin: str) -> None:
    with pytest.raises(CallerError, match="easy to guess"):
        check_pin(pin)


@pytest.mark.parametrize("pin", ["471193", "908172", "271828", "60221407"])
def test_good_pins(pin: str) -> None:
    check_pin(pin)


@given(st.text(max_size=300))
def test_every_text_is_judged(text: str) -> None:
    is_easy_password(text)
    is_easy_pin(text)


def test_a_random_password_is_never_easy() -> None:
    random, signs = Random(1), string.ascii_letters + string.digits
    assert not any(is_easy_password("".join(random.choices(signs, k=16))) for _ in range(2_000))
