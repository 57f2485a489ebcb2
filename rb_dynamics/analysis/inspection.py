"""`inspect`: read and analyse a recording, for `rb-dynamics inspect`, its page and Python."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

import numpy as np

from rb_dynamics.analysis.bag_selection import Window, part_of
from rb_dynamics.analysis.checks import BOUND
from rb_dynamics.analysis.momentum_energy_balance import Balance
from rb_dynamics.analysis.onboard_devices import ActuatorUse, SensorErrors, WheelSpeeds, pointing_error
from rb_dynamics.analysis.read_track import TopicChoice, as_measured, read_track
from rb_dynamics.analysis.summary import RunSummary, summarize
from rb_dynamics.analysis.track import Track
from rb_dynamics.analysis.unexplained_wrench import Residual
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.logs.own_log import logged_scene, opened_scene
from rb_dynamics.numerics.argument_checks import number, quaternion, shown
from rb_dynamics.scene.model import Scene
from rb_dynamics.sensors.attitude_sensors import AttitudeErrorSensor


@dataclass(frozen=True)
class Inspection:
    """A recording and its analysis.

    Attributes:
        track: the motion and the wrenches as arrays over time.
        summary: topics, extremes, balances, checks and warnings.
    """

    track: Track
    summary: RunSummary

    @property
    def passed(self) -> bool:
        """Whether every check holds."""
        return self.summary.passed

    def as_dict(self) -> dict[str, Any]:
        """Return the summary as plain values for JSON; arrays over time stay in `track`, unknown numbers are None."""
        parts = {field.name: getattr(self.summary, field.name) for field in fields(self.summary)}
        return {"passed": self.passed} | {name: _plain(value) for name, value in parts.items()}


def inspect(
    log: str | os.PathLike[str],
    scene: Scene | str | os.PathLike[str] | None = None,
    bound: float = BOUND,
    topics: TopicChoice | None = None,
    window_s: Window = (None, None),
    target: Sequence[float] | None = None,
) -> Inspection:
    """Return the analysis of a log of this package, or of any ROS 2 bag of pose, twist and wrench.

    Args:
        log: the file, or the folder of a bag.
        scene: body and frames for a bag without them, or its file.
        bound: largest defect accepted, relative to the largest energy or momentum.
        topics: which topics describe the body; found by type and name where it does not say.
        window_s: first and last time to inspect, s: simulation time, or since the start of the motion in a bag.
        target: attitude xyzw, body to world, that the body is to point at: its angle from it is analysed too. That of
            the first `attitude_error` of the scene if not given.

    Raises:
        TypeError: an argument has the wrong type.
        ValueError: the bound is not greater than 0, or the target no attitude.
        LogError: the recording cannot be read, has nothing to inspect, or not the topics asked for.
        SceneError: the file has no valid scene.
    """
    number(bound, "bound", "a finite number greater than 0", above=0.0)
    if not isinstance(log, (str, os.PathLike)):
        raise TypeError(f"log is {shown(log)}, expected the path of a log; write its name")
    known = None if scene is None else opened_scene(scene)
    aim = None if target is None else quaternion(target, "target")
    topics = topics or TopicChoice()
    bag, topics = as_measured(read_bag(log, repeated=topics.moving), topics)
    known = known or (logged_scene(bag.attachments) if topics.alone else None)
    track = read_track(bag, known, topics)
    if window_s != (None, None):
        track = read_track(part_of(track, window_s, known), known, topics)
    if aim is None and track.scene is not None:
        errors = (each for each in track.scene.sensors if isinstance(each, AttitudeErrorSensor))
        aim = next((each.aim(each.fixed(track.scene.frames)) for each in errors), None)
    if aim is not None:
        track = replace(track, pointing=pointing_error(track, aim))
    return Inspection(track, summarize(track, bound))


# Of these only some attributes are for JSON: the others are arrays over time.
_KEPT: dict[type, tuple[str, ...]] = {
    Balance: ("name", "unit", "worst", "worst_ns", "relative", "covered", "scale", "basis"),
    Residual: (
        *("relative", "best", "inertia", "scaled", "mass", "mass_error", "mass_explained", "mass_untold", "unit"),
        *("explained", "explainable", "noise", "unseen", "bias", "moment_errors", "untold", "fitted_ns"),
    ),
    ActuatorUse: ("name", "kind", "unit", "commands", "largest", "limited", "rejected"),
    WheelSpeeds: ("name", "max_speed", "first", "last", "largest", "largest_ns", "at_limit_s"),
    SensorErrors: ("name", "quantity", "unit", "count", "compared", "mean", "deviation"),
}


def _plain(value: Any) -> Any:
    if kept := _KEPT.get(type(value)):
        return {name: _plain(getattr(value, name)) for name in kept}
    if isinstance(value, (np.ndarray, np.generic)):
        return _plain(value.tolist())
    if isinstance(value, (tuple, list)):
        return [_plain(each) for each in value]
    if isinstance(value, dict):
        return {str(name): _plain(each) for name, each in value.items()}
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    return value
