"""Measure error against run time of every stepping method on three workloads.

Usage: python benchmarks/methods.py [--page FILE] [name ...]

Prints the attitude error at the end and the time for each method and step, and marks the front: the points that no
other point beats in both. The reference is a much finer run, checked by a method of another family. Times are in plain
Python and depend on the machine; errors do not. `LEFT_OUT` are families that are not in the package because they never
reach the front; `--page` writes docs/methods.md.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion import METHODS, Inertia, Method, commutator_free, moser_veselov, splitting
from rb_dynamics.motion.composition import KAHAN_LI6, SUZUKI4
from rb_dynamics.numerics.rotation import Quaternion, angle_between, normalize
from rb_dynamics.numerics.vector import Vector

START: Quaternion = normalize((0.5, -0.1, 0.7, 0.5))
VELOCITY: Vector = (0.3, -0.1, 0.2)
STEPS = [4.0 / 2 ** (k / 2) for k in range(24)]
REPEATS = 3


@dataclass(frozen=True)
class Workload:
    name: str
    inertia: Inertia
    held: HeldWrench
    spin: Vector
    duration: float
    # Methods and numbers of steps of the reference and of its check.
    references: tuple[tuple[str, int], tuple[str, int]]


@dataclass(frozen=True)
class Point:
    method: str
    step: float
    error: float
    per_step: float
    total: float


def _triaxial() -> Inertia:
    body = RigidBody.from_matrix(3.7, ((2.1, 0.13, -0.27), (0.13, 1.7, 0.31), (-0.27, 0.31, 2.9)))
    return Inertia(body.mass, body.principal_moments)


WORKLOADS = (
    Workload(
        "free: Dzhanibekov, 20 s",
        Inertia(1.0, (1.0, 2.0, 3.0)),
        HeldWrench(),
        (0.1, 2.0, 0.1),
        20.0,
        (("exact", 1), ("midpoint6", 4000)),
    ),
    Workload(
        "driven: torque and force in body axes, 10 s",
        _triaxial(),
        HeldWrench(force_body=(0.9, -0.4, 0.6), torque_body=(0.3, -0.2, 0.25)),
        (0.7, -1.1, 0.9),
        10.0,
        (("strang6", 4000), ("midpoint6", 4000)),
    ),
    Workload(
        "weak: torque of 1e-3 in body and world axes, 20 s",
        _triaxial(),
        HeldWrench(torque_body=(3e-4, -2e-4, 2.5e-4), torque_world=(2e-4, 3.5e-4, -3e-4)),
        (0.7, -1.1, 0.9),
        20.0,
        (("strang6", 4000), ("midpoint6", 5000)),
    ),
)


def run(method: Method, workload: Workload, count: int) -> Quaternion:
    """Return the attitude after `count` equal steps."""
    velocity, q, omega = VELOCITY, START, workload.spin
    h = workload.duration / count
    for _ in range(count):
        step = method.step(workload.inertia, workload.held, h, velocity, q, omega)
        q, omega = step.orientation, step.angular_velocity
    return q


def measure(method: Method, workload: Workload, count: int, reference: Quaternion) -> Point | None:
    """Return one point of the table, the best of several repeats; None if the step is too long for the method."""
    best = float("inf")
    for _ in range(REPEATS):
        begin = time.perf_counter()
        try:
            q = run(method, workload, count)
        except ConvergenceError:
            return None
        best = min(best, time.perf_counter() - begin)
        if best > 0.2:
            break
    return Point(method.name, workload.duration / count, angle_between(q, reference), best / count, best)


def front(points: list[Point]) -> set[Point]:
    """Return the points that no other point beats in both error and time."""
    return {
        p
        for p in points
        if not any(o.error <= p.error and o.total <= p.total and o is not p for o in points) and p.error < 0.1
    }


LEFT_OUT = (
    *(
        splitting.method(name, order, splitting.kick_free_kick(stages), "composed", moser_veselov.flow, "its flow")
        for name, order, stages in (("dmv2", 2, (1.0,)), ("dmv4", 4, SUZUKI4), ("dmv6", 6, KAHAN_LI6))
    ),
    # One exponential per slope. The unused fourth stage, which every table has, takes a quarter of the time.
    commutator_free.method(
        "cg3",
        3,
        commutator_free.StageProducts(
            stages=(((3.0 / 4.0,),), ((119.0 / 216.0, 0.0), (0.0, 17.0 / 108.0)), ((0.0, 0.0, 0.0),)),
            end=((13.0 / 51.0, 0.0, 0.0, 0.0), (0.0, -2.0 / 3.0, 0.0, 0.0), (0.0, 0.0, 24.0 / 17.0, 0.0)),
        ),
        "Crouch & Grossman, J. Nonlinear Sci. 3 (1993) 1",
    ),
)
"""Discrete Moser-Veselov composed as dlm2, dlm4 and dlm6 are, and Crouch-Grossman."""

ERRORS = (1e-3, 1e-5, 1e-7, 1e-9, 1e-11)

PAGE = """# Methods: cost over error

How long does each method take to reach a given accuracy? The tables show the time of a run in milliseconds, in plain
Python. The head of each column is the attitude error (rad) at the end of the run. "-" means that no measured step size
reaches it. Bold marks the shortest time of a column, and times within a tenth of it.

`python benchmarks/methods.py --page docs/methods.md` measured the times on one machine, so compare them only within a
column; compiled code has other ratios. `rb-dynamics trade` measures the same on your own scene.
"""

LEFT_OUT_TEXT = """
## Left out

The package leaves out families that are nowhere cheaper than its own methods. The tables above show some of them in
italics: {names}. Those named dmv compose the discrete Moser-Veselov flow (J. Phys. A 39 (2006) 13225) to
their order; cg3 is Crouch-Grossman, which spends a quarter of its time on a stage that it does not need. The best of
them just equals the shortest time of a column. The Moser-Veselov flow has one advantage, its cheap step: `dmv82`,
`dmv864` and `dmv104` combine it with the stages of schemes for near-integrable systems.
"""


def page(tables: dict[str, dict[str, list[float]]]) -> str:
    """Return the times as a page in Markdown."""
    left_out = [method.name for method in LEFT_OUT]
    lines = [PAGE]
    for workload, rows in tables.items():
        least = [min((row[k] for row in rows.values() if row[k] == row[k]), default=0.0) for k in range(len(ERRORS))]
        lines += [
            f"## {workload[:1].upper()}{workload[1:]}",
            "",
            "| method | " + " | ".join(f"{e:.0e}" for e in ERRORS) + " |",
        ]
        lines.append("| --- |" + " ---: |" * len(ERRORS))
        for name, row in rows.items():
            cells = [
                "-" if t != t else f"**{t:.2g}**" if t <= 1.1 * best else f"{t:.2g}"
                for t, best in zip(row, least, strict=True)
            ]
            lines.append(f"| {f'*{name}*' if name in left_out else f'`{name}`'} | " + " | ".join(cells) + " |")
        lines.append("")
    lines.append(LEFT_OUT_TEXT.strip().format(names=", ".join(left_out)))
    return "\n".join(lines) + "\n"


def main(names: list[str], path: str) -> None:
    everything = (*METHODS.own.values(), *LEFT_OUT)
    methods = [m for m in everything if m.order is not None and (not names or m.name in names)]
    tables: dict[str, dict[str, list[float]]] = {}
    on_front: dict[str, list[str]] = {m.name: [] for m in methods}
    for workload in WORKLOADS:
        reference, check = (run(METHODS[name], workload, count) for name, count in workload.references)
        floor = angle_between(reference, check)
        print(f"\n{workload.name}; reference good to {floor:.1e} rad")
        print(f"{'method':10} {'step s':>9} {'error rad':>10} {'us/step':>8} {'total ms':>9}")
        points = []
        for method in methods:
            for h in STEPS:
                point = measure(method, workload, max(1, round(workload.duration / h)), reference)
                if point is not None:
                    points.append(point)
                    if point.error < max(floor, 1e-14) or point.total > 1.0:
                        break
        best = front(points)
        for p in points:
            mark = " front" if p in best else ""
            print(f"{p.method:10} {p.step:9.2e} {p.error:10.1e} {p.per_step * 1e6:8.1f} {p.total * 1e3:9.2f}{mark}")
        for p in best:
            on_front[p.method].append(workload.name.split(":")[0])
        print(f"\n{'ms for error':12}" + "".join(f"{e:>10.0e}" for e in ERRORS))
        tables[workload.name] = {}
        for method in methods:
            mine = [p for p in points if p.method == method.name]
            times = [min((p.total * 1e3 for p in mine if p.error <= e), default=float("nan")) for e in ERRORS]
            tables[workload.name][method.name] = times
            print(f"{method.name:12}" + "".join(f"{t:10.2f}" for t in times))
    print("\npoints on the front")
    for name, where in on_front.items():
        print(f"{name:10} " + (", ".join(f"{w} {where.count(w)}" for w in dict.fromkeys(where)) or "none: dominated"))

    if path:
        # Keep the section written by `front.py`.
        _, *kept = Path(path).read_text(encoding="utf-8").partition("\n## Which methods stay")
        Path(path).write_text(page(tables) + "".join(kept), encoding="utf-8")


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("names", nargs="*", help="methods; all without")
    arguments.add_argument("--page", default="", metavar="FILE", help="write the tables as Markdown")
    given = arguments.parse_args()
    main(given.names, given.page)
