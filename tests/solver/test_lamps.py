"""Pixels with the border of a lamp in them, which are taken several times: against the area that the lamp covers."""

import functools

import jax
import numpy as np
from helpers import look_at, world_of

import jaxrt
from jaxrt.solver.lamps import TAKES, borders
from jaxrt.solver.measure import view_of

SIZE, RADIANCE = 16, 3.0
LOW, HIGH = np.array([-0.43, -0.71]), np.array([0.52, 0.29])


@functools.cache
def scene():
    """A square lamp before an orthographic camera that sees [−1, 1]², with something of no light behind it."""
    middle, half = (LOW + HIGH) / 2, (HIGH - LOW) / 2
    lamp = np.diag([*half, 1.0, 1.0])
    lamp[:2, 3] = middle
    shapes = [
        jaxrt.Rectangle(id="lamp", to_world=lamp, emission=RADIANCE, bsdf=jaxrt.Diffuse(0.0)),
        jaxrt.Rectangle(id="wall", to_world=np.diag([2.0, 2.0, 1.0, 1.0])),
    ]
    shapes[1].to_world[2, 3] = -1.0
    film = jaxrt.Film(SIZE, SIZE, "box")
    sensor = jaxrt.Sensor("orthographic", to_world=look_at((0, 0, 5), (0, 0, 0), (0, 1, 0)), film=film)
    return jaxrt.Scene.build(shapes, sensors=[sensor])


def covered():
    """The share of each pixel that the lamp covers, (H, W)."""
    edge = np.linspace(-1.0, 1.0, SIZE + 1)
    share = lambda a, b: np.clip(np.minimum(edge[1:], b) - np.maximum(edge[:-1], a), 0, None) * SIZE / 2
    return share(LOW[1], HIGH[1])[::-1, None] * share(LOW[0], HIGH[0])[None]


def test_pixels_with_a_border_are_found():
    view = jax.tree.map(np.asarray, view_of(scene(), 0))
    numbers = borders(world_of(scene()), view)
    partly = (covered() > 1e-6) & (covered() < 1 - 1e-6)
    assert partly.sum() > 20
    np.testing.assert_array_equal(np.sort(numbers), np.flatnonzero(partly))


def test_they_are_right_and_their_error_is_known():
    spp, seeds, true = 4, 24, RADIANCE * covered()
    found = [jaxrt.render(scene(), spp, seed, max_depth=1) for seed in range(seeds)]
    images = np.stack([sol.image[..., 0] for sol in found]).astype(np.float64)
    partly = (true > 1e-6) & (true < RADIANCE - 1e-6)
    for sol in found:
        assert sol.stats["samples"] == spp * (SIZE**2 + (TAKES - 1) * partly.sum())
        np.testing.assert_array_equal(sol.spp, np.where(partly, TAKES * spp, spp))
    np.testing.assert_allclose(
        images[:, ~partly], np.broadcast_to(true, images.shape)[:, ~partly], rtol=1e-6, atol=1e-6
    )
    off = images[:, partly] - true[partly]
    alone = true[partly] * (RADIANCE - true[partly]) / (spp * TAKES)  # variance of as many independent samples
    assert abs(off.mean()) < 4 * np.sqrt(alone.mean() / off.size)
    assert (off**2).mean() < alone.mean()
    # Standard errors are shared with neighbours, so they are compared over the picture.
    claimed = np.mean([(sol.stderr.astype(np.float64) ** 2).mean() for sol in found])
    assert 0.5 * claimed < ((images - true) ** 2).mean() < 1.5 * claimed
