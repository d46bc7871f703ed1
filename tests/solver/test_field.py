"""The field method against closed forms, the path method and differences."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import optimistix
import pytest
from helpers import camera, z_of
from test_path import room

import jaxrt
from jaxrt.sampling.sobol import Stream, combine
from jaxrt.solver.choose import choose
from jaxrt.solver.elements import BLACK, corners_of_pieces, element_of, sampled
from jaxrt.solver.equilibrium import SOLVERS, Anderson, solve_links
from jaxrt.solver.field import links_of
from jaxrt.solver.partition import partition
from jaxrt.surface import surface_point
from jaxrt.world import prepare

pytestmark = pytest.mark.usefixtures("short_loops")

SMALL = {"resolution": 400, "directions": 64, "max_depth": -1}


@functools.cache
def plan(lights=True):
    return jaxrt.plan(room(0.5, walls=1.0), light_sampling=lights)


def solved(scene, **options):
    return jaxrt.solve(scene, options.pop("key", 0), plan=plan(), **(SMALL | options))


def mean_over(field):
    """Mean of what elements store, by area, (C,) in float64."""
    area = np.asarray(field.elements.area, np.float64)[:, None]
    return (area * np.asarray(field.values, np.float64)).sum(0) / area.sum()


# --------------------------------------------------------------------------------------------------- elements


def many_kinds():
    mesh = jaxrt.Mesh(
        vertices=np.array([[0.0, 0, 0], [2, 0, 0], [0, 1, 0], [1, 1, 0.5]]),
        faces=np.array([[0, 1, 2], [2, 1, 3]]),
        id="m",
    )
    shapes = [
        mesh,
        jaxrt.Rectangle(id="r"),
        jaxrt.Disk(id="d", bsdf=jaxrt.TwoSided(jaxrt.Diffuse(0.5))),
        jaxrt.Sphere(id="s", center=(0.0, 0.0, 3.0), radius=0.7),
        jaxrt.Cylinder(id="c", p0=(0.0, 0.0, 4.0), p1=(0.0, 1.0, 5.0), radius=0.3),
        jaxrt.Rectangle(id="mirror", bsdf=jaxrt.Conductor(1.0)),
    ]
    return jaxrt.Scene.build(shapes, sensors=[camera((0, -9, 1), (0, 0, 0))])


def check_partition(scene, resolution, world_area, levels=False):
    chosen = jaxrt.plan(scene)
    world = jax.jit(prepare, static_argnums=1)(scene, chosen)
    elements, _, cell = partition(world, scene, resolution)
    if levels:
        some = np.random.default_rng(0).choice([1, 2, 4], cell.max() + 1)
        elements, *_ = partition(world, scene, resolution, some)
    elements = jax.tree.map(jnp.asarray, elements)

    def one(e, k):
        s = Stream(k.astype(jnp.uint32), combine(jnp.uint32(3), e))
        face, y, n = sampled(world, elements, e, s.pair_at(0), s.pair_at(1)[0])
        x = surface_point(world, face, y + n, -n)
        return element_of(world, elements, x, n), jnp.abs(x.distance - 1.0)

    real = jnp.asarray(np.flatnonzero(np.asarray(elements.size) > 0))
    found, off = jax.jit(jax.vmap(lambda e: jax.vmap(lambda k: one(e, k))(jnp.arange(32))))(real)
    assert float(np.mean(np.asarray(found) != np.asarray(real)[:, None])) < 1e-4  # on a border rounding decides
    assert float(off.max()) < 1e-3
    np.testing.assert_allclose(float(elements.area.sum()), world_area, rtol=1e-4)
    assert len(real) > resolution / 3
    return elements


@pytest.mark.parametrize("levels", [False, True])
def test_a_point_of_an_element_lies_in_it(levels):
    side = (
        np.linalg.norm(np.cross([2.0, 0, 0], [0, 1, 0])) / 2 + np.linalg.norm(np.cross([2.0, -1, 0], [1.0, 0, 0.5])) / 2
    )
    area = side + 4.0 + 2 * np.pi + 4 * np.pi * 0.49 + 2 * np.pi * 0.3 * np.sqrt(2.0)
    check_partition(many_kinds(), 300, area, levels)


def test_small_faces_share_elements():
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=4)
    mesh = jaxrt.Mesh(vertices=np.array(ball.vertices), faces=np.array(ball.faces), id="ball")
    scene = jaxrt.Scene.build([mesh], sensors=[camera((0, -9, 1), (0, 0, 0))])
    elements = check_partition(scene, 200, ball.area)
    assert elements.clustered and 100 < int((elements.size > 0).sum()) < 1000 < len(ball.faces)


def test_elements_are_smaller_where_light_ends():
    """A board between lamp and floor: the border of its shadow is cut finer than the lit floor."""
    place = lambda s, x, z, up: np.array([[s, 0, 0, x], [0, s * up, 0, 0], [0, 0, up, z], [0, 0, 0, 1.0]])
    shapes = [
        jaxrt.Rectangle(id="floor", to_world=place(4.0, 0.0, 0.0, 1)),
        jaxrt.Rectangle(id="board", to_world=place(2.0, -1.7, 0.5, 1), bsdf=jaxrt.TwoSided(jaxrt.Diffuse(0.5))),
        jaxrt.Rectangle(id="lamp", to_world=place(0.1, 0.0, 2.0, -1), emission=1.0),
    ]
    scene = jaxrt.Scene.build(shapes, sensors=[camera((0, -9, 1), (0, 0, 0))])
    elements = jaxrt.elements_of(scene, resolution=400)
    world = jax.jit(prepare, static_argnums=1)(scene, jaxrt.plan(scene))
    corners, element, _ = corners_of_pieces(world, elements)
    middle, size = corners.mean(1), np.asarray(elements.size)[element]
    floor = (np.abs(middle[:, 2]) < 1e-3) & (np.abs(middle[:, 1]) < 1.0)
    border, lit = floor & (np.abs(middle[:, 0] - 0.4) < 0.3), floor & (middle[:, 0] > 1.0) & (middle[:, 0] < 2.0)
    assert border.any() and lit.any()
    assert size[border].min() < 0.6 * np.median(size[lit])


def test_triangles_alone_are_refined():
    """The last cell of a triangle's grid is outside of it."""
    quad = lambda z, s: [[-s, -s, z], [s, -s, z], [s, s, z], [-s, s, z]]
    mesh = lambda name, v, faces, **more: jaxrt.Mesh(
        vertices=np.array(v, float), faces=np.array(faces), id=name, **more
    )
    shapes = [
        mesh("floor", quad(0.0, 2.0), [[0, 1, 2], [0, 2, 3]]),
        mesh("lamp", quad(2.0, 0.2), [[0, 2, 1], [0, 3, 2]], emission=1.0),
        mesh("fin", [[0, -1, 0], [0, 1, 0], [0, 0, 1]], [[0, 1, 2]], bsdf=jaxrt.TwoSided(jaxrt.Diffuse(0.5))),
    ]
    scene = jaxrt.Scene.build(shapes, sensors=[camera((0, -9, 1), (0, 0, 0))])
    elements = jaxrt.elements_of(scene, resolution=400)
    np.testing.assert_allclose(float(elements.area.sum()), 16.0 + 0.16 + 2.0, rtol=1e-4)
    assert int((elements.size > 0).sum()) > 500


def test_what_reflects_nothing_is_black_and_mirrors_have_no_elements():
    scene = many_kinds()
    world = jax.jit(prepare, static_argnums=1)(scene, jaxrt.plan(scene))
    elements = jax.tree.map(jnp.asarray, partition(world, scene, 100)[0])
    first = {name: start for name, _, start, _ in scene.structure.shapes}

    def of(name, up):
        face = jnp.int32(first[name])
        w = jaxrt.Vec3(0.0, 0.0, 1.0 if up else -1.0)
        x = surface_point(world, face, jaxrt.Vec3(0.1, 0.1, 0.0) + w, -w)
        return int(element_of(world, elements, x, w))

    assert of("r", True) > BLACK and of("r", False) == BLACK
    assert of("d", True) > BLACK and of("d", False) > BLACK and of("d", True) != of("d", False)
    assert of("mirror", True) == -1


# ---------------------------------------------------------------------------------------------------- oracles


@pytest.mark.parametrize("rho", [0.5, 0.9, 0.99, 0.999])
def test_the_furnace(rho):
    field = solved(room(rho, walls=1.5), rtol=1e-6)
    rho = float(np.float32(rho))
    want = 1.5 * rho / (1 - rho)
    values = np.asarray(field.values)[np.asarray(field.elements.size) > 0]
    np.testing.assert_allclose(values, want, rtol=1e-4)
    assert field.result == optimistix.RESULTS.successful
    np.testing.assert_allclose(float(field.spectral_radius), rho, rtol=1e-5)


@pytest.mark.parametrize("radius", [0.1, 10.0])
def test_the_furnace_in_a_sphere(radius):
    ball = jaxrt.Sphere(radius=radius, flip_normals=True, emission=1.0, bsdf=jaxrt.Diffuse(0.5))
    field = jaxrt.solve(jaxrt.Scene.build([ball]), resolution=100, directions=16, max_depth=-1)
    values = np.asarray(field.values)[np.asarray(field.elements.size) > 0]
    np.testing.assert_allclose(values, 1.0, rtol=1e-3)


@pytest.mark.parametrize(("rho", "mean"), [(0.5, 1 / 3), (0.9, 5 / 3)])
def test_the_energy_identity(rho, mean):
    """One face of a cube has exitance 1: the mean radiosity of its faces, its own emission among it."""
    field = solved(room(rho, ceiling=1 / np.pi), check=64)
    got = np.pi * mean_over(field)[0] + 1 / 6
    error = field.error
    known = np.pi * mean_over(field)[0]
    off = (mean - got) / known  # the true error of the mean of R, relative
    assert abs(off) < 0.01
    assert abs(float(error.discretisation[0]) - off) < 2.5 * float(error.discretisation_stderr[0]) + 1e-4
    assert 0 < float(error.noise[0]) < 0.2


@functools.cache
def converged(rho):
    """The field of a room with one lamp, solved as far as float32 goes."""
    return solved(room(rho, ceiling=1.0), rtol=1e-6, solver="gmres")


@pytest.mark.parametrize("rho", [0.5, 0.99])
@pytest.mark.parametrize("solver", SOLVERS)
def test_solvers_agree_and_the_certificate_holds(solver, rho):
    exact = np.asarray(converged(rho).values, np.float64)
    field = solved(room(rho, ceiling=1.0), rtol=1e-3, solver=solver)
    assert field.result == optimistix.RESULTS.successful
    off = np.abs(np.asarray(field.values, np.float64) - exact).max() / np.asarray(field.values).max()
    assert bool(field.error.certified)
    assert off <= float(field.error.truncation) + float(converged(rho).error.truncation)
    assert off < 2e-3
    steps = {"plain": 20, "ambient": 12, "anderson": 16, "gmres": 8}[solver]
    assert int(field.iterations) <= (2000 if solver == "plain" and rho == 0.99 else steps)


def test_a_solver_of_optimistix():
    exact = np.asarray(converged(0.5).values)
    field = solved(room(0.5, ceiling=1.0), solver=Anderson(1e-5, 1e-6, depth=3))
    np.testing.assert_allclose(np.asarray(field.values), exact, rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize("solver", ["anderson", "gmres"])
def test_no_solution_is_said(solver):
    """Emission inside a closed surface of albedo 1: light grows for ever."""
    field = solved(room(1.0, ceiling=1.0), solver=solver)
    assert field.result != optimistix.RESULTS.successful
    assert float(field.spectral_radius) > 0.9999 and not bool(field.error.certified)
    assert "no solution exists" in field.why and "max_depth" in field.why


def test_a_picture_without_a_solution_says_so():
    sol = jaxrt.render(room(1.0, ceiling=1.0), 17, method="field", plan=plan(), max_depth=-1)
    assert sol.result != optimistix.RESULTS.successful
    assert sol.stats["unsolved"].startswith("no solution exists: the spectral radius of KG is")
    fine = jaxrt.render(room(0.5, ceiling=1.0), 17, method="field", plan=plan(), max_depth=-1)
    assert fine.result == optimistix.RESULTS.successful and "unsolved" not in fine.stats


def test_a_finite_depth_is_a_partial_sum():
    rho = 0.7
    scene = room(rho, walls=2.0)
    for depth in (2, 3, 5):
        field = solved(scene, max_depth=depth)
        want = 2.0 * sum(rho**k for k in range(1, max(depth - 1, 2)))  # what a path of so many edges can still meet
        if depth > 2:
            np.testing.assert_allclose(mean_over(field), want, rtol=1e-5)


# --------------------------------------------------------------------------------------------------- pictures


def off_by(a, b):
    """The difference of two pictures' means in standard errors, and relative."""
    error = np.sqrt(sum((s.stderr.astype(np.float64) ** 2).sum() for s in (a, b))) / a.image.size
    off = a.image.mean(dtype=np.float64) - b.image.mean(dtype=np.float64)
    return off / error, off / b.image.mean(dtype=np.float64)


@pytest.mark.parametrize(("name", "depth"), [("cornell_box", -1), ("mirror_room", 4)])
def test_pictures_are_those_of_the_path_method(name, depth, request):
    scene = jaxrt.load(request.config.rootpath / "scenes" / f"{name}.xml", res=32)
    by_field = jaxrt.render(scene, 256, 1, method="field", max_depth=depth)
    by_path = jaxrt.render(scene, 512, 2, method="path", max_depth=depth)
    assert by_field.stats["method"] == "field" and by_path.stats["method"] == "path"
    z, off = off_by(by_field, by_path)
    assert abs(off) < 0.01, (z, off)
    values = z_of(by_field.image, np.hypot(by_field.stderr, by_path.stderr) + 0.01 * by_path.image, by_path.image)
    assert np.mean(np.abs(values) < 4.5) > 0.99


def test_light_by_way_of_mirrors_is_not_lost(request):
    """Where paths look at elements themselves, light of lights is left out of them, but not what mirrors send on."""
    scene = jaxrt.load(request.config.rootpath / "scenes" / "mirror_room.xml", res=32)
    by_path = jaxrt.render(scene, 512, 2, method="path", max_depth=-1)
    by_field = [jaxrt.render(scene, 16, seed, method="field", max_depth=-1).image.mean() for seed in range(4)]
    assert abs(np.mean(by_field) / by_path.image.mean() - 1.0) < 0.015


@functools.cache
def cornell_box(scenes):
    """The scene, and a picture of it with little noise."""
    scene = jaxrt.load(scenes / "cornell_box.xml", res=48)
    return scene, jaxrt.render(scene, 4096, 2, method="path")


@pytest.mark.parametrize("spp", [4, 24])
def test_pictures_claim_what_they_are_wrong(spp, request):
    """Paths that look at elements themselves (4), and at what a bounce finds (24)."""
    scene, truth = cornell_box(request.config.rootpath / "scenes")

    def off(method):
        """√relMSE of two pictures over what they claim."""
        found = [jaxrt.render(scene, spp, seed, method=method) for seed in (1, 2)]
        squares = [jaxrt.relative_mse(sol.image, truth.image) - truth.relative_error**2 for sol in found]
        return np.sqrt(np.mean(squares)), np.mean([sol.relative_error for sol in found]), found

    (error, claim, found), (by_path, claimed, _) = off("field"), off("path")
    assert error < 0.6 * by_path
    assert 1 / 3 < error / claim < 1.5 * by_path / claimed  # few samples miss what edges do to a small picture
    for sol in found:
        assert abs(sol.image.mean(dtype=np.float64) / truth.image.mean(dtype=np.float64) - 1.0) < 0.012


def test_the_method_follows_from_scene_and_cost(request):
    def chosen(name, depth=-1, paths=1 << 24):
        scene = jaxrt.load(request.config.rootpath / "scenes" / f"{name}.xml")
        return choose(jax.jit(prepare, static_argnums=1)(scene, jaxrt.plan(scene, free=None)), scene, depth, paths)

    method, why = chosen("cornell_box")
    assert method == "field" and "reflected diffusely once more" in why
    assert chosen("cornell_box", depth=2) == ("path", "no light is reflected twice")
    assert chosen("cornell_box", paths=4096)[0] == "path"
    assert chosen("veach_mis")[0] == "path" and chosen("sphere_light")[0] == "path"


def two_rooms():
    """A room of 2 x 1 x 1 in two by a sheet without thickness, with a lamp on one side; floor and walls are shared."""
    square = lambda o, a, b, id, **more: jaxrt.Rectangle(
        id=id, to_world=np.array([[a[k] / 2, b[k] / 2, np.cross(a, b)[k], o[k] + a[k] / 2 + b[k] / 2] for k in range(3)] + [[0, 0, 0, 1]]),
        bsdf=jaxrt.TwoSided(jaxrt.Diffuse(0.7)), **more,
    )  # fmt: skip
    x, y, z = np.eye(3)
    shapes = [
        square(0 * x, 2 * x, y, "floor"), square(z, 2 * x, y, "ceiling"),
        square(0 * x, 2 * x, z, "front"), square(y, 2 * x, z, "back"),
        square(0 * x, y, z, "left"), square(2 * x, y, z, "right"), square(0.97 * x, y, z, "wall"),
    ]  # fmt: skip
    lamp = np.array([[0.1, 0, 0, 0.5], [0, -0.1, 0, 0.5], [0, 0, -1, 0.99], [0, 0, 0, 1]])
    shapes.append(jaxrt.Rectangle(id="lamp", to_world=lamp, emission=5.0))
    cameras = [camera((x0, 0.1, 0.6), (x1, 0.9, 0.3), 24, 24, 90.0) for x0, x1 in ((0.1, 0.8), (1.9, 1.2))]
    return jaxrt.Scene.build(shapes, sensors=cameras)


def test_no_light_leaks_through_a_thin_wall():
    """Two views of one field: what it costs to solve is said of the first."""
    for spp in (16, 17):  # looking at elements from the camera, and from a bounce away
        lit, dark = jaxrt.render(two_rooms(), spp, sensor=(0, 1), method="field", max_depth=-1)
        assert lit.image.mean() > 0.05
        assert dark.image.mean() < 1e-4 * lit.image.mean()
        assert lit.stats["elements"] == dark.stats["elements"]
        assert dark.stats["seconds_compile"] < 0.2 * lit.stats["seconds_compile"]


def test_unbiased_from_any_field():
    """estimate(field, n) is the series up to n, and the field only takes variance away."""
    scene = room(0.8, ceiling=1.0)
    field = solved(scene, resolution=100, directions=64)
    exact = float(
        np.asarray(jaxrt.radiance(scene, [0.1, 0.2, 0.3], [0.3, 0.2, -1.0], spp=8192, plan=plan(), max_depth=-1))[0]
    )
    psi = jaxrt.psi(jax.jit(prepare, static_argnums=1)(scene, plan()))
    w = jaxrt.Vec3.of(jnp.asarray([0.3, 0.2, -1.0]) / jnp.linalg.norm(jnp.asarray([0.3, 0.2, -1.0])))
    x = psi(jaxrt.Vec3(0.1, 0.2, 0.3), w)
    unbiased = jaxrt.estimate(psi.world, 0, field)

    @jax.jit
    def values(seed):
        one = lambda i: unbiased(x, -w, Stream(i, combine(jnp.uint32(1), seed))).array()[0]
        return jax.vmap(one)(jnp.arange(4096, dtype=jnp.uint32))

    got = np.asarray(values(jnp.uint32(5)))
    error = got.std() / np.sqrt(len(got))
    assert abs(got.mean() - exact) < 4 * error + 1e-3 * exact


def test_measure_with_a_field_and_its_derivative():
    scene = jaxrt.resized(room(0.6, ceiling=1.0, right=0.3), 0, 8, 8)
    elements = jaxrt.elements_of(scene, plan(), 100)

    def mean(rho):
        moved = jaxrt.with_params(scene, {"wall.reflectance": jnp.full(1, rho)})
        field = jaxrt.solve(moved, 0, plan=plan(), elements=elements, directions=16, max_depth=-1, rtol=1e-6)
        return jaxrt.measure(moved, 1, plan=plan(), spp=8, max_depth=-1, radiance=field).mean()

    both = jax.jit(jax.value_and_grad(mean))
    h = 0.01
    np.testing.assert_allclose(both(0.6)[1], (both(0.6 + h)[0] - both(0.6 - h)[0]) / (2 * h), rtol=2e-3)


def test_forward_derivatives_of_a_field():
    scene = room(0.6, ceiling=1.0)
    elements = jaxrt.elements_of(scene, plan(), 100)

    def mean(light):
        moved = jaxrt.with_params(scene, {"ceiling.emitter.radiance": jnp.full(1, light)})
        field = jaxrt.solve(moved, 0, plan=plan(), elements=elements, directions=16, max_depth=-1, rtol=1e-6)
        return (field.values * elements.area[:, None]).sum()

    value, slope = jax.jit(lambda x: jax.jvp(mean, (x,), (1.0,)))(2.0)
    np.testing.assert_allclose(slope, value / 2.0, rtol=1e-4)  # light is linear in its source


def test_derivatives_are_those_of_the_unrolled_iteration():
    """Of a mean over elements, with respect to a factor of all albedos: implicit, forward and reverse."""
    scene = room(0.6, ceiling=1.0)
    elements = jaxrt.elements_of(scene, plan(), 60)
    _, links = links_of(scene, plan(), elements, jnp.uint32(1), 16, -1)

    def scaled(factor):
        return dataclasses.replace(links, albedo=links.albedo * factor, direct=links.direct * factor)

    def implicit(factor):
        return solve_links(scaled(factor), 1e-7, "anderson")[0].mean()

    def unrolled(factor):
        t = scaled(factor)
        return jax.lax.scan(lambda b, _: (t.emitted + t.apply(b), None), t.emitted, None, length=80)[0].mean()

    want = jax.jit(jax.grad(unrolled))(1.0)
    np.testing.assert_allclose(jax.jit(jax.grad(implicit))(1.0), want, rtol=1e-4)
    np.testing.assert_allclose(jax.jit(lambda x: jax.jvp(implicit, (x,), (1.0,))[1])(1.0), want, rtol=1e-4)


def test_in_float64():
    with jax.enable_x64(True):
        chosen = jaxrt.plan(room(0.9, walls=1.5), light_sampling=True)
        field = jaxrt.solve(room(0.9, walls=1.5), plan=chosen, resolution=60, directions=16, rtol=1e-11, max_depth=-1)
        values = np.asarray(field.values)[np.asarray(field.elements.size) > 0]
        rho = np.float64(np.asarray(jaxrt.params(room(0.9))["wall.reflectance"]).ravel()[0])
        assert values.dtype == np.float64
        np.testing.assert_allclose(values, 1.5 * rho / (1 - rho), rtol=1e-9)


def test_a_field_is_saved_as_a_mesh(tmp_path):
    import trimesh

    field = solved(room(0.5, ceiling=1.0), resolution=100)
    field.save(tmp_path / "room.ply")
    mesh = trimesh.load(tmp_path / "room.ply", process=False)
    np.testing.assert_allclose(mesh.area, float(field.elements.area.sum()), rtol=1e-4)
    corners, element, _ = corners_of_pieces(field.world, field.elements)
    assert len(mesh.vertices) == 4 * len(corners) and len(element) == len(corners)
    assert mesh.visual.vertex_colors.shape[1] == 4
    with pytest.raises(jaxrt.SceneError, match="ply"):
        field.save(tmp_path / "room.obj")


def test_mistakes_are_one_line():
    scene = room(0.5, ceiling=1.0)
    with pytest.raises(jaxrt.SceneError, match="plain, ambient, anderson, gmres"):
        jaxrt.solve(scene, solver="newton")
    with pytest.raises(jaxrt.SceneError, match="directions"):
        jaxrt.solve(scene, directions=1)
    field = solved(scene, resolution=100)
    with pytest.raises(jaxrt.SceneError, match="max_depth"):
        jaxrt.measure(scene, 0, plan=plan(), max_depth=4, radiance=field)
    with pytest.raises(ValueError, match="elements_of"):
        jax.jit(lambda s: jaxrt.solve(s, plan=plan()).values)(scene)
