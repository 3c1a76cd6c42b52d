"""Passwords and PINs: those that are among the first to be tried are refused, the others are hashed by
Argon2id in other threads, so that the line never waits for a login.

A text is cut into pieces: common words (also with digits for letters), repetitions, sequences, runs of
neighboring keys, and single characters. A text with too few pieces is easy to guess, however long it is.
"""

from __future__ import annotations

import asyncio
import re
import unicodedata
from pathlib import Path

from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError

from bus.errors import CallerError
from bus.messages import Message
from bus.validation import composed

MIN_PASSWORD, MAX_PASSWORD = 12, 256
MAX_CODE_POINTS = 4 * MAX_PASSWORD
"""The most characters of a password whose accents are typed as separate characters (NFD). Argon2 works on all
of it, so this bounds the work of one request."""
MIN_PIECES = 7
MIN_SIGNS = 5
MIN_PIECES_OF_PIN = 4
MIN_NAME = 4
"""The least letters of a name that a password may not contain; a shorter one is in too many words."""
_PIN = re.compile(r"\d{6,12}")

_LOOK_ALIKES = str.maketrans("013457@$!|", "oieastasii")
_WORDS = frozenset(
    line
    for line in Path(__file__).with_name("common_words.txt").read_text(encoding="utf-8").splitlines()
    if not line.startswith("#")
)
_ADORNMENTS = ("Mn", "Cf")
"""Unicode's categories of combining marks and of signs without a width."""
_DAY, _MONTH, _SHORT_YEAR, _FULL_YEAR = (
    r"(?:0[1-9]|[12]\d|3[01])",
    r"(?:0[1-9]|1[0-2])",
    r"\d\d",
    r"(?:19|20)\d\d",
)
_DATE = re.compile(
    "|".join(
        order
        for year in (_SHORT_YEAR, _FULL_YEAR)
        for order in (_DAY + _MONTH + year, _MONTH + _DAY + year, year + _MONTH + _DAY)
    )
)
"""Dates in the usual orders; a birthday is among the first PINs that are tried."""
_YEAR = re.compile(_FULL_YEAR)
_LONGEST_WORD = max(map(len, _WORDS))
_SHORTEST_WORD = min(map(len, _WORDS))
_ROWS = ((0.0, "1234567890-="), (0.5, "qwertyuiop[]"), (0.75, "asdfghjkl;'"), (1.25, "zxcvbnm,./"))
_KEYS = {sign: (x + shift, float(y)) for y, (shift, row) in enumerate(_ROWS) for x, sign in enumerate(row)}
_SWAPPED = str.maketrans("yz", "zy")
"""Swaps Y and Z, whose keys are exchanged on a German keyboard."""
_PAD = {
    digit: (float(x), float(y)) for y, row in enumerate(("123", "456", "789")) for x, digit in enumerate(row)
}
MIN_RUN = 3
MAX_EASY_BLOCK = 7
"""The most characters of a block that makes a text easy to guess if the text only repeats it."""


def check_secret(secret: str, *, user: str, panel: bool, site: str) -> None:
    """Raise CallerError for a password, or a PIN of a panel, that ``user`` may not choose at ``site``."""
    if panel:
        check_pin(secret)
    else:
        check_password(secret, user=user, site=site)


def check_password(password: str, *, user: str, site: str) -> None:
    """Raise CallerError for a password that ``user`` may not choose at ``site``."""
    password = composed(password)
    if not MIN_PASSWORD <= len(password) <= MAX_PASSWORD:
        bounds = {"least": MIN_PASSWORD, "most": MAX_PASSWORD}
        raise CallerError(Message.of("password_length", count=len(password), **bounds))
    if _contains(password, user):
        raise CallerError(Message("password_contains_user"))
    if _contains(password, site):
        raise CallerError(Message("password_contains_site"))
    if is_easy_password(password):
        raise CallerError(Message("password_easy_to_guess"))


def check_pin(pin: str) -> None:
    """Raise CallerError for a PIN that may not be chosen."""
    if not _PIN.fullmatch(pin) or not pin.isascii():
        raise CallerError(Message("pin_length"))
    if is_easy_pin(pin):
        raise CallerError(Message("pin_easy_to_guess"))


def is_easy_password(password: str) -> bool:
    """Return whether a password is among the first to be tried."""
    text = _without_separator(_bare(password))
    block = _block_of(text)
    return (
        len(set(text)) < MIN_SIGNS
        or (len(block) < len(text) and len(block) <= MAX_EASY_BLOCK)
        or _pieces(text, _KEYS, words=True) < MIN_PIECES
        or _pieces(_plain(password), _KEYS, words=True) < MIN_PIECES
        or _pieces(text.translate(_SWAPPED), _KEYS, words=True) < MIN_PIECES
    )


def is_easy_pin(pin: str) -> bool:
    """Return whether a PIN is among the first to be tried."""
    return (
        len(set(pin)) <= 2
        or len(_block_of(pin)) < len(pin)
        or _DATE.fullmatch(pin) is not None
        or _pieces(pin, _PAD, words=False) < MIN_PIECES_OF_PIN
    )


def _contains(password: str, name: str) -> bool:
    """Return whether the letters and digits of a name are in those of a password, next to one another."""
    wanted = _plain(name)
    return len(wanted) >= MIN_NAME and wanted in _plain(password)


def _plain(text: str) -> str:
    return "".join(sign for sign in _bare(text) if sign.isalnum())


def _bare(text: str) -> str:
    """Return a text in small letters, without accents, full widths and invisible characters, which protect
    nothing."""
    signs = unicodedata.normalize("NFKD", text.casefold())
    return "".join(sign for sign in signs if unicodedata.category(sign) not in _ADORNMENTS)[:MAX_PASSWORD]


def _without_separator(text: str) -> str:
    """Return the letters of ``s-p-e-l-l-e-d``."""
    between = set(text[1::2])
    return text[::2] if len(between) == 1 and not between.pop().isalnum() else text


def _block_of(text: str) -> str:
    """Return the shortest text that, repeated, gives this one."""
    return text[: (text + text).find(text, 1)]


def _pieces(text: str, keys: dict[str, tuple[float, float]], *, words: bool) -> int:
    letters = text.translate(_LOOK_ALIKES)
    place, count = 0, 0
    while place < len(text):
        longest = max(_run(text, place), _walk(text, place, keys), _repeated(text, place))
        if words:
            year = 4 if _YEAR.match(text, place) else 0
            longest = max(longest, year, _word(text, place), _word(letters, place))
        place += max(1, longest)
        count += 1
    return count


def _word(text: str, place: int) -> int:
    for length in range(min(_LONGEST_WORD, len(text) - place), _SHORTEST_WORD - 1, -1):
        if text[place : place + length] in _WORDS:
            return length
    return 0


def _run(text: str, place: int) -> int:
    """Return the length of a run of one character, of characters in alphabetical order, or of evenly spaced
    digits; 0 if there is none."""
    if place + 1 >= len(text):
        return 0
    step = ord(text[place + 1]) - ord(text[place])
    if abs(step) > 1 and not text[place : place + 2].isdecimal():
        return 0
    end = place + 1
    while end < len(text) and ord(text[end]) - ord(text[end - 1]) == step:
        end += 1
    return end - place if end - place >= MIN_RUN else 0


def _walk(text: str, place: int, keys: dict[str, tuple[float, float]]) -> int:
    """Return the length of a run of neighboring keys; 0 if there is none."""
    end = place + 1
    while end < len(text) and _are_neighbors(keys.get(text[end - 1]), keys.get(text[end])):
        end += 1
    return end - place if end - place >= MIN_RUN else 0


def _are_neighbors(one: tuple[float, float] | None, other: tuple[float, float] | None) -> bool:
    return (
        one is not None and other is not None and max(abs(one[0] - other[0]), abs(one[1] - other[1])) <= 1.0
    )


def _repeated(text: str, place: int) -> int:
    """Return the length of a piece that stands earlier in the text; 0 if there is none."""
    length = MIN_RUN
    while place + length <= len(text) and text[place : place + length] in text[:place]:
        length += 1
    return length - 1 if length > MIN_RUN else 0


_hasher = PasswordHasher(time_cost=5, memory_cost=7 * 1024, parallelism=1)
"""OWASP's choice with the least memory among equally strong ones: a flood of sign-ins takes it twice."""


async def hash_secret(secret: str) -> str:
    """Hash the secret in NFC for the store."""
    return await asyncio.to_thread(_hasher.hash, composed(secret))


async def verify_secret(stored: str, secret: str) -> bool:
    """Return whether ``stored`` is a hash of the secret in any of its Unicode forms: older hashes were made
    from the form in which the secret was typed."""
    forms = dict.fromkeys((composed(secret), secret, unicodedata.normalize("NFD", secret)))
    return await asyncio.to_thread(lambda: any(_is_hash_of(stored, form) for form in forms))


def _is_hash_of(stored: str, secret: str) -> bool:
    try:
        return _hasher.verify(stored, secret)
    except (VerificationError, InvalidHashError):
        return False


def is_outdated(stored: str) -> bool:
    """Return whether a hash has other parameters than a new one. Raise InvalidHashError for an invalid
    hash."""
    return _hasher.check_needs_rehash(stored)
