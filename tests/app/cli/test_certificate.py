"""``lineside certificate create``: an authority, its certificates, and what is never overwritten."""

from __future__ import annotations

import re
import socket
import stat
import time
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from app.cli import certificate, cli
from app.cli.certificate import own_addresses, server_names
from app.settings import ServerSettings
from bus.tls import read_certificate
from tests.certificates import subject_of
from tests.for_each import for_each

BUSES = '[[bus]]\nname = "dry-end"\nport = "/dev/a"\n[[bus]]\nname = "wet-end"\nport = "/dev/b"\n'
MADE = {"ca", "server", "worker-dry-end", "worker-wet-end"}


@pytest.fixture
def config(tmp_path: Path) -> Path:
    file = tmp_path / "lineside.toml"
    file.write_text(f'[site]\nname = "Mill 7, \\"east\\" $x"\n{BUSES}', encoding="utf-8")
    return file


def create(config: Path, *options: str) -> Result:
    return CliRunner().invoke(cli, ["certificate", "create", "--config", str(config), *options])


def contents(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in sorted(folder.iterdir())}


def test_an_authority_a_server_and_a_worker_of_each_bus(config: Path) -> None:
    result = create(config, "--name", "Line.Plant.Example", "--name", "10.0.0.7")
    assert result.exit_code == 0, result.output
    folder = config.parent / "certificates"
    assert set(contents(folder)) == {f"{name}.{ending}" for name in MADE for ending in ("pem", "key")}
    assert {stat.S_IMODE(file.stat().st_mode) for file in folder.iterdir()} == {0o600}
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert 'certificate = "certificates/server.pem"' in result.output
    server, worker = subject_of(folder / "server.pem"), subject_of(folder / "worker-dry-end.pem")
    for name in ("DNS:line.plant.example", "IP Address:10.0.0.7", "DNS:localhost", "IP Address:127.0.0.1"):
        assert name in server
    assert "TLS Web Server Authentication" in server
    assert "TLS Web Client Authentication" in worker
    assert "CN = dry-end" in worker
    assert "CA:TRUE, pathlen:0" in subject_of(folder / "ca.pem")


def test_again_renews_all_but_the_authority_and_the_keys(config: Path) -> None:
    create(config)
    folder = config.parent / "certificates"
    before = contents(folder)
    result = create(config)
    assert result.exit_code == 0
    after = contents(folder)
    assert {name for name in after if after[name] != before[name]} == {
        "server.pem",
        "worker-dry-end.pem",
        "worker-wet-end.pem",
    }
    assert result.output.count(" renewed for 730 days") == 3


def test_the_configured_files_are_those_of_the_server(config: Path) -> None:
    tls = '[server.tls]\ncertificate = "site.pem"\nkey = "site.key"\n'
    config.write_text(tls + BUSES)
    assert create(config).exit_code == 0
    assert read_certificate(config.parent / "site.pem")
    assert (config.parent / "site.key").exists()
    assert not (config.parent / "certificates" / "server.pem").exists()


def test_a_missing_folder_is_named_before_anything_is_made(config: Path) -> None:
    tls = '[server.tls]\ncertificate = "tls/site.pem"\nkey = "certificates/site.key"\n'
    config.write_text(tls + BUSES)
    result = create(config)
    assert result.exit_code == 1
    assert f"folder {config.parent / 'tls'} is missing" in result.output
    assert list(config.parent.iterdir()) == [config]
    (config.parent / "tls").mkdir()
    assert create(config).exit_code == 0
    assert (config.parent / "certificates" / "site.key").exists()


def test_a_foreign_certificate_is_not_overwritten(config: Path) -> None:
    create(config)
    folder = config.parent / "certificates"
    elsewhere = config.parent / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "lineside.toml").write_text(BUSES)
    create(elsewhere / "lineside.toml")
    foreign = (elsewhere / "certificates" / "server.pem").read_bytes()
    for content in (foreign, b"a letter"):
        (folder / "server.pem").write_bytes(content)
        result = create(config)
        assert result.exit_code == 1
        assert "is not overwritten" in result.output
        assert (folder / "server.pem").read_bytes() == content


def test_a_key_that_is_none_is_not_overwritten(config: Path) -> None:
    folder = config.parent / "certificates"
    folder.mkdir()
    (folder / "server.key").write_text("a letter")
    result = create(config)
    assert result.exit_code == 1
    assert "nothing was overwritten" in result.output
    assert (folder / "server.key").read_text() == "a letter"
    assert not list(folder.glob(".*"))


def test_half_an_authority_is_not_completed(config: Path) -> None:
    create(config)
    folder, name = config.parent / "certificates", "ca.key"
    (folder / name).unlink()
    before = contents(folder)
    result = create(config)
    assert result.exit_code == 1
    assert f"{name} is missing" in result.output
    assert contents(folder) == before


def test_an_expired_certificate_is_renewed(config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patched:
        patched.setattr(certificate, "unix_now", lambda: time.time() - 731 * 86_400)
        create(config)
    assert create(config).exit_code == 0
    found = read_certificate(config.parent / "certificates" / "server.pem")
    assert found.ends_at - found.begins_at == pytest.approx(730 * 86_400)


def test_a_name_that_is_none_is_refused(config: Path) -> None:
    for name in ("a b", "x,IP:1.2.3.4", "-x", "*.plant"):
        assert create(config, f"--name={name}").exit_code == 2
    assert not (config.parent / "certificates").exists()


@for_each("host", ["0.0.0.0", "::", "[::]", "10.1.2.3", "line.example"])
def test_the_names_of_the_server(host: str) -> None:
    names = server_names(ServerSettings(host=host, allowed_hosts=("mill.example",)), ["127.0.0.1"])
    assert len(names) == len(set(names))
    assert {socket.gethostname(), "mill.example", "localhost", "127.0.0.1", "::1"} <= set(names)
    assert (host in names) == bool(re.search("[1-9a-z]", host))


def test_the_own_addresses_are_no_documentation() -> None:
    assert not {"192.0.2.1", "2001:db8::1"} & set(own_addresses())
