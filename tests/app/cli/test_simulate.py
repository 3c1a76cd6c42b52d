"""Every dialect of the manual's open points: simulated by ``simulate``, detected by ``scan``."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from click.testing import CliRunner

from app.cli import wire as scan
from tests import fork_server

PATIENCE_MS = 400
"""On a busy machine the simulated unit may have to wait its turn."""

cli = scan.scan


@contextmanager
def simulated(*options: str) -> Iterator[str]:
    """One unit played by the command; the port to open."""
    called = ("simulate", "--units", "1", "--no-script", *options)
    process = fork_server.start(*called, stdout=subprocess.PIPE)
    assert process.stdout is not None
    with process.stdout as output:
        try:
            yield output.readline().strip()
        finally:
            process.terminate()
            process.wait()


def scanned(*dialect: str, patience_ms: int = PATIENCE_MS) -> dict[str, Any]:
    """The JSON form of a scan of that unit."""
    with simulated(*dialect) as port:
        arguments = f"--port {port} --baud 9600 --last 1 --turnaround-ms {patience_ms} --json"
        result = CliRunner().invoke(cli, arguments.split())
    assert result.exit_code == 0, result.output
    response: dict[str, Any] = json.loads(result.stdout)
    assert [one["kind"] for one in response["units"]] == ["digimax"]
    return response


def test_as_the_manual_reads() -> None:
    response = scanned()
    assert response["settings"] == {
        "checksum_10h": "once",
        "parameter_numbers": "binary",
        "parameter_reply_bytes": 0,
        "estop_healthy": 1,
        "turnaround_ms": PATIENCE_MS,
    }
    (unit,) = response["units"]
    assert unit["parameter_reply_bytes"] == [1, 2, 4], "as wide as each type"
    assert (unit["parameters"], unit["remarks"]) == (list(range(1, 41)), [])


def test_one_that_decides_everything_otherwise() -> None:
    otherwise = {"checksum_10h": "twice", "parameter_numbers": "bcd", "estop_healthy": 0}
    options = [f"--{key.replace('_', '-')}={value}" for key, value in otherwise.items()]
    response = scanned(*options, "--parameter-reply-bytes", "2", "--last-parameter", "20")
    (unit,) = response["units"]
    for key, value in otherwise.items():
        assert response["settings"][key] == value
        assert any(f"set {key} = {json.dumps(value)}" in remark for remark in unit["remarks"])
    assert (unit["parameter_reply_bytes"], response["settings"]["parameter_reply_bytes"]) == ([2], 2)
    assert unit["parameters"] == list(range(1, 21))


def test_a_unit_that_is_slower_than_it_is_allowed() -> None:
    """Its responses arrive in the windows of later requests, and must not be taken for theirs."""
    response = scanned("--turnaround-ms", "140", patience_ms=100)
    assert response["settings"]["turnaround_ms"] > 100
    assert response["units"][0]["turnaround_ms"] > 100
    assert response["units"][0]["remarks"] == []
    assert "set turnaround_ms = " in response["remarks"][0]


def test_an_impossible_call_prints_one_line() -> None:
    assert CliRunner().invoke(scan.simulate, ["--checksum-10h", "thrice"]).exit_code == 2
    done = fork_server.run("simulate", "--link", "/nonexistent/line")  # it would block signals here
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert done.stderr.startswith("lineside: the link /nonexistent/line cannot be made")
