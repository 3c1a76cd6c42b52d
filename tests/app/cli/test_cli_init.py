"""``lineside init``: a file to start from, and nothing overwritten."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest
from click.testing import CliRunner

from app.cli import cli
from app.cli.accounts import with_accounts
from app.cli.install_service import first_configuration, likely_port, starter
from app.settings import load
from tests.app.cli.test_wire import line, unit

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
    monkeypatch.setattr("app.cli.init.is_interactive", lambda: True)
    monkeypatch.setattr("app.cli.init.ADDRESSES", range(1, 6))


@pytest.mark.usefixtures("at_a_terminal")
def test_at_a_terminal_it_scans_and_adds_the_first_admin(tmp_path: Path) -> None:
    config = tmp_path / "lineside.toml"
    with line(unit(2), unit(5)) as port:
        typed = (
            "Paper machine 2",
            port,
            "y",
            "Unwind",
            "",
            "anna",
            *("too short",) * 2,
            "anna",
            *(PASSWORD,) * 2,
        )
        done = CliRunner().invoke(cli, ["init", "--config", str(config)], input="\n".join(typed) + "\n")
    assert done.exit_code == 0, done.output
    assert PASSWORD not in done.output + config.read_text()
    settings = load(config)
    [bus] = settings.bus
    assert (settings.site.name, bus.port, bus.baud) == ("Paper machine 2", port, 9600)
    assert [(each.id, each.name) for each in bus.unit] == [(2, "Unwind"), (5, "Unit 5")]
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


@pytest.mark.usefixtures("at_a_terminal")
def test_it_completes_the_file_of_the_package(tmp_path: Path) -> None:
    """Port, scan, names, first admin; comments, other settings and the mode of the file stay."""
    config = tmp_path / "lineside.toml"
    shipped = first_configuration(config).replace("/var/lib/lineside/data", str(tmp_path / "data"))
    config.write_text(f'{shipped}# mine\n[shift]\nstarts = ["06:00", "18:00"]\n')
    config.chmod(0o640)
    assert load(config).bus == ()
    with line(unit(3), unit(4)) as port:
        typed = ("Paper machine 2", port, "y", "Unwind", "Nip", "anna", *(PASSWORD,) * 2)
        done = CliRunner().invoke(cli, ["init", "--config", str(config)], input="\n".join(typed) + "\n")
    assert done.exit_code == 0, done.output
    settings = load(config)
    assert (settings.site.name, settings.server.data) == ("Paper machine 2", tmp_path / "data")
    assert [(each.id, each.name) for each in settings.bus[0].unit] == [(3, "Unwind"), (4, "Nip")]
    assert (len(settings.shift.starts), config.stat().st_mode & 0o777) == (2, 0o640)
    assert "# mine\n" in config.read_text()
    assert [each.name for each in with_accounts(config, lambda accounts: accounts.users())] == ["anna"]
    again = CliRunner().invoke(cli, ["init", "--config", str(config)])
    assert (again.exit_code, "exists and is kept" in again.stderr) == (1, True)


@pytest.mark.usefixtures("at_a_terminal")
@pytest.mark.parametrize("example", [True, False])
def test_a_name_that_cannot_be_leaves_the_file_as_it_was(tmp_path: Path, example: bool) -> None:
    """Also the file of an earlier package, which had an example of a bus."""
    config = tmp_path / "lineside.toml"
    before = starter(config, "/dev/ttyUSB0") if example else first_configuration(config)
    config.write_text(before)
    typed = "\n".join(("x" * 81, "/dev/ttyUSB7", "n", ""))
    refused = CliRunner().invoke(cli, ["init", "--config", str(config)], input=typed)
    assert (refused.exit_code, config.read_text()) == (1, before)
    assert "at most 80" in refused.stderr
    typed = "\n".join(("Line 7", "/dev/ttyUSB7", "n", "", ""))
    done = CliRunner().invoke(cli, ["init", "--config", str(config)], input=typed)
    assert done.exit_code == 0, done.output
    assert (load(config).site.name, load(config).bus[0].port) == ("Line 7", "/dev/ttyUSB7")


@pytest.mark.usefixtures("at_a_terminal")
def test_the_service_is_stopped_for_the_scan_and_runs_with_what_was_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config, unit_file = tmp_path / "lineside.toml", tmp_path / "lineside.service"
    config.write_text(first_configuration(config))
    unit_file.touch()
    called: list[tuple[str, int]] = []

    def run(command: Sequence[str]) -> None:
        called.append((" ".join(command), len(load(config).bus)))

    monkeypatch.setattr("app.cli.init.CONFIGURATION", config)
    monkeypatch.setattr("app.cli.init.UNIT_FILE", unit_file)
    monkeypatch.setattr("app.cli.install_service.BOOTED", tmp_path)
    monkeypatch.setattr("app.cli.install_service.run", run)
    monkeypatch.setattr("app.cli.init.geteuid", lambda: 1000)
    words = ["init", "--config", str(config)]
    refused = CliRunner().invoke(cli, words, input="\n")
    assert (refused.exit_code, called) == (1, [])
    assert "sudo lineside init" in refused.stderr
    monkeypatch.setattr("app.cli.init.geteuid", lambda: 0)
    done = CliRunner().invoke(cli, words, input="\n/dev/no-such-port\nn\n\n")
    assert done.exit_code == 0, done.output
    assert called == [("systemctl stop lineside.service", 0), ("systemctl restart lineside.service", 1)]
    assert "The service lineside runs with it." in done.stdout
