"""Functions of plug-ins as compiled code: which are admitted, what identifies them, and how numba gets them.

Compiled code must give the bits of Python and fail where Python fails. So only operations are admitted for which that
is so, division by zero and the domains of `math` are checked, and everything that the result depends on is in the
identity: after a change of the source, no old code is found in the cache.
"""

from __future__ import annotations

import builtins
import dis
import hashlib
import math
import sys
from collections.abc import Callable, Iterator
from itertools import pairwise
from types import CodeType, FunctionType, ModuleType
from typing import Any

from rb_dynamics.numerics.compilation import implementation_of, is_of_kernels, loaded_numba

# Those that both Python and numba take from the C library, or round correctly.
_CHECKED = ("sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "exp", "log")
_MATH = frozenset(
    (*_CHECKED, "atan2", "fabs", "copysign", "isfinite", "isnan", "isinf", "pi", "tau", "e", "inf", "nan")
)
_BUILTINS = (abs, min, max, float, len, range, enumerate, zip)
# `**`, `//` and `%` are rounded otherwise. Before Python 3.11 each had its own instruction.
_OPERATORS = ("+", "-", "*", "/", "[]")
_OPERATIONS = {f"{kind}_{name}" for kind in ("BINARY", "INPLACE") for name in ("ADD", "SUBTRACT", "MULTIPLY")}
_OPERATIONS |= {"BINARY_TRUE_DIVIDE", "INPLACE_TRUE_DIVIDE", "BINARY_SUBSCR", "BINARY_SLICE"}
_SYMBOLS = {"POWER": "**", "FLOOR_DIVIDE": "//", "MODULO": "%"}
_REFUSED = {
    "RAISE_VARARGS": "raise or assert",
    "SETUP_FINALLY": "try",
    "STORE_GLOBAL": "global",
    "IMPORT_NAME": "import",
    "MAKE_FUNCTION": "a function or comprehension inside",
}


class NotAdmittedError(Exception):
    """A function is not admitted; the message says why."""


def identity(function: Callable[..., Any], facts: object) -> str:
    """Return a name for the code of a module-level function and all that it depends on, and for more facts.

    Raises:
        NotAdmittedError: it does something that compiled code may do otherwise.
    """
    digest = hashlib.sha256(f"{sys.version} {facts!r}".encode())
    done: list[object] = []
    todo: list[object] = [function]
    while todo:
        each = todo.pop()
        if each in done:
            continue
        done.append(each)
        if not isinstance(each, FunctionType) or each.__closure__ or each.__kwdefaults__:
            raise NotAdmittedError(f"{_name(each)} is not a function of a module without keyword-only arguments")
        digest.update(f"{each.__module__} {each.__qualname__}\0".encode())
        if is_of_kernels(each):
            # Part of the name of the folder.
            continue
        code = each.__code__
        _require_admitted(each)
        facts = code.co_code, code.co_consts, code.co_names, code.co_varnames, each.__defaults__
        digest.update(repr(facts).encode())
        for name, value in _used(each):
            digest.update(f"{name} {_identity(each, name, value)}\0".encode())
            if isinstance(value, FunctionType):
                todo.append(value)
    return digest.hexdigest()[:24]


def _require_admitted(function: FunctionType) -> None:
    where = function.__qualname__
    if any(isinstance(each, CodeType) for each in function.__code__.co_consts):
        raise NotAdmittedError(f"{where} has a function or comprehension inside")
    if getattr(function.__code__, "co_exceptiontable", b""):
        raise NotAdmittedError(f"{where} has try, with or a comprehension")
    if not all(map(_is_constant, function.__defaults__ or ())):
        raise NotAdmittedError(f"{where} has a default that is not a number")
    for each in dis.get_instructions(function):
        name = each.opname
        if name in _REFUSED:
            raise NotAdmittedError(f"{where} has {_REFUSED[name]}")
        operator = each.argrepr.rstrip("=") if name == "BINARY_OP" else ""
        unknown = name.startswith(("BINARY_", "INPLACE_")) and name != "BINARY_OP" and name not in _OPERATIONS
        if unknown or (operator and operator not in _OPERATORS):
            found = operator or _SYMBOLS.get(name.partition("_")[2], name)
            raise NotAdmittedError(f"{where} uses {found}, expected only +, -, * and / (write x * x for x ** 2)")


def _identity(function: FunctionType, name: str, value: object) -> str:
    """Return what identifies a value that `function` uses.

    Raises:
        NotAdmittedError: it is not admitted.
    """
    if isinstance(value, FunctionType):
        # Another name may be given to one of the same functions.
        code = value.__code__
        return repr((value.__module__, value.__qualname__, code.co_code, code.co_consts, code.co_names))
    if any(value is each for each in _BUILTINS):
        return _name(value)
    if _is_constant(value):
        return repr(value)
    if _is_named_tuple(value):
        return repr((value.__qualname__, value._fields, value._field_defaults))  # type: ignore[attr-defined]
    known = getattr(value, "__name__", "")
    if known in _MATH and getattr(math, known) is value:
        return known
    raise NotAdmittedError(
        f"{function.__qualname__} uses {name}, expected numbers, named tuples, functions of modules, "
        f"{', '.join(each.__name__ for each in _BUILTINS)}, and of math {', '.join(sorted(_MATH))}"
    )


def _is_constant(value: object) -> bool:
    if type(value) is tuple:
        return all(map(_is_constant, value))
    return value is None or type(value) in (float, int, bool)


def _is_named_tuple(value: object) -> bool:
    if not (isinstance(value, type) and issubclass(value, tuple) and hasattr(value, "_fields")):
        return False
    return all(map(_is_constant, value._field_defaults.values()))  # type: ignore[attr-defined]


def _name(value: object) -> str:
    return getattr(value, "__qualname__", type(value).__qualname__)


def _used(function: FunctionType) -> Iterator[tuple[str, object]]:
    """Yield the globals that a function uses, by name, and those of modules as "module.name".

    Raises:
        NotAdmittedError: there is no such name.
    """
    names = {**vars(builtins), **function.__globals__}
    found = [each for each in dis.get_instructions(function) if each.opname not in ("EXTENDED_ARG", "PUSH_NULL")]
    for each, following in pairwise(found):
        if each.opname not in ("LOAD_GLOBAL", "LOAD_NAME"):
            continue
        if each.argval not in names:
            raise NotAdmittedError(f"{function.__qualname__} uses {each.argval}, which is not defined")
        name, value = str(each.argval), names[each.argval]
        if isinstance(value, ModuleType) and following.opname in ("LOAD_ATTR", "LOAD_METHOD"):
            name, value = f"{name}.{following.argval}", getattr(value, str(following.argval), value)
        yield name, value


def translated(function: Callable[..., Any]) -> Any:
    """Return a function that numba compiles, for an admitted function; like it, it fails where Python fails."""
    return _translated(function, {})


def _translated(function: Any, known: dict[int, Any]) -> Any:
    if id(function) in known:
        return known[id(function)]
    numba = loaded_numba()
    plain = implementation_of(function)
    changed: dict[str, Any] = {}
    for name, value in _used(plain) if plain.__code__.co_names else ():
        module, _, inner = name.rpartition(".")
        new = _for_numba(value, known)
        if new is not None and module:
            changed.setdefault(module, ModuleType(module)).__dict__[inner] = new
        elif new is not None:
            changed[name] = new
    for name, module in changed.items():
        if isinstance(module, ModuleType):
            original = plain.__globals__[name].__dict__
            module.__dict__.update({k: v for k, v in original.items() if k not in module.__dict__})
    copy = FunctionType(
        plain.__code__, {**plain.__globals__, **changed}, plain.__name__, plain.__defaults__, plain.__closure__
    )
    # Unlike in kernels, division by zero is an error.
    known[id(function)] = numba.njit(copy, error_model="python")
    return known[id(function)]


def _for_numba(value: Any, known: dict[int, Any]) -> Any:
    """Return what stands for `value` in compiled code; None for `value` itself."""
    if isinstance(implementation_of(value), FunctionType):
        return _translated(value, known)
    name = getattr(value, "__name__", "")
    if name in _CHECKED and getattr(math, name) is value:
        return _checked(value)
    return None


def _checked(function: Callable[[float], float]) -> Any:
    """Return a function of `math` that fails where that of Python does, instead of giving NaN or infinity."""

    def checked(x: float) -> float:
        y = function(x)
        if (math.isnan(y) and not math.isnan(x)) or (math.isinf(y) and not (math.isnan(x) or math.isinf(x))):
            raise ValueError("math domain error")
        return y

    return loaded_numba().njit(checked)
