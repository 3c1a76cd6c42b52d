"""What may go wrong between a line and its broker: said in words, limited, and nothing is lost or doubled."""

from __future__ import annotations

import asyncio
import time
from functools import partial
from pathlib import Path

import pytest

from app.line.history.service import History
from app.system.mqtt import session
from bus.contract import Reading
from bus.messages import in_english
from tests.app.broker import Broker, Relay, listening, running
from tests.app.complete_app import complete_app
from tests.app.fake_worker import PlayedWorker, reading, until
from tests.app.sparkplug import Host
from tests.app.system.test_mqtt_broker import as_received, configuration, node_of, site
from tests.app.system.test_mqtt_node import command

UNITS = (1, 2, 16)


@pytest.fixture(autouse=True)
def _soon_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session, "RETRY_S", (0.2,))


async def feed(worker: PlayedWorker, sent: list[Reading], rounds: int) -> None:
    """Let every unit respond some times, each with another speed than before."""
    for _ in range(rounds):
        for unit in UNITS:
            sent.append(reading(unit, actual=1001 + len(sent)))
            await worker.update(sent[-1])
            await asyncio.sleep(0.01)


def received(host: Host, unit: int) -> list[tuple[int, object]]:
    """Return the speeds of a unit that a host was given, by their time."""
    return sorted((at, value) for at, value, _ in host.readings[f"Unit {unit}", "Speed/Actual"])


def has(host: Host, device: str, speed: float) -> bool:
    return bool(host.values[device]["Speed/Actual"] == speed)


def has_received(host: Host, unit: int, readings: int) -> bool:
    return len(received(host, unit)) >= readings


def was_born(host: Host, times: int) -> bool:
    return host.births >= times


def is_faulty(status: session.NodeStatus) -> bool:
    return status.fault is not None


async def test_each_reading_comes_once_over_losses(tmp_path: Path) -> None:
    """Each reading of a line comes once and in order, over losses of the connection."""
    host = Host("dry-end", "Mill 7")
    async with running(tmp_path) as broker, listening(broker, host):
        relay = Relay(broker)
        async with relay.running(), site(tmp_path / "site", relay) as house:
            worker = await house.worker()
            await until(lambda: len(host.values) == 3, "every unit is born")
            first = {unit: received(host, unit) for unit in UNITS}
            sent: list[Reading] = []
            for births in range(2, 4):
                await feed(worker, sent, 10)
                # What is on its way in the moment of the loss may come twice: nothing is.
                await until(partial(has, host, "Unit 16", (sent[-1].actual or 0) / 10), "received")
                await asyncio.sleep(0.2)
                relay.cut()
                await until(lambda: node_of(house).status.fault is not None, "the connection is lost")
                await feed(worker, sent, 10)
                await until(lambda: house.services[History].status.waiting == 0, "stored")
                await until(partial(was_born, host, births), "it is born again")
            await feed(worker, sent, 10)
            expected = {unit: [as_received(each) for each in sent if each.unit == unit] for unit in UNITS}
            for unit in UNITS:
                total = len(expected[unit]) + len(first[unit])
                await until(partial(has_received, host, unit, total), "all is received")
            await asyncio.sleep(1.2)
    for unit in UNITS:
        assert received(host, unit) == first[unit] + expected[unit]
        for is_old in (True, False):
            times = [at for at, _, old in host.readings[f"Unit {unit}", "Speed/Actual"] if old is is_old]
            assert times == sorted(times)
    assert host.faults == []


async def test_a_broker_that_drops_every_second_connection_is_followed(tmp_path: Path) -> None:
    """Screen and history go on while every second connection to the broker is cut."""
    host = Host("dry-end", "Mill 7")
    async with running(tmp_path) as broker, listening(broker, host):
        relay = Relay(broker, is_cut=lambda number: number % 2 == 1)
        async with relay.running(), site(tmp_path / "site", relay) as house:
            sent: list[Reading] = []
            lines = asyncio.create_task(feed(await house.worker(), sent, 100_000))
            status = node_of(house).status
            for _ in range(2):
                await until(lambda: len(host.values) == 3, "every unit is born")
                births = host.births
                relay.cut()
                await until(lambda: status.fault is not None, "it is said")
                count = len(sent)
                await until(partial(was_born, host, births + 1), "it is born again")
                assert len(sent) > count, "the line is followed meanwhile"
                assert house.live.units[1].reading in sent[-4:]
            lines.cancel()
    assert relay.count >= 5
    assert host.faults == []


async def test_a_host_that_floods_rebirth_gets_one(tmp_path: Path) -> None:
    host = Host("dry-end", "Mill 7")
    async with running(tmp_path) as broker, listening(broker, host), site(tmp_path / "site", broker) as house:
        worker = await house.worker()
        await until(lambda: len(host.values) == 3, "every unit is born")
        async with broker.client() as other:
            for _ in range(500):
                await other.publish("spBv1.0/Mill 7/NCMD/dry-end", command("Node Control/Rebirth"), qos=1)
        await until(lambda: host.births >= 2, "it is born again")
        await worker.update(reading(1, actual=1011))
        # The birth of a node comes before those of its units.
        await until(
            lambda: host.values.get("Unit 1", {}).get("Speed/Actual") == 101.1, "values are sent as before"
        )
        assert host.births <= 4, "one in five seconds"
        assert node_of(house).node.refused == 0
    assert host.faults == []


async def test_two_servers_of_one_name_are_told_so(tmp_path: Path) -> None:
    """Two servers with one client id are told so, and both go on."""
    async with (
        running(tmp_path) as broker,
        site(tmp_path / "first", broker) as first,
        site(tmp_path / "second", broker) as second,
    ):
        for house in (first, second):
            status = node_of(house).status
            await until(partial(is_faulty, status), "it is said")
            assert status.fault is not None
            assert "another client has the same identity" in in_english(status.fault)
            assert (await house.http("viewer").get("/api/v1/sites")).status_code == 200


async def test_the_clock_of_a_broker_does_not_matter(tmp_path: Path) -> None:
    host = Host("dry-end", "Mill 7")
    broker = Broker(tmp_path, more="allow_anonymous true", clock="1970-01-02 00:00:00")
    async with broker, listening(broker, host), site(tmp_path / "site", broker) as house:
        began = time.time()
        await house.worker()
        await until(lambda: len(host.values) == 3, "every unit is born")
        for unit in UNITS:
            ((at, _),) = received(host, unit)
            assert abs(at / 1000 - began) < 60, "the time of the reading"
    assert host.faults == []


async def test_names_of_a_plant_become_topics(tmp_path: Path) -> None:
    names = ("Nip", "NIP", "Coater +1/2 #")
    host = Host("dry-end", "Mill - 7 -- north")
    async with running(tmp_path) as broker, listening(broker, host):
        config = configuration(tmp_path / "site", f"mqtt://127.0.0.1:{broker.port}", name="Mill / 7 +# north")
        text = config.read_text()
        for number, name in zip(UNITS, names, strict=True):
            text = text.replace(f'"Unit {number}"', f'"{name}"')
        config.write_text(text)
        async with complete_app(tmp_path / "site", config=config) as house:
            await house.worker()
            await until(lambda: len(host.values) == 3, "every unit is born")
            assert set(host.values) == {"Nip (1)", "NIP (2)", "Coater -1-2 -"}
    assert host.faults == []


async def test_payloads_that_are_cut_or_invented_are_refused_and_nothing_else(tmp_path: Path) -> None:
    host = Host("dry-end", "Mill 7")
    rebirth = command("Node Control/Rebirth")
    cut = [rebirth[:length] for length in range(len(rebirth))]
    invented = [b"\xff" * 100, b"{}", bytes(200_000), b"\x12\xff\xff\xff\xff\x0fx", rebirth * 2000]
    states = (b"", b"\xff", b"[]", b'{"online": 5, "timestamp": 1}', b'{"online": true, "timestamp": "now"}')
    async with (
        running(tmp_path) as broker,
        listening(broker, host),
        site(tmp_path / "site", broker, 'primary_host = "scada"') as house,
    ):
        worker, node = await house.worker(), node_of(house)
        async with broker.client() as other:
            for payload in (*states, b'{"online": true, "timestamp": 1}'):
                await other.publish("spBv1.0/STATE/scada", payload, qos=1)
            await until(lambda: len(host.values) == 3, "only what is a state counts")
            for topic in ("NCMD/dry-end", "DCMD/dry-end/Unit 1"):
                for payload in (*cut, *invented):
                    await other.publish(f"spBv1.0/Mill 7/{topic}", payload, qos=1)
            await until(lambda: node.node.refused == 2 * len(cut + invented), "each is counted")
        await worker.update(reading(1, actual=1011))
        await until(
            lambda: host.values.get("Unit 1", {}).get("Speed/Actual") == 101.1, "values are sent as before"
        )
        assert node.status.fault is None
        assert worker.commands == []
    assert host.births == 1
    assert host.faults == []
