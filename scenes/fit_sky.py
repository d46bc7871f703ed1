"""Fits the tables of `jaxrt/files/sky.npz` to radiances of the sky and the sun that Mitsuba 3 evaluates.

    python scenes/fit_sky.py [-o jaxrt/files/sky.npz]

Needs Mitsuba with LLVM, and scipy; a few minutes. For every channel, whole turbidity and albedo of 0 and 1 the control
points over the sun's elevation are found together, by least squares of relative errors, each from the solution before.
These leave one number open, by which the scale may be multiplied and C, D, F, G and H divided; between whole
turbidities and albedos it counts, and is found there. Prints errors of radiances that were not fitted.
"""

import argparse
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import least_squares

from jaxrt.files import sky
from jaxrt.sky import radiance

jax.config.update("jax_enable_x64", True)

FILE = Path(__file__).parents[1] / "jaxrt" / "files" / "sky.npz"
ELEVATIONS = np.maximum(np.pi / 2 * (0.5 + 0.5 * np.cos(np.pi * (np.arange(14) + 0.5) / 14)) ** 3, 2e-4)
"""Of the sun, where the sky is fitted: Chebyshev's points of the curve's parameter."""

DIRECTIONS, SCALED, GOOD = 110, [2, 3, 5, 6, 7], 2e-5
START = np.array([-1.1, -0.3, 0.5, 1.5, -2, 0.3, 0.05, 0.4, 0.6])
APERTURE = 20.0
"""Of the sun, degrees, where it is looked at: in float32 Mitsuba knows smaller ones less well."""


def unit(elevation, azimuth=0.0):
    flat = np.cos(elevation)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation) + 0 * azimuth], -1)


def directions(elevation, rng):
    """Above the horizon: a third around the sun, a third near the horizon, a third all over. (N, 3)."""
    k = DIRECTIONS // 3
    gamma, around = np.pi * rng.random((k, 1)) ** 2.5, 2 * np.pi * rng.random((k, 1))
    across = np.cos(around) * unit(elevation + np.pi / 2) + np.sin(around) * [0, 1, 0]
    z = np.concatenate([rng.random(k) ** 4, rng.random(DIRECTIONS - 2 * k)])
    d = np.concatenate(
        [np.cos(gamma) * unit(elevation) + np.sin(gamma) * across, unit(np.arcsin(z), 2 * np.pi * rng.random(len(z)))]
    )
    d[:, 2] = np.abs(d[:, 2]) + 1e-6
    return (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32).astype(float)


def seen(d, **emitter):
    """Radiance that Mitsuba's emitter has from directions d, (N, 3)."""
    import drjit
    import mitsuba

    mitsuba.set_variant("llvm_ad_rgb")
    at = drjit.zeros(mitsuba.SurfaceInteraction3f, len(d))
    at.wi = -mitsuba.Vector3f(*d.T.astype(np.float32))
    return np.array(mitsuba.load_dict({"type": "sunsky", **emitter}).eval(at)).T.astype(float)


class Samples:
    """Radiance (N, 3) of the sky at one turbidity and albedo; cosθ, γ, shares of control points; relative weights."""

    def __init__(self, turbidity, albedo, elevations, rng):
        columns = []
        for elevation in elevations:
            d, sun = directions(elevation, rng), unit(elevation).astype(np.float32).astype(float)
            grey = {"type": "rgb", "value": [float(albedo)] * 3}
            light = seen(d, sun_scale=0.0, sun_direction=sun.tolist(), turbidity=float(turbidity), albedo=grey)
            gamma = np.arctan2(np.linalg.norm(np.cross(d, sun), axis=1), d @ sun)
            weight = 1 / (np.abs(light) + 0.02 * np.abs(light).mean(0))
            columns.append((d[:, 2], gamma, np.tile(sky.bezier(elevation), (len(d), 1)), light, weight))
        self.cos, self.gamma, self.bezier, self.light, self.weight = map(np.concatenate, zip(*columns, strict=True))
        self.light, self.turbidity, self.albedo = np.maximum(self.light, 0), turbidity, albedo

    def of(self, channel):
        return self.cos, self.gamma, self.bezier, self.light[:, channel], self.weight[:, channel]


@jax.jit
def residual(points, cos, gamma, bezier, light, weight):
    """Relative errors of control points, (60,) or (10, 6)."""
    c = points.reshape(10, 6) @ bezier.T
    return jnp.nan_to_num((radiance(c, cos, gamma) - light) * weight, nan=1e3, posinf=1e3, neginf=-1e3)


slopes = jax.jit(jax.jacfwd(residual))


def fitted(start, samples, channel):
    """Control points (10, 6), and the root mean square of their errors."""
    data = samples.of(channel)
    first = start.copy()
    first[9] *= np.abs(data[3]).mean() / np.abs(radiance(start @ data[2].T, data[0], data[1], np)).mean()
    call = lambda f: lambda q: np.nan_to_num(np.asarray(f(q, *data)))
    best = least_squares(
        call(residual), first.ravel(), call(slopes), method="lm", x_scale="jac", xtol=1e-12, max_nfev=500
    )
    return best.x.reshape(10, 6), np.sqrt(np.mean(best.fun**2))


def search(samples, starts, channel, rng):
    """The best of a few fits: from `starts`, then from numbers around the usual ones."""
    found = (np.zeros((10, 6)), np.inf)
    for attempt in range(40):
        if found[1] < GOOD:
            break
        q = np.append(START * (1 + 0.3 * rng.standard_normal(9)), 1.0)
        start = starts[attempt] if attempt < len(starts) else np.repeat(q[:, None], 6, 1)
        found = min(found, fitted(start, samples, channel), key=lambda f: f[1])
    return found


def rescaled(table, powers):
    """Of control points (turbidity, albedo, 10, 6), with scales times exp of `powers` (turbidity, albedo)."""
    factor, table = np.exp(powers)[..., None, None], table.copy()
    table[:, :, 9:] *= factor
    table[:, :, SCALED] /= factor
    return table


def between(table, samples):
    black, white = sky.at_turbidity(table, samples.turbidity)
    return black + (white - black) * samples.albedo


def fit(channel, whole, parts, rng):
    """Control points of a channel (turbidity, albedo, 10, 6). `whole`, `parts`: samples at such turbidities and
    albedos, and at others."""
    table, done = np.zeros((10, 2, 10, 6)), []
    for at in [(t, a) for a in (0, 1) for t in (2, 3, 4, 5, 6, 7, 8, 9, 1, 0)]:
        near = sorted(done, key=lambda b: abs(b[0] - at[0]) + 2 * abs(b[1] - at[1]))[:2]
        table[at], error = search(whole[at], [table[b] for b in near], channel, rng)
        print(f"channel {channel} turbidity {at[0] + 1} albedo {at[1]}: {error:.1e}", flush=True)
        done.append(at)
    scale = lambda powers: rescaled(table, powers.reshape(10, 2))
    errors = lambda powers: np.concatenate(
        [residual(between(scale(powers), s), *s.of(channel)) for s in parts] + [1e-3 * powers[:1]]
    )
    start = -np.log(np.abs(table[:, :, 9]).mean(-1))
    return scale(least_squares(errors, (start - start[0, 0]).ravel()).x)


def sun():
    """Irradiance across the sun's light (turbidity, elevation, channel)."""
    found = np.zeros((10, 30, 3))
    for t, k in np.ndindex(10, 30):
        way = unit(np.radians(sky.FIRST + sky.STEP * k))
        given = {"sky_scale": 0.0, "sun_aperture": APERTURE, "turbidity": t + 1.0, "sun_direction": way.tolist()}
        found[t, k] = seen(way[None], **given)[0]
    return found * (4 * np.pi * np.sin(np.radians(APERTURE / 4)) ** 2)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=FILE)
    asked, rng = parser.parse_args(), np.random.default_rng(1)
    whole = {(t, a): Samples(t + 1, a, ELEVATIONS, rng) for t in range(10) for a in (0, 1)}
    parts = [
        Samples(t, a, ELEVATIONS[::2], rng) for t in np.arange(1, 10.5, 0.5) for a in (0, 0.5, 1) if t % 1 or a % 1
    ]
    table = np.stack([fit(channel, whole, parts, rng) for channel in range(3)], 2)
    np.savez_compressed(asked.output, sky=table.astype(np.float32), sun=sun().astype(np.float32))
    off = []
    for _ in range(300):
        s = Samples(rng.uniform(1, 10), rng.random(), [np.pi / 2 * rng.random() ** 2], rng)
        for channel in range(3):
            model = radiance(between(table[:, :, channel], s) @ s.bezier.T, s.cos, s.gamma, np)
            light = s.light[:, channel]
            off.append(np.abs(model - light) / np.maximum(light, 0.05 * light.mean()))
    print(f"errors of what was not fitted: at most {np.max(off):.1e}, {np.mean(off):.1e} in the mean")


if __name__ == "__main__":
    main()
