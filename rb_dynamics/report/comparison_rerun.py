"""A `Comparison` as a Rerun recording: both bodies on their paths in one view, both motions and differences plotted."""

from __future__ import annotations

import os
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from rb_dynamics.analysis.recording_differences import MOTION, UNITS, Comparison, Difference, Side
from rb_dynamics.body.inertia_quantities import equivalent_box
from rb_dynamics.errors import LogError, needing
from rb_dynamics.formats.output_file import renamed
from rb_dynamics.numerics.rotation import IDENTITY
from rb_dynamics.numerics.vector import ZERO
from rb_dynamics.report import comparison_text as text
from rb_dynamics.sinks.picture_style import BLUE, CYAN, EYE, GREEN, GREY, MAGENTA, ORANGE, RED, Color
from rb_dynamics.sinks.rerun_file import RerunFile
from rb_dynamics.sinks.rerun_sink import SPAWN, require_viewer, sending_to, started_viewer, viewer_address

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

    from rb_dynamics.analysis.track import Times

_SIDES: tuple[tuple[str, Color], ...] = (("A", CYAN), ("B", ORANGE))
_ROWS = 20_000
_PATH = 5_000


def write_comparison_recording(found: Comparison, target: str | os.PathLike[str]) -> None:
    """Write `found` as a recording for the Rerun viewer.

    `target` is a file or the address of a viewer. Motions are thinned to about 20 000 samples.

    Raises:
        LogError: the file cannot be written, or there is no viewer.
        MissingExtraError: rerun-sdk is not installed.
    """
    with needing("rerun-sdk", "log", "writing a .rrd file"):
        import_module("rerun")
    import rerun as rr

    path, address = Path(target), viewer_address(os.fspath(target))
    if address == SPAWN:
        address = started_viewer()
    elif address:
        require_viewer(address)
    try:
        # Without a receiver, the stream keeps all: none waits while it is computed.
        stream, layout = rr.RecordingStream("rb_dynamics compare"), _blueprint(found, _length(found))
        _send_bodies(stream, found)
        for each in found.differences.values():
            _send_plots(stream, found, each)
        about = rr.TextDocument(f"```\n{text.as_text(found)}\n```", media_type="text/markdown")
        stream.log("about", about, static=True)
        if address:
            with sending_to(address):
                stream.connect_grpc(address, default_blueprint=layout)
                stream.disconnect()
        else:
            with renamed(path) as new:
                file = RerunFile(stream, new, layout)
                stream.disconnect()
                file.close()
    except (OSError, RuntimeError) as error:
        raise LogError(f"cannot write {path}: {error}; give a file you may write to") from error


def _length(found: Comparison) -> float:
    """Return half the diagonal of the larger of the two bodies, or a tenth of the path where no body is known, m."""
    known = [equivalent_box(side.body)[1] for side in (found.a, found.b) if side.body is not None]
    if known:
        return max(known)
    position = found.differences.get("position")
    return 1.0 if position is None else max(0.1 * float(np.linalg.norm(np.ptp(position.first, axis=0))), 0.1)


def _send_bodies(stream: rr.RecordingStream, found: Comparison) -> None:
    import rerun as rr

    attitude, position = found.differences.get("attitude"), found.differences.get("position")
    stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    shown = attitude or position
    if shown is None:
        return
    kept = _thinned(shown.time_ns)
    times = [_timeline(found, shown.time_ns[kept])]
    length = _length(found)
    for place, (side, color) in enumerate(_SIDES):
        entity = f"world/{side}"
        moved = position is not None and len(position.time_ns) == len(shown.time_ns)
        places = (position.first, position.second)[place][kept] if position is not None and moved else None
        turns = None if attitude is None else (attitude.first, attitude.second)[place][kept]
        stream.send_columns(entity, times, rr.Transform3D.columns(translation=places, quaternion=turns))
        stream.log(entity, rr.TransformAxes3D(1.5 * length), static=True)
        stream.log(f"{entity}/box", _box((found.a, found.b)[place], length, color, side), static=True)
        if position is not None:
            path = position.recorded[place].values
            line = path[:: max(1, len(path) // _PATH)]
            stream.log(f"world/path/{side}", rr.LineStrips3D([line], colors=[color], radii=[-1.5]), static=True)


def _box(side: Side, length: float, color: Color, label: str) -> rr.Boxes3D:
    import rerun as rr

    body = side.body
    return rr.Boxes3D(
        half_sizes=[(0.6 * length, 0.4 * length, 0.3 * length) if body is None else equivalent_box(body)[0]],
        centers=[ZERO if body is None else body.center_of_mass],
        quaternions=[rr.Quaternion(xyzw=IDENTITY if body is None else body.principal_orientation_xyzw)],
        colors=[color],
        labels=[label],
        fill_mode=rr.components.FillMode.MajorWireframe,
    )


def _send_plots(stream: rr.RecordingStream, found: Comparison, each: Difference) -> None:
    import rerun as rr

    kept = _thinned(each.time_ns)
    times = [_timeline(found, each.time_ns[kept])]
    colors = [RED, GREEN, BLUE, GREY]
    for side, own in zip("AB", each.recorded, strict=True):
        count, part = own.values.shape[1], _thinned(own.time_ns)
        names = [f"{axis} {side}".strip() for axis in ("xyzw" if count == 4 else "xyz" if count == 3 else [""])]
        faded = [tuple(c if side == "A" else (c + 255) // 2 for c in color) for color in colors[:count]]
        entity = f"{each.name}/{side}"
        stream.log(entity, rr.SeriesLines(names=names, colors=faded), static=True)
        clock = _timeline(found, own.time_ns[part])
        stream.send_columns(entity, [clock], rr.Scalars.columns(scalars=own.values[part]))
    entity = f"{each.name}/difference"
    stream.log(
        entity, rr.SeriesLines(names=[f"{text.label(each.name)} [{UNITS[each.name]}]"], colors=[MAGENTA]), static=True
    )
    stream.send_columns(entity, times, rr.Scalars.columns(scalars=each.size[kept]))


def _thinned(time_ns: Times) -> slice:
    return slice(None, None, max(1, len(time_ns) // _ROWS))


def _timeline(found: Comparison, time_ns: Times) -> rr.TimeColumn:
    import rerun as rr

    return rr.TimeColumn("t", duration=(time_ns - found.zero_ns).astype("timedelta64[ns]"))


def _blueprint(found: Comparison, length: float) -> rrb.Blueprint:
    import rerun as rr
    import rerun.blueprint as rrb

    whole = rr.TimeRange(start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite())

    def plot(name: str, *entities: str) -> rrb.TimeSeriesView:
        return rrb.TimeSeriesView(
            origin="/",
            contents=[f"/{entity}" for entity in entities],
            name=name,
            axis_x=rrb.TimeAxis(view_range=whole),
            plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.RightTop),
        )

    names = [name for name in MOTION if name in found.differences]
    position = found.differences.get("position")
    extent = length if position is None else max(length, float(np.linalg.norm(np.ptp(position.first, axis=0))))
    middle = np.zeros(3) if position is None else 0.5 * (position.first.max(axis=0) + position.first.min(axis=0))
    eye = rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital,
        position=middle + np.array(EYE.position) * 0.4 * max(extent, 2.0 * length),
        look_target=middle,
        eye_up=EYE.up,
    )
    left = rrb.Vertical(
        rrb.Spatial3DView(origin="/world", name="A (cyan) and B (orange)", eye_controls=eye, line_grid=False),
        rrb.TextDocumentView(origin="/about", name="Comparison"),
        row_shares=[3, 2],
    )
    rows = [
        rrb.Horizontal(
            plot(f"{text.label(name)} of A and B", f"{name}/A", f"{name}/B"),
            plot(f"Difference of {text.label(name)}", f"{name}/difference"),
        )
        for name in names
    ]
    panel = rrb.TimePanel(timeline="t", state="collapsed")
    return rrb.Blueprint(rrb.Horizontal(left, rrb.Vertical(*rows), column_shares=[2, 3]), panel, collapse_panels=True)
