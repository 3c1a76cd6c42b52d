"""What a server states of a request that it passes on."""

from __future__ import annotations

from base64 import urlsafe_b64encode

import msgspec
import pytest

from app.routing.forwarding.headers import to_client, to_home
from app.routing.forwarding.hop import MAX_AGE_S, ForgedHopError, Hop, opened, sealed
from app.routing.store_clock import KNOWN_FOR_S, StoreClock

SECRET = b"s" * 32
HOP = Hop("app-1", 99.0, 100.0, "192.0.2.7", "https", "plant.example")
TARGET = b"/api/v1/buses/dry-end/execute?x=1"
VALUE = sealed(HOP, SECRET, "POST", TARGET)


def test_a_hop_is_what_was_sealed() -> None:
    assert opened(VALUE, SECRET, "POST", TARGET, 100.5) == HOP


@pytest.mark.parametrize(
    ("value", "secret", "method", "target", "now"),
    [
        (VALUE, b"t" * 32, "POST", TARGET, 100.0),
        (VALUE, b"", "POST", TARGET, 100.0),
        (VALUE, SECRET, "PUT", TARGET, 100.0),
        (VALUE, SECRET, "POST", TARGET[:-1], 100.0),
        (VALUE, SECRET, "POST", TARGET, 100.0 + MAX_AGE_S + 1),
        (VALUE, SECRET, "POST", TARGET, 100.0 - MAX_AGE_S - 1),
        (VALUE[:-1], SECRET, "POST", TARGET, 100.0),
        (VALUE.replace(".", ""), SECRET, "POST", TARGET, 100.0),
        ("é" + VALUE, SECRET, "POST", TARGET, 100.0),
        ("A" * 5000, SECRET, "POST", TARGET, 100.0),
        (".", SECRET, "POST", TARGET, 100.0),
        ("", SECRET, "POST", TARGET, 100.0),
    ],
)
def test_no_other_is(value: str, secret: bytes, method: str, target: bytes, now: float) -> None:
    with pytest.raises(ForgedHopError):
        opened(value, secret, method, target, now)


def test_a_changed_arrival_is_refused() -> None:
    later = msgspec.json.encode(msgspec.structs.replace(HOP, arrived_at=200.0))
    forged = f"{urlsafe_b64encode(later).decode()}.{VALUE.partition('.')[2]}"
    with pytest.raises(ForgedHopError):
        opened(forged, SECRET, "POST", TARGET, 100.0)


def test_a_method_does_not_pass_for_a_part_of_the_target() -> None:
    value = sealed(HOP, SECRET, "POST", b"/a")
    with pytest.raises(ForgedHopError):
        opened(value, SECRET, "POST/", b"a", 100.0)


def test_a_time_of_the_store_errs_to_the_early_side() -> None:
    """Two servers whose clocks differ by an hour; each look at the store takes 0.2 s."""
    first, second = StoreClock(), StoreClock()
    first.compare(1000.0, 50_000.0, 1000.2)
    second.compare(4600.0, 50_000.0, 4600.2)
    arrived = second.from_store(first.to_store(1001.0))
    assert 4600.0 + 1.0 - 0.4 <= arrived <= 4600.2 + 1.0
    assert first.is_known(1000.2 + KNOWN_FOR_S - 0.1)
    assert not first.is_known(1000.2 + KNOWN_FOR_S)
    assert not StoreClock().is_known(0.0)


def test_only_named_headers_pass_to_a_home() -> None:
    given = [
        (b"cookie", b"lineside_session=x"),
        (b"authorization", b"Bearer t"),
        (b"idempotency-key", b"k"),
        (b"hx-request", b"true"),
        (b"lineside-sent-at", b"2026-11-25T22:00:00Z"),
        (b"lineside-hop", b"forged"),
        (b"x-forwarded-for", b"10.0.0.1"),
        (b"connection", b"cookie"),
        (b"transfer-encoding", b"chunked"),
        (b"content-length", b"5"),
        (b"te", b"trailers"),
        (b"referer", b"/x\r\nLineside-Hop: y"),
        (b"user-agent", b"a\nb"),
    ]
    assert [name for name, _ in to_home(given)] == [
        *(b"cookie", b"authorization", b"idempotency-key", b"hx-request", b"lineside-sent-at")
    ]


def test_only_named_headers_pass_to_a_client() -> None:
    given = [
        (b"Content-Type", b"text/html"),
        (b"Set-Cookie", b"lineside_session=stolen; Path=/"),
        (b"Set-Cookie", b"__Host-lineside_session=stolen; Path=/; Secure"),
        (b"Set-Cookie", b"lineside_home=app-9"),
        (b"Set-Cookie", b"lineside_view=rows"),
        (b"Location", b"//evil.example/"),
        (b"Location", b"https://evil.example/"),
        (b"Location", b"/\\evil.example"),
        (b"Location", b"/units/dry-end/1"),
        (b"Link", b'</api/v1/sets?before=7>; rel="next"'),
        (b"Link", b'<https://evil.example/>; rel="next"'),
        (b"Link", b'</x>; rel="next", <https://evil.example/>; rel="preload"'),
        (b"HX-Redirect", b"https://evil.example/"),
        (b"Content-Security-Policy", b"default-src *"),
        (b"Access-Control-Allow-Origin", b"*"),
        (b"Clear-Site-Data", b'"*"'),
        (b"Strict-Transport-Security", b"max-age=1"),
        (b"Content-Disposition", b"attachment\r\nSet-Cookie: x=y"),
        (b"Transfer-Encoding", b"chunked"),
        (b"Connection", b"close"),
    ]
    assert to_client(given) == [
        (b"content-type", b"text/html"),
        (b"set-cookie", b"lineside_view=rows"),
        (b"location", b"/units/dry-end/1"),
        (b"link", b'</api/v1/sets?before=7>; rel="next"'),
    ]
