"""``worker = "remote"`` of a bus: its worker is on the machine with the port, and the server starts none."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from app.cli import check
from app.cli.install_service import unit_of
from app.settings import load
from tests import fork_server
from tests.app.cli.test_serve import buses_at, children_of, command, started, viewer_token
from tests.e2e.site import end, eventually

BUS = (
    '[[bus]]\nname = "{name}"\nport = "{port}"\nworker = "{worker}"\n[[bus.unit]]\nid = 1\nname = "Unwind"\n'
)


@pytest.fixture
def config(tmp_path: Path) -> Path:
    return tmp_path / "lineside.toml"


def write(config: Path, *buses: tuple[str, str, str]) -> None:
    tables = [BUS.format(name=name, port=port, worker=worker) for name, port, worker in buses]
    config.write_text("[server]\nport = 0\n" + "".join(tables))


def test_the_server_starts_no_worker_and_takes_the_one_elsewhere(config: Path) -> None:
    write(config, ("dry-end", "/dev/ttyUSB0", "remote"), ("wet-end", str(config.parent / "absent"), "server"))
    words = ("token", "create", "cabinet", "--role", "worker", "--bus", "dry-end")
    token, viewer = command(*words, config=config).stdout.strip(), viewer_token(config)

    with started("serve", "--config", str(config)) as (process, url):

        def linked() -> list[bool]:
            return [bus["worker"] for bus in buses_at(url, viewer)]

        eventually(lambda: linked() == [False, True], "the server's own worker is linked")
        assert len(children_of(process.pid)) == 1
        call = ["worker", "--bus", "dry-end", "--app", url, "--token", token, "--config", config]
        worker = fork_server.start(*call)
        try:
            eventually(lambda: linked() == [True, True], "the worker elsewhere is linked")
        finally:
            end(worker)


def test_a_port_of_another_machine_is_left_alone(config: Path) -> None:
    write(config, ("dry-end", "/dev/null", "remote"))
    call = ["--live", "--json", "--config", str(config)]
    result = CliRunner().invoke(check.check, call)
    assert (result.exit_code, result.stderr) == (0, "")
    codes = {each["code"] for each in json.loads(result.stdout)["findings"]}
    assert "check_bus_remote" in codes
    assert [code for code in codes if "port" in code] == []
    assert "dialout" not in unit_of(Path("/opt/x"), config, "plant", load(config)).text


def test_each_machine_has_its_own_names_of_devices(config: Path) -> None:
    same = "/dev/ttyUSB0"
    write(config, ("a", same, "server"), ("b", same, "remote"), ("c", same, "remote"))
    assert [bus.has_local_port for bus in load(config).bus] == [True, False, False]
    write(config, ("a", "socket://10.0.0.7:4001", "server"), ("b", "socket://10.0.0.7:4001", "remote"))
    with pytest.raises(Exception, match="belongs to bus a already"):
        load(config)
