"""What the Rerun viewer shows of a run: views, plots, where the eye stands, colours, names and the text beside them.

Makes Rerun's objects and never logs one: entities and their columns are the business of `recording/rerun_sink.py`.
Imports `rerun` only inside its functions.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.vector import ZERO, Vector

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

    from rb_dynamics.scene.model import Scene

Array = NDArray[np.float64]
Color = tuple[int, int, int]

RED, GREEN, BLUE = (236, 92, 92), (102, 194, 102), (96, 148, 245)
ORANGE, CYAN, MAGENTA, YELLOW, GREY = (255, 170, 51), (64, 208, 220), (224, 96, 200), (240, 220, 80), (170, 175, 185)
_AXES_COLORS: tuple[Color, ...] = (RED, GREEN, BLUE, GREY)


@dataclass(frozen=True)
class Series:
    """One field of `Sample` as an entity of scalars, with the names and colours of its lines."""

    entity: str
    attribute: str
    names: tuple[str, ...] = ("x", "y", "z")
    colors: tuple[Color, ...] = _AXES_COLORS


SERIES = (
    Series("position", "position_world"),
    Series("attitude", "orientation_xyzw", ("x", "y", "z", "w")),
    Series("linear_velocity", "linear_velocity_world"),
    Series("angular_velocity", "angular_velocity_body"),
    Series("angular_momentum", "angular_momentum_world"),
    Series("linear_momentum", "linear_momentum_world"),
    Series("energy/kinetic", "kinetic_energy", ("kinetic energy",), (ORANGE,)),
    Series("energy/work", "work", ("work of the loads",), (CYAN,)),
    Series("energy/defect", "energy_defect", ("T - T0 - work",), (MAGENTA,)),
    Series("angular_momentum/defect", "angular_momentum_defect_world"),
    Series("linear_momentum/defect", "linear_momentum_defect_world"),
)

POTENTIAL = Series("energy/potential", "potential_energy", ("potential energy",), (YELLOW,))
"""Where an effect has one."""


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

# ---- looks of the entities


def fixed_looks(scene: Scene, half_sizes: Vector, size: float) -> Iterator[tuple[str, list[rr.AsComponents]]]:
    """Give entity and components of all that looks the same throughout a run, before anything of it is known."""
    import rerun as rr

    box = rr.Boxes3D(
        half_sizes=[half_sizes],
        centers=[scene.body.center_of_mass],
        quaternions=[rr.Quaternion(xyzw=scene.body.principal_orientation_xyzw)],
        colors=[GREY],
        fill_mode=rr.components.FillMode.TransparentFillMajorWireframe,
    )
    yield "world", [rr.ViewCoordinates.RIGHT_HAND_Z_UP]
    yield "world/body", [rr.TransformAxes3D(1.6 * size)]
    yield "world/body/box", [box]
    # Of constant size on the screen: shows where the body is when the whole path is in view.
    yield "world/center_of_mass", [rr.Points3D([ZERO], radii=[-3.0], colors=[GREY])]
    for arrow in ARROWS:
        shaft = rr.Arrows3D.from_fields(colors=[arrow.color], radii=[-4.0])
        letter = rr.Points3D.from_fields(colors=[arrow.color], radii=[-0.5], labels=[arrow.label], show_labels=True)
        yield arrow.entity, [shaft, letter]
    for series in SERIES:
        yield series.entity, [rr.SeriesLines(names=series.names, colors=series.colors[: len(series.names)])]
    yield "scene", [rr.TextDocument(f"```yaml\n{scene.text}\n```", media_type=rr.MediaType.MARKDOWN)]


def wrench_lines(topic: str, frame_id: str, shade: int) -> rr.SeriesLines:
    """Return the looks of a channel's wrench: steps in the colours of the axes, paler with each `shade` (0 to 2)."""
    import rerun as rr

    return rr.SeriesLines(
        names=[f"{topic} {axis} ({frame_id})" for axis in "xyz"],
        colors=[tuple(c + (255 - c) * shade // 3 for c in color) for color in (RED, GREEN, BLUE)],
        interpolation_mode=rr.components.InterpolationMode.StepAfter,
    )


def no_wrench_line() -> rr.SeriesLines:
    """Return the looks of the line that stands where there was no force, or no torque."""
    import rerun as rr

    return rr.SeriesLines(names=["none"], colors=[GREY])


def path_line(name: str, points: Sequence[Vector]) -> rr.LineStrips3D:
    """Return the path of the centre of mass, or a thinner one of the body origin."""
    import rerun as rr

    color, radius = (GREY, -1.5) if name == "center_of_mass" else (BLUE, -0.75)
    return rr.LineStrips3D([points], colors=[color], radii=[radius])


# ---- text

_ABOUT = """\
The **box** has the mass and inertia of the body ({size:.3g} m from corner to corner); its red, green and blue lines are
the body axes. **Orange L**: angular momentum; only a torque turns it. **Cyan ω**: angular velocity. **Magenta F**:
force. **Yellow τ**: torque. Arrows grow with the square root, each kind on its own scale. **Grey line**: path of the
centre of mass. {where}

| run | |
|---|---|
{table}
"""


def about(facts: Mapping[str, str], size: float, offset: Vector) -> rr.TextDocument:
    """Return what there is to see, and the facts; `offset` (m, world) was subtracted in the 3D views."""
    import rerun as rr

    where = "The 3D views use world coordinates."
    if any(offset):
        where = (
            f"The start position {list(offset)} m (world) has been subtracted in the 3D views, "
            "because they compute in single precision; the plots show true values in double precision."
        )
    table = "\n".join(f"| {key} | {value} |" for key, value in facts.items() if value)
    text = _ABOUT.format(where=where, size=2.0 * size, table=table)
    return rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)


# ---- views


def blueprint(path: Sequence[Vector], size: float, peaks: Mapping[str, float], duration: float | None) -> rrb.Blueprint:
    """Return the layout with which the file opens: 3D and text at the left, plots at the right.

    Args:
        path: of the centre of mass so far, m.
        size: half diagonal of the box, m.
        peaks: largest absolute value of each of `SERIES` so far, 0 before there are any.
        duration: of the run, s; None where it has no end yet.
    """
    import rerun.blueprint as rrb

    left = rrb.Vertical(
        rrb.Tabs(_close_up(size), _overview(path, size), active_tab=0),
        rrb.Tabs(
            rrb.TextDocumentView(origin="/about", name="What you see"),
            rrb.TextDocumentView(origin="/scene", name="Scene"),
            rrb.TextLogView(origin="/log", name="Warnings"),
            active_tab=0,
        ),
        row_shares=[5, 2],
    )
    panel = rrb.TimePanel(
        timeline="sim_time",
        state="collapsed",
        playback_speed=_playback_speed(duration),
        loop_mode="all",
        play_state="playing",
    )
    return rrb.Blueprint(rrb.Horizontal(left, _plots(peaks), column_shares=[5, 6]), panel, collapse_panels=True)


def _close_up(size: float) -> rrb.Spatial3DView:
    import rerun.blueprint as rrb

    # The frame of the centre of mass, not the world's: the body stays in view and exact however far it goes.
    return rrb.Spatial3DView(
        origin="/world/center_of_mass",
        contents="/world/**",
        name="Body, followed",
        eye_controls=_eye(np.zeros(3), size),
        line_grid=False,
    )


def _overview(path: Sequence[Vector], size: float) -> rrb.Spatial3DView:
    import rerun.blueprint as rrb

    points = np.array(path or [ZERO])
    low, high = points.min(axis=0), points.max(axis=0)
    eye = _eye(0.5 * (low + high), max(0.25 * float(np.linalg.norm(high - low)), size))
    return rrb.Spatial3DView(origin="/world", name="Whole path, fixed in the world", eye_controls=eye)


def _eye(center: Array, size: float) -> rrb.EyeControls3D:
    """Return an eye that sees what lies within some 3 `size` of `center`, all axes about equally foreshortened."""
    import rerun.blueprint as rrb

    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital,
        position=(center + np.array([3.6, -4.0, 2.8]) * size).tolist(),
        look_target=center.tolist(),
        eye_up=[0.0, 0.0, 1.0],
    )


def _playback_speed(duration: float | None) -> float:
    """Return real time for runs that can be watched, else what shows the run in 30 s."""
    if duration is None or duration <= 0.0 or 2.0 <= duration <= 120.0:
        return 1.0
    return duration / 30.0


def _plots(peaks: Mapping[str, float]) -> rrb.Grid:
    import rerun.blueprint as rrb

    def defect(name: str, entity: str, *of: str) -> rrb.TimeSeriesView:
        # Round-off shall look like zero, not like a signal that fills the plot; labels end at about 1e-15.
        whole = max(peaks[other] for other in of)
        return _plot(name, entity, half_range=max(1.2 * peaks[entity], 1e-12 * whole, 1e-14) if whole else None)

    return rrb.Grid(
        _plot("Angular velocity, body axes [rad/s]", "angular_velocity"),
        _plot("Angular momentum, world [kg m²/s]", "angular_momentum"),
        _plot("Energy and work [J]", "energy/kinetic", "energy/work", "energy/potential"),
        rrb.Tabs(
            _plot("Linear momentum [kg m/s]", "linear_momentum"),
            _plot("Position [m]", "position"),
            _plot("Velocity [m/s]", "linear_velocity"),
            _plot("Attitude", "attitude"),
            active_tab=0,
        ),
        defect("Energy defect [J]", "energy/defect", "energy/kinetic", "energy/work"),
        rrb.Tabs(
            defect("Angular momentum defect [kg m²/s]", "angular_momentum/defect", "angular_momentum"),
            defect("Linear [kg m/s]", "linear_momentum/defect", "linear_momentum"),
            active_tab=0,
        ),
        _plot("Applied force [N]", "force/**"),
        _plot("Applied torque [N m]", "torque/**"),
        grid_columns=2,
    )


def _plot(name: str, *entities: str, half_range: float | None = None) -> rrb.TimeSeriesView:
    import rerun.blueprint as rrb
    from rerun import TimeRange, TimeRangeBoundary

    # Said, or a long run would show only what lies near the time cursor.
    whole_run = TimeRange(start=TimeRangeBoundary.infinite(), end=TimeRangeBoundary.infinite())
    return rrb.TimeSeriesView(
        origin="/",
        contents=[f"/{entity}" for entity in entities],
        name=name,
        axis_x=rrb.TimeAxis(view_range=whole_run),
        axis_y=rrb.ScalarAxis(range=(-half_range, half_range)) if half_range else None,
        plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.RightTop),
    )
