"""The fuzzer for a bounded time; longer by hand: ``python tests/fuzz/fuzz_wire.py -max_total_time=600``."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parent.parent


def test_the_wire_under_the_fuzzer(tmp_path: Path) -> None:
    corpus = tmp_path / "corpus"
    corpus.mkdir()
    for name in ("frames", "streams"):
        for number, vector in enumerate(json.loads((ROOT / "tests/vectors" / f"{name}.json").read_text())):
            data = bytes.fromhex(vector.get("frame") or vector["stream"])
            (corpus / f"{name}-{number}").write_bytes(bytes((number % 256,)) + data)
    finished = subprocess.run(
        [
            sys.executable,
            str(HERE / "fuzz_wire.py"),
            "-seed=1",
            "-runs=1500",
            "-max_len=120",
            "-max_total_time=20",
            f"-artifact_prefix={tmp_path}/",
            str(corpus),
        ],
        capture_output=True,
        text=True,
        timeout=120,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert finished.returncode == 0, finished.stderr[-4000:]
    assert "Done " in finished.stderr
