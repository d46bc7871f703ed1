"""Two readings of one BRDF: the sensitivity f_r(·, ω_e) to light for a fixed view, and the beam f_r(ω_i, ·) that a
fixed light becomes. By reciprocity they are one curve. Writes results/brdf_readings.png and .json (machine, versions).

    python experiments/brdf_readings/run.py [--quick] [--alpha 0.3] [--angle 40]
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from jaxrt import brdf
from jaxrt.vector import Spectrum, Vec3

sys.path.insert(0, str(Path(__file__).parent.parent))
from peer import results_of


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--alpha", type=float, default=0.3, help="GGX roughness")
    parser.add_argument("--angle", type=float, default=40.0, help="polar angle of the fixed direction, degrees")
    parser.add_argument("--quick", action="store_true", help="fewer angles")
    args = parser.parse_args()
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    one = Spectrum((1.0,))
    material = brdf.Material(alpha=(args.alpha, args.alpha), reflectance=one, eta=one * 0.2, k=one * 3.9)
    theta = np.deg2rad(args.angle)
    fixed = Vec3(jnp.float32(-np.sin(theta)), jnp.float32(0.0), jnp.float32(np.cos(theta)))
    angles = np.linspace(-np.pi / 2, np.pi / 2, 181 if args.quick else 721)[1:-1]

    def both(a: jax.Array) -> tuple[jax.Array, jax.Array]:
        w = Vec3(jnp.sin(a), 0.0 * a, jnp.cos(a))
        value = lambda wi, wo: brdf.eval(("ggx",), material, wi, wo).channels[0]
        return value(w, fixed), value(fixed, w)

    sensitivity, beam = jax.vmap(both)(jnp.asarray(angles, jnp.float32))
    difference = float(jnp.abs(sensitivity - beam).max() / beam.max())

    figure, axes = plt.subplots(1, 2, subplot_kw={"projection": "polar"}, figsize=(10, 4.2))
    titles = ("sensitivity $f_r(\\cdot, \\omega_e)$", "reflected beam $f_r(\\omega_i, \\cdot)$")
    for ax, curve, title, arrow in zip(axes, (sensitivity, beam), titles, ("view", "light"), strict=True):
        ax.plot(angles, np.asarray(curve))
        ax.plot([-theta, -theta], [0, float(beam.max())], "k--", lw=1)
        ax.annotate(arrow, (-theta, float(beam.max()) * 1.05), ha="center")
        ax.set_theta_zero_location("N")
        ax.set_theta_direction(-1)
        ax.set_thetamin(-90)
        ax.set_thetamax(90)
        ax.set_title(title)
    figure.suptitle(f"GGX, α = {args.alpha:g}: the two differ by {difference:.1e} of the peak (sr⁻¹)")
    results = results_of(Path(__file__).parent, alpha=args.alpha, angle=args.angle, difference=difference)
    figure.savefig(results / "brdf_readings.png", dpi=120, bbox_inches="tight")
    print(f"largest difference between the two readings: {difference:.2e} of the peak; {results / 'brdf_readings.png'}")


if __name__ == "__main__":
    main()
