"""Basilisk: a spacecraft with an external force and torque, with fixed-step RK4 or adaptive RKF78, without recorders.

Basilisk switches its attitude parameters (MRP) only between steps of the simulation, so a step must not turn the body
by more than about a radian; RKF78 subdivides it to meet its tolerance.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from Basilisk.architecture import bskLogging
from Basilisk.simulation import GravityGradientEffector, extForceTorque, spacecraft, svIntegrators
from Basilisk.utilities import SimulationBaseClass, simIncludeGravBody

from peers.problem import Answer, Problem, Run, Way, steps

NAME = "Basilisk"
PACKAGES = ("bsk",)
ORBITS = True

# Initialising a simulation again, the way to start over, warns of each state.
bskLogging.setDefaultLogLevel(bskLogging.BSK_ERROR)


def ways(problem: Problem) -> list[Way]:
    # It has no ensembles, no linear drag, no rotor at a constant rate, and uniform gravity only as a commanded force.
    if problem.bodies > 1 or (problem.orbit and any((*problem.orbit.rotor, *problem.orbit.drag))):
        return []
    return [
        Way("RKF78", "tolerance", 1e-6, _prepare(problem, adaptive=True)),
        Way("RK4", "steps", steps(problem, 0.1), _prepare(problem, adaptive=False)),
    ]


def _prepare(problem: Problem, *, adaptive: bool) -> Callable[[float], Run]:
    def prepare(setting: float) -> Run:
        step_ns = _step_ns(problem, steps(problem, 1.0) if adaptive else int(setting))
        simulation = SimulationBaseClass.SimBaseClass()
        simulation.SetProgressBar(False)
        simulation.CreateNewProcess("process").addTask(simulation.CreateNewTask("task", step_ns))
        craft, thrust = _spacecraft(problem)
        simulation.AddModelToTask("task", craft)
        simulation.AddModelToTask("task", thrust)
        if problem.orbit:
            simulation.AddModelToTask("task", _in_orbit(craft, problem.orbit.gravitational_parameter))
        integrator = (svIntegrators.svIntegratorRKF78 if adaptive else svIntegrators.svIntegratorRK4)(craft)
        if adaptive:
            integrator.relTol = integrator.absTol = max(setting, 1e-15)
        craft.setIntegrator(integrator)
        wrenches = list(
            zip(
                problem.force_body.tolist(),
                problem.torque_body.tolist(),
                (problem.force_world + problem.mass * np.array(problem.gravity)).tolist(),
                strict=True,
            )
        )
        ends = [round((k + 1) * problem.hold * 1e9) for k in range(problem.holds)]

        def solve() -> Callable[[], Answer]:
            thrust.extForce_B, thrust.extTorquePntB_B, thrust.extForce_N = wrenches[0]
            simulation.InitializeSimulation()
            for wrench, end in zip(wrenches, ends, strict=True):
                thrust.extForce_B, thrust.extTorquePntB_B, thrust.extForce_N = wrench
                simulation.ConfigureStopTime(end)
                simulation.ExecuteSimulation()
            states = craft.dynManager
            sigma, omega, place = (
                np.ravel(states.getStateObject(name).getState()) for name in ("hubSigma", "hubOmega", "hubPosition")
            )
            return lambda: Answer.of(_quaternion(sigma), omega, place)

        return solve

    return prepare


def _step_ns(problem: Problem, least: int) -> int:
    """Return a step in whole nanoseconds, as Basilisk counts them, that divides a hold at least `least` times."""
    hold = round(problem.hold * 1e9)
    return hold // next(n for n in range(least, hold + 1) if hold % n == 0)


def _spacecraft(problem: Problem) -> tuple[Any, Any]:
    craft = spacecraft.Spacecraft()
    craft.hub.mHub = problem.mass
    craft.hub.r_BcB_B = [[0.0], [0.0], [0.0]]
    craft.hub.IHubPntBc_B = problem.inertia.tolist()
    craft.hub.r_CN_NInit = [[c] for c in problem.position_world]
    craft.hub.v_CN_NInit = [[c] for c in problem.linear_velocity_world]
    x, y, z, w = problem.orientation_xyzw
    craft.hub.sigma_BNInit = [[c / (1.0 + w)] for c in (x, y, z)]
    craft.hub.omega_BN_BInit = [[c] for c in problem.angular_velocities[0].tolist()]
    thrust = extForceTorque.ExtForceTorque()
    craft.addDynamicEffector(thrust)
    return craft, thrust


def _in_orbit(craft: Any, gravitational_parameter: float) -> Any:
    """Put a craft into the field of a central body; return its gravity gradient."""
    bodies = simIncludeGravBody.gravBodyFactory()
    earth = bodies.createEarth()
    earth.mu, earth.isCentralBody = gravitational_parameter, True
    bodies.addBodiesTo(craft)
    gradient = GravityGradientEffector.GravityGradientEffector()
    gradient.addPlanetName(earth.planetName)
    craft.addDynamicEffector(gradient)
    return gradient


def _quaternion(sigma: np.ndarray) -> np.ndarray:
    """Return (x, y, z, w), body to world, of modified Rodrigues parameters."""
    square = float(sigma @ sigma)
    return np.append(2.0 * sigma, 1.0 - square) / (1.0 + square)
