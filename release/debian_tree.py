"""What a Debian package unpacks: the program with its packages, the service, the rule for adapters."""

from __future__ import annotations

import platform
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from app.cli.install_service import CONFIGURATION, INSTALLED, PACKAGED_UNIT, ServiceUnit, first_configuration
from release.packages import ROOT, extras

TEMPLATES = ROOT / "release" / "debian"
SCRIPTS = ("postinst", "prerm", "postrm")
ARCHITECTURES = {"x86_64": "amd64", "aarch64": "arm64"}
PYTHON = "/usr/bin/python3"
PROGRAM = """\
#!{home}/bin/python
import sys
from app.cli import main
sys.exit(main())
"""


def package_tree(folder: Path, wheels: Path, version: str) -> str:
    """Fill ``folder`` from ``wheels``; the architecture in Debian's words."""
    architecture = ARCHITECTURES[platform.machine()]
    home = INSTALLED.parent.parent
    environment(folder / home.relative_to("/"), home, wheels, version)
    for name, text in files(version):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    program = folder / "usr" / "bin" / "lineside"
    program.parent.mkdir(parents=True)
    program.symlink_to(INSTALLED)
    control(folder / "DEBIAN", version, architecture)
    return architecture


def environment(folder: Path, home: Path, wheels: Path, version: str) -> None:
    """A virtual environment that will be at ``home``, of the Python that Debian has: pip is not in it."""
    minor = f"python{sys.version_info.major}.{sys.version_info.minor}"
    packages = folder / "lib" / minor / "site-packages"
    subprocess.run(
        [
            *(sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-index"),
            *("--find-links", str(wheels), "--target", str(packages), "--no-compile"),
            f"lineside[{','.join(extras())}]=={version}",
        ],
        check=True,
    )
    shutil.rmtree(packages / "bin", ignore_errors=True)
    (folder / "bin").mkdir()
    (folder / "bin" / "python").symlink_to(f"/usr/bin/{minor}")
    (folder / "pyvenv.cfg").write_text("home = /usr/bin\ninclude-system-site-packages = false\n")
    program = folder / "bin" / "lineside"
    program.write_text(PROGRAM.format(home=home))
    program.chmod(0o755)


def files(version: str) -> Iterator[tuple[str, str]]:
    """Path and text of each file beside the environment."""
    yield str(PACKAGED_UNIT.relative_to("/")), ServiceUnit().text
    yield "usr/lib/udev/rules.d/60-lineside.rules", template("udev.rules")
    yield "usr/share/lineside/lineside.toml", first_configuration(CONFIGURATION)
    yield "usr/share/doc/lineside/copyright", (ROOT / "LICENSE").read_text(encoding="utf-8")
    yield "usr/share/doc/lineside/version", f"{version}\n"


def control(folder: Path, version: str, architecture: str) -> None:
    folder.mkdir()
    major, minor = sys.version_info[:2]
    facts = {"version": debian_version(version), "architecture": architecture}
    facts |= {"python": f"{major}.{minor}", "next_python": f"{major}.{minor + 1}"}
    (folder / "control").write_text(template("control", **facts))
    (folder / "templates").write_text(template("templates"))
    for name in SCRIPTS:
        (folder / name).write_text(template(name))
        (folder / name).chmod(0o755)


def debian_version(version: str) -> str:
    """A development version is before the release it leads to, which Debian says with a tilde."""
    return version.replace(".dev", "~dev")


def template(name: str, **facts: str) -> str:
    return (TEMPLATES / name).read_text(encoding="utf-8").format(**facts)
