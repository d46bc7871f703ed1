"""Every experiment runs with --quick, and writes a figure and what it was run on."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
FAST = "brdf_readings", "fit_albedo"
"""What runs wherever tests run; all others are slow."""

WITHOUT_FIGURE = "fuzz", "hard_cases"


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(run.parent.name, marks=() if run.parent.name in FAST else pytest.mark.slow)
        for run in sorted((ROOT / "experiments").glob("*/run.py"))
    ],
)
def test_quick(name, tmp_path):
    """In a copy, for results that are there already may be of the full mode."""
    shutil.copytree(ROOT / "experiments", tmp_path / "experiments", ignore=shutil.ignore_patterns("results"))
    for shared in ("scenes", "tests"):
        (tmp_path / shared).symlink_to(ROOT / shared)
    done = subprocess.run(
        [sys.executable, tmp_path / "experiments" / name / "run.py", "--quick"],
        env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()
    results = tmp_path / "experiments" / name / "results"
    assert name in WITHOUT_FIGURE or list(results.glob("*.png"))
    told = [json.loads(file.read_text()) for file in results.glob("*.json")]
    assert any({"cpu", "cores", "python", "jax", "jaxrt", "seed"} <= set(one) for one in told)
