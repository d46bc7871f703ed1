"""A block that stands elsewhere is put back by what its outline and its shadow say."""

import numpy as np
import optimistix
import pytest
from helpers import box_room, camera, moved

import jaxrt


@pytest.mark.slow
def test_a_block_is_put_back():
    """All six numbers of its motion, from one picture."""
    sensors = [camera((0.6, -0.7, 0.7), (-0.4, 0.4, -0.8), 16, 16, 70.0)]
    block = jaxrt.Rectangle(id="block", to_world=moved(0.35, (-0.1, 0.1, -0.4)), bsdf=jaxrt.Diffuse(0.1, id="dark"))
    parts = {"emission": {"ceiling": 1.0}, "sensors": sensors, "integrator": jaxrt.Integrator(2)}
    room = box_room(0.6, others=[block], **parts)
    target = jaxrt.render(room, spp=1024, seed=1, method="path").image
    away = np.array(jaxrt.params(room)["block.to_world"])
    away[:3, 3] += (0.12, -0.1, 0.08)
    fit = jaxrt.fit(
        jaxrt.with_params(room, {"block.to_world": away}), target, "block.to_world",
        optimiser=optimistix.GaussNewton(1e-3, 1e-3), steps=12, spp=64,
    )  # fmt: skip
    found = np.asarray(fit.parameters["block.to_world"])
    np.testing.assert_allclose(found[:3, 3], (-0.1, 0.1, -0.4), atol=0.02)  # it was .18 away
    off = np.abs(found - np.asarray(jaxrt.params(room)["block.to_world"]))[:3]
    said = np.asarray(fit.stderr["block.to_world"])[:3]
    assert (off < 4.5 * said + 1e-3).all()  # tilts of a dark square are hardly seen, and it says so
    assert (said[:, 3] > 1e-4).all() and (said < 0.03).all()
