"""Compile step functions with numba if it is installed; otherwise the same functions run as plain Python.

Step functions do not mention numba. `compile_kernel` finds the functions that a kernel calls and registers each once.
Compiled and plain results must have the same bits, so fast-math, contraction and Intel's vector library stay off.
"""

from __future__ import annotations

import contextlib
import gc
import hashlib
import logging
import os
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from types import FunctionType, ModuleType
from typing import TYPE_CHECKING, Any, TypeVar

from rb_dynamics.numerics.object_code import Native, ObjectCode, processor

if TYPE_CHECKING:
    from rb_dynamics.numerics.array_types import Numbers

_PACKAGE = Path(__file__).parents[1]
# The folders whose functions kernels may call.
_MADE_OF = ("numerics", "body", "loads", "sensors", "motion")
_F = TypeVar("_F", bound=Callable[..., Any])
_MARK, _BY, _CALLED = "__compiled_as__", "__compiled_by__", "__compiled_apart__"
_MONTH = 30 * 86400.0
_log = logging.getLogger(__name__)

# Division by zero gives inf or NaN: callers check for non-finite results. The same for all functions: numba compiles a
# callee anew for callers with other options.
_OPTIONS = {"error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True}


def compiled_as(value: object = None) -> Callable[[_F], _F]:
    """Mark a function that may raise; the compiled version returns `value` instead, a NaN that then propagates.

    Without `value` it returns its last argument unchanged, which already is NaN in the cases that plain Python refuses.
    """

    def mark(function: _F) -> _F:
        setattr(function, _MARK, value)
        return function

    return mark


def compiled_by(function: Callable[..., Any], first: type) -> Callable[[_F], _F]:
    """Mark a function that compiled code calls in place of `function` if the first argument is of the type `first`.

    The type is a NamedTuple. The function is not inlined: it may be large, and is called at every stage of a method.
    """

    def mark(compiled: _F) -> _F:
        setattr(function, _BY, {**getattr(function, _BY, {}), first: compiled})
        return compiled

    return mark


def compiled_apart(function: _F) -> _F:
    """Mark a function that compiled code calls and does not inline: it is large, and called from several places."""
    setattr(function, _CALLED, True)
    return function


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


def flat(matrix: Any) -> Any:
    """Return the numbers of a contiguous matrix in a row, not copied: loops over rows and lanes at once vectorise."""
    return matrix.reshape(-1)


def lane(i: int) -> int:
    """Return i >= 0; unsigned when compiled, so that indexing needs no check for negative indices."""
    return i


def high_word(a: int, b: int) -> int:
    """Return the upper 64 bits of the product of two words of 64 bits, unsigned when compiled; see `lane`."""
    return (a * b) >> 64


def call_at(cell: float, c: Numbers, i: int, x: Numbers) -> bool:
    """Call the compiled function whose address is at the address `cell`, with (c, i, x); return whether it succeeds.

    For compiled code alone. Without a function (0 in the cell) it does not succeed.
    """
    raise NotImplementedError


def double(x: float) -> float:
    """Return x; when compiled, it must be a float, as whole numbers have no -0."""
    return x


def specialise(template: Callable[..., Any], name: str, **names: object) -> Callable[..., Any]:
    """Return a copy of the module-level function `template`, called `name`, with `names` among its globals.

    A closure would not work: numba could not find the compiled code in the cache of another process.
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
    return _kept_in(name).is_file()


def failure_of(name: str) -> str:
    """Return why another process could not compile a kernel of this name; "" if none has tried or it could."""
    with contextlib.suppress(OSError):
        return _kept_in(name).with_suffix(".failure").read_text(encoding="utf-8")
    return ""


def keep_failure(name: str, reason: str) -> None:
    """Store the reason for `failure_of`."""
    with contextlib.suppress(OSError):
        _kept_in(name).with_suffix(".failure").write_text(reason, encoding="utf-8")


def _kept_in(name: str) -> Path:
    return cache_folder() / f"{name}.kernel"


def compile_kernel(
    function: Callable[..., Any], signature: str, prepare: Callable[[Any], Callable[..., Any]] | None = None
) -> Native:
    """Return `function` compiled for `signature`, from the cache in `cache_folder` if possible.

    Without a readable and writable cache it is compiled anew. `prepare` returns what is compiled in place of it.

    Raises:
        ImportError, RuntimeError: numba does not load, is switched off, or does not compile it.
    """
    with _one_at_a_time:
        path = _kept_in(function.__name__)
        found, trouble = None, ""
        try:
            found = ObjectCode.read(path)
            trouble = "" if found else "it is damaged"
        except FileNotFoundError:
            pass
        except OSError as error:
            trouble = str(error)
        if found is not None:
            return Native(found, signature)
        found = _compiled(function, signature, prepare)
        native = Native(found, signature)
        try:
            found.write(path)
        except OSError as error:
            trouble = trouble or str(error)
        if trouble:
            _log.warning("%s was compiled, as %s cannot be used: %s", function.__qualname__, path, trouble)
        return native


# Two threads would register a function twice.
_one_at_a_time = threading.Lock()


def _compiled(
    function: Callable[..., Any], signature: str, prepare: Callable[[Any], Callable[..., Any]] | None
) -> ObjectCode:
    """Return `function` compiled by numba.

    Raises:
        ImportError, RuntimeError: numba does not load, is switched off, or does not compile it.
    """
    numba = loaded_numba()
    if numba.config.DISABLE_JIT:
        raise RuntimeError("NUMBA_DISABLE_JIT is set; unset it")
    called = _reach(function)
    for callee in called:
        _register(callee)
    # A second round vectorises loops over lanes in which the first has replaced branches; it slows others, as of rk4.
    rounds = 2 if block in called else 1
    options = {**_OPTIONS, "pipeline_class": _compiler(inlined=False)}
    try:
        compiled = function if prepare is None else prepare(function)
        with _without_collection():
            (result,) = numba.njit(signature, **options)(compiled).overloads.values()
    except numba.core.errors.NumbaError as error:
        raise RuntimeError(f"numba {numba.__version__} does not compile {function.__qualname__}") from error
    externals, code = result.library.object_code(rounds)
    return ObjectCode(result.fndesc.llvm_func_name, externals, code)


@contextlib.contextmanager
def _without_collection() -> Iterator[None]:
    """Let Python look for no garbage: numba makes millions of objects, and that takes a tenth of its time."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


@cache
def _compiler(*, inlined: bool) -> Any:
    """Return a compiler for functions of kernels, which are inlined where they are called, or not.

    Numba's own optimises and translates each function, together with all that it calls, and so a function once for each
    level of calls above it. This one does so for whole kernels alone.
    """
    from numba.core import codegen, compiler, compiler_lock, compiler_machinery, lowering, typed_passes

    class Library(codegen.JITCodeLibrary):  # type: ignore[misc]
        """The code of one function, and what it calls."""

        def finalize(self) -> None:
            """Close it, without optimising it for itself."""
            self._finalized = True

        def object_code(self, rounds: int) -> tuple[tuple[str, ...], bytes]:
            """Optimise it; return the names of the external functions that are called, and the object code."""
            module = self._final_module
            # Callers first: the linker drops what nothing calls yet.
            for each in reversed(_with_called(self, {})[:-1]):
                module.link_in(each._get_module_for_linking(), preserve=True)  # noqa: SLF001
            with compiler_lock.global_compiler_lock:
                # Without numba's first, cheaper round, which is for counts of references.
                for _ in range(rounds):
                    found = self._codegen._module_pass_manager()  # noqa: SLF001
                    passes, *of_it = found if isinstance(found, tuple) else (found,)
                    passes.run(module, *of_it)
                code = self._codegen._tm.emit_object(module)  # noqa: SLF001
            declared = [each.name for each in module.functions if each.is_declaration]
            return tuple(name for name in declared if not name.startswith("llvm.")), code

    class Lower(lowering.Lower):  # type: ignore[misc]
        """Without counts of references: kernels own no memory."""

        def incref(self, _type: Any, _value: Any) -> None:
            pass

        def decref(self, _type: Any, _value: Any) -> None:
            pass

    @compiler_machinery.register_pass(mutates_CFG=True, analysis_only=False)
    class Lowering(typed_passes.NativeLowering):  # type: ignore[misc]
        _name = f"lowering_of_kernels_{inlined}"
        lowering_class = Lower

        def run_pass(self, state: Any) -> bool:
            state.library = Library(state.targetctx.codegen(), state.func_id.func_qualname)
            state.flags.no_compile, state.flags.forceinline = True, inlined
            super().run_pass(state)
            # Numba expects something to call, although it is not called.
            call = [state.library].copy
            state.cr = state.cr._replace(cfunc=call)
            state.targetctx.insert_user_function(call, state.cr.fndesc, [state.library])
            return True

    # They fuse expressions of arrays, which kernels do not have, and explain types to a reader.
    unneeded = typed_passes.NopythonRewrites, typed_passes.AnnotateTypes

    class Compiler(compiler.CompilerBase):  # type: ignore[misc]
        def define_pipelines(self) -> list[Any]:
            manager = compiler.DefaultPassBuilder.define_nopython_pipeline(self.state)
            manager.passes = [
                (Lowering if each is typed_passes.NativeLowering else each, name)
                for each, name in manager.passes
                if each not in unneeded
            ]
            manager.finalize()
            return [manager]

    return Compiler


def _with_called(library: Any, found: dict[Any, None]) -> list[Any]:
    """Return a library of code after all those that it calls."""
    for each in library._linking_libraries:  # noqa: SLF001
        if each not in found:
            _with_called(each, found)
    found[library] = None
    return [*found]


@cache
def cache_folder() -> Path:
    """Return the folder of compiled kernels; its name depends on their sources and the compiler, so no edit is missed.

    Creating a new folder deletes those that have not been used for a month.

    Raises:
        ImportError: numba is not installed.
    """
    digest = hashlib.sha256(f"{_version_of_numba()} {processor()}".encode())
    for path in sorted(path for part in _MADE_OF for path in (_PACKAGE / part).rglob("*.py")):
        digest.update(path.relative_to(_PACKAGE).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    folder = _cache_root() / "rb_dynamics" / digest.hexdigest()[:16]
    with contextlib.suppress(OSError):
        if folder.is_dir():
            os.utime(folder)
        else:
            _delete_unused(folder.parent)
    return folder


def _version_of_numba() -> str:
    """Return the identity of the installed numba without importing it, which would take half a second."""
    spec = find_spec("numba")
    if spec is None or spec.origin is None:
        raise ImportError("numba is not installed")
    return Path(spec.origin).with_name("_version.py").read_text(encoding="utf-8")


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
def loaded_numba() -> Any:
    """Return the module numba, set up for kernels.

    Raises:
        ImportError: it does not load.
    """
    # Intel's vector library rounds differently from libm. Numba reads this variable once, when it is imported.
    os.environ.setdefault("NUMBA_DISABLE_INTEL_SVML", "1")
    import numba

    _provide_workspace()
    return numba


def _provide_workspace() -> None:
    from llvmlite.ir import IntType as Type
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

    def in_a_row(_context: Any, matrix: Any) -> Any:
        found = types.Array(matrix.dtype, 1, "C")

        def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            given, value = (
                make_array(signature.args[0])(context, builder, arguments[0]),
                make_array(found)(context, builder),
            )
            width = context.get_constant(types.intp, 8)
            populate_array(value, given.data, (given.nitems,), (width,), width, None)
            return value._getvalue()  # noqa: SLF001

        return found(matrix), build

    def call(_context: Any, cell: Any, c: Any, i: Any, x: Any) -> Any:
        signature = types.boolean(cell, c, i, x)

        def build(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            whole = builder.fptosi(arguments[0], Type(64))
            found = builder.load(builder.inttoptr(whole, Type(64).as_pointer()))
            inner = types.void(c, types.int64, x)
            kind = context.call_conv.get_function_type(inner.return_type, inner.args)
            number = context.cast(builder, arguments[2], i, types.int64)
            good = cgutils.alloca_once_value(builder, cgutils.false_bit)
            with builder.if_then(cgutils.is_not_null(builder, found)):
                function = builder.inttoptr(found, kind.as_pointer())
                given = (arguments[1], number, arguments[3])
                status, _ = context.call_conv.call_function(builder, function, inner.return_type, inner.args, given)
                builder.store(builder.not_(status.is_error), good)
            return builder.load(good)

        return signature, build

    def unsigned(_context: Any, i: Any) -> Any:
        return types.uint64(i), lambda _context, _builder, _signature, arguments: arguments[0]

    def upper_half(_context: Any, a: Any, b: Any) -> Any:
        def build(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            wide = Type(128)
            product = builder.mul(*(builder.zext(each, wide) for each in arguments))
            return builder.trunc(builder.lshr(product, wide(64)), arguments[0].type)

        return types.uint64(a, b), build

    block_on_stack, as_unsigned = intrinsic(prefer_literal=True)(matrix_on_stack), intrinsic(unsigned)
    upper_word, called, flattened = intrinsic(upper_half), intrinsic(call), intrinsic(in_a_row)

    # Inlined before compilation, so that the memory belongs to the caller. Both lambdas need the same arguments.
    # ruff: noqa: ARG005, PLW0108
    overload(workspace, inline="always", prefer_literal=True)(lambda n: lambda n: zeros_on_stack(n))
    overload(block, inline="always", prefer_literal=True)(
        lambda rows, lanes: lambda rows, lanes: block_on_stack(rows, lanes)
    )
    overload(flat, inline="always")(lambda matrix: lambda matrix: flattened(matrix))
    overload(lane, inline="always")(lambda i: lambda i: as_unsigned(i))
    overload(high_word, inline="always")(lambda a, b: lambda a, b: upper_word(a, b))
    overload(call_at, inline="always")(lambda cell, c, i, x: lambda cell, c, i, x: called(cell, c, i, x))
    overload(double, inline="always")(lambda x: (lambda x: x) if isinstance(x, types.Float) else None)


def reader(example: object) -> Any:
    """Return, for compiled code, a function that reads a value of the type of `example`, floats, from (c, i) on."""
    numba = loaded_numba()
    from numba.extending import intrinsic
    from numba.np.arrayobj import make_array

    kind = numba.typeof(example)

    def read(_context: Any, c: Any, i: Any) -> Any:
        def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            array = make_array(signature.args[0])(context, builder, arguments[0])
            # Tuples of floats are in memory as their floats are.
            at = builder.gep(array.data, [arguments[1]])
            return builder.load(builder.bitcast(at, context.get_value_type(kind).as_pointer()))

        return kind(c, i), build

    return intrinsic(read)


_registered: dict[int, object] = {
    id(provided): provided for provided in (workspace, block, flat, lane, high_word, call_at, double)
}


def _register(function: Any) -> None:
    if id(function) in _registered:
        return
    from numba.extending import overload

    _registered[id(function)] = function
    # Without inlining, tuples pass through memory.
    inlined = not (hasattr(function, _BY) or hasattr(function, _CALLED))
    provide = overload(function, jit_options={**_OPTIONS, "pipeline_class": _compiler(inlined=inlined)}, strict=False)
    if hasattr(function, _BY):
        provide(lambda first, *_, **__: getattr(function, _BY).get(getattr(first, "instance_class", None)))
        return
    implementation = implementation_of(function)
    provide(lambda *_, **__: implementation)


def implementation_of(function: Any) -> Any:
    """Return the function that compiled code calls in place of a function that does not depend on a type."""
    return (
        _constant(getattr(function, _MARK)) if hasattr(function, _MARK) else getattr(function, "__wrapped__", function)
    )


def is_of_kernels(function: FunctionType) -> bool:
    """Return whether `function` is one of those in whose sources the folder of the cache is named."""
    return function.__module__.startswith(tuple(f"{_PACKAGE.name}.{part}." for part in _MADE_OF))


def _implementations(function: Any) -> list[Any]:
    """Return the functions that compiled code may call in place of `function`."""
    return [*getattr(function, _BY, {}).values()] or [getattr(function, "__wrapped__", function)]


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
    for plain in _implementations(function):
        cells = [cell.cell_contents for cell in plain.__closure__ or ()]
        names = plain.__code__.co_names
        values = [plain.__globals__[name] for name in names if name in plain.__globals__]
        values += [getattr(v, n) for v in values if isinstance(v, ModuleType) for n in names if hasattr(v, n)]
        for value in (*values, *cells):
            inner = _implementations(value)[0]
            # Not what numba has wrapped.
            known = isinstance(value, FunctionType) or hasattr(value, "cache_info")
            if known and isinstance(inner, FunctionType) and inner.__module__.startswith(f"{_PACKAGE.name}."):
                yield value
