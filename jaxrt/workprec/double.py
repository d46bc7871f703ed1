"""Rows in float64: in a process of its own, for JAX's precision is that of a process.

python -m jaxrt.workprec.double JOB    (a pickle of the stage's file and reference; rows come back in its place)
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from .curve import Row
from .stage import Stage, stage_with
from .stage import samples as named


def double_rows(stage: Stage, samples: Sequence[int]) -> list[Row]:
    """Pictures of the path method in float64 by numbers of samples. Raises `RuntimeError` if the process fails."""
    from ..compiler import folder

    width, height, *_ = stage.scene.structure.sensors[0].film
    job = {
        "file": stage.file, "defaults": stage.defaults, "size": (width, height), "seed": stage.seed,
        "reference": stage.reference, "samples": list(samples), "folder": folder,
    }  # fmt: skip
    with tempfile.TemporaryDirectory() as there:
        file = Path(there) / "job"
        file.write_bytes(pickle.dumps(job))
        path = os.pathsep.join([str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", "")])
        env = os.environ | {"JAX_ENABLE_X64": "1", "PYTHONPATH": path}
        command = [sys.executable, "-m", "jaxrt.workprec.double", str(file)]
        done = subprocess.run(command, env=env, capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(f"float64: {(done.stderr.strip().splitlines() or ['the process failed'])[-1]}")
        return pickle.loads(file.read_bytes())


def _work(file: Path) -> None:
    from .. import compiler
    from ..loading import load
    from ..solver.render import resized

    job = pickle.loads(file.read_bytes())
    compiler.folder = job["folder"]
    scene = resized(load(job["file"], **job["defaults"]), 0, *job["size"])
    stage = stage_with(scene, job["reference"], job["seed"])
    rows = [stage.rendered(named(n), n, n, method="path") for n in job["samples"]]
    file.write_bytes(pickle.dumps(rows))


if __name__ == "__main__":
    _work(Path(sys.argv[1]))
