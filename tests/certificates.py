"""Certificates for tests, made by ``lineside certificate`` and its authority, once for all of them."""

from __future__ import annotations

import atexit
import shutil
import subprocess
import time
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import pytest

from app.cli import certificate
from app.cli.certificate import CertificateAuthority

DAY_S = 86_400
LOCAL = ("localhost", "127.0.0.1")


def certificates(folder: Path) -> Path:
    """Copy them to a folder: ``ca``, ``server`` and ``worker``, the same of an authority ``other``, and
    ``expired`` and ``misnamed`` of a server, each ``.pem`` and ``.key``."""
    shutil.copytree(_made(), folder, dirs_exist_ok=True)
    return folder


@cache
def _made() -> Path:
    folder = Path(mkdtemp(prefix="lineside-certificates-"))
    atexit.register(shutil.rmtree, folder)
    site = CertificateAuthority(folder, "Mill 7")
    site.issue(*_pair(folder, "server"), "server", "plant", LOCAL)
    site.issue(*_pair(folder, "misnamed"), "server", "plant", ["elsewhere.example"])
    site.issue(*_pair(folder, "worker"), "worker", "dry-end")
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(certificate, "unix_now", lambda: time.time() - (certificate.DAYS + 1) * DAY_S)
        site.issue(*_pair(folder, "expired"), "server", "plant", LOCAL)
        site.issue(*_pair(folder, "worker-expired"), "worker", "dry-end")
    other = CertificateAuthority(folder / "other", "Elsewhere")
    other.issue(*_pair(folder / "other", "server"), "server", "plant", LOCAL)
    other.issue(*_pair(folder / "other", "worker"), "worker", "dry-end")
    return folder


def renew(folder: Path, name: str = "server") -> None:
    """The same certificate again, signed now: its serial number differs."""
    CertificateAuthority(folder, "Mill 7").issue(*_pair(folder, name), "server", "plant", LOCAL)


def subject_of(pem: Path) -> str:
    """What openssl reads in a certificate."""
    shown = subprocess.run(
        ["openssl", "x509", "-in", str(pem), "-noout", "-text"], check=True, capture_output=True, text=True
    )
    return shown.stdout


def _pair(folder: Path, name: str) -> tuple[Path, Path]:
    return folder / f"{name}.pem", folder / f"{name}.key"
