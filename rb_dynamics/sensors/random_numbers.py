"""Random numbers that depend only on (seed, name, sample, lane): Philox, and normal numbers from it.

A counter-based generator has no state: a sensor draws the same bits at any rate of outputs, in a run that advances in
pieces, in a replay, and whatever other sensors there are. The streams of numpy may change, so these functions are our
own; they run in plain Python and in kernels, with the same bits.
"""

from __future__ import annotations

import hashlib
import math
from functools import cache

from rb_dynamics.numerics.compilation import compiled_apart, high_word, lane
from rb_dynamics.numerics.vector import Vector

_WORD = 2**64 - 1
_FIRST, _SECOND = 0xD2E7470EE14C6C93, 0xCA5A826395121157
_WEYL = 0x9E3779B97F4A7C15, 0xBB67AE8584CAA73B

Four = tuple[float, float, float, float]
Key = tuple[int, int]
_Row = tuple[float, float, float, float, float, float, float, float]


def philox(counter: tuple[int, int, int, int], key: Key) -> tuple[int, int, int, int]:
    """Return four words of 64 random bits: Philox4x64-10 (Salmon et al., Parallel random numbers, SC 2011)."""
    a, b, c, d = counter
    k0, k1 = key
    for _ in range(10):
        first, second = high_word(_FIRST, a), high_word(_SECOND, c)
        a, b, c, d = second ^ b ^ k0, (_SECOND * c) & _WORD, first ^ d ^ k1, (_FIRST * a) & _WORD
        k0, k1 = (k0 + _WEYL[0]) & _WORD, (k1 + _WEYL[1]) & _WORD
    return a, b, c, d


def uniform_numbers(key: Key, sample: int, number: int) -> Four:
    """Return four numbers between 0 and 1, both excluded, of lane `number` of a sample."""
    a, b, c, d = philox((lane(sample), lane(number), lane(0), lane(0)), key)
    return _between(a), _between(b), _between(c), _between(d)


@compiled_apart
def normal_numbers(key: Key, sample: int, number: int) -> Vector:
    """Return three numbers of the normal distribution with standard deviation 1, of lane `number` of a sample."""
    a, b, c, _ = uniform_numbers(key, sample, number)
    return _normal(a), _normal(b), _normal(c)


def _between(word: int) -> float:
    # 52 bits and a half: neither 0 nor 1 in double precision.
    return ((word >> lane(12)) + 0.5) * 2.0**-52


# Wichura, The percentage points of the normal distribution, Applied Statistics 37 (1988) 477, algorithm AS 241, PPND16:
# numerators and denominators near the middle, in the tails, and far out, highest power first.
_MIDDLE = (
    (
        *(2.5090809287301226727e3, 3.3430575583588128105e4, 6.7265770927008700853e4, 4.5921953931549871457e4),
        *(1.3731693765509461125e4, 1.9715909503065514427e3, 1.3314166789178437745e2, 3.3871328727963666080e0),
    ),
    (
        *(5.2264952788528545610e3, 2.8729085735721942674e4, 3.9307895800092710610e4, 2.1213794301586595867e4),
        *(5.3941960214247511077e3, 6.8718700749205790830e2, 4.2313330701600911252e1, 1.0),
    ),
)
_TAIL = (
    (
        *(7.7454501427834140764e-4, 2.27238449892691845833e-2, 2.41780725177450611770e-1, 1.27045825245236838258e0),
        *(3.64784832476320460504e0, 5.76949722146069140550e0, 4.63033784615654529590e0, 1.42343711074968357734e0),
    ),
    (
        *(1.05075007164441684324e-9, 5.47593808499534494600e-4, 1.51986665636164571966e-2, 1.48103976427480074590e-1),
        *(6.89767334985100004550e-1, 1.67638483018380384940e0, 2.05319162663775882187e0, 1.0),
    ),
)
_FAR = (
    (
        *(2.01033439929228813265e-7, 2.71155556874348757815e-5, 1.24266094738807843860e-3, 2.65321895265761230930e-2),
        *(2.96560571828504891230e-1, 1.78482653991729133580e0, 5.46378491116411436990e0, 6.65790464350110377720e0),
    ),
    (
        *(2.04426310338993978564e-15, 1.42151175831644588870e-7, 1.84631831751005468180e-5, 7.86869131145613259100e-4),
        *(1.48753612908506148525e-2, 1.36929880922735805310e-1, 5.99832206555887937690e-1, 1.0),
    ),
)


def _normal(p: float) -> float:
    """Return the number below which a share p of the normal distribution lies, to 16 digits (AS 241)."""
    q = p - 0.5
    if abs(q) <= 0.425:
        r = 0.180625 - q * q
        return _polynomial(_MIDDLE[0], r) * q / _polynomial(_MIDDLE[1], r)
    r = math.sqrt(-math.log(p if q <= 0.0 else 1.0 - p))
    if r <= 5.0:
        r = r - 1.6
        x = _polynomial(_TAIL[0], r) / _polynomial(_TAIL[1], r)
    else:
        r = r - 5.0
        x = _polynomial(_FAR[0], r) / _polynomial(_FAR[1], r)
    return -x if q < 0.0 else x


def _polynomial(row: _Row, r: float) -> float:
    a, b, c, d, e, f, g, h = row
    return ((((((a * r + b) * r + c) * r + d) * r + e) * r + f) * r + g) * r + h


def key_of(seed: int, name: str) -> Key:
    """Return the key of the random numbers of what is called `name`, in runs with one seed."""
    return seed, _word_of(name)


@cache
def _word_of(name: str) -> int:
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "little")


class RandomNumbers:
    """The random numbers of what is called `name`, in runs with one seed.

    Attributes:
        key: of them.
    """

    def __init__(self, seed: int, name: str) -> None:
        """Key the numbers by seed and name."""
        self.key = key_of(seed, name)

    def uniform(self, sample: int, number: int) -> Four:
        """Return four numbers between 0 and 1, both excluded, of one lane of a sample."""
        return uniform_numbers(self.key, sample, number)

    def normal(self, sample: int, number: int) -> Vector:
        """Return three numbers of the normal distribution with standard deviation 1."""
        return normal_numbers(self.key, sample, number)
