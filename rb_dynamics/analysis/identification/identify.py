"""`identify`: what recordings say about a body, and how certain it is; see `Identification`.

What the recordings determine follows from the information matrix of the fit. Besides the recordings, each number is
assumed to be known to about its own size; it counts as determined if the recordings make it several times more certain.
"""

from __future__ import annotations

import contextlib
import functools
import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, cast

import numpy as np

from rb_dynamics.analysis.identification import rotations
from rb_dynamics.analysis.identification.adapted_numbers import adapted, kept_numbers
from rb_dynamics.analysis.identification.csv_flight import read_csv_flight
from rb_dynamics.analysis.identification.estimation import LOSSES, fitted
from rb_dynamics.analysis.identification.fit_consistency import (
    Estimate,
    chance_of_one_body,
    model_of_others,
    predicting,
)
from rb_dynamics.analysis.identification.flights import ATTITUDE, POSITION, RATES, Flight, read_flight
from rb_dynamics.analysis.identification.late_commands import late_commands
from rb_dynamics.analysis.identification.measurement_model import DRAWN, Body, Model, Predicted
from rb_dynamics.analysis.identification.model_omissions import CHANCE, TOLD, Omission, Trial, best_with, trials
from rb_dynamics.analysis.identification.multiple_shooting import TURN
from rb_dynamics.analysis.identification.noise_of_wheels import noise_of_wheels
from rb_dynamics.analysis.identification.other_units import (
    doubt_of_acceleration,
    doubt_of_center,
    doubt_of_inertia,
    doubt_of_mass,
)
from rb_dynamics.analysis.identification.parameters import AXES, PLACES, moments_and_axes
from rb_dynamics.analysis.identification.residual_whiteness import (
    DOUBT,
    Band,
    axes_of,
    gains_nothing,
    root_of,
    uneven,
    widened,
)
from rb_dynamics.analysis.identification.residuals import Fit, Residuals, fit_bands, residuals_of
from rb_dynamics.analysis.identification.stacked_rows import covariance_of, information
from rb_dynamics.analysis.read_track import TopicChoice
from rb_dynamics.analysis.track import Array
from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import LogError, SceneError, did_you_mean
from rb_dynamics.formats.yaml import document
from rb_dynamics.formats.yaml.problems import Problems
from rb_dynamics.loads.drag import QuadraticDrag
from rb_dynamics.loads.gyrostat_rotor import Rotor
from rb_dynamics.loads.reaction_wheel import ReactionWheel
from rb_dynamics.loads.scheduled_wrench import ScheduledWrench
from rb_dynamics.motion.fixed_step_kernel import Tally, counted_by
from rb_dynamics.numerics.argument_checks import items, shown, whole_number
from rb_dynamics.scene.model import Scene
from rb_dynamics.scene.overrides import apply_overrides
from rb_dynamics.scene.read import opened, scene_of, with_true_text
from rb_dynamics.sensors.imu import Imu

GROUPS = (
    "mass", "center_of_mass", "inertia", "inertia_ratios", "initial", "gyro_bias", "gyro_scale", "gyro_alignment",
    "accelerometer", "delay", "wrench_scale",
)  # fmt: skip
"""What can be fitted, in addition to every number of an effect by its dotted key."""

STARTS = 4
"""Starts of a fit: the body of the scene, and others."""

# The end of a key of the inertia of a rotor.
_AXIAL = ".axial_inertia"
# Of matrices: axes of one sensor that differ by rounding.
_SAME_AXES = 1e-9
# A number is determined if at most this part of its change is in undetermined directions.
_HIDDEN = 0.05
# Of what is plausible, the error of a direction that is not determined: a fit may stop anywhere in it.
_OPEN = 30.0
# Fits of one body differ by chance as much as that in one of ten thousand recordings only.
_CHANCE_OF_ONE_BODY = 1e-4
_BEGUN = (
    "it is not known what acts before the first command of a topic: if nothing does, the motion is not explained. The "
    "recording may have begun amid commands; only what was measured from then on is fitted"
)
# Times the noise that the quickest changes show, what noise alone leaves at most.
_ONLY_NOISE = 1.3
# More of them explain anything.
_MOST_OMISSIONS = 2
# What wheels may have done between samples is named if it is that many standard errors.
_MUCH = 0.5
# Of what is plausible, the variance below which errors are linear. Misfits that are this many times smaller or larger
# than those of linear errors are not.
_STRAIGHT, _LINEAR = 3e-3**2, 4.0
# Steps along a curved valley, at most.
_CORRECTIONS = 6
# Against the direction in which the inertia changes most: less is rounding.
_FLAT = 1e-10
_UNITS = {
    "mass": "kg", "center_of_mass": "m", "inertia": "kg m^2", "inertia_ratios": "", "rotation": "rad",
    "angular_velocity_body": "rad/s", "position_world": "m", "linear_velocity_world": "m/s", "gyro_bias": "rad/s",
    "gyro_scale": "", "gyro_alignment": "rad", "accelerometer_bias": "m/s^2", "accelerometer_position": "m",
    "delay": "s", "wrench_scale": "",
}  # fmt: skip
# Of all but quadratic drag, and of that.
_UNITS_OF_EFFECTS = {
    "rotation": ("N m s/rad", "N m s^2/rad^2"), "translation": ("N s/m", "N s^2/m^2"), "force": ("N",) * 2,
    "torque": ("N m",) * 2, "acceleration_world": ("m/s^2",) * 2, "medium_velocity_world": ("m/s",) * 2,
    "axial_inertia": ("kg m^2",) * 2, "spin_rate": ("rad/s",) * 2, "momentum_body": ("N m s",) * 2,
}  # fmt: skip


@dataclass(frozen=True)
class Parameter:
    """One number.

    Attributes:
        name: as in `inertia.xx`.
        value: in SI units; that of the scene where it is not known, unless it is `adapted`.
        standard_error: None if it is not known.
        interval: which holds the true value in 95 of 100 recordings; None if it is not known.
        unit: of the value; "" for a ratio.
        known: whether the recordings determine it.
        asked: whether it was asked for by name.
        adapted: of one that is not known, that it is not the value of the scene but goes with others that are: only a
            combination of them is known.
    """

    name: str
    value: float
    standard_error: float | None
    interval: tuple[float, float] | None
    unit: str
    known: bool
    asked: bool
    adapted: bool = False

    @property
    def taken(self) -> str:
        """What was done for the value of one that is not known, in a word."""
        return "adapted" if self.adapted else "kept"


@dataclass(frozen=True)
class Identification:
    """What recordings say about a body.

    Attributes:
        recordings: their names.
        parameters: the numbers, and how certain they are.
        covariance: of the parameters, in their order and units; NaN of those that are not known.
        body: with the values that are known, and those of the scene for the others.
        scene: with that body, the effects and the start of the first recording: it runs.
        residuals: what is left, by topic and kind.
        unknown_combinations: directions that are not determined, as text.
        advice: which recording would determine them.
        starts: fits that were tried.
        agreeing: how many of them found the same best one.
        converged: whether that fit converged.
        principal_errors: standard errors of the principal moments, ascending; infinite where not known.
        notes: on how the recordings were read, and what bears on the errors.
        predicted: residuals over time.
        omissions: loads that the scene does not have and errors of sensors that were not to be fitted: first those that
            were found, which the fit and the scene here have, then those that were tried.
        validation: residuals of recordings that were held out; of those the start alone is fitted.
        chance: that a fit to those differs at least as much from this one, if both are of one body, and 0 if no body
            explains them; None if they are predicted.
        zero_ns: the stamp in the first recording that is time 0 of `scene`.
    """

    recordings: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    covariance: Array
    body: RigidBody
    scene: Scene
    residuals: tuple[Residuals, ...]
    unknown_combinations: tuple[str, ...]
    advice: tuple[str, ...]
    starts: int
    agreeing: int
    converged: bool
    principal_errors: tuple[float, float, float]
    notes: tuple[str, ...]
    predicted: tuple[Predicted, ...]
    omissions: tuple[Omission, ...] = ()
    validation: tuple[Residuals, ...] = ()
    chance: float | None = None
    zero_ns: int = 0

    @property
    def explained(self) -> bool:
        """Whether the model explains the recordings up to noise; if not, errors may be larger than stated."""
        return all(each.explained for each in self.residuals)

    @property
    def validated(self) -> bool | None:
        """Whether the fit predicts the recordings that were held out; None without any, or if it cannot tell.

        It cannot if its own errors explain why it does not predict them.
        """
        if not self.validation or (self._mispredicted and (self.chance or 0.0) > _CHANCE_OF_ONE_BODY):
            return None
        return not self._mispredicted

    @property
    def _mispredicted(self) -> list[Residuals]:
        return _missed(self.validation, self.residuals)

    @property
    def unexplained(self) -> list[str]:
        """What the model does not explain or predict, as text."""
        return [
            f"the model does not explain this recording: residuals of {each.topic} {each.kind} are "
            f"{each.times_noise:.3g} times its noise and {100.0 * each.unexplained:.3g} % of its motion; "
            + (
                "intervals are doubled, and hold if what is missing is no larger where it does not show"
                if each.follows
                else "such a fit determines nothing: look for a torque, a sensor or a body far from that of the scene"
                + ", or positions in another unit than m" * (each.kind == POSITION)
            )
            for each in self.residuals
            if not each.explained
        ] + [
            f"the fit does not predict what was held out: residuals of {each.topic} {each.kind} are "
            f"{each.times_noise:.3g} times its noise and {100.0 * each.unexplained:.3g} % of its motion: "
            + (
                "the body, or what acts on it, is another there"
                if self.validated is False
                else "the fit is too uncertain to tell, as its own errors explain them; fit a longer recording, or more"
            )
            for each in self._mispredicted
        ]

    @property
    def passed(self) -> bool:
        """Whether the fit converged, everything asked for is known, and nothing held out contradicts it.

        Without names, anything at all is to be known. A fit that does not follow its recording determines nothing.
        """
        asked = [each.known for each in self.parameters if each.asked]
        told = all(asked) if asked else any(each.known for each in self.parameters if _of_body(each.name))
        return self.converged and told and self.validated is not False

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "parameters": [
                {
                    "name": each.name,
                    "value": each.value,
                    "standard_error": each.standard_error,
                    "interval": None if each.interval is None else list(each.interval),
                    "unit": each.unit,
                    "known": each.known,
                    "adapted": each.adapted,
                }
                for each in self.parameters
            ],
            "covariance": [[v if np.isfinite(v) else None for v in row] for row in self.covariance.tolist()],
            "mass": self.body.mass,
            "center_of_mass": list(self.body.center_of_mass),
            "inertia": [list(row) for row in self.body.inertia],
            "principal_moments": sorted(self.body.principal_moments),
            "principal_moments_standard_error": [e if np.isfinite(e) else None for e in self.principal_errors],
            "residuals": _by_topic(self.residuals),
            "unknown_combinations": list(self.unknown_combinations),
            "advice": list(self.advice),
            "starts": self.starts,
            "starts_agreeing": self.agreeing,
            "converged": self.converged,
            "explained": self.explained,
            "omissions": [each.as_dict() for each in self.omissions],
            "validation": _by_topic(self.validation),
            "validated": self.validated,
            "validation_chance": self.chance,
            "notes": list(self.notes),
        }


def _of_body(name: str) -> bool:
    mass_properties = ("mass", "center_of_mass", "inertia", "inertia_ratios")
    return name.partition(".")[0] in mass_properties or name.startswith("effects[")


_AS_WELL = 2.0
"""What is held out may be missed by so many times what is fitted is."""

_SHOWN = ("rms", "count", "unit", "noise", "white", "correlation", "times_noise", "unexplained")


def _by_topic(found: Sequence[Residuals]) -> dict[str, Any]:
    topics: dict[str, Any] = {}
    for each in found:
        part = {name: getattr(each, name) for name in _SHOWN}
        topics.setdefault(each.topic, {"rms": 0.0, "count": 0, "parts": {}})["parts"][each.kind] = part
    for topic in topics.values():
        parts = topic["parts"].values()
        topic["rms"] = float(np.sqrt(np.mean([part["rms"] ** 2 for part in parts])))
        topic["count"] = max(part["count"] for part in parts)
    return topics


def identify(
    scene: Scene | str | os.PathLike[str],
    recordings: Sequence[str | os.PathLike[str] | Flight] | str | os.PathLike[str],
    fit: Sequence[str] | None = None,
    *,
    commands: Sequence[str | os.PathLike[str]] = (),
    columns: Mapping[str, Sequence[str]] | None = None,
    topics: TopicChoice | None = None,
    validate: Sequence[str | os.PathLike[str] | Flight] = (),
    loss: str = "linear",
    starts: int = STARTS,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Identification:
    """Return what `recordings` say about the body of `scene`.

    Args:
        scene: the body as far as it is known, frames, channels and effects; or its file.
        recordings: logs of this package, or bags of pose, odometry, twist or gyro, with the commands, or .csv; of one
            body.
        fit: what to fit, of `GROUPS` and dotted keys of effects; None for the mass properties, as far as they are
            determined.
        commands: bags with the commands, where the recordings have none; of the same clock.
        columns: of .csv recordings, by what they hold, as in {"gyro": ("wx", "wy", "wz")}; see `QUANTITIES`.
        topics: which topics of bags of other programs describe the body; found by type and name otherwise.
        validate: recordings that are not fitted but predicted, from a start that is fitted to each.
        loss: of residuals: "linear", or one of scipy's that outliers hardly change.
        starts: number of starts.
        seed: of their choice.
        progress: called with the fraction done, 0 to 1.

    Raises:
        SceneError: the scene is not valid, has an effect that is not modelled, or `fit` names what there is not.
        LogError: a recording cannot be read, has no motion, or not the `topics`.
        ValueError: `loss` or `starts` is none.
    """
    known = opened(scene)
    expected = "paths of logs, one at least"
    given = [recordings] if isinstance(recordings, (str, os.PathLike)) else items(recordings, "recordings", expected)
    if not given:
        raise ValueError(f"recordings is empty, expected {expected}; name the log of a flight")
    if known.body.is_particle:
        raise SceneError(f"{known.source}: body: found a particle, expected a body to identify; add body.inertia")
    if loss not in LOSSES:
        raise ValueError(f"loss is {shown(loss)}, expected one of {', '.join(LOSSES)}; linear is least squares")
    if whole_number(starts, "starts", "write how many, such as 4") < 1:
        raise ValueError(f"starts is {starts}, expected 1 or more; write how many, such as 4")
    names = () if fit is None else tuple(items(fit, "fit", "names of what to fit"))
    _require_names(names, known)
    flights, held_out = (
        [
            piece.without_spikes()
            for each in some
            for piece in _flight(each, known, commands, columns, topics).without_repeats().pieces()
        ]
        for some in (given, validate)
    )
    _require_different([*flights, *held_out])
    for flight in (*flights, *held_out):
        flight.require_dense()
    flights, held_out = ([flight.require_agreement() for flight in some] for some in (flights, held_out))
    settings = _Settings(starts, loss, seed)
    result, report = _fitted_to_whole_or_part(known, flights, names, settings, progress)
    if held_out:
        bare, result = result, _validated(result, report, held_out, settings)
        if result.validated is False and (begun := _since_first_commands(held_out)):
            with contextlib.suppress(LogError):
                again = _validated(bare, report, begun, settings)
                result = replace(again, notes=(*again.notes, _BEGUN)) if _near_noise(again.validation) else result
    return result


class _Settings(NamedTuple):
    """Settings of fits, as of `identify`."""

    starts: int
    loss: str
    seed: int


def _since_first_commands(flights: Sequence[Flight]) -> list[Flight]:
    """Return the flights since their first commands; none if no flight has any that came after its start."""
    parts = [flight.since_first_commands() for flight in flights]
    return [part or flight for part, flight in zip(parts, flights, strict=True)] if any(parts) else []


def _fitted_to_whole_or_part(
    scene: Scene,
    flights: Sequence[Flight],
    names: Sequence[str],
    settings: _Settings,
    progress: Callable[[float], None] | None,
) -> tuple[Identification, _Report]:
    """Return the fit to flights; to what was measured since their first commands, if only that is explained."""
    try:
        found = _fitted_to(scene, flights, names, settings, progress)
    except LogError:
        if part := _fitted_to_part(scene, flights, names, settings):
            return part
        raise
    return found if found[0].explained else _fitted_to_part(scene, flights, names, settings) or found


def _fitted_to_part(
    scene: Scene, flights: Sequence[Flight], names: Sequence[str], settings: _Settings
) -> tuple[Identification, _Report] | None:
    """Return the fit to what was measured since the first commands; None if there is no such part or it fails, too."""
    begun = _since_first_commands(flights)
    if not begun:
        return None
    with contextlib.suppress(LogError):
        found, report = _fitted_to(scene, begun, names, settings)
        if _near_noise(found.residuals):
            return replace(found, notes=(_BEGUN, *found.notes)), report
    return None


def _near_noise(left: Sequence[Residuals]) -> bool:
    """Return whether no more is left than noise leaves: a part that is chosen must not hide what the whole shows."""
    return all(each.times_noise <= _ONLY_NOISE for each in left)


def _fitted_to(
    scene: Scene,
    flights: Sequence[Flight],
    names: Sequence[str],
    settings: _Settings,
    progress: Callable[[float], None] | None = None,
) -> tuple[Identification, _Report]:
    model = Model(scene, flights, names or _default(flights))
    # A fit waits for its kernel: without it each flight takes a hundred times as long.
    with counted_by(Tally()):
        return _completed(model, fitted(model, *settings, progress), names, settings.loss)


def _validated(
    result: Identification, report: _Report, held_out: Sequence[Flight], settings: _Settings
) -> Identification:
    """Return the same with what it leaves of recordings that were held out."""
    rest = predicting(report.model, report.z, result.scene, held_out)
    alone = fitted(rest, 1, settings.loss, settings.seed)
    left = tuple(residuals_of(rest, alone, fit_bands(alone)))
    result = replace(result, validation=left, notes=(*result.notes, *_notes_of(held_out)))
    if result.validated is not False:
        return result
    return replace(result, chance=_chance_of_one_body(report, held_out, *settings))


def _require_different(flights: Sequence[Flight]) -> None:
    """Check that no two flights have the same samples.

    Raises:
        LogError: two have: their noise would count as two, and the first would validate the second.
    """
    names: dict[tuple[tuple[str, bytes, bytes], ...], str] = {}
    for flight in flights:
        samples = tuple((each.kind, each.time_ns.tobytes(), each.values.tobytes()) for each in flight.streams)
        if samples in names:
            raise LogError(
                f"{flight.name} has the samples of {names[samples]}, expected recordings of different flights; "
                "give each recording once"
            )
        names[samples] = flight.name


def _notes_of(flights: Sequence[Flight]) -> list[str]:
    """Return the remarks on recordings, each with the name of its own."""
    return [f"{flight.name}: {note}" for flight in flights for note in flight.notes]


def _chance_of_one_body(report: _Report, held_out: Sequence[Flight], starts: int, loss: str, seed: int) -> float:
    """Return the chance that a fit to what was held out differs that much from `report`, if it is the same body.

    It is 0 if no body explains what was held out.
    """
    other = model_of_others(report.model, report.fit.z, held_out)
    try:
        found = _Report(other, fitted(other, starts, loss, seed), ())
    except LogError:
        return 0.0
    if _missed(found.residuals, report.residuals):
        return 0.0
    chance = chance_of_one_body(report.estimate, found.estimate)
    if chance > _CHANCE_OF_ONE_BODY or any(each.coloured for each in report.residuals):
        return chance
    # So far from a fit its errors may not be linear: what does the other body leave of its own recordings?
    rest = predicting(other, found.z, found.identification().scene, report.model.flights)
    alone, fit = fitted(rest, 1, loss, seed), report.fit
    left = sum(float(np.sum((each.left / fit.noise[each.key]) ** 2)) for each in alone.predicted)
    count = len(fit.z) - len(alone.z)
    from scipy.special import fdtrc

    more = max(0.0, left - float(fit.left @ fit.left))
    return max(chance, float(fdtrc(max(1, count), report.freedom, more / max(1, count))))


def _missed(held_out: Sequence[Residuals], fitted: Sequence[Residuals]) -> list[Residuals]:
    """Return what is held out and not explained, nor about as well as what was fitted is."""
    least: dict[str, float] = {}
    for each in fitted:
        least[each.kind] = max(each.times_noise, least.get(each.kind, 0.0))
    return [each for each in held_out if not each.explained and each.times_noise > _AS_WELL * least.get(each.kind, 0.0)]


def _completed(model: Model, fit: Fit, names: Sequence[str], loss: str) -> tuple[Identification, _Report]:
    """Return the result of a fit with what it lacks, and what it is from.

    That is joined segments if these leave only noise, and the whole is not explained or contradicts them.
    """
    result, report = _with_omissions(model, fit._replace(joined=None), names, loss)
    if fit.joined is None or (result.converged and all(each.only_noise for each in result.residuals)):
        return result, report
    of_segments = _Report(model, fit.joined._replace(starts=fit.starts, agreeing=fit.agreeing), names)
    found = of_segments.identification()
    if not _near_noise(found.residuals):
        return result, report
    whole = result.converged and result.explained
    if whole and chance_of_one_body(report.estimate, of_segments.estimate) > _CHANCE_OF_ONE_BODY:
        return result, report
    return found, of_segments


def _of_joints(disturbance: float) -> str:
    """Return a remark on segments that were joined."""
    return (
        "no motion from a single start was found that follows the recording to the end: "
        + (
            f"a small disturbance acted, which changed the rates by about {disturbance:.2g} rad/s in each {TURN:g} rad "
            "that the body turned. It is fitted as noise between joined segments"
            if disturbance
            else "errors grow too fast along it. Segments that are joined are fitted"
        )
        + ", and all intervals are doubled"
    )


def _with_omissions(model: Model, fit: Fit, names: Sequence[str], loss: str) -> tuple[Identification, _Report]:
    """Return the result of a fit, with the missing load if that explains all of the residuals, and what it is from.

    A load that is certain but explains only a part is not the truth either: the fit stays, and its errors are widened
    by as much as that load would move the numbers.
    """
    bare = _Report(model, fit, names)
    result = bare.identification()
    tried = first_tried = trials(model, fit)
    wide, found = bare, list[tuple[Trial, float]]()
    while (best := best_with(wide.model, wide.fit, tried, loss)) and len(found) < _MOST_OMISSIONS:
        found.append((best[0], wide.shift(best[0].step)))
        wide = _Report(best[1], best[2], names, doubtful=True)
        whole = wide.identification()
        tried = trials(wide.model, wide.fit, [trial for trial, _ in found])
        if all(each.only_noise for each in whole.residuals):
            sure = [wide.settled(trial).omission(shift, True) for trial, shift in found]
            if not all(each.significant for each in sure):
                break
            others = [trial.omission(wide.shift(trial.step)) for trial in tried]
            return replace(whole, omissions=(*sure, *others), notes=(*_of_omissions(sure), *whole.notes)), wide
    others = [trial.omission(bare.shift(trial.step)) for trial in first_tried]
    part = [each for each in others if each.chance <= CHANCE]
    if part:
        steps = [trial.step for trial in first_tried if trial.chance <= CHANCE]
        bare = _Report(model, fit, names, moved=steps)
        result = bare.identification()
    return replace(result, omissions=tuple(others), notes=(*_of_parts(part, bare), *result.notes)), bare


def _sized(omission: Omission) -> str:
    """Return what is missing, with its size."""
    values, errors = (", ".join(f"{v:.3g}" for v in some) for some in (omission.value, omission.standard_error))
    return f"{omission.what} of ({values}) ± ({errors}) {omission.unit}".rstrip()


def _of_parts(part: Sequence[Omission], report: _Report) -> list[str]:
    """Return a remark on loads that explain only a part of the residuals of a fit."""
    return [
        _sized(each)
        + ("" if each.entry is None else report.relative_to(each.unit))
        + ("" if each.significant else ", so that its size is not known,")
        + " that is not in the scene would explain a part of the residuals, not all"
        + (
            f", and would move numbers of the body by up to {each.shift:.2g} standard errors; the intervals are "
            "widened to include that"
            if np.isfinite(each.shift)
            else ""
        )
        for each in part
    ]


def _of_omissions(found: Sequence[Omission]) -> list[str]:
    """Return a remark on parameters that were fitted without being asked for."""
    notes = []
    for each in found:
        remedy = f"--fit {each.names[0].partition('[')[0].partition('.')[0]}"
        if each.entry is not None:
            remedy = f"effects: [{json.dumps(each.entry)}] in the scene and its numbers in --fit"
        notes.append(
            f"{_sized(each)} that is not in the scene explains the residuals: it is fitted, too, as "
            f"{', '.join(each.names)}. "
            + (
                f"Without it numbers of the body would be up to {each.shift:.2g} standard errors off. "
                if np.isfinite(each.shift)
                else "Without it nothing would be known of the body. "
            )
            + "Another cause may look the same, so all intervals are doubled; if you know that it "
            f"acts, write {remedy}"
        )
    return notes


def _flight(
    given: str | os.PathLike[str] | Flight,
    scene: Scene,
    commands: Sequence[str | os.PathLike[str]],
    columns: Mapping[str, Sequence[str]] | None,
    topics: TopicChoice | None,
) -> Flight:
    if isinstance(given, Flight):
        return given
    if not isinstance(given, (str, os.PathLike)):
        raise TypeError(f"one of the recordings is {shown(given)}, expected the path of a log; write its name")
    path, others = os.fspath(given), [os.fspath(each) for each in commands]
    if path.lower().endswith(".csv"):
        return read_csv_flight(path, scene, others, columns, () if topics is None else topics.wrenches)
    return read_flight(path, scene, others, topics)


def _require_names(names: Sequence[str], scene: Scene) -> None:
    for name in names:
        if name not in GROUPS and not str(name).startswith("effects["):
            mend = did_you_mean(name, GROUPS, "write one of them")
            raise SceneError(
                f"{scene.source}: fit: found {shown(name)} to be fitted, expected {', '.join(GROUPS)} or a number of "
                f"an effect as effects[0].rotation; {mend}"
            )


def _default(flights: Sequence[Flight]) -> tuple[str, ...]:
    gyro = any(stream.gyro for flight in flights for stream in flight.streams)
    return ("inertia", "inertia_ratios", "mass", "center_of_mass", "initial", *(["gyro_bias"] if gyro else []))


def _coloured(residuals: Sequence[Residuals], fit: Sequence[str]) -> list[str]:
    names = ", ".join(f"{each.topic} {each.kind}" for each in residuals)
    note = (
        f"residuals of {names} are not white: the noise is coloured, or something acts that the scene does not have. "
        "All intervals are doubled for that"
    )
    if "gyro_scale" not in fit and any(each.kind == RATES for each in residuals):
        note += "; a scale of the gyro is not looked for, and may move them by more: fit it with gyro_scale, too"
    return [note] if residuals else []


class _Report:
    """The result of a fit, with errors."""

    def __init__(
        self, model: Model, fit: Fit, names: Sequence[str], doubtful: bool = False, moved: Sequence[Array] = ()
    ) -> None:
        """Take a fit; errors are doubled if it is `doubtful`, and hold steps by which something else has `moved` it."""
        self.model, self.fit, self.names, self.z = model, fit, names, fit.z
        self.changes: list[Array] = []
        self.adapted: list[int] | None = []
        self.told: tuple[Parameter, ...] = ()
        self.local = self._local()
        weighted = fit.weighted @ self.local
        told, self.covariance = information(weighted), covariance_of(weighted)
        freedom = max(1.0, len(fit.left) - float(np.trace(self.covariance @ told)))
        bands = fit_bands(fit, self.local)
        self.residuals = residuals_of(model, fit, bands)
        if any(each.coloured for each in self.residuals):
            self.covariance, freedom = widened(root_of(self.covariance), bands)
        else:
            self.covariance = uneven(root_of(self.covariance), fit_bands(fit, self.local, axes_of))
            self.covariance *= DOUBT**2 if doubtful or fit.disturbance is not None else 1.0
        values, directions = np.linalg.eigh(self.covariance)
        self.follows = all(each.follows for each in self.residuals)
        bent = [
            self._bent(direction, told) if _STRAIGHT < value <= TOLD**2 else value > TOLD**2
            for value, direction in zip(values, directions.T, strict=True)
        ]
        self.unseen = directions[:, bent]
        if (constant := self._of_rates_and_biases(bands)).size:
            both, sizes, _ = np.linalg.svd(np.hstack([self.unseen, constant]), full_matrices=False)
            self.unseen = both[:, sizes > _HIDDEN]
        # What the recordings determine stays determined, with an error that covers what may have moved it.
        self.by_wheels, drawn = self._of_curved_speeds(weighted)
        self.by_noise, spread = noise_of_wheels(model, fit, self.local)
        self.late = late_commands(model, weighted, lambda other: self._misfit(self.z, other)[1])
        self.covariance = self.covariance + spread + self.late.spread
        # Along a direction that is not determined a fit may go far, and take determined numbers along a little.
        gone = self.unseen @ (self.unseen.T @ np.linalg.solve(self.local, self.z))
        steps = (np.linalg.solve(self.local, step) for step in moved)
        for near in (*steps, self.by_wheels, *drawn, self.by_noise, gone):
            self.covariance = self.covariance + np.outer(near, near)
        if not self.follows:
            # The only result is that the scene is not that of the recording: its values stay.
            self.unseen, self.z = directions, np.zeros(len(fit.z))
        from scipy.special import stdtrit

        self.freedom, self.quantile = freedom, float(stdtrit(freedom, 0.975))

    def _of_curved_speeds(self, weighted: Array) -> tuple[Array, list[Array]]:
        """Return how far near parameters move if wheels turn otherwise between samples of their speeds.

        First by a smooth curve; then by each of such curves drawn at random, over the root of their number. What is
        true is not known, so this says how much the samples leave open.
        """
        none, other = np.zeros(weighted.shape[1]), self.model.with_curved_speeds()
        here = None if other is None else self._misfit(self.z)[1]
        if other is None or here is None or len(here) != len(weighted):
            return none, []

        def step(other: Model) -> Array:
            there = self._misfit(self.z, other)[1]
            if there is None or not np.isfinite(there).all():
                return none
            found: Array = covariance_of(weighted) @ (weighted.T @ (there - here))
            return found

        return step(other), [step(each) / np.sqrt(DRAWN) for each in self.model.with_drawn_speeds()]

    def _of_rates_and_biases(self, bands: Sequence[Sequence[Band]]) -> Array:
        """Return the directions (p, k) in which rates and bias of gyros change alike, where these are not told apart.

        Where a constant fits as well, a body at rest and a large bias leave the same noise as a spin, far from each
        other. Without an attitude, only the motion tells a bias: bodies of other shapes, where the shape is not known,
        follow other biases, far from each other too.
        """
        known = not self._has("shape") or self._shape_told
        layout, ways = self.model.layout, [np.zeros((self.model.layout.count, 0))]
        for number, flight in enumerate(self.model.flights):
            biases = [f"gyro_bias[{number}].{stream.topic}" for stream in flight.streams]
            if not all(name in layout for name in biases):
                continue
            mine = [(each, of) for each, of in zip(self.fit.predicted, bands, strict=True) if each.key[2] == number]
            gain = sum(
                float(np.sum((each.measured - each.measured.mean(axis=0)) ** 2) - np.sum(each.left**2))
                / self.fit.noise[each.key] ** 2
                for each, _ in mine
            )
            if known and not gains_nothing(gain, 3 * len(mine), [of for _, of in mine]):
                continue
            way = np.zeros((layout.count, 3))
            way[layout[f"initial[{number}].angular_velocity_body"].at] = -np.eye(3)
            for name, stream in zip(biases, flight.streams, strict=True):
                way[layout[name].at] = stream.mount
            ways.append(way / np.linalg.norm(way, axis=0))
        return np.hstack(ways)

    def _bent(self, direction: Array, told: Array) -> bool:
        """Return whether parameters two standard errors away misfit otherwise than linear errors say.

        The numbers are then fitted to noise, as those of a body that hardly tumbles: anything may be the truth. The
        other directions follow, by Gauss-Newton steps, so that a valley that is merely curved counts as what it is.
        """
        way = np.linalg.solve(told + np.eye(len(told)), direction)
        step = 2.0 * way / np.sqrt(direction @ way)
        others = np.linalg.svd(direction[None])[2][1:].T
        slopes = self.fit.weighted @ (self.local @ others)
        normal = slopes.T @ slopes + np.eye(len(others.T))
        here = self._misfit(self.z)[0]
        for start in (-step, step):
            away, expected = start, 4.0
            for _ in range(_CORRECTIONS):
                z = self._moved(away)
                misfit, left = (np.nan, None) if z is None else self._misfit(z)
                if not np.isfinite(misfit):
                    # No body has these, or an effect refuses them: nearer to the solution some does not.
                    away, expected = 0.5 * away, 0.25 * expected
                    continue
                if expected / _LINEAR < misfit - here < expected * _LINEAR:
                    break
                if left is None or misfit < here:
                    return True
                away = away - others @ np.linalg.solve(normal, slopes.T @ left)
            else:
                if z is not None:
                    return True
        return False

    def _misfit(self, z: Array, model: Model | None = None) -> tuple[float, Array | None]:
        """Return -2 times the logarithm of the likelihood of parameters, up to a constant, and the residuals.

        Over noise, as in `Fit.left`; None if a profile has only the likelihood.
        """
        if self.fit.profile is not None:
            return self.fit.profile(z), None
        predicted = list((model or self.model).predict(z, derivatives=False))
        if self.fit.robust is not None:
            # Squares of outliers say nothing of parameters: at the solution they would fall to one side.
            return self.fit.robust(predicted)
        left = np.concatenate([np.ravel(each.left / self.fit.noise[each.key]) for each in predicted])
        return float(left @ left), left

    def _moved(self, step: Array) -> Array | None:
        """Return the parameters after a step of the coordinates near the solution; None if no body has them."""
        z = self.z + self.local @ step
        if self._has("shape"):
            at = self.model.layout["shape"].at
            change = self._inertia_by()[:, :, at] @ (self.local @ step)[at]
            try:
                z[at] = self.model.inertia.parameters(self.model.body(self.z).inertia + change)[1]
            except np.linalg.LinAlgError:
                return None
        return z

    @property
    def estimate(self) -> Estimate:
        """The parameters and their covariance, large where they are not determined."""
        open_ = _OPEN**2 * self.unseen @ self.unseen.T
        covariance = self.local @ (self.covariance + open_) @ self.local.T
        return Estimate(self.model.layout, self.z, covariance, self.freedom)

    def identification(self) -> Identification:
        parameters = self.told = tuple(self._parameters())
        body = self._body()
        _, axes = np.linalg.eigh(np.array(body.inertia))
        errors = [
            self._error(np.einsum("i,ijk,j->k", axis, self._inertia_by(), axis))
            if self._has("shape") and self._shape_told and self._told("size")
            else np.inf
            for axis in axes.T
        ]
        first, second, third = (float(e) for e in errors)
        return Identification(
            recordings=tuple(flight.name for flight in self.model.flights),
            parameters=parameters,
            covariance=self._covariance(parameters),
            body=body,
            scene=self._scene(body),
            residuals=tuple(self.residuals),
            unknown_combinations=tuple(self._unknown()),
            advice=tuple(self._advice(parameters)),
            starts=self.fit.starts,
            agreeing=self.fit.agreeing,
            converged=self.fit.converged,
            principal_errors=(first, second, third),
            notes=(
                *self._other_units(body),
                *self._of_adapted(parameters),
                *self._of_reversed(),
                *([] if self.fit.disturbance is None else [_of_joints(self.fit.disturbance)]),
                *_notes_of(self.model.flights),
                *self._of_wheels(),
                *self._of_times(),
                *_coloured([each for each in self.residuals if each.explained and each.coloured], self.model.fit),
            ),
            predicted=tuple(self.fit.predicted),
            zero_ns=self.model.flights[0].zero_ns,
        )

    def _of_wheels(self) -> list[str]:
        """Return remarks where much of the errors is noise in speeds of wheels, or what these did between samples."""
        between = (
            "what the wheels did between samples of their speeds is much of the errors: smooth there, and not linear, "
            "they would move numbers of the body by {:.2g} standard errors. The intervals are widened to include "
            "that; record the speeds more often"
        )
        noisy = (
            "noise in the speeds of the wheels is much of the errors: what they do looks less by it, which moves "
            "numbers of the body by {:.2g} standard errors. The intervals are widened to include that; turn the wheels "
            "faster"
        )
        told = [(between, self.by_wheels), (noisy, self.by_noise)]
        shifts = [(note, self.shift(self.local @ step)) for note, step in told]
        return [note.format(shift) for note, shift in shifts if _MUCH <= shift < np.inf]

    def _of_times(self) -> list[str]:
        """Return a remark where much of the errors is that nothing says when exactly commands acted."""
        values, directions = np.linalg.eigh(self.late.spread)
        moves = (np.sqrt(np.maximum(values, 0.0)) * directions).T
        shift = max((self.shift(self.local @ step) for step in moves), default=0.0)
        topics = sorted({c.topic for flight in self.model.flights for c in flight.channels if c.within_ns})
        told = (
            f"times of commands on {', '.join(topics)} are not known exactly, and by what the fit leaves are off by "
            f"{self.late.seconds:.2g} s (root mean square): much of the errors. The intervals are widened to include "
            "that; record commands with exact stamps"
        )
        return [told] if _MUCH <= shift < np.inf else []

    def _reversed(self) -> list[str]:
        """Return the inertias of rotors that were found negative: their momentum is opposite to that of the scene."""
        found = self.model.effects(self._kept)
        return [name for name, values in found.items() if name.endswith(_AXIAL) and values[0] < 0.0]

    def _of_reversed(self) -> list[str]:
        """Return a remark on rotors that the scene gives backwards."""
        told = "is negative: the momentum is opposite to axis and rate of the scene; in that found the axis is reversed"
        return [f"{name} {told}" for name in self._reversed()]

    def _of_adapted(self, parameters: Sequence[Parameter]) -> list[str]:
        """Return a remark on numbers of which a combination is determined."""
        if self.adapted is None:
            told = "only combinations of unknown numbers are determined, and none with those of the scene was found"
            return [f"{told}: a run of the scene with the result may not follow the recording"]
        names = ", ".join(each.name for each in parameters if each.adapted)
        told = "only combinations with numbers that keep the values of the scene are determined: they go with those"
        return [f"of {names} {told}"] if names else []

    def _other_units(self, body: RigidBody) -> list[str]:
        """Return a remark where the body found is that far from the body given, as other units would do."""
        given, notes = self.model.scene.body, list[str]()
        of_inertia = None
        if self._has("shape") and self._told("size"):
            of_inertia = float(np.trace(np.array(body.inertia)) / np.trace(np.array(given.inertia)))
        if self._has("mass") and self._told("mass") and (doubt := doubt_of_mass(body.mass, given.mass, of_inertia)):
            notes.append(f"the mass found is {doubt}; correct the units, or the scene if they are right")
        elif of_inertia is not None and (doubt := doubt_of_inertia(of_inertia)):
            notes.append(f"the inertia found is {doubt}; correct the units, or the scene if they are right")
        if self._has("center_of_mass") and self._told("center_of_mass"):
            notes.append(doubt_of_center(float(np.linalg.norm(body.center_of_mass)), self.model.arm))
        for name, values in self.model.effects(self._kept).items():
            size = float(np.linalg.norm(values))
            if name.endswith(".acceleration_world"):
                notes.append(doubt_of_acceleration(size))
            elif name.endswith(".force") and self.model.in_world(name):
                notes.append(doubt_of_acceleration(size / body.mass))
        return [note for note in notes if note]

    def shift(self, step: Array) -> float:
        """Return by how many of its standard errors a step moves that number of the body which it moves most.

        Of those that `identification` has determined; infinite if it has determined none of the body.
        """
        numbers = [(p.standard_error, by) for p, by in zip(self.told, self.changes, strict=True) if _of_body(p.name)]
        moved = [abs(float(by @ step)) / error for error, by in numbers if error]
        return max(moved, default=np.inf if numbers else 0.0)

    def settled(self, trial: Trial) -> Trial:
        """Return what was tried and is fitted now, with the values and errors of the fit."""
        names = [self._shown(name) for name in trial.blocks]
        mine = [p for p in self.told if any(p.name == name or p.name.startswith(f"{name}.") for name in names)]
        errors = [
            before if each.standard_error is None else each.standard_error
            for each, before in zip(mine, trial.standard_error.tolist(), strict=True)
        ]
        value = np.array([each.value for each in mine])
        return trial._replace(blocks=tuple(names), value=value, standard_error=np.array(errors))

    def _local(self) -> Array:
        """Return the derivatives of the parameters by coordinates near the solution in which all plausibly change by 1.

        They differ in the shape of the inertia: near a flat body its parameters run away while the inertia rests. Its
        coordinates are relative changes of the inertia.
        """
        found = np.eye(self.model.layout.count)
        if self._has("shape"):
            at = self.model.layout["shape"].at
            moments, axes = moments_and_axes(self.model.body(self.z).inertia)
            root = axes / np.sqrt(moments)
            relative = np.einsum("ia,ijk,jb->abk", root, self._inertia_by()[:, :, at], root).reshape(9, -1)
            _, sizes, turned = np.linalg.svd(relative, full_matrices=False)
            found[at, at] = turned.T / np.maximum(sizes, _FLAT * sizes[0])
        return found

    def _has(self, block: str) -> bool:
        return block in self.model.layout

    @functools.cached_property
    def _kept(self) -> Array:
        """The parameters, but zero, which is the value of the scene, where a number is not determined.

        A fit may stop anywhere there. Not of initial states, which have none in the scene, and not of the shape of the
        inertia, which is known as a whole or not at all. Where only a combination is determined, some numbers are zero,
        and others go with them, so that the scene flies the recording: `adapted` has their places, None if there are no
        such values.
        """
        kept, one = self.z.copy(), self._across_axes
        unknown = [
            k
            for name, block in self.model.layout.blocks.items()
            if name != "shape" and not name.startswith("initial[")
            for k in range(block.at.start, block.at.stop)
            if not np.isfinite(self._error(one[k]))
        ]
        kept[unknown] = 0.0
        held, coupled = kept_numbers(self.model, self.unseen, unknown)
        if coupled and self.follows:
            whole = self.fit.profile is None and (not self._has("shape") or self._shape_told)
            z = adapted(self.model, self.fit, held) if whole else None
            if z is None:
                self.adapted = None
                return kept
            self.adapted = [k for k in unknown if k not in held]
            kept[unknown] = z[unknown]
            for name, block in self.model.layout.blocks.items():
                if name.startswith("initial["):
                    kept[block.at] = z[block.at]
        return kept

    @functools.cached_property
    def _across_axes(self) -> Array:
        """The projection (p, p) of changes that leaves out the lengths of the axes of rotors, which do not count."""
        found = np.eye(len(self.z))
        for name in filter(self.model.is_axis, self.model.layout.blocks):
            at = self.model.layout[name].at
            axis = self.model.layout[name].values(self.z)
            found[at, at] -= np.outer(axis, axis) / (axis @ axis)
        return found

    def _error(self, by: Array) -> float:
        """Return the standard error of a number that changes by `by` with the parameters; infinite if unknown."""
        by = by @ self.local
        hidden = float(np.linalg.norm(by @ self.unseen))
        return float(np.sqrt(by @ self.covariance @ by)) if hidden <= _HIDDEN * float(np.linalg.norm(by)) else np.inf

    def _parameter(self, name: str, value: float, by: Array, group: str) -> Parameter:
        error = self._error(by)
        known = bool(np.isfinite(error)) and bool(by.any())
        self.changes.append(by)
        asked = group in self.names
        unit = self._unit(name)
        if not known:
            went = self.adapted or []
            goes = bool(by[went].any()) or (group == "inertia" and self.model.layout["size"].at.start in went)
            return Parameter(name, value, None, None, unit, False, asked, goes)
        half = self.quantile * error
        return Parameter(name, value, error, (value - half, value + half), unit, True, asked)

    def _unit(self, name: str) -> str:
        if name.startswith("effects["):
            number, _, rest = name.removeprefix("effects[").partition("].")
            found = [part for part in rest.split(".") if part in _UNITS_OF_EFFECTS]
            units = _UNITS_OF_EFFECTS[found[0]] if found else ("", "")
            return units[self.model.scene.effects[int(number)].kind == QuadraticDrag.kind]
        parts = [_UNITS.get(part, "") for part in name.split(".")[:2]]
        return next(filter(None, parts), "")

    def _covariance(self, parameters: Sequence[Parameter]) -> Array:
        """Return the covariance of the numbers, in the order in which they were made."""
        by = np.array(self.changes).reshape(len(parameters), -1) @ self.local
        found: Array = by @ self.covariance @ by.T
        unknown = np.array([not each.known for each in parameters], dtype=bool)
        found[unknown] = found[:, unknown] = np.nan
        return found

    def _inertia_by(self) -> Array:
        """Return the derivatives (3, 3, p) of the inertia by all parameters."""
        layout = self.model.layout
        by = np.zeros((3, 3, layout.count))
        _, by_six = self.model.inertia.derivative(*self.model.size_and_shape(self.z))
        for (i, j), row in zip(PLACES, by_six, strict=True):
            by[i, j, layout["size"].at] = by[j, i, layout["size"].at] = row[:1]
            by[i, j, layout["shape"].at] = by[j, i, layout["shape"].at] = row[1:]
        return by

    def _parameters(self) -> list[Parameter]:
        found: list[Parameter] = []
        body, layout = self.model.body(self._kept), self.model.layout
        if self._has("mass"):
            by = np.zeros(layout.count)
            by[layout["mass"].at] = body.mass
            found.append(self._parameter("mass", body.mass, by, "mass"))
        if self._has("center_of_mass"):
            found += self._values("center_of_mass", "center_of_mass")
        if self._has("shape"):
            by = self._inertia_by()
            given = np.array(self.model.scene.body.inertia)
            kept, fitted = (body.inertia, self.model.body(self.z).inertia) if self._shape_told else (given, given)
            trace = float(np.trace(fitted))
            ratios = fitted / trace
            ratios_by = (by - ratios[:, :, None] * np.trace(by)) / trace
            for group, values, changes in (
                ("inertia", kept, by),
                ("inertia_ratios", ratios, ratios_by),
            ):
                if group in self.model.fit or group == "inertia_ratios":
                    # Without a scale no moment is known, not even a product that is zero: its error is not. And where
                    # a direction of the shape is not determined, each number depends on where the fit stopped in it.
                    told = self._shape_told and (group != "inertia" or self._told("size"))
                    found += [
                        self._parameter(f"{group}.{axis}", float(values[i, j]), told * changes[i, j], group)
                        for axis, (i, j) in zip(AXES, PLACES, strict=True)
                    ]
        for name in layout.blocks:
            group = name.partition("[")[0].partition(".")[0]
            if group == "initial" and "initial" in self.model.fit:
                found += self._initial(name)
            elif group == "effects":
                found += self._values(name, name)
            elif group not in ("initial", "mass", "center_of_mass", "size", "shape"):
                found += self._values(name, "accelerometer" if group.startswith("accelerometer") else group)
        return found

    def _values(self, name: str, group: str) -> list[Parameter]:
        """Return the numbers of a block that stands for itself."""
        block = self.model.layout[name]
        values, one = block.values(self._kept), self._across_axes[block.at]
        if self.model.is_axis(name):
            length = np.linalg.norm(values)
            values, one = values / length, one / length
        shown_name = self._shown(name)
        found = []
        for k, value in enumerate(values.tolist()):
            by = one[k] * block.scale[k]
            axis = f".{'xyz'[k]}" if len(values) == 3 else ""
            found.append(self._parameter(shown_name + axis, value, by, group))
        return found

    def _shown(self, name: str) -> str:
        """Return the name of a block: the number of the flight is left out where there is one alone."""
        return name if len(self.model.flights) > 1 or name.startswith("effects[") else name.replace("[0].", ".")

    def _initial(self, name: str) -> list[Parameter]:
        if not name.endswith(".rotation"):
            return self._values(name, "initial")
        number = int(name.partition("[")[2].partition("]")[0])
        attitude, by_start = self.model.start_of(self.z, number)
        vector = rotations.logarithms(attitude[:4])
        by = np.linalg.inv(rotations.right_jacobians(vector)) @ by_start[:3]
        names = (f"{self._shown(name)}.{axis}" for axis in "xyz")
        return [self._parameter(n, float(v), row, "initial") for n, v, row in zip(names, vector, by, strict=True)]

    def _unknown(self) -> list[str]:
        """Return the directions of the body, effects and sensors that the recordings do not determine."""
        layout = self.model.layout
        kept = {
            name: block
            for name, block in layout.blocks.items()
            if not name.startswith("initial[") or "initial" in self.names
        }
        if "inertia" not in self.model.fit:
            kept.pop("size", None)
        columns = np.concatenate([np.arange(b.at.start, b.at.stop) for b in kept.values()] or [np.zeros(0, int)])
        names = [
            _coordinate(self._shown(name), k, block) for name, block in kept.items() for k in range(len(block.scale))
        ]
        if not len(columns):
            return []
        covariance = self._across_axes @ self.covariance @ self._across_axes
        values, vectors = np.linalg.eigh(covariance[np.ix_(columns, columns)])
        directions = vectors[:, values > TOLD**2]
        return [_combination(vector, names) for vector in _simple(directions).T]

    def _advice(self, parameters: Sequence[Parameter]) -> list[str]:
        """Return what recording would determine what this one does not; none if the model does not fit."""
        if not self.follows:
            return []
        unknown = {each.name.split(".")[0] for each in parameters if not each.known}
        ratios = [p for p in parameters if p.name.startswith("inertia_ratios")]
        found = []
        if "mass" in unknown:
            found.append(
                "mass: record position or velocity while a known force acts; neither gravity nor does rotation"
            )
        if "center_of_mass" in unknown:
            found.append("center_of_mass: record the position of the body origin while the body turns about two axes")
        if "inertia" in unknown:
            if all(p.known for p in ratios):
                found.append(
                    "inertia: the motion determines only ratios; record a flight in which a known torque acts, or a "
                    "rotor of known momentum turns"
                )
            else:
                found.append(f"inertia: {self._axis_to_excite()}")
        if "initial" in unknown:
            found.append("initial: record a pose; rates alone determine neither position nor attitude")
        return found

    def _axis_to_excite(self) -> str:
        """Return about which axes the body hardly turned."""
        spin = _rates_of(self.model)
        values, axes = np.linalg.eigh(spin)
        weak = [axis for value, axis in zip(values, axes.T, strict=True) if value < 0.05 * values[-1]]
        if not weak:
            return (
                "the rates hardly change; throw it so that it tumbles, or turn it by known torques about three axes in "
                "turn"
            )
        named = " and ".join("(" + ", ".join(f"{x:.2f}" for x in _upwards(axis)) + ")" for axis in weak)
        return (
            f"it hardly turned about the body axes {named}; spin it about these, or push it about them by known torques"
        )

    def _body(self) -> RigidBody:
        found, inertia = self.model.body(self._kept), self.model.scene.body.inertia
        # What is not determined stays as it was given, to the bit.
        if self._has("shape") and self._shape_told:
            inertia = (0.5 * (found.inertia + found.inertia.T)).tolist()
        return RigidBody.from_matrix(found.mass, inertia, found.center_of_mass.tolist())

    @property
    def _shape_told(self) -> bool:
        """Whether every direction of the shape of the inertia is determined."""
        return float(np.linalg.norm(self.unseen[self.model.layout["shape"].at])) <= _HIDDEN

    def relative_to(self, unit: str) -> str:
        """Return what a load of this unit is relative to: the mass or inertia that was kept, as it is not known."""
        name, said = ("size", "inertia") if unit.startswith("N m") else ("mass", "mass")
        return f", for the {said} kept," if self._has(name) and not self._told(name) else ""

    def _told(self, name: str) -> bool:
        by = np.zeros(self.model.layout.count)
        by[self.model.layout[name].at] = 1.0
        return bool(np.isfinite(self._error(by)))

    def _speeds(self) -> dict[str, object]:
        """Return by their keys the speeds that wheels had where the first recording begins, as far as a scene may."""
        scene, flight = self.model.scene, self.model.flights[0]
        if flight.wheels is None:
            return {}
        of, found = iter(flight.wheels.speeds.T), dict[str, object]()
        for number, wheel in enumerate(scene.actuators):
            if isinstance(wheel, ReactionWheel):
                speed = float(np.interp(flight.span_ns[0], flight.wheels.time_ns, next(of)))
                found[f"actuators[{number}].speed"] = min(max(speed, -wheel.max_speed), wheel.max_speed)
        return found

    def _bias_of_imu(self) -> dict[str, object]:
        """Return the bias of the gyro by its key; of several in recordings or scene it is not told whose it is."""
        scene, flights = self.model.scene, enumerate(self.model.flights)
        gyros = [
            (number, each) for number, flight in flights for each in flight.streams if each.gyro and each.kind == RATES
        ]
        if len(gyros) != 1:
            return {}
        name, mount = f"gyro_bias[{gyros[0][0]}].{gyros[0][1].topic}", gyros[0][1].mount

        def along(imu: Imu) -> bool:
            turned = rotations.matrices(np.array(imu.fixed(scene.frames).orientation_xyzw)).T
            return bool(np.allclose(turned, mount, rtol=0.0, atol=_SAME_AXES))

        imus = [k for k, each in enumerate(scene.sensors) if isinstance(each, Imu) and along(each)]
        if len(imus) != 1 or name not in self.model.layout or not self._told(name):
            return {}
        return {f"sensors[{imus[0]}].gyro.bias": self.model.layout[name].values(self.z).tolist()}

    def _scene(self, body: RigidBody) -> Scene:
        """Return the scene with what was found, as text that runs."""
        scene, layout = self.model.scene, self.model.layout
        overrides: dict[str, object] = {}
        if self._has("mass") or self._has("center_of_mass") or self._has("shape"):
            overrides = {
                "body.mass": body.mass,
                "body.center_of_mass": list(body.center_of_mass),
                "body.inertia": {"matrix": [list(row) for row in body.inertia]},
            }
        for name, values in self.model.effects(self._kept).items():
            number, _, key = name.removeprefix("effects[").partition("].")
            rotor = scene.effects[int(number)]
            if key == "momentum_body" and isinstance(rotor, Rotor):
                if self._kept[layout[name].at].any():
                    turned = rotor.with_momentum(tuple(values.tolist()))
                    overrides[f"effects[{number}].axis_body"] = list(turned.axis_body)
                    overrides[f"effects[{number}].spin_rate"] = turned.spin_rate[0][1]
                continue
            # Drag takes energy out: a negative one comes from noise and is set to zero.
            least = 0.0 if name.endswith((".rotation", ".translation")) else -np.inf
            kept = np.maximum(values, least).tolist()
            overrides[name] = kept if len(kept) > 1 else kept[0]
        # A scene takes no negative one.
        for name in self._reversed():
            found, axis = self.model.effects(self._kept), name.replace(_AXIAL, ".axis_body")
            given: Any = scene.effects[int(name.removeprefix("effects[").partition("]")[0])]
            overrides[name] = -float(found[name][0])
            overrides[axis] = [-float(x) for x in found.get(axis, given.axis_body)]
        state, _ = self.model.start_of(self._kept, 0)
        overrides |= self._bias_of_imu()
        overrides["initial.orientation"] = dict(
            zip("xyzw", (state[:4] / np.linalg.norm(state[:4])).tolist(), strict=True)
        )
        overrides["initial.angular_velocity_body"] = state[4:7].tolist()
        if self.model.placed[0]:
            for key in ("position_world", "linear_velocity_world"):
                overrides[f"initial.{key}"] = layout[f"initial[0].{key}"].values(self._kept).tolist()
        overrides |= self._speeds()
        if with_true_text(scene) is not scene:
            return _changed(scene, body, overrides)
        problems = Problems(scene.source)
        tree = document.parse(scene.text, problems)
        apply_overrides(tree, overrides, problems)
        return scene_of(tree, problems, scene.text, ["what was identified"])


def _changed(scene: Scene, body: RigidBody, overrides: Mapping[str, Any]) -> Scene:
    """Return a scene that was made or changed in Python with what was found; no text describes it."""
    start: dict[str, Any] = {
        key.removeprefix("initial."): tuple(value) for key, value in overrides.items() if key.startswith("initial.")
    }
    start["orientation_xyzw"] = tuple(overrides["initial.orientation"][axis] for axis in "xyzw")
    del start["orientation"]
    effects, sensors, actuators = list(scene.effects), list(scene.sensors), list(scene.actuators)
    for key, value in overrides.items():
        if key.startswith("actuators["):
            place = int(key.removeprefix("actuators[").partition("]")[0])
            actuators[place] = replace(cast("ReactionWheel", actuators[place]), speed=value)
        if key.startswith("sensors["):
            place = int(key.removeprefix("sensors[").partition("]")[0])
            imu = cast("Imu", sensors[place])
            sensors[place] = replace(imu, gyro=replace(imu.gyro, bias=tuple(value)))
        if key.startswith("effects["):
            number, _, name = key.removeprefix("effects[").partition("].")
            given = tuple(value) if isinstance(value, list) else value
            given = ((0.0, value),) if name == "spin_rate" else given
            effect = effects[int(number)]
            if isinstance(effect, ScheduledWrench):
                k, _, part = name.removeprefix("schedule[").partition("].")
                entries = [
                    (time, replace(wrench, **cast(Any, {part: given})) if i == int(k) else wrench)
                    for i, (time, wrench) in enumerate(effect.entries)
                ]
                name, given = "entries", tuple(entries)
            effects[int(number)] = replace(effect, **{name: given})  # type: ignore[type-var]
    state = replace(scene.initial, **start)
    devices = {"effects": tuple(effects), "actuators": tuple(actuators), "sensors": tuple(sensors)}
    return with_true_text(replace(scene, body=body, initial=state, text="", **cast(Any, devices)))


def _coordinate(name: str, k: int, block: Any) -> str:
    if name == "size":
        return "scale of the inertia (all moments by one factor)"
    if name == "shape":
        return f"shape of the inertia [{k}]"
    return f"{name}.{'xyz'[k]}" if len(block.scale) == 3 else name


def _simple(directions: Array) -> Array:
    """Return a basis of the same space with as many zeros as there can be: its reduced row echelon form."""
    rows = directions.T.copy()
    count, place = len(rows), 0
    for column in range(rows.shape[1]):
        if place == count:
            break
        pivot = place + int(np.abs(rows[place:, column]).argmax())
        if abs(rows[pivot, column]) < 1e-2:
            continue
        rows[[place, pivot]] = rows[[pivot, place]]
        rows[place] /= rows[place, column]
        for other in range(count):
            if other != place:
                rows[other] -= rows[other, column] * rows[place]
        place += 1
    found: Array = (rows / np.linalg.norm(rows, axis=1, keepdims=True)).T
    return found


def _combination(vector: Array, names: Sequence[str]) -> str:
    order = np.argsort(-np.abs(vector), kind="stable")
    kept = [k for k in order.tolist() if abs(vector[k]) >= 0.05]
    if len(kept) == 1:
        return str(names[kept[0]])
    sign = 1.0 if vector[kept[0]] > 0.0 else -1.0
    return " ".join(f"{sign * float(vector[k]):+.2f} {names[k]}" for k in kept)


def _upwards(axis: Array) -> Array:
    """Return an axis with its largest component positive."""
    found: Array = axis * np.sign(axis[int(np.abs(axis).argmax())]) + 0.0
    return found


def _rates_of(model: Model) -> Array:
    """Return the mean of w w^T over the measured rates, body axes."""
    streams = [stream for flight in model.flights for stream in flight.streams]
    rows = [stream.values @ stream.mount for stream in streams if stream.kind == RATES and not stream.world]
    if not rows:
        rows = [rotations.between(s.values[:-1], s.values[1:]) for s in streams if s.kind == ATTITUDE]
    every = np.vstack(rows) if rows else np.zeros((1, 3))
    found: Array = every.T @ every / len(every)
    return found


__all__ = ["GROUPS", "STARTS", "Body", "Identification", "Parameter", "identify"]
