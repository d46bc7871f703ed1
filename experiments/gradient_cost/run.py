"""What a gradient costs: forward and backward of a picture by three reflectances, beside Mitsuba 3's `prb`.

    python experiments/gradient_cost/run.py [--quick]

The Cornell box, and d(mean radiance)/d(red, green, white). By reverse mode at two depths, by jax.jacfwd, through the
field method, a picture alone, and Mitsuba's render and backward with the same samples; turn by turn, warm, the best of
each. Then the error of each gradient: relative distance from the mean of many. And the peak memory of processes of
their own, over samples and depth. Writes results/gradient_cost.csv, .json (machine, versions, seed) and .png.
"""

from __future__ import annotations

import argparse
import csv
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))
from fits import use_cores
from peer import load_mitsuba, results_of

import jaxrt

HERE = Path(__file__).parent
SCENE = HERE.parent.parent / "scenes" / "cornell_box.xml"
NAMES = ("red.reflectance", "green.reflectance", "white.reflectance")
SEED = 0


def ours(res: int, spp: int, depth: int, way: str) -> Callable[[int], Any]:
    """seed -> gradient (3, 3), or a picture."""
    scene = jaxrt.load(SCENE, res=res)
    plan = jaxrt.plan(scene, free="*.reflectance")
    elements = jaxrt.elements_of(scene) if way == "field" else None
    start = jnp.stack([jaxrt.params(scene)[name] for name in NAMES])

    def picture(values: Any, seed: Any, scene: Any) -> Any:
        moved = jaxrt.with_params(scene, dict(zip(NAMES, values, strict=True)))
        if way == "field":
            field = jaxrt.solve(moved, seed, plan=plan, max_depth=depth, directions=64, elements=elements)
            return jaxrt.measure(moved, seed, plan=plan, spp=spp, max_depth=depth, radiance=field)
        return jaxrt.measure(moved, seed, plan=plan, spp=spp, max_depth=depth)

    def three(x: Any, seed: Any, scene: Any) -> Any:  # along one direction a wall: three numbers
        return picture(start * x[:, None], seed, scene)

    if way == "picture":
        f = jax.jit(picture)
        return lambda seed: jax.block_until_ready(f(start, seed, scene))
    if way == "jacfwd":
        g = jax.jit(lambda seed, scene: jax.jacfwd(three)(jnp.ones(3), seed, scene))
        return lambda seed: jax.block_until_ready(g(seed, scene))
    loss = lambda values, seed, scene: picture(values, seed, scene).mean()
    gradient = jax.jit(jax.grad(loss))
    return lambda seed: jax.block_until_ready(gradient(start, seed, scene))


def theirs(peer: Any, res: int, spp: int, depth: int) -> Callable[[int], Any]:
    import drjit as dr

    mi = peer[0]
    scene = mi.load_file(str(SCENE), res=res)
    params = mi.traverse(scene)
    keys = [name + ".value" for name in NAMES]
    integrator = mi.load_dict({"type": "prb", "max_depth": depth, "rr_depth": 1000})

    def gradient(seed: int) -> np.ndarray:
        for key in keys:
            dr.enable_grad(params[key])
            dr.set_grad(params[key], 0.0)
        image = mi.render(scene, params, integrator=integrator, spp=spp, seed=seed)
        dr.backward(dr.mean(image, axis=None))
        return np.stack([np.array(dr.grad(params[key])).reshape(-1) for key in keys])

    return gradient


def peak(arguments: list[str]) -> float:
    """Peak memory (MB) of a gradient in a process of its own."""
    run = subprocess.run([sys.executable, __file__, "--once", *arguments], capture_output=True, text=True, check=True)
    return float(run.stdout.split()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--quick", action="store_true", help="small pictures, few samples")
    parser.add_argument("--once", nargs=4, metavar=("res", "spp", "depth", "way"), help="one gradient; its peak memory")
    args = parser.parse_args()
    use_cores()
    if args.once:
        ours(*map(int, args.once[:3]), args.once[3])(SEED)
        print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
        return
    res, spp, repeat, depths = (64, 16, 2, (6,)) if args.quick else (256, 64, 4, (6, 32))
    peer = load_mitsuba()
    rows: list[dict[str, Any]] = []
    for depth in depths:
        ways = ["picture", "reverse", "jacfwd", "field"] if depth == 6 else ["reverse"]
        calls = {way: ours(res, spp if way != "field" else max(spp // 16, 1), depth, way) for way in ways}
        if peer is not None:
            calls[f"mitsuba {peer[1]}"] = theirs(peer, res, spp, depth)
        times: dict[str, list[float]] = {name: [] for name in calls}
        gradients: dict[str, list[Any]] = {name: [] for name in calls}
        first: dict[str, float] = {}
        for seed in range(SEED, SEED + repeat + 1):
            for name, call in calls.items():
                began = time.perf_counter()
                gradients[name].append(np.asarray(call(seed)))
                took = time.perf_counter() - began
                if seed == SEED:
                    first[name] = took
                else:
                    times[name].append(took)
        for name in calls:
            off = None
            if gradients[name][0].shape == (3, 3):
                g = np.stack(gradients[name])
                off = float(np.sqrt(((g - g.mean(0)) ** 2).sum((1, 2)).mean() * len(g) / (len(g) - 1)))
                off /= float(np.linalg.norm(g.mean(0)))
            rows.append({"way": name, "depth": depth, "seconds": min(times[name]), "first": first[name], "noise": off})
            mean = "" if off is None else f", mean {np.mean(gradients[name], 0).sum(1)}"
            print(
                f"depth {depth:2} {name:20} {min(times[name]):.3f} s, first {first[name]:.1f} s, noise {off}{mean}",
                flush=True,
            )
    ladder = [(16, 6), (64, 6)] if args.quick else [(64, 6), (1024, 6), (64, 4), (64, 32)]
    for samples, depth in ladder:
        megabytes = peak([str(res if args.quick else 128), str(samples), str(depth), "reverse"])
        rows.append({"way": "reverse, memory", "depth": depth, "spp": samples, "megabytes": megabytes})
        print(f"depth {depth:2} spp {samples:5} peak {megabytes:.0f} MB", flush=True)
    mitsuba = getattr(peer[0], "__version__", None) if peer else None
    results = results_of(HERE, SEED, res=res, spp=spp, mitsuba=mitsuba)
    with open(results / "gradient_cost.csv", "w", newline="") as file:
        writer = csv.DictWriter(file, ["way", "depth", "spp", "seconds", "first", "noise", "megabytes"])
        writer.writeheader()
        writer.writerows(rows)
    draw([row for row in rows if "seconds" in row], results / "gradient_cost.png")


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    fig, ax = plt.subplots(figsize=(7, 0.4 * len(rows) + 1))
    names = [f"{row['way']}, depth {row['depth']}" for row in rows]
    ax.barh(names[::-1], [row["seconds"] for row in rows[::-1]])
    ax.set_xlabel("seconds, warm")
    fig.tight_layout()
    fig.savefig(path, dpi=150)


if __name__ == "__main__":
    main()
