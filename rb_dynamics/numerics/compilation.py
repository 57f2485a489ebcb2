"""Compiles step functions by numba where it is installed, from the functions that run as plain Python where it is not.

Nothing in the step functions names numba: the functions that a kernel reaches are found by looking, registered once and
left as they are. Never changes a result: no fast-math, no contraction, no vector library of other bits.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import os
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from pickle import UnpicklingError
from types import FunctionType, ModuleType
from typing import Any, TypeVar

_PACKAGE = Path(__file__).parents[1]
_F = TypeVar("_F", bound=Callable[..., Any])
_MARK = "__compiled_as__"
_MONTH = 30 * 86400.0
_log = logging.getLogger(__name__)

# Division by zero is infinite or NaN, as the caller looks for what is not finite. Inlined, or tuples go through memory.
_OPTIONS = {"error_model": "numpy", "forceinline": True}


def compiled_as(value: object = None) -> Callable[[_F], _F]:
    """Mark a function that may raise. Compiled, it returns `value`, NaN that poisons what follows.

    Without `value` it returns its last argument unchanged: what it would refuse is poisoned already.
    """

    def mark(function: _F) -> _F:
        setattr(function, _MARK, value)
        return function

    return mark


def workspace(n: int) -> list[float]:
    """Return n zeros to be overwritten: a list; compiled, memory on the stack, which costs nothing.

    `n` is a constant. What is returned lives as long as the function that asks for it, which must not return it.
    """
    return [0.0] * n


def block(rows: int, lanes: int) -> Any:
    """Return a matrix to be overwritten, as numpy has it; compiled, on the stack like `workspace`, and as short-lived.

    Both are constants: the compiler knows that its rows are apart, and can take many lanes at once.
    """
    import numpy as np

    return np.empty((rows, lanes))


def lane(i: int) -> int:
    """Return i >= 0; compiled, as an unsigned number, which no array takes to count from its end."""
    return i


def specialise(template: Callable[..., Any], name: str, **names: object) -> Callable[..., Any]:
    """Return a copy of the module-level function `template`, called `name`, with `names` among its globals.

    Not a closure: numba finds its result again in the cache, in every process.
    """
    if not isinstance(template, FunctionType):
        raise TypeError(f"template is {template!r}, expected a function")
    copy = FunctionType(template.__code__, {**template.__globals__, **names}, name, template.__defaults__)
    copy.__qualname__, copy.__module__, copy.__doc__ = name, template.__module__, template.__doc__
    return copy


@cache
def available() -> bool:
    """Return whether numba is installed."""
    return find_spec("numba") is not None


def is_cached(name: str) -> bool:
    """Return whether a kernel of this name has been compiled before, from the same sources by the same compiler."""
    folder = cache_folder()
    return folder.is_dir() and any(folder.rglob(f"*.{name}-*.nbi"))


def compile_kernel(function: Callable[..., Any], signature: str) -> Callable[..., Any]:
    """Return `function` compiled for `signature`; results are cached on disk by the sources of the whole package.

    Where they cannot be kept, or what is found there cannot be read, it is compiled all the same.

    Raises:
        ImportError, RuntimeError: numba does not load, is switched off, or does not compile it.
    """
    # Two threads would register a function twice, and change the folder under each other.
    with _one_at_a_time:
        numba = _numba()
        if numba.config.DISABLE_JIT:
            raise RuntimeError("NUMBA_DISABLE_JIT is set; unset it")
        for callee in _reach(function):
            _register(callee)
        before = numba.config.CACHE_DIR
        numba.config.CACHE_DIR = str(cache_folder())
        try:
            if _can_keep(numba, function):
                try:
                    return _compile(numba, function, signature, cache=True)
                except _BROKEN_CACHE as error:
                    _log.warning(
                        "%s is compiled without the cache in %s: %s", function.__qualname__, cache_folder(), error
                    )
                    _forget(function.__name__)
            return _compile(numba, function, signature, cache=False)
        except numba.core.errors.NumbaError as error:
            raise RuntimeError(f"numba {numba.__version__} does not compile {function.__qualname__}") from error
        finally:
            numba.config.CACHE_DIR = before


# A disk that is full, and what comes of reading what a crash or a full disk has left (see the documentation of pickle).
_BROKEN_CACHE = (OSError, UnpicklingError, EOFError, ImportError, LookupError, AttributeError, TypeError, ValueError)
_one_at_a_time = threading.Lock()


def _compile(numba: Any, function: Callable[..., Any], signature: str, *, cache: bool) -> Callable[..., Any]:
    found: Callable[..., Any] = numba.njit(signature, cache=cache, nogil=True, error_model="numpy")(function)
    return found


def _can_keep(numba: Any, function: Callable[..., Any]) -> bool:
    """Return whether numba would keep `function` in `cache_folder`.

    Where it cannot write there it takes the folder of the source or one of its own, and then misses every edit of what
    `function` calls.
    """
    try:
        path = numba.njit(cache=True)(function).stats.cache_path
    except RuntimeError:
        return False
    return cache_folder() in Path(path).parents


def _forget(name: str) -> None:
    with contextlib.suppress(OSError):
        for path in cache_folder().rglob(f"*.{name}-*"):
            path.unlink(missing_ok=True)


@cache
def cache_folder() -> Path:
    """Return where compiled kernels are kept: a folder for each state of the sources, so that no edit is missed.

    Those of other states that nobody has used for a month are deleted when a new one begins.
    """
    from importlib import metadata

    digest = hashlib.sha256(f"{metadata.version('numba')} {sys.implementation.cache_tag}".encode())
    for path in sorted(_PACKAGE.rglob("*.py")):
        digest.update(path.relative_to(_PACKAGE).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    folder = _cache_root() / "rb_dynamics" / digest.hexdigest()[:16]
    with contextlib.suppress(OSError):
        if folder.is_dir():
            os.utime(folder)
        else:
            _delete_unused(folder.parent)
    return folder


def _cache_root() -> Path:
    if given := os.environ.get("XDG_CACHE_HOME"):
        return Path(given)
    try:
        return Path.home() / ".cache"
    except RuntimeError:
        # A user without a home: a folder that nobody can make.
        return Path(os.devnull)


def _delete_unused(folder: Path) -> None:
    for other in folder.glob("[0-9a-f]" * 16):
        if other.stat().st_mtime < time.time() - _MONTH:
            shutil.rmtree(other, ignore_errors=True)


@cache
def _numba() -> Any:
    # Intel's vector library has other bits than libm. Numba looks at this once, when it is imported.
    os.environ.setdefault("NUMBA_DISABLE_INTEL_SVML", "1")
    import numba

    _provide_workspace()
    return numba


def _provide_workspace() -> None:
    from numba import types as numba_types
    from numba.core import cgutils
    from numba.extending import intrinsic, overload
    from numba.np.arrayobj import make_array, populate_array

    types: Any = numba_types

    def on_stack(_context: Any, n: Any) -> Any:
        array = types.Array(types.float64, 1, "C")

        def build(context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
            size, width = context.get_constant(types.intp, n.literal_value), context.get_constant(types.intp, 8)
            zeros = cgutils.get_null_value(context.get_value_type(types.UniTuple(types.float64, n.literal_value)))
            data = cgutils.alloca_once(builder, zeros.type)
            builder.store(zeros, data)
            value = make_array(array)(context, builder)
            populate_array(value, builder.bitcast(data, value.data.type), (size,), (width,), width, None)
            return value._getvalue()  # noqa: SLF001

        return array(n), build

    zeros_on_stack = intrinsic(prefer_literal=True)(on_stack)

    def matrix_on_stack(_context: Any, rows: Any, lanes: Any) -> Any:
        array = types.Array(types.float64, 2, "C")

        def build(context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
            r, n = rows.literal_value, lanes.literal_value
            data = cgutils.alloca_once(builder, context.get_value_type(types.UniTuple(types.float64, r * n)))
            # Of a cache line: or each vector of eight takes two of them.
            data.align = 64
            value = make_array(array)(context, builder)
            shape, strides = ([context.get_constant(types.intp, k) for k in pair] for pair in ((r, n), (8 * n, 8)))
            populate_array(value, builder.bitcast(data, value.data.type), shape, strides, strides[1], None)
            return value._getvalue()  # noqa: SLF001

        return array(rows, lanes), build

    def unsigned(_context: Any, i: Any) -> Any:
        return types.uint64(i), lambda _context, _builder, _signature, arguments: arguments[0]

    block_on_stack, as_unsigned = intrinsic(prefer_literal=True)(matrix_on_stack), intrinsic(unsigned)

    # Inlined before it is compiled: the memory belongs to the caller. Both lambdas need the same arguments.
    # ruff: noqa: ARG005, PLW0108
    overload(workspace, inline="always", prefer_literal=True)(lambda n: lambda n: zeros_on_stack(n))
    overload(block, inline="always", prefer_literal=True)(
        lambda rows, lanes: lambda rows, lanes: block_on_stack(rows, lanes)
    )
    overload(lane, inline="always")(lambda i: lambda i: as_unsigned(i))


_registered: dict[int, object] = {id(provided): provided for provided in (workspace, block, lane)}


def _register(function: Any) -> None:
    if id(function) in _registered:
        return
    from numba.extending import overload

    _registered[id(function)] = function
    implementation = getattr(function, "__wrapped__", function)
    if hasattr(function, _MARK):
        implementation = _constant(getattr(function, _MARK))
    overload(function, jit_options=_OPTIONS, strict=False)(lambda *_, **__: implementation)


def _constant(value: object) -> Callable[..., Any]:
    if value is None:
        return lambda *args: args[-1]
    return lambda *_: value


def _reach(function: Any) -> list[Any]:
    """Return the functions of this package that `function` may call, itself left out."""
    found: dict[int, Any] = {}
    todo = [function]
    while todo:
        for callee in _callees(todo.pop()):
            if id(callee) not in found:
                found[id(callee)] = callee
                if not hasattr(callee, _MARK):
                    todo.append(callee)
    return list(found.values())


def _callees(function: Any) -> Iterator[Any]:
    plain = getattr(function, "__wrapped__", function)
    cells = [cell.cell_contents for cell in plain.__closure__ or ()]
    names = plain.__code__.co_names
    values = [plain.__globals__[name] for name in names if name in plain.__globals__]
    values += [getattr(v, n) for v in values if isinstance(v, ModuleType) for n in names if hasattr(v, n)]
    for value in (*values, *cells):
        inner = getattr(value, "__wrapped__", value)
        if isinstance(inner, FunctionType) and inner.__module__.startswith(f"{_PACKAGE.name}."):
            yield value
