"""Functions that XLA is asked to compile as one, in the forms in which it would abort; and programs from another process."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxrt import compiler
from jaxrt.compiler import one_function
from jaxrt.solver import links, path, probe
from jaxrt.world import prepare


def body(a, b, unused, empty):
    x = jax.lax.fori_loop(0, 3, lambda i, x: jnp.sin(x) + b, a)
    return x, jnp.where(x > 0, a, b) + empty.sum(), (jnp.arange(len(a)) % 2).astype(bool)


@pytest.mark.parametrize("lanes", [8, 1 << 17])
def test_unused_empty_and_constant_arguments(lanes):
    args = jnp.linspace(-1, 1, lanes), jnp.float32(0.3), jnp.arange(7), jnp.zeros((0, 3))
    want = body(*args)
    for got in (jax.jit(one_function(body))(*args), jax.jit(lambda: one_function(body)(*args))()):
        jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-6), got, want)


def test_one_result_of_many_numbers():
    """XLA would split a single result over threads, which such a function cannot be."""
    n = 1 << 20
    each = lambda x: jax.lax.fori_loop(0, n, lambda i, y: y.at[i].set(2 * x[i]), jnp.zeros(n))
    np.testing.assert_allclose(jax.jit(one_function(each))(jnp.linspace(0, 1, n)), 2 * np.linspace(0, 1, n), rtol=1e-6)


def test_within_loops_and_vmap():
    def step(k, carry):
        part = one_function(lambda x, y, other: (x + y, y * 0.5))
        return jax.vmap(lambda x, y: part(x, y, jnp.zeros(3)))(*carry)

    x, y = jax.jit(lambda: jax.lax.fori_loop(0, 20, step, (jnp.zeros(100), jnp.ones(100))))()
    np.testing.assert_allclose(x, 2.0, rtol=1e-5)
    np.testing.assert_allclose(y, 0.5**20, rtol=1e-5)


INVERT = """
import pathlib, sys
import jax.numpy as jnp
from jaxrt import compiler
compiler.folder = pathlib.Path(sys.argv[1])
a = 2 * jnp.eye(3)
print(len(list(compiler.folder.glob("*"))), float(compiler.program(jnp.linalg.inv, a)(a).sum()))
"""


def test_a_kept_program_with_linear_algebra(tmp_path):
    """It calls LAPACK, which a process that lowers nothing has not found yet: it would call address 0."""
    for kept in (0, 1):
        done = subprocess.run([sys.executable, "-c", INVERT, str(tmp_path)], capture_output=True, text=True, check=True)
        assert done.stdout.split() == [str(kept), "1.5"]


def test_what_is_kept_has_a_name(tmp_path, monkeypatch):
    """A function with derivatives of its own has none in some versions of equinox, and no file could be named."""
    monkeypatch.setattr(compiler, "folder", tmp_path)
    functions = [links.link_rows, probe.lit, probe.stood_on, path.trace_rows, prepare]
    assert len({compiler._file(f, "tree", ()) for f in functions}) == len(functions)
