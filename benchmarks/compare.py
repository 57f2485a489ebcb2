"""Compare with other simulators on the same problems at the same error and write docs/benchmarks.md.

    python benchmarks/compare.py                  # a quarter of an hour; `make bench` first installs the peers
    python benchmarks/compare.py --quick          # seconds: scipy alone, small problems; writes nothing
    python benchmarks/compare.py heyoka driven    # only these peers (and ours) and these problems; writes nothing

For each problem, each peer is refined from coarse to fine settings until its attitude error meets the target. The
settings found are then run in turn, A B C A B C, and the medians of times and ratios are shown. Times exclude set-up,
compilation and the first run, which have columns of their own. The page lists the peers that are not installed.
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable, Iterable
from dataclasses import replace
from statistics import median

import numpy as np
from found import Point, Row, StepRow
from peers.problem import PROBLEMS, Answer, Problem, attitude_error, ensemble, problem
from peers.reference import reference
from peers.worker import PeerError, Worker

PEERS = ("scipy", "basilisk", "mujoco", "drake", "pinocchio", "heyoka", "diffrax", "c")

LONGEST = 5.0
"""Seconds: a run that takes longer is not made finer, and is not repeated."""

ROUNDS = 7
FINEST = 2.3e-16
"""The least tolerance that a peer is given."""


def ladder(worker: Worker, task: Problem, way: tuple[str, str, float], expected: Answer) -> Row:
    """Refine from coarse to fine until the error meets the target, then search for the coarsest setting that does."""
    name, kind, setting = way
    points: list[Point] = []

    def attempt(value: float) -> Point:
        tried = worker.attempt(name, value)
        points.append(Point(value, attitude_error(tried.answer, expected), tried.seconds, tried.setup))
        return points[-1]

    row = Row(worker.name, name, kind)
    try:
        fine, coarse = attempt(setting), None
        while kind and fine.error > task.wanted and fine.seconds < LONGEST and not _at_the_end(points, kind):
            coarse = fine
            fine = attempt(2.0 * fine.setting if kind == "steps" else max(0.1 * fine.setting, FINEST))
        if coarse is not None and fine.error <= task.wanted:
            between = math.sqrt(coarse.setting * fine.setting)
            attempt(float(round(between)) if kind == "steps" else between)
        # One more point, for the picture.
        if kind and fine.error <= task.wanted and fine.seconds < 0.2 * LONGEST:
            attempt(2.0 * fine.setting if kind == "steps" else max(0.01 * fine.setting, FINEST))
    except PeerError as error:
        row = replace(row, trouble=str(error))
    good = [p for p in points if p.error <= task.wanted]
    coarsest = min(good, key=lambda p: p.setting if kind == "steps" else -p.setting, default=None)
    return replace(row, points=tuple(points), chosen=coarsest)


def _at_the_end(points: list[Point], kind: str) -> bool:
    """Return whether refining is pointless: there is no finer setting, or rounding dominates."""
    best = min(p.error for p in points)
    worse = best < 1e-6 and all(p.error > best for p in points[-3:])
    return worse or (kind == "tolerance" and points[-1].setting <= FINEST)


def compared(task: Problem, workers: list[Worker], rounds: int) -> list[Row]:
    """Return the rows of a problem; ours come first."""
    expected = reference(task)
    rows: list[tuple[Worker, Row]] = []
    for worker in workers:
        try:
            ways = worker.ways(task)
        except PeerError as error:
            rows.append((worker, Row(worker.name, "", "", trouble=str(error))))
            continue
        for way in ways:
            row = ladder(worker, task, way, expected)
            print(f"  {row.name:34} {_found(row)}", flush=True)
            rows.append((worker, row))
    times = in_turn([(w, r) for w, r in rows if r.chosen and r.chosen.seconds <= LONGEST], rounds)
    # Without a result of ours there is nothing to compare with.
    ours = min(
        (times[r.name] for _, r in rows if r.is_ours and r.name in times), key=median, default=[math.nan] * rounds
    )
    found = []
    for _, row in rows:
        if row.name in times:
            mine = times[row.name]
            ratio = median(a / b for a, b in zip(mine, ours, strict=True))
            found.append(replace(row, seconds=median(mine), ratio=ratio))
        elif row.points:
            # At least as long as its best setting took, accurate enough or not.
            seconds = (row.chosen or row.best).seconds
            found.append(replace(row, seconds=seconds, ratio=seconds / median(ours)))
        else:
            found.append(row)
    return found


def in_turn(rows: list[tuple[Worker, Row]], rounds: int) -> dict[str, list[float]]:
    """Return the times of the chosen settings, run in turn (A B C A B C), by name; ways that fail are left out."""
    times: dict[str, list[float]] = {}
    for worker, row in rows:
        try:
            worker.choose(row.way, row.chosen.setting)
            times[row.name] = []
        except PeerError as error:
            print(f"  {row.name}: {error}", flush=True)
    for _ in range(rounds):
        for worker, row in rows:
            if row.name in times:
                try:
                    times[row.name].append(worker.run(row.way))
                except PeerError as error:
                    print(f"  {row.name}: {error}", flush=True)
                    del times[row.name]
    return times


def _found(row: Row) -> str:
    if row.chosen:
        return f"{row.chosen.error:.1e} rad in {row.chosen.seconds:.3g} s ({row.kind} {row.chosen.setting:g})"
    return row.trouble or f"no better than {row.best.error:.1e} rad, in {row.best.seconds:.3g} s"


def step_rows(task: Problem, n: int, workers: Iterable[Worker], rounds: int) -> list[StepRow]:
    """Compare n rk4 steps of 1 ms with ours on the same number of threads."""
    named: list[tuple[Worker, str, np.ndarray]] = []
    for worker in workers:
        named += [(worker, name, numbers) for name, numbers in worker.kernels(task, 0.001, n)]
    times: dict[tuple[str, str], list[float]] = {(w.name, name): [] for w, name, _ in named}
    for _ in range(rounds):
        for worker, name, _ in named:
            times[worker.name, name].append(worker.run(name))
    found = []
    for worker, name, numbers in named:
        ours, mine = _like(named, name), times[worker.name, name]
        same = np.array_equal(numbers, ours[2])
        base = times[ours[0].name, ours[1]]
        ratio = median(a / b for a, b in zip(base, mine, strict=True))
        found.append(StepRow(f"{worker.name} {name}", 1e9 * median(mine) / n / task.bodies, ratio, same))
    return found


def _like(named: list[tuple[Worker, str, np.ndarray]], name: str) -> tuple[Worker, str, np.ndarray]:
    """Return ours on the same number of threads."""
    ours = [one for one in named if one[0].name == "rb_dynamics"]
    return next((one for one in ours if one[1].endswith(name.rpartition(", ")[2])), ours[0])


def one_body(task: Problem) -> Problem:
    return replace(task, name="step", angular_velocities=np.array([[0.4, -0.7, 0.6]]))


def started(names: Iterable[str], say: Callable[[str], None]) -> tuple[list[Worker], dict[str, str]]:
    """Return the available peers, and the reasons why the others are not."""
    workers, missing = [], {}
    for name in names:
        try:
            workers.append(Worker(name))
            say(f"{workers[-1].name}: {workers[-1].versions}")
        except PeerError as error:
            missing[name] = str(error)
            say(f"{name} {error}")
    return workers, missing


def main(arguments: list[str]) -> None:
    quick = "--quick" in arguments
    if unknown := set(arguments) - {"--quick", *PEERS, *PROBLEMS}:
        sys.exit(f"unknown argument {' '.join(sorted(unknown))}, expected some of: {' '.join((*PEERS, *PROBLEMS))}")
    names = [name for name in PEERS if name in arguments]
    chosen = [name for name in PROBLEMS if name in arguments]
    # With numba, compiled from the first step on: the set-up includes the cost of compilation.
    if not quick:
        os.environ.setdefault("RB_DYNAMICS_COMPILE", "always")
    workers, missing = started(("ours", *(names or (("scipy",) if quick else PEERS))), lambda s: print(s, flush=True))
    rounds = 3 if quick else ROUNDS
    tasks = (
        [replace(problem("boxes"), duration=1.0), ensemble(4)]
        if quick
        else [problem(name) for name in chosen or PROBLEMS]
    )
    results = {}
    for task in tasks:
        print(f"\n{task.title}: to {task.wanted:g} rad", flush=True)
        results[task.name] = task, compared(task, workers, rounds)
        for row in results[task.name][1]:
            print(f"  {row.name:34} {row.seconds:10.3g} s  {row.ratio:10.3g}", flush=True)
    steppers = [w for w in workers if w.name in ("rb_dynamics", "C RK4")]
    sizes = [(one_body(ensemble(64)), 100_000), (ensemble(), 500)] if not quick else [(one_body(ensemble(4)), 100)]
    step_tables = []
    for task, n in sizes:
        step_tables.append((task, step_rows(task, n, steppers, rounds)))
        print(f"\nOne rk4 step, {task.bodies} bodies: ns for each, ours / theirs, same bits", flush=True)
        for row in step_tables[-1][1]:
            print(f"  {row.name:34} {row.nanoseconds:8.1f} {row.ratio:8.2f} {row.same_bits}", flush=True)
    versions = {w.name: w.versions for w in workers}
    for worker in workers:
        worker.close()
    if not (quick or names or chosen):
        from page import write

        write(results, step_tables, versions, missing)


if __name__ == "__main__":
    main(sys.argv[1:])
