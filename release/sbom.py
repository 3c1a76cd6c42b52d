"""The parts of a release as a CycloneDX 1.6 document (ECMA-424)."""

from __future__ import annotations

import json
from importlib.metadata import metadata
from pathlib import Path
from typing import Any
from uuid import NAMESPACE_URL, uuid5

from release.packages import ROOT, extras, locked, needed

SENT_TO_BROWSERS = ("htmx.org", "uplot")


def document(version: str, made_at: str) -> str:
    """``made_at``: ISO 8601. The same commit gives the same text."""
    own = {"type": "application", "name": "lineside", "version": version, "licenses": _license("MIT")}
    parts = [*map(_of_python, sorted(needed(*extras()))), *map(_of_browsers, SENT_TO_BROWSERS)]
    made = {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "serialNumber": f"urn:uuid:{uuid5(NAMESPACE_URL, f'lineside {version}')}",
        "version": 1,
        "metadata": {"timestamp": made_at, "component": {**own, "bom-ref": f"pkg:pypi/lineside@{version}"}},
        "components": parts,
    }
    return json.dumps(made, indent=1) + "\n"


def _of_python(name: str) -> dict[str, Any]:
    version, _ = locked()[name]
    about = metadata(name)
    licence = about["License-Expression"] or (about["License"] or "").split("\n")[0]
    return _library(name, version, f"pkg:pypi/{name}@{version}", licence)


def _of_browsers(name: str, lock: Path = ROOT / "package-lock.json") -> dict[str, Any]:
    about = json.loads(lock.read_text(encoding="utf-8"))["packages"][f"node_modules/{name}"]
    return _library(name, about["version"], f"pkg:npm/{name}@{about['version']}", about.get("license", ""))


def _library(name: str, version: str, purl: str, licence: str) -> dict[str, Any]:
    part = {"type": "library", "bom-ref": purl, "name": name, "version": version, "purl": purl}
    return {**part, "licenses": _license(licence)} if licence else part


def _license(name: str) -> list[dict[str, Any]]:
    return [{"license": {"name": name}}]
