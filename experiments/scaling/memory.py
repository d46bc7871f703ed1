"""Peak memory of whole `jaxrt render` processes against size and samples a pixel.

    python experiments/scaling/memory.py [--quick]

The Cornell box, each render in a process of its own, the second one of its kind, so that nothing is compiled.
A picture, its error and the copy of both that goes into the file take 48 bytes a pixel. Writes results/memory.csv,
.png and .json (machine, versions).
"""

from __future__ import annotations

import argparse
import csv
import os
import subprocess
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
from peer import results_of

HERE = Path(__file__).parent
SCENE = HERE.parent.parent / "scenes" / "cornell_box.xml"


def peak(size: int, spp: int) -> float:
    """Peak memory (MB) of a render's process."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "jaxrt", "render", str(SCENE), "--size", f"{size}x{size}", "--spp", str(spp)]
        process = subprocess.Popen([*command, "-o", f"{folder}/box.exr"], stdout=subprocess.DEVNULL)
        _, status, usage = os.wait4(process.pid, 0)
    if status:
        raise SystemExit(f"the render of {size}x{size}, {spp} samples failed")
    return usage.ru_maxrss / 1e3


def main() -> None:
    parser = argparse.ArgumentParser(description="Peak memory of renders against size and samples.")
    parser.add_argument("--quick", action="store_true", help="small pictures, few samples")
    quick = parser.parse_args().quick
    sizes, samples = ((128, 256), (1, 4)) if quick else ((512, 1024, 2048, 4096), (1, 16, 256))
    most = 1 << 24 if quick else 1 << 29  # paths; more would take minutes, and memory does not know of them
    rows = []
    for size in sizes:
        for spp in samples:
            if size * size * spp <= most:
                peak(size, spp)
                rows.append({"size": size, "spp": spp, "megabytes": peak(size, spp)})
                film = 48e-6 * size * size
                print(
                    f"{size}x{size}, {spp:>3} spp: {rows[-1]['megabytes']:.0f} MB, of which film {film:.0f} MB",
                    flush=True,
                )

    results = results_of(HERE, name="memory")
    with (results / "memory.csv").open("w", newline="") as file:
        table = csv.DictWriter(file, ["size", "spp", "megabytes"])
        table.writeheader()
        table.writerows(rows)
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    fig, ax = plt.subplots(figsize=(5, 4), layout="constrained")
    for spp in samples:
        points = [(row["size"] ** 2 / 1e6, row["megabytes"]) for row in rows if row["spp"] == spp]
        ax.plot(*zip(*points, strict=True), "o-", label=f"{spp} samples a pixel")
    pixels = [size * size / 1e6 for size in sizes]
    ax.plot(pixels, [rows[0]["megabytes"] + 48 * p for p in pixels], "k:", label="film alone")
    ax.set(xlabel="million pixels", ylabel="peak memory, MB", ylim=(0, None))
    ax.legend()
    fig.savefig(results / "memory.png", dpi=150)


if __name__ == "__main__":
    main()
