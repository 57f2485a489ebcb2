"""What a step of one body costs among many: by the number of bodies, the method and the threads.

Usage: python benchmarks/ensemble.py [name ...]

Forced bodies, compiled; best of some repeats. `alone` is the same method for one body through `driven_motion`, held for
steps enough that the call does not count; `edge` is what a held wrench costs there beside its one step. Times are of
this machine.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable

import numpy as np

from rb_dynamics import METHODS, Ensemble, RigidBody, State, compiled, driven_motion

BODY = RigidBody.from_matrix(2.5, [[2.1, 0.1, -0.2], [0.1, 1.7, 0.3], [-0.2, 0.3, 2.9]], (0.1, -0.2, 0.3))
STEP, STEP_NS = 0.001, 1_000_000
BODIES = (1, 16, 64, 1024, 4096, 65536)
BODY_STEPS = 200_000
FEWEST_STEPS = 100
EDGES = 10_000
REPEATS = 3


def best(do: Callable[[], object]) -> float:
    """Return the shortest time (s) that `do` takes."""
    do()
    times = []
    for _ in range(REPEATS):
        begin = time.perf_counter()
        do()
        times.append(time.perf_counter() - begin)
    return min(times)


def many(name: str, bodies: int, threads: int) -> float:
    """Return ns per step and body."""
    r = np.random.default_rng(1)
    states = [State(angular_velocity_body=tuple(spin)) for spin in r.normal(size=(bodies, 3)).tolist()]
    ensemble = Ensemble(BODY, states, name, STEP, threads)
    ensemble.hold(torque_body=r.normal(size=(bodies, 3)), force_body=r.normal(size=(bodies, 3)))
    steps = max(FEWEST_STEPS, BODY_STEPS // bodies)
    return best(lambda: ensemble.advance_to(ensemble.time_ns + steps * STEP_NS)) / (steps * bodies) * 1e9


def alone(name: str) -> tuple[float, float]:
    """Return ns per step, and ns per held wrench beside it."""
    state = State(angular_velocity_body=(0.7, -1.1, 0.9))
    torques = 0.1 * np.random.default_rng(1).normal(size=(EDGES, 3))

    def seconds(times: np.ndarray) -> float:
        return best(
            lambda: driven_motion(BODY, state, times, method=name, step=STEP, torque_body=torques[: len(times)])
        )

    step = seconds(np.array([EDGES * STEP_NS])) / EDGES
    return step * 1e9, (seconds(STEP_NS * np.arange(1, EDGES + 1)) / EDGES - step) * 1e9


def main(names: list[str]) -> None:
    """Print a table for each number of threads."""
    if not compiled.available():
        sys.exit("numba is not installed: pip install 'rb_dynamics[fast]'")
    os.environ["RB_DYNAMICS_COMPILE"] = "always"
    chosen = [name for name, method in METHODS.items() if method.compiles and (not names or name in names)]
    print("ns per step and body")
    print(f"{'method':10} {'threads':>7} {'alone':>7} {'edge':>7}" + "".join(f"{bodies:>8}" for bodies in BODIES))
    for name in chosen:
        step, edge = alone(name)
        for threads in (1, 2):
            times = "".join(f"{many(name, bodies, threads):8.1f}" for bodies in BODIES)
            print(f"{name:10} {threads:7} {step:7.0f} {edge:7.0f}{times}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
