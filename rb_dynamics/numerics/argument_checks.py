"""Checks of the arguments of public functions; each error names the argument, what was found and what was expected.

A wrong type raises TypeError, a wrong value an error of the caller's choice. Numpy arrays are accepted where tuples are
expected. Not for use inside a step: the checks are slow.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Iterable, Mapping, Set
from typing import TYPE_CHECKING, Any, TypeVar

from rb_dynamics.numerics.rotation import NORM_TOLERANCE, Quaternion, unit
from rb_dynamics.numerics.vector import Vector

if TYPE_CHECKING:
    import numpy.typing as npt

T = TypeVar("T")

_COUNTS = {3: "three", 4: "four"}


def shown(value: object) -> str:
    """Return `value` as an error message shows it: on one line, at most 60 characters."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{text[:60]}..."


def instance(value: object, kind: type[T], name: str, remedy: str) -> T:
    """Return `value` if it is an instance of `kind`.

    Raises:
        TypeError: it is not.
    """
    if isinstance(value, kind):
        return value
    article = "an" if kind.__name__[0] in "AEIO" else "a"
    raise TypeError(f"{name} is {shown(value)}, expected {article} {kind.__name__}; {remedy}")


def mapping(value: object, name: str, remedy: str) -> Mapping[Any, Any]:
    """Return `value` if it is a mapping.

    Raises:
        TypeError: it is not.
    """
    if isinstance(value, Mapping):
        return value
    raise TypeError(f"{name} is {shown(value)}, expected a mapping; {remedy}")


def items(values: object, name: str, expected: str) -> list[Any]:
    """Return the items of a sequence or an array; strings and mappings do not count as sequences.

    Raises:
        TypeError: it is neither.
    """
    if not isinstance(values, Iterable) or isinstance(values, (str, bytes, Mapping)) or getattr(values, "ndim", 1) == 0:
        raise TypeError(f"{name} is {shown(values)}, expected {expected}; write a list")
    return list(values)


def instances(values: object, kind: type[T], name: str, remedy: str) -> tuple[T, ...]:
    """Return the items of a sequence if each is an instance of `kind`.

    Raises:
        TypeError: it is not a sequence, or an item is of another type.
    """
    if type(values) is tuple and all(isinstance(value, kind) for value in values):
        return values
    found = items(values, name, f"a sequence of {kind.__name__}")
    return tuple(instance(value, kind, f"{name}[{k}]", remedy) for k, value in enumerate(found))


def whole_number(value: Any, name: str, remedy: str) -> int:
    """Return `value`, a whole number of Python or numpy, as an int.

    Raises:
        TypeError: it is not a whole number.
    """
    try:
        if not isinstance(value, bool):
            return operator.index(value)
    except TypeError:
        pass
    raise TypeError(f"{name} is {shown(value)}, expected a whole number; {remedy}")


def time_count(value: Any, name: str) -> int:
    """Return a time in whole nanoseconds that 64 bits hold.

    Raises:
        TypeError: it is not a whole number.
        ValueError: it is too large.
    """
    found = whole_number(value, name, "give nanoseconds: round(1e9 * seconds)")
    if not -(2**63) < found < 2**63:
        raise ValueError(f"{name} is {shown(value)}, expected less than 2^63 ns (292 years) either way")
    return found


def truth(value: Any, name: str) -> bool:
    """Return a truth value of Python or numpy: not a number, nor a text such as "false", which Python takes for true.

    Raises:
        TypeError: it is not one.
    """
    if isinstance(value, bool) or (getattr(value, "ndim", 1) == 0 and value.dtype.kind == "b"):
        return bool(value)
    raise TypeError(f"{name} is {shown(value)}, expected a truth value; write True or False")


def number(
    value: object,
    name: str,
    expected: str,
    error: type[Exception] = ValueError,
    least: float = -math.inf,
    above: float = -math.inf,
    most: float = math.inf,
) -> float:
    """Return `value` as a float if it is finite, from `least` to `most` and greater than `above`.

    `expected` says the same in words, for the error message.

    Raises:
        TypeError: it is not a number.
        Exception: `error`, if the number is out of range.
    """
    found = _real(value)
    if found is None:
        raise TypeError(f"{name} is {shown(value)}, expected {expected}: write a number")
    if not (math.isfinite(found) and least <= found <= most and found > above):
        raise error(f"{name} is {found!r}, expected {expected}")
    return found


def vector(value: object, name: str, expected: str, error: type[Exception] = ValueError) -> Vector:
    """Return `value` as three finite floats.

    Raises:
        TypeError: it is not a sequence of numbers.
        Exception: `error`, unless it has three finite numbers.
    """
    x, y, z = _numbers(value, 3, name, expected, error)
    return (x, y, z)


def quaternion(value: object, name: str, error: type[Exception] = ValueError) -> Quaternion:
    """Return `value` as a unit quaternion (x, y, z, w), of norm 1 to round-off.

    Raises:
        TypeError: it is not a sequence of numbers.
        Exception: `error`, unless it has four finite numbers whose norm is 1 within `NORM_TOLERANCE`.
    """
    x, y, z, w = _numbers(value, 4, name, "a unit quaternion (x, y, z, w)", error)
    found = unit((x, y, z, w))
    if found is None:
        raise error(
            f"{name} has norm {math.hypot(x, y, z, w):.6g}, expected a unit quaternion (x, y, z, w), norm 1 within "
            f"{NORM_TOLERANCE:g}; divide it by its norm"
        )
    return found


def as_array(value: object, name: str, expected: str, kind: str | None = "f8") -> npt.NDArray[Any]:
    """Return `value` as an array of dtype `kind`; with `kind=None`, of the dtype that numpy infers.

    Raises:
        TypeError: it is not an array of numbers.
    """
    import numpy as np

    try:
        found = np.asarray(value)
        if found.dtype.kind in "fiu" and not np.ma.is_masked(value):
            return found if kind is None else found.astype(kind, copy=False)
    except ValueError:
        pass
    raise TypeError(f"{name} is {shown(value)}, expected {expected}; write an array of numbers of one shape") from None


def vectors(value: object, name: str) -> npt.NDArray[Any]:
    """Return vectors (..., 3) as an array of float64; NaN and infinity are kept.

    Raises:
        TypeError: it is not an array of real numbers.
        ValueError: its last axis does not have three.
    """
    found = as_array(value, name, "vectors (..., 3)")
    if found.shape[-1:] != (3,):
        raise ValueError(f"{name} has the shape {found.shape}, expected (..., 3); give three components along the last")
    return found


def _numbers(value: object, count: int, name: str, expected: str, error: type[Exception]) -> list[float]:
    # Cheap, because arguments that have been checked before are checked again at every call.
    if (
        type(value) is tuple
        and len(value) == count
        and {*map(type, value)} == {float}
        and all(map(math.isfinite, value))
    ):
        return [*value]
    # A set has no order, and the keys of a mapping are not components.
    unordered = isinstance(value, (Set, Mapping)) or getattr(value, "ndim", 1) == 0
    listed = list(value) if isinstance(value, Iterable) and not unordered else []
    found = [number for number in map(_real, listed) if number is not None]
    if not len(found) == len(listed) == count:
        names = "(x, y, z)" if count == 3 else "(x, y, z, w)"
        kind = error if found and len(found) == len(listed) else TypeError
        raise kind(f"{name} is {shown(value)}, expected {expected}: write {_COUNTS[count]} numbers, {names}")
    if not all(map(math.isfinite, found)):
        raise error(f"{name} is {shown(tuple(found))}, expected {expected}: {_COUNTS[count]} finite numbers")
    return found


def _real(value: Any) -> float | None:
    """Return a real number as a float; None for anything else, strings and booleans included."""
    if isinstance(value, (str, bytes, bool)) or getattr(value, "ndim", 0) != 0:
        return None
    # To float, numpy gives a truth value as well, and a complex number without its imaginary part.
    if getattr(getattr(value, "dtype", None), "kind", "") in ("b", "c"):
        return None
    # A masked number is unknown, and its comparisons are neither true nor false.
    if getattr(value, "mask", False):
        return None
    try:
        return float(value)
    except (TypeError, ValueError):
        return None
    except OverflowError:
        return math.inf
