"""What a solve costs: seconds and bytes against the number of links, elements times directions.

    python experiments/fixed_point/cost.py [--quick]

The Cornell box at its fixed point, warm, the best of three: links sampled and solved, elements given. Bytes
are those that XLA plans for: arguments, results and what it keeps in between. Writes results/cost.csv,
.png and .json (machine, versions).
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
from pathlib import Path

import jax
import matplotlib
import matplotlib.pyplot as plt
import numpy as np

import jaxrt
from jaxrt.solver import field

sys.path.insert(0, str(Path(__file__).parent.parent))
from peer import results_of

matplotlib.use("Agg")
HERE = Path(__file__).parent


def cost(scene: jaxrt.Scene, resolution: int, directions: int) -> list[float]:
    """Elements, directions, seconds of a warm solve, and bytes of its two programs."""
    plan = jaxrt.plan(scene)
    elements = jaxrt.elements_of(scene, plan, resolution)
    key = jax.numpy.uint32(0)
    solve = lambda key: jaxrt.solve(scene, key, plan=plan, elements=elements, directions=directions, max_depth=-1)
    jax.block_until_ready(solve(0).values)
    seconds = []
    for k in range(3):
        start = time.perf_counter()
        jax.block_until_ready(solve(k + 1).values)
        seconds.append(time.perf_counter() - start)
    follow = field.follows(plan, elements)
    linked = field._linked.lower(scene, plan, elements, key, directions, follow, field.lengths_of(follow, -1))
    world, links = field.links_of(scene, plan, elements, key, directions, -1)
    found = field._found.lower(world, elements, links, key, 1e-4, "anderson", -1, 0)
    planned = 0
    for program in (linked, found):
        memory = program.compile().compiled.memory_analysis()
        planned += memory.argument_size_in_bytes + memory.output_size_in_bytes + memory.temp_size_in_bytes
    return [elements.count, directions, min(seconds), planned]


def main() -> None:
    parser = argparse.ArgumentParser(description="Seconds and bytes of a solve against its number of links.")
    parser.add_argument("--quick", action="store_true", help="two sizes")
    quick = parser.parse_args().quick
    scene = jaxrt.load(HERE.parent.parent / "scenes" / "cornell_box.xml", res=16)
    sizes = [(1024, 64), (4096, 64)] if quick else [(1024, 64), (4096, 64), (4096, 256), (16384, 64), (16384, 256)]
    rows = []
    for size in sizes:
        rows.append(cost(scene, *size))
        n, k, s, b = rows[-1]
        print(f"{n:6.0f} elements x {k:4.0f} directions: {s:7.3f} s, {b / 1e6:7.1f} MB", flush=True)
    table = np.array(rows)
    links = table[:, 0] * table[:, 1]
    slopes = [np.polyfit(np.log(links), np.log(table[:, k]), 1)[0] for k in (2, 3)]
    print(f"seconds grow as links^{slopes[0]:.2f}, bytes as links^{slopes[1]:.2f}")
    results = results_of(HERE, name="cost")
    with (results / "cost.csv").open("w", newline="") as out:
        csv.writer(out).writerows([["elements", "directions", "seconds", "bytes"], *rows])
    fig, axes = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
    for ax, column, name in zip(axes, (2, 3), ("seconds", "bytes"), strict=True):
        ax.loglog(links, table[:, column], "o")
        ax.loglog(links, table[0, column] * links / links[0], ":", label="linear")
        ax.set(xlabel="elements · directions", ylabel=name)
    axes[0].legend()
    fig.savefig(results / "cost.png", dpi=150)


if __name__ == "__main__":
    main()
