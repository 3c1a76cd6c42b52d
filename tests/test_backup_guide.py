"""The commands of docs/guide/backup.md, typed as they are written, below a folder instead of the root."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

from app.system.configuration.document import ConfigurationVersion, StoredVersion, VersionStore
from bus.instants import UnixTime
from tests import fork_server
from tests.test_architecture import ROOT, text_of

LINESIDE = Path(sys.executable).with_name("lineside")
CHAPTERS = {
    title: re.findall(r"```sh\n(.*?)```", text, re.S)
    for title, text in re.findall(
        r"^## (.*?)\n(.*?)(?=^## |\Z)", text_of(ROOT / "docs" / "guide" / "backup.md"), re.M | re.S
    )
}
FOLDERS = ("/etc/lineside", "/var/lib/lineside", "/var/backups", "/mnt/backup", "/root/back")
OF_THIS_MACHINE = ("systemctl", "chown", "install-service")
"""What a test cannot call: the service, and its user."""


def test_a_backup_is_made_and_restored_as_the_guide_says(tmp_path: Path) -> None:
    """Every folder that is written to is made before, by the guide or by the installation."""
    for folder in ("etc/lineside", "var/lib/lineside", "root", "mnt", "var/backups"):
        (tmp_path / folder).mkdir(parents=True)
    key = tmp_path / "backup.key"
    key.write_text("0123456789abcdef" * 4)
    key.chmod(0o600)
    config = tmp_path / "etc/lineside/lineside.toml"
    config.write_text(f'[server]\ndata = "{tmp_path}/var/lib/lineside/data"\n[backup]\nkey_file = "{key}"\n')
    made = fork_server.run("token", "create", "plc", "--role", "viewer", "--config", config)
    assert made.returncode == 0, made.stderr
    # The server makes it at its first start.
    versions = VersionStore(tmp_path / "var/lib/lineside/data")
    versions.add(StoredVersion(ConfigurationVersion(1, UnixTime(0.0), "found", "0"), config.read_text()))
    typed(tmp_path, "Back up")
    assert (tmp_path / "var/backups/lineside/monday.tar").is_file()
    assert (tmp_path / "mnt/backup/lineside").is_dir()
    (tmp_path / "monday.tar").write_bytes((tmp_path / "var/backups/lineside/monday.tar").read_bytes())
    config_text = config.read_text()
    asked = typed(tmp_path, "Restore")
    assert "Replace the stores" in asked
    assert config.read_text() == config_text
    assert (tmp_path / "var/lib/lineside/data/lineside.db.before-restore").is_file()


def typed(root: Path, chapter: str) -> str:
    """Type the commands of a chapter, and confirm; return what they print."""
    printed = ""
    for line in (line for block in CHAPTERS[chapter] for line in block.splitlines()):
        for command in line.split(" && "):
            words = shlex.split(
                below(root, re.sub(r"^sudo (-u lineside )?|-o lineside -g lineside ", "", command))
            )
            if not any(word in command for word in OF_THIS_MACHINE):
                done = run(words, root, "y\n")
                assert done.returncode == 0, f"{command}: {done.stderr}"
                printed += done.stdout
    return printed


def run(words: list[str], folder: Path, text: str) -> subprocess.CompletedProcess[str]:
    """Run a command with ``text`` on its standard input; ``lineside`` from the fork server."""
    if words[0] == str(LINESIDE):
        return fork_server.run(*words[1:], cwd=folder, text=text)
    return subprocess.run(words, cwd=folder, input=text, capture_output=True, text=True, check=False)


def below(root: Path, command: str) -> str:
    """The command with the program of this tree and the folders below ``root``."""
    command = command.replace("/opt/lineside/bin/lineside", str(LINESIDE))
    # The backup holds each file under its whole path.
    command = re.sub(r"/root/back/(etc|var)", rf"{root}/root/back{root}/\1", command)
    command = re.sub(r" (/etc/|/var/lib/)(?= |$)", rf" {root}\1", command)
    for folder in FOLDERS:
        command = re.sub(rf"(?<![\w/]){folder}", f"{root}{folder}", command)
    return command
