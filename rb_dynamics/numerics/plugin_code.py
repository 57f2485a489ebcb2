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
import operator
import re
import sys
from bisect import bisect_left
from collections.abc import Callable, Iterator
from functools import cache
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
# Larger whole numbers are no doubles, and the sum of a smaller one and of those that a function counts has 64 bits.
_LARGEST_WHOLE, _LARGEST_ADDEND = 2**53, 2**31


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
    if unset := _may_be_unset(function):
        raise NotAdmittedError(
            f"{where} may use {unset} before it is set, an error in plain Python; set it at the start"
        )
    if any(map(_is_too_large, function.__code__.co_consts)):
        raise NotAdmittedError(f"{where} has a whole number beyond 2^53; write it as a float")


def _may_be_unset(function: FunctionType) -> str:
    """Return a local variable that may be read before it is set, on some path through the code; "" for none."""
    code = function.__code__
    found = list(dis.get_instructions(function))
    offsets = [each.offset for each in found]
    known: dict[int, set[str]] = {}
    several = bool(code.co_flags & _VARARGS)
    todo = [(0, set(code.co_varnames[: code.co_argcount + several]))]
    while todo:
        number, set_before = todo.pop()
        # Only what all ways to an instruction have set is set there.
        if number in known and known[number] <= set_before:
            continue
        here = known[number] = known.get(number, set_before) & set_before
        each, names = found[number], set(here)
        values = each.argval if isinstance(each.argval, tuple) else (each.argval,)
        for (action, _), name in zip(_LOCAL.findall(each.opname), values, strict=False):
            if action == "LOAD" and name not in names:
                return str(name)
            names = names - {name} if action == "DELETE" else names | {name}
        if not each.opname.startswith(("RETURN", "RAISE")) and each.opname not in _ALWAYS:
            todo.append((number + 1, names))
        if each.opcode in _JUMPS:
            todo.append((bisect_left(offsets, each.argval), names))
    return ""


# Newer Python has instructions for two variables.
_LOCAL = re.compile(r"(LOAD|STORE|DELETE)_FAST(_BORROW)?")
# The flag of code with *args.
_VARARGS = 0x04
_JUMPS = {*dis.hasjrel, *dis.hasjabs}
_ALWAYS = ("JUMP", "JUMP_FORWARD", "JUMP_ABSOLUTE", "JUMP_BACKWARD", "JUMP_BACKWARD_NO_INTERRUPT")


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
    return value is None or type(value) in (float, bool) or (type(value) is int and abs(value) <= _LARGEST_WHOLE)


def _is_too_large(value: object) -> bool:
    if type(value) is tuple:
        return any(map(_is_too_large, value))
    return isinstance(value, int) and abs(value) > _LARGEST_WHOLE


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
    known[id(function)] = numba.njit(copy, error_model="python", pipeline_class=_compiler())
    return known[id(function)]


@cache
def _compiler() -> Any:
    """Return a compiler that refuses sums and products of whole numbers that may go beyond 64 bits."""
    from numba.core import compiler, compiler_machinery, ir, types
    from numba.core.typed_passes import NopythonTypeInference

    sums, products = (operator.add, operator.sub, operator.iadd, operator.isub), (operator.mul, operator.imul)

    def is_small(kind: Any) -> bool:
        return isinstance(kind, types.IntegerLiteral) and abs(kind.literal_value) <= _LARGEST_ADDEND

    @compiler_machinery.register_pass(mutates_CFG=False, analysis_only=True)
    class WholeNumbers(compiler_machinery.AnalysisPass):  # type: ignore[misc]
        _name = "whole_numbers_of_plugins"

        def __init__(self) -> None:
            super().__init__()

        def run_pass(self, state: Any) -> bool:
            for each in state.calltypes:
                if not isinstance(each, ir.Expr) or each.op not in ("binop", "inplace_binop"):
                    continue
                kinds = [state.typemap[side.name] for side in (each.lhs, each.rhs)]
                if each.fn not in (*sums, *products) or not all(isinstance(kind, types.Integer) for kind in kinds):
                    continue
                # No run counts up to 2^63 in such steps.
                if each.fn in products or not any(map(is_small, kinds)):
                    name = state.func_id.func_qualname
                    raise RuntimeError(
                        f"{name} adds or multiplies whole numbers, which may go beyond 64 bits; write them as floats"
                    )
            return False

    class Compiler(compiler.CompilerBase):  # type: ignore[misc]
        def define_pipelines(self) -> list[Any]:
            passes = compiler.DefaultPassBuilder.define_nopython_pipeline(self.state)
            passes.add_pass_after(WholeNumbers, NopythonTypeInference)
            passes.finalize()
            return [passes]

    return Compiler


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
