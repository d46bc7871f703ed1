"""Closest hits a second against the number of triangles, by every backend, beside Mitsuba 3 in the same run.

    python experiments/scaling/run.py [--quick]

Rays start inside spheres of 48 to 1.3 million triangles, in all directions, arrays in and out. The embree backend
gets all of them in one jitted call, the others one program a core; Mitsuba `ray_intersect_preliminary`, robust.
They take turns, warm, and the best of five counts. Writes results/scaling.csv, .png and .json (machine, versions).
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

sys.path.insert(0, str(Path(__file__).parent.parent))
from peer import load_mitsuba, results_of, timed

HERE = Path(__file__).parent
LANES = 8192
MOST = {"dense": 6_000, "bvh": 2_000_000, "embree": 10_000_000}  # triangles beyond which a backend takes too long


def rays(count: int) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(0)
    o, d = random.normal(size=(2, count, 3)).astype(np.float32)
    unit = lambda v: v / np.linalg.norm(v, axis=1, keepdims=True)
    return 0.3 * unit(o), unit(d)


def ours(mesh: Any, backend: str, o: np.ndarray, d: np.ndarray) -> Callable[[], None]:
    """A call that casts all rays; it checks that the mesh is closed."""
    import jax

    import jaxrt
    from jaxrt.solver.render import cores
    from jaxrt.world import prepare

    scene = jaxrt.Scene.build([jaxrt.Mesh(vertices=mesh.vertices, faces=mesh.faces)])
    search = jax.jit(prepare)(scene, jaxrt.plan(scene, backend=backend)).search

    @jax.jit
    def cast(search: Any, o: Any, d: Any) -> Any:
        one = jax.vmap(lambda o, d: search.closest(jaxrt.Vec3(*o), jaxrt.Vec3(*d)))
        return jax.vmap(one)(o, d) if backend == "embree" else jax.lax.map(lambda od: one(*od), (o, d))

    columns = lambda a: tuple(np.ascontiguousarray(a[..., k]) for k in range(3))
    programs = 1 if backend == "embree" else cores()
    parts = [a.reshape(programs, -1, LANES, 3) for a in (o, d)]
    work = [jax.device_put((columns(a), columns(b))) for a, b in zip(*parts, strict=True)]

    def call() -> None:
        with ThreadPoolExecutor(programs) as pool:
            faces = list(pool.map(lambda od: jax.block_until_ready(cast(search, *od)), work))
        assert all((np.asarray(f) >= 0).all() for f in faces)

    return call


def theirs(mi: Any, mesh: Any, o: np.ndarray, d: np.ndarray) -> Callable[[], None]:
    import drjit as dr

    made = mi.Mesh("m", len(mesh.vertices), len(mesh.faces))
    values = mi.traverse(made)
    values["vertex_positions"] = np.asarray(mesh.vertices, np.float32).ravel()
    values["faces"] = np.asarray(mesh.faces, np.uint32).ravel()
    values.update()
    scene = mi.load_dict({"type": "scene", "embree_use_robust_intersections": True, "m": made})
    ray = mi.Ray3f(mi.Point3f(o.T.copy()), mi.Vector3f(d.T.copy()))
    dr.eval(ray)
    dr.sync_thread()

    def call() -> None:
        hit = scene.ray_intersect_preliminary(ray, coherent=False)
        dr.eval(hit.t, hit.prim_index)
        dr.sync_thread()

    return call


def main() -> None:
    parser = argparse.ArgumentParser(description="Closest hits a second against triangles.")
    parser.add_argument("--quick", action="store_true", help="small meshes, few rays, best of two")
    quick = parser.parse_args().quick
    levels, count, repeat = ((0, 2, 4), 8 * LANES, 2) if quick else ((0, 2, 4, 6, 8), 128 * LANES, 5)
    found = load_mitsuba()
    mi = found[0] if found and "llvm" in found[1] else None
    from jaxrt.intersect import BACKENDS, refusal

    o, d = rays(count)
    rows = []
    for level in levels:
        mesh = trimesh.creation.icosphere(subdivisions=level) if level else trimesh.creation.uv_sphere(count=(4, 6))
        n = len(mesh.faces)
        backends = [name for name in BACKENDS if refusal(name) is None and n <= MOST[name]]
        sides = {name: ours(mesh, name, o, d) for name in backends}
        if mi is not None:
            sides["mitsuba"] = theirs(mi, mesh, o, d)
        for call in sides.values():
            call()  # compiles
        times = [[timed(call) for call in sides.values()] for _ in range(repeat)]
        rates = dict(zip(sides, (count / min(column) / 1e6 for column in zip(*times, strict=True)), strict=True))
        rows.append({"triangles": n, **rates})
        print(f"{n:>8} triangles:", ", ".join(f"{name} {rate:.2f} Mrays/s" for name, rate in rates.items()), flush=True)

    results, names = results_of(HERE), [*BACKENDS, "mitsuba"]
    with (results / "scaling.csv").open("w", newline="") as file:
        table = csv.DictWriter(file, ["triangles", *names])
        table.writeheader()
        table.writerows(rows)
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    fig, ax = plt.subplots(figsize=(5, 4), layout="constrained")
    for name in names:
        points = [(row["triangles"], row[name]) for row in rows if name in row]
        if points:
            ax.loglog(*zip(*points, strict=True), "o-", label=name)
    ax.set(xlabel="triangles", ylabel="closest hits, millions a second")
    ax.legend()
    fig.savefig(results / "scaling.png", dpi=150)


if __name__ == "__main__":
    main()
