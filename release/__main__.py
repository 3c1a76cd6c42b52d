"""``python -m release [FOLDER]``: source archive, wheel, Debian package, bundle for machines without a
network, list of parts and checksums, in build/release. It needs dpkg-deb, and a network for the wheels."""

from __future__ import annotations

import gzip
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
from datetime import UTC, datetime
from hashlib import sha256
from io import BytesIO
from pathlib import Path

from hatch_version import version as version_of_files
from release.debian_tree import package_tree
from release.packages import ROOT, extras, requirements
from release.sbom import document


def main(folder: Path) -> None:
    """Fill ``folder``, which is emptied first."""
    version, seconds = version_of_files(), committed_at()
    os.environ["SOURCE_DATE_EPOCH"] = str(seconds)
    # The modes of files do not depend on who builds.
    os.umask(0o022)
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    run(Path(sys.executable).with_name("hatchling"), "build", "-t", "sdist", "-t", "wheel", "-d", folder)
    with tempfile.TemporaryDirectory() as temporary:
        work = Path(temporary)
        wheels = wheelhouse(work / "wheels", folder, version)
        bundle(folder / f"lineside-{version}-{platform_tag()}.tar.gz", wheels, version, seconds)
        debian(folder, work / "tree", wheels, version)
    made_at = datetime.fromtimestamp(seconds, UTC).isoformat().replace("+00:00", "Z")
    (folder / f"lineside-{version}.cdx.json").write_text(document(version, made_at))
    (folder / "SHA256SUMS").write_text(checksums(folder))
    print(*sorted(path.name for path in folder.iterdir()), sep="\n")


def committed_at() -> int:
    """When the commit was made, in Unix seconds: the time of every file."""
    return int(subprocess.check_output(["git", "log", "-1", "--format=%ct"], cwd=ROOT, text=True))


def wheelhouse(folder: Path, built: Path, version: str) -> Path:
    """Every package as a wheel, each with the hash of the lock, and Lineside's."""
    folder.mkdir()
    listed = folder.with_suffix(".txt")
    listed.write_text(requirements())
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet")
    run(*pip, "wheel", "--no-deps", "--require-hashes", "-r", listed, "-w", folder)
    [own] = built.glob(f"lineside-{version}-*.whl")
    shutil.copy(own, folder)
    return folder


def platform_tag() -> str:
    """Python and machine for which the wheels are, such as ``cp311-x86_64``."""
    return f"cp{sys.version_info.major}{sys.version_info.minor}-{os.uname().machine}"


def bundle(path: Path, wheels: Path, version: str, seconds: int) -> None:
    """An archive with the wheels, their checksums and ``install.sh``."""
    major, minor = map(str, sys.version_info[:2])
    script = (ROOT / "release" / "install.sh").read_text(encoding="utf-8")
    script = script.format(version=version, major=major, minor=minor, extras=",".join(extras()))
    contents = {f"wheels/{wheel.name}": wheel.read_bytes() for wheel in wheels.iterdir()}
    listed = "".join(f"{sha256(data).hexdigest()}  {name}\n" for name, data in sorted(contents.items()))
    contents |= {"SHA256SUMS": listed.encode(), "install.sh": script.encode()}
    top = path.name.removesuffix(".tar.gz")
    with (
        path.open("wb") as file,
        gzip.GzipFile("", "wb", fileobj=file, mtime=seconds) as packed,
        tarfile.open(fileobj=packed, mode="w") as archive,
    ):
        for name, data in sorted(contents.items()):
            member = tarfile.TarInfo(f"{top}/{name}")
            member.size, member.mtime = len(data), seconds
            member.mode = 0o755 if data.startswith(b"#!") else 0o644
            archive.addfile(member, BytesIO(data))


def debian(folder: Path, tree: Path, wheels: Path, version: str) -> None:
    tree.mkdir()
    architecture = package_tree(tree, wheels, version)
    package = folder / f"lineside_{version}_{architecture}.deb"
    run("dpkg-deb", "--root-owner-group", "-Zxz", "--build", tree, package)


def checksums(folder: Path) -> str:
    """In the form of sha256sum."""
    return "".join(
        f"{sha256(path.read_bytes()).hexdigest()}  {path.name}\n" for path in sorted(folder.iterdir())
    )


def run(*command: str | Path) -> None:
    subprocess.run(list(map(str, command)), cwd=ROOT, check=True, stdout=subprocess.DEVNULL)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "build" / "release")
