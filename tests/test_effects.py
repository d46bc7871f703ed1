"""The plan: what is in, what is left out of the program, and what values it relies on."""

import functools
import re
from collections import Counter

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import camera

import jaxrt
from jaxrt import compiler
from jaxrt.effects.costs import dropped_radiance
from jaxrt.effects.effect import Effect, Found
from jaxrt.effects.registry import EFFECTS
from jaxrt.sampling.sobol import Stream
from jaxrt.solver import measure, path
from jaxrt.vector import Vec3
from jaxrt.world import prepare

pytestmark = pytest.mark.usefixtures("short_loops")


def room(*more, radiance=1.0, reflectance=0.5, **parts):
    lamp = np.diag([0.5, 0.5, -1.0, 1.0])
    lamp[2, 3] = 2.0
    shapes = [
        jaxrt.Rectangle(id="floor", bsdf=jaxrt.Diffuse(reflectance, id="paint")),
        jaxrt.Rectangle(id="lamp", to_world=lamp, emission=radiance, emission_id="light", bsdf=jaxrt.Diffuse(0.0)),
        *more,
    ]
    film = jaxrt.Film(8, 8, "box")
    return jaxrt.Scene.build(shapes, sensors=[jaxrt.Sensor(film=film)], channels=3, **parts)


def lowered(scene, plan):
    """The program of the path method for a plan, as text."""
    world = jax.eval_shape(functools.partial(prepare, plan=plan), scene)
    view, depths = measure.view_of(scene, 0), measure.depths_of(scene, 4)
    pixels = jnp.arange(64, dtype=jnp.int32)[:, None]
    return jax.jit(path.trace).lower(world, view, depths, jnp.uint32(0), pixels, 0, 4).as_text()


SPHERE = dict(center=(0.0, 0.0, 0.5), radius=0.2)


def test_what_is_left_out_leaves_no_trace():
    plain = room()
    short = lowered(plain, jaxrt.plan(plain))
    for more in (
        jaxrt.Sphere(**SPHERE),
        jaxrt.Rectangle(bsdf=jaxrt.Conductor(alpha=0.2)),
        jaxrt.Rectangle(bsdf=jaxrt.Conductor()),
    ):
        rich = room(more)
        assert len(lowered(rich, jaxrt.plan(rich)).splitlines()) > len(short.splitlines()) + 50
    dark = room(radiance=0.0)
    without_lamp = lowered(dark, jaxrt.plan(dark, free=None))
    assert len(without_lamp.splitlines()) < len(short.splitlines()) - 1050
    grey = lowered(plain, jaxrt.plan(plain, free=None))
    assert len(grey.splitlines()) < len(short.splitlines())


def test_a_plan_is_static_and_values_do_not_change_it():
    a, b = room(reflectance=0.3), room(reflectance=0.7, radiance=5.0)
    assert jaxrt.plan(a) == jaxrt.plan(b)
    assert hash(jaxrt.plan(a)) == hash(jaxrt.plan(b))
    assert jaxrt.plan(a) != jaxrt.plan(room(jaxrt.Sphere(**SPHERE)))
    assert {"area_light", "lobe:diffuse", "parallelogram", "bounces"} <= jaxrt.plan(a).effects
    assert not {"sphere", "lobe:ggx", "twosided", "smooth_normals"} & jaxrt.plan(a).effects


def test_a_grey_scene_runs_on_one_channel_and_looks_the_same():
    scene = room()
    one, three = jaxrt.plan(scene, free=None), jaxrt.plan(scene)
    assert (one.channels, three.channels) == (1, 3)
    got = [jaxrt.render(scene, spp=4, plan=p, max_depth=3).image for p in (one, three)]
    assert got[0].shape == got[1].shape == (8, 8, 3)
    np.testing.assert_allclose(got[0], got[1], rtol=1e-5, atol=1e-6)


def test_free_parameters_are_not_specialised_on():
    dark = room(radiance=0.0)
    assert "area_light" not in jaxrt.plan(dark, free=None).effects
    assert jaxrt.plan(dark, free=None).assumes
    assert "area_light" in jaxrt.plan(dark, free="light.*").effects
    assert "area_light" in jaxrt.plan(dark).effects
    assert jaxrt.plan(room(), free="paint.reflectance").channels == 3
    black = room(reflectance=0.0)
    assert "bounces" not in jaxrt.plan(black, free=None).effects
    assert "bounces" in jaxrt.plan(black, free="paint.reflectance").effects


def test_names_that_do_not_exist_are_refused_with_the_closest():
    with pytest.raises(jaxrt.SceneError, match=r"paint\.reflectance"):
        jaxrt.plan(room(), free="paint.reflectanse")
    with pytest.raises(jaxrt.SceneError, match="closest: enclosure"):
        jaxrt.plan(room(), enclosures=False)
    with pytest.raises(jaxrt.SceneError, match="lobe:ggx"):
        jaxrt.plan(room(), ggx=True)


def test_an_effect_can_be_forced_out():
    scene = room(enclosure=jaxrt.Enclosure(1.0))
    at = lambda **out: jaxrt.radiance(scene, (0.0, 0.0, 1.5), (0.3, 0.2, -1.0), plan=jaxrt.plan(scene, **out), spp=64)
    both, lamp, sky = (np.asarray(at(**out)) for out in ({}, {"enclosure": False}, {"area_light": False}))
    assert "enclosure" not in jaxrt.plan(scene, enclosure=False).effects
    assert (lamp > 0.01).all() and (sky > 0.01).all()
    np.testing.assert_allclose(lamp + sky, both, rtol=0.05)
    np.testing.assert_allclose(at(light_sampling=False), both, rtol=0.2)
    assert (at(enclosure=False, area_light=False) == 0).all()


# ------------------------------------------------------------------------------- each effect of its own


OF_PROGRAMS = [name for name, effect in EFFECTS.items() if not effect.fixed]
"""Effects that can be forced."""


def operations(scene, plan):
    """How many there are of each operation in a bounce."""

    def one(scene, o, d, k):
        world = prepare(scene, plan)
        begin = path.start(world, Vec3.of(o), Vec3.of(d))
        return path.bounce(world, measure.depths_of(scene, 4), begin, Stream(k, k))

    text = str(jax.make_jaxpr(one)(scene, jnp.zeros(3), jnp.zeros(3), jnp.uint32(0)))
    return Counter(re.findall(r" = (\w+)", text))


def test_every_effect_changes_the_program_and_leaves_no_trace_where_it_is_out(monkeypatch):
    scene = room()
    plan = jaxrt.plan(scene, free=None)
    before = operations(scene, plan)
    for name in OF_PROGRAMS:
        on = name in plan.effects
        if not on:  # the program is the one there was before anybody thought of the effect
            with monkeypatch.context() as patch:
                patch.setitem(EFFECTS, name, Effect(name, lambda facts, chosen: Found(False, "")))
                assert jaxrt.plan(scene, free=None) == plan, name
        after = operations(scene, jaxrt.plan(scene, free=None, **{name: not on}))
        if name in ("enclosure", "environment"):  # without that, the last ray is aimed at lamps
            assert after != before, name
        elif name == "lobe:diffuse":  # black in its stead
            assert after.total() >= before.total()
        else:
            assert (after.total() < before.total()) == on, name


@pytest.mark.slow
@pytest.mark.parametrize("lobes", [True, False])
def test_a_plain_scene_looks_the_same_with_everything_forced_in(lobes):
    scene = room()
    plain = jaxrt.plan(scene, free=None)
    o = np.random.default_rng(0).uniform(-0.5, 0.5, (64, 3)) + [0, 0, 1.0]
    left = ("solid_angle", "environment", "nested", "smooth_lights")  # other samples, and what plain scenes cannot have
    names = [name for name in OF_PROGRAMS if name.startswith("lobe:") == lobes and name not in left]
    rich = jaxrt.plan(scene, free=None, **{name: True for name in names})
    assert rich.effects >= set(names)
    quick = {"xla_backend_optimization_level": 0, "xla_llvm_disable_expensive_passes": True}

    def seen(plan):
        f = jax.jit(lambda s, o: jaxrt.radiance(s, o, (0.0, 0.0, -1.0), 3, plan=plan, spp=8, max_depth=3))
        return f.lower(scene, o).compile(quick)(scene, o)

    a, b = seen(plain), seen(rich)
    assert (np.asarray(a) > 0).all()
    np.testing.assert_allclose(a, b, rtol=1e-5)


def test_a_value_does_not_compile_again_and_a_plan_does(monkeypatch):
    scene = room()
    plan = jaxrt.plan(scene)
    render = lambda scene, plan: jaxrt.render(scene, spp=4, plan=plan, max_depth=3).image
    first, made = render(scene, plan), compiler.programs()
    other = jaxrt.with_params(scene, {"paint.reflectance": 0.7, "light.radiance": [3.0, 2.0, 1.0]})
    assert (render(other, jaxrt.plan(other)) != first).any()
    assert compiler.programs() == made

    def compiles(*_):
        raise RuntimeError("compiles")

    monkeypatch.setattr(compiler, "_make", compiles)
    with pytest.raises(RuntimeError, match="compiles"):
        render(scene, jaxrt.plan(scene, smooth_normals=True, light_sampling=False))


# ------------------------------------------------------------------------------------------- assumptions


def refused(match, scene, plan, **values):
    scene = jaxrt.with_params(scene, {name.replace("__", "."): value for name, value in values.items()})
    down = (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)
    for use in (
        lambda: jaxrt.measure(scene, 0, plan=plan, spp=1),
        lambda: jaxrt.render(scene, 1, plan=plan),
        lambda: jaxrt.irradiance(scene, *down, plan=plan),
        lambda: jaxrt.solve(scene, plan=plan),
    ):
        with pytest.raises(jaxrt.SceneError, match=match):
            use()


def test_values_that_a_plan_does_not_have_are_refused_by_name():
    free = r"light\.radiance: is 2 2 2.*stays dark.*free=\"light\.radiance\""
    dark = room(radiance=0.0)
    refused(free, dark, jaxrt.plan(dark, free=None), light__radiance=2.0)
    refused(r"enclosure\.radiance: is 1", room(), jaxrt.plan(room(), free=None), enclosure__radiance=1.0)
    red = [0.5, 0.1, 0.1]
    refused(
        r"paint\.reflectance: is 0\.5 0\.1 0\.1.*grey", room(), jaxrt.plan(room(), free=None), paint__reflectance=red
    )
    black = room(reflectance=0.0)
    plan = jaxrt.plan(black, free="light.*")
    assert [(a.effect, a.leaf, a.holds) for a in plan.assumes] == [
        ("enclosure", "radiance", "zero")
    ] or not plan.bounces
    refused(r"paint\.reflectance: is 0\.3.*stays 0", black, plan, paint__reflectance=0.3)
    coat = room(jaxrt.Rectangle(bsdf=jaxrt.Principled(id="coat")))
    refused(r"coat\.anisotropic", coat, jaxrt.plan(coat, free=None), coat__anisotropic=0.5)
    assert jaxrt.plan(coat).tangents  # where it may move
    # What no assumption is about may have any value.
    jaxrt.effects.fitting(jaxrt.with_params(room(), {"paint.reflectance": 0.9}), jaxrt.plan(room(), free=None))


def test_another_scenes_plan_is_refused_by_what_it_leaves_out():
    plan = jaxrt.plan(room())
    board = jaxrt.Rectangle(bsdf=jaxrt.Diffuse(jaxrt.Checkerboard()))
    for match, other in (
        (r"lobe:ggx \(material steel\)", room(jaxrt.Rectangle(bsdf=jaxrt.Conductor(alpha=0.2, id="steel")))),
        ("texture:checkerboard", room(board)),
        ("light_selection", room(jaxrt.Rectangle(emission=1.0))),
        ("spot", room(lamps=[jaxrt.Spot(position=(0, 0, 1.0))])),
        ("twosided", room(jaxrt.Rectangle(bsdf=jaxrt.TwoSided(jaxrt.Diffuse(0.5))))),
    ):
        refused(match, other, plan)
    lamps = room(jaxrt.Rectangle(emission=1.0))
    refused("kinds of lights", room(jaxrt.Sphere(**SPHERE, emission=1.0)), jaxrt.plan(lamps))
    jaxrt.effects.fitting(room(), jaxrt.plan(room(board)))  # more than the scene needs is no mistake


def test_derivatives_in_what_a_plan_assumes_are_refused():
    scene = room()
    down = (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)
    mean = lambda s, plan: jaxrt.radiance(s, *down, plan=plan, spp=1, max_depth=2).mean()
    moved = lambda v: jaxrt.with_params(scene, {"light.radiance": v})
    fixed, free = jaxrt.plan(scene, free=None), jaxrt.plan(scene, free="light.*")
    with pytest.raises(jaxrt.SceneError, match=r"light\.radiance: is traced"):
        jax.grad(lambda v: mean(moved(v), fixed))(1.0)
    whole = jax.jit(mean, static_argnums=1)  # in which the names of what moves are lost
    with pytest.raises(jaxrt.SceneError, match=r"light\.radiance: is differentiated"):
        jax.grad(lambda v: whole(moved(v), fixed))(1.0)
    with pytest.raises(jaxrt.SceneError, match=r"enclosure\.radiance: is traced"):
        jax.grad(lambda v: mean(jaxrt.with_params(scene, {"enclosure.radiance": v}), free))(1.0)
    jax.make_jaxpr(jax.grad(lambda v: mean(moved(v), free)))(
        1.0
    )  # the free ones may move, also where the others do not
    jax.make_jaxpr(jax.grad(lambda v: whole(moved(v), free)))(1.0)


# ---------------------------------------------------------------------------------------------- forcing


def test_the_table_names_the_parts_and_what_was_forced():
    glass = jaxrt.Sphere(id="ball", center=(0, 0, 0.5), radius=0.2, bsdf=jaxrt.Dielectric(id="glass"))
    scene = room(glass)
    rows = lambda plan: {name: (on, why) for name, on, why in plan.reasons}
    found = rows(jaxrt.plan(scene))
    assert found["lobe:glass"] == (True, "material glass") and "ball" in found["sphere"][1]
    assert "light" in found["area_light"][1] and "paint" in found["lobe:diffuse"][1]
    forced = jaxrt.plan(scene, **{"lobe:glass": False, "smooth_normals": True, "solid_angle": False})
    assert forced.dropped == ("lobe:glass",)  # the others change no picture
    assert rows(forced)["lobe:glass"] == (False, "forced out; material glass")
    assert "forced in" in rows(forced)["smooth_normals"][1]
    assert "needs area_light" in rows(jaxrt.plan(scene, light_sampling=True, area_light=False))["light_sampling"][1]
    for name in ("sphere", "rays:bvh", "film:box"):
        with pytest.raises(jaxrt.SceneError, match=f"{name}: "):
            jaxrt.plan(scene, **{name: False})
    with pytest.raises(jaxrt.SceneError, match="light_selection: cannot be left out"):
        jaxrt.plan(room(jaxrt.Rectangle(emission=1.0)), light_selection=False)


def test_what_is_forced_out_is_black_or_plain():
    board = jaxrt.Checkerboard(0.2, [0.8, 0.4, 0.6])
    steel, paint = jaxrt.Conductor(alpha=0.2), jaxrt.Diffuse([0.1, 0.2, 0.3])
    for bsdf, name, instead in (
        (jaxrt.Diffuse(board), "texture:checkerboard", jaxrt.Diffuse([0.5, 0.3, 0.4])),
        (steel, "lobe:ggx", jaxrt.Diffuse(0.0)),
        (jaxrt.Blend(paint, jaxrt.Diffuse(0.0), 0.3), "blend", paint),
        (jaxrt.BumpMap(jaxrt.Diffuse([0.1, 0.2, 0.3]), jaxrt.Bitmap(np.eye(4))), "bumpmap", paint),
    ):
        more = {"texture:bitmap": False} if name == "bumpmap" else {}
        scene, other = (room(jaxrt.Rectangle(id="wall", bsdf=b)) for b in (bsdf, instead))
        plan, want = jaxrt.plan(scene, **{name: False}, **more), jaxrt.plan(other)
        assert name in plan.cut and plan.fields == want.fields
        rows = [
            jax.jit(lambda s, p=p: prepare(s, p).finishes[s.shape_finish[2]])(s)
            for s, p in ((scene, plan), (other, want))
        ]
        np.testing.assert_allclose(*rows, rtol=1e-6)


def test_dropped_radiance_is_what_the_effect_brought():
    """A lamp that fills a third of the picture before a sky, both of radiance 1."""
    lamp = jaxrt.Rectangle(id="lamp", emission=1.0, bsdf=jaxrt.Diffuse(0.0))
    sensors = [camera((0, 0, 3.0), (0, 0, 0.0), 8, 8, 60.0, up=(0, 1, 0))]
    scene = jaxrt.Scene.build([lamp], enclosure=jaxrt.Enclosure(1.0), sensors=sensors)
    mean, less, error = dropped_radiance(scene, {"enclosure": False})
    assert abs(mean - 1.0) < 1e-5 and error < 0.01 and abs(less - 2 / 3) < 4.5 * error
    (cost,) = jaxrt.effect_costs(scene, ["enclosure"], spp=64, repeat=2)
    assert cost.on and min(cost.seconds) > 0 and cost.rays[0] > 0
    np.testing.assert_allclose(cost.radiance[0], less, rtol=1e-5)
