"""Steps with reaction wheels are identical compiled and in plain Python: bits, lengths, refusals."""

from __future__ import annotations

from dataclasses import replace
from itertools import count

import pytest

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.body.state import State
from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.actuator import Actuator
from rb_dynamics.loads.central_gravity import CentralGravity
from rb_dynamics.loads.effect import Effect
from rb_dynamics.loads.magnetic_field import MagneticField
from rb_dynamics.loads.magnetorquer import Magnetorquer
from rb_dynamics.loads.reaction_wheel import ReactionWheel
from rb_dynamics.loads.thruster import Thruster
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.loads.wrench_channels import Channel
from rb_dynamics.motion import METHODS
from rb_dynamics.motion.arc import Stepper
from rb_dynamics.motion.stateful_kernel import StatefulSteps
from rb_dynamics.numerics import compilation
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.run.simulation import Simulation
from rb_dynamics.scene.model import Scene, Solver
from test.support import motions

needs_numba = pytest.mark.skipif(not compilation.available(), reason="nothing to compare with: numba is not installed")

BODY = RigidBody.from_matrix(2.0, ((1.0, 0.1, 0.0), (0.1, 1.5, 0.2), (0.0, 0.2, 2.0)), (0.1, -0.2, 0.05))
START = State(0, (2.0, 1.5, -1.3), (0.5, -0.5, 0.5, 0.5), (0.3, 0.8, -0.2), (0.5, -1.0, 2.0))
# One comes to rest and to its largest speed, one is commanded a speed, and one has neither friction nor limits.
WHEELS: tuple[Actuator, ...] = (
    ReactionWheel(name="a", axis=(1, 0, 0), inertia=0.01, max_torque=0.5, max_speed=12.0, coulomb=0.02, viscous=1e-3),
    ReactionWheel(
        name="b", axis=(0, 1, 1), inertia=0.02, max_torque=0.4, max_speed=30.0, command="speed", coulomb=0.01
    ),
    ReactionWheel(name="c", axis=(1, -1, 0), inertia=0.01, max_torque=1.0, speed=3.0),
)
JET = Thruster(name="jet", frame="body", force=0.5, rise=0.1, fall=0.2)
LAGGING = (Channel(lag=0.15),)
ROD = Magnetorquer(name="rod", axis=(0, 1, 1), max_dipole=5.0)
GRAVITY = CentralGravity(5.0, (0.2, -0.1, 0.3), gravity_gradient=True)
NEAR = MagneticField("dipole", moment_world=(3e4, -2e5, 1e5), center_world=(0.0, 1.0, 2.0))
EVEN = MagneticField("uniform", (0.02, -0.05, 0.01))


def told(monkeypatch: pytest.MonkeyPatch, when: str, scene: Scene, pieces: int = 1) -> tuple[object, ...]:
    """Return everything that a sink is told in a second of flight, and the error if there is one."""
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", when)
    sink, names = motions.Recorder(), [actuator.name for actuator in scene.actuators]
    run = Simulation(scene, [sink])
    run.start()
    run.post("wrench", Wrench((0.1, 0.2, 0.0), (0.0, 0.1, 0.3)), 400_000_000)
    for at, name, value in (
        (0, "a", -0.3),
        (1, "a", 0.5),
        (0, "b", 9.0),
        (2, "b", -4.0),
        (1, "c", 0.7),
        (1, "rod", 4.0),
        (1, "jet", 0.15),
    ):
        if name in names:
            run.actuate(f"{name}/command", value, at * 300_000_000 + 7)
    try:
        for part in range(pieces):
            run.advance(NANOSECONDS * (part + 1) // pieces)
        run.finish()
    except ConvergenceError as error:
        return str(error), run.time_ns, repr(run.sample)
    return repr(sink.events), sink.result, run.acceleration


@needs_numba
@pytest.mark.parametrize(
    "solver",
    [
        Solver("dop853", step=0.05),
        Solver("dop853", accuracy=1e-9),
        # Compiles seven kernels that differ in the tableau.
        pytest.param(Solver("dverk", accuracy=1e-7), marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize(
    ("effects", "actuators"),
    [
        ((GRAVITY, NEAR), (*WHEELS, ROD)),
        ((EVEN,), (*WHEELS[:2], ROD)),
        ((), WHEELS[2:]),
        # Without wheels, the kernels of effects take a dipole.
        ((NEAR,), (ROD,)),
        # Two sources have no numbers: plain Python.
        ((EVEN, NEAR), (*WHEELS, ROD)),
        ((GRAVITY,), (*WHEELS, JET)),
        ((), (*WHEELS, JET)),
    ],
)
@pytest.mark.parametrize("channels", [(Channel(),), LAGGING])
def test_a_run_has_the_bits_of_plain_python(
    monkeypatch: pytest.MonkeyPatch,
    effects: tuple[Effect, ...],
    actuators: tuple[Actuator, ...],
    solver: Solver,
    channels: tuple[Channel, ...],
) -> None:
    """With commands on the way, lags and ramps of a thruster, and outputs between steps."""
    scene = motions.scene(BODY, START, solver, 1.0, 7.0, channels=channels)
    scene = replace(scene, effects=effects, actuators=actuators)
    plain = told(monkeypatch, "never", scene)
    assert told(monkeypatch, "always", scene, pieces=3) == plain
    assert len(plain) == 3
    assert "wheel_speeds" in str(plain[0])


@needs_numba
def test_a_refused_step_has_the_error_of_plain_python(monkeypatch: pytest.MonkeyPatch) -> None:
    """The body starts where the dipole is; and a step that turns it too far is no rotation."""
    there = replace(NEAR, center_world=(2.0, 1.5, -1.3))
    body = RigidBody.from_matrix(2.0, ((1.0, 0.0, 0.0), (0.0, 1.5, 0.0), (0.0, 0.0, 2.0)))
    still = replace(START, linear_velocity_world=(0.0, 0.0, 0.0))
    infinite = replace(
        motions.scene(body, still, Solver("dop853", step=0.05), 1.0, 7.0),
        effects=(there,),
        actuators=(*WHEELS, ROD),
    )
    fast = replace(START, angular_velocity_body=(400.0, 0.0, 100.0))
    too_long = replace(motions.scene(BODY, fast, Solver("dop853", step=0.05), 1.0, 7.0), actuators=WHEELS)
    for scene, what in ((infinite, "its field is infinite"), (too_long, "turns too far")):
        plain = told(monkeypatch, "never", scene)
        assert told(monkeypatch, "always", scene) == plain
        assert what in str(plain[0])


@needs_numba
def test_kernels_take_the_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise the tests above would compare plain Python with itself."""
    taken, numbers = count(), StatefulSteps._after

    def counted(self: StatefulSteps, *arguments: object) -> object:
        found = numbers(self, *arguments)  # type: ignore[arg-type]
        assert found is not None
        next(taken)
        return found

    monkeypatch.setattr(StatefulSteps, "_after", counted)
    scene = motions.scene(BODY, START, Solver("dop853", accuracy=1e-9), 1.0, 7.0, channels=LAGGING)
    told(monkeypatch, "always", replace(scene, effects=(GRAVITY, NEAR), actuators=(*WHEELS, ROD, JET)))
    assert next(taken) > 10
    monkeypatch.setattr(Stepper, "_arguments", None)
    told(monkeypatch, "always", replace(scene, effects=(GRAVITY, NEAR), actuators=(*WHEELS, ROD, JET)))
    assert METHODS["dop853"].tableau is not None
