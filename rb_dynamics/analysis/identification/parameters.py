"""Parameters of a fit: plain numbers without limits, and the body, effects and sensors that they stand for.

Each is scaled: 0 is the starting value, and about 1 is the largest plausible change. The inertia is that of second
moments of mass S = (tr I / 2) 1 - I = L M M^T L^T, with L of the start and M lower triangular with a positive diagonal
(log-Cholesky; Rucker & Wensing, IEEE RA-L 7 (2022) 2439): every value is that of a body. One number is the logarithm of
the trace, and five are its shape, which is all that torque-free motion can determine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rb_dynamics.analysis.track import Array
from rb_dynamics.body.rigid_body import RigidBody

# Of the largest second moment: a flat body has one that is zero, of which there is no logarithm.
_FLATTEST = 1e-6


@dataclass(frozen=True)
class ParameterBlock:
    """Parameters next to each other in the vector of all.

    Attributes:
        name: what they are; followed by the recording or sensor in brackets, if they belong to one.
        at: where they are in the vector of all.
        scale: of each, in SI units.
        start: (k,), values at zero, for those that are values themselves.
    """

    name: str
    at: slice
    scale: Array
    start: Array = field(default_factory=lambda: np.zeros(0))

    def values(self, z: Array) -> Array:
        """Return the values in SI units of parameters that are values themselves."""
        found: Array = self.start + self.scale * z[self.at]
        return found


class Layout:
    """The blocks of a fit, one after the other."""

    def __init__(self) -> None:
        """Begin with none."""
        self.blocks: dict[str, ParameterBlock] = {}
        self.count = 0

    def add(self, name: str, scale: Sequence[float] | Array, start: Sequence[float] | Array | None = None) -> None:
        """Add a block."""
        scales = np.array(scale, dtype=np.float64)
        starts = np.zeros(len(scales)) if start is None else np.array(start, dtype=np.float64)
        self.blocks[name] = ParameterBlock(name, slice(self.count, self.count + len(scales)), scales, starts)
        self.count += len(scales)

    def __contains__(self, name: str) -> bool:
        """Return whether a block is there."""
        return name in self.blocks

    def __getitem__(self, name: str) -> ParameterBlock:
        """Return a block."""
        return self.blocks[name]

    def values(self, name: str, z: Array, otherwise: Array) -> Array:
        """Return the values of a block, in SI units; `otherwise` where it is not there."""
        return self.blocks[name].values(z) if name in self.blocks else otherwise


PLACES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Where Ixx, Iyy, Izz, Ixy, Ixz and Iyz stand in a matrix."""

AXES = ("xx", "yy", "zz", "xy", "xz", "yz")


class InertiaParameters:
    """Inertia, parametrised around that of a reference body."""

    def __init__(self, body: RigidBody) -> None:
        """Begin with that of `body`."""
        inertia = np.array(body.inertia)
        self.trace = float(np.trace(inertia))
        second = 0.5 * self.trace * np.eye(3) - inertia
        values, axes = np.linalg.eigh(second)
        values = np.maximum(values, _FLATTEST * values.max())
        self._root = np.linalg.cholesky((axes * values) @ axes.T)
        # Many segments of a flight ask for the same in turn.
        self._last: tuple[bytes, Any] = (b"", None)

    # A search may try one that is too far away to be a number.
    @np.errstate(over="ignore", invalid="ignore")
    def matrix(self, size: complex, shape: Any) -> Any:
        """Return the inertia: `size` is the logarithm of its trace against that of the start, `shape` has 5 numbers."""
        a, b, x, y, z = shape
        one = np.array([[np.exp(a), 0.0, 0.0], [x, np.exp(b), 0.0], [y, z, np.exp(-a - b)]])
        root = self._root @ one
        second = root @ root.T
        # With tr S = tr I / 2, I = tr S 1 - S.
        return self.trace * np.exp(size) * 0.5 * (np.eye(3) - second / np.trace(second))

    def parameters(self, inertia: Array) -> tuple[float, Array]:
        """Return `size` and `shape` of an inertia; see `matrix`."""
        trace = float(np.trace(inertia))
        inner = np.linalg.inv(self._root)
        one = np.linalg.cholesky(inner @ (0.5 * trace * np.eye(3) - inertia) @ inner.T)
        one /= np.cbrt(np.linalg.det(one))
        shape = np.array([np.log(one[0, 0]), np.log(one[1, 1]), one[1, 0], one[2, 0], one[2, 1]])
        return float(np.log(trace / self.trace)), shape

    def derivative(self, size: float, shape: Array) -> tuple[Array, Array]:
        """Return Ixx ... Iyz (6,) and their derivatives (6, 6) by size and shape, by complex steps: exact."""
        here = np.append(size, shape)
        if self._last[0] != here.tobytes():
            step = 1e-30j
            moved = [self.matrix(each[0], each[1:]) for each in here + step * np.eye(6)]
            at, value = tuple(zip(*PLACES, strict=True)), self.matrix(size, shape)
            self._last = here.tobytes(), (value[at], np.array([each[at].imag / 1e-30 for each in moved]).T)
        found: tuple[Array, Array] = self._last[1]
        return found


def rows_of(six: Array) -> Array:
    """Return the matrix of Ixx, Iyy, Izz, Ixy, Ixz and Iyz."""
    xx, yy, zz, xy, xz, yz = six
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def moments_and_axes(inertia: Array) -> tuple[Array, Array]:
    """Return the principal moments, ascending and positive, and the axes, as columns, of an inertia.

    The least moment of a rod at which a fit ends that runs away is rounding of the others, and may be negative. It is
    then as large as rounding can be.
    """
    moments, axes = np.linalg.eigh(inertia)
    return np.maximum(moments, np.finfo(np.float64).eps * moments[-1]), axes
