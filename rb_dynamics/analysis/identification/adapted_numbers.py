"""Numbers of which a fit determines only a combination, such as a product: some keep their value, others go with it.

A rotor shows the product of its inertia and its rate, and pushes of unknown scale the mass over that scale. With the
values of the scene for all of them a body flies another motion than the recording.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.analysis.identification.measurement_model import Model
from rb_dynamics.analysis.identification.residuals import Fit
from rb_dynamics.analysis.identification.stacked_rows import sane, stacked
from rb_dynamics.analysis.track import Array

# A scene has no scale of wrenches; of a rotor and a body users rather know the inertia. All others come after these.
_KEPT_FIRST = ("wrench_scale", "axial_inertia", "size", "mass", "center_of_mass")
# The part of a direction that no other number has.
_OWN = 0.05
# Times the misfit of the fit, and that of another that follows the recording as well.
_AS_WELL = 1.1
# Steps to the values that are kept, at most; and corrections of each.
_STEPS, _CORRECTIONS = 60, 8
# Of what is plausible, over noise: it keeps a number that does not count where it is.
_STILL = 1e-2


def kept_numbers(model: Model, unseen: Array, unknown: Sequence[int]) -> tuple[list[int], bool]:
    """Return those of the `unknown` parameters that can keep any value, and whether others must then go with them.

    These are as many as there are directions (p, k) `unseen` by the recordings in which the unknown ones change.
    """

    def place(k: int) -> int:
        name = next(n for n, block in model.layout.blocks.items() if block.at.start <= k < block.at.stop)
        parts = (name.partition(".")[0], name.rpartition(".")[2])
        return min((i for i, part in enumerate(_KEPT_FIRST) if part in parts), default=len(_KEPT_FIRST))

    rows, kept, ways = unseen.copy(), list[int](), list[Array]()
    for k in sorted(unknown, key=place):
        own = float(np.linalg.norm(rows[k]))
        if own > _OWN:
            kept.append(k)
            ways.append(unseen @ rows[k] / own)
            # What is left of the directions moves this number no more.
            rows -= np.outer(rows @ rows[k], rows[k]) / own**2
    others = np.delete(np.array(ways), kept, axis=1) if ways else np.zeros(0)
    return kept, bool(np.linalg.norm(others) > _OWN)


def adapted(model: Model, fit: Fit, kept: Sequence[int]) -> Array | None:
    """Return the parameters of a fit in which those `kept` are zero, as in the scene; None if there is none.

    They go there by steps, from each of which the others follow.
    """
    held = np.isin(np.arange(len(fit.z)), kept)
    most = _AS_WELL * float(fit.left @ fit.left) + len(fit.z)
    z, share, step = fit.z, 1.0, 1.0
    for _ in range(_STEPS):
        if not share:
            return z
        target = max(0.0, share - step)
        moved = _followed(model, fit, z, held, target * fit.z)
        if moved is None or moved[1] > most:
            step *= 0.5
        else:
            z, share, step = moved[0], target, 2.0 * step
    return None


def _followed(model: Model, fit: Fit, z: Array, held: NDArray[np.bool_], goal: Array) -> tuple[Array, float] | None:
    """Return parameters with those `held` at their `goal`, and their misfit; None if the motion diverges."""
    still = _STILL * np.eye(int((~held).sum()))
    misfit = np.inf
    for _ in range(_CORRECTIONS):
        left, by = stacked(list(model.predict(z)), fit.noise)
        if not sane(left, by):
            return None
        there = bool((z[held] == goal[held]).all())
        before, misfit = misfit, float(left @ left) if there else np.inf
        if there and abs(before - misfit) < 1e-3 * misfit:
            break
        change = np.where(held, goal - z, 0.0)
        wanted = np.append(-(left + by @ change), np.zeros(len(still)))
        change[~held] = np.linalg.lstsq(np.vstack([by[:, ~held], still]), wanted, rcond=None)[0]
        z = np.where(held, goal, z + change)
    return z, misfit
