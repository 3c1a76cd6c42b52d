"""``lineside home`` where one server has the store in files; tests/path has two servers on PostgreSQL."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from app.cli import cli
from app.main import create_app
from app.settings import load

TOML = """\
[server]
id = "app-1"
home = ["a"]
[[bus]]
name = "a"
port = "socket://127.0.0.1:9"
[[bus]]
name = "b"
port = "/dev/null"
"""


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "lineside.toml"
    path.write_text(TOML)
    return path


def run_server(config: Path) -> None:
    async def run() -> None:
        async with create_app(load(config)).state.services.lifespan.running():
            pass

    asyncio.run(run())


def test_before_the_first_start_no_bus_has_a_home_and_no_store_is_made(config: Path) -> None:
    shown = CliRunner().invoke(cli, ["home", "--config", str(config)])
    assert (shown.exit_code, shown.stdout) == (0, "a: no home yet\nb: no home yet\n")
    assert not (config.parent / "data").exists()


def test_a_server_alone_is_the_home_of_every_bus_with_an_epoch_more_at_each_start(config: Path) -> None:
    for epoch in (1, 2):
        run_server(config)
        shown = CliRunner().invoke(cli, ["home", "--json", "--config", str(config)])
        homes = json.loads(shown.stdout)["homes"]
        assert [(each["bus"], each["server"], each["epoch"], each["until"]) for each in homes] == [
            ("a", "app-1", epoch, None),
            ("b", "app-1", epoch, None),
        ]
    shown = CliRunner().invoke(cli, ["home", "--config", str(config)])
    assert shown.stdout.splitlines()[0] == "a: app-1, epoch 2"


@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        (("take", "a", "--reason", "x"), 0, "the stores are files of this server"),
        (
            ("take", "b", "--reason", "x"),
            2,
            "app-1 may not be the home of b",
        ),
        (("take", "c", "--reason", "x"), 2, "there is no bus c; this configuration has a, b"),
        (("take", "a", "--reason", " "), 2, "give a reason: it is in the event"),
        (("take", "a"), 2, "--reason"),
    ],
)
def test_a_bus_that_is_never_taken_is_refused_in_words(
    config: Path, words: tuple[str, ...], code: int, text: str
) -> None:
    done = CliRunner().invoke(cli, ["home", *words, "--config", str(config)])
    assert done.exit_code == code
    assert text in done.stdout + done.stderr
