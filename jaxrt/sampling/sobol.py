"""Owen-scrambled Sobol points as a counter: no state, any number of dimensions, any order.

Dimensions come in pairs, each a (0, 2)-sequence of its own: the index is shuffled and the two
Sobol dimensions are scrambled by hashes of (stream, pair) (Burley 2020, "Practical hash-based Owen
scrambling"; padding as in Kollig and Keller 2002). Every power of two of consecutive points is stratified.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, PRNGKeyArray, UInt32

_U = np.uint32


def hash_u32(x: Any) -> UInt32[Array, ...]:
    """A bijective mixing of 32 bits (Ellmann and Wellons 2018, lowbias32)."""
    if isinstance(x, np.generic):  # numpy warns where a number overflows, but not in arrays
        return hash_u32(np.asarray([x]))[0]
    x = x ^ (x >> _U(16))
    x = x * _U(0x7FEB352D)
    x = x ^ (x >> _U(15))
    x = x * _U(0x846CA68B)
    return x ^ (x >> _U(16))


def combine(seed: Any, value: Any) -> UInt32[Array, ...]:
    """Hash of a seed and one more number."""
    if isinstance(value, (int, np.integer)):
        return hash_u32(seed ^ _U((int(value) * 0x9E3779B9 + 0x85EBCA6B) & 0xFFFFFFFF))
    return hash_u32(seed ^ (value.astype(_U) * _U(0x9E3779B9) + _U(0x85EBCA6B)))


def _reverse(x: Any) -> Any:
    for shift, mask in ((1, 0x55555555), (2, 0x33333333), (4, 0x0F0F0F0F), (8, 0x00FF00FF)):
        x = ((x >> _U(shift)) & _U(mask)) | ((x & _U(mask)) << _U(shift))
    return (x >> _U(16)) | (x << _U(16))


def _scramble_reversed(x: Any, seed: Any) -> Any:
    """Owen's nested uniform scramble of a number whose bits are reversed (Laine and Karras 2011, Vegdahl 2021)."""
    x = x ^ (x * _U(0x3D20ADEA))
    x = x + seed
    x = x * ((seed >> _U(16)) | _U(1))
    x = x ^ (x * _U(0x05526C56))
    return x ^ (x * _U(0x53A22864))


def _pascal(x: Any) -> Any:
    """Bit-reversed second Sobol dimension of an index whose bits are not reversed: Pascal's matrix modulo 2."""
    for shift, mask in ((1, 0x55555555), (2, 0x33333333), (4, 0x0F0F0F0F), (8, 0x00FF00FF), (16, 0x0000FFFF)):
        x = x ^ ((x >> _U(shift)) & _U(mask))
    return x


def unit_interval(bits: Any) -> Any:
    """[0, 1) from 32 bits, with as many bits as the float type holds without ever rounding to 1."""
    if jax.config.jax_enable_x64:  # pyright: ignore[reportAttributeAccessIssue]
        return bits.astype(jnp.float64) * 2.0**-32
    return (bits >> _U(8)).astype(jnp.float32) * jnp.float32(2.0**-24)


class Stream(eqx.Module):
    """The random numbers of one sample: point `index` of the sequences named by `seed`, from pair `pair` on.

    Streams that share a seed and count through `index` are stratified against each other; different
    seeds are independent. `s.pair_at(k)` gives two numbers in [0, 1); `advance` moves past those used.
    """

    index: Any
    seed: Any
    pair: Any = 0

    def pair_at(self, k: int) -> tuple[Any, Any]:
        seed = combine(self.seed, self.pair + k if isinstance(self.pair, int) else self.pair + _U(k))
        index = _reverse(_scramble_reversed(_reverse(jnp.asarray(self.index)), jnp.asarray(seed)))
        second, third = hash_u32(seed ^ _U(0x68BC21EB)), hash_u32(seed ^ _U(0x02E5BE93))
        a = _reverse(_scramble_reversed(index, second))
        b = _reverse(_scramble_reversed(_pascal(index), third))
        return unit_interval(a), unit_interval(b)

    def advance(self, pairs: int) -> Stream:
        return Stream(self.index, self.seed, self.pair + pairs if isinstance(self.pair, int) else self.pair + _U(pairs))

    def node(self, j: Any, n: int) -> Stream:
        """The stream of node j of n: the n nodes are consecutive points of one set of sequences."""
        return Stream(self.index * _U(n) + jnp.asarray(j).astype(_U), combine(self.seed, n), self.pair)

    def child(self, name: int) -> Stream:
        """Independent numbers for another use of the same point."""
        return Stream(self.index, combine(self.seed, name), self.pair)


class Drawn(eqx.Module):
    """The first pairs of a stream, drawn already."""

    pairs: tuple[tuple[Any, Any], ...]

    @classmethod
    def of(cls, s: Stream, n: int) -> Drawn:
        return cls(tuple(s.pair_at(k) for k in range(n)))

    def pair_at(self, k: int) -> tuple[Any, Any]:
        return self.pairs[k]


def seed_of(key: PRNGKeyArray | Array | int) -> UInt32[Array, ""] | np.uint32:
    """32 bits from a JAX key (new or old style) or a whole number, traced or not: a key only seeds the hash."""
    if isinstance(key, (int, np.integer)):  # of any size
        key = int(key)
        low, high = (_U((key >> k) & 0xFFFFFFFF) for k in (0, 32))
        seed, rest = combine(hash_u32(low), high), key >> 64
        while rest not in (0, -1):
            seed, rest = combine(seed, rest & 0xFFFFFFFF), rest >> 32
        return seed  # by numpy, for JAX takes 2 ms for these few operations one by one
    if jnp.issubdtype(jnp.asarray(key).dtype, jax.dtypes.prng_key):
        key = jax.random.key_data(key)
    key = jnp.asarray(key)
    if jnp.issubdtype(key.dtype, jnp.integer) and key.shape == ():
        wide = key.dtype.itemsize > 4
        high = (key >> 32) if wide else jnp.where(key < 0, -1, 0) if key.dtype == jnp.int32 else jnp.zeros_like(key)
        return combine(hash_u32(key.astype(_U)), high.astype(_U))
    if key.dtype != jnp.uint32 or key.ndim != 1:
        raise ValueError(f"key: has shape {key.shape} and type {key.dtype}; give one JAX key or a whole number")
    seed = _U(0)
    for k in range(key.shape[0]):
        seed = combine(seed, key[k])
    return seed
