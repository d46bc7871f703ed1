"""Radiance as a fixed point: how the solvers of b = e + T b converge, why, and what they find.

    python experiments/fixed_point/run.py [--quick]

1. solvers.png: applications of T until the true error of the discrete system is below 1e-4, against the albedo of a
   closed cube with a lamp, and of one with a face taken out. GMRES counts its cycles, each of up to 32 applications.
2. convergence.png: the true error after each application, beside what the certificate of `field.error` says.
3. spectrum.png: eigenvalues of T of the cube and of the three channels of the Cornell box: those of KG on elements.
4. field.png: the radiance on the walls of the Cornell box, unfolded, as its elements store it, and by the path method.

Numbers go to results/*.csv, machine and versions to results/fixed_point.json. Everything is computed in float64, so
that rounding does not hide convergence.
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import matplotlib
import matplotlib.pyplot as plt
import numpy as np

import jaxrt
from jaxrt.files.image import to_srgb
from jaxrt.solver.equilibrium import SOLVERS, residual_bound, solve_links
from jaxrt.solver.field import links_of

sys.path.insert(0, str(Path(__file__).parent.parent))
from peer import results_of

jax.config.update("jax_enable_x64", True)
matplotlib.use("Agg")

HERE = Path(__file__).parent
SCENES = HERE.parent.parent / "scenes"


def cube(rho: float, open_: bool = False) -> jaxrt.Scene:
    """A cube of albedo ρ whose ceiling has a lamp; without its front where it is open."""
    paint = jaxrt.TwoSided(jaxrt.Diffuse(rho))
    turns = {
        "floor": ((1, 0, 0), (0, 1, 0), (0, 0, 0)), "ceiling": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
        "left": ((0, 1, 0), (0, 0, 1), (0, 0, 0)), "right": ((0, 1, 0), (0, 0, 1), (1, 0, 0)),
        "back": ((1, 0, 0), (0, 0, 1), (0, 1, 0)), "front": ((1, 0, 0), (0, 0, 1), (0, 0, 0)),
    }  # fmt: skip
    shapes = []
    for name, (a, b, o) in turns.items():
        if open_ and name == "front":
            continue
        a, b, o = (np.array(v, float) for v in (a, b, o))
        columns = np.stack([a / 2, b / 2, np.cross(a, b), o + (a + b) / 2], 1)
        shapes.append(jaxrt.Rectangle(id=name, to_world=np.vstack([columns, [0, 0, 0, 1]]), bsdf=paint))
    lamp = np.array([[0.1, 0, 0, 0.5], [0, -0.1, 0, 0.4], [0, 0, -1, 0.99], [0, 0, 0, 1.0]])
    shapes.append(jaxrt.Rectangle(id="lamp", to_world=lamp, emission=1.0))
    return jaxrt.Scene.build(shapes)


def links(scene: jaxrt.Scene, resolution: int, directions: int) -> Any:
    """T of a scene, as links of its elements."""
    plan = jaxrt.plan(scene, light_sampling=True)
    elements = jaxrt.elements_of(scene, plan, resolution)
    return links_of(scene, plan, elements, jax.numpy.uint32(0), directions, -1)[1]


@jax.jit
def off(b: Any, exact: Any) -> Any:
    return jnp.abs(b - exact).max() / exact.max()


def steps_needed(table: Any, exact: Any, solver: str, wanted: float, asked: int) -> int:
    """Applications of T until the error is below `wanted`, by a solver that is `asked` so often for ever more."""
    for rtol in np.geomspace(1e-1, 1e-9, asked):
        b, steps, _ = _solve(table, rtol, solver, 1 << 14)
        if off(b, exact) < wanted:
            return int(steps)
    return -1


_solve = jax.jit(solve_links, static_argnums=(2, 3))


def solvers(quick: bool) -> None:
    rhos = [0.5, 0.99] if quick else [0.2, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 0.99, 0.995, 0.998, 0.999]
    rows = []
    fig, axes = plt.subplots(1, 2, figsize=(9, 4), sharey=True, layout="constrained")
    for ax, open_ in zip(axes, (False,) if quick else (False, True), strict=False):
        tables = [links(cube(r, open_), 400, 32) for r in rhos]
        tables = [(t, _solve(t, 1e-11, "gmres", 4096)[0]) for t in tables]
        counts = {s: [steps_needed(*t, s, 1e-4, 9 if quick else 33) for t in tables] for s in SOLVERS}
        for name, values in counts.items():
            ax.loglog([1 - r for r in rhos], values, "o-", label=name)
            rows += [[("closed", "open")[open_], name, r, v] for r, v in zip(rhos, values, strict=True)]
            print(f"{('closed', 'open')[open_]:7} {name:9}", dict(zip(rhos, values, strict=True)), flush=True)
        ax.invert_xaxis()
        ax.set(xlabel="1 − albedo", title=("closed cube", "cube without its front")[open_])
    axes[0].set_ylabel("applications of T (gmres: cycles) to 1e-4")
    axes[0].legend()
    save(fig, "solvers", ["cube", "solver", "albedo", "applications"], rows)


def convergence(quick: bool) -> None:
    fig, axes = plt.subplots(1, 2, figsize=(9, 4), sharey=True, layout="constrained")
    rows = []
    for ax, rho in zip(axes, (0.5, 0.95), strict=True):
        table = links(cube(rho), 400, 32)
        exact = _solve(table, 1e-11, "gmres", 4096)[0]
        for name in SOLVERS[:3]:  # GMRES counts cycles
            found = [_solve(table, r, name, 1 << 14)[:2] for r in np.geomspace(0.3, 1e-9, 12 if quick else 40)]
            steps = [int(n) for _, n in found]
            errors = [float(off(b, exact)) for b, _ in found]
            bounds = [float(residual_bound(table, b)[0] / exact.max()) for b, _ in found]
            (line,) = ax.semilogy(steps, errors, "-", label=name)
            ax.semilogy(steps, bounds, ":", color=line.get_color())
            rows += [[rho, name, *r] for r in zip(steps, errors, bounds, strict=True)]
            assert all(e <= b * (1 + 1e-9) + 1e-12 for e, b in zip(errors, bounds, strict=True)), (name, rho)
        ax.set(xlabel="applications of T", title=f"albedo {rho}", xlim=(0, 60), ylim=(1e-10, 3))
    axes[0].set_ylabel("error (solid), certificate (dotted)")
    axes[0].legend()
    save(fig, "convergence", ["albedo", "solver", "applications", "error", "certificate"], rows)


def spectrum(quick: bool) -> None:
    fig, ax = plt.subplots(figsize=(6, 4), layout="constrained")
    rows = []
    box = jaxrt.load(SCENES / "cornell_box.xml", res=16)
    cases = [("cube, albedo 0.9", links(cube(0.9), 400, 256), 0, "black")]
    table = links(box, *((300, 64) if quick else (600, 256)))
    cases += [(f"Cornell box, {c}", table, k, c) for k, c in enumerate(("red", "green", "blue"))]
    for name, table, channel, color in cases:
        count, directions = table.target.shape
        weight = table.albedo[:, None] if table.weight is None else table.weight
        matrix = np.zeros((count, count))
        np.add.at(matrix, (np.arange(count)[:, None], np.asarray(table.target)), np.asarray(weight)[..., channel])
        values = np.sort(np.abs(np.linalg.eigvals(matrix / directions)))[::-1]
        ax.semilogy(np.arange(1, 61), np.maximum(values[:60], 1e-4), "o-", ms=3, label=name, color=color)
        rows += [[name, k + 1, v] for k, v in enumerate(values[:60])]
        print(f"{name:20} largest |λ|: {', '.join(f'{v:.3f}' for v in values[:5])}", flush=True)
    ax.set(xlabel="number", ylabel="|λ| of T", ylim=(0.1, 1))
    ax.legend()
    save(fig, "spectrum", ["scene", "number", "modulus"], rows)


def pictures(quick: bool) -> None:
    n = 32 if quick else 192
    scene = jaxrt.load(SCENES / "cornell_box.xml", res=16)
    field = jaxrt.solve(scene, resolution=4096, directions=64 if quick else 256, max_depth=-1)
    low, high = 0.0, 555.0
    t = low + (high - low) * (np.arange(n) + 0.5) / n
    b, a = np.meshgrid(t, t, indexing="ij")  # rows, columns
    middle = np.full_like(a, 278.0)
    walls = {  # points a little inside, looking at the wall
        "back": (a, high - b, middle * 0 + 500.0, (0, 0, 1)), "floor": (a, middle * 0 + 1.0, high - b, (0, -1, 0)),
        "ceiling": (a, middle * 0 + 540.0, b, (0, 1, 0)), "left": (middle * 0 + 500.0, high - b, a, (1, 0, 0)),
        "right": (middle * 0 + 50.0, high - b, high - a, (-1, 0, 0)),
    }  # fmt: skip
    psi = jaxrt.psi(field.world)

    @jax.jit
    def seen(points: Any, w: Any) -> Any:
        w = jaxrt.Vec3.of(w)
        return jax.vmap(lambda p: field(psi(jaxrt.Vec3.of(p), w), -w).array())(points)

    shown, errors = {}, []
    for name, (x, y, z, w) in walls.items():
        points = np.stack([x, y, z], -1).reshape(-1, 3)
        direction = np.array(w, float)
        stored = np.asarray(seen(points, direction)).reshape(n, n, 3)
        # The path method on the same rays, without the emission that they meet.
        every = np.broadcast_to(direction, points.shape)
        spp = 16 if quick else 1024
        whole = np.asarray(jaxrt.radiance(scene, points, every, 1, spp=spp, max_depth=30)).reshape(n, n, 3)
        lamp = np.asarray(jaxrt.radiance(scene, points, every, 1, spp=4, max_depth=1)).reshape(n, n, 3)
        shown[name] = stored, whole - lamp
        errors.append([name, float(stored.mean()), float((whole - lamp).mean())])
        print(f"{name:8} mean of the field {errors[-1][1]:.4f}, of paths {errors[-1][2]:.4f}", flush=True)
    fig, axes = plt.subplots(2, 1, figsize=(8, 11), layout="constrained")
    for ax, k, title in zip(axes, (0, 1), ("as elements store it", "by paths"), strict=True):
        sheet = np.ones((3 * n, 3 * n, 3))
        at = {"ceiling": (0, 1), "left": (1, 0), "back": (1, 1), "right": (1, 2), "floor": (2, 1)}
        for name, (row, column) in at.items():
            sheet[row * n : (row + 1) * n, column * n : (column + 1) * n] = to_srgb(shown[name][k]) / 255.0
        ax.imshow(sheet)
        ax.set(title=f"R on the walls of the Cornell box, {title}", xticks=[], yticks=[])
    save(fig, "field", ["wall", "mean of the field", "mean of paths"], errors)


def save(fig: Any, name: str, header: list[str], rows: list[Any]) -> None:
    results = results_of(HERE)
    fig.savefig(results / f"{name}.png", dpi=150)
    plt.close(fig)
    with (results / f"{name}.csv").open("w", newline="") as out:
        csv.writer(out).writerows([header, *rows])


def main() -> None:
    parser = argparse.ArgumentParser(description="How the solvers of the field method converge, and what they find.")
    parser.add_argument("--quick", action="store_true", help="fewer albedos, directions and points")
    quick = parser.parse_args().quick
    for part in (solvers, convergence, spectrum, pictures):
        start = time.perf_counter()
        part(quick)
        print(f"{part.__name__}: {time.perf_counter() - start:.0f} s", flush=True)


if __name__ == "__main__":
    main()
