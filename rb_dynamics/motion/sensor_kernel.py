"""The kernel that reads a sensor on many bodies; here, above `sensors/`, for the list of all kernels."""

from __future__ import annotations

from rb_dynamics.motion.fixed_step_kernel import OnDemand
from rb_dynamics.sensors.many_readings import read_all

READ_ALL = OnDemand(
    "rk4", read_all, "void(int64, float64[:, ::1], float64[:, ::1], int64[:, ::1], float64[:, ::1])", steps=20.0
)
