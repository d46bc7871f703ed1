"""The same seed gives the same bits in another process, and the same within rounding on other devices and in chunks."""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.slow  # two methods are compiled three times

ROOT = Path(__file__).parents[1]

CHILD = """
import sys
import jax, numpy as np
import jaxrt
devices, chunk = int(sys.argv[2]), int(sys.argv[3]) or None
assert len(jax.devices()) == devices
scene = jaxrt.load("scenes/cornell_box.xml", res=16)
found = {}
for method in ("path", "field"):
    sol = jaxrt.render(scene, 4, 3, method=method, max_depth=3, chunk=chunk)
    found |= {method: sol.image, f"{method} stderr": sol.stderr}
found["measure"] = jaxrt.measure(scene, jax.random.key(3), spp=4, max_depth=3)
np.savez(sys.argv[1], **found)
"""


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    """Of processes with (devices, chunk), by name."""
    folder = tmp_path_factory.mktemp("pictures")

    def made(name, devices, chunk):
        environment = os.environ | {
            "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
            "XLA_FLAGS": f"--xla_force_host_platform_device_count={devices}",
            "JAXRT_CACHE": "off",
        }
        file = folder / f"{name}.npz"
        command = [sys.executable, "-c", CHILD, str(file), str(devices), str(chunk)]
        done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr[-2000:]
        with np.load(file) as stored:
            return dict(stored)

    asked = {"one": (1, 0), "again": (1, 0), "four": (4, 100)}
    with ThreadPoolExecutor(2) as pool:
        return dict(zip(asked, pool.map(lambda name: made(name, *asked[name]), asked), strict=True))


def test_another_process_gives_the_same_bits(pictures):
    for name, values in pictures["one"].items():
        np.testing.assert_array_equal(values, pictures["again"][name], err_msg=name)


def test_other_devices_and_chunks_give_the_same_within_rounding(pictures):
    for name, values in pictures["one"].items():
        off = abs(values - pictures["four"][name]) / (abs(values) + 1e-3 * abs(values).mean())
        assert (off < 1e-5).mean() > 0.97, name  # see the test of chunks in tests/solver/test_path.py
