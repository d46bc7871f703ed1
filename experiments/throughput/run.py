"""How many paths and rays a second jaxrt traces, beside Mitsuba 3 in the same run.

    python experiments/throughput/run.py [--quick]

The two take turns on the Cornell box, warm, and the best of five counts; compiling is timed apart. A path is a
sample of a pixel. Rays are incoherent closest hits from points in the box: for jaxrt ψ with its distance, for
Mitsuba `ray_intersect_preliminary`. Mitsuba runs `llvm_ad_rgb` where an LLVM library is found (or named by
DRJIT_LIBLLVM_PATH), else `scalar_rgb`, which traces no batches of rays. Writes results/throughput.csv, .png and
.json (machine, versions).
"""

from __future__ import annotations

import argparse
import csv
import dataclasses
import functools
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))
from peer import load_mitsuba, results_of, timed

HERE = Path(__file__).parent
SCENE = HERE.parent.parent / "scenes" / "cornell_box.xml"
LANES = 8192


@dataclasses.dataclass
class Row:
    """One comparison: work done in a call, and the best time of each side (s); `first`: compiling included."""

    name: str
    work: float
    jaxrt: float
    mitsuba: float | None
    jaxrt_first: float
    mitsuba_first: float | None

    def rate(self, seconds: float | None) -> float:
        return self.work / seconds / 1e6 if seconds else float("nan")

    @property
    def ratio(self) -> float:
        return self.rate(self.jaxrt) / self.rate(self.mitsuba)


def turns(name: str, work: float, ours: Callable[[], Any], theirs: Callable[[], Any] | None, repeat: int) -> Row:
    """Both sides in turn: once to compile, then `repeat` times, of which the best counts. They return seconds."""
    sides = [ours, *([theirs] if theirs else [])]
    first = [timed(side) for side in sides]
    times = [[timed(side) for side in sides] for _ in range(repeat)]
    best = [min(column) for column in zip(*times, strict=True)]
    row = Row(name, work, best[0], best[1] if theirs else None, first[0], first[1] if theirs else None)
    print(
        f"{name:<18} jaxrt {row.rate(row.jaxrt):6.2f} M/s, Mitsuba {row.rate(row.mitsuba):6.2f} M/s, "
        f"ratio {row.ratio:.2f} (first call {row.jaxrt_first:.1f} s, {row.mitsuba_first or float('nan'):.1f} s)",
        flush=True,
    )
    return row


def paths(scene: Any, peer: Any, mi: Any, size: int, spp: int, depth: int, repeat: int) -> Row:
    import jaxrt

    state = {"seed": 0}

    def ours() -> float | None:
        state["seed"] += 1
        start = time.perf_counter()
        sol = jaxrt.render(scene, spp=spp, seed=state["seed"], max_depth=depth, rr_depth=5)
        return None if state["seed"] == 1 else time.perf_counter() - start - sol.stats["seconds_compile"]

    def theirs() -> None:
        state["seed"] += 1
        np.array(mi.render(peer, integrator=integrator, spp=spp, seed=state["seed"]))

    integrator = mi.load_dict({"type": "path", "max_depth": depth, "rr_depth": 5}) if mi else None
    return turns(f"paths, depth {depth}", size * size * spp, ours, theirs if mi else None, repeat)


def rays(scene: Any, peer: Any, mi: Any, count: int, repeat: int) -> Row:
    import jax

    import jaxrt
    from jaxrt.solver.render import cores

    # Points in the middle of the box, and uniform directions.
    random = np.random.default_rng(0)
    o = random.uniform(100.0, 450.0, (count, 3)).astype(np.float32)
    d = random.normal(size=(count, 3)).astype(np.float32)
    d /= np.linalg.norm(d, axis=1, keepdims=True)

    psi = jaxrt.psi(scene)
    parts = cores()

    @jax.jit
    def cast(psi: Any, o: Any, d: Any) -> Any:
        one = lambda o, d: (lambda y: (y.face, y.distance))(psi(jaxrt.Vec3(*o), jaxrt.Vec3(*d)))
        return jax.lax.map(lambda od: jax.vmap(one)(*od), (o, d))

    def chunks(a: np.ndarray) -> list[Any]:
        a = a.reshape(parts, -1, LANES, 3)
        return [jax.device_put(tuple(np.ascontiguousarray(part[..., k]) for k in range(3))) for part in a]

    work = list(zip(chunks(o), chunks(d), strict=True))

    def ours() -> None:
        with ThreadPoolExecutor(parts) as pool:
            list(pool.map(lambda od: jax.block_until_ready(cast(psi, *od)), work))

    if mi is None or "llvm" not in mi.variant():
        return turns("rays, closest hit", count, ours, None, repeat)
    import drjit as dr

    ray = mi.Ray3f(mi.Point3f(o.T.copy()), mi.Vector3f(d.T.copy()))
    dr.eval(ray)  # input, not constants of the program
    dr.sync_thread()

    def theirs() -> None:
        hit = peer.ray_intersect_preliminary(ray, coherent=False)
        dr.eval(hit.t, hit.prim_index)
        dr.sync_thread()

    return turns("rays, closest hit", count, ours, theirs, repeat)


def draw(rows: list[Row], variant: str | None, file: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    fig, axes = plt.subplots(1, len(rows), figsize=(3 * len(rows), 3.2), layout="constrained")
    for ax, row in zip(np.atleast_1d(axes), rows, strict=True):
        bars = ax.bar(["jaxrt", "Mitsuba 3"], [row.rate(row.jaxrt), row.rate(row.mitsuba)], color=["C0", "C7"])
        ax.bar_label(bars, fmt="%.2f")
        ax.set_title(f"{row.name}\nratio {row.ratio:.2f}")
        ax.set_ylabel("millions a second")
        ax.margins(y=0.15)
    fig.suptitle(f"Cornell box; Mitsuba 3 as {variant or 'not installed'}")
    fig.savefig(file, dpi=150)


def main() -> None:
    parser = argparse.ArgumentParser(description="Paths and rays a second, jaxrt and Mitsuba 3.")
    parser.add_argument("--quick", action="store_true", help="a small picture, best of two")
    quick = parser.parse_args().quick
    size, spp, count, repeat = (64, 16, 32 * LANES, 2) if quick else (256, 64, 256 * LANES, 5)

    found = load_mitsuba()
    mi, variant = found or (None, None)
    print(f"Mitsuba 3: {variant or 'not installed'}")
    import jaxrt

    scene = jaxrt.load(SCENE, res=size)
    peer = mi.load_file(str(SCENE), res=size) if mi else None
    runs = [functools.partial(paths, scene, peer, mi, size, spp, depth, repeat) for depth in (6, -1)]
    rows = [run() for run in [*runs, functools.partial(rays, scene, peer, mi, count, repeat)]]

    results = results_of(HERE, mitsuba=variant)
    with (results / "throughput.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["what", "jaxrt M/s", "Mitsuba M/s", "ratio", "jaxrt first s", "Mitsuba first s", "variant"])
        for r in rows:
            rates = [f"{r.rate(r.jaxrt):.4g}", f"{r.rate(r.mitsuba):.4g}", f"{r.ratio:.4g}"]
            table.writerow([r.name, *rates, r.jaxrt_first, r.mitsuba_first, variant])
    draw(rows, variant, results / "throughput.png")


if __name__ == "__main__":
    main()
