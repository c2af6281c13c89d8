"""Random number streams of the twin: one seed, one independent stream for each part.

Streams are derived from names, so adding a vehicle or a camera does not change the others' numbers.
A stream is a row of an array, so compiled code draws from it, and a copy of the array is a copy of
the stream. The numbers are those of `numpy.random.Generator` with PCG64, bit for bit.
"""

import numpy as np
from numba.np.random import _constants as ziggurat
from numpy.typing import NDArray

from testbed.core.compiled import compiled, inlined

Words = NDArray[np.uint64]

WORDS = 8  # of a stream: 128 bits of state, 128 bits of increment, 32 bits each, lowest first

# 32 bits in 64: no product or sum overflows, with which plain Python would find fault
_FACTOR = 0x2360ED051FC65DA44385DF649FCCF645  # of PCG64
_M0, _M1, _M2, _M3 = (np.uint64(_FACTOR >> 32 * k & 0xFFFFFFFF) for k in range(4))
_LOW, _HALF, _BYTE, _MANTISSA = (np.uint64(n) for n in (2**32 - 1, 32, 0xFF, 2**52 - 1))
_ONE, _THREE, _EIGHT, _NINE, _ELEVEN, _26, _64 = (np.uint64(n) for n in (1, 3, 8, 9, 11, 26, 64))
_63 = np.uint64(63)
_NORMAL_X, _NORMAL_K, _NORMAL_F = ziggurat.wi_double, ziggurat.ki_double, ziggurat.fi_double
_DELAY_X, _DELAY_K, _DELAY_F = ziggurat.we_double, ziggurat.ke_double, ziggurat.fe_double
_NORMAL_R, _NORMAL_INVERSE_R = ziggurat.ziggurat_nor_r, ziggurat.ziggurat_nor_inv_r
_DELAY_R = ziggurat.ziggurat_exp_r


def stream(seed: int, *name: str) -> np.random.Generator:
    """The generator of the part `name`, for instance ("sat1", "camera")."""
    key = tuple("/".join(name).encode())
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


def words(generator: np.random.Generator) -> Words:
    """A generator's state, shape (WORDS,), with which compiled code goes on drawing."""
    state = generator.bit_generator.state["state"]
    numbers = (state["state"], state["inc"])
    return np.array([n >> 32 * k & 0xFFFFFFFF for n in numbers for k in range(4)], np.uint64)


@compiled
def bits(own):
    """The next 64 random bits of a stream, which is advanced."""
    a0, a1, a2, a3 = own[0], own[1], own[2], own[3]
    total = a0 * _M0 + own[4]
    r0, carry = total & _LOW, total >> _HALF
    p, q = a0 * _M1, a1 * _M0
    total = (p & _LOW) + (q & _LOW) + carry + own[5]
    r1, carry = total & _LOW, (total >> _HALF) + (p >> _HALF) + (q >> _HALF)
    p, q, r = a0 * _M2, a1 * _M1, a2 * _M0
    total = (p & _LOW) + (q & _LOW) + (r & _LOW) + carry + own[6]
    r2 = total & _LOW
    carry = (total >> _HALF) + (p >> _HALF) + (q >> _HALF) + (r >> _HALF)
    p, q, r, s = a0 * _M3, a1 * _M2, a2 * _M1, a3 * _M0
    total = (p & _LOW) + (q & _LOW) + (r & _LOW) + (s & _LOW) + carry + own[7]
    r3 = total & _LOW
    own[0], own[1], own[2], own[3] = r0, r1, r2, r3
    folded = (r3 ^ r1) << _HALF | (r2 ^ r0)
    turn = r3 >> _26
    return folded >> turn | folded << (_64 - turn & _63)


@inlined
def uniform(own):
    """`Generator.random()`: in [0, 1)."""
    return (bits(own) >> _ELEVEN) * (1.0 / 9007199254740992.0)


@compiled
def normal(own):
    """`Generator.standard_normal()`."""
    while True:
        r = bits(own)
        k = np.int64(r & _BYTE)
        size = r >> _NINE & _MANTISSA
        x = size * _NORMAL_X[k]
        if r >> _EIGHT & _ONE:
            x = -x
        if size < _NORMAL_K[k]:
            return x
        if k == 0:
            while True:
                tail = -_NORMAL_INVERSE_R * np.log1p(-uniform(own))
                depth = -np.log1p(-uniform(own))
                if depth + depth > tail * tail:
                    far = _NORMAL_R + tail
                    return -far if size >> _EIGHT & _ONE else far
        height = (_NORMAL_F[k - 1] - _NORMAL_F[k]) * uniform(own) + _NORMAL_F[k]
        if height < np.exp(-0.5 * x * x):
            return x


@compiled
def exponential(own):
    """`Generator.standard_exponential()`."""
    while True:
        r = bits(own) >> _THREE
        k = np.int64(r & _BYTE)
        size = r >> _EIGHT
        x = size * _DELAY_X[k]
        if size < _DELAY_K[k]:
            return x
        if k == 0:
            return _DELAY_R - np.log1p(-uniform(own))
        height = (_DELAY_F[k - 1] - _DELAY_F[k]) * uniform(own) + _DELAY_F[k]
        if height < np.exp(-x):
            return x
