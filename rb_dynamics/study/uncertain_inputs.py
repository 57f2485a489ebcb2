"""`uncertain_numbers`: which numbers of state and body are uncertain, and by how much: by name, or of a file or fit."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from rb_dynamics.analysis.identification.identify import Identification
from rb_dynamics.analysis.identification.parameters import AXES
from rb_dynamics.analysis.track import Array
from rb_dynamics.errors import LogError, SceneError
from rb_dynamics.formats.yaml.document import parse, plain
from rb_dynamics.formats.yaml.problems import Problems
from rb_dynamics.loads.gyrostat_rotor import Rotor
from rb_dynamics.loads.scheduled_wrench import ScheduledWrench
from rb_dynamics.numerics.argument_checks import shown
from rb_dynamics.scene.model import Scene

Uncertain: TypeAlias = "Mapping[str, object] | str | os.PathLike[str] | Identification"

STATE = ("orientation", "angular_velocity_body", "position_world", "linear_velocity_world")
"""Parts of a first state."""

# The largest standard deviation: squares of larger ones, and of what follows from them, are beyond double precision.
_MOST = 1e100
# Part of a standard deviation squared by which rounding may make a variance negative.
_ROUNDED = 1e-6


class UncertainNumbers(NamedTuple):
    """What is uncertain: names, their covariance, and what is taken as exact."""

    names: tuple[str, ...]
    matrix: Array
    exact: tuple[str, ...] = ()


def uncertain_numbers(
    uncertain: Uncertain | None, sigmas: Mapping[str, object] | None, scene: Scene
) -> UncertainNumbers:
    """Return what `uncertain` and `sigmas` say, for a run of `scene`; see `covariance`.

    Raises:
        LogError: the file cannot be read.
        SceneError: what is in it, a name or a value is wrong, or nothing is uncertain.
    """
    above = _given(sigmas, "sigma", scene) if sigmas else UncertainNumbers((), np.zeros((0, 0)))
    below = UncertainNumbers((), np.zeros((0, 0))) if uncertain is None else _given(uncertain, "uncertain", scene)
    # A fit gives the start as a rotation vector.
    said = {name.replace("orientation", "rotation") for name in above.names}
    kept = [k for k, name in enumerate(below.names) if name.replace("orientation", "rotation") not in said]
    matrix = np.zeros((len(kept) + len(above.names),) * 2)
    matrix[: len(kept), : len(kept)] = below.matrix[np.ix_(kept, kept)]
    matrix[len(kept) :, len(kept) :] = above.matrix
    names = (*(below.names[k] for k in kept), *above.names)
    if not matrix.any():
        raise SceneError("found nothing uncertain, expected a standard deviation above 0; give one, such as mass: 0.1")
    exact = tuple(name for name in below.exact if name.replace("orientation", "rotation") not in said)
    return UncertainNumbers(names, matrix, exact)


def _given(uncertain: Uncertain, source: str, scene: Scene) -> UncertainNumbers:
    """Return what is uncertain."""
    if isinstance(uncertain, Identification):
        uncertain = uncertain.as_dict()
    if isinstance(uncertain, (str, os.PathLike)):
        source = str(uncertain)
        try:
            text = Path(uncertain).read_text(encoding="utf-8")
            # A fit of many numbers is beyond the limits of what people write.
            found = json.loads(text) if '"parameters"' in text else _written(text, source)
        except (OSError, ValueError) as error:
            raise LogError(
                f"cannot read {source}: {error}; give the output of identify --json, or a YAML file"
            ) from error
    else:
        found = uncertain
    if not isinstance(found, Mapping) or not found:
        raise SceneError(f"{source}: found {shown(found)}, expected standard deviations by name, such as mass: 0.1")
    if isinstance(found.get("parameters"), list):
        return _of_fit(found, source, scene)
    names: list[str] = []
    sigmas: list[float] = []
    for name, value in found.items():
        each = _named(str(name).removeprefix("body."), value, scene, source)
        names += each
        sigmas += each.values()
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise SceneError(f"{source}: found {twice} twice, expected it once; leave out one of them")
    return UncertainNumbers(tuple(names), np.diag(np.square(sigmas)))


def _written(text: str, source: str) -> object:
    problems = Problems(source)
    document = parse(text, problems, "file of standard deviations", "mass")
    if problems:
        raise problems.error()
    return plain(document)


def _named(name: str, value: object, scene: Scene, source: str) -> dict[str, float]:
    """Return the standard deviation of each number that `name` stands for.

    Raises:
        SceneError: there is no such name, or the value does not fit.
    """
    whole, axes = name, _axes(name, scene)
    if axes is None and "." in name:
        whole, _, axis = name.rpartition(".")
        axes = _axes(whole, scene)
        axes = (axis,) if axes is not None and axis in axes else None
    if axes is None:
        known = [*(f"initial.{part}" for part in STATE), "mass", "center_of_mass", "inertia", "wrench_scale.TOPIC"]
        raise SceneError(
            f"{source}: found {name!r}, expected one of {', '.join(known)}, a number of an effect as "
            "effects[0].rotation, or one axis of them as inertia.xx; correct the name"
        )
    values = value if isinstance(value, (list, tuple)) else [value] * len(axes)
    good = len(values) == len(axes) and all(
        isinstance(v, (int, float)) and not isinstance(v, bool) and 0.0 <= v <= _MOST for v in values
    )
    if not good:
        many = "" if len(axes) == 1 else f", or a list of {len(axes)} ({', '.join(axes)})"
        raise SceneError(
            f"{source}: {name}: found {shown(value)}, expected a standard deviation, 0 or more, up to {_MOST:g}, in "
            f"SI units{many}; correct it"
        )
    return {f"{whole}.{axis}" if axis else whole: float(v) for axis, v in zip(axes, values, strict=True)}


def _axes(name: str, scene: Scene) -> tuple[str, ...] | None:
    """Return the parts of a number of several, ("",) of a single one; None if there is no such name."""
    if name == "mass" or name.startswith("wrench_scale."):
        return ("",)
    if name == "inertia":
        return AXES
    if name == "center_of_mass" or name in {f"initial.{part}" for part in STATE}:
        return tuple("xyz")
    match = re.fullmatch(r"effects\[([0-9]{1,6})\]\.(?:schedule\[([0-9]{1,6})\]\.)?(\w+)", name)
    if match is None or int(match[1]) >= len(scene.effects):
        return None
    effect: Any = scene.effects[int(match[1])]
    parts: tuple[str, ...] = (*effect.keys, *["momentum_body"] * isinstance(effect, Rotor))
    if match[2] is not None:
        entries = effect.entries if isinstance(effect, ScheduledWrench) else ()
        effect = entries[int(match[2])][1] if int(match[2]) < len(entries) else None
        parts = ("force", "torque")
    value = getattr(effect, match[3], None) if match[3] in parts else None
    if not isinstance(value, (int, float, tuple)):
        return None
    return tuple("xyz") if isinstance(value, tuple) and len(value) == 3 else ("",)


def _of_fit(found: Mapping[str, Any], source: str, scene: Scene) -> UncertainNumbers:
    """Return the numbers of a fit that change a motion.

    Raises:
        SceneError: it is not what `identify --json` prints, or of a scene with other effects.
    """
    try:
        parameters = [(str(p["name"]), bool(p["known"]), p["standard_error"]) for p in found["parameters"]]
        errors = [math.nan if error is None else float(error) for *_, error in parameters]
        rows = found.get("covariance") or np.diag(np.square(errors)).tolist()
        matrix = np.array([[math.nan if v is None else float(v) for v in row] for row in rows])
        trace = float(np.trace(np.array(found["inertia"], dtype=np.float64)))
        matrix = matrix.reshape(len(parameters), len(parameters))
    except (KeyError, TypeError, ValueError) as error:
        raise SceneError(
            f"{source}: found no output of identify --json ({error}), expected one; make it again"
        ) from error
    names = [name.replace("initial[0].", "initial.") for name, *_ in parameters]
    told = {name for name, (_, known, _) in zip(names, parameters, strict=True) if known}
    # Without a scale the moments are not known, but their ratios are; the motion without torque needs no more.
    scale = np.ones(len(names))
    if "inertia.xx" not in told and "inertia_ratios.xx" in told:
        for k, name in enumerate(names):
            if name.startswith("inertia_ratios."):
                names[k], scale[k] = name.replace("_ratios", ""), trace
            elif name.startswith("inertia."):
                names[k] = f"scale of the {name}"
    moving = ("mass", "center_of_mass.", "inertia.", "initial.", "effects[", "wrench_scale.", "scale of the inertia.xx")
    kept = [k for k, name in enumerate(names) if name.startswith(moving)]
    known = [k for k in kept if parameters[k][1]]
    unknown = [names[k].replace("inertia.xx", "inertia") for k in kept if k not in known]
    for name in (name for name in names if name.startswith("effects[")):
        if _axes(name, scene) is None and _axes(name.rpartition(".")[0], scene) is None:
            raise SceneError(
                f"{source}: found {name} in the fit, expected numbers of the effects of the scene; simulate the scene "
                "that identify wrote with --out"
            )
    part = (scale[:, None] * matrix * scale)[np.ix_(known, known)]
    if not _is_covariance(part):
        raise SceneError(
            f"{source}: the covariance of {', '.join(names[k] for k in known)} is no covariance, expected a "
            "matrix of finite numbers that is symmetric and positive semidefinite; write it again with identify --json"
        )
    return UncertainNumbers(tuple(names[k] for k in known), part, tuple(unknown))


def _is_covariance(matrix: Array) -> bool:
    """Return whether a matrix (n, n) is finite, symmetric and positive semidefinite, but for rounding."""
    variances = np.diagonal(matrix)
    if not (np.isfinite(matrix).all() and ((variances >= 0.0) & (variances <= _MOST**2)).all()):
        return False
    sizes = np.sqrt(np.where(variances > 0.0, variances, 1.0))
    shares = matrix / sizes[:, np.newaxis] / sizes
    return bool(
        np.allclose(shares, shares.T, rtol=0.0, atol=_ROUNDED)
        and np.linalg.eigvalsh(shares).min(initial=0.0) >= -_ROUNDED
    )
