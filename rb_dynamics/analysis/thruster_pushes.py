"""What thrusters did to the body, by the commands that a bag has."""

from __future__ import annotations

import numpy as np

from rb_dynamics.analysis.track import Array, Times
from rb_dynamics.loads.actuator_bank import ActuatorBank
from rb_dynamics.loads.thruster import Thruster
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.scene.model import Scene

# A ramp counts as steps of its mean force, which keep its impulse.
_STEPS = 10


def pushes(thruster: Thruster, scene: Scene, time_ns: Times, values: Array) -> tuple[Times, Array]:
    """Return when the wrench of a thruster changes (ns), ascending, and rows of force and torque, body axes.

    Commands act as in a run: after their delay, in place of the one before; those that are invalid do not. Torques are
    about the centre of mass of the scene.
    """
    bank = ActuatorBank([thruster], scene.body, scene.frames, scene.combined_effects.magnetic_field)
    for at, value in zip(time_ns.tolist(), values.tolist(), strict=True):
        bank.post(thruster.topic, value, at)
    found: list[tuple[int, HeldWrench]] = []
    while (now := bank.next_change_ns()) is not None:
        # What comes now ends a ramp.
        found = [each for each in found if each[0] < now]
        bank.apply(now)
        ramps = bank.transients()
        steps = _STEPS if ramps else 1
        for k in range(steps):
            held = bank.held()
            for ramp in ramps:
                held = held + ramp.aged(ramp.length * (k + 0.5) / steps)
            begin = now + round(1e9 * ramps[0].length * k / steps) if ramps else now
            found.append((begin, held))
    rows = [(*held.force_body, *held.torque_body) for _, held in found]
    return np.array([at for at, _ in found], dtype=np.int64), np.array(rows, dtype=np.float64).reshape(-1, 6)
