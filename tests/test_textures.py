"""Textures, environment maps and materials made of others: derivatives, densities, names, and what a plan has of them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import camera, moved, picture

import jaxrt
from jaxrt.environment import Environment
from jaxrt.texture import Place, Textures
from jaxrt.vector import Vec3

pytestmark = pytest.mark.usefixtures("short_loops")
COLOURS = np.random.default_rng(2).uniform(0.1, 0.9, (3, 4, 3))


def table(bsdf, enclosure=None, **more):
    """A square seen from above, below a lamp."""
    lamp = jaxrt.Rectangle(
        id="lamp", to_world=moved(0.3, (0.5, 0, 2), np.diag([1.0, -1, -1])), emission=[5.0, 4.0, 3.0]
    )
    floor = jaxrt.Rectangle(id="floor", bsdf=bsdf)
    return jaxrt.Scene.build(
        [floor, lamp], sensors=[camera((0.3, -1, 3), (0, 0, 0), 6, 6, 35.0)], enclosure=enclosure, channels=3, **more
    )


def mean(scene, plan, spp=64):
    return picture(scene, jax.random.key(0), plan, spp=spp, max_depth=2).mean()


def slope(scene, name, direction, plan):
    """Derivative of a picture's mean along a direction of one parameter, and the difference of a step."""
    value = jaxrt.params(scene)[name]
    along = lambda t: mean(jaxrt.with_params(scene, {name: value + t * direction}), plan)
    return jax.jvp(along, (0.0,), (1.0,))[1], (along(0.01) - along(-0.01)) / 0.02


@pytest.mark.parametrize("filter", ["nearest", "bilinear"])
def test_derivatives_with_respect_to_a_picture(filter):
    scene = table(jaxrt.Diffuse(jaxrt.Bitmap(COLOURS, filter=filter), id="paint"))
    plan, name = jaxrt.plan(scene), "paint.reflectance.data"
    assert jaxrt.params(scene)[name].shape == (3, 4, 3)
    np.testing.assert_allclose(jaxrt.params(scene)[name], COLOURS, rtol=1e-6)
    direction = np.random.default_rng(1).normal(size=(3, 4, 3)).astype(np.float32)
    got, want = slope(scene, name, direction, plan)  # the picture is linear in it
    assert float(got) == pytest.approx(float(want), rel=2e-3)
    grad = jax.grad(lambda v: mean(jaxrt.with_params(scene, {name: v}), plan))(jnp.asarray(COLOURS, jnp.float32))
    assert float((grad * direction).sum()) == pytest.approx(float(got), rel=1e-4)


@pytest.mark.slow
def test_a_product_is_that_of_its_factors_at_each_point():
    """A picture times colours of vertices that do not vary, on paint and on a lamp, is a picture of products."""
    square = {"vertices": [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], "faces": [[0, 1, 2], [0, 2, 3]]}
    square |= {"uvs": [[0, 0], [1, 0], [1, 1], [0, 1]], "attributes": {"vertex_color": np.tile([0.5, 0.25, 1], (4, 1))}}
    lamp = square | {"emission_id": "lamp", "to_world": moved(0.5, (0.9, 0.2, 1), np.diag([-1.0, 1, -1]))}
    sensors = [camera((0.3, -1, 3), (0, 0, 0), 6, 6, 35.0)]

    def seen(texture):
        shapes = [jaxrt.Mesh(bsdf=jaxrt.Diffuse(texture, id="paint"), **square), jaxrt.Mesh(emission=texture, **lamp)]
        scene = jaxrt.Scene.build(shapes, sensors=sensors)
        return scene, picture(scene, jax.random.key(0), jaxrt.plan(scene), spp=16, max_depth=3)

    tint = jaxrt.MeshAttribute("vertex_color")
    scene, got = seen(jaxrt.Product(jaxrt.Bitmap(COLOURS), tint))
    _, want = seen(jaxrt.Bitmap(COLOURS * np.array([0.5, 0.25, 1])))
    np.testing.assert_allclose(got, want, rtol=1e-4, atol=1e-6)
    assert float(got.max()) > 0.01
    assert {"paint.reflectance.first.data", "paint.reflectance.second.data"} <= set(jaxrt.params(scene))
    assert {f"texture:{kind}" for kind in ("product", "bitmap", "attribute")} <= jaxrt.plan(scene).effects
    with pytest.raises(jaxrt.SceneError, match="two textures, not Product"):
        jaxrt.Product(tint, jaxrt.Product(tint, tint))


def test_pictures_in_a_checkerboard():
    """What a square shows is that picture by the surface's coordinates, and a parameter by itself."""
    inner = jaxrt.Checkerboard(0.1, jaxrt.Bitmap(COLOURS, filter="nearest"), to_uv=[[2, 0, 0], [0, 2, 0]])
    board = jaxrt.Checkerboard(inner, 0.7)
    scene = table(jaxrt.Diffuse(board, id="paint"))
    plan, name = jaxrt.plan(scene), "paint.reflectance.color0.color1.data"
    assert (plan.nested, plan.textures) == (2, ("bitmap", "checkerboard"))
    assert "nested" in plan.effects
    assert jaxrt.params(scene)[name].shape == (3, 4, 3)
    assert "paint.reflectance.color0" not in jaxrt.params(scene)
    looked_up = Textures.of(scene, 3, plan.textures, plan.nested)
    u, v = np.random.default_rng(0).random((2, 200)).astype(np.float32)
    at = jax.jit(jax.vmap(lambda u, v: looked_up.at(3, Place((u, v), 0, (u, v))).array()))
    texel = COLOURS[(v * 3).astype(int), (u * 4).astype(int)]
    first = lambda u, v: ((u % 1 > 0.5) == (v % 1 > 0.5))[:, None]
    want = np.where(first(u, v), np.where(first(2 * u, 2 * v), 0.1, texel), 0.7)
    np.testing.assert_allclose(at(u, v), want, rtol=1e-6)
    got, moved_by = slope(scene, name, np.ones((3, 4, 3), np.float32), plan)
    assert float(got) == pytest.approx(float(moved_by), rel=2e-3)


@pytest.mark.slow
def test_derivatives_with_respect_to_a_mixture():
    scene = table(jaxrt.Blend(jaxrt.Diffuse(0.2), jaxrt.Diffuse([0.9, 0.6, 0.3]), weight=0.3, id="mix"))
    got, want = slope(scene, "mix.weight", 1.0, jaxrt.plan(scene))
    paths = [mean(table(jaxrt.Diffuse(v)), jaxrt.plan(table(jaxrt.Diffuse(v)))) for v in (0.2, [0.9, 0.6, 0.3])]
    assert float(got) == pytest.approx(float(paths[1] - paths[0]), rel=0.05)  # of chosen samples, hence the noise
    assert np.isfinite(float(want))


@pytest.mark.parametrize("weight", [0.0, 1.0])
def test_what_a_mixture_has_none_of_has_a_derivative(weight):
    scene = table(jaxrt.Blend(jaxrt.Diffuse(0.2), jaxrt.Diffuse(0.8), weight=weight, id="mix"))
    got, _ = slope(scene, "mix.weight", 1.0, jaxrt.plan(scene))
    at = [float(mean(table(jaxrt.Diffuse(v)), jaxrt.plan(table(jaxrt.Diffuse(v))))) for v in (0.2, 0.8)]
    assert float(got) == pytest.approx(at[1] - at[0], rel=0.15)


def test_a_mask_lets_through_what_is_behind():
    """A sheet of opacity o before a luminous enclosure: the rest of the enclosure's light passes."""
    sheet = jaxrt.Rectangle(id="sheet", bsdf=jaxrt.Mask(jaxrt.Diffuse(0.0), opacity=0.25), to_world=moved(9.0))
    scene = jaxrt.Scene.build(
        [sheet], sensors=[camera((0, 0, 3), (0, 0, 0), 4, 4, up=(0, 1, 0))], enclosure=jaxrt.Enclosure(2.0)
    )
    sol = jaxrt.render(scene, 256, method="path", max_depth=4)
    np.testing.assert_allclose(sol.image, 1.5, rtol=0.05)
    assert sol.image.mean() == pytest.approx(1.5, rel=1e-2)


def environment(data, turn=None):
    around = jaxrt.Enclosure(jaxrt.Bitmap(data), to_world=moved(1.0, turn=turn), id="sky")
    return table(jaxrt.Diffuse(0.5), enclosure=around)


def test_the_density_of_an_environment():
    """Its integral over all directions is 1, and samples fall where it says."""
    data = np.full((6, 8, 3), 0.1, np.float32)
    data[1, 2] = data[4, 6] = 9.0
    turn = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
    scene = environment(data, turn * np.sign(np.linalg.det(turn)))
    sky = Environment.of(scene, (8, 6), "bitmap")
    n = 400
    z = (np.arange(n) + 0.5) / n * 2 - 1
    phi = (np.arange(2 * n) + 0.5) / n * np.pi
    r = np.sqrt(1 - z**2)[:, None]
    w = np.stack([r * np.cos(phi), r * np.sin(phi), np.broadcast_to(z[:, None], (n, 2 * n))], -1).reshape(-1, 3)
    pdf = np.asarray(jax.jit(jax.vmap(lambda v: sky.pdf(Vec3.of(v))))(jnp.asarray(w, jnp.float32)), np.float64)
    assert pdf.mean() * 4 * np.pi == pytest.approx(1, rel=2e-3)
    u = np.random.default_rng(0).random((1 << 15, 2)).astype(np.float32)
    drawn, p = jax.jit(jax.vmap(lambda v: (lambda a: (a[0].array(), a[1]))(sky.sample((v[0], v[1])))))(u)
    drawn, p = np.asarray(drawn, np.float64), np.asarray(p, np.float64)
    np.testing.assert_allclose(np.linalg.norm(drawn, axis=1), 1, atol=1e-5)
    for test in (lambda v: v[:, 0] > 0.2, lambda v: v[:, 1] * v[:, 2] > 0, lambda v: v[:, 2] < -0.6):
        want = (pdf * test(w)).mean() * 4 * np.pi
        assert test(drawn).mean() == pytest.approx(want, abs=4.5 * np.sqrt(want * (1 - want) / len(u)) + 2e-3)
    assert (1 / p).mean() == pytest.approx(4 * np.pi, rel=0.05)


def test_an_even_environment_is_a_constant_enclosure():
    picture_, constant = (
        environment(np.full((4, 8, 3), 0.7, np.float32)),
        table(jaxrt.Diffuse(0.5), jaxrt.Enclosure(0.7)),
    )
    a, b = (jaxrt.render(s, 256, method="path", max_depth=3) for s in (picture_, constant))
    z = (a.image - b.image) / np.sqrt(a.stderr**2 + b.stderr**2 + 1e-6)
    assert (np.abs(z) < 4.5).all()


def test_an_environment_forced_out_is_dark():
    """Its texture, too: the picture is that without an enclosure, also where the camera looks past everything."""
    past = camera((0.3, -1, 3), (0, 0, 0), 6, 6, 120.0)
    lamp = jaxrt.Rectangle(to_world=moved(0.3, (0.5, 0, 2), np.diag([1.0, -1, -1])), emission=[5.0, 4.0, 3.0])
    build = lambda around: jaxrt.Scene.build([jaxrt.Rectangle(), lamp], sensors=[past], enclosure=around, channels=3)
    scene, without = build(jaxrt.Enclosure(jaxrt.Bitmap(COLOURS))), build(None)
    a = picture(scene, jax.random.key(0), jaxrt.plan(scene, environment=False), spp=64, max_depth=2)
    b = picture(without, jax.random.key(0), jaxrt.plan(without), spp=64, max_depth=2)
    np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-6)
    assert (np.asarray(a) == 0).any()


def test_plans_of_textures():
    plain, painted = table(jaxrt.Diffuse(0.5)), table(jaxrt.Diffuse(jaxrt.Bitmap(COLOURS)))
    mixed, sky = table(jaxrt.Mask(jaxrt.Diffuse(0.5))), environment(COLOURS)
    plan = jaxrt.plan(plain)
    assert (plan.textures, plan.nested, plan.nodes, plan.environment, plan.coordinates, plan.tangents) == (
        (),
        0,
        (),
        None,
        False,
        False,
    )
    assert "texture:bitmap" in jaxrt.plan(painted).effects
    assert "on floor.bsdf.reflectance" in str(jaxrt.plan(painted))
    assert {"blend", "lobe:nothing"} <= jaxrt.plan(mixed).effects
    assert {"environment", "enclosure"} <= jaxrt.plan(sky).effects
    assert "environment" not in jaxrt.plan(sky, environment=False).effects
    assert (
        jaxrt.plan(table(jaxrt.Diffuse(jaxrt.Bitmap(COLOURS[..., :1]))), free="floor.to_world").channels == 3
    )  # the lamp


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: jaxrt.Bitmap(np.zeros((0, 3))), "has shape"),
        (lambda: jaxrt.Bitmap(np.full((2, 2), np.nan)), "not finite"),
        (lambda: jaxrt.Bitmap(np.ones((2, 2)), wrap="never"), "is not one of repeat"),
        (lambda: jaxrt.Diffuse(jaxrt.Bitmap(np.full((2, 2), 1.5))), "at most 1"),
        (
            lambda: jaxrt.Diffuse(jaxrt.Checkerboard(jaxrt.Bitmap(np.full((2, 2), 1.5)))),
            "color0.data: is 1.5; .*at most 1",
        ),
        (lambda: jaxrt.Point(intensity=jaxrt.Bitmap(np.ones((2, 2)))), "takes no texture"),
        (lambda: jaxrt.NormalMap(jaxrt.Diffuse(), 0.5), "is no texture"),
        (lambda: jaxrt.BumpMap(jaxrt.Diffuse(), jaxrt.Checkerboard()), "is no Bitmap"),
        (lambda: jaxrt.TwoSided(jaxrt.Mask(jaxrt.Diffuse())), "holds what transmits"),
        (lambda: jaxrt.Enclosure(jaxrt.Bitmap(np.ones((1, 4)))), "has one row"),
        (lambda: table(jaxrt.Diffuse(jaxrt.MeshAttribute("vertex_color"))), "which is no mesh"),
        (lambda: table(jaxrt.Diffuse(jaxrt.Bitmap(np.ones((2, 2, 2))))), "has 2 channels"),
    ],
)
def test_what_does_not_work(make, says):
    with pytest.raises(jaxrt.SceneError, match=says):
        make()
