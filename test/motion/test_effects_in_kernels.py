"""Steps and strides under effects are identical compiled and in plain Python: bits, lengths, choices, refusals."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import pytest

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.body.state import State
from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.buoyancy import Buoyancy
from rb_dynamics.loads.central_gravity import CentralGravity
from rb_dynamics.loads.compiled_load import effect_numbers
from rb_dynamics.loads.drag import LinearDrag, QuadraticDrag
from rb_dynamics.loads.effect import Effect
from rb_dynamics.loads.effect_types import EFFECTS
from rb_dynamics.loads.gyrostat_rotor import Rotor
from rb_dynamics.loads.magnetic_field import MagneticField
from rb_dynamics.loads.scheduled_wrench import ScheduledWrench
from rb_dynamics.loads.uniform_gravity import UniformGravity
from rb_dynamics.loads.varying_load import LoadDependence
from rb_dynamics.loads.wrench import WORLD, Wrench
from rb_dynamics.motion import METHODS, adaptive_kernel, fixed_step_kernel
from rb_dynamics.motion.arc import Stepper
from rb_dynamics.numerics import compilation
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.run.simulation import Simulation
from rb_dynamics.scene import parse_scene
from rb_dynamics.scene.model import Scene, Solver
from test.support import motions

needs_numba = pytest.mark.skipif(not compilation.available(), reason="nothing to compare with: numba is not installed")

BODY = RigidBody.from_matrix(2.0, ((1.0, 0.1, 0.0), (0.1, 1.5, 0.2), (0.0, 0.2, 2.0)), (0.1, -0.2, 0.05))
START = State(0, (2.0, 1.5, -1.3), (0.5, -0.5, 0.5, 0.5), (0.3, 0.8, -0.2), (0.5, -1.0, 2.0))
FIELD: tuple[Effect, ...] = (
    CentralGravity(5.0, (0.2, -0.1, 0.3), gravity_gradient=True),
    UniformGravity((0.0, 0.1, -0.2)),
    Buoyancy(1e-3, 1000.0, (0.1, 0.2, -1.0), (0.0, 0.0, 0.3)),
    MagneticField("uniform", (1e-5, 0.0, 0.0)),
)
ANY: tuple[Effect, ...] = (
    QuadraticDrag((0.3, 0.3, 0.3), (0.1, 0.2, 0.3), (0.1, 0.0, -0.5)),
    *FIELD,
    CentralGravity(1.0),
    LinearDrag((0.1, 0.2, 0.3), (0.01, 0.0, 0.05)),
    Rotor((1.0, 2.0, -1.0), 0.05, ((0.1, 10.0), (0.35, -20.0), (0.6, 5.0))),
    ScheduledWrench(((0.2, Wrench((1.0, 0.0, 0.5), (0.1, 0.2, 0.3), WORLD)),)),
)
# The others take long to compile; test/run/test_propagation.py flies dop853 and auto under effects.
USUAL = ("rk4",)
NAMES = [
    pytest.param(name, marks=() if name in USUAL else pytest.mark.slow)
    for name, method in METHODS.items()
    if fixed_step_kernel.compiles(method, effects=True)
]


def scene(solver: Solver, effects: tuple[Effect, ...], output_rate: float = 7.0) -> Scene:
    return replace(motions.scene(BODY, START, solver, 1.0, output_rate), effects=effects)


def told(monkeypatch: pytest.MonkeyPatch, what: Scene, *, pieces: int = 1) -> list[tuple[object, ...]]:
    """Return everything that a sink is told, or the error, in plain Python and compiled."""
    found: list[tuple[object, ...]] = []
    for when in ("never", "always"):
        monkeypatch.setenv("RB_DYNAMICS_COMPILE", when)
        sink = motions.Recorder()
        run = Simulation(what, [sink])
        run.start()
        run.post("wrench", Wrench((0.1, 0.2, 0.0), (0.0, 0.1, 0.3)), 400_000_000)
        try:
            for part in range(pieces if when == "always" else 1):
                run.advance(NANOSECONDS * (part + 1) // pieces if when == "always" else NANOSECONDS)
            run.finish()
            found.append((repr(sink.events), sink.result, run.acceleration))
        except ConvergenceError as error:
            found.append((type(error), str(error), run.time_ns, repr(run.sample)))
    return found


@needs_numba
@pytest.mark.parametrize("name", NAMES)
def test_a_run_has_the_bits_of_plain_python(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """With outputs between steps, a command on the way, and knots of a rotor."""
    effects = ANY if METHODS[name].takes >= LoadDependence.ANY else FIELD
    accuracy = {1: 0.3, 2: 1e-4}.get(METHODS[name].order or 0, 1e-6)
    for solver in (Solver(name, step=0.003), Solver(name, accuracy=accuracy)):
        plain, compiled = told(monkeypatch, scene(solver, effects), pieces=3)

        assert plain == compiled
        assert isinstance(plain[0], str), plain


@needs_numba
@pytest.mark.parametrize(
    "effects", [*((effect,) for effect in ANY), ANY, FIELD], ids=lambda found: "+".join(each.kind for each in found)
)
def test_so_has_a_run_under_each_effect(monkeypatch: pytest.MonkeyPatch, effects: tuple[Effect, ...]) -> None:
    for solver in (Solver("rk4", step=0.01), Solver("dop853", accuracy=1e-9)):
        plain, compiled = told(monkeypatch, scene(solver, effects))

        assert plain == compiled


GRADUAL = """
body:
  mass: 10
  inertia: {matrix: [[0.2, 0.01, 0], [0.01, 0.3, 0.02], [0, 0.02, 0.25]]}
  frames: {jet: {position: [0.1, 0.2, 0.05], orientation: {x: 0, y: 0, z: 0.6, w: 0.8}}}
initial: {angular_velocity_body: [0.1, -0.2, 0.3]}
wrenches: [{topic: wrench, lag: 0.2}, {topic: other, lag: 0.01}]
actuators:
  - {type: thruster, name: jet, frame: jet, force: 0.5, rise: 0.3, fall: 0.2}
duration: 1.5
output_rate: 7
"""


@needs_numba
@pytest.mark.parametrize("effects", ["", "effects: [{type: linear_drag, translation: 0.3, rotation: 0.05}]"])
@pytest.mark.parametrize(
    "solver",
    ["rk4, step: 0.011", "rk4, accuracy: 1.0e-7", pytest.param("dop853, accuracy: 1.0e-9", marks=pytest.mark.slow)],
)
def test_so_has_a_run_with_lags_and_ramps(monkeypatch: pytest.MonkeyPatch, solver: str, effects: str) -> None:
    scene, found = parse_scene(f"{GRADUAL}{effects}\nsolver: {{method: {solver}}}\n"), []
    begun, steps, in_plain_python = Stepper._arguments, [], 0
    monkeypatch.setattr(Stepper, "_arguments", lambda *of: steps.append(of) or begun(*of))
    for when in ("never", "always"):
        in_plain_python = len(steps)
        monkeypatch.setenv("RB_DYNAMICS_COMPILE", when)
        with fixed_step_kernel.counted_by(fixed_step_kernel.Tally()):
            run = Simulation(scene, [sink := motions.Recorder()])
            run.start()
            run.post("wrench", Wrench((1.0, 0.0, 0.0), (0.0, 0.05, 0.0), "world"), 300_000_000)
            run.post("other", Wrench((0.0, 0.5, 0.0), (0.02, 0.0, 0.0), "jet"), 400_000_001)
            run.actuate("jet/command", 1.0, 200_000_000)
            run.actuate("jet/command", 0.0, 900_000_000)
            for part in range(1, 4 if when == "always" else 2):
                run.advance(part * NANOSECONDS // 2 if when == "always" else 2 * NANOSECONDS)
            run.finish()
        found.append((repr(sink.events), sink.result, run.acceleration))
    assert found[0] == found[1]
    # Each step that is not compiled begins with this.
    assert len(steps) == in_plain_python > 20


@needs_numba
@pytest.mark.parametrize("name", ["rk4", "dop853"])
def test_the_kernels_are_used(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "always")
    for solver, wanted in (
        (Solver(name, step=0.01), fixed_step_kernel.kernel(METHODS[name], effects=True)),
        (Solver(name, accuracy=1e-6), adaptive_kernel.strides_of(METHODS[name], effects=True)),
    ):
        with fixed_step_kernel.counted_by(tally := fixed_step_kernel.Tally()):
            run = Simulation(scene(solver, ANY))
            run.advance(NANOSECONDS)

        assert wanted in tally.used


@needs_numba
@pytest.mark.parametrize(
    ("solver", "place", "speed", "pull"),
    [
        (Solver("rk4", step=0.125), -0.25, 1.0, 1e-300),
        (Solver("rk4", accuracy=1e-6), 0.3, 0.0, 5.0),
        (Solver("dop853"), 0.3, 0.0, 5.0),
    ],
)
def test_a_fall_into_the_centre_is_refused_in_the_same_words(
    monkeypatch: pytest.MonkeyPatch, solver: Solver, place: float, speed: float, pull: float
) -> None:
    body = RigidBody.from_diagonal(1.0, (1.0, 1.0, 1.0))
    fall = State(0, (place, 0.0, 0.0), linear_velocity_world=(speed, 0.0, 0.0))
    what = replace(motions.scene(body, fall, solver, 1.0, 8.0), effects=(CentralGravity(pull),))

    plain, compiled = told(monkeypatch, what)

    assert plain == compiled
    assert plain[0] is ConvergenceError


def test_every_effect_of_the_package_has_numbers() -> None:
    assert {type(effect) for effect in ANY} == set(EFFECTS.own.values())
    numbers = effect_numbers(ANY, BODY, 0.4)

    assert numbers is not None
    assert numbers[-1] == 6.0
    assert all(map(math.isfinite, numbers))


@dataclass(frozen=True)
class Other(LinearDrag):
    """Acts otherwise than what it is derived from."""


def test_what_is_not_of_the_package_has_none() -> None:
    assert effect_numbers((*ANY, Other((1.0, 1.0, 1.0))), BODY, 0.0) is None
