"""Functions of plug-ins as compiled code: the bits and failures of Python, and an identity that misses no edit."""

from __future__ import annotations

import math
import random
import struct
from collections.abc import Callable
from types import FunctionType
from typing import Any

import pytest

from rb_dynamics.numerics import compilation
from rb_dynamics.numerics.plugin_code import _MATH, NotAdmittedError, identity, translated

needs_numba = pytest.mark.skipif(not compilation.available(), reason="nothing to compile with: numba is not installed")

HEAD = """
import math
from math import exp
from rb_dynamics.numerics import vector
from rb_dynamics.numerics.vector import norm
from rb_dynamics import UniformGravity
import numpy as np
LIST = [1.0]
def scaled(a, b=2.0): return a * b
"""


def defined(source: str, name: str = "f") -> Any:
    names: dict[str, Any] = {"__name__": "plugin"}
    exec(HEAD + source, names)
    return names[name]


def outcome(function: Callable[..., float], *arguments: float) -> bytes | None:
    try:
        return struct.pack("d", function(*arguments))
    except (ArithmeticError, ValueError):
        return None


NUMBERS = [0.0, -0.0, 1.0, -1.0, 1e-320, 1e308, -1e308, math.inf, -math.inf, math.pi, 2.0**52]
FUNCTIONS = sorted(name for name in _MATH if callable(getattr(math, name)) and name not in ("atan2", "copysign"))


@needs_numba
@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_function_of_math_has_the_bits_of_python_and_fails_where_it_does(name: str) -> None:
    plain = defined(f"def f(x): return 1.0 * math.{name}(x)")
    identity(plain, ())
    compiled = translated(plain)
    chance = random.Random(1)
    some = [chance.gauss(0.0, 10.0 ** chance.uniform(-6.0, 3.0)) for _ in range(3000)]

    for x in (*NUMBERS, *some):
        assert outcome(compiled, x) == outcome(plain, x), x


@needs_numba
@pytest.mark.parametrize(
    "expression",
    [
        "x / y",
        "math.atan2(x, y)",
        "math.copysign(x, y)",
        "min(x, y) + max(y, x)",
        "abs(x) * y - x",
        "exp(x) + math.sin(y) * math.cos(y)",
        "norm((x, y, 1.0)) / vector.dot((x, x, x), (y, y, y))",
        "min(1.0, 1.0 / x) if y > 0.0 else -x",
        "1.0 / (1.0 + exp(x * 1000.0))",
        "scaled(x) + scaled(x, b=y)",
    ],
)
def test_an_expression_has_the_bits_of_python_and_fails_where_it_does(expression: str) -> None:
    plain = defined(f"def f(x, y): return {expression}")
    identity(plain, ())
    compiled = translated(plain)
    chance = random.Random(2)
    some = [(chance.gauss(0.0, 3.0), chance.gauss(0.0, 3.0)) for _ in range(1000)]

    for x, y in (*((x, y) for x in NUMBERS for y in NUMBERS), *some):
        assert outcome(compiled, x, y) == outcome(plain, x, y), (x, y)


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        ("return x ** 2", r"f uses \*\*, expected only \+"),
        ("x //= 2.0; return x", "f uses //"),
        ("return x % 2.0", "f uses %"),
        ("return math.hypot(x, x)", "f uses math.hypot, expected numbers"),
        ("return math.pow(x, 2.0)", "f uses math.pow"),
        ("return np.sqrt(x)", "f uses np.sqrt"),
        ("return sum((x, x))", "f uses sum"),
        ("return float(int(x))", "f uses int"),
        ("return LIST[0] * x", "f uses LIST"),
        ("return UniformGravity", "f uses UniformGravity"),
        ("return nowhere(x)", "f uses nowhere, which is not defined"),
        ("e = math; return e.hypot(x, x)", "f uses math"),
        ("return [y for y in (x, x)][0]", "comprehension"),
        ("return (lambda y: y)(x)", "a function or comprehension inside"),
        ("if x > 0.0: raise ValueError\n    return x", "f has raise or assert"),
        ("assert x > 0.0\n    return x", "f has raise or assert"),
        ("try:\n        return 1.0 / x\n    except ZeroDivisionError:\n        return 0.0", "f has try"),
        ("global LIST; LIST = x\n    return x", "f has global"),
        ("import os\n    return x", "f has import"),
        ("if x > 0.0: y = x\n    return y", "f may use y before it is set"),
        ("for k in range(3): y = x\n    return y", "f may use y before it is set"),
        ("for k in range(3): x = x + 1.0\n    return x + k", "f may use k before it is set"),
        ("while x < 1.0:\n        if x > 0.5: break\n        y = x; x = x + y\n    return y", "f may use y before"),
        ("y = x; del y; return y", "f may use y before it is set"),
        ("if x > 5.0: y = x\n    return x and y", "f may use y before it is set"),
        ("return x * 9007199254740993", "a whole number beyond 2.53"),
        ("return (x, 2 * 9007199254740993)[0]", "a whole number beyond 2.53"),
    ],
)
def test_what_compiled_code_may_do_otherwise_is_not_admitted(body: str, reason: str) -> None:
    with pytest.raises(NotAdmittedError, match=reason):
        identity(defined(f"def f(x):\n    {body}\n"), ())


@pytest.mark.parametrize(
    "body",
    [
        "if x > 0.0: y = x\n    else: y = -x\n    return y",
        "y = x\n    for k in range(3): y = y + k\n    return y",
        "y = 0.0\n    while y < 3.0:\n        if y > x: break\n        z = y + 1.0; y = z\n    return y",
        "for a in (x, x):\n        if a > 1.0: continue\n        b = a\n        x = x + b\n    return x",
        "if x > 1.0: return x\n    elif x > 0.0: y = 1.0\n    else: return -x\n    return y and x or y",
    ],
)
def test_what_is_set_on_all_ways_is_admitted(body: str) -> None:
    assert identity(defined(f"def f(x):\n    {body}\n"), ())


@needs_numba
@pytest.mark.parametrize(
    ("body", "admitted"),
    [
        ("n = 1\n    for k in range(70): n = n * 3\n    return x * n", False),
        ("n = 1\n    for k in range(70): n += n\n    return x * n", False),
        ("n = 3037000500\n    return x * (n * n)", False),
        ("n = 0\n    for k in range(3): n += 1\n    return x * n + len((x, x)) - 1", True),
        ("n = 0\n    for k in range(3): n = n + x * k\n    return n", True),
        ("n = 0\n    while n < 3: n += 1\n    return (x, 2.0, 3.0, x)[n]", True),
    ],
)
def test_whole_numbers_that_may_be_large_are_not_compiled(body: str, admitted: bool) -> None:
    plain = defined(f"def f(x):\n    {body}\n")
    identity(plain, ())
    if admitted:
        assert outcome(translated(plain), 1.5) == outcome(plain, 1.5)
    else:
        with pytest.raises(RuntimeError, match="f adds or multiplies whole numbers, which may go beyond 64 bits"):
            translated(plain)(1.5)


def test_functions_of_functions_and_objects_are_not_admitted() -> None:
    for function in (defined("def g(y):\n    return lambda x: x + y\nf = g(1.0)"), math.sqrt, print):
        with pytest.raises(NotAdmittedError, match="is not a function of a module"):
            identity(function, ())
    with pytest.raises(NotAdmittedError, match="a default that is not a number"):
        identity(defined("def f(x, y=[]): return x"), ())


SOURCE = """
from typing import NamedTuple
class Numbers(NamedTuple):
    a: float
    b: float = 1.0
G = 9.81
def h(x, k=2.0):
    return k * x
def g(x):
    return h(x) + G
def f(x):
    return g(Numbers(x).b) + 3.0
"""


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("9.81", "9.82"),
        ("k=2.0", "k=2.5"),
        ("k * x", "k + x"),
        ("+ 3.0", "+ 4.0"),
        ("b: float = 1.0", "b: float = 2.0"),
        ("    a: float\n    b: float = 1.0", "    b: float = 1.0\n    a: float = 2.0"),
        ("G = 9.81", "G = 9"),
        ("h(x) + G", "G + h(x)"),
        ("def g(x)", "def g(x, y=0.0)"),
    ],
)
def test_every_edit_of_what_it_depends_on_changes_the_identity(old: str, new: str) -> None:
    assert old in SOURCE
    assert identity(defined(SOURCE.replace(old, new)), ()) != identity(defined(SOURCE), ())


@pytest.mark.parametrize("ends", [("middle = h", "middle = g"), ("middle = min", "middle = max")])
def test_a_name_given_to_another_of_the_same_functions_changes_the_identity(ends: tuple[str, str]) -> None:
    """Machine code from before such an edit was run."""
    source = """
def h(x):
    return x
def g(x):
    return 2.0 * x
first, {}, last = h, {}, g
def f(x):
    return first(x) + middle(x, x) + last(x) + min(x, 1.0) + max(x, 1.0)
"""
    one, other = (identity(defined(source.format(*end.split(" = "))), ()) for end in ends)
    assert one != other


def test_the_identity_is_that_of_the_contents() -> None:
    one, other = defined(SOURCE), defined(SOURCE)
    assert isinstance(one, FunctionType)
    assert one is not other
    assert identity(one, ()) == identity(other, ())
    assert identity(one, ("a",)) != identity(one, ())
