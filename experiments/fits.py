"""What experiments on fits share: strips of pictures, curves of loss, and what is written of both."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import jax
import numpy as np
import optimistix
from peer import results_of

import jaxrt
from jaxrt.files.image import to_srgb


def use_cores() -> None:
    """One device a core: programs of derivatives spread over them. Before anything else is done with jax."""
    jax.config.update("jax_num_cpu_devices", len(os.sched_getaffinity(0)))


def gauss_newton() -> Any:
    """For what moves. It ends by root mean squares: the largest residual never rests, as samples jump over borders."""
    return optimistix.GaussNewton(1e-2, 1e-3, norm=optimistix.rms_norm)


def chosen_steps(n: int, frames: int = 5) -> list[int]:
    """Steps to show, from the first to the last, early ones closer together."""
    return sorted({round((n - 1) * (k / (frames - 1)) ** 2) for k in range(frames)})


def on_the_way(start: jaxrt.Scene, fit: jaxrt.Fit, spp: int = 64, **how: Any) -> dict[str, np.ndarray]:
    """Pictures of the start and after some steps, where the history has all parameters; `how`: of `jaxrt.render`."""
    shown = {"start": start}
    for k in chosen_steps(len(fit.history["step"])):
        shown[f"step {k + 1}"] = jaxrt.with_params(start, {name: fit.history[name][k] for name in fit.parameters})
    return {title: jaxrt.render(s, spp=spp, method="path", **how).image for title, s in shown.items()}


def keeper(name: str, shape: tuple[int, ...], steps: int, frames: dict[str, Any]) -> Any:
    """A `progress` of `jaxrt.fit` that puts a parameter of many numbers into `frames` after some steps."""
    keep = chosen_steps(steps)

    def kept(step: int, loss: float, values: dict[str, Any]) -> None:
        if step - 1 in keep:
            frames[f"step {step}"] = np.asarray(values[name]).reshape(shape)

    return kept


def write(
    folder: Path,
    seed: int,
    numbers: dict[str, Any],
    curves: dict[str, tuple[Any, Any]],
    strip: dict[str, Any],
) -> None:
    """Writes .json and .png to results/, named as the folder: pictures (radiance or sRGB bytes), curves of loss."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    results = results_of(folder, seed, **numbers)
    fig = plt.figure(figsize=(2.1 * max(len(strip), 3), 4.8), layout="constrained")
    above, below = fig.subfigures(2, 1, height_ratios=(1, 1.1))
    for ax, (title, image) in zip(np.atleast_1d(above.subplots(1, len(strip))), strip.items(), strict=True):
        image = np.asarray(image)
        ax.imshow(image if image.dtype == np.uint8 else to_srgb(image.astype(np.float32)))
        ax.set_title(title, fontsize=8)
        ax.axis("off")
    ax = below.subplots()
    for label, (x, y) in curves.items():
        ax.plot(x, np.abs(y), lw=1, label=label)
    ax.set(xlabel="seconds, compiling included", yscale="log")
    ax.legend(fontsize=8)
    fig.savefig(results / f"{folder.name}.png", dpi=130)
    plt.close(fig)
