"""The figures of a report: motion, momenta, energy, defects, wrenches and comparison.

Takes arrays over time in s; `svg.py` does the drawing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from rb_dynamics.report.interactive_plots import Picture
from rb_dynamics.report.svg import Array, Line, Panel, components, draw, far_off

# A wheel whose speed comes to this part of its limit is shown with the limit.
_NEAR = 0.8
# Relative defects below this are in units of 1e-16, about half the spacing of the numbers next to 1.
_ROUND_OFF = 1e-12


def position_and_attitude(time_s: Array, position_world: Array, orientation_xyzw: Array) -> Picture:
    """Return position (m) and quaternion; its sign is chosen to be continuous, since q and -q are the same attitude."""
    place, less = far_off(position_world)
    return draw(
        _measured(
            Panel(f"Position of the body origin{less}, world axes [m]", components(time_s, position_world - place)),
            Panel("Attitude, quaternion from body to world", components(time_s, continuous(orientation_xyzw), "xyzw")),
        ),
        "Position and attitude over time",
    )


def rates_and_velocity(time_s: Array, angular_velocity: Array, linear_velocity: Array, axes: str = "body") -> Picture:
    """Return angular (rad/s) and linear velocity (m/s), both in the axes of the `axes` frame."""
    return draw(
        _measured(
            Panel(f"Angular velocity, {axes} axes [rad/s]", components(time_s, angular_velocity)),
            Panel(f"Velocity of the body origin, {axes} axes [m/s]", components(time_s, linear_velocity)),
        ),
        "Angular and linear velocity over time",
    )


def specific_force(time_s: Array, values: Array) -> Picture:
    """Return what an accelerometer measures (m/s^2)."""
    return draw([Panel("Specific force [m/s²]", components(time_s, values))], "Specific force over time")


def pointing(time_s: Array, angle: Array) -> Picture:
    """Return the angle from a target (rad)."""
    return draw([Panel("Angle from the target [rad]", [Line("angle", time_s, angle)])], "Pointing error over time")


def wheel_speeds(wheels: Sequence[tuple[str, Array, Array, float]]) -> Picture:
    """Return the speeds (rad/s) of reaction wheels: name, times (s), speeds, largest speed allowed."""
    lines = []
    for place, (name, time_s, speed, limit) in enumerate(wheels):
        lines.append(Line(name, time_s, speed, color=place))
        if np.abs(speed).max() > _NEAR * limit:
            side = np.full(2, math.copysign(limit, speed[np.abs(speed).argmax()]))
            lines.append(Line(f"{name}: max_speed", time_s[[0, -1]], side, dashed=True, color=place))
    return draw([Panel("Wheel speeds [rad/s]", lines)], "Wheel speeds over time")


def actuator_commands(commands: Sequence[tuple[str, str, Array, Array]], span_s: Array) -> Picture:
    """Return commands to actuators: title with unit, name, times (s), values; one panel for each title."""
    panels: dict[str, list[Line]] = {}
    for title, name, time_s, values in commands:
        panels.setdefault(title, []).append(Line(name, time_s, values, step=True))
    return draw([Panel(title, lines) for title, lines in panels.items()], "Commands to actuators over time", span_s)


def sensor_errors(panels: Sequence[tuple[str, Array, Array]]) -> Picture:
    """Return measured minus true: title with unit, times (s), rows of x, y, z."""
    shown = [Panel(title, components(time_s, rows)) for title, time_s, rows in panels]
    return draw(shown, "Errors of the sensors over time")


def _measured(*panels: Panel) -> list[Panel]:
    """Return the panels without those of quantities that nothing measures."""
    return [panel for panel in panels if not all(np.isnan(line.values).all() for line in panel.lines)] or [*panels]


def momenta(time_s: Array, angular_momentum_world: Array, linear_momentum_world: Array) -> Picture:
    """Return angular (kg m^2/s, about the centre of mass) and linear momentum (kg m/s), world axes."""
    return draw(
        [
            Panel(
                "Angular momentum about the centre of mass, world axes [kg m²/s]",
                components(time_s, angular_momentum_world),
            ),
            Panel("Linear momentum, world axes [kg m/s]", components(time_s, linear_momentum_world)),
        ],
        "Angular and linear momentum over time",
    )


def energy(
    time_s: Array, kinetic: Array, work: Array | None = None, parts: Mapping[str, tuple[Array, Array]] | None = None
) -> Picture:
    """Return kinetic energy and, if known, the initial energy plus the work done since (J).

    `parts` are energies by the wheels, by their names, each as times (s) and values (J).
    """
    lines = [Line("kinetic energy", time_s, kinetic)]
    if work is not None:
        lines.append(Line("initial energy + work", time_s, kinetic[:1] + work, dashed=True))
    panels = [Panel("Energy [J]", lines)]
    if parts:
        # In orbit the kinetic energy is 1e8 times as large.
        panels.append(Panel("Energy by the wheels [J]", [Line(name, *part) for name, part in parts.items()]))
    return draw(panels, "Kinetic energy and work over time")


def energy_defect(time_s: Array, defect: Array, scale: float) -> Picture:
    """Return T - T0 - work, relative to `scale`, both in J."""
    title, shown = _relative("Energy defect T − T₀ − W", defect, scale, "J")
    return draw([Panel(title, [Line("defect", time_s, shown)])], "Energy defect over time")


def momentum_defects(angular: tuple[Array, Array, float] | None, linear: tuple[Array, Array, float] | None) -> Picture:
    """Return L - L0 - int N dt and p - p0 - int F dt, each as (time, rows, scale); None if unknown."""
    panels = []
    for name, unit, given in (("Angular", "kg m²/s", angular), ("Linear", "kg m/s", linear)):
        if given is not None:
            time_s, rows, scale = given
            title, shown = _relative(f"{name} momentum defect, world axes", rows, scale, unit)
            panels.append(Panel(title, components(time_s, shown)))
    return draw(panels, "Momentum defects over time")


def _relative(name: str, values: Array, scale: float, unit: str) -> tuple[str, Array]:
    """Return the title and the values relative to `scale`, in units of a power of ten: 1e-16 if they are round-off."""
    if not scale > 0.0:
        return f"{name} [{unit}]", values
    relative = values / scale
    most = float(np.nanmax(np.abs(relative), initial=0.0))
    power = -16 if most < _ROUND_OFF else 3 * math.floor(math.log10(most) / 3.0)
    return f"{name}, relative to {scale:.3g} {unit} [1e{power}]".replace("[1e0]", "[1]"), relative / 10.0**power


def wrench_history(steps: Sequence[tuple[str, Array, Array]], span_s: Array) -> Picture:
    """Return held wrenches over time, each value until the next and the last to the end.

    Args:
        steps: for each panel: title with unit, times in s, rows of x, y, z.
        span_s: first and last time to show, s.
    """
    panels = [Panel(title, components(time_s, rows, step=True)) for title, time_s, rows in steps]
    return draw(panels, "Applied wrenches over time", span_s)


def residual_wrench(time_s: Array, force_world: Array, torque_world: Array, torque_body: Array) -> Picture:
    """Return the unexplained force (N, world axes; NaN if not known) and torque (N m, in both axes)."""
    panels = [
        Panel("Residual torque about the centre of mass, world axes [N m]", components(time_s, torque_world)),
        Panel("Residual torque about the centre of mass, body axes [N m]", components(time_s, torque_body)),
    ]
    if not np.isnan(force_world).all():
        panels.insert(0, Panel("Residual force, world axes [N]", components(time_s, force_world)))
    return draw(panels, "Residual wrench over time")


def comparison(time_s: Array, differences: Mapping[str, Array]) -> Picture:
    """Return magnitudes of differences from a reference, one logarithmic panel per title.

    Vectors (rows) are shown by their norm; zero, exact agreement, leaves a gap.
    """
    panels = []
    for title, values in differences.items():
        size = values if values.ndim == 1 else np.linalg.norm(values, axis=1)
        panels.append(Panel(title, [Line("difference", time_s, size)], log=True))
    return draw(panels, "Difference against the reference over time")


def overlay(title: str, first: tuple[Array, Array], second: tuple[Array, Array], labels: Sequence[str]) -> Panel:
    """Return the components of A, and dashed over them in the same colours those of B; each as times (s) and rows."""
    lines = [
        Line(f"{label} {side}", time_s, column, dashed=side == "B", color=place)
        for side, (time_s, rows) in (("A", first), ("B", second))
        for place, (label, column) in enumerate(zip(labels, rows.T, strict=True))
    ]
    return Panel(title, lines)


def overlays(panels: Sequence[Panel]) -> Picture:
    """Return panels of `overlay`, one above the other."""
    return draw(panels, "Both motions over time")


def continuous(orientation_xyzw: Array) -> Array:
    """Return the same attitudes with the sign of each quaternion chosen to be continuous."""
    if len(orientation_xyzw) == 0:
        return orientation_xyzw
    turns = np.einsum("ij,ij->i", orientation_xyzw[1:], orientation_xyzw[:-1]) < 0.0
    signs = np.concatenate([[1.0], np.where(np.cumsum(turns) % 2, -1.0, 1.0)])
    result: Array = orientation_xyzw * signs[:, None]
    return result
