"""Random numbers that depend only on (seed, name, sample, lane): Philox, and normal numbers from it.

A counter-based generator has no state: a sensor draws the same bits at any output rate, in a run that advances in
pieces, in a replay, and with any other sensors. In plain Python, because numpy's streams may change.
"""

from __future__ import annotations

import hashlib
from statistics import NormalDist

_WORD = 2**64 - 1
_MULTIPLIERS = 0xD2E7470EE14C6C93, 0xCA5A826395121157
_WEYL = 0x9E3779B97F4A7C15, 0xBB67AE8584CAA73B
_NORMAL = NormalDist()

Four = tuple[float, float, float, float]


def philox(counter: tuple[int, int, int, int], key: tuple[int, int]) -> tuple[int, int, int, int]:
    """Return four words of 64 random bits: Philox4x64-10 (Salmon et al., Parallel random numbers, SC 2011)."""
    a, b, c, d = counter
    k0, k1 = key
    for _ in range(10):
        first, second = _MULTIPLIERS[0] * a, _MULTIPLIERS[1] * c
        a, b, c, d = (second >> 64) ^ b ^ k0, second & _WORD, (first >> 64) ^ d ^ k1, first & _WORD
        k0, k1 = (k0 + _WEYL[0]) & _WORD, (k1 + _WEYL[1]) & _WORD
    return a, b, c, d


class RandomNumbers:
    """The random numbers for one name, in runs with one seed."""

    def __init__(self, seed: int, name: str) -> None:
        """Derive the key from seed and name."""
        self._key = seed, int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "little")

    def uniform(self, sample: int, lane: int) -> Four:
        """Return four numbers between 0 and 1, both excluded, of one lane of a sample."""
        a, b, c, d = philox((sample, lane, 0, 0), self._key)
        return _between(a), _between(b), _between(c), _between(d)

    def normal(self, sample: int, lane: int) -> Four:
        """Return four numbers of the normal distribution with standard deviation 1 (Wichura, algorithm AS 241)."""
        a, b, c, d = map(_NORMAL.inv_cdf, self.uniform(sample, lane))
        return a, b, c, d


def _between(word: int) -> float:
    # 52 bits plus a half: never 0 or 1 in double precision.
    return ((word >> 12) + 0.5) * 2.0**-52
