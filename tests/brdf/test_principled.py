"""Disney's principled surfaces: Mitsuba's values, samplers against densities, derivatives, sides."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import jaxrt
from jaxrt import brdf
from jaxrt.brdf import LOBES, Material, MaterialColumns
from jaxrt.vector import Vec3

RED = [0.8, 0.3, 0.1]
SOLID = {
    "default": {},
    "rough": dict(base_color=RED, roughness=1.0, specular=0.9),
    "metal": dict(base_color=RED, metallic=1.0, roughness=0.3),
    "some metal": dict(base_color=RED, metallic=0.4, roughness=0.4, anisotropic=0.8),
    "tinted": dict(base_color=[0.1, 0.2, 0.9], spec_tint=0.8, roughness=0.6),
    "cloth": dict(base_color=RED, sheen=1.0, sheen_tint=0.7, roughness=0.8),
    "skin": dict(base_color=RED, flatness=0.8, roughness=0.6, sheen=0.3),
    "coat": dict(base_color=RED, clearcoat=1.0, clearcoat_gloss=0.2),
    "glass": dict(base_color=RED, spec_trans=1.0, roughness=0.5, eta=1.5),
    "low index": dict(base_color=RED, spec_trans=0.9, roughness=0.7, eta=0.7, spec_tint=0.5, clearcoat=0.5),
    "dense": dict(base_color=RED, spec_trans=0.6, roughness=0.4, eta=2.4, anisotropic=0.5, metallic=0.2),
    "all": dict(
        base_color=RED, spec_trans=0.5, roughness=0.45, specular=0.8, anisotropic=0.3, metallic=0.3, spec_tint=0.4,
        sheen=0.6, sheen_tint=0.5, flatness=0.4, clearcoat=0.8, clearcoat_gloss=0.1,
    ),
}  # fmt: skip
THIN = {
    "default": {},
    "paper": dict(base_color=RED, diff_trans=1.2, flatness=0.5, sheen=0.7, sheen_tint=0.4, roughness=0.9),
    "leaf": dict(base_color=RED, diff_trans=2.0, spec_trans=0.3, roughness=0.4, spec_tint=0.6),
    "pane": dict(base_color=RED, spec_trans=1.0, roughness=0.5, anisotropic=0.6, eta=1.3),
    "sheet": dict(base_color=RED, spec_trans=0.7, diff_trans=0.6, roughness=0.7, eta=1.8, spec_tint=0.3),
    "bubble": dict(base_color=RED, spec_trans=0.9, diff_trans=0.6, roughness=0.8, eta=0.8, spec_tint=0.3),
}
CASES = {("principled", k): v for k, v in SOLID.items()} | {("principledthin", k): v for k, v in THIN.items()}
EVERY = pytest.mark.parametrize("case", CASES, ids=" ".join)
COLUMNS = MaterialColumns(3)


def row(case):
    """The lobe and the row of the table."""
    made = (jaxrt.Principled if case[0] == "principled" else jaxrt.PrincipledThin)(**CASES[case]).row()
    return made.lobe, np.float32(COLUMNS.row(LOBES[made.lobe].number, **made.fields))


def directions(n, seed, grazing=0.05):
    rng = np.random.default_rng(seed)
    z = rng.uniform(grazing, 1, n) * rng.choice([-1, 1], n)
    phi, r = rng.uniform(-np.pi, np.pi, n), np.sqrt(1 - z**2)
    return np.float32(np.stack([r * np.cos(phi), r * np.sin(phi), z], 1))


def material(cells):
    return Material.of(cells, COLUMNS, lambda number, value: value)


@functools.partial(jax.jit, static_argnums=0)
def _values(lobe, cells, wi, wo):
    m = material(cells)
    one = lambda a, b: (
        brdf.eval((lobe,), m, Vec3.of(a), Vec3.of(b)).array(),
        brdf.pdf((lobe,), m, Vec3.of(a), Vec3.of(b)),
    )
    return jax.vmap(one)(wi, wo)


def values(case, wi, wo):
    """f_r, (N, 3), and density in float64."""
    wi, wo = np.broadcast_arrays(np.float32(wi), np.float32(wo))
    return [np.asarray(a, np.float64) for a in _values(*row(case), wi, wo)]


@functools.partial(jax.jit, static_argnums=0)
def _samples(lobe, cells, wo, u):
    m = material(cells)
    return jax.vmap(lambda v: brdf.sample((lobe,), m, Vec3.of(wo), tuple(v))[0].array())(u)


def samples(case, wo, n, seed=0):
    u = np.float32(np.random.default_rng(seed).random((n, 3)))
    return np.asarray(_samples(*row(case), wo, np.minimum(u, np.float32(1 - 2.0**-24))), np.float64)


@pytest.mark.peer
@EVERY
def test_values_are_those_of_mitsuba(case):
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    given = dict(CASES[case])
    if "base_color" in given:
        given["base_color"] = {"type": "rgb", "value": given["base_color"]}
    peer = mi.load_dict({"type": case[0], **given})
    wi, wo = directions(60, 1), directions(60, 2)
    wi[:20] = np.float32([-1, -1, 1]) * wo[:20] + 0.1 * wi[:20]  # near the mirror direction
    wi[20:40] = -wo[20:40] + 0.2 * wi[20:40]  # nearly straight on
    wi /= np.linalg.norm(wi, axis=1, keepdims=True)
    si, theirs = mi.SurfaceInteraction3f(), []
    for a, b in zip(wi, wo, strict=True):
        si.wi = mi.Vector3f(*map(float, b))
        theirs.append(peer.eval(mi.BSDFContext(), si, mi.Vector3f(*map(float, a))))
    theirs, ours = np.array(theirs, np.float64), values(case, wi, wo)[0] * np.abs(wi[:, 2:])
    assert (theirs > 0).any(1).mean() > 0.1
    np.testing.assert_allclose(ours, theirs, rtol=1e-3, atol=1e-6)


BANDS, SECTORS, FINE = 32, 32, 10


@functools.cache
def sphere():
    """Directions at the middles of fine bins of (θ, φ), and their solid angles."""
    theta = (np.arange(BANDS * FINE) + 0.5) * np.pi / (BANDS * FINE)
    phi = -np.pi + (np.arange(SECTORS * FINE) + 0.5) * 2 * np.pi / (SECTORS * FINE)
    r = np.sin(theta)[:, None]
    d = np.stack(np.broadcast_arrays(r * np.cos(phi), r * np.sin(phi), np.cos(theta)[:, None]), -1)
    return d.reshape(-1, 3), np.broadcast_to(r * 2 * np.pi**2 / (BANDS * SECTORS * FINE**2), d.shape[:2]).ravel()


DRAWN = [
    *(("principled", k) for k in ("rough", "some metal", "cloth", "glass", "low index", "dense")),
    *(("principledthin", k) for k in ("leaf", "pane", "sheet")),
]


@pytest.mark.parametrize("case", DRAWN, ids=" ".join)
@pytest.mark.parametrize("cos", [0.8, 0.25, -0.5])
def test_samples_follow_the_density(case, cos):
    """χ² over the sphere, the albedo by samples and by quadrature, and no direction is drawn without a density."""
    n, wo = 50_000, np.float32([np.sqrt(1 - cos**2) * 0.8, np.sqrt(1 - cos**2) * 0.6, cos])
    d, solid = sphere()
    f, p = values(case, d, wo)
    whole = p @ solid
    assert whole == pytest.approx(1, abs=3e-3)
    share = (p * solid).reshape(BANDS, FINE, SECTORS, FINE).sum((1, 3)).ravel() / whole
    s = samples(case, wo, n)
    np.testing.assert_allclose(np.linalg.norm(s, axis=1), 1, atol=1e-5)
    band = np.minimum(np.arccos(np.clip(s[:, 2], -1, 1)) / np.pi * BANDS, BANDS - 1).astype(int)
    sector = np.minimum((np.arctan2(s[:, 1], s[:, 0]) + np.pi) / (2 * np.pi) * SECTORS, SECTORS - 1).astype(int)
    counts = np.bincount(band * SECTORS + sector, minlength=BANDS * SECTORS)
    rich = n * share >= 10
    counts, expected = np.append(counts[rich], counts[~rich].sum()), np.append(share[rich], share[~rich].sum()) * n
    keep = expected > 0
    chance = stats.chi2.sf(((counts - expected)[keep] ** 2 / expected[keep]).sum(), keep.sum() - 1)
    assert chance > 1e-4

    got, density = values(case, s, wo)
    assert (density > 0).all()
    weight = (got * np.abs(s[:, 2:]) / density[:, None]).mean(1)
    want = ((f * np.abs(d[:, 2:])).mean(1) * solid).sum()
    assert abs(weight.mean() - want) < 4 * weight.std() / np.sqrt(n) + 2e-3 * want + 1e-9


@pytest.mark.peer
@pytest.mark.parametrize("case", [("principled", "coat"), ("principled", "all"), ("principledthin", "paper")], ids=" ".join)  # fmt: skip
@pytest.mark.parametrize("cos", [0.7, -0.6])
def test_albedos_are_those_of_mitsuba(case, cos):
    """Narrow coats included, where quadrature fails."""
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    given = {**CASES[case], "base_color": {"type": "rgb", "value": RED}}
    peer, si = mi.load_dict({"type": case[0], **given}), mi.SurfaceInteraction3f()
    wo, rng = np.float32([np.sqrt(1 - cos**2), 0, cos]), np.random.default_rng(3)
    si.wi = mi.Vector3f(*map(float, wo))
    u = rng.random((6000, 3))
    theirs = np.array([peer.sample(mi.BSDFContext(), si, v[0], mi.Point2f(v[1], v[2]))[1] for v in u]).mean(1)
    s = samples(case, wo, 50_000)
    f, p = values(case, s, wo)
    ours = f.mean(1) * np.abs(s[:, 2]) / p
    spread = np.hypot(theirs.std() / np.sqrt(len(theirs)), ours.std() / np.sqrt(len(ours)))
    assert abs(ours.mean() - theirs.mean()) < 4 * spread + 1e-9


@functools.partial(jax.jit, static_argnums=0)
def _slopes(lobe, cells, wi, wo):
    def value(cells, wi, wo):
        return brdf.eval((lobe,), material(cells), Vec3.of(wi), Vec3.of(wo)).channels[0]

    def one(wi, wo):
        m, a, b = material(cells), Vec3.of(wi), Vec3.of(wo)
        u = (0.5 + 0.4 * wi[0], 0.5 - 0.4 * wi[1], 0.5 + 0.49 * wi[2])
        drawn = brdf.sample((lobe,), m, b, u)[0].array(), brdf.pdf((lobe,), m, a, b)
        return jax.value_and_grad(value, (0, 1, 2))(cells, wi, wo), drawn

    return jax.vmap(one)(wi, wo)


EXTREMES = [
    {}, dict(roughness=0.0), dict(roughness=1.0, anisotropic=1.0), dict(metallic=1.0, base_color=0.0), dict(eta=1.0),
    dict(spec_trans=1.0, base_color=0.0), dict(spec_trans=1.0, eta=1.0), dict(spec_trans=1.0, roughness=0.0, eta=0.5),
    dict(sheen=1.0, sheen_tint=1.0, base_color=0.0), dict(clearcoat=1.0, clearcoat_gloss=1.0, flatness=1.0),
    dict(spec_tint=1.0, base_color=[0, 0, 1.0], spec_trans=1.0, eta=1e-3), dict(eta=1e3, spec_trans=0.5),
    dict(diff_trans=2.0, base_color=0.0), dict(diff_trans=2.0, spec_trans=0.5, eta=1e3),
]  # fmt: skip


@pytest.mark.parametrize("part", [jaxrt.Principled, jaxrt.PrincipledThin])
def test_values_and_derivatives_are_finite(part):
    """At the ends of every range, straight on, at grazing incidence and in the surface, from both sides."""
    known = part.__dataclass_fields__
    z = np.float32([1, 0.6, 1e-3, 1e-6, 0])
    a = [np.stack([np.sqrt(1 - z * z) * np.cos(p), np.sqrt(1 - z * z) * np.sin(p), s * z], 1) for p in (0.0, 2.2, 2.2 + np.pi) for s in (1, -1)]  # fmt: skip
    a = np.float32(np.concatenate(a))
    wi, wo = np.repeat(a, len(a), 0), np.tile(a, (len(a), 1))
    for given in EXTREMES:
        if not set(given) <= set(known):
            continue
        made = part(**given).row()
        cells = np.float32(COLUMNS.row(LOBES[made.lobe].number, **made.fields))
        for leaf in jax.tree.leaves(_slopes(made.lobe, cells, wi, wo)):
            assert np.isfinite(leaf).all(), given


@pytest.mark.parametrize("case", [("principled", "all"), ("principledthin", "sheet")], ids=" ".join)
def test_derivatives_with_respect_to_parameters(case):
    """Against differences."""
    lobe, cells = row(case)
    wi, wo = directions(64, 5, 0.3), directions(64, 6, 0.3)

    def f(cells):
        m = material(cells)
        return jax.vmap(lambda a, b: brdf.eval((lobe,), m, Vec3.of(a), Vec3.of(b)).array())(wi, wo)

    along = jax.jit(lambda v: jax.jvp(f, (jnp.asarray(cells),), (v,))[1])
    f, step = jax.jit(f), 1e-3
    for name in LOBES[lobe].fields:
        v = np.float32(np.arange(len(cells)) == COLUMNS[name][0])
        want = (np.asarray(f(cells + step * v), float) - np.asarray(f(cells - step * v), float)) / (2 * step)
        atol = 4e-3 * max(np.abs(want).max(), 0.1)
        np.testing.assert_allclose(along(v), want, rtol=0.02, atol=atol, err_msg=name)


def test_an_opaque_surface_has_no_other_side():
    wi, wo = directions(60, 7), directions(60, 8)
    f = values(("principled", "skin"), wi, wo)[0]
    up = (wi[:, 2] > 0) & (wo[:, 2] > 0)
    assert (f[up] > 0).all()
    np.testing.assert_array_equal(f[~up], 0)


def test_transmission_is_reciprocal_but_for_the_index():
    """f(ω_i, ω_o) of light that enters is η⁻² times that of light that leaves, by radiance over η²."""
    case = ("principled", "dense")
    wi, wo = directions(60, 9), directions(60, 10)
    wi[:, 2] = -np.sign(wo[:, 2]) * np.abs(wi[:, 2])
    there, back = values(case, wi, wo)[0], values(case, wo, wi)[0]
    eta2 = np.where(wo[:, 2:] > 0, 2.4**2, 2.4**-2)
    assert (there > 0).any(1).mean() > 0.3
    np.testing.assert_allclose(there * eta2, back, rtol=2e-3, atol=1e-6)


def test_a_thin_sheet_is_alike_from_both_sides():
    wi, wo = directions(60, 11), directions(60, 12)
    flip = np.float32([1, 1, -1])
    for a, b in zip(values(("principledthin", "sheet"), wi, wo), values(("principledthin", "sheet"), wi * flip, wo * flip), strict=True):  # fmt: skip
        np.testing.assert_allclose(a, b, rtol=1e-5)


def test_parts():
    index = lambda **given: jaxrt.Principled(**given).row().fields["ior"]
    assert index() == pytest.approx(1.5)
    assert index(specular=0.0) == 1.0 and index(specular=1.0) == pytest.approx(1.789, abs=1e-3)
    for bad in (
        dict(eta=1.5, specular=0.5),
        dict(metallic=1.1),
        dict(roughness=-0.1),
        dict(eta=0.0),
        dict(base_color=2),
    ):
        with pytest.raises(jaxrt.SceneError):
            jaxrt.Principled(**bad)
    jaxrt.PrincipledThin(diff_trans=2.0)
    for field in ("eta", "specular"):
        with pytest.raises(jaxrt.SceneError, match="takes no texture"):
            jaxrt.Principled(**{field: jaxrt.Checkerboard(0.5, 1.0)})
    jaxrt.TwoSided(jaxrt.Principled())
    for part in (
        jaxrt.Principled(spec_trans=jaxrt.Checkerboard(0.1, 0.2)),
        jaxrt.Principled(spec_trans=0.1),
        jaxrt.PrincipledThin(),
    ):
        with pytest.raises(jaxrt.SceneError, match="transmits"):
            jaxrt.TwoSided(part)


def test_a_black_one_still_shines_and_anisotropy_needs_tangents():
    plan = lambda **given: jaxrt.plan(jaxrt.Scene.build([jaxrt.Rectangle(bsdf=jaxrt.Principled(**given))]), free=None)
    assert plan(base_color=0.0).bounces and not plan().tangents
    assert plan(anisotropic=0.5).tangents and plan(anisotropic=jaxrt.Checkerboard(0.0, 1.0)).tangents
