"""Where a request belongs."""

from __future__ import annotations

import pytest

from app.routing.forwarding.target import is_own, named_bus, named_server, place_of, prefixes_of
from tests.app.played_site import PlayedHomes

PREFIXES = prefixes_of(
    ("/units/{bus}/{unit:int}", "/bus/{bus}", "/api/v1/buses/{bus}/units", "/lines", "/swap/{bus}/{unit}")
)
BUSES = ("dry-end", "wet-end", "coater")


@pytest.fixture
def homes() -> PlayedHomes:
    """``dry-end`` is here, ``wet-end`` at app-2, ``coater`` nowhere."""
    homes = PlayedHomes()
    homes.put("dry-end", "app-1")
    homes.put("wet-end", "app-2")
    return homes


def test_a_bus_that_was_just_taken_is_not_at_the_server_of_its_row(homes: PlayedHomes) -> None:
    assert place_of("", "app-2", homes, BUSES).home is not None
    homes.is_here = lambda _bus: True  # type: ignore[method-assign]
    assert place_of("", "app-2", homes, BUSES).home is None


def test_an_alarm_of_the_site_belongs_to_its_home(homes: PlayedHomes) -> None:
    assert place_of("_", "", homes, BUSES).home is None
    homes.put("", "app-2")
    home = place_of("_", "", homes, BUSES).home
    assert home is not None
    assert home.server == "app-2"


def test_the_prefixes_are_those_of_the_routes() -> None:
    assert PREFIXES == ("/api/v1/buses/", "/bus/", "/swap/", "/units/")


@pytest.mark.parametrize(
    ("path", "query", "bus"),
    [
        ("/units/wet-end/3", b"", "wet-end"),
        ("/bus/wet-end", b"", "wet-end"),
        ("/bus", b"", ""),
        ("/api/v1/buses/wet-end/units/1/speed", b"timeout_s=1", "wet-end"),
        ("/api/v1/history", b"bus=wet-end&unit=1", "wet-end"),
        ("/api/v1/stream", b"bus=wet-end", "wet-end"),
        ("/api/v1/history", b"bus=wet-end&bus=dry-end", ""),
        ("/api/v1/history", b"bus=../x", ""),
        ("/api/v1/history", b"subus=wet-end", ""),
        ("/units/wet-end/3", b"bus=dry-end", "wet-end"),
        ("/units/../wet-end", b"", ""),
        ("/units/Wet_End/1", b"", ""),
        ("/api/v1/alarms/wet-end.3.unit_offline.7/acknowledge", b"", "wet-end"),
        ("/alarms/wet-end.port_lost.1", b"", "wet-end"),
        ("/alarms/_.disk_low.1", b"", "_"),
        ("/api/v1/alarms/own/wet-end.3.own-1a", b"version=1", "wet-end"),
        ("/alarms", b"bus=_", "_"),
        ("/alarms/performance", b"", ""),
    ],
)
def test_the_bus_that_a_request_names(path: str, query: bytes, bus: str) -> None:
    assert named_bus(path, query, PREFIXES) == bus


@pytest.mark.parametrize(
    "path", ["/feed", "/healthz", "/lines", "/login", "/static/1/a.css", "/api/v1/sites"]
)
def test_what_every_server_responds_to_itself(path: str) -> None:
    assert is_own(path)
    assert not is_own("/feedback")


def test_a_socket_names_its_server_before_the_cookie() -> None:
    assert named_server(b"language=de&home=app-2", "app-1", is_socket=True) == "app-2"
    assert named_server(b"language=de", "app-1", is_socket=True) == "app-1"
    assert named_server(b"home=app-2", "app-1", is_socket=False) == "app-1"


def test_a_page_names_its_server_before_the_cookie_of_all_tabs() -> None:
    assert named_server(b"", "app-1", "app-2", is_socket=False) == "app-2"


@pytest.mark.parametrize(
    ("bus", "server", "where", "looked_at"),
    [
        ("dry-end", "", "", "app-1"),
        ("dry-end", "app-2", "", "app-1"),
        ("wet-end", "", "app-2", "app-2"),
        ("coater", "", "", ""),
        ("no-such", "app-2", "", ""),
        ("", "", "", ""),
        ("", "app-2", "app-2", ""),
        ("", "app-1", "", ""),
        ("", "app-9", "", ""),
        ("", "http://evil.example", "", ""),
    ],
)
def test_where_a_request_belongs(
    homes: PlayedHomes, bus: str, server: str, where: str, looked_at: str
) -> None:
    place = place_of(bus, server, homes, BUSES)
    assert (place.home.server if place.home else "", place.looked_at) == (where, looked_at)


def test_a_server_that_is_no_home_shows_the_first_there_is(homes: PlayedHomes) -> None:
    homes.put("dry-end", "app-3")
    place = place_of("", "", homes, BUSES)
    assert place.home is not None
    assert place.home.server == "app-3"


def test_a_home_that_this_server_has_just_lost_is_not_passed_on_to_itself(homes: PlayedHomes) -> None:
    lost = PlayedHomes(homes=homes.homes)
    lost.is_here = lambda _: False  # type: ignore[method-assign]
    assert place_of("dry-end", "", lost, BUSES).home is None
