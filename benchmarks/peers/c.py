"""The rk4 step in hand-written C (`benchmarks/reference.c`), compiled here by gcc."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache, partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from peers.problem import Answer, Problem, Run, Way, steps, threads_named
from peers.translate import answer, booked, constants_of, held_of, numbers_of

NAME = "C RK4"
PACKAGES = ()
SOURCE = Path(__file__).resolve().parents[1] / "reference.c"

# Without the last three gcc cannot vectorise a square root and a comparison; they change no bit.
COMMON = ("-O3", "-march=native", "-mprefer-vector-width=512", "-fno-math-errno", "-fno-trapping-math")
FLAGS = {"same rounding": ("-ffp-contract=off",), "contracted": ("-ffp-contract=fast",), "fast-math": ("-ffast-math",)}
LANES = 64


def version() -> str:
    if shutil.which("gcc") is None:
        raise FileNotFoundError("gcc is not installed")
    found = subprocess.run(["gcc", "-dumpfullversion"], capture_output=True, text=True, check=True)
    return f"gcc {found.stdout.strip()}"


@cache
def library(flags: str) -> ctypes.CDLL:
    """Return reference.c compiled with `FLAGS[flags]`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "reference.so"
        compiled = path.with_suffix(".o")
        subprocess.run(["gcc", *COMMON, *FLAGS[flags], "-c", "-fPIC", "-o", str(compiled), str(SOURCE)], check=True)
        # Linked without the flags: with -ffast-math gcc links code that disables subnormal numbers for the process.
        subprocess.run(["gcc", "-shared", "-o", str(path), str(compiled), "-lm"], check=True)
        found = ctypes.CDLL(str(path))
    array = np.ctypeslib.ndpointer(np.float64, flags="C_CONTIGUOUS")
    number, integer = ctypes.c_double, ctypes.c_long
    for name in ("run", "run_bare"):
        getattr(found, name).argtypes = [array, number, integer, array]
    for name in ("run_schedule", "run_schedule_bare"):
        getattr(found, name).argtypes = [array, array, integer, number, integer, array]
    found.run_many.argtypes = [array, number, integer, array, integer, integer, integer]
    return found


def ways(problem: Problem) -> list[Way]:
    first = steps(problem, 0.3)
    if problem.bodies > 1:
        return [Way(f"vectorised, {flags}", "steps", first, _many(problem, flags)) for flags in FLAGS]
    return [
        Way("same books and rounding", "steps", first, _one(problem, "same rounding", "run_schedule")),
        Way("state alone, contracted", "steps", first, _one(problem, "contracted", "run_schedule_bare")),
        Way("state alone, fast-math", "steps", first, _one(problem, "fast-math", "run_schedule_bare")),
    ]


def _one(problem: Problem, flags: str, function: str) -> Callable[[float], Run]:
    def prepare(count: float) -> Run:
        run = getattr(library(flags), function)
        constants, start = constants_of(problem), numbers_of(problem)[0]
        wrenches = np.array([np.concatenate(held) for held in held_of(problem)])
        h = problem.hold / count

        def solve() -> Callable[[], Answer]:
            state = start.copy()
            run(constants, wrenches, problem.holds, h, int(count), state)
            return lambda: answer(problem, state[None])

        return solve

    return prepare


def _many(problem: Problem, flags: str) -> Callable[[float], Run]:
    def prepare(count: float) -> Run:
        lib = library(flags)
        constants = np.repeat(constants_of(problem)[:, None], problem.bodies, axis=1)
        start = np.ascontiguousarray(numbers_of(problem).T)
        h = problem.duration / count

        def solve() -> Callable[[], Answer]:
            state = start.copy()
            run_many(lib, constants, h, int(count), state)
            return lambda: answer(problem, state.T)

        return solve

    return prepare


def run_many(lib: ctypes.CDLL, constants: np.ndarray, h: float, n: int, state: np.ndarray, threads: int = 2) -> None:
    """Advance all bodies by n steps on `threads` threads."""
    bodies = state.shape[1]
    edges = [LANES * round(k * bodies / LANES / threads) for k in range(threads + 1)]
    if threads == 1:
        lib.run_many(constants, h, n, state, bodies, 0, bodies)
        return
    with ThreadPoolExecutor(threads) as pool:
        parts = pairwise(edges)
        list(pool.map(lambda part: lib.run_many(constants, h, n, state, bodies, *part), parts))


def kernels(problem: Problem, h: float, n: int) -> dict[str, Callable[[], Callable[[], np.ndarray]]]:
    """Return functions for n rk4 steps of h s of all bodies, one per compilation; each returns a reader of results."""
    constants = constants_of(problem)
    if problem.bodies == 1:
        start = numbers_of(problem)[0]

        def one(run: Callable[..., None]) -> Callable[[], np.ndarray]:
            state = start.copy()
            run(constants, h, n, state)
            return lambda: booked(problem, state[None])

        found = {flags: partial(one, library(flags).run) for flags in FLAGS}
        return found | {"state alone, fast-math": partial(one, library("fast-math").run_bare)}
    all_constants = np.repeat(constants[:, None], problem.bodies, axis=1)
    all_start = np.ascontiguousarray(numbers_of(problem).T)

    def many(flags: str, threads: int) -> Callable[[], np.ndarray]:
        state = all_start.copy()
        run_many(library(flags), all_constants, h, n, state, threads)
        return lambda: booked(problem, state.T)

    return {f"{flags}, {threads_named(k)}": partial(many, flags, k) for flags in FLAGS for k in (1, 2)}
