"""What docs/mqtt.md gives to copy, tried: for other programs, and the rules by which a broker keeps each
server to its own."""

from __future__ import annotations

import asyncio
import json
import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

from app.system.mqtt.node import LINES
from tests.app.broker import Broker, listening, running
from tests.app.complete_app import complete_app
from tests.app.fake_worker import until
from tests.app.sparkplug import Host
from tests.app.system.test_mqtt_broker import configuration, node_of, site
from tests.app.system.test_mqtt_node import command
from tests.unpacked import environment, program

PAGE = Path(__file__).resolve().parents[3] / "docs" / "mqtt.md"
BLOCKS = re.findall(r"```(\w*)\n(.*?)```", PAGE.read_text(), re.DOTALL)
PASSWORD = "of the test"


def block(begin: str) -> str:
    """Return the one block of the documentation that begins with a line."""
    (found,) = (text for _, text in BLOCKS if text.startswith(begin))
    return str(found)


async def genuine(tmp_path: Path) -> bytes:
    """Return the document of a line, as the broker has it."""
    async with running(tmp_path) as broker, broker.client() as reader:
        await reader.subscribe(f"{LINES}/+/+")
        async with site(tmp_path / "site", broker) as house:
            await house.worker()
            async for message in reader.messages:
                return bytes(message.payload)
    raise AssertionError("no document")


async def test_documents_have_what_other_programs_are_told_to_read(tmp_path: Path) -> None:
    """Telegraf by its configuration, and Node-RED by a function."""
    document = await genuine(tmp_path)
    (consumer,) = tomllib.loads(block("[[inputs.mqtt_consumer]]"))["inputs"]["mqtt_consumer"]
    (wanted,) = consumer["json_v2"][0]["object"]
    (line,) = json.loads(document)[wanted["path"]]
    for key in (*wanted["tags"], *wanted["included_keys"]):
        assert isinstance(line[key], str | int | float), key
    assert consumer["topics"] == [f"{LINES}/+/+"]
    node = shutil.which("node")
    if node is None:
        pytest.skip("Node.js is not here")
    code = f"const f = new Function('msg', {json.dumps(block('const line'))});"
    words = [node, "-e", f"{code} console.log(JSON.stringify(f({{ payload: {document.decode()} }})));"]
    shown = await asyncio.to_thread(subprocess.run, words, check=True, capture_output=True, text=True)
    payload = json.loads(shown.stdout)["payload"]
    assert payload["line"] == "Mill 7 dry-end"
    assert payload["verdict"]
    assert isinstance(payload["alarms"], dict)


@pytest.fixture
def broker(tmp_path: Path) -> Broker:
    """Run a broker with the documented rules, for another server too, and one who may read everything."""
    mill7 = block("user mill7")
    mill8 = mill7.replace("mill7", "mill8").replace("Mill 7", "Mill 8")
    (tmp_path / "acl").write_text(f"{mill7}\n{mill8}\n{block('user scada')}\nuser observer\ntopic read #\n")
    passwords = tmp_path / "passwords"
    passwords.touch(0o600)
    for user in ("mill7", "mill8", "scada", "observer"):
        words = [program("mosquitto_passwd"), "-b", str(passwords), user, PASSWORD]
        subprocess.run(words, check=True, env=environment("mosquitto_passwd"), capture_output=True)
    return Broker(tmp_path, f"password_file {passwords}\nacl_file {tmp_path}/acl")


async def test_the_rules_let_a_server_publish_its_own_and_nothing_else(
    tmp_path: Path, broker: Broker
) -> None:
    host = Host("dry-end", "Mill 7")
    secret = tmp_path / "secret"
    secret.write_text(PASSWORD)
    secret.chmod(0o600)
    keys = f'username = "mill7"\npassword_file = "{secret}"\noverview = true'
    config = configuration(tmp_path / "site", f"mqtt://127.0.0.1:{broker.port}", keys)
    observer = {"username": "observer", "password": PASSWORD}
    async with (
        broker,
        listening(broker, host, **observer),
        complete_app(tmp_path / "site", config=config) as house,
        broker.client(username="mill8", password=PASSWORD) as intruder,
        broker.client(username="scada", password=PASSWORD) as scada,
        broker.client(**observer) as everything,
    ):
        await house.worker()
        await until(lambda: len(host.values) == 3, "every unit is born")
        await scada.publish("spBv1.0/Mill 7/NCMD/dry-end", command("Node Control/Rebirth"), qos=1)
        await until(lambda: host.births == 2, "the host may request a rebirth")
        await everything.subscribe("#", 1)
        forbidden = ("NBIRTH/dry-end", "NDEATH/dry-end", "DDATA/dry-end/Unit 1", "NCMD/dry-end")
        for topic in (*(f"spBv1.0/Mill 7/{each}" for each in forbidden), f"{LINES}/Mill 7/dry-end"):
            await intruder.publish(topic, b"forged", qos=1)
        await scada.publish("spBv1.0/Mill 7/DCMD/dry-end/Unit 1", b"forged", qos=1)
        await intruder.publish("spBv1.0/Mill 8/NBIRTH/own", b"the last", qos=1)
        awaited = {f"{LINES}/Mill 7/dry-end", "spBv1.0/Mill 8/NBIRTH/own"}
        async for message in everything.messages:
            assert message.payload != b"forged", message.topic
            awaited.discard(str(message.topic))
            if not awaited:
                break
        assert node_of(house).node.refused == 0
