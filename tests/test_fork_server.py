"""A forked process is what a started one is: it gets the same and gives the same."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

from tests import fork_server

LINESIDE = Path(sys.executable).with_name("lineside")


def test_it_prints_and_returns_what_a_started_process_does(tmp_path: Path) -> None:
    words = ("serve", "--config", "absent.toml")
    environment = {**os.environ, "COLUMNS": "60"}
    begun = subprocess.run(
        [LINESIDE, *words], capture_output=True, text=True, cwd=tmp_path, env=environment, input=""
    )
    forked = fork_server.run(*words, cwd=tmp_path, env=environment)
    assert (forked.returncode, forked.stdout, forked.stderr) == (begun.returncode, begun.stdout, begun.stderr)


def test_it_gets_its_input_environment_folder_and_umask(tmp_path: Path) -> None:
    (tmp_path / "lineside.toml").write_text('[server]\ndata = "./kept"\n')
    options: dict[str, Any] = {"cwd": tmp_path, "umask": 0o077, "env": {**os.environ, "LOGNAME": "carl"}}
    add = ("user", "add", "ann", "--role", "admin", "--password-stdin")
    added = fork_server.run(*add, text="correct horse battery\n", **options)
    assert (added.returncode, added.stderr) == (0, "")
    assert "ann" in fork_server.run("user", "list", **options).stdout
    worker = fork_server.run(
        *("--config", "absent.toml", "--bus", "b", "--app", "http://127.0.0.1:1"),
        program="bus",
        cwd=tmp_path,
        env={"LINESIDE_WORKER_TOKEN": "t"},
    )
    assert worker.returncode == 2
    assert "absent.toml" in worker.stderr


def test_it_has_no_file_of_the_tests_or_of_another_process(tmp_path: Path) -> None:
    with (tmp_path / "log").open("wb") as log:
        first = fork_server.start("simulate", "--units", "1", stdout=log)
        second = fork_server.start("simulate", "--units", "1", stdout=subprocess.PIPE)
        assert second.stdout is not None
        with second.stdout as output:
            assert output.readline()
            opened = {str(path.readlink()) for path in Path(f"/proc/{second.pid}/fd").iterdir()}
            assert str(tmp_path / "log") not in opened
            for process in (first, second):
                process.kill()
                assert process.wait() == -signal.SIGKILL
