"""``make release`` builds the same bytes twice, and they install on machines that have nothing of ours."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
from collections.abc import Iterator
from importlib.metadata import distribution
from pathlib import Path
from zipfile import ZipFile

import pytest

from app.version import VERSION
from release.__main__ import bundle, main
from release.debian_tree import debian_version, files, template
from release.packages import extras, locked, needed, requirements
from release.sbom import document
from tests.booted_machine import Machine, booted
from tests.test_architecture import ROOT

MAX_PACKAGES, MAX_MB = 38, 100.0
FIRST_PAGE_S, AGAIN_S = 60.0, 30.0
PAGE = "http://127.0.0.1:8000/healthz"
BUS = """
[[bus]]
name = "line-1"
port = "/dev/ttyUSB0"
[[bus.unit]]
id = 1
name = "Unwind"
"""
SERVER = "systemctl show -p MainPID --value lineside"
RESTART = """
import json, sys, time, urllib.request
def call(path, body=None):
    headers = {"Authorization": f"Bearer {sys.argv[1]}", "Content-Type": "application/json"}
    data = None if body is None else json.dumps(body).encode()
    address = f"http://127.0.0.1:8000/api/v1/configuration{path}"
    return urllib.request.urlopen(urllib.request.Request(address, data, headers), timeout=5).read()
present = json.loads(call(""))
assert not present["running"]
call("/restart", {"digest": present["digest"]})
end = time.monotonic() + float(sys.argv[2])
while time.monotonic() < end:
    time.sleep(0.2)
    try:
        if json.loads(call(""))["running"]:
            sys.exit(0)
    except OSError:
        pass
sys.exit("not restarted")
"""


def test_an_installation_is_light() -> None:
    """With Lineside itself, without what Python compiles."""
    packages = {*needed(), "lineside"}
    assert "psycopg" not in packages
    assert len(packages) <= MAX_PACKAGES
    size = sum((file.size or 0) for name in packages for file in distribution(name).files or ())
    assert size <= MAX_MB * 1e6


def test_each_package_that_runs_has_its_version_and_hash() -> None:
    lines = requirements().splitlines()
    named = {line.partition("==")[0] for line in lines if not line.startswith(" ")}
    assert named == needed(*extras()) | {"pip"}
    assert {"authlib", "pyarrow", "serialx"} <= named, "no extra can be added where there is no network"
    assert all(
        line.endswith("\\") != line.lstrip().startswith("--hash") or "--hash" in line for line in lines
    )
    assert "hatchling" in locked()
    assert "hatchling" not in named


def test_the_list_of_parts_names_each_with_its_version() -> None:
    parts = json.loads(document(VERSION, "2026-11-26T00:00:00Z"))["components"]
    assert {part["name"] for part in parts} == {*needed(*extras()), "htmx.org", "uplot"}
    assert all(part["purl"].endswith(f"@{part['version']}") for part in parts)


def test_a_package_of_debian_holds_the_service_and_a_configuration() -> None:
    made = dict(files(VERSION))
    assert "ExecStart=/opt/lineside/bin/lineside serve" in made["usr/lib/systemd/system/lineside.service"]
    shipped = tomllib.loads(made["usr/share/lineside/lineside.toml"])
    assert (shipped["server"]["data"], "bus" in shipped) == ("/var/lib/lineside/data", False)
    assert debian_version("1.4.1.dev7+gabc") == "1.4.1~dev7+gabc"


@pytest.mark.soak
def test_the_bundle_installs_where_python_cannot_make_pip(tmp_path: Path) -> None:
    """Debian's Python has no ``ensurepip`` without python3-venv. The bundle is small: a pip, and a stub."""
    wheels = tmp_path / "wheels"
    wheels.mkdir()
    pip = distribution("pip")
    with ZipFile(wheels / f"pip-{pip.version}-py3-none-any.whl", "w") as wheel:
        for file in pip.files or ():
            if file.suffix != ".pyc" and ".." not in file.parts:
                wheel.write(str(file.locate()), str(file))
    stub_wheel(wheels, "1.0")
    bundle(tmp_path / "lineside.tar.gz", wheels, "1.0", 0)
    python = python_without_ensurepip(tmp_path / "python")
    lacking = subprocess.run([python, "-c", "import ensurepip"], capture_output=True, text=True, check=False)
    assert "No module named 'ensurepip'" in lacking.stderr
    with tarfile.open(tmp_path / "lineside.tar.gz") as archive:
        archive.extractall(tmp_path, filter="data")
    script, folder = tmp_path / "lineside" / "install.sh", tmp_path / "installed here"
    environment = os.environ | {"PYTHON": str(python), "PIP_NO_COMPILE": "1"}
    done = subprocess.run(
        ["sh", script, folder], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"{folder}/bin/lineside install-service" in done.stdout
    assert subprocess.check_output([folder / "bin" / "lineside"], text=True) == "a stub\n"
    assert (folder / "bin" / "pip").exists(), "an upgrade is a wheel that pip installs"


def python_without_ensurepip(folder: Path) -> Path:
    """Make a copy of this Python's program beside all of its library but ``ensurepip``, as Debian has it."""
    library = Path(sysconfig.get_path("stdlib"))
    own = folder / "lib" / library.name
    own.mkdir(parents=True)
    for entry in library.iterdir():
        if entry.name not in ("ensurepip", "site-packages", "dist-packages"):
            (own / entry.name).symlink_to(entry)
    (folder / "bin").mkdir()
    program = f"python{sys.version_info.major}.{sys.version_info.minor}"
    shutil.copy(Path(sys.base_prefix) / "bin" / program, folder / "bin")
    return folder / "bin" / program


def stub_wheel(folder: Path, version: str) -> None:
    """Make a wheel of Lineside's name, extras and command."""
    about = f"lineside-{version}.dist-info"
    metadata = ["Metadata-Version: 2.1", "Name: lineside", f"Version: {version}"]
    members = {
        "stub.py": 'def main():\n    print("a stub")\n',
        f"{about}/METADATA": "\n".join((*metadata, *(f"Provides-Extra: {name}" for name in extras()), "")),
        f"{about}/WHEEL": "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
        f"{about}/entry_points.txt": "[console_scripts]\nlineside = stub:main\n",
    }
    listed = "".join(f"{name},,\n" for name in (*members, f"{about}/RECORD"))
    with ZipFile(folder / f"lineside-{version}-py3-none-any.whl", "w") as wheel:
        for name, text in (members | {f"{about}/RECORD": listed}).items():
            wheel.writestr(name, text)


def test_its_scripts_are_of_a_shell() -> None:
    install = (ROOT / "release" / "install.sh").read_text(encoding="utf-8")
    for script in (*map(template, ("postinst", "prerm", "postrm")), install):
        subprocess.run(["sh", "-n"], input=script, text=True, check=True)


@pytest.fixture(scope="module")
def release(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("release") / "first"
    main(folder)
    return folder


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machine]:
    with booted(tmp_path_factory.mktemp("debian")) as made:
        yield made


@pytest.mark.soak
def test_twice_the_same_bytes(release: Path, tmp_path: Path) -> None:
    main(tmp_path / "again")
    assert (tmp_path / "again" / "SHA256SUMS").read_text() == (release / "SHA256SUMS").read_text()
    subprocess.run(["sha256sum", "--quiet", "--check", "SHA256SUMS"], cwd=release, check=True)


@pytest.mark.soak
def test_the_bundle_installs_without_a_network(release: Path, machine: Machine) -> None:
    [bundle] = release.glob("lineside-*-cp*.tar.gz")
    there = machine.put(bundle)
    machine.run(f"cd /root && tar xzf {there} && sh lineside-*-cp*/install.sh /srv/lineside")
    machine.run("systemd-run --unit=try /srv/lineside/bin/lineside demo --port 8100")
    machine.wait_for("http://127.0.0.1:8100/healthz", FIRST_PAGE_S)
    machine.run("systemctl stop try; rm -rf /srv/lineside /root/lineside-*-cp*")


@pytest.mark.soak
def test_the_package_is_installed_lives_through_faults_and_is_removed(
    release: Path, machine: Machine
) -> None:
    [package] = release.glob("*.deb")
    there = machine.put(package)
    told = machine.run(f"dpkg -i {there} 2>&1")
    assert "http://127.0.0.1:8000/setup with the code " in told
    assert "sudo journalctl -u lineside" in told
    machine.wait_for(PAGE, FIRST_PAGE_S)
    machine.run(f"cat >> /etc/lineside/lineside.toml <<'END'\n{BUS}END\nsystemctl restart lineside")
    machine.wait_for(PAGE, AGAIN_S)
    assert machine.run("lineside --version") == f"lineside {package.name.split('_')[1]}"
    assert "read-only" not in machine.run("journalctl -u lineside -o cat").lower()

    former = machine.run(SERVER)
    machine.run(
        f"kill -STOP {former}; for i in $(seq {AGAIN_S:.0f}); do "
        f"[ $({SERVER}) != {former} ] && exit 0; sleep 1; done; exit 1"
    )
    machine.wait_for(PAGE, AGAIN_S)
    worker = machine.run("pgrep -f -- '--bus line-1'")
    machine.run(
        f"kill -STOP {worker}; for i in $(seq {AGAIN_S:.0f}); do "
        f"pgrep -f -- '--bus line-1' | grep -qvx {worker} && exit 0; sleep 1; done; exit 1"
    )

    # A person restarts it from the page of the configuration: systemd watches the same process.
    machine.wait_for(PAGE, AGAIN_S)
    server, token = machine.run(SERVER), machine.run("lineside token create admin --role admin").split()[-1]
    machine.run("sed -i 's/My line/Our line/' /etc/lineside/lineside.toml")
    (machine.root / "root" / "restart.py").write_text(RESTART, "utf-8")
    machine.run(f"python3 /root/restart.py {token} {AGAIN_S}")
    machine.run("sleep 2; systemctl is-active lineside")
    assert machine.run(SERVER) == server

    machine.run("echo '[server' >> /etc/lineside/lineside.toml; systemctl restart lineside || true; sleep 5")
    assert machine.run("systemctl show -p NRestarts --value lineside") == "0"
    assert "lineside.toml" in machine.run("journalctl -u lineside -o cat -n 20")
    machine.run("sed -i '$d' /etc/lineside/lineside.toml; systemctl reset-failed lineside")

    machine.run(f"echo '# mine' >> /etc/lineside/lineside.toml; dpkg -i {there}")
    machine.wait_for(PAGE, AGAIN_S)
    assert machine.run("tail -1 /etc/lineside/lineside.toml") == "# mine"
    machine.run("dpkg -r lineside; test -e /var/lib/lineside/data/lineside.db; test ! -e /opt/lineside")
    machine.run("dpkg -P lineside; test -e /etc/lineside/lineside.toml; getent passwd lineside")
    machine.run(
        f"dpkg -i {there}; echo lineside lineside/remove-records boolean true | debconf-set-selections"
    )
    machine.run("dpkg -P lineside; test ! -e /etc/lineside; ! getent passwd lineside")
    assert shutil.which("lineside", path=str(machine.root / "usr/bin")) is None
    assert sys.version_info[:2] == (3, 11), "of the Python of this Debian"
