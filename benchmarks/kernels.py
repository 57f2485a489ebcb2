"""Measure the speed-up by compilation: time of a step in plain Python and compiled, for every method that compiles.

Usage: python benchmarks/kernels.py [name ...]

A forced body, advanced through `Arc` as in a run, with fixed steps of 1 ms and with strides chosen for `ACCURACY` (a
stride is up to three steps and its step control); best of several repeats. One-time costs are shown apart: import of
numba, first compilation (into an empty folder), and loading the cached result in a new process. Times are for this
machine.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from importlib import import_module
from itertools import pairwise

from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion import METHODS, Inertia, Method
from rb_dynamics.motion.arc import Arc
from rb_dynamics.motion.phase_state import PhaseState
from rb_dynamics.motion.step_control import AccuracyControl, FixedStep, OwnControl, StepControl
from rb_dynamics.numerics.compilation import available
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.numerics.rotation import normalize

INERTIA = Inertia(3.7, (1.6, 2.1, 2.9))
# So weak that the spin stays the same, since the cost of a step may depend on it.
HELD = HeldWrench((0.009, -0.004, 0.006), (0.003, -0.002, 0.0025), (0.001, 0.002, -0.003), (0.002, 0.0035, -0.003))
# The body moves, since errors of the position are relative to the distance travelled.
SUMS = (0.0, 0.0, 0.0, 1.1, -0.7, 0.4, *(0.0,) * 8)
START = PhaseState(normalize((0.5, -0.1, 0.7, 0.5)), (0.7, -1.1, 0.9), SUMS, (0.0,) * 14)
STEP = 0.001
# For a horizon of 1 s; for lower orders, an accuracy that their steps can reach.
ACCURACY, COARSER = 1e-7, {1: 1e-3, 2: 1e-5}
DURATION = {"never": 5, "always": 100}
REPEATS = 5


def by_accuracy(method: Method) -> StepControl:
    """Return the step control of a run without end, as `run/plan.py` makes it."""
    if method.longest_step is not None:
        return OwnControl(ACCURACY, 1.0, ends=False)
    order = method.order or 0
    accuracy, pair = COARSER.get(order, ACCURACY), method.pair is not None
    return AccuracyControl(accuracy, 1.0, order, INERTIA, start=SUMS[:3], embedded=pair, ends=False)


CONTROLS = (lambda _: FixedStep(STEP), by_accuracy)


def per_stride(method: Method, control: Callable[[Method], StepControl], when: str) -> float:
    """Return the time (s) of a stride."""
    os.environ["RB_DYNAMICS_COMPILE"] = when
    arc, end_ns = Arc(method, INERTIA, HELD, control(method), 0, START), DURATION[when] * NANOSECONDS
    begin = time.perf_counter()
    arc.advance(end_ns)
    return (time.perf_counter() - begin) / arc.steps_to(end_ns)


def first(name: str) -> None:
    """Print the time to import numba, and the time before the first stride of each kind."""
    times = [time.perf_counter()]
    import_module("numba")
    times.append(time.perf_counter())
    os.environ["RB_DYNAMICS_COMPILE"] = "always"
    method = METHODS[name]
    for control in CONTROLS:
        Arc(method, INERTIA, HELD, control(method), 0, START).advance(NANOSECONDS // 100)
        times.append(time.perf_counter())
    print(*(end - begin for begin, end in pairwise(times)))


def first_in_new_process(name: str, cache: str) -> list[float]:
    environment = os.environ | {"XDG_CACHE_HOME": cache, "NUMBA_DISABLE_INTEL_SVML": "1"}
    command = [sys.executable, __file__, "--first", name]
    found = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout.split()
    return [float(text) for text in found]


def main(names: list[str]) -> None:
    if not available():
        sys.exit("numba is not installed: pip install 'rb_dynamics[fast]'")
    print(f"{'':10} {'us, a step of 1 ms':^25} {'us, a stride by accuracy':^25} {'s, once: import, then':^33}")
    kind = f" {'plain':>8} {'compiled':>8} {'ratio':>7}"
    print(f"{'method':10}{kind}{kind} {'numba':>6} {'compile':>7} {'load':>4}  {'compile':>7} {'load':>4}")
    for method in METHODS.values():
        if method.compiles and (not names or method.name in names):
            with tempfile.TemporaryDirectory() as cache:
                imported, *compiled = first_in_new_process(method.name, cache)
                again, *loaded = first_in_new_process(method.name, cache)
            line = f"{method.name:10}"
            for control in CONTROLS:
                plain = min(per_stride(method, control, "never") for _ in range(REPEATS))
                per_stride(method, control, "always")
                fast = min(per_stride(method, control, "always") for _ in range(REPEATS))
                line += f" {plain * 1e6:8.1f} {fast * 1e6:8.3f} {plain / fast:7.0f}"
            line += f" {min(imported, again):6.2f}"
            print(line + " ".join(f" {a:7.2f} {b:4.2f}" for a, b in zip(compiled, loaded, strict=True)), flush=True)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--first"]:
        first(sys.argv[2])
    else:
        main(sys.argv[1:])
