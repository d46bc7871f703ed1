"""Rough glass and rough plastic: values of Mitsuba, samplers, energy, the η² of radiance, what enters a coat."""

import functools

import jax
import numpy as np
import pytest
from helpers import moved
from scipy import stats

import jaxrt
from jaxrt import brdf
from jaxrt.brdf import LOBES, Material, MaterialColumns
from jaxrt.vector import Spectrum, Vec3

GLASS, PLASTIC = ("rough_glass", "rough_glass_beckmann"), ("rough_plastic", "rough_plastic_beckmann")
ALL = pytest.mark.parametrize("lobe", GLASS + PLASTIC)


def peer_name(lobe):
    return "beckmann" if lobe.endswith("beckmann") else "ggx"


@functools.partial(jax.jit, static_argnums=0)
def _material(lobe, alpha, ior, nonlinear, spectra):
    """With what is derived, as `prepare` finds it."""
    fields = {k: Spectrum((v,)) for k, v in spectra.items()} | {"ior": ior, "nonlinear": nonlinear, "alpha": alpha}
    derive = LOBES[lobe].derive
    return Material(**fields, **({} if derive is None else derive(Material(**fields))))


def material(lobe, alpha, ior=1.5, nonlinear=0.0, **spectra):
    given = {"reflectance": 1.0, "transmittance": 1.0, "specular": 1.0} | spectra
    alpha = np.broadcast_to(np.float32(alpha), (2,))
    given = {k: np.float32(v) for k, v in given.items()}
    return _material(lobe, tuple(alpha), np.float32(ior), np.float32(nonlinear), given)


@functools.partial(jax.jit, static_argnums=0)
def _values(lobe, m, wi, wo):
    one = lambda a, b: (brdf.eval((lobe,), m, a, b).channels[0], brdf.pdf((lobe,), m, a, b))
    return jax.vmap(lambda a, b: one(Vec3.of(a), Vec3.of(b)))(wi, wo)


def values(lobe, m, wi, wo):
    wi, wo = np.broadcast_arrays(np.float32(wi), np.float32(wo))
    return [np.asarray(a, np.float64) for a in _values(lobe, m, wi, wo)]


@functools.partial(jax.jit, static_argnums=0)
def _samples(lobe, m, wo, u):
    return jax.vmap(lambda a, u: brdf.sample((lobe,), m, Vec3.of(a), tuple(u))[0].array())(wo, u)


def samples(lobe, m, wo, n=1, seed=0):
    """n directions for each ω_o."""
    wo = np.repeat(np.float32(np.atleast_2d(wo)), n, 0)
    u = np.random.default_rng(seed).random((len(wo), 3)).astype(np.float32)
    return np.asarray(_samples(lobe, m, wo, np.minimum(u, np.float32(1 - 2.0**-24))), np.float64)


def direction(z, phi=0.3):
    r = np.sqrt(1 - np.asarray(z) ** 2)
    return np.stack(np.broadcast_arrays(r * np.cos(phi), r * np.sin(phi), z), -1)


def pairs(lobe, m, n, both, least=0.03, seed=0):
    """ω_o over one or both hemispheres, and ω_i: half evenly spread, half drawn."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(least, 1, (2, n)) * (rng.choice([-1, 1], (2, n)) if both else 1)
    wi, wo = (direction(a, rng.uniform(-4, 4, n)) for a in z)
    drawn = samples(lobe, m, wo)
    return np.where((np.arange(n)[:, None] % 2 > 0) & (np.abs(drawn[:, 2:]) > least), drawn, wi), wo


# -------------------------------------------------------------------------------------------- Mitsuba


def peers(peer, wi, wo):
    import mitsuba as mi

    si, out = mi.SurfaceInteraction3f(), []
    for a, b in zip(wi, wo, strict=True):
        si.wi = mi.Vector3f(*map(float, b))
        out.append(peer.eval(mi.BSDFContext(), si, mi.Vector3f(*map(float, a)))[0] / abs(a[2]))
    return np.array(out)


@pytest.fixture
def mi():
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    return mi


@pytest.mark.peer
@pytest.mark.parametrize("lobe", GLASS)
@pytest.mark.parametrize(
    "alpha, ior, colours",
    [((0.1, 0.1), 1.5, (1, 1)), ((0.5, 0.2), 1.33, (0.5, 0.8)), ((1, 1), 2.4, (1, 1)), ((0.3, 0.3), 0.8, (0.2, 1))],
)
def test_rough_glass_is_that_of_mitsuba(mi, lobe, alpha, ior, colours):
    rgb = lambda v: {"type": "rgb", "value": [v] * 3}
    given = {"alpha_u": alpha[0], "alpha_v": alpha[1], "int_ior": ior, "ext_ior": 1.0}
    given |= {"specular_reflectance": rgb(colours[0]), "specular_transmittance": rgb(colours[1])}
    peer = mi.load_dict({"type": "roughdielectric", "distribution": peer_name(lobe), **given})
    m = material(lobe, alpha, ior, reflectance=colours[0], transmittance=colours[1])
    wi, wo = pairs(lobe, m, 200, both=True)
    ours, theirs = values(lobe, m, wi, wo)[0], peers(peer, wi, wo)
    for side in (1, -1):
        assert (theirs[np.sign(wi[:, 2] * wo[:, 2]) == side] > 0).sum() > 30
    np.testing.assert_allclose(ours, theirs, rtol=3e-3, atol=1e-5)


@pytest.mark.peer
@pytest.mark.parametrize("lobe", PLASTIC)
@pytest.mark.parametrize(
    "alpha, ior, nonlinear, colours", [(0.1, 1.49, 0, (0.5, 1)), (0.4, 1.9, 1, (0.8, 0.3)), (0.02, 1.3, 1, (0.3, 0))]
)
def test_rough_plastic_is_that_of_mitsuba(mi, lobe, alpha, ior, nonlinear, colours):
    rgb = lambda v: {"type": "rgb", "value": [v] * 3}
    given = {"alpha": alpha, "int_ior": ior, "ext_ior": 1.0, "nonlinear": bool(nonlinear)}
    given |= {"diffuse_reflectance": rgb(colours[0]), "specular_reflectance": rgb(colours[1])}
    peer = mi.load_dict({"type": "roughplastic", "distribution": peer_name(lobe), **given})
    m = material(lobe, alpha, ior, nonlinear, reflectance=colours[0], specular=colours[1])
    wi, wo = pairs(lobe, m, 120, both=False, least=0.1)
    np.testing.assert_allclose(values(lobe, m, wi, wo)[0], peers(peer, wi, wo), rtol=8e-3, atol=1e-5)


# ----------------------------------------------------------------- shares of a coat's facets, by brute force


def share(distribution, alpha, index, cos, through, n=80):
    """What facets reflect or let through, over slopes spread as D is; float64."""
    u = (np.polynomial.legendre.leggauss(n)[0] + 1) / 2
    weight = np.polynomial.legendre.leggauss(n)[1] / 2
    tan = alpha * (np.sqrt(u / (1 - u)) if distribution == "ggx" else np.sqrt(-np.log(1 - u)))
    h = direction(1 / np.sqrt(1 + tan[:, None] ** 2), np.pi * (np.arange(n) + 0.5) / n)
    wo = direction(cos, 0.0)
    c = h @ wo
    t = np.sqrt(np.maximum(1 - (1 - c**2) / index**2, 0))
    z = cos / index - (c / index - t) * h[..., 2] if through else 2 * c * h[..., 2] - cos

    def shown(z):
        a2 = z**2 / np.maximum(1 - z**2, 1e-300) / alpha**2
        if distribution == "ggx":
            return 2 / (1 + np.sqrt(1 + 1 / a2))
        return np.where(a2 < 2.56, (3.535 * np.sqrt(a2) + 2.181 * a2) / (1 + 2.276 * np.sqrt(a2) + 2.577 * a2), 1)

    ok = (c > 0) & (z > 0)
    rs, rp = (c - index * t) / (c + index * t), (index * c - t) / (index * c + t)
    f = np.where(t > 0, (rs**2 + rp**2) / 2, 1)
    f = (1 - f if through else f) * shown(np.where(ok, z, 1)) * shown(cos) * c / (h[..., 2] * cos)
    return (np.where(ok, f, 0).mean(1) * weight).sum()


@pytest.mark.parametrize("lobe", PLASTIC)
@pytest.mark.parametrize("alpha", [0.02, 0.2, 1.0])
def test_what_enters_a_coat_and_what_it_throws_back(lobe, alpha):
    cosines = np.array([0.01, 0.03, 0.1, 0.25, 0.6, 1.0])
    inner = (np.polynomial.legendre.leggauss(12)[0] + 1) / 2
    weight = np.polynomial.legendre.leggauss(12)[1] * inner
    for ior in (1.1, 2.5):
        m = material(lobe, alpha, ior, specular=0.0)
        # Of the paint alone, T(ω_i) T(ω_o) ρ/(1 − R)/πη².
        scale = np.pi * ior**2 * (1 - float(m.inside))
        square = values(lobe, m, direction(cosines), direction(cosines))[0] * scale
        want = [share(peer_name(lobe), alpha, ior, c, True, 300) for c in cosines]
        np.testing.assert_allclose(np.sqrt(square), want, atol=2e-3)
        kink, thrown = np.sqrt(1 - 1 / ior**2), 0.0
        for start, end in ((0, kink), (kink, 1)):
            mu = start + (end - start) * inner
            back = np.array([share(peer_name(lobe), alpha, 1 / ior, c, False) for c in mu])
            thrown += (end - start) * (weight * back * mu / inner).sum()
        thrown += (share(peer_name(lobe), alpha, 1 / ior, 1.0, False) - thrown) / 64  # as Mitsuba takes its mean
        assert float(m.inside) == pytest.approx(thrown, abs=1e-3)


# -------------------------------------------------------------------------------------------- sampling

BANDS, SECTORS, FINE = 32, 32, 12


@pytest.mark.parametrize(
    "lobe, cos",
    [*((lobe, c) for lobe in GLASS for c in (0.8, 0.2, -0.5)), *((lobe, c) for lobe in PLASTIC for c in (0.8, 0.2))],
)
def test_samples_follow_the_density(lobe, cos):
    """χ² over bins of the sphere; what is masked is what the density leaves out."""
    n, wo, m = 50_000, direction(cos), material(lobe, (0.5, 0.3) if lobe in GLASS else 0.4, 1.5)
    theta = (np.arange(BANDS * FINE) + 0.5) * np.pi / (BANDS * FINE)
    phi = -np.pi + (np.arange(SECTORS * FINE) + 0.5) * 2 * np.pi / (SECTORS * FINE)
    grid = direction(np.cos(theta)[:, None], phi[None])
    p = values(lobe, m, grid.reshape(-1, 3), wo)[1].reshape(grid.shape[:2]) * np.sin(theta)[:, None]
    p = p * (np.pi / (BANDS * FINE)) * (2 * np.pi / (SECTORS * FINE))
    share = p.reshape(BANDS, FINE, SECTORS, FINE).sum((1, 3)).ravel()
    assert share.sum() < 1 + 1e-3
    s = samples(lobe, m, wo, n)
    np.testing.assert_allclose(np.linalg.norm(s, axis=1), 1.0, atol=1e-5)
    kept = np.abs(s[:, 2]) > 1e-6 if lobe in GLASS else s[:, 2] > 0
    assert kept.mean() > 0.7
    band = np.minimum(np.arccos(np.clip(s[kept, 2], -1, 1)) / np.pi * BANDS, BANDS - 1).astype(int)
    sector = np.minimum((np.arctan2(s[kept, 1], s[kept, 0]) + np.pi) / (2 * np.pi) * SECTORS, SECTORS - 1).astype(int)
    counts, expected = np.bincount(band * SECTORS + sector, minlength=BANDS * SECTORS), n * share
    rich = expected >= 10
    counts = np.append(counts[rich], counts[~rich].sum() + (~kept).sum())
    expected = np.append(expected[rich], max(n - expected[rich].sum(), 1e-9))
    chance = stats.chi2.sf(((counts - expected) ** 2 / expected).sum(), len(counts) - 1)
    assert chance > 1e-4


@ALL
@pytest.mark.parametrize("alpha", [1e-3, 0.02, 0.3, 1.0])
def test_weights_are_finite_and_small(lobe, alpha):
    """f cosθ/p of what is drawn, from both sides: 1 but for masking, as much again for Beckmann; η² of radiance."""
    for ior in (1.0, 1.0005, 1.5, 2.4):
        m = material(lobe, alpha, ior)
        for cos in (0.9, 0.1) + ((-0.9, -0.1) if lobe in GLASS else ()):
            wo = direction(cos)
            s = samples(lobe, m, wo, 4000, 1)
            f, p = values(lobe, m, s, wo)
            weight = np.where(p > 0, f * np.abs(s[:, 2]) / np.where(p > 0, p, 1), 0)
            assert np.isfinite(weight).all()
            ratio = max(ior, 1.001) ** np.sign(cos)  # light is bent a little at least
            kept = np.where(s[:, 2] * cos > 0, 1, ratio**2) * weight
            assert kept.max() < (1.01 if lobe == "rough_glass" else 3), (ior, cos)
            if lobe in GLASS:
                error = kept.std() / np.sqrt(len(s))
                assert kept.mean() < 1 + 4 * error + 1e-3, (ior, cos)  # no energy is made
                if alpha * 20 < abs(cos):
                    assert kept.mean() > 0.98 - 4 * error, (ior, cos)


# ------------------------------------------------------------------------------------------ laws of light


@pytest.mark.parametrize("lobe", GLASS)
def test_radiance_over_the_square_of_the_index_is_reciprocal(lobe):
    """Veach 1997, section 5.2: f(ω_i → ω_o)/η_o² = f(ω_o → ω_i)/η_i²."""
    m = material(lobe, (0.5, 0.3), 1.6)
    wi, wo = pairs(lobe, m, 2000, both=True)
    there, back = values(lobe, m, wi, wo)[0], values(lobe, m, wo, wi)[0]
    square = lambda w: np.where(w[:, 2] > 0, 1.0, 1.6**2)
    assert (there[wi[:, 2] * wo[:, 2] < 0] > 0).sum() > 300
    np.testing.assert_allclose(there / square(wo), back / square(wi), rtol=2e-3, atol=1e-6)


@pytest.mark.parametrize("lobe", PLASTIC)
def test_rough_plastic_is_reciprocal_and_keeps_its_energy(lobe):
    for alpha, ior in ((0.05, 1.5), (0.4, 2.0), (1.0, 1.3)):
        m = material(lobe, alpha, ior)
        wi, wo = pairs(lobe, m, 500, both=False)
        np.testing.assert_allclose(values(lobe, m, wi, wo)[0], values(lobe, m, wo, wi)[0], rtol=1e-3)
        for cos in (0.9, 0.3):
            s = samples(lobe, m, direction(cos), 20_000, 2)
            f, p = values(lobe, m, s, direction(cos))
            weight = np.where(p > 0, f * s[:, 2] / np.where(p > 0, p, 1), 0)
            assert 0.25 < weight.mean() < 1 + 4 * weight.std() / np.sqrt(len(s)) + 0.01


@ALL
def test_derivatives_are_finite(lobe):
    """From grazing to normal, of directions drawn and not, whatever roughness and index."""
    cosines = (1.0, 0.5, 1e-3, 1e-6) + ((-1e-6, -0.3, -1.0) if lobe in GLASS else (-0.5,))
    a = np.concatenate([direction(np.array(cosines), p) for p in (0.0, 0.7 + np.pi)])
    wi, wo = np.repeat(a, len(a), 0), np.tile(a, (len(a), 1))
    for alpha in (1e-4, 0.1, 1.0):
        for ior in (0.7, 1.0, 1.5):
            m = material(lobe, alpha, ior, nonlinear=1.0, reflectance=0.9)
            two = [np.concatenate([wi, samples(lobe, m, wo)]), np.concatenate([wo, wo])]
            for leaf in jax.tree.leaves(_slopes(lobe, m, *(np.float32(w) for w in two))):
                assert np.isfinite(leaf).all(), (alpha, ior)


@functools.partial(jax.jit, static_argnums=0)
def _slopes(lobe, m, wi, wo):
    value = lambda m, a, b: brdf.eval((lobe,), m, Vec3.of(a), Vec3.of(b)).channels[0] * a[2]
    return jax.vmap(jax.grad(value, (0, 1, 2)), (None, 0, 0))(m, wi, wo)


# ---------------------------------------------------------------------------------------- in a scene


@pytest.mark.slow
def test_roughness_and_index_move_what_is_derived():
    """Against differences; its derivatives are finite wherever roughness and index go."""
    paints = [jaxrt.Plastic(alpha=0.3, distribution=d, id=d) for d in ("ggx", "beckmann")]
    scene = jaxrt.Scene.build([jaxrt.Rectangle(bsdf=paint) for paint in paints])
    columns = MaterialColumns(scene.channels)

    def derived(x):
        changed = jaxrt.with_params(
            scene, {f"{p.id}.{k}": v for p in paints for k, v in zip(("alpha", "eta"), x, strict=True)}
        )
        return brdf.derive(PLASTIC, columns, changed.materials[1:3])[0]

    both = jax.jit(jax.vmap(lambda x: (derived(x), jax.jacfwd(derived)(x))))
    h = 5e-3
    x = np.float32([[0.3, 1.5], [0.3 + h, 1.5], [0.3 - h, 1.5], [0.3, 1.5 + h], [0.3, 1.5 - h]])
    value, slope = (np.asarray(a, np.float64) for a in both(x))
    want = np.stack([value[1] - value[2], value[3] - value[4]], -1) / (2 * h)
    np.testing.assert_allclose(slope[0], want, rtol=0.05, atol=1e-2)
    assert np.abs(want[:, -1]).min() > 0.1  # inside, both matter
    ends = np.float32([[0.0, 1.5], [1e-4, 1.0], [1e-4, 2.5], [1.0, 1.0], [1.0, 2.5]])
    assert all(np.isfinite(a).all() for a in both(ends))


@pytest.mark.slow
def test_rough_glass_in_the_field(short_loops):
    """A closed room with a ball of rough glass: the field's picture is that of paths."""
    room = jaxrt.Cube(to_world=moved(2.0), bsdf=jaxrt.TwoSided(jaxrt.Diffuse(0.5)))
    lamp = jaxrt.Sphere(center=(0, 0, 1.5), radius=0.5, emission=5.0)
    ball = jaxrt.Sphere(center=(0, 0.8, 0), radius=0.6, bsdf=jaxrt.Dielectric(alpha=0.3))
    pose = np.array([[1.0, 0, 0, 0], [0, 0, 1, -1.8], [0, 1, 0, 0], [0, 0, 0, 1]])
    sensor = jaxrt.Sensor(to_world=pose, fov=60.0, film=jaxrt.Film(16, 16, "box"))
    scene = jaxrt.Scene.build([room, lamp, ball], sensors=[sensor])
    path, field = (jaxrt.render(scene, 512, 0, max_depth=6, method=m) for m in ("path", "field"))
    for part in (np.s_[:], np.s_[5:11, 5:11]):  # all of it, and the ball
        means = [s.image[part].mean(dtype=float) for s in (path, field)]
        error = np.hypot(
            *(np.sqrt((s.stderr[part].astype(float) ** 2).sum()) / s.stderr[part].size for s in (path, field))
        )
        assert error < 0.025 * means[0]
        assert abs(means[0] - means[1]) < 4 * error + 0.005 * means[0]


def test_parts_and_their_columns():
    made = lambda part: part.row().lobe
    assert made(jaxrt.Dielectric(alpha=0.1)) == "rough_glass" and made(jaxrt.Dielectric(alpha=0)) == "glass"
    assert made(jaxrt.Plastic(alpha=0.1, distribution="beckmann")) == "rough_plastic_beckmann"
    with pytest.raises(jaxrt.SceneError, match="thin sheet is smooth"):
        jaxrt.Dielectric(thin=True, alpha=0.1)
    with pytest.raises(jaxrt.SceneError, match="is one roughness"):
        jaxrt.Plastic(alpha=(0.1, 0.2))
    with pytest.raises(jaxrt.SceneError, match="is not ggx or beckmann"):
        jaxrt.Plastic(alpha=0.1, distribution="ggx_separable")
    with pytest.raises(jaxrt.SceneError, match="holds what transmits"):
        jaxrt.TwoSided(jaxrt.Dielectric(alpha=0.1))
    held, wanted = MaterialColumns(3), MaterialColumns(3, ("alpha", "reflectance", "coat", "inside"))
    assert "coat" not in held.at and wanted.width == 2 + 3 + 10 + 1
