"""``lineside check --live`` beside a running server: nothing of it is touched."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from tests import fork_server
from tests.path.dashboard import dashboard
from tests.path.independent_unit import Unit


@pytest.mark.soak
def test_a_running_server_is_recognized_and_left_alone(tmp_path: Path) -> None:
    with (
        dashboard(tmp_path, [Unit(1, commanded=1000, actual=1000)], forks_workers=False) as plant,
        socket.create_server(("127.0.0.1", 0)) as device_server,
    ):
        [worker] = plant.workers()
        config = tmp_path / "checked.toml"
        second = f'[[bus]]\nname = "wet-end"\nport = "socket://127.0.0.1:{device_server.getsockname()[1]}"\n'
        config.write_text((tmp_path / "lineside.toml").read_text() + second)
        result = fork_server.run("check", "--live", "--config", config)
        assert f"{plant.url} responds: a Lineside server runs" in result.stdout, result.stderr
        assert f"held by the running worker of this bus (process {worker})" in result.stdout
        assert "wet-end: socket://" in result.stdout
        assert "was not tried: the server runs" in result.stdout
        device_server.setblocking(False)
        with pytest.raises(BlockingIOError):
            device_server.accept()
        assert plant.workers() == [worker]
        assert plant.unit(1)["link"] == "online"
