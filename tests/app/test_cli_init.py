"""``lineside init``: a file to start from, and nothing overwritten."""

from __future__ import annotations

from pathlib import Path

from click.testing import CliRunner

from app.cli import cli
from app.cli.init import likely_port, starter
from app.settings import load


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
