"""MuJoCo: a free body without contact, collision and constraints, stepped by its own C loop (`mujoco.rollout`).

Body-frame wrenches are actuators on a site at the centre of mass, so that they turn with the body inside a step;
world-frame forces are `xfrc_applied`.
"""

from __future__ import annotations

import os
from collections.abc import Callable

import mujoco
import numpy as np
from mujoco import rollout

from peers.problem import Answer, Problem, Run, Way, steps

NAME = "MuJoCo"
PACKAGES = ("mujoco",)

# Number of steps whose states `rollout` writes before they are discarded.
CHUNK = 1000
_USER = mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_XFRC_APPLIED


def ways(problem: Problem) -> list[Way]:
    first = steps(problem, 0.1)
    return [
        Way("RK4", "steps", first, _prepare(problem, "RK4")),
        Way("implicitfast", "steps", first, _prepare(problem, "implicitfast")),
    ]


def _model(problem: Problem, integrator: str, step: float) -> mujoco.MjModel:
    i = problem.inertia
    x, y, z, w = problem.orientation_xyzw
    gears = "".join(
        f'<motor site="center" gear="{" ".join("1" if k == j else "0" for k in range(6))}"/>' for j in range(6)
    )
    flags = " ".join(f'{name}="disable"' for name in ("contact", "constraint", "limit", "equality", "frictionloss"))
    return mujoco.MjModel.from_xml_string(
        f"""
        <mujoco>
          <compiler autolimits="false"/>
          <option timestep="{step!r}" integrator="{integrator}" gravity="{" ".join(map(repr, problem.gravity))}">
            <flag {flags}/>
          </option>
          <worldbody>
            <body quat="{w!r} {x!r} {y!r} {z!r}">
              <freejoint/>
              <inertial pos="0 0 0" mass="{problem.mass!r}"
                fullinertia="{i[0, 0]!r} {i[1, 1]!r} {i[2, 2]!r} {i[0, 1]!r} {i[0, 2]!r} {i[1, 2]!r}"/>
              <site name="center"/>
            </body>
          </worldbody>
          <actuator>{gears}</actuator>
        </mujoco>""".replace("np.float64(", "").replace(")", "")
    )


def _prepare(problem: Problem, integrator: str) -> Callable[[float], Run]:
    def prepare(count: float) -> Run:
        n = int(count)
        model = _model(problem, integrator, problem.hold / n)
        threads = min(os.cpu_count() or 1, problem.bodies)
        data = [mujoco.MjData(model) for _ in range(threads)]
        full = mujoco.mjtState.mjSTATE_FULLPHYSICS
        begin = np.zeros(mujoco.mj_stateSize(model, full))
        mujoco.mj_getState(model, data[0], begin, full)
        starts = np.tile(begin, (problem.bodies, 1))
        # time, position, quaternion (w, x, y, z), velocity in world axes, angular velocity in body axes
        starts[:, 8:11] = problem.linear_velocity_world
        starts[:, 11:14] = problem.angular_velocities
        sequence = _wrenches(problem, model)
        total = problem.holds * n
        pool = rollout.Rollout(nthread=threads if threads > 1 else 0)
        written = np.empty((problem.bodies, min(CHUNK if problem.bodies == 1 else 50, total), starts.shape[1]))

        def solve() -> Callable[[], Answer]:
            now, done = starts, 0
            while done < total:
                chunk = min(written.shape[1], total - done)
                at = np.arange(done, done + chunk) // n
                states = written if chunk == written.shape[1] else None
                found, _ = pool.rollout(
                    model, data, now, sequence[at][None], control_spec=_USER, nstep=chunk, state=states
                )
                now, done = found[:, -1].copy(), done + chunk
            return lambda: Answer.of(now[:, [5, 6, 7, 4]], now[:, 11:14], now[:, 1:4])

        return solve

    return prepare


def _wrenches(problem: Problem, model: mujoco.MjModel) -> np.ndarray:
    """Return ctrl (force and torque in body axes) and xfrc_applied (of the world, which has none, and of the body)."""
    found = np.zeros((problem.holds, model.nu + 6 * model.nbody))
    found[:, 0:3], found[:, 3:6] = problem.force_body, problem.torque_body
    found[:, -6:-3] = problem.force_world
    return found
