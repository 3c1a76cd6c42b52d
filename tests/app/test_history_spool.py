"""The spool: what was appended is read in order, whatever happens to the file; the oldest gives way."""

from __future__ import annotations

import os
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.history.intake.updates import Delivery
from app.history.spool.records import pack, records_in, unpack
from app.history.spool.segments import Segment, to_give_up
from app.history.spool.spool import Spool
from bus.contract import BusLink, ParameterValue, Reading, Staged, UnitLink
from bus.instants import UnixTime
from bus.messages import Message
from tests.app.history_line import NOON

MICROS = st.integers(0, 4_000_000_000_000_000)
BYTE = st.integers(0, 255)
FOUR_BYTES = st.integers(0, 2**32 - 1)
AT = MICROS.map(lambda at: UnixTime(at / 1_000_000))
READING = st.builds(Reading, st.integers(1, 255), AT, FOUR_BYTES, FOUR_BYTES, BYTE, BYTE, BYTE)
OTHER = st.one_of(
    st.builds(
        UnitLink, st.integers(1, 255), AT, st.just("stale"), st.just(Message.of("bus_closed", reason=1))
    ),
    st.builds(BusLink, AT, st.just("closed")),
    st.builds(ParameterValue, st.integers(1, 255), st.just(3), AT, FOUR_BYTES),
)
DELIVERIES = st.lists(st.tuples(st.text(max_size=9), st.lists(READING | OTHER, max_size=9)), max_size=4)


def delivery(number: int) -> list[Delivery]:
    return [("dry-end", [Reading(1, UnixTime(NOON + number), number, number, 0, 0, 0)])]


def number_of(deliveries: Any) -> int:
    return int(deliveries[0][1][0].actual)


def drained(spool: Spool, after: int = 0) -> list[int]:
    """The numbers of all deliveries, in the order in which they are read."""
    found = []
    while (record := spool.read(after)) is not None:
        after = record[0].number
        found.append(number_of(record[1]))
    return found


@given(DELIVERIES, st.booleans())
def test_a_record_gives_back_what_belongs_to_history(deliveries: list[Delivery], is_repeated: bool) -> None:
    packed = pack(7, deliveries, is_repeated=is_repeated)
    kept = [(bus, updates) for bus, updates in deliveries if updates]
    if packed is None:
        assert not kept
        return
    (record,) = records_in(packed)
    times = [round(each.at * 1e6) for _, updates in kept for each in updates if type(each) is Reading]
    assert record.facts == (7, min(times, default=0), max(times, default=0), len(times), is_repeated)
    found = unpack(record.content)
    assert [bus for bus, _ in found] == [bus for bus, _ in kept]
    for (_, before), (_, after) in zip(kept, found, strict=True):
        assert sorted(before, key=repr) == sorted(after, key=repr)


def test_updates_that_are_no_history_take_no_space() -> None:
    assert (
        pack(1, [("dry-end", [Staged(1, UnixTime(NOON), 5), ParameterValue(1, 17, UnixTime(NOON), 1)])])
        is None
    )


@given(st.lists(st.binary(max_size=12), min_size=4, max_size=4), st.integers(0, 10_000), BYTE)
def test_a_torn_end_or_damage_costs_only_what_it_touches(between: list[bytes], place: int, mask: int) -> None:
    packed = [pack(number, delivery(number)) or b"" for number in (1, 2, 3)]
    data = b"".join(b for pair in zip(between, [*packed, b""], strict=True) for b in pair)
    ends = [record.stop for record in records_in(data)]
    assert len(ends) == 3
    torn = list(records_in(data[: place % len(data)]))
    assert [record.facts.number for record in torn] == [
        n for n, end in enumerate(ends, 1) if end <= place % len(data)
    ]
    changed = bytearray(data)
    changed[place % len(data)] ^= mask
    intact = {record.facts.number for record in records_in(bytes(changed))}
    assert len(intact) >= 2
    assert [number_of(unpack(record.content)) for record in records_in(bytes(changed))] == sorted(intact)


@given(st.lists(st.integers(1, 100), min_size=1, max_size=12), st.integers(1, 50), st.integers(1, 600))
def test_the_oldest_gives_way_and_no_more_than_needed(sizes: list[int], needed: int, most: int) -> None:
    segments = [Segment(n, n, size, 1, n, n) for n, size in enumerate(sizes, 1)]
    given_up = to_give_up(segments, needed, most)
    assert given_up == segments[: len(given_up)]
    left = segments[len(given_up) :]
    assert len(left) == 1 or sum(each.size for each in left) + needed <= most
    if given_up:
        assert sum(each.size for each in [given_up[-1], *left]) + needed > most


ACTION = st.sampled_from(("append", "append", "append", "read", "drop", "open", "tear", "fail"))


@settings(max_examples=40, deadline=None)
@given(actions=st.lists(ACTION, max_size=40), most=st.sampled_from((600, 3000, 10**6)))
def test_it_does_what_a_list_would(
    actions: list[str], most: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("spool")
    spool, waiting, appended, after = Spool(folder, most), list[int](), 0, 0
    with pytest.MonkeyPatch.context() as patch:
        for action in actions:
            if action == "append":
                appended += 1
                lost = spool.state.lost
                spool.append(delivery(appended))
                waiting = [*waiting[spool.state.lost - lost :], appended]
            elif action == "fail":
                with patch.context() as failing:
                    failing.setattr(os, "fdatasync", fail)
                    with pytest.raises(OSError, match="broken"):
                        spool.append(delivery(0))
            elif action == "read":
                found = drained(spool, after)
                assert found == waiting
            elif action == "drop" and (record := spool.read(after)) is not None:
                after = record[0].number
                waiting.pop(0)
                spool.drop(after)
            elif action in ("open", "tear"):
                spool.close()
                files = sorted(folder.glob("*.spool"))
                if action == "tear" and files:
                    with files[-1].open("ab") as file:
                        file.write((pack(99, delivery(99)) or b"")[:-1])
                spool = Spool(folder, most)
            assert spool.contents == Spool(folder, most).contents
    spool.close()


def fail(_: int) -> None:
    raise OSError("broken")


@pytest.fixture
def spool(tmp_path: Path) -> Iterator[Spool]:
    spool = Spool(tmp_path / "spool", 4000)
    yield spool
    spool.close()


def test_the_bound_is_kept_and_losses_are_counted(spool: Spool) -> None:
    for number in range(1, 101):
        spool.append(delivery(number))
        assert spool.contents.size <= 4000
    found = drained(spool)
    assert found == list(range(101 - len(found), 101))
    assert spool.state.lost == 100 - len(found) == 100 - spool.contents.readings
    assert (spool.contents.begin, spool.contents.end) == tuple(
        round((NOON + number) * 1e6) for number in (found[0], 100)
    )


def test_numbers_rise_also_after_all_was_stored_and_the_server_started_again(
    spool: Spool, tmp_path: Path
) -> None:
    numbers = []
    for number in range(3):
        spool.append(delivery(number))
        record = spool.read(0)
        assert record is not None
        numbers.append(record[0].number)
        spool.drop(record[0].number)
        assert not list((tmp_path / "spool").glob("*.spool"))
        spool.close()
        spool = Spool(tmp_path / "spool", 4000)
    assert all(a < b for a, b in pairwise(numbers))


def test_on_a_short_disk_the_oldest_gives_way_then_nothing_is_written(tmp_path: Path) -> None:
    free = [1000]
    spool = Spool(tmp_path / "spool", 4000, min_free=100, free=lambda _: free[0])
    for number in range(1, 21):
        spool.append(delivery(number))
    free[0] = 50
    with pytest.raises(OSError, match="No space left"):
        spool.append(delivery(21))
    assert len(drained(spool)) + spool.state.lost == 20
    assert drained(spool)[-1] == 20
    free[0] = 1000
    spool.append(delivery(22))
    assert drained(spool)[-1] == 22
    spool.close()


@pytest.mark.parametrize("content", [b"", b"{", b'{"id": 7}', b"\xff"])
def test_records_outlive_a_damaged_state(spool: Spool, tmp_path: Path, content: bytes) -> None:
    spool.append(delivery(1))
    (tmp_path / "spool" / "spool.json").write_bytes(content)
    again = Spool(tmp_path / "spool", 4000)
    assert drained(again) == [1]
    assert again.state.id != spool.state.id


def test_a_file_that_holds_a_torn_record_alone_does_not_take_the_next_one_with_it(tmp_path: Path) -> None:
    (tmp_path / "spool").mkdir()
    (tmp_path / "spool" / f"{1:020d}.spool").write_bytes((pack(1, delivery(1)) or b"")[:-1])
    spool = Spool(tmp_path / "spool", 4000)
    spool.append(delivery(2))
    spool.drop(0)
    assert drained(spool) == [2]
    spool.close()


def test_damage_in_the_middle_is_noted_and_a_torn_end_is_not(spool: Spool, tmp_path: Path) -> None:
    for number in (1, 2):
        spool.append(delivery(number))
    (file,) = (tmp_path / "spool").glob("*.spool")
    data = bytearray(file.read_bytes())
    file.write_bytes(data + data[:20])
    assert Spool(tmp_path / "spool", 4000).contents.damaged == 0
    data[20] ^= 0xFF
    file.write_bytes(data)
    damaged = Spool(tmp_path / "spool", 4000)
    assert (damaged.contents.damaged, drained(damaged)) == (1, [2])


def test_files_are_private(spool: Spool, tmp_path: Path) -> None:
    spool.append(delivery(1))
    assert {path.stat().st_mode & 0o077 for path in (tmp_path / "spool").rglob("*")} == {0}
