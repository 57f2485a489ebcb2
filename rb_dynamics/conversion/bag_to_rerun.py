"""A bag of another program as a Rerun recording: each topic an entity with its pose in 3D and its numbers as plots."""

from __future__ import annotations

import uuid
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.conversion.bag_to_table import ALL, ORIENTATION, POSITION, Messages, Quantity, Skip, Span, messages_of
from rb_dynamics.errors import LogError, needing
from rb_dynamics.formats.output_file import renamed, require_other
from rb_dynamics.sinks.picture_style import BLUE, GREEN, GREY, RED
from rb_dynamics.sinks.rerun_file import RerunFile
from rb_dynamics.sinks.rerun_thinning import Polyline

if TYPE_CHECKING:
    import rerun as rr

PATH_POINTS = 8192
# Stamps beyond are those of a clock on the wall (1973), and shown as dates.
_DATES_NS = 10**17


def bag_to_rerun(
    bag: Path, target: Path, topics: Sequence[str] = (), span: Span = ALL, skip: Skip | None = None
) -> int:
    """Write the messages of a bag as a Rerun recording; returns their number. `skip`: see `messages_of`.

    Raises:
        LogError: the bag has nothing to show, or a file cannot be read or written.
        MissingExtraError: rerun-sdk is not installed.
    """
    with needing("rerun-sdk", "log", "writing a .rrd file"):
        import rerun as rr
    require_other(target, bag)
    try:
        stream = rr.RecordingStream("rb_dynamics", recording_id=uuid.uuid4())
        with renamed(target) as new:
            file = RerunFile(stream, new)
            stream.send_recording_name(bag.name)
            recorder = _Recorder(bag, stream)
            for messages in messages_of(bag, topics, span, skip=skip):
                recorder.take(messages)
            recorder.end()
            stream.disconnect()
            file.close()
    except (RuntimeError, OSError) as error:
        raise LogError(
            f"{target}: cannot be written ({error}); give a path that you may write to, on a disk with room"
        ) from error
    return recorder.count


class _Recorder:
    def __init__(self, bag: Path, stream: rr.RecordingStream) -> None:
        self.bag, self.stream, self.count = bag, stream, 0
        self.paths: dict[str, Polyline] = {}
        self.dated: dict[str, bool] = {}

    def take(self, messages: Messages) -> None:
        """Send messages of one topic."""
        import rerun as rr

        # A name of an entity has no spaces: those of pairs of frames do.
        entity = rr.new_entity_path([part for part in messages.topic.replace(" ", "/").split("/") if part])
        if messages.topic not in self.paths:
            self.paths[messages.topic] = Polyline(PATH_POINTS)
            self._describe(entity, messages)
        self.count += len(messages.log_times)
        for quantity, values in messages.values.items():
            known = _finite(values)
            if known.any():
                scalars = rr.Scalars.columns(scalars=values[known])
                times = self._times(messages, known)
                self.stream.send_columns(f"{entity}/{quantity.name}", times, scalars, strict=True)
        if POSITION in messages.values:
            position, orientation = messages.values[POSITION], messages.values[ORIENTATION]
            known = _finite(np.column_stack([position, orientation]))
            if known.any():
                self.paths[messages.topic].extend(position[known])
                poses = rr.Transform3D.columns(translation=position[known], quaternion=orientation[known])
                self.stream.send_columns(f"{entity}/body", self._times(messages, known), poses, strict=True)

    def _times(self, messages: Messages, known: NDArray[np.bool_]) -> list[rr.TimeColumn]:
        """Return the times of the messages that are `known`; a timeline has dates or durations, for all topics."""
        import rerun as rr

        columns = []
        for name, times in (("log_time", messages.log_times), ("stamp", messages.stamps)):
            if times is None:
                continue
            if self.dated.setdefault(name, int(times.max()) > _DATES_NS):
                columns.append(rr.TimeColumn(name, timestamp=times[known].astype("datetime64[ns]")))
            else:
                columns.append(rr.TimeColumn(name, duration=times[known].astype("timedelta64[ns]")))
        return columns

    def end(self) -> None:
        """Send the path of each topic that has one, with body axes long enough to be seen beside it."""
        import rerun as rr

        for topic, path in self.paths.items():
            points = path.line()
            if len(points):
                extent = float(np.linalg.norm(np.ptp(points, axis=0)))
                entity = rr.new_entity_path([part for part in topic.replace(" ", "/").split("/") if part])
                line = rr.LineStrips3D([points], colors=[GREY], radii=[-1.5])
                self.stream.log(f"{entity}/path", line, static=True)
                self.stream.log(f"{entity}/body", rr.TransformAxes3D(0.1 * extent or 1.0), static=True)

    def _describe(self, entity: str, messages: Messages) -> None:
        """Send what does not change: names with units, and the origin of the numbers."""
        import rerun as rr

        frame, child = next(iter(messages.frames), (None, None)) if messages.frames else (None, None)
        facts = {"source": str(self.bag), "topic": messages.topic, "type": messages.type_name}
        facts |= {name: text for name, text in (("frame_id", frame), ("child_frame_id", child)) if text}
        self.stream.log(entity, rr.AnyValues(drop_untyped_nones=True, **facts), static=True)
        for quantity in messages.values:
            names, colors = _names(quantity), (RED, GREEN, BLUE, GREY, GREY, GREY)[: len(quantity.axes)]
            self.stream.log(f"{entity}/{quantity.name}", rr.SeriesLines(names=names, colors=colors), static=True)


def _names(quantity: Quantity) -> list[str]:
    unit = f" [{quantity.unit}]" if quantity.unit else ""
    return [f"{quantity.name} {axis}".strip() + unit for axis in quantity.axes]


def _finite(rows: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which rows (n, k) have finite numbers only."""
    found: NDArray[np.bool_] = np.logical_and.reduce(np.isfinite(rows), axis=1)
    return found
