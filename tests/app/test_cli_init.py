"""``lineside init``: a file to start from, and nothing overwritten."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from app.cli import cli
from app.cli.setup.accounts import with_accounts
from app.cli.setup.init import likely_port, starter
from app.settings import load
from tests.app.test_cli_scan import line, unit

PASSWORD = "collect house bakery stable"


def test_what_it_writes_passes_the_check(tmp_path: Path) -> None:
    config = str(tmp_path / "lineside.toml")
    written = CliRunner().invoke(cli, ["init", "--config", config])
    assert (written.exit_code, written.stderr) == (0, "")
    assert f"lineside check --config {config}" in written.stdout
    settings = load(Path(config))
    assert [(bus.name, [unit.id for unit in bus.unit]) for bus in settings.bus] == [("line-1", [1])]


def test_every_line_that_it_comments_out_is_good(tmp_path: Path) -> None:
    """Without the marks of comment before keys and tables, it is still a configuration."""
    config = tmp_path / "lineside.toml"
    lines = starter(config, "/dev/ttyUSB0").splitlines()
    config.write_text(
        "\n".join(line.removeprefix("# ") if is_commented_out(line) else line for line in lines)
    )
    settings = load(config)
    assert settings.site.time_zone == "Europe/Berlin"
    assert [unit.group for unit in settings.bus[0].unit] == ["", "Calender"]


def is_commented_out(line: str) -> bool:
    return line.startswith("# [") or (line.startswith("# ") and " = " in line)


def test_an_existing_file_is_kept(tmp_path: Path) -> None:
    config = tmp_path / "lineside.toml"
    config.write_text("mine")
    refused = CliRunner().invoke(cli, ["init", "--config", str(config)])
    assert (refused.exit_code, refused.stdout, config.read_text()) == (1, "", "mine")
    assert f"lineside: {config} exists and is kept." in refused.stderr


def test_a_folder_that_is_not_there(tmp_path: Path) -> None:
    refused = CliRunner().invoke(cli, ["init", "--config", str(tmp_path / "no" / "lineside.toml")])
    assert refused.exit_code == 1
    assert "cannot be written: No such file or directory. Create its folder" in refused.stderr


def test_it_takes_the_adapter_that_is_plugged_in(tmp_path: Path) -> None:
    assert likely_port(tmp_path / "absent") == "/dev/ttyUSB0"
    name = "usb-FTDI\\x20Cable-if00-port0"
    (tmp_path / name).touch()
    (tmp_path / "usb-Other-if00").touch()
    port = likely_port(tmp_path)
    assert port == str(tmp_path / name)
    config = tmp_path / "lineside.toml"
    config.write_text(starter(config, port))
    assert load(config).bus[0].port == port


@pytest.fixture
def at_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    """Prompts are read from the input of the runner."""
    monkeypatch.setattr("app.cli.setup.init.is_interactive", lambda: True)
    monkeypatch.setattr("app.cli.setup.init.ADDRESSES", range(1, 6))


@pytest.mark.usefixtures("at_a_terminal")
def test_at_a_terminal_it_scans_and_adds_the_first_admin(tmp_path: Path) -> None:
    config = tmp_path / "lineside.toml"
    with line(unit(2), unit(5)) as port:
        typed = ("Paper machine 2", port, "y", "anna", *("too short",) * 2, "anna", *(PASSWORD,) * 2)
        done = CliRunner().invoke(cli, ["init", "--config", str(config)], input="\n".join(typed) + "\n")
    assert done.exit_code == 0, done.output
    assert PASSWORD not in done.output + config.read_text()
    settings = load(config)
    [bus] = settings.bus
    assert (settings.site.name, bus.port, bus.baud) == ("Paper machine 2", port, 9600)
    assert [each.id for each in bus.unit] == [2, 5]
    assert [each.name for each in with_accounts(config, lambda accounts: accounts.users())] == ["anna"]


@pytest.mark.usefixtures("at_a_terminal")
def test_a_port_that_is_not_there_leaves_a_configuration_to_change(tmp_path: Path) -> None:
    config = tmp_path / "lineside.toml"
    typed = "\n/dev/no-such-port\ny\n\n"
    done = CliRunner().invoke(cli, ["init", "--config", str(config)], input=typed)
    assert done.exit_code == 0, done.output
    assert "/dev/no-such-port does not exist" in done.stderr
    assert [each.id for each in load(config).bus[0].unit] == [1]
    assert not (tmp_path / "data").exists()
