"""The lines of a site on a real broker: born, followed, cut off, and shown elsewhere."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from functools import partial
from html import unescape
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from app.cli import cli
from app.cli.check import mqtt
from app.core.web.shape import iso
from app.line.alarms.line_alarms import SiteAlarms
from app.line.history.series.runs import SECOND, micros
from app.line.history.service import History
from app.settings import ConfigurationError, load
from app.system.mqtt import session
from app.system.mqtt.session import Nodes, NodeSession, identifier_for
from bus.contract import BusLink, Reading
from bus.instants import UnixTime, unix_now
from bus.messages import in_english
from tests.app.broker import Broker, Relay, listening, running
from tests.app.complete_app import House, complete_app
from tests.app.fake_worker import PlayedWorker, reading, until
from tests.app.sparkplug import Host
from tests.app.system.test_mqtt_node import command
from tests.for_each import for_each

ADDRESSES = (1, 2, 16)
UNITS = "".join(f'[[bus.unit]]\nid = {n}\nname = "Unit {n}"\n' for n in ADDRESSES)


def configuration(folder: Path, url: str, more: str = "", name: str = "Mill 7", bus: bool = True) -> Path:
    folder.mkdir(exist_ok=True)
    config = folder / "lineside.toml"
    line = f'[[bus]]\nname = "dry-end"\nport = "/dev/null"\nworker = "remote"\n{UNITS}' if bus else ""
    config.write_text(
        f'[site]\nname = "{name}"\n[server]\ndata = "data"\n[mqtt]\nurl = "{url}"\n{more}\n{line}'
    )
    return config


@asynccontextmanager
async def site(folder: Path, broker: Broker | Relay, more: str = "") -> AsyncIterator[House]:
    """Run a site with a line of three units that respond."""
    config = configuration(folder, f"mqtt://127.0.0.1:{broker.port}", more)
    async with complete_app(folder, config=config) as house:
        yield house


def as_received(sent: Reading) -> tuple[int, float]:
    """Return the time of a reading in ms, and its speed, as a host gets them."""
    return round(float(sent.at) * 1e6) // 1000, (sent.actual or 0) / 10


def node_of(house: House) -> NodeSession:
    (node,) = house.services[Nodes]
    return node


def is_confirmed(house: House) -> bool:
    """Return whether the broker has confirmed all that was sent, so that none of it is sent again."""
    node = node_of(house)
    assert node.backlog is not None
    return node.backlog.received >= max(micros(each.sent_until) for each in node.node.devices.values())


async def connected(house: House) -> None:
    await until(lambda: node_of(house).status.is_connected, "the node is published")


async def test_a_line_is_born_followed_and_leaves_its_death(tmp_path: Path) -> None:
    host = Host("dry-end", "Mill 7")
    async with running(tmp_path) as broker, listening(broker, host):
        async with site(tmp_path / "site", broker) as house:
            worker = await house.worker()
            await until(lambda: len(host.values) == 3, "every unit is born")
            assert host.values["Unit 1"]["Speed/Actual"] == 100.0
            await worker.update(reading(1, actual=1011))
            await until(lambda: host.values["Unit 1"]["Speed/Actual"] == 101.1, "a reading is sent")
            await worker.update(BusLink(unix_now(), "closed"))
            await until(lambda: not host.values, "units that are silent are dead")
            assert host.is_alive
        await until(lambda: not host.is_alive, "the node is dead")
    assert host.faults == []


async def feed(worker: PlayedWorker, sent: list[Reading], rounds: int) -> None:
    """Let every unit respond some times, each with another speed than before."""
    for _ in range(rounds):
        for unit in ADDRESSES:
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


async def test_each_reading_comes_once_and_in_order_over_losses(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(session, "RETRY_S", (0.2,))
    host = Host("dry-end", "Mill 7")
    async with running(tmp_path) as broker, listening(broker, host):
        relay = Relay(broker)
        async with relay.running(), site(tmp_path / "site", relay) as house:
            worker = await house.worker()
            await until(lambda: len(host.values) == 3, "every unit is born")
            first = {unit: received(host, unit) for unit in ADDRESSES}
            sent: list[Reading] = []
            for births in range(2, 4):
                await feed(worker, sent, 10)
                # What is on its way in the moment of the loss may come twice: nothing is.
                await until(partial(has, host, "Unit 16", (sent[-1].actual or 0) / 10), "received")
                await until(partial(is_confirmed, house), "the broker has confirmed what was sent")
                relay.cut()
                await until(lambda: node_of(house).status.fault is not None, "the connection is lost")
                await feed(worker, sent, 10)
                assert house.live.units[1].reading in sent[-4:], "the line is followed meanwhile"
                await until(lambda: house.services[History].status.waiting == 0, "stored")
                assert node_of(house).lag_s() > 0
                await until(partial(was_born, host, births), "it is born again")
            await feed(worker, sent, 10)
            expected = {unit: [as_received(each) for each in sent if each.unit == unit] for unit in ADDRESSES}
            for unit in ADDRESSES:
                total = len(expected[unit]) + len(first[unit])
                await until(partial(has_received, host, unit, total), "all is received")
            await asyncio.sleep(1.2)
    for unit in ADDRESSES:
        assert received(host, unit) == first[unit] + expected[unit]
        for is_old in (True, False):
            times = [at for at, _, old in host.readings[f"Unit {unit}", "Speed/Actual"] if old is is_old]
            assert times == sorted(times)
    assert host.faults == []


async def test_status_states_up_to_when_the_broker_has_everything(tmp_path: Path) -> None:
    folder = tmp_path / "site"
    words = ["status", "--config", str(folder / "lineside.toml")]

    async def shown() -> tuple[str, Any]:
        text, facts = [
            (await asyncio.to_thread(CliRunner().invoke, cli, [*words, *more])).stdout
            for more in ((), ("--json",))
        ]
        return text, json.loads(facts)["nodes"]

    async with running(tmp_path) as broker:
        place = f"127.0.0.1:{broker.port}"
        configuration(folder, f"mqtt://{place}")
        text, nodes = await shown()
        assert f"broker {place}: nothing of dry-end was published yet" in text
        assert nodes == [{"broker": place, "node": "dry-end", "until": None, "lag_s": None}]
        async with site(folder, broker) as house:
            await house.worker()
            backlog = node_of(house).backlog
            assert backlog is not None
            await until(lambda: backlog.received > 0, "it was confirmed")
        text, ((node,)) = await shown()
        assert f"broker {place}: has everything of dry-end up to " in text
        assert node["until"] == iso(UnixTime(backlog.received / SECOND))
        assert node["lag_s"] >= 0


async def test_the_number_of_a_connection_survives_a_restart(tmp_path: Path) -> None:
    host = Host("dry-end", "Mill 7")
    found = []
    async with running(tmp_path) as broker, listening(broker, host):
        for _ in range(2):
            async with site(tmp_path / "site", broker) as house:
                await connected(house)
                await until(lambda: host.is_alive, "the node is born")
                found.append(host.bd_seq)
            await until(lambda: not host.is_alive, "the node is dead")
    assert found == [0, 1]
    assert host.faults == []


async def test_a_connection_that_another_client_takes_is_stated_and_leaves_its_will(tmp_path: Path) -> None:
    host = Host("dry-end", "Mill 7")
    async with running(tmp_path) as broker, listening(broker, host), site(tmp_path / "site", broker) as house:
        await until(lambda: host.is_alive, "the node is born")
        node = node_of(house)
        async with broker.client(identifier=identifier_for("Mill 7", "dry-end")):
            await until(lambda: node.status.fault is not None, "the connection was taken over")
            fault = node.status.fault
            assert fault is not None
            assert "another client has the same identity" in in_english(fault)
            assert not host.is_alive
        await until(lambda: host.births >= 2 and host.is_alive, "it is born again")
    assert host.faults == []


async def test_nothing_is_commanded_by_mqtt_but_rebirth(tmp_path: Path) -> None:
    host = Host("dry-end", "Mill 7")
    async with running(tmp_path) as broker, listening(broker, host), site(tmp_path / "site", broker) as house:
        worker = await house.worker()
        await until(lambda: len(host.values) == 3, "every unit is born")
        async with broker.client() as other:
            for topic in ("NCMD/dry-end", "DCMD/dry-end/Unit 1"):
                for name in ("Speed/Commanded", "Outputs/Output 1", "Node Control/Reboot"):
                    await other.publish(f"spBv1.0/Mill 7/{topic}", command(name), qos=1)
            for payload in (b"\xff" * 100, bytes(200_000)):
                await other.publish("spBv1.0/Mill 7/NCMD/dry-end", payload, qos=1)
            await other.publish("spBv1.0/Mill 7/NCMD/dry-end", command("Node Control/Rebirth"), qos=1)
            await until(lambda: host.births == 2, "it is born again")
        assert node_of(house).node.refused == 8
        assert worker.commands == [], "no command reached the worker"
        metrics = (await house.http("viewer").get("/metrics")).text
        assert 'lineside_mqtt_refused_total{bus="dry-end"} 8.0' in metrics
        page = (await house.http("admin").get("/system")).text
        assert "MQTT node dry-end" in page
    assert host.faults == []


async def test_it_waits_for_its_primary_host(tmp_path: Path) -> None:
    host = Host("dry-end", "Mill 7")

    def state(online: bool, timestamp: int) -> bytes:
        return json.dumps({"online": online, "timestamp": timestamp}).encode()

    async with running(tmp_path) as broker, listening(broker, host), broker.client() as primary:
        topic = "spBv1.0/STATE/scada"
        async with site(tmp_path / "site", broker, 'primary_host = "scada"') as house:
            node = node_of(house)
            await until(lambda: node.status.waits, "it waits")
            for payload in (b"online", b"", b"\xff", b"[]", b'{"online": true, "timestamp": "now"}'):
                await primary.publish(topic, payload, qos=1, retain=True)
            await primary.publish(topic, state(False, 5), qos=1, retain=True)
            await primary.publish(topic, state(True, 6), qos=1, retain=True)
            await until(lambda: host.is_alive, "the node is born")
            await primary.publish(topic, state(False, 4), qos=1)
            await primary.publish(topic, state(False, 7), qos=1, retain=True)
            await until(lambda: not host.is_alive, "it dies with its primary host")
            await primary.publish(topic, state(True, 3), qos=1, retain=True)
            await until(lambda: node.status.host_is_behind, "the clock of the host was set back")
            assert "Compare its clock" in in_english(node.state())
            assert host.births == 1
    assert host.faults == []


@pytest.mark.parametrize(
    ("more", "words"),
    [("allow_anonymous false", "refuses the connection: Not authorized"), ("max_connections 0", "")],
)
async def test_a_broker_that_refuses_is_stated(tmp_path: Path, more: str, words: str) -> None:
    async with running(tmp_path, more) as broker, site(tmp_path / "site", broker) as house:
        node = node_of(house)
        await until(lambda: node.status.fault is not None, "why it is not published is known")
        fault = node.status.fault
        assert fault is not None
        assert words in in_english(fault)
        assert in_english(node.state()).startswith("node dry-end: the broker 127.0.0.1:")
        alarms = house.services[SiteAlarms]
        alarm = alarms.list.alarms["_.broker_lost"]
        await until(lambda: alarms.present(alarm) == fault, "its alarm")
        alarm.facts = replace(alarm.facts, active=True)
        page = (await house.http("admin").get("/system")).text
        assert f'href="/alarms/{alarm.id}">{in_english(node.state())}' in unescape(page)


@for_each(
    ("url", "more", "words"),
    [
        ("http://broker", "", "must be the URL of a broker"),
        ("mqtt://lineside:secret@broker", "", "must not have a user or a password"),
        ("mqtt://broker/topic", "", "must be the URL of a broker"),
        ("mqtt://broker:99999", "", "must be the URL of a broker"),
        ("mqtt://broker", 'ca_file = "ca.pem"', "are for a broker with TLS"),
        ("mqtts://broker", 'certificate = "node.pem"', "certificate needs key beside it"),
        ("mqtt://broker", 'password_file = "p"', "password_file needs username"),
        ("mqtt://broker", 'group = "a/b"', "must not have / + or #"),
        ("mqtt://broker", 'deadband = { actual = "-1" }', "deadband"),
    ],
)
def test_a_wrong_setting_is_refused_where_it_stands(tmp_path: Path, url: str, more: str, words: str) -> None:
    with pytest.raises(ConfigurationError) as refused:
        load(configuration(tmp_path, url, more))
    assert words in str(refused.value)
    assert "secret" not in str(refused.value)


async def test_check_states_whether_the_broker_takes_the_connection(tmp_path: Path) -> None:
    async with running(tmp_path) as broker:
        config = configuration(tmp_path / "site", f"mqtt://127.0.0.1:{broker.port}")
        found = await asyncio.to_thread(lambda: list(mqtt(load(config))))
        assert [in_english(each.message) for each in found] == [
            f"the broker 127.0.0.1:{broker.port} takes the connection"
        ]
    (lost,) = await asyncio.to_thread(lambda: list(mqtt(load(config))))
    assert lost.is_fault
    assert "cannot be reached: Connection refused" in in_english(lost.message)
