"""Every search and the points it leads to: against float64 brute force, at edges, gaps, scales and misses."""

import functools

import helpers
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import (
    bounces,
    edges_of,
    hemisphere_directions,
    hits,
    icosphere,
    moved,
    occluded,
    rotation,
    sphere_directions,
)

import jaxrt
from jaxrt.casting import cast
from jaxrt.intersect import BACKENDS, dense, refusal
from jaxrt.vector import Vec3
from jaxrt.world import prepare


@pytest.fixture(params=sorted(BACKENDS), autouse=True)
def backend(request):
    """Each test goes through every backend that runs here."""
    if (why := refusal(request.param)) is not None:
        pytest.skip(f"{request.param}: {why}")
    helpers.search["backend"] = request.param
    yield request.param
    helpers.search.clear()


RAYS = 4096
NEAR = 1e-5  # m; at a scene of size 3 float32 rounds to 2e-7, and an inside test adds a few of them


# ------------------------------------------------------------------ float64 reference, every ray on every face
# Each function gives, for rays (N, 3) and one face, lists of crossings (t, margin, outward normal): the margin is
# how far inside the face the crossing lies (m), negative outside.


def _flat(o, d, corner, a, b, margin):
    n = np.cross(a, b)
    n /= np.linalg.norm(n)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = ((corner - o) @ n) / (d @ n)
        p = o + t[:, None] * d - corner
        u, v = np.linalg.lstsq(np.stack([a, b], 1), np.nan_to_num(p.T), rcond=None)[0]
    return [(t, margin(u, v), np.broadcast_to(n, o.shape))]


def ref_triangle(o, d, p0, p1, p2):
    a, b = p1 - p0, p2 - p0
    twice = np.linalg.norm(np.cross(a, b))
    heights = [twice / np.linalg.norm(e) for e in (b, a, p2 - p1)]
    return _flat(
        o, d, p0, a, b, lambda u, v: np.minimum.reduce([u * heights[0], v * heights[1], (1 - u - v) * heights[2]])
    )


def ref_parallelogram(o, d, p0, a, b, side):
    area = np.linalg.norm(np.cross(a, b))
    hu, hv = area / np.linalg.norm(b), area / np.linalg.norm(a)
    inside = lambda u, v: np.minimum.reduce([u * hu, (1 - u) * hu, v * hv, (1 - v) * hv])
    return [(t, margin, side * n) for t, margin, n in _flat(o, d, p0, a, b, inside)]


def ref_disk(o, d, center, a, b):
    return _flat(o, d, center, a, b, lambda u, v: (1 - np.hypot(u, v)) * min(np.linalg.norm(a), np.linalg.norm(b)))


def ref_sphere(o, d, center, radius):
    s = o - center
    b = (s * d).sum(1)
    impact = np.linalg.norm(s - b[:, None] * d, axis=1)
    half = np.sqrt(np.maximum(radius**2 - impact**2, 0))
    return [(t, radius - impact, (s + t[:, None] * d) / radius) for t in (-b - half, -b + half)]


def ref_cylinder(o, d, p0, p1, radius):
    length = np.linalg.norm(p1 - p0)
    axis = (p1 - p0) / length
    s = o - p0
    across = lambda w: w - (w @ axis)[:, None] * axis
    so, do = across(s), across(d)
    a, b = (do**2).sum(1), (so * do).sum(1)
    half = np.sqrt(np.maximum(b * b - a * ((so**2).sum(1) - radius**2), 0))
    impact = np.linalg.norm(so - (b / a)[:, None] * do, axis=1)
    out = []
    for t in ((-b - half) / a, (-b + half) / a):
        h = (s + t[:, None] * d) @ axis
        out.append((t, np.minimum.reduce([radius - impact, h, length - h]), (so + t[:, None] * do) / radius))
    return out


def reference(faces, o, d):
    """Crossings of all faces: t and margin, (F, 2, N), and normals (F, 2, N, 3)."""
    t = np.full((len(faces), 2, len(o)), np.nan)
    margin, normal = np.full_like(t, -np.inf), np.zeros((*t.shape, 3))
    for k, (f, *args) in enumerate(faces):
        for j, (tt, m, n) in enumerate(f(o, d, *args)):
            t[k, j], margin[k, j], normal[k, j] = tt, np.where(np.isfinite(tt), m, -np.inf), n
    return t, margin, normal


REFERENCES = (ref_triangle, ref_parallelogram, ref_disk, ref_sphere, ref_cylinder)


def f32(a):
    return np.asarray(a, np.float32).astype(np.float64)


@functools.cache
def crowd():
    """A scene of many faces of every kind, the same faces for the reference, and their numbers in the scene."""
    rng = np.random.default_rng(11)
    v = f32(rng.uniform(-1, 1, (40, 1, 3)) + rng.normal(0, 0.3, (40, 3, 3)))
    shapes: list = [jaxrt.Mesh(vertices=v.reshape(-1, 3), faces=np.arange(120).reshape(40, 3))]
    faces: list = [(ref_triangle, *p) for p in v]
    places = f32(rng.uniform(-1, 1, (40, 3)))
    for at in places[:10]:
        m = np.eye(4)
        m[:3, :3], m[:3, 3] = f32(rng.normal(0, 0.25, (3, 3))), at
        shapes.append(jaxrt.Rectangle(to_world=m))
        # It faces the image of +z: where the matrix mirrors, that is against e₁ x e₂.
        side = np.sign(np.linalg.det(m))
        faces.append((ref_parallelogram, at - m[:3, 0] - m[:3, 1], 2 * m[:3, 0], 2 * m[:3, 1], side))
    for at in places[10:20]:
        m = f32(moved(rng.uniform(0.2, 0.5), at, rotation(rng.integers(1 << 30))))
        shapes.append(jaxrt.Disk(to_world=m))
        faces.append((ref_disk, at, m[:3, 0], m[:3, 1]))
    for at in places[20:30]:
        r = float(np.float32(rng.uniform(0.1, 0.4)))
        shapes.append(jaxrt.Sphere(center=at, radius=r))
        faces.append((ref_sphere, at, r))
    for at in places[30:]:
        r, end = float(np.float32(rng.uniform(0.1, 0.3))), f32(at + rng.normal(0, 0.5, 3))
        shapes.append(jaxrt.Cylinder(p0=at, p1=end, radius=r))
        faces.append((ref_cylinder, at, end, r))
    scene = jaxrt.Scene.build(shapes)
    numbers = np.concatenate([np.arange(a, b) for _, _, a, b in scene.structure.shapes])
    o = f32(np.random.default_rng(5).uniform(-1.5, 1.5, (RAYS, 3)))
    d = f32(sphere_directions(RAYS, 6))
    d[:12] = np.vstack([np.eye(3), -np.eye(3)] * 2)  # along the axes: zeros in d
    return scene, faces, numbers, o, d


@functools.cache
def crossings():
    _, faces, _, o, d = crowd()
    return reference(faces, o, d)


def crowd_hits(first=-2, second=-2):
    """ψ with two faces excluded (−2: none), by one program."""
    scene, _, _, o, d = crowd()
    none = np.full(RAYS, -2, np.int32)
    return hits(
        scene, o, d, (np.broadcast_to(np.int32(first), none.shape), np.broadcast_to(np.int32(second), none.shape))
    )


def finite(t):
    return np.where(np.isfinite(t), t, 0.0)


def of_faces(x, numbers):
    """For each ray the row of its face in the reference (0 where it missed) and whether it hit."""
    hit = x.face >= 0
    row = np.where(hit, np.searchsorted(numbers, x.face), 0)
    assert (numbers[row[hit]] == x.face[hit]).all()  # no padding was hit
    return row, hit


def test_hits_agree_with_brute_force():
    """The face is one that may be hit, and none that is surely hit lies nearer; the rest follows from the face."""
    _, faces, numbers, o, d = crowd()
    x = crowd_hits()
    t, margin, normal = crossings()
    row, hit = of_faces(x, numbers)
    counts = [np.isin(row[hit], [k for k, f in enumerate(faces) if f[0] is kind]).sum() for kind in REFERENCES]
    assert min(counts) > 50 and 0.3 < hit.mean() < 0.95
    nearest = np.where((margin > 1e-4) & (t > NEAR), t, np.inf).min((0, 1))
    assert np.isinf(nearest[~hit]).all()
    # Of the face's two crossings, the nearer that may count.
    lane = np.arange(RAYS)
    may = np.where((margin > -NEAR) & (t > -NEAR), t, np.inf)[row, :, lane]
    j, want = may.argmin(1), may.min(1)
    assert np.isfinite(want[hit]).all()
    assert (want[hit] <= nearest[hit] + 1e-3).all()
    # Well inside a face and not at grazing incidence everything is accurate: float32 rounds to 2e-7, over a cosine.
    m, n = margin[row, j, lane], normal[row, j, lane]
    good = hit & (m > 1e-3) & (np.abs((n * d).sum(1)) > 0.05)
    assert good.sum() > 0.8 * hit.sum()
    assert (want[good] <= nearest[good] + NEAR).all()
    np.testing.assert_allclose(x.distance[good], want[good], atol=2e-5)
    np.testing.assert_allclose(np.asarray(x.position)[good], (o + finite(want)[:, None] * d)[good], atol=2e-5)
    np.testing.assert_allclose(np.asarray(x.normal)[good], n[good], atol=1e-4)  # error of position over the radius
    # uv on flat faces: position = corner + u e₁ + v e₂. The thinnest face is a hundredth of its length high.
    for k in np.unique(row[hit]):
        if faces[k][0] not in (ref_triangle, ref_parallelogram):
            continue
        f, p0, a, b = faces[k][:4]
        a, b = (a - p0, b - p0) if f is ref_triangle else (a, b)
        on = hit & (row == k)
        there = p0 + x.uv[0][on, None] * a + x.uv[1][on, None] * b
        np.testing.assert_allclose(np.asarray(x.position)[on], there, atol=2e-5)


def test_excluded_faces_are_passed_through():
    _, _, numbers, _, _ = crowd()
    first = crowd_hits()
    second = crowd_hits(first.face)
    third = crowd_hits(second.face, first.face)  # in any order
    t, margin, _ = crossings()
    np.testing.assert_array_equal(second.face[first.face < 0], -1)
    for before, after in (((first,), second), ((first, second), third)):
        row, hit = of_faces(after, numbers)
        assert hit.mean() > 0.1
        gone = np.zeros(margin.shape[::2], bool)
        for x in before:
            assert (after.face != x.face)[hit].all()
            assert (after.distance >= x.distance - NEAR)[x.face >= 0].all()
            gone |= numbers[:, None] == x.face
        # Without them the reference sees the same next face.
        left = np.where((margin > 1e-4) & (t > NEAR) & ~gone[:, None], t, np.inf).min((0, 1))
        assert np.isinf(left[~hit]).all()
        assert (after.distance <= left + 1e-3).all()


def test_occlusion_agrees_with_the_closest_hit():
    scene, _, _, o, d = crowd()
    none = np.full(RAYS, -2, np.int32)
    first = crowd_hits()
    second = crowd_hits(first.face)
    far = np.random.default_rng(9).uniform(0, 2, RAYS)
    for x, skip in ((first, none), (second, first.face)):
        got = occluded(scene, o, d, far, skip)
        clear = np.abs(far - x.distance) > 1e-4
        np.testing.assert_array_equal(got[clear], (x.distance < far)[clear])
        assert 0.02 < got.mean() < 0.9
        np.testing.assert_array_equal(occluded(scene, o, d, 1e9, skip), x.face >= 0)


@pytest.mark.parametrize("kind", ["sphere", "cylinder"])
@pytest.mark.parametrize("radius", [1e-2, 1e-3])
def test_thin_curved_faces_far_away(kind, radius):
    """Rays from 10 m at and just past a wire and a bead: hits and distances as in float64."""
    n, rng = RAYS, np.random.default_rng(0)
    made = {
        "sphere": lambda: jaxrt.Sphere(radius=radius),
        "cylinder": lambda: jaxrt.Cylinder(p0=(0, 0, -1), p1=(0, 0, 1), radius=radius),
    }[kind]()
    around, aside, height = rng.uniform(0, 2 * np.pi, n), rng.uniform(-1.2, 1.2, n), rng.uniform(-0.3, 0.3, (2, n))
    height *= kind == "cylinder"
    o = f32(np.stack([10 * np.cos(around), 10 * np.sin(around), height[0]], -1))
    target = np.stack([-np.sin(around) * aside * radius, np.cos(around) * aside * radius, height[1]], -1)
    d = f32((target - o) / np.linalg.norm(target - o, axis=1, keepdims=True))
    r = float(np.float32(radius))
    ends = (np.array([0, 0, -1.0]), np.array([0, 0, 1.0]), r)
    (t, margin, _), _ = ref_sphere(o, d, np.zeros(3), r) if kind == "sphere" else ref_cylinder(o, d, *ends)
    x = hits(jaxrt.Scene.build([made]), o, d)
    # A float32 direction is off by 3e-8 over 10 m: of a radius of 1e-3 m a few in 10⁴; and a distance by its rounding.
    np.testing.assert_array_equal((x.face >= 0)[np.abs(margin) > 3e-3 * r], (margin > 0)[np.abs(margin) > 3e-3 * r])
    inside = (margin > 0.1 * r) & (x.face >= 0)
    np.testing.assert_allclose(x.distance[inside], t[inside], atol=1e-2 * r + 4e-6)


# ------------------------------------------------------------------------------------------ watertight


def aimed_rays(vertices, faces, n, seed):
    """Rays from inside at points of shared edges, one in five at a vertex, exactly as float32 rounds them."""
    rng = np.random.default_rng(seed)
    e = vertices[edges_of(faces)][rng.integers(len(edges_of(faces)), size=n)]
    share = rng.random((n, 1)) * (rng.random((n, 1)) > 0.2)
    target = f32(e[:, 0] + share * (e[:, 1] - e[:, 0]))
    centre, size = vertices.mean(0), np.abs(vertices - vertices.mean(0)).max()
    o = f32(centre + rng.uniform(-0.4, 0.4, (n, 3)) * size)
    d = target - o
    return o, d / np.linalg.norm(d, axis=1, keepdims=True)


def escapes(scene, vertices, faces, n, seed=0):
    lost = 0
    for k in range(0, n, 1 << 16):
        size = min(n - k, 1 << 16)
        lost += int((hits(scene, *aimed_rays(vertices, faces, 1 << 16, seed + k)).face[:size] < 0).sum())
    return lost


def sphere_mesh(level, scale=1.0, shift=0.0):
    v, f = icosphere(level)
    v = f32(v * scale + shift)
    return jaxrt.Scene.build([jaxrt.Mesh(vertices=v, faces=f)]), v, f


@pytest.mark.parametrize("scale, shift", [(1.0, 0.0), (1e-3, 0.0), (1e3, 0.0), (1.0, 1e4), (1e3, 1e4)])
def test_no_ray_escapes_through_shared_edges(scale, shift):
    assert escapes(*sphere_mesh(2, scale, shift), 1 << 17) == 0


@pytest.mark.slow
def test_no_ray_of_a_million_escapes_a_fine_mesh():
    assert escapes(*sphere_mesh(3), 1_000_000, seed=99) == 0


QUADS = [(0, 2, 6, 4), (0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (1, 5, 7, 3)]
SIDES = np.array([t for a, b, c, d in QUADS for t in ((a, b, c), (a, c, d))])


def box_of_parts(m):
    """A cube of five rectangles, each with a matrix of its own, and a lid of two triangles; its corners."""
    cube = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    corner = cube @ m[:3, :3].T + m[:3, 3]
    parts: list = []
    for a, b, c, d in QUADS[:5]:
        side = np.eye(4)
        side[:3, 0], side[:3, 1] = (corner[b] - corner[a]) / 2, (corner[d] - corner[a]) / 2
        side[:3, 2], side[:3, 3] = np.cross(side[:3, 0], side[:3, 1]), (corner[a] + corner[c]) / 2
        parts.append(jaxrt.Rectangle(to_world=side))
    a, b, c, d = QUADS[5]
    return [*parts, jaxrt.Mesh(vertices=corner, faces=np.array([[a, b, c], [a, c, d]]))], corner


def test_no_ray_escapes_a_cube_or_a_box_of_parts():
    m = moved(0.7, (0.1, -0.2, 0.3), rotation(4))
    parts, corner = box_of_parts(m)
    assert escapes(jaxrt.Scene.build(parts), corner, SIDES, 1 << 17) == 0
    # The same program: a cube, and as many parts as before out of the way.
    away = [jaxrt.Mesh(vertices=corner + 9, faces=[[0, 1, 2], [0, 2, 3]])]
    assert escapes(jaxrt.Scene.build([jaxrt.Cube(to_world=m), *away]), corner, SIDES, 1 << 17, seed=3) == 0


@pytest.mark.parametrize("shift", [(3, -2, 5), (1e4, 1e4, 1e4)])
def test_no_ray_escapes_a_box_of_parts_away_from_the_origin(shift):
    """Matrices are rounded in proportion to the coordinates, so neighbours part by that much."""
    parts, corner = box_of_parts(moved(0.7, shift, rotation(4)))
    assert escapes(jaxrt.Scene.build(parts), corner, SIDES, 1 << 17) == 0


# ------------------------------------------------------------------------------------------------ gaps


def test_a_gap_of_4e_5_is_still_a_gap():
    gap = 4e-5
    plates = [jaxrt.Rectangle(to_world=moved(0.5, (0, 0, z))) for z in (0.0, gap)]
    scene = jaxrt.Scene.build(plates)
    n = 1000
    at = np.random.default_rng(0).uniform(-0.4, 0.4, (n, 3))
    at[:, 2] = gap / 2
    up, down = np.broadcast_to([0, 0, 1.0], (n, 3)), np.broadcast_to([0, 0, -1.0], (n, 3))
    x = hits(scene, at, up)
    np.testing.assert_array_equal(x.face, 1)
    np.testing.assert_allclose(x.distance, gap / 2, atol=1e-6)
    np.testing.assert_array_equal(hits(scene, at, down).face, 0)
    # What leaves the lower plate sees the upper one, and the other way round, at any angle.
    local = hemisphere_directions(n)
    local[:, 2] = np.maximum(local[:, 2], 1e-3)
    first, _, second = bounces(scene, at, down, local)
    assert (first.face == 0).all()
    inside = np.abs(np.asarray(second.position)[:, :2]).max(1) < 0.5
    np.testing.assert_array_equal(second.face[inside], 1)
    assert inside.mean() > 0.9
    distance = second.distance[inside] * local[inside, 2] / np.linalg.norm(local[inside], axis=1)
    np.testing.assert_allclose(distance, gap, atol=3e-6)  # a ray starts 1e-6 above its plate


def test_a_slit_of_4e_5_lets_rays_through():
    slit = 4e-5
    m = [moved(0.5, (s * (0.5 + slit / 2), 0, 0)) for s in (-1, 1)]
    scene = jaxrt.Scene.build([jaxrt.Rectangle(to_world=a) for a in m])
    n = 1000
    o = np.zeros((n, 3))
    o[:, 0] = np.linspace(-1.5e-5, 1.5e-5, n)
    o[:, 1], o[:, 2] = np.linspace(-0.4, 0.4, n), 0.3
    np.testing.assert_array_equal(hits(scene, o, np.broadcast_to([0, 0, -1.0], (n, 3))).face, -1)
    o[:, 0] = np.where(np.arange(n) % 2, 1, -1) * 2.5e-5
    assert (hits(scene, o, np.broadcast_to([0, 0, -1.0], (n, 3))).face >= 0).all()


# ------------------------------------------------------------------------------------------- self-hits

PLACES = [(1.0, 0.0), (1e-3, 0.0), (1e3, 0.0), (1.0, 1e4), (1e3, 1e4)]
N_SELF = 1 << 14


def flat_mesh(n=12):
    """A square of 2 x 2 m in 2 n² triangles: in the same bucket as the closed mesh of 320."""
    g = np.linspace(-1, 1, n + 1)
    v = np.stack([*np.meshgrid(g, g, indexing="ij"), np.zeros((n + 1, n + 1))], -1).reshape(-1, 3)
    i, j = (a.ravel() for a in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
    a, b, c, d = ((n + 1) * (i + p) + j + q for p, q in ((0, 0), (1, 0), (1, 1), (0, 1)))
    return v, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def grazing(n, seed, least=1e-3):
    """Local directions: cosine-distributed, every fourth at grazing incidence down to a cosine of `least`."""
    local = hemisphere_directions(n, seed)
    z = np.where(
        np.arange(n) % 4 == 0, 10.0 ** np.random.default_rng(seed).uniform(np.log10(least), -1, n), local[:, 2]
    )
    r = np.sqrt((1 - z * z) / np.maximum((local[:, :2] ** 2).sum(1), 1e-12))
    return np.stack([local[:, 0] * r, local[:, 1] * r, z], -1)


@pytest.mark.parametrize("scale, shift", PLACES)
def test_a_flat_mesh_never_hits_itself(scale, shift):
    v, f = flat_mesh()
    turn = rotation(8)
    v = f32(v @ turn.T * scale + shift)
    scene = jaxrt.Scene.build([jaxrt.Mesh(vertices=v, faces=f)])
    rng = np.random.default_rng(3)
    at = (rng.uniform(-0.99, 0.99, (N_SELF, 3)) * [1, 1, 0]) @ turn.T * scale + shift
    d = turn @ np.array([0.2, -0.3, -1.0]) / np.sqrt(1.13)
    # Vertices rounded to 1e-3 m, as at 1e4 m, tilt faces of 0.17 m by up to 0.012: what leaves below may land again.
    local = grazing(N_SELF, 1, max(1e-3, 2e-6 * shift / scale))
    x, _, y = bounces(scene, at - d * scale, np.broadcast_to(d, at.shape), local)
    assert (x.face >= 0).mean() > 0.999
    np.testing.assert_array_equal(y.face[x.face >= 0], -1)


@pytest.mark.parametrize("scale, shift", PLACES)
@pytest.mark.parametrize("side", ["outside", "inside"])
def test_a_closed_mesh_never_hits_itself(side, scale, shift):
    """Leaving a convex mesh outwards meets nothing; leaving it inwards meets another face, at a distance."""
    scene, v, f = sphere_mesh(2, scale, shift)
    d = sphere_directions(N_SELF, 2)
    o = shift + (d * -3.0 * scale if side == "outside" else np.zeros_like(d))
    local = grazing(N_SELF, 4) * [1, 1, 1.0 if side == "outside" else -1.0]
    x, w, y = bounces(scene, o, d, local)
    assert (x.face >= 0).all()
    if side == "outside":
        np.testing.assert_array_equal(y.face, -1)
        return
    # Inwards from a rounded vertex a grazing ray may leave by the very edge; steeper ones have a way to go.
    assert (y.face >= 0).all()
    assert (y.face != x.face).all()
    height = -local[:, 2]
    away = np.abs(np.einsum("ni,ni->n", np.asarray(y.position, np.float64) - np.asarray(x.position), np.asarray(w)))
    np.testing.assert_allclose(away[height > 0.1], y.distance[height > 0.1], rtol=0.05, atol=0.05 * scale)


@pytest.mark.parametrize("scale, shift", PLACES)
@pytest.mark.parametrize("shape", ["sphere", "cylinder"])
def test_curved_faces_never_hit_themselves(shape, scale, shift):
    center = np.full(3, shift)
    if shape == "sphere":
        made = jaxrt.Sphere(center=center, radius=scale)
    else:
        made = jaxrt.Cylinder(p0=center - [0, 0, scale], p1=center + [0, 0, scale], radius=scale)
    scene = jaxrt.Scene.build([made])
    d = sphere_directions(N_SELF, 6)
    d[:, 2] = np.clip(d[:, 2], -0.3, 0.3) * np.hypot(d[:, 0], d[:, 1])  # within the height of the cylinder
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    x, _, y = bounces(scene, center - 3 * scale * d, d, grazing(N_SELF, 7))
    assert (x.face == 0).all()
    np.testing.assert_array_equal(y.face, -1)
    # Inside, a ray goes right across: a chord of 2 r cosθ at least (a cylinder's may be longer, or leave by an end).
    x, _, y = bounces(scene, np.broadcast_to(center, d.shape), d, grazing(N_SELF, 8) * [1, 1, -1])
    assert (x.face == 0).all()
    chord = 2 * scale * grazing(N_SELF, 8)[:, 2]
    if shape == "sphere":
        assert (y.face == 0).all()
    steep = (y.face == 0) & (chord > 0.1 * scale)
    # A start 9.5e-6 of the offset off the surface, at the offset's own rounding.
    assert (y.distance[steep] > 0.99 * chord[steep] - 1e-5 * abs(shift) / 0.05).all() and steep.mean() > 0.3


# --------------------------------------------------------------------------------------- harmless faces


N_HARMLESS = 1 << 14


def in_a_ball(extra_vertices, extra_faces):
    """Hits in an icosphere with more faces, of at most 48 more vertices and 16 more faces: one bucket."""
    v, f = icosphere(1)
    unused = np.full((48 - len(extra_vertices), 3), np.nan)  # vertices that no face names may be anything
    v = np.concatenate([f32(v), extra_vertices, unused])
    scene = jaxrt.Scene.build([jaxrt.Mesh(vertices=v, faces=np.concatenate([f, extra_faces]))])
    o = np.random.default_rng(5).uniform(-0.5, 0.5, (N_HARMLESS, 3))
    return hits(scene, o, sphere_directions(N_HARMLESS, 6)), f


def test_faces_without_area_and_copies_change_nothing():
    none = np.zeros((0, 3))
    plain, f = in_a_ball(none, none.astype(int))
    odd = np.array([[3, 3, 3], [5, 5, 7], [0, 1, 1]])
    got, _ = in_a_ball(none, np.concatenate([odd, f[:7], f[7:9, ::-1]]))  # copies, two of them inside out
    assert (plain.face >= 0).all()
    source = np.concatenate([np.arange(len(f)), -np.ones(3, int), np.arange(9)])
    same = source[got.face] == plain.face
    assert same.mean() > 0.9995  # an inside-out copy is rounded otherwise along its edges
    np.testing.assert_allclose(got.distance, plain.distance, rtol=1e-6)
    np.testing.assert_allclose(np.asarray(got.position), np.asarray(plain.position), atol=1e-6)
    turned = same & (got.face >= len(f) + 3 + 7)
    np.testing.assert_allclose(np.asarray(got.normal)[turned], -np.asarray(plain.normal)[turned], atol=1e-6)


def test_slivers_are_harmless():
    """Needles of width 1e-6 and less, collinear points rounded apart: finite, and hit by next to nothing."""
    rng = np.random.default_rng(4)
    a, b = rng.uniform(-0.5, 0.5, (2, 16, 3))
    width = 10.0 ** rng.uniform(-9, -6, (16, 1))
    third = a + (b - a) * rng.random((16, 1)) + width * rng.normal(size=(16, 3))
    x, f = in_a_ball(np.stack([a, b, third], 1).reshape(-1, 3), 42 + np.arange(48).reshape(16, 3))
    assert (x.face >= 0).all()  # the ball is still closed
    assert np.isfinite(np.asarray(x.position)).all() and np.isfinite(np.asarray(x.normal)).all()
    # 16 needles of length 1 and width 2e-6 cover 3e-5 m² of what a ray can meet.
    assert (x.face >= len(f)).mean() < 1e-3


# ----------------------------------------------------------------------------------------------- misses


@pytest.mark.parametrize("scale, shift", PLACES)
def test_a_miss_lands_on_the_enclosure(scale, shift):
    scene = jaxrt.Scene.build(
        [jaxrt.Sphere(center=np.full(3, shift), radius=scale)], enclosure=jaxrt.Enclosure([0.25, 0.5, 2.0])
    )
    d = sphere_directions(512, 1)
    o = shift + 2 * scale * d
    x = hits(scene, o, d)
    np.testing.assert_array_equal(x.face, -1)
    assert np.isposinf(x.distance).all()
    np.testing.assert_array_equal(np.asarray(x.normal), -d.astype(np.float32))
    p = np.asarray(x.position, np.float64) - shift
    assert np.isfinite(p).all()
    assert (np.linalg.norm(p, axis=1) > 2 * scale).all()  # beyond everything
    np.testing.assert_array_equal(np.stack(x.uv), 0.0)


def test_the_enclosure_emits_and_reflects_nothing(backend):
    scene = jaxrt.Scene.build([jaxrt.Sphere()], enclosure=jaxrt.Enclosure([0.25, 0.5, 2.0]))
    plan = jaxrt.plan(scene, backend=backend)

    @functools.partial(jax.jit, static_argnames="plan")
    def both(scene, o, d, plan):
        world = prepare(scene, plan)
        x = cast(world, Vec3.of(o), Vec3.of(d))
        rule = jaxrt.BrdfRule(world)(x, -Vec3.of(d), jaxrt.Stream(jnp.uint32(3), jnp.uint32(4)))
        return jaxrt.emission(world)(x, -Vec3.of(d)).array(), rule.weight.array()

    light, weight = both(scene, np.array([2.0, 0, 0], np.float32), np.array([1.0, 0, 0], np.float32), plan)
    np.testing.assert_array_equal(light, [0.25, 0.5, 2.0])
    np.testing.assert_array_equal(weight, [[0, 0, 0]])


# ------------------------------------------------------------------------------------------ derivatives


@functools.partial(jax.jit, static_argnames="plan")
def _landings(values, o, d, scene, plan):
    """Distance (0 on a miss), position, normals and uv of hits, (N, 12), as a function of parameters and rays."""
    world = prepare(jaxrt.with_params(scene, values), plan)

    def one(o, d):
        x = cast(world, Vec3.of(o), Vec3.of(d))
        distance = jnp.where(x.face < 0, 0.0, jnp.where(x.face < 0, 0.0, x.distance))
        parts = [distance, *x.position, *x.normal, *x.shading, *x.uv]
        return jnp.stack([jnp.broadcast_to(p, distance.shape) for p in parts])

    return jax.vmap(one)(o, d)


@functools.partial(jax.jit, static_argnames="plan")
def _slopes(values, o, d, direction, cotangent, scene, plan):
    """Of `_landings`: derivatives along random directions (K of them), and cotangents of all arguments."""
    f = lambda *a: _landings(*a, scene, plan)
    _, pull = jax.vjp(f, values, o, d)
    forward = jax.vmap(lambda t: jax.jvp(f, (values, o, d), t)[1])(direction)
    return forward, pull(cotangent)


def test_derivatives_of_hits_and_misses(backend, monkeypatch):
    """Forward and reverse mode against central differences in float64, for every parameter of every kind of face and
    for the rays; rays that miss, graze an edge or lie in a plane put no NaN into cotangents (oracles, hard case 10)."""
    if backend != "dense":
        pytest.skip(
            "a search only tells the face, so one backend will do; embree has no float64 to take differences in"
        )
    monkeypatch.setattr(dense, "UNROLL", 1)  # compiles sooner
    m = moved(0.8, (0.1, -0.2, 0.3), rotation(5))
    at = lambda x: moved(1.0, (x, 0, 0)) @ m
    normals = np.array([[0.1, 0, 1], [0, 0.2, 1], [-0.1, 0.1, 1.0]])
    shapes = [
        jaxrt.Mesh(
            id="t", vertices=[[-1, -1, 0], [1, -1, 0.2], [0, 1, 0.1]], faces=[[0, 1, 2]], normals=normals, to_world=m
        ),
        jaxrt.Rectangle(id="r", to_world=at(3)),
        jaxrt.Disk(id="d", to_world=at(6)),
        jaxrt.Sphere(id="s", center=(0.1, 0.2, 0.3), radius=0.9, to_world=at(9)),
        jaxrt.Cylinder(id="c", p0=(0, 0, -1), p1=(0.1, 0, 1.2), radius=0.9, to_world=at(12)),
        jaxrt.Rectangle(id="flat", to_world=moved(1.0, (0, 0, 9))),
        jaxrt.Sphere(id="ball", center=(3, 0, 9)),
        jaxrt.Cylinder(id="tube", p0=(6, 0, 8), p1=(6, 0, 10)),
    ]
    with jax.enable_x64(True):
        scene = jaxrt.Scene.build(shapes)
        plan = jaxrt.plan(scene, backend=backend)
        rng = np.random.default_rng(0)
        d = np.tile([0.05, 0.95, -0.3], (10, 1)) + rng.normal(0, 0.05, (10, 3))
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        o = np.array([m[:3, 3] + (3 * (k % 5) + 0.05, 0.02, 0.03) for k in range(10)]) - 2.5 * d
        odd_o = [[-5, 0, 9], [0, 0, 12], [1, 0, 12], [3, 5, 9], [4, 0, 5], [7, 0, 5], [6, 0, 12], [0, -9, 3]]
        odd_d = [[1, 0, 0], [0, 0, 1], [0, 0, -1], [0, 1, 0], [0, 0, 1], [0, 0, 1], [0, 0, -1], [0, 0, -1]]
        o, d = jnp.asarray(np.concatenate([o, odd_o])), jnp.asarray(np.concatenate([d, np.array(odd_d, float)]))
        values = {k: v for k, v in jaxrt.params(scene).items() if k.split(".")[0] in "trdsc" and "bsdf" not in k}
        assert {"t.vertices", "t.normals", "s.radius", "c.p0", "c.radius", "d.to_world"} <= set(values)
        base = np.asarray(_landings(values, o, d, scene, plan))
        assert base.dtype == np.float64 and (base[:10, 0] > 1).all() and np.isfinite(base).all()
        arguments = (values, o, d)
        leaves, tree = jax.tree.flatten(arguments)
        # Along random directions in one argument at a time, so that every parameter is seen for itself.
        direction = [np.zeros((len(leaves), *x.shape)) for x in leaves]
        for k, x in enumerate(leaves):
            direction[k][k] = rng.normal(size=x.shape)
            if x.shape == (4, 4):
                direction[k][k][3] = 0  # affine
            if k >= len(leaves) - 2:
                direction[k][k][10:] = 0  # the odd rays stay where they are: there the function has kinks
        cotangent = rng.normal(size=base.shape)
        forward, reverse = _slopes(*arguments, tree.unflatten(direction), jnp.asarray(cotangent), scene, plan)
        forward = np.asarray(forward)
        assert np.isfinite(forward).all()
        assert all(np.isfinite(x).all() for x in jax.tree.leaves(reverse))
        h = 1e-5
        for k in range(len(leaves)):
            step = [h * a[k] for a in direction]
            plus, minus = (
                _landings(*tree.unflatten([x + s * dx for x, dx in zip(leaves, step, strict=True)]), scene, plan)
                for s in (1, -1)
            )
            difference = (np.asarray(plus) - np.asarray(minus)) / (2 * h)
            assert np.abs(difference[:10]).max() > 0.01
            # Third derivatives here are of order 100, times h²/6; rounding 1e-15/h.
            np.testing.assert_allclose(forward[k][:10], difference[:10], atol=1e-7)
            pulled = sum(np.vdot(a[k], b) for a, b in zip(direction, jax.tree.leaves(reverse), strict=True))
            assert pulled == pytest.approx(np.vdot(forward[k], cotangent), abs=1e-9)
