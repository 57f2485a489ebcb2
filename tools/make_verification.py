"""Write docs/verification.md and its figures: measured accuracy, and the test that checks each claim.

    python tools/make_verification.py          # two to three minutes; keeps the previous drift over 1e9 steps
    python tools/make_verification.py --long   # measures that too: a quarter of an hour with numba

Calls the functions of the tests on the same motions, for every method of METHODS. Figures have one digit, since the
last ones depend on platform and libraries. The limits are in the tests, not here.
"""

from __future__ import annotations

import io
import json
import math
import multiprocessing
import platform
import random
import re
import sys
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path

import mpmath
from matplotlib import colormaps, style
from matplotlib.figure import Figure

import rb_dynamics as rb
from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion import Inertia
from rb_dynamics.motion.arc import Arc
from rb_dynamics.motion.free_rotation import free_rotation
from rb_dynamics.motion.phase_state import PhaseState
from rb_dynamics.motion.step_control import FixedStep
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.numerics.rotation import IDENTITY, rotate
from rb_dynamics.numerics.vector import ZERO, Vector, dot, multiply, norm, scale, subtract
from rb_dynamics.scene.model import Solver

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "verification.md"
IMAGES = ROOT / "docs" / "images"
sys.path[:0] = [str(ROOT / "test" / "support"), str(ROOT / "test" / "verification"), str(ROOT / "test" / "motion")]
(
    free_reference,
    motions,
    test_extremes,
    test_free_rotation,
    test_invariants,
    test_order,
    test_second_simulator,
    wrenches,
) = map(
    import_module,
    (
        *("free_reference", "motions", "test_extremes", "test_free_rotation", "test_invariants", "test_order"),
        *("test_second_simulator", "test_ten_thousand_wrenches"),
    ),
)
EPS, METHODS, STEPPED = motions.EPS, motions.METHODS, motions.STEPPED

GREY, DARK = "#8a949e", "#24292f"
LONG_STEPS = 1_000_000_000

# The exponent of a drift is measured on random spins of the body of test_invariants.
STARTS = 4
ENSEMBLE_STEPS = 10_000
STEP = 0.02

Rows = Iterable[Sequence[str]]


def table(head: Sequence[str], rows: Rows) -> str:
    lines = [head, ["---"] + ["---:"] * (len(head) - 1), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def digit(value: float) -> str:
    """Return a number rounded to one digit; exactly zero gives 0."""
    if value == 0.0 or 0.1 <= value < 1e3:
        return f"{float(f'{value:.0e}'):g}"
    return f"{value:.0e}".replace("e-0", "e-").replace("e+0", "e")


def named(method: str) -> str:
    return f"`{method}`"


# Order ----------------------------------------------------------------------------------------------------------------


def order_rows(methods: Iterable[str] = STEPPED) -> list[list[str]]:
    """Return, for each method, the declared order and the slope of log error over log step of each quantity."""
    rows = []
    for name in methods:
        found = test_order.measured(name)
        slopes = []
        for quantity in test_order.QUANTITIES:
            sizes, values = test_order.resolved(found[quantity])
            slopes.append(f"{motions.slope(sizes, values):.1f}" if len(sizes) >= test_order.NEEDED else "-")
        rows.append([named(name), str(STEPPED[name].order), *slopes])
    return rows


def order_figure() -> Figure:
    """Draw the error of the attitude over the step, one panel for each range of orders."""
    groups: dict[str, list[str]] = {}
    for name, method in STEPPED.items():
        low, high = next(b for b in ((1, 2), (3, 4), (5, 6), (7, 99)) if b[0] <= method.order <= b[1])
        orders = sorted({m.order for m in STEPPED.values() if low <= m.order <= high})
        groups.setdefault("order " + " and ".join(map(str, orders)), []).append(name)
    colors, dashes = colormaps["Dark2"].colors, ("-", "--", ":")
    figure = Figure(figsize=(8.4, 6.2), layout="constrained")
    panels = figure.subplots(2, 2, sharex=True, sharey=True).ravel()
    for axes, title in zip(panels, sorted(groups, key=lambda t: int(t.split()[1])), strict=True):
        for k, name in enumerate(groups[title]):
            values = test_order.measured(name)["attitude"]
            points = [(h, e) for h, e in zip(test_order.STEPS, values, strict=False) if 0.0 < e < 1.0]
            dash, color = dashes[k // len(colors)], colors[k % len(colors)]
            axes.plot(*zip(*points, strict=True), dash, color=color, linewidth=1.2, label=name)
        axes.set_title(title, color=DARK)
        columns = 2 if len(groups[title]) > 6 else 1
        axes.legend(fontsize=7, ncols=columns, frameon=False, loc="lower right", handlelength=1.5, columnspacing=1.0)
        axes.axhspan(1e-17, test_order.FLOOR, color=GREY, alpha=0.15, linewidth=0.0)
    for axes in panels:
        axes.set(xscale="log", yscale="log", ylim=(1e-16, 1.0), xlim=(1.6e-3, 2.5))
        axes.grid(color=GREY, alpha=0.25, linewidth=0.5)
    figure.supxlabel("step, s")
    figure.supylabel("error of the attitude after 2 s, rad")
    return figure


# Invariants -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Walk:
    """Drift of a free body at some numbers of steps: |T/T0 - 1| and |L - L0|/|L0|."""

    method: str
    marks: tuple[int, ...]
    energy: tuple[float, ...]
    angular_momentum: tuple[float, ...]


def marks_up_to(count: int) -> tuple[int, ...]:
    """Return four numbers of steps to each power of ten, from 10 on."""
    return tuple(sorted({round(10 ** (k / 4)) for k in range(4, round(4 * math.log10(count)) + 1)}))


def walk(method: str, count: int, start: int) -> Walk:
    """Return the drift of a method; `start` picks a spin of 2 rad/s of a triaxial body."""
    draw = random.Random(start)
    body = test_invariants.tumbler().body
    inertia = Inertia(1.0, body.principal_moments)
    spin = (draw.gauss(0.0, 1.0), draw.gauss(0.0, 1.0), draw.gauss(0.0, 1.0))
    omega = scale(2.0 / norm(spin), spin)
    # In free motion `exact` takes the same steps as strang2, which numba compiles if it is installed.
    stepping = METHODS["strang2" if method == "exact" else method]
    phase = PhaseState(IDENTITY, omega, (0.0,) * 14, (0.0,) * 14)
    arc = Arc(stepping, inertia, HeldWrench(), FixedStep(STEP), 0, phase)

    def energy(w: Vector) -> float:
        return dot(w, multiply(inertia.moments, w))

    momentum = multiply(inertia.moments, omega)
    e0, size = energy(omega), norm(momentum)
    marks = marks_up_to(count)
    energies, momenta = [], []
    for mark in marks:
        reached = arc.at(mark * round(STEP * NANOSECONDS))
        omega = reached.angular_velocity
        energies.append(abs(energy(omega) / e0 - 1.0))
        momenta.append(norm(subtract(rotate(reached.orientation, multiply(inertia.moments, omega)), momentum)) / size)
    return Walk(method, marks, tuple(energies), tuple(momenta))


@cache
def moves_exactly(method: str) -> bool:
    """Return whether a method takes the same free steps as `exact`, to the bit."""
    inertia, spin = Inertia(1.0, (1.0, 2.0, 2.9)), (0.3, 1.2, -0.7)
    one, other = (METHODS[name].step(inertia, HeldWrench(), STEP, ZERO, IDENTITY, spin) for name in ("exact", method))
    return one == other


def keepers() -> list[str]:
    """Return the methods that conserve energy or momentum, without those that step like `exact`."""
    kept = [name for name, m in METHODS.items() if m.invariants & {"energy", "angular_momentum"}]
    return [name for name in kept if name == "exact" or not moves_exactly(name)]


def long_runners() -> list[str]:
    """Return the methods of `keepers` that the others are composed of: those of order 2, and the closed form."""
    return [name for name in keepers() if (METHODS[name].order or 0) <= 2]


def exponent(walks: Sequence[Walk], invariant: str) -> float:
    """Return the exponent p of the growth n^p of the root mean square over the walks, from 30 steps on."""
    marks = [n for n in walks[0].marks if n >= 30]
    values = [getattr(w, invariant)[-len(marks) :] for w in walks]
    means = [math.sqrt(math.fsum(v * v for v in column) / len(walks)) for column in zip(*values, strict=True)]
    return motions.slope([float(n) for n in marks], [max(m, 1e-3 * EPS) for m in means])


def walks(jobs: Sequence[tuple[str, int, int]]) -> list[Walk]:
    """Return all walks, computed on all cores, the longest first."""
    with ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn")) as pool:
        pending = {job: pool.submit(walk, *job) for job in sorted(jobs, key=lambda job: -job[1])}
        return [pending[job].result() for job in jobs]


def invariant_rows(ensembles: dict[str, list[Walk]]) -> list[list[str]]:
    """Return, for each method, the largest drift over the steps of test_invariants, and its growth if it is kept."""
    rows = []
    for name, method in METHODS.items():
        drift = test_invariants.drift(name, STEP, test_invariants.N)
        grown = ensembles.get("exact" if moves_exactly(name) else name)
        cells = []
        for invariant in ("energy", "angular_momentum"):
            kept = invariant in method.invariants
            cells += [
                "kept" if kept else "",
                digit(getattr(drift, invariant)),
                f"{exponent(grown, invariant):.1f}" if kept and grown else "",
            ]
        rows.append([named(name), *cells])
    return rows


def long_rows(runs: Iterable[Walk]) -> list[list[str]]:
    return [
        [
            named(run.method),
            digit(run.energy[-1]) if "energy" in METHODS[run.method].invariants else "",
            digit(run.angular_momentum[-1]),
        ]
        for run in runs
    ]


def kept_drifts(page: str) -> str:
    """Return the table on `page` of the drift over LONG_STEPS.

    Raises:
        ValueError: There is no table, or its methods are out of date.
    """
    _, _, rest = page.partition("(`--long` measures this")
    found = re.search(r"(?:^\|.*\n)+", rest, re.MULTILINE)
    listed = re.findall(r"^\| `(\w+)`", found[0], re.MULTILINE) if found else []
    if found is None or listed != long_runners():
        raise ValueError(
            f"{PAGE}: found the drift over {LONG_STEPS:.0e} steps of {listed}, expected that of {long_runners()}; "
            "run with --long"
        )
    return found[0]


def drift_figure(runs: Sequence[Walk]) -> Figure:
    figure = Figure(figsize=(8.4, 3.6), layout="constrained")
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    invariants = {"energy": "kinetic energy, |T/T₀ - 1|", "angular_momentum": "angular momentum, |L - L₀|/|L₀|"}
    for axes, (invariant, title) in zip(panels, invariants.items(), strict=True):
        for run, color in zip(runs, colormaps["tab10"].colors, strict=False):
            if invariant in METHODS[run.method].invariants:
                values = [max(v, 0.25 * EPS) for v in getattr(run, invariant)]
                axes.plot(run.marks, values, color=color, linewidth=1.2, label=run.method)
        n = runs[0].marks
        axes.plot(n, [EPS * math.sqrt(k) for k in n], "--", color=DARK, linewidth=1.0, label="ε √n")
        axes.plot(n, [EPS * k for k in n], ":", color=GREY, linewidth=1.0, label="ε n")
        axes.set(xscale="log", yscale="log", title=title, ylim=(0.2 * EPS, 100.0 * EPS * math.sqrt(n[-1])))
        axes.grid(color=GREY, alpha=0.25, linewidth=0.5)
        axes.legend(fontsize=7, frameon=False, loc="upper left")
    figure.supxlabel("steps n")
    return figure


# Exact motion ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Exactness:
    """Errors of the closed form against many digits, in units of the rounding error."""

    turn: float
    error: float
    attitude: float
    energy: float
    angular_momentum: float


def exactness(moments: Sequence[float], spin: Sequence[float], t: float, digits: int = 80) -> Exactness:
    turn, omega = free_rotation((*moments,), (*spin,), t)
    expected, _ = free_reference.free_rotation(moments, spin, t, digits)
    rate = math.hypot(*spin)
    error, changes = free_reference.angle(expected, turn), []
    with mpmath.workdps(50):
        for power in (1, 2):
            now, was = (
                sum(mpmath.mpf(i) ** power * mpmath.mpf(w) ** 2 for i, w in zip(moments, v, strict=True))
                for v in (omega, spin)
            )
            changes.append(float(abs(now / was - 1)) / power / EPS if was else 0.0)
    return Exactness(rate * t, error, error / (EPS * (1.0 + rate * t)), *changes)


def exact_motions() -> dict[str, list[Exactness]]:
    """Return the draws of test_free_rotation by kind of body: all kinds of spin, times from 1e-3 to 1e9 s."""
    found: dict[str, list[Exactness]] = {}
    for body in test_free_rotation.BODIES:
        for spin in test_free_rotation.SPINS:
            draw = random.Random(f"{body} {spin}")
            for longest in (1e-3, 1.0, 1e2, 1e5, 1e9):
                moments = test_free_rotation.BODIES[body](draw)
                draw.shuffle(moments)
                omega = test_free_rotation.SPINS[spin](draw, moments)
                found.setdefault(body, []).append(exactness(moments, omega, longest * draw.random()))
    return found


def exact_rows(found: dict[str, list[Exactness]]) -> list[list[str]]:
    return [
        [body, str(len(draws)), *(digit(max(getattr(d, name) for d in draws)) for name in names)]
        for names in [("attitude", "energy", "angular_momentum")]
        for body, draws in found.items()
    ]


def exact_figure(found: dict[str, list[Exactness]]) -> Figure:
    figure = Figure(figsize=(6.4, 3.8), layout="constrained")
    axes = figure.subplots()
    for (body, draws), color in zip(found.items(), colormaps["tab10"].colors, strict=False):
        points = [(max(d.turn, 1e-16), max(d.error, 1e-18)) for d in draws]
        axes.plot(*zip(*points, strict=True), "o", markersize=3, color=color, label=body)
    turns = [10.0 ** (k / 4) for k in range(-64, 65)]
    for factor, dash, text in ((100.0, "-", "100 ε (1 + |ω| t), the bound"), (1.0, "--", "ε (1 + |ω| t)")):
        bound = [min(math.pi, factor * EPS * (1.0 + turn)) for turn in turns]
        axes.plot(turns, bound, dash, color=DARK, linewidth=1.0, label=text)
    axes.set(xscale="log", yscale="log", xlabel="angle turned, rad", ylabel="error of the attitude, rad")
    axes.set(xlim=(1e-16, 1e16), ylim=(1e-18, 10.0))
    axes.grid(color=GREY, alpha=0.25, linewidth=0.5)
    figure.legend(fontsize=7, frameon=False, loc="outside right center")
    return figure


def underflow_rows() -> list[list[str]]:
    """Return the cases of test_extremes in which products of the closed form underflow or overflow."""
    rows = []
    for name, (moments, spin, time) in test_extremes.UNDERFLOWS.items():
        found = exactness(moments, spin, time, 450)
        numbers = [", ".join(repr(c).removesuffix(".0") for c in v) for v in (moments, spin)]
        rows.append([name, *numbers, f"{time:g}", digit(found.attitude)])
    return rows


# References -----------------------------------------------------------------------------------------------------------

STATE = ["attitude", "angular_velocity_body", "position_world", "linear_velocity_world"]


def reference_rows(methods: Iterable[str] = STEPPED) -> list[list[str]]:
    """Return the errors against forced_motion.json at 1 s, with the step h where h^order is 1e-12, at least 1 ms."""
    rows = []
    for name in methods:
        step = max(1e-3, float(f"{1e-12 ** (1.0 / STEPPED[name].order):.1g}"))
        found = motions.errors(motions.forced(), 1, motions.move(motions.forced(), STEPPED[name], step, 1.0))
        rows.append([named(name), f"{step:g}", *(digit(found[quantity]) for quantity in (*STATE, "work"))])
    return rows


def closed_form_rows() -> list[list[str]]:
    """Return the errors against free_motion.json of every closed form, at every time of the table."""
    rows = []
    for name in (name for name, m in METHODS.items() if m.order is None):
        for case in ("dzhanibekov", "boxes_rotation"):
            turning = motions.free(case)
            for time in turning.states:
                found = motions.errors(turning, time, motions.move(turning, METHODS[name], 1e6, time))
                rows.append([f"{named(name)}, {case}", f"{time:g}", *(digit(found[quantity]) for quantity in STATE)])
    return rows


def wrench_rows() -> tuple[list[list[str]], str]:
    run, samples = wrenches.flown(Solver("auto", accuracy=1e-11), 100)
    rows = []
    for time in wrenches.STATES:
        found = wrenches.deviations(samples[time], time)
        rows.append([f"{time:g}", f"{200 * time:,}".replace(",", " "), *(digit(found[q]) for q in wrenches.BOUNDS)])
    return rows, f"{run.steps} steps of {run.method}"


def second_simulator_rows() -> list[list[str]]:
    """Return the differences from each of the other simulators."""
    solver = Solver("auto", accuracy=1e-11)
    textbook = test_second_simulator.TestTextbookEquations().deviations(solver)
    rows = [["textbook equations about the body origin, DOP853", *map(digit, textbook.values())]]
    particles = test_second_simulator.TestPointMasses().deviations()
    rows.append(["four point masses held together by tensions", "-", "-", *map(digit, list(particles.values())[:2])])
    bag = test_second_simulator.read_bag(ROOT / "examples" / "slew.mcap")
    flight = test_second_simulator.TestRecordedFlight().deviations(bag, solver)
    rows.append(["60 s recorded from the Basilisk simulator", *map(digit, flight.values())])
    return rows


def several_turns_rows() -> list[list[str]]:
    """Return, for each method, its error with free steps of more than half a turn, or that it refuses them."""
    rows = []
    for name in METHODS:
        cells = []
        for turns in (0.6, 1.4, 3.3, 25.0):
            moments, spin = (1.0, 1.5, 2.0), (0.3, 1.1, 0.7)
            step = turns * 2.0 * math.pi / norm(spin)
            body = rb.RigidBody.from_diagonal(1.0, moments)
            start = rb.State(angular_velocity_body=spin)
            scene = test_extremes.scene(body, start, Solver(name, step=step), 10.0 * step, 0.0)
            try:
                sample = rb.simulate(scene).sample
            except ConvergenceError:
                cells.append("refused")
                continue
            expected, _ = free_reference.free_rotation(moments, spin, 10.0 * step)
            cells.append(digit(free_reference.angle(expected, sample.orientation_xyzw)))
        rows.append([named(name), *cells])
    return rows


# What shows it --------------------------------------------------------------------------------------------------------

VERIFICATION = "test/verification"
EXTREMES = f"{VERIFICATION}/test_extremes.py"

CLAIMS = [
    (
        "Every method has its declared order in each quantity, on a driven triaxial body",
        f"{VERIFICATION}/test_order.py::test_error_falls_as_the_declared_order",
    ),
    (
        "The balances of energy and momenta converge with the same order, or close exactly where declared",
        f"{VERIFICATION}/test_order.py::test_balances_close_as_fast_or_exactly",
    ),
    (
        "The defects are not zero by construction: they show the error of a method that does not keep a balance",
        f"{VERIFICATION}/test_order.py::test_balances_that_do_not_close_show",
    ),
    (
        "In free motion a method conserves its declared invariants to round-off",
        f"{VERIFICATION}/test_invariants.py::test_declared_invariants_are_kept_to_round_off",
    ),
    (
        "The same with steps that do not resolve the motion",
        f"{VERIFICATION}/test_invariants.py::test_declared_invariants_do_not_depend_on_the_step",
    ),
    (
        "The drift of invariants grows like a random walk of rounding errors",
        f"{VERIFICATION}/test_invariants.py::test_defects_of_long_runs_grow_like_roundings",
    ),
    (
        "The same over 200 000 steps (slow)",
        f"{VERIFICATION}/test_invariants.py::test_declared_invariants_are_kept_over_200000_steps",
    ),
    (
        "The closed form is accurate to 100 ε (1 + |ω| t), T and |L| to 20 ε, for all kinds of body and spin, to 1e9 s",
        "test/motion/test_free_rotation.py::test_attitude_energy_and_momentum_at_the_extremes",
    ),
    (
        "The same where products in its formulas underflow or overflow",
        f"{EXTREMES}::TestFreeRotation::test_is_right_where_products_underflow",
    ),
    (
        "The same near the middle axis, down to 1e-190 of the spin",
        f"{EXTREMES}::TestFreeRotation::test_flips_late_beside_the_middle_axis_or_says_that_it_cannot_tell",
    ),
    (
        "A driven body agrees with a reference of 30 digits, with every method of order 4 and above",
        f"{VERIFICATION}/test_references.py::test_forced_body_to_twelve_digits",
    ),
    (
        "A free body in closed form agrees with a reference of 34 digits at every time",
        f"{VERIFICATION}/test_references.py::test_closed_form_is_exact_at_every_time",
    ),
    (
        "The references conserve energy and momentum, and their generator reproduces them",
        f"{VERIFICATION}/test_references.py::TestData::test_forced_states_are_made_again_by_their_generator",
    ),
    (
        "After 10 000 wrenches in each of two frames the attitude is accurate to 1e-11 rad",
        f"{VERIFICATION}/test_ten_thousand_wrenches.py::test_auto_is_where_the_reference_is",
    ),
    (
        "Every method is accurate after a hundred of them",
        f"{VERIFICATION}/test_ten_thousand_wrenches.py::test_every_method_is_there_after_a_hundred",
    ),
    (
        "Other equations, solved by other code, give the same motion in every wrench frame and across every edge",
        f"{VERIFICATION}/test_second_simulator.py::TestTextbookEquations::test_every_frame_and_edge",
    ),
    (
        "A body moves like the particles that it consists of",
        f"{VERIFICATION}/test_second_simulator.py::TestPointMasses::test_move_as_the_body_does",
    ),
    (
        "A flight recorded from another simulator is reproduced",
        f"{VERIFICATION}/test_second_simulator.py::TestRecordedFlight::test_is_flown_again",
    ),
    (
        "Masses and inertias from 1e-20 to 1e20: a change of the units of length and mass changes no bit",
        f"{EXTREMES}::TestUnits::test_of_length_and_mass_do_not_matter",
    ),
    (
        "Rates and wrenches from 1e-100 to 1e100 and beyond: nor does a change of the unit of time",
        f"{EXTREMES}::TestUnits::test_of_time_do_not_matter",
    ),
    (
        "A slow body arrives at 1e12 m within one unit in the last place",
        f"{EXTREMES}::TestFarAway::test_a_slow_body_at_1e12_m_arrives",
    ),
    (
        "A body at 1e12 m turns as it does at the origin, to the bit",
        f"{EXTREMES}::TestFarAway::test_a_tumbling_body_turns_there_as_it_does_here",
    ),
    (
        "A body at rest, or spinning about a principal axis, stays so to the bit",
        f"{EXTREMES}::TestRest::test_spin_on_a_principal_axis_stays_there_to_the_bit",
    ),
    (
        "Needles down to a ratio of 1e-12 are accurate, refused, or off by no more than the energy defect shows",
        f"{EXTREMES}::TestNeedle::test_is_never_wrong_in_silence_by_more_than_its_energy_says",
    ),
    (
        "Overflow in products gives a clear error",
        f"{EXTREMES}::TestProducts::test_an_energy_beyond_the_range_is_an_error",
    ),
    (
        "A spin that no step can resolve gives a clear error",
        f"{EXTREMES}::TestProducts::test_a_spin_that_no_step_resolves_is_an_error",
    ),
    (
        "1e20 N on 1e-20 kg give Newton's acceleration to 1e-13",
        f"{EXTREMES}::TestProducts::test_a_light_body_under_a_large_force_flies_as_newton_says",
    ),
    (
        "Inertia matrices at the limits of double precision give a valid body or are refused",
        f"{EXTREMES}::TestProducts::test_an_inertia_at_the_ends_of_the_range_is_a_body_or_is_refused",
    ),
    (
        "Wrenches that reverse in every step cancel",
        f"{EXTREMES}::TestWrenches::test_that_reverse_each_step_leave_nothing_behind",
    ),
    (
        "On a tumbling body the motion under such wrenches is accurate",
        f"{EXTREMES}::TestWrenches::test_that_reverse_each_step_on_a_tumbling_body_are_followed",
    ),
    (
        "Subnormal wrenches have almost no effect",
        f"{EXTREMES}::TestWrenches::test_that_are_hardly_there_do_hardly_anything",
    ),
    (
        "Steps of several turns are accurate, refused, or conserve the declared invariants",
        f"{EXTREMES}::TestSteps::test_of_several_turns_are_right_or_an_error",
    ),
    (
        "Whatever the input numbers, a run ends with a finite state or with the one error type allowed",
        f"{EXTREMES}::TestAnyNumbers::test_drawn_at_random",
    ),
]


# The page -------------------------------------------------------------------------------------------------------------


def measured_page(long: bool = False) -> tuple[str, dict[str, Figure]]:
    """Return the page and its figures by name; without `long`, keep the long drifts of the page and omit their figure.

    Raises:
        ValueError: The page has no long drifts to keep.
    """
    kept = "" if long else kept_drifts(PAGE.read_text(encoding="utf-8"))
    short = [(name, ENSEMBLE_STEPS, start) for name in keepers() for start in range(STARTS)]
    runs = [(name, LONG_STEPS, 0) for name in long_runners()] if long else []
    done = walks([*runs, *short])
    far, ensembles = done[: len(runs)], {}
    for one in done[len(runs) :]:
        ensembles.setdefault(one.method, []).append(one)
    found = exact_motions()
    wrench_table, wrench_run = wrench_rows()
    how = json.loads((motions.DATA / "ten_thousand_wrenches.json").read_text(encoding="utf-8"))["how"]
    text = PAGE_TEXT.format(
        machine=f"Python {platform.python_version()} on {platform.system()}, {platform.machine()}",
        orders=table(
            ["method", "declared", "attitude", "rate", "position", "velocity", "work", "impulse", "torque impulse"],
            order_rows(),
        ),
        invariants=table(
            ["method", "T", "drift", "grows as n to the", "L", "drift", "grows as n to the"], invariant_rows(ensembles)
        ),
        exactly=", ".join(named(name) for name in METHODS if name != "exact" and moves_exactly(name)) or "None",
        count=f"1e{round(math.log10(LONG_STEPS))}",
        long_drifts=kept or table(["method", "T", "L"], long_rows(far)),
        root=digit(EPS * math.sqrt(LONG_STEPS)),
        exact=table(["body", "motions", "attitude", "T", "L"], exact_rows(found)),
        underflows=table(["case", "moments", "spin, rad/s", "t, s", "attitude"], underflow_rows()),
        references=table(["method", "step, s", "attitude", "rate", "position", "velocity", "work"], reference_rows()),
        closed=table(["method, body", "t, s", "attitude", "rate", "position", "velocity"], closed_form_rows()),
        how=how,
        wrench_run=wrench_run,
        wrenches=table(
            ["t, s", "wrenches", "attitude, rad", "rate, rad/s", "position, m", "velocity, m/s", "work, J"],
            wrench_table,
        ),
        wrench_bounds=", ".join(digit(bound) for bound in wrenches.BOUNDS.values()),
        simulators=table(
            ["other simulator", "attitude, rad", "rate, rad/s", "position, m", "velocity, m/s"],
            second_simulator_rows(),
        ),
        turns=table(["method", "0.6 turns", "1.4", "3.3", "25"], several_turns_rows()),
        claims=table(["claim", "test"], [[claim.replace("|", "\\|"), f"`{path}`"] for claim, path in CLAIMS]).replace(
            "---:", "---"
        ),
    )
    figures = {"order": order_figure(), "exact": exact_figure(found)}
    return text, figures | ({"drift": drift_figure(far)} if long else {})


PAGE_TEXT = """# Verification

This page reports the accuracy of the package, measured with {machine}. Figures have one digit, because further
digits depend on the platform. `python tools/make_verification.py` writes the page and its plots for every method in
`METHODS`, with the same functions as the tests. The [last table](#the-test-for-each-claim) names the test that checks
each claim against its bound. ε is 2⁻⁵² = 2.2e-16, T the kinetic energy, and L the angular momentum in world axes.

## Order

The order of a method is the slope of log(error) against log(step). The table compares the declared order with the
measured one. The test case is a triaxial body with off-diagonal inertia and its centre of mass away from its origin,
under force and torque in body and in world axes for 2 s; the reference has 30 digits. The slope is fitted to the six
finest steps whose error is above round-off; "-" means that there are fewer than four. The tests accept a deviation of
0.2, above order 8 of 0.5 downwards. Work may converge faster.

{orders}
![Error of the attitude over the step, for every method](images/verification-order.svg)

*Grey: round-off. `exact` is missing because it has no step.*

## Invariants of free motion

The table shows the largest relative drift over 2000 steps of 0.02 s, for a body that tumbles at 2 rad/s near its middle
axis. "kept" means that the method declares the quantity an invariant: it is conserved to round-off at any step size.
Any other quantity drifts as the order of the method dictates; at a high order this may be less than round-off.

A conserved quantity picks up one rounding error per step. If the errors were random, the drift after n steps would grow
as n to the 0.5; if they all had the same sign, as n. The table gives the measured exponent, for the root mean square
over four motions, from 30 to 10 000 steps. With so few motions it is accurate to about 0.2. The attitude quaternion q
is normalised only if |q| differs from 1 by more than two bits: normalising it in every step would turn L steadily in
one direction, by some thousandths of ε per step.

{invariants}
In free motion, these methods take bit for bit the same steps as `exact`: {exactly}.

After {count} steps (`--long` measures this, in a quarter of an hour with numba); ε √n is {root}:

{long_drifts}
A drift that grows as n instead of √n is systematic: `midpoint` gains energy, `midpoint` and `dlm2` change |L|, and on
this motion the closed form turns L by a thousandth of ε per step, though not on others (`test_long_drift.py`). In the
closed form, T and |L| have no such drift.

![Drift of energy and angular momentum against the number of steps](images/verification-drift.svg)

## Exact motion

The closed form is compared with a computation in 80 digits, on random motions of each kind of body. The spins of 1e-12
to 1e6 rad/s have any direction, or lie on or near an axis or the separatrix; the times are 1e-3 to 1e9 s. The table
shows the largest error of the attitude in units of ε (1 + |ω| t), and of T and |L| in units of ε. The guaranteed bounds
are 100, 20 and 20.

{exact}
![Error of the attitude against the angle turned](images/verification-exact.svg)

The next table, in the same units, has cases in which a product in the formulas underflows or overflows, or in which two
moments are almost equal:

{underflows}
## References to 30 digits

The references were computed with Taylor series in mpmath, from other equations than those of the package
(`test/verification/make_reference.py`). The table shows the errors of the driven body after 1 s, in SI units. The step
h of a method of order p is chosen such that h^p = 1e-12, but is at least 1 ms:

{references}
Free bodies are compared with a reference of 34 digits. Over 1e6 s, merely rounding the initial angular velocity to
double precision changes the attitude by 1e-10 rad or more:

{closed}
## Ten thousand wrenches

One wrench in body axes and one in world axes, each with force and torque, change every 0.01 s for 100 s. With
`solver: {{method: auto, accuracy: 1e-11}}` the run takes {wrench_run}. The reference was computed as follows: {how}.

{wrenches}
The test's bounds, in the order of the columns: {wrench_bounds}.

## Other simulators

The package is compared with two simulators written for the tests and with a recording of a third. They share no code
with it: no rotations, no principal axes, no wrench rule. The table shows the largest difference over the run. In the
first row, that difference is the error of the other simulator's DOP853.

{simulators}
NASA's check cases include a brick that tumbles free of torque (case 2 of NASA/TM-2015-218675), as flown by four flight
simulators. `tools/compare_tumbling_brick.py FOLDER` runs the brick from the first sample of each of the four
histories and compares the two motions with `compare`. The histories are distributed with `nasa/simupy-flight`; they are
not in this repository.

| simulator | largest difference of the rate, °/s | relative to 37 °/s | attitude, rad | drift of the size of L |
| --- | ---: | ---: | ---: | ---: |
| 01 | 7e-11 | 2e-12 | 1e-6 | 1e-12 |
| 02 | 1e-3 | 4e-5 | 7e-2 | 3e-6 |
| 04 | 4e-10 | 1e-11 | 1e-6 | 2e-12 |
| 06 | 5e-3 | 1e-4 | 2e-4 | 8e-10 |

In simulators 01 and 04 the rate is correct to eleven digits, in 02 and 06 to four. Simulator 06 conserves the angular
momentum four thousand times better than 02, yet its rate is further off: conservation says little about accuracy. The
recorded angles refer to the local horizon, which turns with the Earth. The comparison removes that turn, but not the
eastward drift of the falling brick, which causes the 1e-6 rad of 01 and 04.

Basilisk flew a 6U satellite with the devices of `actuators`: wheels at 100 rad/s, with and without Coulomb and viscous
friction, a limit of their torque and imbalance (`JitterSimple`), a torque rod, a thruster; and with the gravity
gradient. `tools/compare_basilisk.py` flies each case twice with Basilisk's RK4, with a step and with half of it. The
difference between the two is about the error of the longer step. This package differs from the run with half the step
by less, except with the thruster: RK4 loses its order where a pulse begins or ends within a step. Here the edges of a
pulse fall on their exact nanosecond, and the impulse is exact ([test](../test/loads/test_actuators.py)). Limits of
speed are not compared, because they are another model there: at `Omega_max` Basilisk takes the motor's torque away, and
the body may drive the wheel beyond, where a motor here holds it with `max_torque` at most.

| flight | s | Basilisk step, s | difference, rad | at half the step, rad | between the two steps, rad | wheels, rad/s |
| --- | ---: | ---: | ---: | ---: | ---: | ---: |
| free wheels at 100 rad/s | 100 | 0.1 | 5e-09 | 3e-10 | 5e-09 | 5e-11 |
| wheels under 10 torques each | 100 | 0.1 | 3e-09 | 2e-10 | 3e-09 | 5e-11 |
| the same, with Coulomb and viscous friction | 100 | 0.01 | 3e-13 | 3e-14 | 3e-13 | 8e-13 |
| wheels under 10 torques, at most 5e-5 N m each | 100 | 0.1 | 4e-09 | 2e-10 | 4e-09 | 5e-11 |
| unbalanced wheels at 100 rad/s | 120 | 0.001 | 2e-09 | 1e-10 | 1e-09 | 4e-12 |
| a torque rod, 10 dipoles, uniform field | 100 | 0.1 | 9e-13 | 5e-14 | 9e-13 | - |
| 10 pulses of a thruster with a lever arm | 100 | 0.002 | 6e-04 | 4e-04 | 2e-04 | - |
| gravity gradient, 10 orbits | 56800 | 0.125 | 6e-10 | 4e-11 | 6e-10 | - |
| gravity gradient, wheels and rod, an orbit | 5680 | 0.02 | 1e-09 | 6e-11 | 1e-09 | 5e-12 |

## Extremes

At the extremes of the input range, a result is either within its bound, or a `ConvergenceError` or `BodyError` that
names the remedy. There is never a NaN, and never an exception raised by the arithmetic. The last table has the bounds.

The next table shows the error of the attitude, in rad, after ten steps of free motion of more than half a turn each.
The closed form and the methods built on it are as accurate as with small steps. The others refuse the step, or have the
large error of a step that does not resolve the motion.

{turns}
## The test for each claim

To run a test: `python -m pytest PATH`.

{claims}"""


def svg(name: str, figure: Figure) -> bytes:
    buffer = io.BytesIO()
    settings = {"svg.hashsalt": name, "svg.fonttype": "path"}
    with style.context(["default", settings]):
        figure.savefig(buffer, format="svg", facecolor="white", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def main(arguments: list[str]) -> None:
    if unknown := set(arguments) - {"--long"}:
        sys.exit(f"unknown argument {' '.join(sorted(unknown))}, expected nothing or --long")
    with style.context(["default", {"font.size": 9.0}]):
        long = "--long" in arguments
        text, figures = measured_page(long)
        for name, figure in figures.items():
            (IMAGES / f"verification-{name}.svg").write_bytes(svg(name, figure))
    PAGE.write_text(text, encoding="utf-8")
    print(f"{PAGE}: {len(METHODS)} methods, {len(CLAIMS)} claims")
    if not long:
        print(f"The drift over {LONG_STEPS:.0e} steps, table and figure, is unchanged; --long measures it")


if __name__ == "__main__":
    main(sys.argv[1:])
