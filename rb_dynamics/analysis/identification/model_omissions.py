"""What a fit lacks: whether a load that is not in the scene, or an error of a sensor, explains its residuals.

A small constant torque hides in the noise while it shifts the inertia by many standard errors: the fit adjusts its
parameters until the residuals are nearly white. So each candidate is added to the model, and one Gauss-Newton step is
taken with it, from the exact derivatives that the fit has anyway. Its numbers relative to their covariance give an F
statistic. If the residuals stay coloured with the candidate, the covariance of coloured noise, doubled, is used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from rb_dynamics.analysis.identification.estimation import settled
from rb_dynamics.analysis.identification.flights import ACCELERATION, ATTITUDE, RATES
from rb_dynamics.analysis.identification.measurement_model import DRAWN, Model
from rb_dynamics.analysis.identification.parameters import ParameterBlock, moments_and_axes
from rb_dynamics.analysis.identification.residual_whiteness import root_of, widened
from rb_dynamics.analysis.identification.residuals import Fit, fit_bands, residuals_of
from rb_dynamics.analysis.identification.stacked_rows import covariance_of, sane, stacked, triangle
from rb_dynamics.analysis.track import Array
from rb_dynamics.errors import LogError
from rb_dynamics.formats.yaml import document
from rb_dynamics.formats.yaml.problems import Problems
from rb_dynamics.loads.drag import LinearDrag
from rb_dynamics.loads.effect import Effect
from rb_dynamics.loads.gyrostat_rotor import Rotor
from rb_dynamics.loads.scheduled_wrench import ScheduledWrench
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.numerics.vector import ZERO
from rb_dynamics.scene.model import Scene
from rb_dynamics.scene.read import scene_of, with_true_text

CHANCE = 0.005
"""Of a flight of which the scene says everything, the chance that a load is found in it."""

TOLD = 0.3
"""A direction counts as determined if its standard error is at most this fraction of what is plausible."""

# Standard errors by which a drag may be negative.
_PUSHED = 3.0
# Of the least moment of the body, the inertia of a rotor that only its momentum tells of.
_ROTOR = 1e-3


@dataclass(frozen=True)
class Omission:
    """A load that the scene does not have, or an error of sensors that is not fitted, as the recordings show it.

    Attributes:
        what: in words.
        names: of its numbers among the parameters of a fit that has it.
        value: in SI units.
        standard_error: of each.
        unit: of all.
        chance: that a flight without it looks like this, times the number of those that were tried.
        shift: by how many of its standard errors it moves that number of the body which it moves most; infinite if
            without it nothing is known of the body.
        found: whether it is so sure that the fit has it, too.
        entry: for the effects of a scene; None for an error of sensors.
    """

    what: str
    names: tuple[str, ...]
    value: tuple[float, ...]
    standard_error: tuple[float, ...]
    unit: str
    chance: float
    shift: float
    found: bool
    entry: dict[str, Any] | None

    @property
    def significant(self) -> bool:
        """Whether it is farther from zero than its errors: where one step does not lead, it may be zero after all."""
        return float(np.sum((np.array(self.value) / self.standard_error) ** 2)) > len(self.value)

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "what": self.what,
            "names": list(self.names),
            "value": list(self.value),
            "standard_error": list(self.standard_error),
            "unit": self.unit,
            "chance": self.chance,
            "shift": self.shift if np.isfinite(self.shift) else None,
            "found": self.found,
            "effect": self.entry,
        }


class Candidate(NamedTuple):
    """A candidate that is tried.

    Attributes:
        what: in words.
        unit: of its numbers.
        kind: of the effect; "" of an error of sensors.
        frame_id: of a wrench.
        part: what of the effect it is; what to fit of an error of sensors.
        axial_inertia: of a rotor.
    """

    what: str
    unit: str
    kind: str
    frame_id: str
    part: str
    axial_inertia: float = 0.0

    def key(self, place: int) -> str:
        """Return what to fit, of a load as that effect of a scene."""
        if not self.kind:
            return self.part
        return f"effects[{place}]." + (f"schedule[0].{self.part}" if self.kind == ScheduledWrench.kind else self.part)

    def entry(self, value: Sequence[float]) -> dict[str, Any] | None:
        """Return an entry for the effects of a scene."""
        if not self.kind:
            return None
        if self.kind == Rotor.kind:
            x, y, z = value
            rotor = Rotor((0.0, 0.0, 1.0), self.axial_inertia, ((0.0, 0.0),)).with_momentum((x, y, z))
            axis, rate = list(rotor.axis_body), rotor.spin_rate[0][1]
            return {"type": self.kind, "axis_body": axis, "axial_inertia": self.axial_inertia, "spin_rate": rate}
        if self.kind != ScheduledWrench.kind:
            return {"type": self.kind, self.part: list(value)}
        return {"type": self.kind, "frame_id": self.frame_id, "schedule": [{"time": 0.0, self.part: list(value)}]}


class Trial(NamedTuple):
    """The result of one step with a load in the model.

    Attributes:
        candidate: what was tried.
        blocks: names of its parameters.
        step: of the parameters of the fit.
        own: its parameters.
        value: in SI units.
        standard_error: of each.
        chance: as of an `Omission`.
    """

    candidate: Candidate
    blocks: tuple[str, ...]
    step: Array
    own: Array
    value: Array
    standard_error: Array
    chance: float

    def omission(self, shift: float, found: bool = False) -> Omission:
        """Return it as part of the answer."""
        value, error = tuple(self.value.tolist()), tuple(self.standard_error.tolist())
        of = self.candidate
        return Omission(of.what, self.blocks, value, error, of.unit, self.chance, shift, found, of.entry(value))


def trials(model: Model, fit: Fit, known: Sequence[Trial] = ()) -> list[Trial]:
    """Return what each candidate, except those `known`, would explain of the residuals of a fit from single starts."""
    if fit.disturbance is not None:
        return []
    tried = [each for each in _candidates(model, fit.z) if each.what not in {trial.candidate.what for trial in known}]
    wide, keys = _with_loads(model, tried, fit.z)
    old = _places(model, wide)
    z = np.zeros(wide.layout.count)
    z[old] = fit.z
    roots, count, opened = [], 0, _left_open(model, fit)
    width = next(iter(opened.values())).shape[2] if opened else 0
    for block in wide.blocks(z):
        left, weighted = stacked(block, fit.noise)
        if not sane(left, weighted):
            return []
        moved = np.zeros((len(left), width))
        if opened:
            moved = np.vstack([opened[each.key][: len(each.left)].reshape(each.left.size, width) for each in block])
            opened |= {each.key: opened[each.key][len(each.left) :] for each in block}
        roots.append(triangle(np.column_stack([weighted, moved, left])))
        count += len(left)
    root = triangle(np.vstack(roots))
    found = []
    for candidate, key in zip(tried, keys, strict=True):
        blocks = _blocks(model, wide, key)
        if not blocks:
            continue
        scale, start = (np.concatenate([getattr(b, of) for b in blocks]) for of in ("scale", "start"))
        columns = np.concatenate([old, _columns(blocks)])
        part = root[:, columns]
        # As in the report of a fit: without a recording, each number is known to about what is plausible.
        covariance = covariance_of(part)
        step = -covariance @ (part.T @ root[:, -1])
        by_wheels = (covariance @ (part.T @ root[:, -1 - width : -1]))[len(old) :]
        of_wheels = by_wheels @ by_wheels.T
        of_load = covariance[len(old) :, len(old) :]
        smallest, largest = np.linalg.eigvalsh(of_load)[[0, -1]].tolist()
        if not 0.0 < smallest <= largest <= TOLD**2:
            # What the fit already has under another name, to rounding or nearly, is left out.
            continue
        freedom = max(1.0, count - len(columns))
        level = max(1.0, float(np.sum((root[:, -1] + part @ step) ** 2)) / freedom)
        of_load = of_load * level + of_wheels
        chance = _chance(step[len(old) :], of_load, freedom, len(tried))
        own = step[len(old) :]
        value, error = start + scale * own, scale * np.sqrt(np.diagonal(of_load))
        if candidate.kind == LinearDrag.kind and (value < -_PUSHED * error).any():
            # What adds energy is not drag.
            chance = 1.0
        if chance <= CHANCE:
            after = _after(model, fit, candidate, step)
            bands = fit_bands(after)
            if any(each.coloured for each in residuals_of(model, after, bands)):
                covariance, freedom = widened(root_of(covariance), bands)
                of_load = covariance[len(old) :, len(old) :] + of_wheels
                if float(np.linalg.eigvalsh(of_load)[-1]) > TOLD**2:
                    continue
                chance = _chance(step[len(old) :], of_load, freedom, len(tried))
                error = scale * np.sqrt(np.diagonal(of_load))
        names = tuple(block.name for block in blocks)
        found.append(Trial(candidate, names, step[: len(old)], own, value, error, chance))
    return found


def _left_open(model: Model, fit: Fit) -> dict[tuple[str, str, int], Array]:
    """Return by how many times the noise (n, 3, k) each sample may change as wheels turn otherwise than recorded.

    The sum of the squares over k is a variance. Empty without wheels, or where the motion is lost.
    """
    curved = model.with_curved_speeds()
    if curved is None:
        return {}
    here = {each.key: each.left for each in model.predict(fit.z, derivatives=False)}
    drawn = (*model.with_drawn_speeds(), *model.with_noisy_speeds())
    ways: dict[tuple[str, str, int], list[Array]] = {key: [] for key in here}
    for other, weight in ((curved, 1.0), *((each, DRAWN**-0.5) for each in drawn)):
        for each in other.predict(fit.z, derivatives=False):
            ways[each.key].append((each.left - here[each.key]) * weight / fit.noise[each.key])
    found = {key: np.stack(each, axis=-1) for key, each in ways.items()}
    return found if all(np.isfinite(each).all() for each in found.values()) else {}


def _after(model: Model, fit: Fit, candidate: Candidate, step: Array) -> Fit:
    """Return the fit after a step, to first order, with the parameters of a candidate after its own."""
    wide, (key,) = _with_loads(model, [candidate], fit.z)
    old = _places(model, wide)
    z = np.zeros(wide.layout.count)
    z[old] = fit.z
    columns = np.concatenate([old, _columns(_blocks(model, wide, key))])
    predicted = [each._replace(by=each.by[:, :, columns]) for each in wide.predict(z)]
    left, weighted = stacked(predicted, fit.noise)
    moved = [each._replace(left=each.left + each.by @ step).without_derivatives() for each in predicted]
    return fit._replace(predicted=moved, weighted=weighted, left=left + weighted @ step)


def best_with(model: Model, fit: Fit, tried: Sequence[Trial], loss: str) -> tuple[Trial, Model, Fit] | None:
    """Return the candidate that is certain and explains most, with model and fit; None if there is none.

    If several are certain, each is fitted to the end, as one step does not show which is right: the least information
    criterion of Schwarz wins.
    """
    sure = [_fitted_with(model, fit, trial, loss) for trial in tried if trial.chance <= CHANCE]
    return min(filter(None, sure), key=lambda each: _criterion(each[2]), default=None)


def _criterion(fit: Fit) -> float:
    """Return the information criterion of a fit, up to a constant."""
    logarithms = sum(each.left.size * np.log(fit.noise[each.key]) for each in fit.predicted)
    return float(2.0 * logarithms + len(fit.z) * np.log(len(fit.left)))


def _fitted_with(model: Model, fit: Fit, trial: Trial, loss: str) -> tuple[Trial, Model, Fit] | None:
    """Return the model with a candidate, as it is named there, and its fit; None if that follows no recording."""
    wide, (key,) = _with_loads(model, [trial.candidate], fit.z)
    blocks = _blocks(model, wide, key)
    z = np.zeros(wide.layout.count)
    z[_places(model, wide)] = fit.z + trial.step
    z[_columns(blocks)] = trial.own
    try:
        found = settled(wide, z, fit.noise, loss)
    except LogError:
        return None
    left = residuals_of(wide, found, fit_bands(found))
    if not all(each.follows for each in left):
        return None
    named = trial._replace(blocks=tuple(block.name for block in blocks))
    return named, wide, found._replace(starts=fit.starts, agreeing=fit.agreeing)


def _chance(value: Array, covariance: Array, freedom: float, tried: int) -> float:
    """Return the chance that one of the tested candidates is this far from zero."""
    from scipy.special import fdtrc

    statistic = float(value @ np.linalg.solve(covariance, value)) / len(value)
    return min(1.0, tried * float(fdtrc(len(value), freedom, statistic)))


def _candidates(model: Model, z: Array) -> list[Candidate]:
    """Return the candidates that these recordings may show and the fit does not have, for a body of parameters `z`."""
    frames, wrench, drag = model.scene.frames, ScheduledWrench.kind, LinearDrag.kind
    found = [
        Candidate("a constant torque in body axes", "N m", wrench, frames.body_frame, "torque"),
        Candidate("a constant torque in world axes", "N m", wrench, frames.world_frame, "torque"),
        Candidate("a linear drag of rotation", "N m s/rad", drag, "", "rotation"),
    ]
    if not any(key.endswith(".momentum_body") for key in model.fit):
        # Of its inertia the motion tells nothing: it only has to be a part of the body.
        bodies = (model.body(z).inertia, np.array(model.scene.body.inertia))
        part = _ROTOR * min(float(moments_and_axes(inertia)[0][0]) for inertia in bodies)
        found.append(Candidate("a rotor momentum in body axes", "N m s", Rotor.kind, "", "momentum_body", part))
    pushed = any(model.placed) or any(s.kind == ACCELERATION for f in model.flights for s in f.streams)
    if pushed:
        found += [
            Candidate("a constant force in body axes", "N", wrench, frames.body_frame, "force"),
            Candidate("a constant force in world axes", "N", wrench, frames.world_frame, "force"),
        ]
    if any(model.placed):
        found.append(Candidate("a linear drag of translation", "N s/m", drag, "", "translation"))
    gyro = any(s.kind == RATES for f in model.flights for s in f.streams)
    if gyro:
        found.append(Candidate("a bias of the gyro", "rad/s", "", "", "gyro_bias"))
    if gyro and _has_axes(model):
        found.append(Candidate("an alignment of the gyro", "rad", "", "", "gyro_alignment"))
    found.append(Candidate("a delay", "s", "", "", "delay"))
    found = [each for each in found if each.kind or each.part not in model.fit]
    drags = [i for i, effect in enumerate(model.scene.effects) if isinstance(effect, LinearDrag)]
    return [each for each in found if each.kind != drag or not any(each.key(i) in model.fit for i in drags)]


def _has_axes(model: Model) -> bool:
    """Return whether anything but a gyro and drag depends on the axes of the body: otherwise they are the gyro's."""
    sensors = any(s.kind in (ATTITUDE, ACCELERATION) for flight in model.flights for s in flight.streams)
    loads = any(isinstance(effect, (Rotor, ScheduledWrench)) for effect in model.scene.effects)
    return sensors or loads or any(flight.channels for flight in model.flights)


def _with_loads(model: Model, loads: Sequence[Candidate], z: Array) -> tuple[Model, list[str]]:
    """Return the model with loads, zero if the scene has none, and their keys."""
    scene, keys = model.scene, []
    for each in loads:
        if not each.kind:
            keys.append(each.part)
            continue
        # One drag has both of its parts.
        drag = next((i for i, effect in enumerate(scene.effects) if isinstance(effect, LinearDrag)), -1)
        there = drag if each.kind == LinearDrag.kind else -1
        keys.append(each.key(len(scene.effects) if there < 0 else there))
        if there < 0:
            scene = _with_effect(scene, each)
    wide = Model(scene, model.flights, (*model.fit, *keys), model.body(z))
    wide.turn = model.turn
    # The same numbers mean the same.
    for name, block in model.layout.blocks.items():
        wide.layout.blocks[name] = replace(block, at=wide.layout[name].at)
    return wide, keys


def _with_effect(scene: Scene, load: Candidate) -> Scene:
    """Return the scene with a load that is zero."""
    if with_true_text(scene) is not scene:
        # It was made in Python, and so is this.
        if load.kind == Rotor.kind:
            added: Effect = Rotor((0.0, 0.0, 1.0), load.axial_inertia, ((0.0, 0.0),))
        elif load.kind == ScheduledWrench.kind:
            added = ScheduledWrench(((0.0, Wrench(ZERO, ZERO, load.frame_id)),))
        else:
            added = LinearDrag()
        return replace(scene, effects=(*scene.effects, added))
    problems = Problems(scene.source)
    tree = document.parse(scene.text, problems)
    if isinstance(tree.value, dict):
        acting, entry = tree.value.get("effects"), document.from_python(load.entry((0.0, 0.0, 0.0)))
        given = acting.value if acting is not None and isinstance(acting.value, list) else []
        tree.value["effects"] = document.Node([*given, entry])
    return scene_of(tree, problems, scene.text, [f"with {load.what}"])


def _blocks(model: Model, wide: Model, key: str) -> list[ParameterBlock]:
    """Return the blocks that fitting `key`, too, adds to a model."""
    return [
        block
        for name, block in wide.layout.blocks.items()
        if name not in model.layout and (name == key or name.partition("[")[0].partition(".")[0] == key)
    ]


def _columns(blocks: Sequence[ParameterBlock]) -> npt.NDArray[np.int64]:
    """Return where the parameters of blocks are."""
    return np.concatenate([np.arange(block.at.start, block.at.stop, dtype=np.int64) for block in blocks])


def _places(model: Model, wide: Model) -> npt.NDArray[np.int64]:
    """Return where the parameters of a model are in one that has more."""
    found = np.zeros(model.layout.count, dtype=np.int64)
    for name, block in model.layout.blocks.items():
        at = wide.layout[name].at
        found[block.at] = np.arange(at.start, at.stop)
    return found
