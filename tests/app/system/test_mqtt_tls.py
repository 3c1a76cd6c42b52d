"""TLS to a real broker, with certificates of authorities of the test's own: who is not trusted is named."""

from __future__ import annotations

import gc
from pathlib import Path
from typing import Any

import pytest

from app.system.mqtt import session
from app.system.mqtt.session import BrokerError, connected
from app.system.mqtt.settings import MqttSettings
from bus.messages import in_english
from tests.app.broker import listening, running
from tests.app.complete_app import complete_app
from tests.app.fake_worker import until
from tests.app.sparkplug import Host
from tests.app.system.test_mqtt_broker import configuration
from tests.certificates import certificates
from tests.free_port import free_port

# paho leaves its socket to the collector where the handshake fails.
pytestmark = pytest.mark.filterwarnings("ignore:unclosed <ssl.SSLSocket:ResourceWarning")
IN_CLEAR = "allow_anonymous true"


def with_tls(folder: Path, name: str = "server") -> str:
    """Return the configuration of a broker that shows a certificate, and takes those of its own authority."""
    files = f"cafile {folder}/ca.pem\ncertfile {folder}/{name}.pem\nkeyfile {folder}/{name}.key"
    return f"{files}\nrequire_certificate true\nuse_identity_as_username true"


async def refusal(settings: MqttSettings) -> str:
    """Return why a connection cannot be made; empty where it can."""
    try:
        async with connected(settings, "test") as client:
            await client.publish("test", b"", qos=1)
    except BrokerError as error:
        return in_english(error.message)
    finally:
        gc.collect()
    return ""


@pytest.mark.parametrize(
    ("server", "own", "ca", "words"),
    [
        ("server", "worker", "ca", ""),
        ("server", "worker", "other/ca", "is not trusted: self-signed certificate in certificate chain"),
        ("expired", "worker", "ca", "is not trusted: certificate has expired"),
        ("misnamed", "worker", "ca", "is not trusted: IP address mismatch"),
        ("server", "", "ca", "refuses the certificate of this server: certificate required"),
        ("server", "worker-expired", "ca", "refuses the certificate of this server: certificate expired"),
        ("server", "other/worker", "ca", "refuses the certificate of this server: unknown ca"),
        ("server", "worker", "absent", "absent.pem"),
        ("server", "worker", "worker.key", "holds no certificate"),
    ],
)
async def test_who_is_not_trusted_is_named(
    tmp_path: Path, server: str, own: str, ca: str, words: str
) -> None:
    files = certificates(tmp_path / "files")
    pair: dict[str, Any] = {"certificate": files / f"{own}.pem", "key": files / f"{own}.key"} if own else {}
    authority = files / ca if ca.endswith(".key") else files / f"{ca}.pem"
    async with running(tmp_path, with_tls(files, server)) as broker:
        settings = MqttSettings(url=f"mqtts://127.0.0.1:{broker.port}", ca_file=authority, **pair)
        found = await refusal(settings)
    assert words in found
    assert bool(found) == bool(words)


async def test_tls_on_one_side_only_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session, "CONNECT_S", 1.0)
    files = certificates(tmp_path / "files")
    async with running(tmp_path, with_tls(files)) as broker:
        silent = await refusal(MqttSettings(url=f"mqtt://127.0.0.1:{broker.port}"))
    assert "does not respond as a broker: one side may expect TLS and the other not" in silent
    async with running(tmp_path, IN_CLEAR) as broker:
        settings = MqttSettings(url=f"mqtts://127.0.0.1:{broker.port}", ca_file=files / "ca.pem")
        assert "cannot be reached" in await refusal(settings)


async def test_a_line_is_published_over_tls(tmp_path: Path) -> None:
    """A line is published over TLS; the host listens to the same broker in clear."""
    host = Host("dry-end", "Mill 7")
    files = certificates(tmp_path / "files")
    secure = free_port()
    more = f"{IN_CLEAR}\nlistener {secure} 127.0.0.1\n{with_tls(files)}"
    named = {"ca_file": files / "ca.pem", "certificate": files / "worker.pem", "key": files / "worker.key"}
    keys = "\n".join(f'{key} = "{path}"' for key, path in named.items())
    async with running(tmp_path, more) as broker, listening(broker, host):
        config = configuration(tmp_path / "site", f"mqtts://127.0.0.1:{secure}", keys)
        async with complete_app(tmp_path / "site", config=config) as house:
            await house.worker()
            await until(lambda: len(host.values) == 3, "every unit is born")
        await until(lambda: not host.is_alive, "the node is dead")
    assert host.faults == []
