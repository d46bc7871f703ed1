"""What a picture costs for an error: the field and path methods of jaxrt beside Mitsuba 3, in one run.

    python experiments/efficiency/run.py [--quick] [scene.xml ...]

Efficiency is 1/(relMSE · seconds), relMSE = mean((I − R)²/(R² + ε)) with ε = 0.01 mean(R²) and the noise of R taken
off. Everything is warm and at equal max_depth; seconds are those of a whole call, the field's solve among them. From
errors at growing numbers of samples comes the time for relMSE 1e-2, 1e-3 and 1e-4, by lines in log-log (beyond the
last point with its slope). Writes results/efficiency.csv, .png and .json (machine, versions).
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))
from peer import load_mitsuba, results_of

import jaxrt

HERE = Path(__file__).parent
SCENES = [HERE.parent.parent / "scenes" / "cornell_box.xml", HERE / "hidden_light.xml", HERE / "glossy_object.xml"]
SAMPLERS = ("independent", "stratified", "multijitter", "orthogonal", "ldsampler")
LEVELS = (1e-2, 1e-3, 1e-4)


def reference(scene: Any, spp: int) -> tuple[np.ndarray, float]:
    """The path method's picture, and the relMSE that its noise makes."""
    sol = jaxrt.render(scene, spp, 12345, method="path")
    return sol.image.astype(np.float64), sol.relative_error**2


def curve(
    call: Any, samples: list[int], truth: tuple[np.ndarray, float], repeat: int
) -> list[tuple[int, float, float]]:
    """(samples a pixel, seconds, relMSE) for each number of samples: the best time, the mean error of all seeds."""
    rows = []
    for spp in samples:
        call(spp, 0)  # compiles
        errors, times = [], []
        for seed in range(1, repeat + 1):
            start = time.perf_counter()
            image = call(spp, seed)
            times.append(time.perf_counter() - start)
            errors.append(jaxrt.relative_mse(image, truth[0]) - truth[1])
        rows.append((spp, min(times), max(float(np.mean(errors)), 1e-9)))
    return rows


def seconds_for(level: float, rows: list[tuple[int, float, float]]) -> float:
    """Seconds to reach an error, by lines in log-log."""
    t, e = (np.log([row[k] for row in rows]) for k in (1, 2))
    x = np.log(level)
    if x >= e[0]:
        return float(np.exp(t[0]))  # one sample is enough
    k = min(int(np.searchsorted(-e, -x)), len(e) - 1)
    slope = (t[k] - t[k - 1]) / (e[k] - e[k - 1])
    return float(np.exp(t[k] + slope * (x - e[k])))


def main() -> None:
    parser = argparse.ArgumentParser(description="Seconds for an error, jaxrt and Mitsuba.")
    parser.add_argument("--quick", action="store_true", help="small pictures, few samples")
    parser.add_argument("scenes", nargs="*", type=Path, help="Mitsuba XML scenes with a default named res")
    args = parser.parse_args()
    quick, peer = args.quick, load_mitsuba()
    size, most, repeat = (64, 64, 2) if quick else (256, 256, 3)
    table, curves = [], {}
    for file in args.scenes or SCENES:
        scene = jaxrt.load(file, res=size)
        truth = reference(scene, 1024 if quick else 4096)
        ladder = [n for n in (1, 2, 3, 4, 8, 16, 32, 64, 128, 256) if n <= most]
        found: dict[str, Any] = {}
        fours = [n for n in ladder if n in (1, 4, 16, 64, 256)]  # curves of slope −1 need no more
        for method, samples in (("field", ladder), ("path", fours)):
            found[f"jaxrt {method}"] = curve(
                lambda spp, seed, m=method, s=scene: jaxrt.render(s, spp, seed, method=m).image, samples, truth, repeat
            )
        if peer is not None:
            mi, _ = peer
            for sampler in SAMPLERS:
                theirs = mi.load_file(str(file), res=size)
                sensor = mi.load_dict(_with_sampler(mi, theirs.sensors()[0], mi.load_dict({"type": sampler}), size))
                found[f"mitsuba {sampler}"] = curve(
                    lambda spp, seed, mi=mi, s=sensor, t=theirs: np.array(mi.render(t, sensor=s, spp=spp, seed=seed)),
                    fours,
                    truth,
                    2,
                )
        curves[file.stem] = found
        for name, rows in found.items():
            times = [seconds_for(level, rows) for level in LEVELS]
            table.append([file.stem, name, *times])
            said = ", ".join(f"{1 / (lv * t):9.0f}" for lv, t in zip(LEVELS, times, strict=True))
            print(f"{file.stem:14} {name:22} efficiency at 1e-2, 1e-3, 1e-4: {said}", flush=True)

    results = results_of(HERE)
    with (results / "efficiency.csv").open("w", newline="") as out:
        writer = csv.writer(out)
        writer.writerow(["scene", "method", *(f"seconds to relMSE {lv:g}" for lv in LEVELS)])
        writer.writerows(table)
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    fig, axes = plt.subplots(1, len(curves), figsize=(5 * len(curves), 4), layout="constrained", squeeze=False)
    for ax, (name, found) in zip(axes[0], curves.items(), strict=True):
        for label, rows in found.items():
            ax.loglog([r[1] for r in rows], [r[2] for r in rows], "o-", label=label, lw=2 if "jaxrt" in label else 1)
        ax.set(title=name, xlabel="seconds", ylabel="relMSE")
    axes[0][0].legend()
    fig.savefig(results / "efficiency.png", dpi=150)


def _with_sampler(mi: Any, sensor: Any, sampler: Any, size: int) -> dict[str, Any]:
    """A perspective sensor like this one with another sampler."""
    params = mi.traverse(sensor)
    film = {
        "type": "hdrfilm", "width": size, "height": size, "pixel_format": "rgb", "filter": {"type": "box"},
    }  # fmt: skip
    to_world = mi.ScalarTransform4f(np.array(params["to_world"].matrix).reshape(4, 4).tolist())
    fov = float(np.array(params["x_fov"]).reshape(-1)[0])
    near, far = float(params["near_clip"]), float(params["far_clip"])
    return {
        "type": "perspective", "fov": fov, "fov_axis": "x", "to_world": to_world,
        "near_clip": near, "far_clip": far, "film": film, "sampler": sampler,
    }  # fmt: skip


if __name__ == "__main__":
    main()
