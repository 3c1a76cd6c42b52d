"""The dashboard of Grafana and the rules of Prometheus in docs/deploy read metrics that there are."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from docs.generated import metric_names

DEPLOY = Path(__file__).resolve().parent.parent / "docs" / "deploy"
PROMETHEUS, DASHBOARD = DEPLOY / "prometheus", DEPLOY / "grafana" / "lineside.json"
READ = re.compile(r"\b(?:lineside|process)_[a-z_]+\b")
OF_PROCESS = {"process_resident_memory_bytes", "process_cpu_seconds_total"}


@pytest.mark.parametrize("file", [DASHBOARD, PROMETHEUS / "lineside.rules.yml"], ids=lambda file: file.name)
def test_every_metric_that_is_read_exists(file: Path) -> None:
    read = set(READ.findall(file.read_text(encoding="utf-8")))
    assert read - metric_names() - OF_PROCESS == set()
    assert len(read) > 8


@pytest.fixture(scope="module")
def promtool(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of Debian's package of Prometheus, unpacked and not installed."""
    folder = tmp_path_factory.mktemp("prometheus")
    apt = shutil.which("apt-get")
    if (
        apt is None
        or subprocess.run([apt, "download", "prometheus"], cwd=folder, capture_output=True).returncode
    ):
        pytest.skip("Debian's package prometheus cannot be downloaded")
    [package] = folder.glob("*.deb")
    subprocess.run(["dpkg-deb", "-x", package, folder], check=True)
    return folder / "usr" / "bin" / "promtool"


@pytest.mark.soak
@pytest.mark.parametrize(
    "words", [("check", "rules", "lineside.rules.yml"), ("test", "rules", "lineside.rules.test.yml")]
)
def test_the_rules_are_accepted_and_alert_when_they_should(promtool: Path, words: tuple[str, ...]) -> None:
    done = subprocess.run([promtool, *words], cwd=PROMETHEUS, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
