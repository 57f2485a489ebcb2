"""Compile step functions with numba where it is installed; the same functions run as plain Python where it is not.

Step functions do not mention numba. `compile_kernel` finds the functions that a kernel calls and registers each once.
Compiled and plain results must have the same bits, so fast-math, contraction and Intel's vector library stay off.
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

# Division by zero gives inf or NaN: callers check for non-finite results. Without inlining, tuples go through memory.
_OPTIONS = {"error_model": "numpy", "forceinline": True}


def compiled_as(value: object = None) -> Callable[[_F], _F]:
    """Mark a function that may raise; the compiled version returns `value` instead, NaN that spreads to the result.

    Without `value` it returns its last argument unchanged, which is NaN already in the cases that plain Python refuses.
    """

    def mark(function: _F) -> _F:
        setattr(function, _MARK, value)
        return function

    return mark


def workspace(n: int) -> list[float]:
    """Return n zeros to overwrite: a list in plain Python, memory on the stack when compiled.

    `n` must be a constant. The memory lives as long as the calling function, which must not return it.
    """
    return [0.0] * n


def block(rows: int, lanes: int) -> Any:
    """Return an uninitialised matrix: a numpy array, or memory on the stack when compiled (see `workspace`).

    Both sizes must be constants, so that the compiler knows that rows do not overlap and can vectorise over lanes.
    """
    import numpy as np

    return np.empty((rows, lanes))


def lane(i: int) -> int:
    """Return i >= 0; unsigned when compiled, so that indexing needs no check for negative indices."""
    return i


def specialise(template: Callable[..., Any], name: str, **names: object) -> Callable[..., Any]:
    """Return a copy of the module-level function `template`, called `name`, with `names` among its globals.

    A closure would not do: numba could not find its result again in the cache of another process.
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


def compile_kernel(function: Callable[..., Any], signature: str | Callable[[], Any]) -> Callable[..., Any]:
    """Return `function` compiled for `signature`, or for what that returns; see `cache_folder` for where it is kept.

    Without a writable or readable cache it is compiled anew.

    Raises:
        ImportError, RuntimeError: numba does not load, is switched off, or does not compile it.
    """
    # Two threads would register a function twice and change the cache folder under each other.
    with _one_at_a_time:
        numba = _numba()
        if numba.config.DISABLE_JIT:
            raise RuntimeError("NUMBA_DISABLE_JIT is set; unset it")
        for callee in _reach(function):
            _register(callee)
        if not isinstance(signature, str):
            signature = signature()
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


# A full disk, and whatever pickle raises for the truncated files that a crash or a full disk leaves behind.
_BROKEN_CACHE = (OSError, UnpicklingError, EOFError, ImportError, LookupError, AttributeError, TypeError, ValueError)
_one_at_a_time = threading.Lock()


def _compile(numba: Any, function: Callable[..., Any], signature: Any, *, cache: bool) -> Callable[..., Any]:
    found: Callable[..., Any] = numba.njit(signature, cache=cache, nogil=True, error_model="numpy")(function)
    return found


def _can_keep(numba: Any, function: Callable[..., Any]) -> bool:
    """Return whether numba would cache `function` in `cache_folder`.

    If it cannot write there, numba uses folders of its own, where it would miss edits of what `function` calls.
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
    """Return the folder of compiled kernels, one for each state of the sources, so that no edit is missed.

    Creating a new one deletes those that have not been used for a month.
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
        # The user has no home directory: return a folder that cannot be created.
        return Path(os.devnull)


def _delete_unused(folder: Path) -> None:
    for other in folder.glob("[0-9a-f]" * 16):
        if other.stat().st_mtime < time.time() - _MONTH:
            shutil.rmtree(other, ignore_errors=True)


@cache
def _numba() -> Any:
    # Intel's vector library rounds differently from libm. Numba reads this variable once, when it is imported.
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
            # Aligned to a cache line; otherwise each vector of eight doubles spans two.
            data.align = 64
            value = make_array(array)(context, builder)
            shape, strides = ([context.get_constant(types.intp, k) for k in pair] for pair in ((r, n), (8 * n, 8)))
            populate_array(value, builder.bitcast(data, value.data.type), shape, strides, strides[1], None)
            return value._getvalue()  # noqa: SLF001

        return array(rows, lanes), build

    def unsigned(_context: Any, i: Any) -> Any:
        return types.uint64(i), lambda _context, _builder, _signature, arguments: arguments[0]

    block_on_stack, as_unsigned = intrinsic(prefer_literal=True)(matrix_on_stack), intrinsic(unsigned)

    # Inlined before compilation, so that the memory is the caller's. Both lambdas need the same arguments.
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
    """Return the functions of this package that `function` may call, without itself."""
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
