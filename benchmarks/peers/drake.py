"""Drake: one free body in a `MultibodyPlant`, by its embedded Runge-Kutta pairs of order 3 (the default) and 5."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RotationalInertia, SpatialInertia
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig

from peers.problem import Answer, Problem, Run, Way

NAME = "Drake"
PACKAGES = ("drake",)

SCHEMES = {"RK3": "runge_kutta3", "RK5": "runge_kutta5"}


def ways(problem: Problem) -> list[Way]:
    # Its plant accepts wrenches in world axes only; one that turns with the body would need a system in Python.
    if problem.force_body.any() or problem.torque_body.any():
        return []
    return [Way(name, "tolerance", 1e-4, _prepare(problem, scheme)) for name, scheme in SCHEMES.items()]


def _prepare(problem: Problem, scheme: str) -> Callable[[float], Run]:
    def prepare(tolerance: float) -> Run:
        plant = MultibodyPlant(time_step=0.0)
        i = problem.inertia
        inertia = RotationalInertia(i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2])
        spatial = SpatialInertia.MakeFromCentralInertia(problem.mass, [0.0, 0.0, 0.0], inertia)
        body = plant.AddRigidBody("body", spatial)
        plant.mutable_gravity_field().set_gravity_vector(problem.gravity)
        plant.Finalize()
        simulator = Simulator(plant)
        config = SimulatorConfig(
            integration_scheme=scheme, accuracy=tolerance, max_step_size=1.0 / problem.rate, use_error_control=True
        )
        ApplySimulatorConfig(config, simulator)
        context = simulator.get_mutable_context()

        def solve() -> Callable[[], Answer]:
            context.SetTime(0.0)
            _place(problem, plant, context, body)
            simulator.Initialize()
            simulator.AdvanceTo(problem.duration)
            return lambda: _answer(plant, context, body)

        return solve

    return prepare


def _place(problem: Problem, plant: Any, context: Any, body: Any) -> None:
    x, y, z, w = problem.orientation_xyzw
    n = np.sqrt(x * x + y * y + z * z + w * w)
    pose = RigidTransform(Quaternion(w / n, x / n, y / n, z / n), [0.0, 0.0, 0.0])
    plant.SetFreeBodyPose(context, body, pose)
    spin = pose.rotation().matrix() @ problem.angular_velocities[0]
    plant.SetFreeBodySpatialVelocity(context, body, SpatialVelocity(spin, problem.linear_velocity_world))


def _answer(plant: Any, context: Any, body: Any) -> Answer:
    pose = plant.EvalBodyPoseInWorld(context, body)
    q = pose.rotation().ToQuaternion()
    spin = plant.EvalBodySpatialVelocityInWorld(context, body).rotational()
    return Answer.of([q.x(), q.y(), q.z(), q.w()], pose.rotation().matrix().T @ spin, pose.translation())
