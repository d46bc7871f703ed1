"""Boundaries that transmit or coat: Fresnel, Snell, energy, the η² of radiance, and a sheet in closed form."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import moved

import jaxrt
from jaxrt import brdf
from jaxrt.brdf import Material, fresnel
from jaxrt.vector import Spectrum, Vec3

COSINES = np.array([1.0, 0.9, 0.6, 0.3, 0.05])


def reflectance(eta, cos):
    """By complex numbers, from a medium of index 1 into one of index η."""
    inner = np.sqrt(eta**2 - 1 + cos**2 + 0j)
    rs, rp = (cos - inner) / (cos + inner), (eta**2 * cos - inner) / (eta**2 * cos + inner)
    return (abs(rs) ** 2 + abs(rp) ** 2) / 2


@pytest.mark.parametrize("eta", [1.0, 1.0001, 1.33, 1.5, 2.419])
def test_fresnel(eta):
    """From both sides; total reflection beyond sinθ = 1/η inside."""
    for sign in (1, -1):
        cos = np.append(COSINES, np.sqrt(max(1 - 1 / eta**2, 0)) + 0.01 * np.array([-2, -1, 1, 2]))
        cos = cos[(cos > 0) & (cos <= 1)]
        f, t, ratio = (np.asarray(a) for a in fresnel.dielectric(jnp.float32(eta), jnp.float32(sign * cos)))
        np.testing.assert_allclose(ratio, eta**sign, rtol=1e-6)
        np.testing.assert_allclose(f, reflectance(float(ratio[0] if ratio.ndim else ratio), cos), atol=2e-4)
        sine = np.sqrt(1 - cos**2) / ratio
        np.testing.assert_allclose(t, np.sqrt(np.maximum(1 - sine**2, 0)), atol=1e-3)
    assert float(fresnel.dielectric(1.5, 1.0)[0]) == pytest.approx(0.04, rel=1e-5)


@pytest.mark.parametrize("eta", [1 / 4, 1 / 2.4, 1 / 1.5, 1 / 1.33, 1.33, 1.5, 2.4])
def test_mean_reflectance_of_even_light(eta):
    cos = (np.arange(20000) + 0.5) / 20000
    want = (2 * cos * reflectance(eta, cos)).mean()
    assert float(fresnel.diffuse_reflectance(jnp.float32(eta))) == pytest.approx(want, rel=6e-3)


def material(ior=1.5, **spectra):
    one = lambda v: Spectrum((jnp.float32(v),))
    given = {"reflectance": 1.0, "transmittance": 1.0, "specular": 1.0} | spectra
    return Material(**{k: one(v) for k, v in given.items()}, ior=jnp.float32(ior), nonlinear=jnp.float32(0))


@functools.partial(jax.jit, static_argnums=0)
def _drawn(lobe, m, wo, u):
    def one(u):
        wi, delta = brdf.sample((lobe,), m, Vec3.of(wo), (u[0], u[1]))
        return wi.array(), delta, brdf.delta_weight((lobe,), m, wi, Vec3.of(wo)).channels[0]

    return jax.vmap(one)(u)


def drawn(lobe, m, cos, n=1 << 15):
    wo = np.array([np.sqrt(1 - cos**2), 0, cos], np.float32)
    u = np.random.default_rng(7).random((n, 2)).astype(np.float32)
    return [np.asarray(a, np.float64) for a in _drawn(lobe, m, wo, np.minimum(u, np.float32(1 - 2.0**-24)))]


@pytest.mark.parametrize("cos", [0.9, 0.3, -0.9, -0.8, -0.3])
def test_glass_bends_light_and_keeps_its_energy(cos):
    eta = 1.5
    ratio = eta if cos > 0 else 1 / eta
    wi, delta, weight = drawn("glass", material(eta), cos)
    assert delta.all()
    np.testing.assert_allclose(np.linalg.norm(wi, axis=1), 1, atol=1e-5)
    through = wi[:, 2] * cos < 0
    f = reflectance(ratio, abs(cos))
    assert through.mean() == pytest.approx(1 - f, abs=4 * np.sqrt(f * (1 - f) / len(wi)) + 1e-6)
    np.testing.assert_allclose(np.abs(wi[through, 0]) * ratio, np.sqrt(1 - cos**2), atol=1e-5)
    np.testing.assert_allclose(wi[through, 0], -np.sqrt(1 - cos**2) / ratio, atol=1e-5)
    np.testing.assert_allclose(weight[~through], 1, rtol=1e-5)
    np.testing.assert_allclose(weight[through], 1 / ratio**2, rtol=1e-5)  # radiance over η² is what is kept


@pytest.mark.parametrize("cos", [0.8, 0.2, -0.5])
def test_a_sheet(cos):
    wi, _, weight = drawn("thin_glass", material(1.5, transmittance=0.5), cos)
    through = wi[:, 2] * cos < 0
    r = reflectance(1.5, abs(cos))
    assert through.mean() == pytest.approx(1 - 2 * r / (1 + r), abs=0.012)
    np.testing.assert_allclose(np.where(through, 0.5, 1.0), weight, rtol=1e-5)
    np.testing.assert_allclose(
        wi[through], np.broadcast_to([-np.sqrt(1 - cos**2), 0, -cos], wi[through].shape), atol=1e-6
    )


def test_plastic_keeps_its_books():
    """The chance and density of both parts, energy, and reciprocity of the paint."""
    m = material(1.5, reflectance=0.8)
    for cos in (1.0, 0.6, 0.2):
        wi, delta, weight = drawn("plastic", m, cos)
        wo = np.broadcast_to(np.array([np.sqrt(1 - cos**2), 0, cos], np.float32), wi.shape)
        f, p = jax.jit(jax.vmap(lambda a, b: (brdf.eval(("plastic",), m, Vec3.of(a), Vec3.of(b)).channels[0], brdf.pdf(("plastic",), m, Vec3.of(a), Vec3.of(b)))))(np.float32(wi), wo)  # fmt: skip
        f, p, delta = np.asarray(f, float), np.asarray(p, float), delta > 0.5
        np.testing.assert_allclose(p[~delta], (1 - delta.mean()) * wi[~delta, 2] / np.pi, rtol=0.02)
        np.testing.assert_allclose(wi[delta], np.broadcast_to(wo[0] * [-1, -1, 1], wi[delta].shape), atol=1e-6)
        shine = np.where(delta, weight, 0).mean()
        assert shine == pytest.approx(reflectance(1.5, cos), rel=1e-4 + 4 / np.sqrt(delta.sum()))
        paint = np.where(delta, 0, f * wi[:, 2] / np.where(delta, 1, p))
        assert 0.3 < shine + paint.mean() < 1
        there, back = (brdf.eval(("plastic",), m, Vec3.of(a), Vec3.of(b)).channels[0] for a, b in ((np.float32(wi[~delta][0]), wo[0]), (wo[0], np.float32(wi[~delta][0]))))  # fmt: skip
        assert float(there) == pytest.approx(float(back), rel=1e-5)


def test_a_sheet_before_black_and_its_derivative():
    """What a ray that looks down at it sees is R = 2r/(1 + r) of the light around; dR/dη by the chain rule."""
    sheet = jaxrt.Rectangle(id="sheet", bsdf=jaxrt.Dielectric(1.5, 1.0, thin=True, id="glass"))
    wall = jaxrt.Rectangle(to_world=moved(3.0, (0, 0, -1)), bsdf=jaxrt.Diffuse(0.0))
    scene = jaxrt.Scene.build([sheet, wall], enclosure=jaxrt.Enclosure(1.0))
    assert jaxrt.params(scene)["glass.eta"] == 1.5

    def seen(eta):
        changed = jaxrt.with_params(scene, {"glass.eta": eta})
        down = np.array([0.0, 0.0, -1.0])
        return jaxrt.radiance(changed, [0.0, 0.0, 1.0], down, jax.random.key(0), spp=1 << 14, max_depth=3)[0]

    value, slope = jax.jit(lambda x: jax.jvp(seen, (x,), (1.0,)))(1.5)
    want = lambda n: 2 * ((n - 1) / (n + 1)) ** 2 / (1 + ((n - 1) / (n + 1)) ** 2)
    assert float(value) == pytest.approx(want(1.5), abs=4 * np.sqrt(want(1.5) / (1 << 14)))
    assert float(slope) == pytest.approx((want(1.501) - want(1.499)) / 0.002, rel=0.05)


def test_glass_in_a_furnace_cannot_be_seen(short_loops):
    """Radiance 1 from all around: a ball of glass and a cube of it."""
    shapes = [
        jaxrt.Sphere(center=(-1.2, 0, 0), bsdf=jaxrt.Dielectric()),
        jaxrt.Cube(to_world=moved(0.7, (1.2, 0, 0)), bsdf=jaxrt.Dielectric(int_ior=2.4)),
    ]
    scene = jaxrt.Scene.build(shapes, enclosure=jaxrt.Enclosure(1.0))
    rng = np.random.default_rng(0)
    points = np.float32(rng.uniform(-1.5, 1.5, (256, 3)) * [1, 1, 0] + [0, 0, 4])
    down = np.broadcast_to(np.float32([0, 0, -1]), points.shape)
    seen = np.asarray(jaxrt.radiance(scene, points, down, jax.random.key(0), spp=64, max_depth=64))
    assert abs(seen.mean() - 1) < 2e-3
    np.testing.assert_allclose(seen, 1, atol=0.15)


@pytest.mark.parametrize("lobe", ["glass", "thin_glass", "plastic"])
@pytest.mark.parametrize("eta", [1.0, 0.7, 1.5])
def test_derivatives_are_finite_at_grazing_and_total_reflection(lobe, eta):
    def total(eta, cos):
        wo = Vec3(jnp.sqrt(1.0 - cos * cos + 1e-12), 0.0 * cos, cos)
        m = material(eta)
        wi, _ = brdf.sample((lobe,), m, wo, (0.5, 0.5))
        both = brdf.eval((lobe,), m, wi, wo), brdf.delta_weight((lobe,), m, wi, wo)
        return sum(f.channels[0] for f in both) + wi.z

    for cos in (0.0, 1e-3, -1e-3, -0.3, 1.0):
        assert np.isfinite(jax.grad(total, (0, 1))(jnp.float32(eta), jnp.float32(cos))).all(), cos


def test_black_plastic_can_be_left():
    """Straight down at plastic below light of 1: derivatives of both its albedos at 0."""
    paint = jaxrt.Plastic(0.0, 0.0, 1.5, 1.0, id="paint")
    scene = jaxrt.Scene.build([jaxrt.Rectangle(bsdf=paint)], enclosure=jaxrt.Enclosure(1.0))

    def seen(diffuse, specular):
        changed = jaxrt.with_params(
            scene, {"paint.diffuse_reflectance": diffuse, "paint.specular_reflectance": specular}
        )
        down = np.array([0.0, 0.0, -1.0])
        return jaxrt.radiance(changed, [0.0, 0.0, 1.0], down, jax.random.key(0), spp=1 << 13, max_depth=2)[0]

    slopes = jax.jit(jax.jacfwd(seen, (0, 1)))(0.0, 0.0)
    assert float(slopes[0]) == pytest.approx(0.96, rel=0.02)  # what gets in gets out where nothing is taken in
    assert float(slopes[1]) == pytest.approx(0.04, rel=0.05)


def test_what_transmits_is_no_black_side_of_the_field(short_loops):
    """A closed room with balls of glass: the field's picture is that of paths, on the glass as well."""
    room = jaxrt.Cube(to_world=moved(2.0), bsdf=jaxrt.TwoSided(jaxrt.Diffuse(0.5)))
    lamp = jaxrt.Sphere(center=(0, 0, 1.5), radius=0.3, emission=5.0)
    balls = [
        jaxrt.Sphere(center=(-0.6, 0.8, 0), radius=0.5, bsdf=jaxrt.Dielectric()),
        jaxrt.Sphere(center=(0.6, 0.8, 0), radius=0.5, bsdf=jaxrt.Dielectric(thin=True)),
    ]
    pose = np.array([[1.0, 0, 0, 0], [0, 0, 1, -1.8], [0, 1, 0, 0], [0, 0, 0, 1]])
    sensor = jaxrt.Sensor(to_world=pose, fov=60.0, film=jaxrt.Film(16, 12, "box"))
    scene = jaxrt.Scene.build([room, lamp, *balls], sensors=[sensor])
    path, field = (jaxrt.render(scene, 512, 0, max_depth=12, method=m).image for m in ("path", "field"))
    assert field.mean() == pytest.approx(path.mean(), rel=0.015)
    assert field[4:8, 3:13].mean() == pytest.approx(path[4:8, 3:13].mean(), rel=0.03)


def test_an_index_is_a_number():
    with pytest.raises(jaxrt.SceneError, match=r"glass\.int_ior: 'bk7' is no number"):
        jaxrt.Dielectric("bk7", id="glass")
