"""`PluginFunction`: a function of an effect that is not of this package, as kernels call it.

Such a function is `functools.partial(function, numbers)`: a function of a module, of floats in a NamedTuple (or a
tuple, or one float) and of a `Point`, as those of the effects of this package are.
"""

from __future__ import annotations

import contextlib
import ctypes
import math
import struct
from collections.abc import Callable, Iterable
from functools import partial
from types import FunctionType
from typing import TYPE_CHECKING, Any

from rb_dynamics.loads.effect import Effect, Point
from rb_dynamics.numerics.compilation import call_at, compiled_apart, double, reader, specialise, workspace
from rb_dynamics.numerics.plugin_code import NotAdmittedError, identity, translated
from rb_dynamics.numerics.rotation import IDENTITY, Quaternion, normalize
from rb_dynamics.numerics.vector import ZERO, Vector

if TYPE_CHECKING:
    from rb_dynamics.numerics.array_types import Numbers
    from rb_dynamics.numerics.object_code import Native

SIGNATURE = "void(float64[::1], int64, float64[::1])"

# Numbers of a point, which are handed over, and of a load, which comes back behind them.
_POINT, _LOAD = 14, 6
_POINTS = 40


class PluginFunction:
    """A function of an effect, in the form of `template`.

    Attributes:
        kind: of the effect.
        template: `load_on_numbers` or `scale_on_numbers`.
        part: an example, with some numbers; another effect may have others.
        name: in the cache.
        fault: why it cannot be compiled; "" if nothing is known against it.
        cell: holds its address once it is there; 0 before.
    """

    def __init__(self, kind: str, template: Callable[..., None], part: Callable[[Point], Any]) -> None:
        """Examine a function, without compiling."""
        self.kind, self.template, self.part, self.name, self.fault = kind, template, part, "", ""
        self.cell = ctypes.c_int64(0)
        try:
            self.name = f"{template.__name__}_{_identity(part)}"
        except NotAdmittedError as error:
            self.fault = str(error)

    def for_numba(self, function: Any) -> Any:
        """Return what numba compiles."""
        assert isinstance(self.part, partial)
        inner, read = translated(self.part.func), reader(self.part.args[0])
        return specialise(function, function.__name__, _function=inner, _read=read)

    def enter(self, native: Native) -> None:
        """Let kernels call the compiled function, if it gives what Python gives at some points.

        Raises:
            RuntimeError: it does not.
        """
        assert isinstance(self.part, partial)
        import numpy as np

        numbers = np.array(flat(self.part.args[0]))
        count = _LOAD if self.template is load_on_numbers else 1

        def compiled(point: Point) -> list[float]:
            x = np.array((*flat(point), *(0.0,) * _LOAD))
            native(numbers, 0, x)
            return x[_POINT : _POINT + count].tolist()  # type: ignore[no-any-return]

        for point in _points():
            if _bits(compiled, point) != _bits(lambda at: flat(self.part(at)), point):
                raise RuntimeError(f"compiled, it gives other bits than in Python at {point}")
        self.cell.value = native.address


def _bits(function: Callable[[Point], list[float]], point: Point) -> bytes | None:
    """Return the bits of what a function gives; None if it fails or gives NaN, which a run refuses alike."""
    try:
        found = function(point)
    except Exception:  # noqa: BLE001
        return None
    return None if any(map(math.isnan, found)) else struct.pack(f"{len(found)}d", *found)


def _identity(part: object) -> str:
    if not isinstance(part, partial) or part.keywords or len(part.args) != 1:
        raise NotAdmittedError("found a load, slowing or sight that is not functools.partial(function, numbers)")
    return identity(part.func, _shape(part.args[0]))


_functions: dict[object, PluginFunction] = {}
_by_cell: dict[float, PluginFunction] = {}


def numbers_of(
    effect: Effect, template: Callable[..., None], part: Callable[[Point], Any]
) -> tuple[float, list[float]]:
    """Return the address of the cell of a function of `effect`, and its numbers."""
    key: object = template, type(effect)
    numbers: list[float] = []
    if isinstance(part, partial) and isinstance(part.func, FunctionType) and len(part.args) == 1:
        with contextlib.suppress(NotAdmittedError):
            key, numbers = (template, part.func, _shape(part.args[0])), flat(part.args[0])
    found = _functions.get(key)
    if found is None:
        found = _functions[key] = PluginFunction(effect.kind, template, part)
        _by_cell[float(ctypes.addressof(found.cell))] = found
    return float(ctypes.addressof(found.cell)), numbers


def function_at(cell: float) -> PluginFunction:
    """Return the function of a cell."""
    return _by_cell[cell]


def _shape(value: Any) -> object:
    """Return the types of numbers, which together with the function determine the code.

    Raises:
        NotAdmittedError: they are not floats, or tuples of such.
    """
    if type(value) is float:
        return 0
    if isinstance(value, tuple) and value:
        return (type(value).__qualname__, getattr(value, "_fields", ()), *map(_shape, value))
    raise NotAdmittedError(
        f"its numbers contain a {type(value).__name__} ({value!r}), expected floats or tuples of floats"
    )


def flat(value: Any) -> list[float]:
    """Return the numbers in nested tuples."""
    return [number for each in value for number in flat(each)] if isinstance(value, tuple) else [float(value)]


def _points() -> Iterable[Point]:
    """Yield points at which compiled functions are compared with plain ones."""
    from random import Random

    random = Random(1)

    def vector(least: float, most: float) -> Vector:
        size = 10.0 ** random.uniform(least, most)
        return (random.gauss(0.0, size), random.gauss(0.0, size), random.gauss(0.0, size))

    yield Point(0.0, ZERO, ZERO, IDENTITY, ZERO)
    for _ in range(_POINTS):
        turn: Quaternion = normalize((*vector(0.0, 0.0), random.gauss(0.0, 1.0)))
        time = 10.0 ** random.uniform(-2.0, 4.0)
        yield Point(time, vector(-3.0, 7.5), vector(-3.0, 4.0), turn, vector(-3.0, 2.0))


def _function(*_: Any) -> Any:
    """Placeholder for the function of an effect."""
    raise NotImplementedError


def _read(c: Numbers, i: int) -> Any:
    """Placeholder for a function that reads its numbers."""
    raise NotImplementedError


def load_on_numbers(c: Numbers, i: int, x: Numbers) -> None:
    """Write force and torque at a point."""
    force, torque = _function(_read(c, i), _point_at(x))
    x[14], x[15], x[16] = double(force[0]), double(force[1]), double(force[2])
    x[17], x[18], x[19] = double(torque[0]), double(torque[1]), double(torque[2])


def scale_on_numbers(c: Numbers, i: int, x: Numbers) -> None:
    """Write the number that a function gives at a point."""
    x[14] = double(_function(_read(c, i), _point_at(x)))


def _point_at(x: Numbers) -> Point:
    orientation = (x[7], x[8], x[9], x[10])
    return Point(x[0], (x[1], x[2], x[3]), (x[4], x[5], x[6]), orientation, (x[11], x[12], x[13]))


@compiled_apart
def load_at(cell: float, c: Numbers, i: int, here: Point) -> tuple[Vector, Vector]:
    """Return, in a kernel, force and torque of the function in a cell; NaN where it fails."""
    x: Any = workspace(20)
    _write(x, here)
    if not call_at(cell, c, i, x):
        return (math.nan, math.nan, math.nan), (math.nan, math.nan, math.nan)
    return (x[14], x[15], x[16]), (x[17], x[18], x[19])


@compiled_apart
def scale_at(cell: float, c: Numbers, i: int, here: Point) -> float:
    """Return, in a kernel, the number of the function in a cell; NaN where it fails."""
    x: Any = workspace(20)
    _write(x, here)
    return x[14] if call_at(cell, c, i, x) else math.nan


def _write(x: Any, here: Point) -> None:
    x[0] = here.time
    x[1], x[2], x[3] = here.position
    x[4], x[5], x[6] = here.velocity
    x[7], x[8], x[9], x[10] = here.orientation
    x[11], x[12], x[13] = here.angular_velocity
