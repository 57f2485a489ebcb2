"""The blueprint of a recording: which views the Rerun viewer opens with, from where each looks, and what is plotted.

Imports `rerun` only inside its functions.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

from rb_dynamics.numerics.vector import ZERO
from rb_dynamics.sinks import rerun_poinsot as poinsot
from rb_dynamics.sinks.picture_style import EYE, Eye
from rb_dynamics.sinks.rerun_sensors import TRUE, entities
from rb_dynamics.sinks.rerun_style import COMMANDS_ON_PATH, DEFECTS, WHEELS, half_range

if TYPE_CHECKING:
    import rerun.blueprint as rrb
    from rerun import EntityPath
    from rerun.blueprint.api import VisualizerLike

    from rb_dynamics.scene.model import Scene

CLOSE_UP, OVERVIEW = "world/center_of_mass/view", "world/view"
"""Frames whose unit is the size of what is to be seen: the viewer cuts off what is nearer to the eye than 0.01."""


def blueprint(
    poinsot_eye: Eye | None,
    peaks: Mapping[str, float],
    duration: float | None,
    exponents: Mapping[str, int],
    path_beside_body: bool,
    scene: Scene,
) -> rrb.Blueprint:
    """Return the layout with which the file opens: 3D and text at the left, plots at the right.

    Args:
        poinsot_eye: viewpoint on the invariable plane; None for a body without one, a particle.
        peaks: largest absolute value of each of `SERIES` so far, 0 before there are any.
        duration: of the run, s; None if it has no end yet.
        exponents: powers of ten that are the units of the plotted defects, as far as they are known.
        path_beside_body: whether the path is shown beside the body; lines of kilometres would cover one of metres.
        scene: what runs: its wheels and sensors have plots.
    """
    import rerun.blueprint as rrb

    rolling = [] if poinsot_eye is None else [_poinsot(poinsot_eye)]
    left = rrb.Vertical(
        rrb.Tabs(_close_up(path_beside_body), _overview(), active_tab=0),
        *rolling,
        rrb.Tabs(
            rrb.TextDocumentView(origin="/about", name="What you see"),
            rrb.TextDocumentView(origin="/scene", name="Scene"),
            rrb.TextLogView(origin="/log", name="Commands and warnings"),
            active_tab=0,
        ),
        row_shares=[5, *(5 for _ in rolling), 3],
    )
    panel = rrb.TimePanel(
        timeline="sim_time",
        state="collapsed",
        playback_speed=_playback_speed(duration),
        loop_mode="all",
        play_state="playing",
    )
    return rrb.Blueprint(
        rrb.Horizontal(left, _plots(peaks, exponents, scene), column_shares=[5, 6]), panel, collapse_panels=True
    )


def _close_up(with_path: bool) -> rrb.Spatial3DView:
    import rerun.blueprint as rrb

    # A frame at the centre of mass, not the world's: the body stays in view and exact however far it goes.
    return rrb.Spatial3DView(
        origin=f"/{CLOSE_UP}",
        contents=["/world/**", *([] if with_path else ["- /world/path/**"])],
        name="Body, followed",
        eye_controls=_eye(EYE),
        line_grid=False,
        overrides=_as_they_arise(COMMANDS_ON_PATH),
    )


def _overview() -> rrb.Spatial3DView:
    import rerun.blueprint as rrb

    return rrb.Spatial3DView(
        origin=f"/{OVERVIEW}",
        contents="/world/**",
        name="Whole path, fixed in the world",
        eye_controls=_eye(EYE),
        overrides=_as_they_arise(COMMANDS_ON_PATH),
    )


def _poinsot(eye: Eye) -> rrb.Spatial3DView:
    import rerun.blueprint as rrb

    return rrb.Spatial3DView(
        origin=f"/{poinsot.ROOT}",
        name="Poinsot: the ellipsoid of inertia rolls on the invariable plane",
        eye_controls=_eye(eye),
        line_grid=False,
        overrides=_as_they_arise(*poinsot.GROWING),
    )


def _eye(eye: Eye) -> rrb.EyeControls3D:
    import rerun.blueprint as rrb

    return rrb.EyeControls3D(kind=rrb.Eye3DKind.Orbital, position=eye.position, look_target=ZERO, eye_up=eye.up)


def _as_they_arise(*entities: str) -> dict[EntityPath | str, VisualizerLike | Iterable[VisualizerLike]]:
    """Return the setting with which a view shows everything logged of these entities up to the time cursor."""
    import rerun.blueprint as rrb
    from rerun import TimeRangeBoundary

    until_now = rrb.VisibleTimeRanges(
        timeline="sim_time", start=TimeRangeBoundary.infinite(), end=TimeRangeBoundary.cursor_relative()
    )
    return {entity: [until_now] for entity in entities}


def _playback_speed(duration: float | None) -> float:
    """Return real time for runs that can be watched, else what shows the run in 30 s."""
    if duration is None or duration <= 0.0 or 2.0 <= duration <= 120.0:
        return 1.0
    return duration / 30.0


def _plots(peaks: Mapping[str, float], exponents: Mapping[str, int], scene: Scene) -> rrb.Grid:
    import rerun.blueprint as rrb

    def defect(name: str, entity: str) -> rrb.TimeSeriesView:
        unit, exponent = DEFECTS[entity][0], exponents.get(entity)
        # Until the first rows arrive, only the names of the lines show the unit.
        scale = "" if exponent is None else f" [1e{exponent} {unit}]"
        reach = half_range(peaks, entity) / 10.0 ** (exponent or 0)
        return _plot(f"{name}{scale}", f"{entity}/scaled", half_range=reach or None)

    def tabs(first: rrb.TimeSeriesView, others: Sequence[rrb.TimeSeriesView]) -> rrb.TimeSeriesView | rrb.Tabs:
        return rrb.Tabs(first, *others, active_tab=0) if others else first

    measured = [
        _plot(f"{name}: {what} beside the truth, body axes", entity, TRUE[what])
        if what in TRUE
        else _plot(f"{name}: {what}", entity)
        for entity, name, what, _ in entities(scene)
    ]
    wheels = [_plot("Wheel speeds [rad/s]", WHEELS)] if scene.wheels else []
    return rrb.Grid(
        tabs(_plot("Angular velocity, body axes [rad/s]", "angular_velocity"), measured),
        _plot("Angular momentum, world [kg m²/s]", "angular_momentum"),
        _plot(
            "Energy and work [J]",
            *(f"energy/{each}" for each in ("kinetic", "work", "potential", "motor_work", "friction_heat", "commands")),
        ),
        rrb.Tabs(
            _plot("Linear momentum [kg m/s]", "linear_momentum"),
            _plot("Position [m]", "position"),
            _plot("Velocity [m/s]", "linear_velocity"),
            _plot("Attitude", "attitude"),
            active_tab=0,
        ),
        defect("Energy defect", "energy/defect"),
        rrb.Tabs(
            defect("Angular momentum defect", "angular_momentum/defect"),
            defect("Linear", "linear_momentum/defect"),
            active_tab=0,
        ),
        _plot("Applied force [N]", "force/**"),
        tabs(_plot("Applied torque [N m]", "torque/**"), wheels),
        grid_columns=2,
    )


def _plot(name: str, *entities: str, half_range: float | None = None) -> rrb.TimeSeriesView:
    import rerun.blueprint as rrb
    from rerun import TimeRange, TimeRangeBoundary

    # Needed: a long run would otherwise show only what lies near the time cursor.
    whole_run = TimeRange(start=TimeRangeBoundary.infinite(), end=TimeRangeBoundary.infinite())
    return rrb.TimeSeriesView(
        origin="/",
        contents=[f"/{entity}" for entity in entities],
        name=name,
        axis_x=rrb.TimeAxis(view_range=whole_run),
        axis_y=rrb.ScalarAxis(range=(-half_range, half_range)) if half_range else None,
        plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.RightTop),
    )
