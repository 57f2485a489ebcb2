"""Compare the motion of a satellite with Basilisk's and print the table of docs/verification.md.

    python tools/compare_basilisk.py     # needs bsk, which `make bench` installs

The satellite has wheels, torque rods, a thruster and the gravity gradient. Basilisk takes fixed steps of RK4, and the
edges of a pulse fall inside them. Each case is flown twice, with a step and with half of it: the difference is about
Basilisk's own error, and no comparison with it can be closer.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import rb_dynamics as rb

MU, RADIUS = 3.986004418e14, 6.878e6
ORBIT = 5680.0  # s, 3 s more than one takes: Basilisk counts whole nanoseconds
FIELD = (2.0e-5, 0.5e-5, -4.0e-5)
MOMENTS, WHEEL, DIPOLE = (0.05, 0.12, 0.14), 1.0e-4, 0.2
COULOMB, VISCOUS, LARGEST = 1.0e-5, 1.0e-7, 5.0e-5
THRUST, PLACE = 0.005, (0.1, 0.15, 0.05)
STATIC, DYNAMIC, WHEEL_PLACE = 1e-6, 1e-7, (0.05, -0.1, 0.15)
PHASES = (0.5 * math.pi, math.pi, 0.5 * math.pi)
SPIN, SPEED = (0.02, -0.03, 0.01), 100.0

Array = NDArray[np.float64]


class Command(NamedTuple):
    """Commands to all actuators: torques of the wheels (N m), dipole (A m^2) and on-time of the thruster (s)."""

    torques: tuple[float, ...]
    dipole: float
    on_time: float


class Case(NamedTuple):
    """A flight: what is on board, its length (s), Basilisk's coarser step (s), and how many commands it has."""

    name: str
    duration: float
    step: float
    wheels: bool = False
    friction: bool = False
    imbalance: bool = False
    limited: bool = False
    gradient: bool = False
    rod: bool = False
    thruster: bool = False
    commands: int = 1

    def command(self, number: int) -> Command:
        """Return a command: the longer the flight the weaker, so that the body turns as fast in all of them."""
        weaker = 100.0 / self.duration
        torques = tuple(1.0e-4 * weaker * math.sin(1.0 + number + 2.0 * k) for k in range(3))
        return Command(torques, weaker * DIPOLE * math.cos(number), 0.25 + 0.5 * (number % 2))


CASES = (
    Case("free wheels at 100 rad/s", 100.0, 0.1, wheels=True, commands=0),
    Case("wheels under 10 torques each", 100.0, 0.1, wheels=True, commands=10),
    Case("the same, with Coulomb and viscous friction", 100.0, 0.01, wheels=True, friction=True, commands=10),
    Case("wheels under 10 torques, at most 5e-5 N m each", 100.0, 0.1, wheels=True, limited=True, commands=10),
    Case("unbalanced wheels at 100 rad/s", 120.0, 0.001, wheels=True, imbalance=True, commands=10),
    Case("a torque rod, 10 dipoles, uniform field", 100.0, 0.1, rod=True, commands=10),
    Case("10 pulses of a thruster with a lever arm", 100.0, 0.002, thruster=True, commands=10),
    Case("gravity gradient, 10 orbits", 10.0 * ORBIT, 0.125, gradient=True, commands=0),
    Case("gravity gradient, wheels and rod, an orbit", ORBIT, 0.02, wheels=True, gradient=True, rod=True, commands=20),
)


class End(NamedTuple):
    """The end of a flight: attitude (x, y, z, w, body to world) and speeds of the wheels (rad/s)."""

    attitude: Array
    speeds: Array


def ours(case: Case) -> End:
    """Return the end by this package: to 1e-12 rad, or to 1e-9 over orbits, where rounding adds some 4e-10.

    Imbalances take so many steps that their rounding adds some 1e-12.
    """
    accuracy = 1e-9 if case.gradient else 1e-10 if case.imbalance else 1e-12
    body = f"body: {{mass: 10, inertia: {{diagonal: {list(MOMENTS)}}}"
    if case.thruster:
        body += f", frames: {{jet: {{position: {list(PLACE)}, orientation: {{x: 0, y: 0, z: 0, w: 1}}}}}}"
    start = f"initial: {{angular_velocity_body: {list(SPIN)}"
    if case.gradient:
        start += f", position_world: [{RADIUS!r}, 0, 0], linear_velocity_world: [0, {math.sqrt(MU / RADIUS)!r}, 0]"
    lines = [body + "}", start + "}", "wrenches: []", f"solver: {{accuracy: {accuracy!r}}}"]
    lines += [f"duration: {case.duration!r}", "effects:"]
    if case.gradient:
        lines.append(f"  - {{type: central_gravity, gravitational_parameter: {MU!r}, gravity_gradient: true}}")
    if case.rod:
        lines.append(f"  - {{type: magnetic_field, model: uniform, field_world: {list(FIELD)}}}")
    actuators = []
    if case.wheels:
        actuators += [_wheel(case, k) for k in range(3)]
    if case.rod:
        actuators.append(f"  - {{type: magnetorquer, name: rod, axis: [0, 0, 1], max_dipole: {DIPOLE}}}")
    if case.thruster:
        actuators.append(f"  - {{type: thruster, name: jet, frame: jet, force: {THRUST}, command: on_time}}")
    text = "\n".join(line for line in lines if line != "effects:" or case.gradient or case.rod)
    text += "\nactuators:\n" + "\n".join(actuators) if actuators else ""
    commands = []
    for number in range(case.commands):
        torques, dipole, on_time = case.command(number)
        stamp = round(number * case.duration / case.commands * 1e9)
        if case.wheels:
            commands += [(f"wheel_{k}/command", rb.Setpoint(torque, stamp)) for k, torque in enumerate(torques)]
        if case.rod:
            commands.append(("rod/command", rb.Setpoint(dipole, stamp)))
        if case.thruster:
            commands.append(("jet/command", rb.Setpoint(on_time, stamp)))
    sample = rb.simulate(rb.parse_scene(text), commands).sample
    return End(np.array(sample.orientation_xyzw), np.array(sample.wheel_speeds or ()))


def _wheel(case: Case, k: int) -> str:
    """Return the line of a wheel; Basilisk's angle 0 of an imbalance is at z, -z and y."""
    given = f"name: wheel_{k}, axis: {[float(k == i) for i in range(3)]}, inertia: {WHEEL!r}, speed: {SPEED!r}"
    if case.friction:
        given += f", friction: {{coulomb: {COULOMB!r}, viscous: {VISCOUS!r}}}"
    if case.limited:
        given += f", max_torque: {LARGEST!r}"
    if case.imbalance:
        given += f", imbalance: {{static: {STATIC!r}, dynamic: {DYNAMIC!r}, phase: {PHASES[k]!r}}}"
        given += f", position: {list(WHEEL_PLACE)}"
    return f"  - {{type: reaction_wheel, command: torque, {given}}}"


def basilisk(case: Case, step: float) -> End:
    """Return the end by Basilisk with steps of about `step` s, which divide the time between commands and pulses."""
    from Basilisk.architecture import messaging
    from Basilisk.simulation import spacecraft, svIntegrators
    from Basilisk.utilities import SimulationBaseClass

    grain = case.duration / max(case.commands, 1)
    step_ns = round(grain / math.ceil(grain / step) * 1e9)
    simulation = SimulationBaseClass.SimBaseClass()
    simulation.SetProgressBar(False)
    simulation.CreateNewProcess("process").addTask(simulation.CreateNewTask("task", step_ns))
    craft = spacecraft.Spacecraft()
    craft.hub.mHub, craft.hub.r_BcB_B = 10.0, [[0.0], [0.0], [0.0]]
    craft.hub.IHubPntBc_B = np.diag(MOMENTS).tolist()
    craft.hub.r_CN_NInit = [[RADIUS if case.gradient else 0.0], [0.0], [0.0]]
    craft.hub.v_CN_NInit = [[0.0], [math.sqrt(MU / RADIUS) if case.gradient else 0.0], [0.0]]
    craft.hub.sigma_BNInit, craft.hub.omega_BN_BInit = [[0.0], [0.0], [0.0]], [[c] for c in SPIN]
    craft.setIntegrator(svIntegrators.svIntegratorRK4(craft))
    kept: list[Any] = [craft]
    listeners: list[Callable[[Command], None]] = []
    if case.wheels:
        listeners.append(_wheels(simulation, craft, kept, case))
    if case.rod:
        listeners.append(_rod(simulation, craft, kept))
    if case.thruster:
        listeners.append(_thruster(simulation, craft, kept))
    if case.gradient:
        _gradient(simulation, craft, kept)
    simulation.AddModelToTask("task", craft, 1)
    wheel_speeds = None
    if case.wheels:
        wheel_speeds = messaging.RWSpeedMsgReader()
        wheel_speeds.subscribeTo(kept[1].rwSpeedOutMsg)
    simulation.InitializeSimulation()
    for number in range(max(case.commands, 1)):
        if case.commands:
            for tell in listeners:
                tell(case.command(number))
        simulation.ConfigureStopTime(step_ns * round((number + 1) * grain * 1e9 / step_ns))
        simulation.ExecuteSimulation()
    sigma = np.ravel(craft.dynManager.getStateObject("hubSigma").getState())
    square = float(sigma @ sigma)
    attitude = np.append(2.0 * sigma, 1.0 - square) / (1.0 + square)
    speeds = np.array(wheel_speeds().wheelSpeeds[:3]) if wheel_speeds is not None else np.array([])
    return End(attitude, speeds)


def _wheels(simulation: Any, craft: Any, kept: list[Any], case: Case) -> Callable[[Command], None]:
    from Basilisk.architecture import messaging
    from Basilisk.simulation import reactionWheelStateEffector
    from Basilisk.utilities import simIncludeRW

    factory = simIncludeRW.rwFactory()
    # So steep that its tanh is 1 at all speeds here.
    wear: dict[str, Any] = (
        {"fCoulomb": COULOMB, "fStatic": COULOMB, "cViscous": VISCOUS, "betaStatic": 1e-3} if case.friction else {}
    )
    if case.imbalance:
        wear |= {"RWModel": messaging.JitterSimple, "rWB_B": list(WHEEL_PLACE)}
    for k in range(3):
        axis = [float(k == i) for i in range(3)]
        rpm = SPEED * 30.0 / math.pi
        largest = LARGEST if case.limited else 1.0
        settings = {"Js": WHEEL, "Omega": rpm, "Omega_max": 1e5, "u_max": largest, "useRWfriction": case.friction}
        wheel = factory.create("custom", axis, **settings, **wear)
        if case.imbalance:
            wheel.U_s, wheel.U_d = STATIC, DYNAMIC
    effector = reactionWheelStateEffector.ReactionWheelStateEffector()
    factory.addToSpacecraft("wheels", effector, craft)
    message = messaging.ArrayMotorTorqueMsg().write(messaging.ArrayMotorTorqueMsgPayload())
    effector.rwMotorCmdInMsg.subscribeTo(message)
    simulation.AddModelToTask("task", effector, 2)
    kept += [effector, factory, message]

    def tell(command: Command) -> None:
        payload = messaging.ArrayMotorTorqueMsgPayload()
        payload.motorTorque = [*command.torques, *[0.0] * 33]
        message.write(payload, simulation.TotalSim.CurrentNanos)

    return tell


def _rod(simulation: Any, craft: Any, kept: list[Any]) -> Callable[[Command], None]:
    from Basilisk.architecture import messaging
    from Basilisk.simulation import MtbEffector

    effector = MtbEffector.MtbEffector()
    settings = messaging.MTBArrayConfigMsgPayload()
    settings.numMTB, settings.GtMatrix_B, settings.maxMtbDipoles = 1, [0.0, 0.0, 1.0], [DIPOLE]
    field = messaging.MagneticFieldMsgPayload()
    field.magField_N = list(FIELD)
    parameters = messaging.MTBArrayConfigMsg().write(settings)
    fields = messaging.MagneticFieldMsg().write(field)
    message = messaging.MTBCmdMsg().write(messaging.MTBCmdMsgPayload())
    effector.mtbParamsInMsg.subscribeTo(parameters)
    effector.magInMsg.subscribeTo(fields)
    effector.mtbCmdInMsg.subscribeTo(message)
    craft.addDynamicEffector(effector)
    simulation.AddModelToTask("task", effector, 2)
    kept += [effector, parameters, fields, message]

    def tell(command: Command) -> None:
        payload = messaging.MTBCmdMsgPayload()
        payload.mtbDipoleCmds = [command.dipole]
        message.write(payload, simulation.TotalSim.CurrentNanos)

    return tell


def _thruster(simulation: Any, craft: Any, kept: list[Any]) -> Callable[[Command], None]:
    from Basilisk.architecture import messaging
    from Basilisk.simulation import thrusterDynamicEffector

    effector = thrusterDynamicEffector.ThrusterDynamicEffector()
    thruster = thrusterDynamicEffector.THRSimConfig()
    thruster.thrLoc_B, thruster.thrDir_B = [[c] for c in PLACE], [[1.0], [0.0], [0.0]]
    thruster.MaxThrust, thruster.steadyIsp, thruster.MinOnTime = THRUST, 1e9, 1e-9
    effector.addThruster(thruster)
    message = messaging.THRArrayOnTimeCmdMsg().write(messaging.THRArrayOnTimeCmdMsgPayload())
    effector.cmdsInMsg.subscribeTo(message)
    craft.addDynamicEffector(effector)
    simulation.AddModelToTask("task", effector, 2)
    kept += [effector, thruster, message]

    def tell(command: Command) -> None:
        payload = messaging.THRArrayOnTimeCmdMsgPayload()
        payload.OnTimeRequest = [command.on_time]
        message.write(payload, simulation.TotalSim.CurrentNanos)

    return tell


def _gradient(simulation: Any, craft: Any, kept: list[Any]) -> None:
    from Basilisk.simulation import GravityGradientEffector
    from Basilisk.utilities import simIncludeGravBody

    bodies = simIncludeGravBody.gravBodyFactory()
    earth = bodies.createEarth()
    earth.mu, earth.isCentralBody = MU, True
    bodies.addBodiesTo(craft)
    effector = GravityGradientEffector.GravityGradientEffector()
    effector.addPlanetName(earth.planetName)
    craft.addDynamicEffector(effector)
    simulation.AddModelToTask("task", effector, 2)
    kept += [bodies, effector]


def turned(one: End, other: End) -> float:
    """Return the angle between two attitudes, rad."""
    sign = 1.0 if one.attitude @ other.attitude >= 0.0 else -1.0
    return 4.0 * math.asin(min(1.0, float(np.linalg.norm(one.attitude - sign * other.attitude)) / 2.0))


def rows(cases: Iterable[Case]) -> Iterable[str]:
    """Return the lines of the table."""
    differences = "difference, rad", "at half the step, rad", "between the two steps, rad", "wheels, rad/s"
    titles = ("flight", "s", "Basilisk step, s", *differences)
    yield f"| {' | '.join(titles)} |"
    yield "| --- | ---: | ---: | ---: | ---: | ---: | ---: |"
    for case in cases:
        mine, coarse, fine = ours(case), basilisk(case, case.step), basilisk(case, 0.5 * case.step)
        differ = [turned(*pair) for pair in ((mine, coarse), (mine, fine), (coarse, fine))]
        speeds = f"{np.abs(mine.speeds - fine.speeds).max():.0e}" if case.wheels else "-"
        columns = [case.name, f"{case.duration:.0f}", f"{case.step:g}", *(f"{angle:.0e}" for angle in differ), speeds]
        yield f"| {' | '.join(columns)} |"


def main() -> int:
    try:
        from Basilisk.architecture import bskLogging
    except ImportError:
        print("Basilisk is not installed; `make bench` installs it", file=sys.stderr)
        return 2
    bskLogging.setDefaultLogLevel(bskLogging.BSK_ERROR)
    for row in rows(CASES):
        print(row, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
