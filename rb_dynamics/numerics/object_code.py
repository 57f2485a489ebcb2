"""Compiled functions as object code: stored in files, loaded by LLVM alone, and called by address.

Importing numba takes half a second and loading a function from its own cache as long again; LLVM alone (`llvmlite`,
which numba needs anyway) takes a tenth of that.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import json
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

# Symbols that numba emits for paths that these functions never take: they get functions by address and own no memory.
# Each is bound to a function that ends the process.
_NEVER_CALLED = ("NRT_MemInfo_call_dtor", "numba_gil_ensure", "numba_gil_release", "numba_unpickle")
# Status of a function that has returned a value, and of one that has returned None.
_GOOD = (0, -2)
_LIBRARIES = ("libm.so.6", "libc.so.6", "/usr/lib/libSystem.B.dylib")
_TUPLE = re.compile(r"UniTuple\(int64, (\d+)\)")

# Receives the result of a function without one; it is never read.
_UNREAD = ctypes.c_void_p()
_NOTHING = ctypes.addressof(_UNREAD)


@dataclass(frozen=True)
class ObjectCode:
    """A compiled function.

    Attributes:
        symbol: its name in the code.
        externals: names of the external functions that it calls.
        code: object code for this processor.
    """

    symbol: str
    externals: tuple[str, ...]
    code: bytes

    def write(self, path: Path) -> None:
        """Write it to a file atomically.

        Raises:
            OSError: the file cannot be written.
        """
        path.parent.mkdir(parents=True, exist_ok=True)
        head = json.dumps({"symbol": self.symbol, "externals": self.externals})
        whole = head.encode() + b"\n" + self.code
        part = path.with_name(f"{path.name}.{os.getpid()}.part")
        try:
            part.write_bytes(_digest(whole) + b"\n" + whole)
            part.replace(path)
        except OSError:
            with contextlib.suppress(OSError):
                part.unlink(missing_ok=True)
            raise

    @classmethod
    def read(cls, path: Path) -> ObjectCode | None:
        """Return the function that `write` stored; None if the file is damaged.

        Raises:
            OSError: the file cannot be read.
        """
        digest, _, whole = path.read_bytes().partition(b"\n")
        if digest != _digest(whole):
            return None
        head, _, code = whole.partition(b"\n")
        facts = json.loads(head)
        return cls(facts["symbol"], tuple(facts["externals"]), code)


def _digest(whole: bytes) -> bytes:
    return hashlib.sha256(whole).hexdigest().encode()


class Native:
    """A compiled function in memory, called with arrays and numbers.

    Arrays must have the right shape, be aligned and, if the function writes to them, be writable. Only the type of
    their numbers and, where it matters, contiguity are checked.

    Attributes:
        address: address of the function, in numba's calling convention.
    """

    def __init__(self, found: ObjectCode, signature: str) -> None:
        """Load the function; `signature` is the one it was compiled for, as numba writes it.

        Raises:
            RuntimeError: an external function is not in this process.
        """
        returns, arguments = _parts(signature)
        several = _TUPLE.fullmatch(returns)
        self._several, self._returns = several is not None, returns != "void"
        self._result: Any = (ctypes.c_bool if returns == "boolean" else ctypes.c_int64) * int(
            several[1] if several else 1
        )
        self._flatteners = [_flattener(each) for each in arguments]
        # LLVM must not be called any more while the process ends.
        self.address = _loaded(found)
        function = ctypes.CFUNCTYPE(ctypes.c_int32)(self.address)
        function.argtypes = [ctypes.c_void_p] * 2 + [kind for _, kinds in self._flatteners for kind in kinds]
        self._function = function

    def __call__(self, *arguments: Any) -> Any:
        """Call the function; return None, a number or a tuple. Other threads run meanwhile."""
        result, trouble = self._result(), ctypes.c_void_p()
        native: list[Any] = [ctypes.addressof(result), ctypes.addressof(trouble)]
        for (flat, _), argument in zip(self._flatteners, arguments, strict=True):
            native += flat(argument)
        status = self._function(*native)
        if status not in _GOOD:
            raise RuntimeError(f"compiled code ended with status {status}, expected one of {_GOOD}")
        if not self._returns:
            return None
        return tuple(result) if self._several else result[0]

    def on_doubles(self, numbers: ctypes.Array[ctypes.c_double], *others: float) -> None:
        """Call a function of one array of doubles and of numbers that returns nothing; takes half the time."""
        n = len(numbers)
        status = self._function(_NOTHING, _NOTHING, None, None, n, 8, ctypes.addressof(numbers), n, 8, *others)
        if status not in _GOOD:
            raise RuntimeError(f"compiled code ended with status {status}, expected one of {_GOOD}")


def _parts(signature: str) -> tuple[str, list[str]]:
    """Return the type of a function's result, and the types of its arguments."""
    depth, begin, arguments = 0, len(signature) - 1, list[str]()
    end = begin
    for at in range(len(signature) - 1, -1, -1):
        depth += {")": 1, "]": 1, "(": -1, "[": -1}.get(signature[at], 0)
        if (signature[at] == "," and depth == 1) or depth == 0:
            arguments.append(signature[at + 1 : end].strip())
            end = at
        if depth == 0:
            break
    return signature[:end], arguments[::-1]


Flattener = tuple[Callable[[Any], Sequence[Any]], tuple[Any, ...]]
_POINTER, _WHOLE = ctypes.c_void_p, ctypes.c_int64


def _flattener(kind: str) -> Flattener:
    """Return a function that converts an argument of type `kind` to native ones, and their types."""
    if kind in ("float64", "int64"):
        return lambda value: (value,), (ctypes.c_double if kind == "float64" else _WHOLE,)
    if kind.startswith("FunctionType("):
        # Address for C, Python object, address in numba's convention: only the last is used.
        return lambda function: (None, None, function.address), (_POINTER, _POINTER, _POINTER)
    strided = kind.startswith("Array(")
    letter = "d" if "float64" in kind else "q"
    dimensions = int(kind.split(",")[1]) if strided else 1 + kind.count(",")

    def flat(array: Any) -> tuple[Any, ...]:
        if array.dtype.char not in (letter, "l" if letter == "q" else letter) or array.ndim != dimensions:
            raise TypeError(f"found an array of {array.ndim} axes and type {array.dtype}, expected {kind}")
        if not (strided or array.flags.c_contiguous):
            raise TypeError(f"found an array that is not contiguous, expected {kind}")
        try:
            # Takes a third of the time of the other, but only for writable arrays.
            address = ctypes.addressof(ctypes.c_char.from_buffer(array))
        except (TypeError, ValueError):
            address = array.__array_interface__["data"][0]
        # No reference counter, no owner.
        return (None, None, array.size, 8, address, *array.shape, *array.strides)

    return flat, (_POINTER, _POINTER, _WHOLE, _WHOLE, _POINTER, *(2 * dimensions * (_WHOLE,)))


@cache
def processor() -> str:
    """Return the name of the processor and its features: code for one does not run on another.

    Raises:
        ImportError: there is no llvmlite.
    """
    import llvmlite
    import llvmlite.binding as llvm

    return f"{llvmlite.__version__} {llvm.get_host_cpu_name()} {llvm.get_host_cpu_features().flatten()}"


def _loaded(found: ObjectCode) -> int:
    import llvmlite.binding as llvm

    engine = _engine()
    for name in found.externals:
        _bind(name)
    engine.add_object_file(llvm.ObjectFileRef.from_data(found.code))
    engine.finalize_object()
    return int(engine.get_function_address(found.symbol))


@cache
def _engine() -> Any:
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    # Functions that code generated by LLVM calls.
    for library in _LIBRARIES:
        with contextlib.suppress(RuntimeError):
            llvm.load_library_permanently(library)
    machine = llvm.Target.from_default_triple().create_target_machine()
    return llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)


def _bind(name: str) -> None:
    """Tell LLVM the address of a function, unless it knows.

    Raises:
        RuntimeError: it is not in this process.
    """
    import llvmlite.binding as llvm

    if llvm.address_of_symbol(name) is not None:
        return
    # The C library's frexp and ldexp stand for numba_frexp and numba_ldexp: they agree for every finite number.
    wanted = "abort" if name in _NEVER_CALLED else name.removeprefix("numba_")
    for library in (ctypes.pythonapi, ctypes.CDLL(None)):
        with contextlib.suppress(AttributeError):
            llvm.add_symbol(name, ctypes.cast(getattr(library, wanted), ctypes.c_void_p).value)
            return
    raise RuntimeError(f"compiled code needs {name}, which is not in this process")
