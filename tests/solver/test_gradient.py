"""Derivatives of pictures: closed forms, central differences with the same numbers, forward against reverse."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import WALLS, box_room, camera, frame, icosphere, look_at, mean_and_error, moved

import jaxrt

pytestmark = pytest.mark.usefixtures("short_loops")

KEYS = 8
INTERIOR = {"rr_depth": 1000, "boundary": False}  # how what is seen changes has tests of its own


def batches(seed=0, n=KEYS):
    return jax.random.split(jax.random.key(seed), n)


def total(image):
    """A number of a picture in which every pixel counts differently."""
    weight = 1.0 + 0.5 * np.sin(np.arange(image.size, dtype=np.float32)).reshape(image.shape)
    return jnp.mean(image * weight)


@functools.partial(jax.jit, static_argnames=("plan", "spp", "max_depth"))
def _value(values, scene, keys, plan, spp, max_depth):
    f = lambda key: total(
        jaxrt.measure(jaxrt.with_params(scene, values), key, plan=plan, spp=spp, max_depth=max_depth, **INTERIOR)
    )
    return jax.vmap(f)(keys)


@functools.partial(jax.jit, static_argnames=("plan", "spp", "max_depth"))
def _slope(values, scene, keys, plan, spp, max_depth):
    """Reverse mode: for each key, the value and its gradient."""
    f = lambda values, key: total(
        jaxrt.measure(jaxrt.with_params(scene, values), key, plan=plan, spp=spp, max_depth=max_depth, **INTERIOR)
    )
    return jax.vmap(jax.value_and_grad(f), (None, 0))(values, keys)


@functools.partial(jax.jit, static_argnames=("plan", "spp", "max_depth"))
def _along(values, tangents, scene, keys, plan, spp, max_depth):
    """Forward mode: for each key, the value and its derivative along `tangents`."""
    f = lambda values, key: total(
        jaxrt.measure(jaxrt.with_params(scene, values), key, plan=plan, spp=spp, max_depth=max_depth, **INTERIOR)
    )
    return jax.vmap(lambda key: jax.jvp(lambda v: f(v, key), (values,), (tangents,)))(keys)


class Setting:
    """A scene with the parameters that move in it; one program each for values, reverse and forward mode.

    `loop`: whether values have a program of their own, which pictures are made with; else forward mode gives them.
    """

    def __init__(self, scene, names, spp, max_depth, plan=None, loop=False):
        self.scene, self.plan, self.spp, self.max_depth = scene, plan or jaxrt.plan(scene), spp, max_depth
        self.loop = loop
        self.values = {k: v for k, v in jaxrt.params(scene).items() if k in names}
        assert set(self.values) == set(names)

    def value(self, changes=None, keys=None):
        values = self.values | {k: jnp.asarray(v, jnp.float32) for k, v in (changes or {}).items()}
        keys = batches() if keys is None else keys
        if not self.loop:
            return self.forward(values, {}, keys)[0]
        return np.asarray(_value(values, self.scene, keys, self.plan, self.spp, self.max_depth), np.float64)

    @functools.cached_property
    def slope(self):
        """Gradients by name, with an axis of keys first."""
        value, grad = _slope(self.values, self.scene, batches(), self.plan, self.spp, self.max_depth)
        for leaf in jax.tree.leaves(grad):
            assert np.isfinite(leaf).all()
        np.testing.assert_allclose(value, self.value(), rtol=1e-4)  # two drivers of one bounce
        return jax.tree.map(lambda a: np.asarray(a, np.float64), grad)

    def forward(self, values, tangents, keys):
        tangents = {k: jnp.zeros_like(v) for k, v in values.items()} | tangents
        value, slope = _along(values, tangents, self.scene, keys, self.plan, self.spp, self.max_depth)
        return np.asarray(value, np.float64), np.asarray(slope, np.float64)

    def along(self, tangents):
        tangents = {k: jnp.asarray(v, jnp.float32) for k, v in tangents.items()}
        value, slope = self.forward(self.values, tangents, batches())
        assert np.isfinite(slope).all()
        if self.loop:
            np.testing.assert_allclose(value, self.value(), rtol=1e-4)  # two drivers of one bounce
        return slope

    def difference(self, name, direction, h):
        """Central difference along a direction of one parameter, with the same random numbers."""
        direction = np.asarray(direction, np.float32)
        at = np.asarray(self.values[name])
        plus, minus = at + np.float32(h) * direction, at - np.float32(h) * direction
        return (self.value({name: plus}) - self.value({name: minus})) / (2 * h)

    def pulled(self, name, direction):
        return (self.slope[name] * np.asarray(direction)).reshape(KEYS, -1).sum(1)


def agree(a, b, relative, sigmas=4.5):
    """Two estimates of a number, by the same keys, differ by chance alone; and are good enough to tell."""
    mean, error = mean_and_error(np.asarray(a) - np.asarray(b))
    scale = abs(np.mean(b))
    assert error < relative * scale, (error, scale)
    assert abs(mean) < sigmas * error + 1e-3 * relative * scale, (mean, error, scale)


# ------------------------------------------------------------------------------------ the furnace, exactly


def furnace():
    scene = box_room(0.5, {k: 1.5 for k in WALLS}, sensors=[camera((0.3, -0.4, 0.2), (-0.5, 0.6, 0.7), 4, 4, 90.0)])
    return scene, jaxrt.plan(scene, light_sampling=False)


FURNACE = furnace()


def furnace_mean(rho, key=3, depth=3):
    scene, plan = FURNACE
    scene = jaxrt.with_params(scene, {"wall.reflectance": rho})
    return jnp.mean(jaxrt.measure(scene, key, plan=plan, spp=4, max_depth=depth, rr_depth=1000))


def test_first_and_second_derivative_of_a_furnace():
    """L = Le (1 + ρ + ρ²) for every sample, so L' = Le (1 + 2ρ) and L'' = 2 Le."""
    value, slope, bend = jax.jit(
        lambda r: (
            furnace_mean(r),
            jax.grad(furnace_mean)(r),
            jax.jvp(jax.grad(furnace_mean), (r,), (jnp.ones(()),))[1],
        )
    )(jnp.float32(0.5))
    np.testing.assert_allclose([value, slope, bend], [1.5 * 1.75, 1.5 * 2.0, 1.5 * 2.0], rtol=1e-5)


def test_batches_of_scenes_and_keys():
    """vmap over a parameter and over keys."""
    rho = jnp.array([0.0, 0.2, 0.5, 0.9])
    images = jax.jit(jax.vmap(furnace_mean, (0, 0)))(rho, batches(1, 4))
    np.testing.assert_allclose(images, 1.5 * (1 + rho + rho**2), rtol=1e-5)


def test_derivatives_without_a_limit_of_depth_are_refused():
    for differentiate in (jax.grad, lambda f: lambda x: jax.jvp(f, (x,), (jnp.ones(()),))):
        with pytest.raises(ValueError, match="max_depth"):
            jax.eval_shape(differentiate(lambda r: furnace_mean(r, depth=-1)), jnp.float32(0.5))


# -------------------------------------------------------- reflectance, radiance, roughness and index in a box


WHITE = jaxrt.Diffuse(0.5, id="white")


@functools.cache
def box():
    """A box with red-ish walls in grey, a lit ceiling, a lamp that is off, a rough metal wall and a ball of metal."""
    bsdfs = {"left": jaxrt.Diffuse(0.6, id="red"), "right": jaxrt.Diffuse(0.3, id="green")}
    bsdfs |= {k: WHITE for k in ("floor", "ceiling", "back")} | {
        "front": jaxrt.Conductor(0.4, 0.9, 2.5, 0.9, id="metal")
    }
    lamp = jaxrt.Rectangle(
        id="lamp", to_world=moved(0.3, (0.4, 0.5, -0.4), frame((-0.5, 0.2, 0.6), (1, 0, 0))), emission=0.0
    )
    sensor = camera((0.2, -0.9, 0.1), (0.1, 0.9, -0.1), 16, 16, 70.0)
    scene = box_room(bsdfs=bsdfs, emission={"ceiling": 1.0}, others=[lamp], sensors=[sensor])
    names = ["red.reflectance", "white.reflectance", "ceiling.emitter.radiance", "lamp.emitter.radiance"]
    return Setting(
        scene, [*names, "metal.alpha", "metal.eta", "metal.k", "metal.specular_reflectance"], 8, 3, loop=True
    )


@pytest.mark.parametrize("name", ["red.reflectance", "white.reflectance", "metal.specular_reflectance"])
def test_reflectance(name):
    """Of degree 2 in a reflectance at depth 3, where sampling does not depend on it: central differences are exact."""
    got, want = box().slope[name][:, 0], box().difference(name, [1.0], 0.05)
    np.testing.assert_allclose(got, want, rtol=2e-4, atol=2e-5)  # rounding of 1e-7 over 0.05, and of the mean
    assert (want > 0.005).all()


def test_radiance_is_linear():
    """Where pictures are sums over lamps, Σ radiance · ∂I/∂radiance is the picture itself."""
    np.testing.assert_allclose(box().slope["ceiling.emitter.radiance"][:, 0] * 1.0, box().value(), rtol=1e-4)


def test_a_lamp_that_is_off_has_a_derivative():
    """By linearity it is the picture with that lamp alone at 1; the structural plan keeps the lamp."""
    got = box().slope["lamp.emitter.radiance"][:, 0]
    alone = box().value({"lamp.emitter.radiance": [1.0], "ceiling.emitter.radiance": [0.0]}, batches(5))
    (a, da), (b, db) = mean_and_error(got), mean_and_error(alone)
    # One sample in forty goes to a lamp that is off: its derivative is noisy, and not 0.
    assert a > 8 * da and da < 0.1 * a
    assert abs(a - b) < 4.5 * np.hypot(da, db)


@pytest.mark.parametrize("name, h", [("metal.eta", 0.02), ("metal.k", 0.02)])
def test_index_of_refraction(name, h):
    got, want = box().slope[name][:, 0], box().difference(name, [1.0], h)
    np.testing.assert_allclose(got, want, rtol=5e-3, atol=2e-5)  # the third derivative times h²/6
    assert np.abs(want).min() > 1e-3


def test_roughness():
    """Directions drawn from the lobe move in the difference and are held fixed in the derivative: alike in the mean."""
    agree(box().slope["metal.alpha"], box().difference("metal.alpha", 1.0, 0.04), 0.1)


def test_forward_is_reverse():
    """⟨c, J v⟩ = ⟨Jᵀ c, v⟩ for every key, along a direction in all parameters at once."""
    rng = np.random.default_rng(2)
    v = {k: rng.normal(size=np.shape(a)) for k, a in box().values.items()}
    pulled = sum(box().pulled(k, v[k]) for k in v)
    np.testing.assert_allclose(box().along(v), pulled, rtol=1e-4, atol=1e-5)


# ------------------------------------------------------------- geometry of direct light, in closed form
# A camera far above, with so narrow a field of view that it sees one point of the floor, x = (0, 0, 0), under three
# lamps. L = ρ/π E(x), and E is known: polygons by Lambert, the ball by its solid angle.

SQUARE, TRIANGLE, BALL = moved(0.4, (1.0, 0.3, 1.2), frame((-0.6, -0.2, -1), (1, 0, 0))), None, None
TRIANGLE = np.array([[-1.4, -0.2, 0.8], [-1.2, 0.9, 1.3], [-0.6, -0.4, 1.1]], np.float32).astype(float)
BALL = np.array([0.3, -1.5, 1.0]), 0.4
FLOOR = np.array([[-3, -3, 0], [3, -3, 0], [0, 5, 0]], float)
RHO = 0.6


def lambert(x, n, corners):
    v = corners - x
    out = 0.0
    for a, b in zip(v, np.roll(v, -1, 0), strict=True):
        c = np.cross(a, b)
        out += np.arctan2(np.linalg.norm(c), a @ b) * (c / np.linalg.norm(c)) @ n
    return abs(out) / 2


def exact(p):
    """L at the point of the floor on the z axis, from parameters as in the scene."""
    a, b, c = p["floor.vertices"]
    n = np.cross(b - a, c - a)
    n /= np.linalg.norm(n)
    x = np.array([0, 0, (a @ n) / n[2]])
    m = p["square.to_world"]
    corners = np.array([m[:3, 3] + s * m[:3, 0] + t * m[:3, 1] for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    d = p["ball.center"] - x
    e = lambert(x, n, corners) + 2 * lambert(x, n, p["triangle.vertices"])
    e += 0.5 * np.pi * p["ball.radius"] ** 2 * (d @ n) / np.linalg.norm(d) ** 3
    return RHO / np.pi * e


@functools.cache
def under_lamps():
    black = jaxrt.Diffuse(0.0, id="black")
    shapes = [
        jaxrt.Mesh(id="floor", vertices=FLOOR, faces=[[0, 1, 2]], bsdf=jaxrt.Diffuse(RHO, id="grey")),
        jaxrt.Rectangle(id="square", to_world=SQUARE, emission=1.0, bsdf=black),
        jaxrt.Mesh(id="triangle", vertices=TRIANGLE, faces=[[0, 1, 2]], emission=2.0, bsdf=black),
        jaxrt.Sphere(id="ball", center=BALL[0], radius=BALL[1], emission=0.5, bsdf=black),
    ]
    sensor = camera((0, 0, 5), (0, 0, 0), 16, 16, 1e-3, up=(0, 1, 0))
    names = ["floor.vertices", "square.to_world", "triangle.vertices", "ball.center", "ball.radius"]
    return Setting(jaxrt.Scene.build(shapes, sensors=[sensor]), names, 64, 2, loop=True)


def plain():
    """What `total` makes of a constant picture of 1, 16 x 16."""
    return float(np.mean(1.0 + 0.5 * np.sin(np.arange(256, dtype=np.float32))))


def test_the_lamps_light_the_floor():
    p = {k: np.asarray(v, np.float64) for k, v in under_lamps().values.items()}
    mean, error = mean_and_error(under_lamps().value() / plain())
    assert error < 2e-3 * mean
    assert abs(mean - exact(p)) < 4.5 * error


MOVES = {
    "square moved": ("square.to_world", lambda r: np.pad(r.normal(size=(3, 1)), ((0, 1), (3, 0)))),
    "square turned and stretched": ("square.to_world", lambda r: np.pad(r.normal(size=(3, 3)), ((0, 1), (0, 1)))),
    "a triangle's vertex": ("triangle.vertices", lambda r: np.eye(3)[1][:, None] * r.normal(size=3)),
    "all of a triangle": ("triangle.vertices", lambda r: r.normal(size=(3, 3))),
    "ball moved": ("ball.center", lambda r: r.normal(size=3)),
    "ball blown up": ("ball.radius", lambda r: np.array(1.0)),
    "floor lifted": ("floor.vertices", lambda r: np.tile([0, 0, 1.0], (3, 1))),
    "floor tilted": ("floor.vertices", lambda r: np.array([[0, 0, -1.0], [0, 0, 1.0], [0, 0, 0.3]])),
    "floor slid": ("floor.vertices", lambda r: np.tile([0.7, -0.4, 0], (3, 1))),
}


@pytest.mark.parametrize("move", MOVES)
def test_geometry_of_direct_light(move):
    """Vertices and poses of lamps and of what they light, where nothing occludes."""
    name, make = MOVES[move]
    direction = make(np.random.default_rng(4))
    p = {k: np.asarray(v, np.float64) for k, v in under_lamps().values.items()}
    h = 1e-5
    want = (exact(p | {name: p[name] + h * direction}) - exact(p | {name: p[name] - h * direction})) / (2 * h)
    mean, error = mean_and_error(under_lamps().along({name: direction}) / plain())
    if move == "floor slid":
        assert want == pytest.approx(0, abs=1e-9)
    else:
        assert error < 0.03 * max(abs(want), 0.02)  # of a picture of .12
    assert abs(mean - want) < 4.5 * error + 1e-6


# --------------------------------------------------------------- geometry where no edge of visibility moves


@functools.cache
def gloss():
    """A rough metal floor that fills the picture, under an even sky: radiance depends on the angle of view alone."""
    floor = jaxrt.Rectangle(id="floor", to_world=moved(20.0), bsdf=jaxrt.Conductor(0.5, id="metal"))
    sensor = camera((0, -2, 1.0), (0, 0, 0), 16, 16, 10.0)
    scene = jaxrt.Scene.build([floor], sensors=[sensor], enclosure=jaxrt.Enclosure(1.0))
    return Setting(scene, ["floor.to_world", "sensor.to_world"], 16, 2)


def turned(m, axis, angle):
    """A pose turned about an axis through the origin."""
    k = np.cross(np.eye(3), np.asarray(axis, float))
    r = np.eye(4)
    r[:3, :3] = np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k
    return r @ m


@pytest.mark.parametrize("axis", [(1, 0, 0), (0.8, 0.6, 0)])
def test_a_tilted_glossy_floor(axis):
    """∂/∂(angle) of the floor's pose, and of the camera's about the same axis, which is the same but for its sign."""
    setting, h = gloss(), 0.02
    pose = {k: np.asarray(v, np.float64) for k, v in setting.values.items()}
    slope = {k: (turned(m, axis, 1e-6) - turned(m, axis, -1e-6)) / 2e-6 for k, m in pose.items()}
    difference = setting.value({"floor.to_world": turned(pose["floor.to_world"], axis, h)})
    difference = (difference - setting.value({"floor.to_world": turned(pose["floor.to_world"], axis, -h)})) / (2 * h)
    assert abs(difference.mean()) > 0.05
    agree(setting.along({"floor.to_world": slope["floor.to_world"]}), difference, 0.05)
    agree(-setting.along({"sensor.to_world": slope["sensor.to_world"]}), difference, 0.05)


@functools.cache
def hollow():
    """Inside a shining rough metal ball: smooth, closed, without edges. Three bounces."""
    ball = jaxrt.Sphere(
        id="ball", center=(0.1, 0.2, 0.3), radius=2.0, flip_normals=True, emission=1.0,
        bsdf=jaxrt.Conductor(0.9, id="metal"),
    )  # fmt: skip
    scene = jaxrt.Scene.build([ball], sensors=[camera((1.0, -0.5, 0.0), (-1, 1, 0.5), 16, 16, 60.0)])
    return Setting(scene, ["ball.center", "ball.radius"], 16, 4)


@pytest.mark.parametrize("name, direction", [("ball.center", (0.8, -0.5, 0.3)), ("ball.radius", 1.0)])
def test_inside_a_smooth_room(name, direction):
    agree(hollow().along({name: direction}), hollow().difference(name, direction, 0.05), 0.15)


@functools.cache
def crystal():
    """A convex room of 20 facets, each as bright and as grey as the others: L = Le (1 − ρ³)/(1 − ρ) whatever its shape."""
    v, f = icosphere(0)
    room = jaxrt.Mesh(
        id="room",
        vertices=v * [1.0, 1.2, 0.9],
        faces=f[:, ::-1].copy(),
        emission=1.0,
        bsdf=jaxrt.Diffuse(0.5, id="wall"),
    )
    scene = jaxrt.Scene.build([room], sensors=[camera((0.1, -0.2, 0.1), (1, 1, 0.2), 16, 16, 60.0)])
    return Setting(scene, ["room.vertices"], 16, 3, jaxrt.plan(scene, light_sampling=False))


def test_an_even_room_does_not_change_with_its_shape():
    """Single samples do, by their cosines, and cancel."""
    rng = np.random.default_rng(6)
    for _ in range(4):
        direction = rng.normal(size=(12, 3))
        mean, error = mean_and_error(crystal().along({"room.vertices": direction}))
        assert 1e-5 < error < 0.05  # of a picture of 1.75, for a step of length 6
        assert abs(mean) < 5 * error


# ------------------------------------------------------------------------------------------ nothing infinite


@pytest.mark.slow
def test_every_derivative_of_everything_is_finite():
    """All leaves of a scene with every kind of face, lobe and lamp: grazing, behind, inside, missing, at edges."""
    v, f = icosphere(0)
    metal, rough = jaxrt.Conductor(0.0, 0.2, 3.9), jaxrt.TwoSided(jaxrt.Conductor((0.1, 0.4), 0.2, 3.9))
    shapes = [
        jaxrt.Mesh(vertices=v * 0.5 + [-1.5, 0, 0], faces=f, normals=v, bsdf=rough),
        jaxrt.Mesh(vertices=[[0, 0, 0], [0, 0, 0], [1, 0, 0]], faces=[[0, 1, 2]]),  # without area
        jaxrt.Rectangle(to_world=moved(4.0, (0, 0, -1)), bsdf=jaxrt.Diffuse([0.2, 0.5])),
        jaxrt.Rectangle(to_world=moved(0.5, (0, 0, 2), frame((0, 0, -1), (1, 0, 0))), emission=[3.0, 0.0]),
        jaxrt.Rectangle(to_world=moved(0.5, (0, 1.5, -1 + 1e-6)), emission=0.0),  # off, and lying on the floor
        jaxrt.Disk(to_world=moved(0.6, (1.5, 1, 0.3), frame((-1, 0, 0.3), (0, 1, 0))), bsdf=metal),
        jaxrt.Sphere(center=(1.5, -0.5, -0.4), radius=0.6, bsdf=metal),
        jaxrt.Sphere(center=(0, 0, 0), radius=0.2, emission=2.0, bsdf=jaxrt.Diffuse(0.0)),
        jaxrt.Cylinder(p0=(0.5, 1, -1), p1=(0.5, 1, 0.5), radius=0.2, bsdf=rough, emission=0.3),
    ]
    film = jaxrt.Film(9, 7, "gaussian")
    pose = look_at((0.2, -4, 1), (0, 0, 0))
    sensor = jaxrt.Sensor("thinlens", pose, fov=60, film=film, aperture_radius=0.05, focus_distance=3.0)
    scene = jaxrt.Scene.build(shapes, sensors=[sensor], enclosure=jaxrt.Enclosure([0.1, 0.2]))
    plan = jaxrt.plan(scene)

    @jax.jit
    def gradient(scene):
        return eqx.filter_grad(lambda s: jnp.sum(jaxrt.measure(s, 0, plan=plan, spp=16, max_depth=5, boundary=False)))(
            scene
        )

    out = gradient(scene)
    names = ["vertices", "normals", "patches", "to_world", "materials", "radiance", "sensor_to_world", "lens"]
    for name in names:
        leaf = np.asarray(getattr(out, name))
        assert np.isfinite(leaf).all(), name
        assert np.abs(leaf).max() > 0, name


def test_a_black_surface_can_be_left():
    """d/dρ at ρ = 0: the path ends in value but not in derivative."""
    floor = jaxrt.Rectangle(to_world=moved(5.0, (0, 0, 0)), bsdf=jaxrt.Diffuse(0.0, id="paint"))
    scene = jaxrt.Scene.build([floor], enclosure=jaxrt.Enclosure(1.0))
    f = lambda r: jaxrt.radiance(jaxrt.with_params(scene, {"paint.reflectance": r}), (0, 0, 1), (0, 0, -1), max_depth=2)
    np.testing.assert_allclose(jax.jit(jax.jacrev(f))(jnp.zeros(1)), [[1.0]], rtol=1e-5)
    np.testing.assert_allclose(jax.jit(f)(jnp.full(1, 0.6)), [0.6], rtol=1e-5)  # constants in a caller's program


@pytest.mark.slow
def test_irradiance_under_a_lamp_that_rises():
    """dE/dz by Lambert's formula for a square on its axis, in the lamp's height and in the meter's."""
    lamp = moved(0.5, (0, 0, 1), frame((0, 0, -1), (1, 0, 0)))
    floor = jaxrt.Rectangle(to_world=moved(5.0, (0, 0, -1)))
    scene = jaxrt.Scene.build([floor, jaxrt.Rectangle(id="lamp", emission=1.0, to_world=lamp)])

    def meter(z, height):
        pose = jnp.asarray(lamp, jnp.float32).at[2, 3].set(z)
        moved_scene = jaxrt.with_params(scene, {"lamp.to_world": pose})
        at = jnp.stack([0.0, 0.0, height])
        return jaxrt.irradiance(moved_scene, at, jnp.asarray([0.0, 0, 1]), spp=4096, max_depth=1, plan=scene.plan)[0]

    def exact(z):
        x = 0.5 / np.hypot(z, 0.5)
        return 4 * x * np.arctan(x)

    want = (exact(0.701) - exact(0.699)) / 0.002
    up, down = jax.jit(jax.grad(meter, (0, 1)))(1.0, 0.3)
    assert float(up) == pytest.approx(want, rel=3e-3) and float(down) == pytest.approx(-want, rel=3e-3)


@pytest.mark.slow
def test_a_tube_of_light_that_tilts():
    """dE/dz of one end of an outward tube over a meter: central differences with the same numbers."""
    tube = jaxrt.Cylinder(id="tube", p0=(-1, 0, 1), p1=(1, 0, 1.2), radius=0.3, emission=1.0, bsdf=jaxrt.Diffuse(0.0))
    floor = jaxrt.Rectangle(to_world=moved(5.0, (0, 0, -1)))
    scene = jaxrt.Scene.build([tube, floor])
    o, n = np.broadcast_to([0.2, 0.1, 0.0], (64, 3)), np.broadcast_to([0, 0, 1.0], (64, 3))

    def mean(z):
        tilted = jaxrt.with_params(scene, {"tube.p0": jnp.stack([-1.0, 0.0, z])})
        return jaxrt.irradiance(tilted, o, n, spp=1024, max_depth=1, plan=scene.plan).mean()

    both = jax.jit(lambda z: jax.jvp(mean, (z,), (1.0,)))
    h = 0.02
    difference = (both(1 + h)[0] - both(1 - h)[0]) / (2 * h)
    assert float(both(1.0)[1]) == pytest.approx(float(difference), rel=0.02)
