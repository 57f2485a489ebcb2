"""How things look in the Rerun viewer: colours, names, lines, and the text beside them.

`rerun_sink.py` logs the entities. Imports `rerun` only inside its functions.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import cycle, islice
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.numerics.vector import ZERO, Vector
from rb_dynamics.sinks.picture_style import BLUE, CYAN, GREEN, GREY, MAGENTA, ORANGE, RED, YELLOW, Color
from rb_dynamics.sinks.rerun_sensors import entities

if TYPE_CHECKING:
    import rerun as rr

    from rb_dynamics.body.rigid_body import RigidBody
    from rb_dynamics.scene.model import Scene

Array = NDArray[np.float64]
_AXES_COLORS: tuple[Color, ...] = (RED, GREEN, BLUE, GREY)


@dataclass(frozen=True)
class PlotLines:
    """One field of `Sample` as an entity of scalars, with the names and colours of its lines."""

    entity: str
    attribute: str
    names: tuple[str, ...] = ("x", "y", "z")
    colors: tuple[Color, ...] = _AXES_COLORS


SERIES = (
    PlotLines("position", "position_world"),
    PlotLines("attitude", "orientation_xyzw", ("x", "y", "z", "w")),
    PlotLines("linear_velocity", "linear_velocity_world"),
    PlotLines("angular_velocity", "angular_velocity_body"),
    PlotLines("angular_momentum", "angular_momentum_world"),
    PlotLines("linear_momentum", "linear_momentum_world"),
    PlotLines("energy/kinetic", "kinetic_energy", ("kinetic energy",), (ORANGE,)),
    PlotLines("energy/work", "work", ("work of the loads",), (CYAN,)),
    PlotLines("energy/defect", "energy_defect", ("T - T0 - work",), (MAGENTA,)),
    PlotLines("angular_momentum/defect", "angular_momentum_defect_world"),
    PlotLines("linear_momentum/defect", "linear_momentum_defect_world"),
)

POTENTIAL = PlotLines("energy/potential", "potential_energy", ("potential energy",), (YELLOW,))
"""Where an effect has one."""


WHEELS = "wheels"
"""Speeds of reaction wheels, where there are any."""

_WHEEL_ENERGIES = (
    PlotLines("energy/motor_work", "motor_work", ("work of the motors",), (GREEN,)),
    PlotLines("energy/friction_heat", "friction_heat", ("heat of the wheels' friction",), (RED,)),
)

_WHEEL_COLORS = (RED, GREEN, BLUE, GREY, ORANGE, CYAN)

DEFECTS: dict[str, tuple[str, tuple[str, ...]]] = {
    "energy/defect": ("J", ("energy/kinetic", "energy/work")),
    "angular_momentum/defect": ("kg m²/s", ("angular_momentum",)),
    "linear_momentum/defect": ("kg m/s", ("linear_momentum",)),
}
"""Of each defect: its unit, and the quantities to which it is small. The viewer writes 2e-14 as 0.000 000 000 000 02:
what is plotted is the entity `scaled` below it, in units of a power of ten."""


def half_range(peaks: Mapping[str, float], entity: str) -> float:
    """Return how far the axis of a defect reaches; 0 if nothing is known yet, from the largest of each entity so far.

    Round-off shall look like zero, not like a signal that fills the plot.
    """
    whole = max(peaks[other] for other in DEFECTS[entity][1])
    return max(1.2 * peaks[entity], 1e-12 * whole, 1e-14) if whole else 0.0


def scaled_lines(entity: str, exponent: int) -> rr.SeriesLines:
    """Return the looks of a defect in units of 10**exponent."""
    import rerun as rr

    series = next(one for one in SERIES if one.entity == entity)
    names = [f"{name} [1e{exponent}]" for name in series.names]
    return rr.SeriesLines(names=names, colors=series.colors[: len(names)])


def series_of(scene: Scene) -> tuple[PlotLines, ...]:
    """Return what is plotted of each sample of `scene`."""
    series = SERIES if scene.combined_effects.potential() is None else (*SERIES, POTENTIAL)
    if not scene.wheels:
        return series
    limits = [f" (at most {w.max_speed:g} rad/s)" if w.max_speed < math.inf else "" for w in scene.wheels]
    names = tuple(wheel.name + limit for wheel, limit in zip(scene.wheels, limits, strict=True))
    series = (*series, *_WHEEL_ENERGIES)
    return (*series, PlotLines(WHEELS, "wheel_speeds", names, tuple(islice(cycle(_WHEEL_COLORS), len(names)))))


@dataclass(frozen=True)
class Arrow:
    """A vector at the centre of mass; where it is largest it is `length` half diagonals of the box long."""

    entity: str
    label: str
    color: Color
    length: float


MOMENTUM = Arrow("world/center_of_mass/angular_momentum", "L", ORANGE, 3.0)
RATE = Arrow("world/center_of_mass/angular_velocity", "ω", CYAN, 1.9)
FORCE = Arrow("world/center_of_mass/force", "F", MAGENTA, 2.4)
TORQUE = Arrow("world/center_of_mass/torque", "τ", YELLOW, 1.6)
ARROWS = (MOMENTUM, RATE, FORCE, TORQUE)

COMMANDS_ON_PATH = "world/path/commands"
MARKS = 48
"""Largest number of marked commands, chosen evenly among all: more would hide what they mark."""

# ---- looks of the entities


def fixed_looks(scene: Scene, half_sizes: Vector, size: float) -> Iterator[tuple[str, list[rr.AsComponents]]]:
    """Give entity and components of all that looks the same throughout a run, before anything of it is known."""
    import rerun as rr

    yield "world", [rr.ViewCoordinates.RIGHT_HAND_Z_UP]
    yield "world/body", [rr.TransformAxes3D(1.6 * size)]
    if scene.surface is not None:
        yield "world/body/mesh", [_mesh(*scene.surface)]
    else:
        yield "world/body/box", [_box(scene.body, half_sizes)]
    # Of constant size on the screen: shows where the body is when the whole path is in view.
    yield "world/center_of_mass", [rr.Points3D([ZERO], radii=[-3.0], colors=[GREY])]
    for arrow in ARROWS:
        shaft = rr.Arrows3D.from_fields(colors=[arrow.color], radii=[-4.0])
        letter = rr.Points3D.from_fields(colors=[arrow.color], radii=[-0.5], labels=[arrow.label], show_labels=True)
        yield arrow.entity, [shaft, letter]
    yield COMMANDS_ON_PATH, [rr.Points3D.from_fields(colors=[MAGENTA], radii=[-2.0])]
    points = rr.SeriesPoints(names=["command"], colors=[MAGENTA], markers=["diamond"], marker_sizes=[2.0])
    yield "energy/commands", [points]
    for series in series_of(scene):
        yield series.entity, [rr.SeriesLines(names=series.names, colors=series.colors[: len(series.names)])]
    for entity, name, _, width in entities(scene):
        # Points, beside the lines of the true values.
        colors = [tuple((c + 255) // 2 for c in color) for color in _AXES_COLORS[:width]]
        points = rr.SeriesPoints(
            names=[f"{name} {axis}" for axis in "xyzw"[:width]], colors=colors, marker_sizes=[1.5] * width
        )
        yield entity, [points]
    yield "scene", [rr.TextDocument(f"```yaml\n{scene.text}\n```", media_type=rr.MediaType.MARKDOWN)]


def _mesh(path: str, scale_to_m: float) -> rr.Mesh3D:
    import rerun as rr

    from rb_dynamics.body.mesh import read_mesh

    points, faces = read_mesh(path)
    # Every triangle with corners of its own: edges look sharp.
    corners = (points * scale_to_m)[faces]
    normals = np.repeat(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), 3, axis=0)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return rr.Mesh3D(
        vertex_positions=corners.reshape(-1, 3),
        vertex_normals=normals / np.where(lengths > 0.0, lengths, 1.0),
        albedo_factor=GREY,
    )


def _box(body: RigidBody, half_sizes: Vector) -> rr.Boxes3D:
    import rerun as rr

    return rr.Boxes3D(
        half_sizes=[half_sizes],
        centers=[body.center_of_mass],
        quaternions=[rr.Quaternion(xyzw=body.principal_orientation_xyzw)],
        colors=[GREY],
        fill_mode=rr.components.FillMode.TransparentFillMajorWireframe,
    )


def wrench_lines(topic: str, frame_id: str, shade: int) -> rr.SeriesLines:
    """Return the looks of a channel's wrench: steps in the colours of the axes, paler with each `shade` (0 to 2)."""
    import rerun as rr

    return rr.SeriesLines(
        names=[f"{topic} {axis} ({frame_id})" for axis in "xyz"],
        colors=[tuple(c + (255 - c) * shade // 3 for c in color) for color in (RED, GREEN, BLUE)],
        interpolation_mode=rr.components.InterpolationMode.StepAfter,
    )


def no_wrench_line() -> rr.SeriesLines:
    """Return the looks of the line that is shown where there was no force, or no torque."""
    import rerun as rr

    return rr.SeriesLines(names=["none"], colors=[GREY])


def path_line(name: str, points: Array) -> rr.LineStrips3D:
    """Return the path of the centre of mass, or a thinner one of the body origin."""
    import rerun as rr

    color, radius = (GREY, -1.5) if name == "center_of_mass" else (BLUE, -0.75)
    return rr.LineStrips3D([points], colors=[color], radii=[radius])


# ---- text

_ABOUT = """\
{shape} ({size:.3g} m across), with the body axes in red, green and
blue. **Orange L**: angular momentum; only a torque turns it. **Cyan ω**: angular velocity. **Magenta F**: force.
**Yellow τ**: torque. Arrows grow with the square root. **Grey line**: path of the centre of mass, with a
**magenta dot** where a command took effect. {where}
{rolling}
| run | |
|---|---|
{table}
"""


_ROLLING = """
**Poinsot's construction**: while no torque acts, the ellipsoid of inertia (blue, turning with the body) rolls without
slipping on the grey plane, which is fixed and perpendicular to **L**. They touch at the tip of **ω**: it draws the
**green** polhode on the ellipsoid and the **yellow** herpolhode on the plane. {spin}The grey lines cross at the middle
axis: a tip that starts near a crossing follows a line to the opposite one, and **the body turns over**.
"""


def about(facts: Mapping[str, str], size: float, offset: Vector, scene: Scene) -> rr.TextDocument:
    """Return the text that explains the view, and the facts; `offset` (m, world) was subtracted in the 3D views."""
    import rerun as rr

    where = ""
    if any(offset):
        where = (
            f"The start position {list(offset)} m (world) has been subtracted in the 3D views, "
            "because they compute in single precision; the plots show true values in double precision."
        )
    table = "\n".join(f"| {key} | {value} |" for key, value in facts.items() if value)
    shape = "The **grey body** is its mesh" if scene.surface else "The **box** has the mass and inertia of the body"
    rolling = "" if scene.body.is_particle else _ROLLING.format(spin=_spin(scene))
    text = _ABOUT.format(shape=shape, where=where, size=2.0 * size, rolling=rolling, table=table)
    return rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)


def _spin(scene: Scene) -> str:
    """Return what happens to the initial spin if nothing acts; "" for a body at rest."""
    if not any(scene.initial.angular_velocity_body):
        return ""
    from rb_dynamics.theory.poinsot import PolhodeKind, polhode

    curve = polhode(scene.body, scene.initial, 1)
    if curve.kind in (PolhodeKind.FIXED_AXIS, PolhodeKind.SPHERE):
        return "This run starts with a spin that keeps its axis: both curves are points. "
    if curve.kind is PolhodeKind.SEPARATRIX:
        return "This run starts on a line that only ends at the middle axis: the body turns over once. "
    return f"This run starts with a polhode {curve.kind.value}, once round in {curve.period:.4g} s. "
