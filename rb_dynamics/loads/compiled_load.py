"""`EffectLoad`: the effects of the package as numbers, and their load as a kernel evaluates it.

The functions are those of the effects themselves, so the bits are those of plain Python. Those of effects that are not
listed here, such as those of plug-ins, are called by address, see `plugin_load.py`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.loads.buoyancy import Buoyancy, Lift, lifted
from rb_dynamics.loads.central_gravity import Attraction, CentralGravity, attracted, time_to_fall
from rb_dynamics.loads.drag import LinearDrag, QuadraticDrag, Resistance, resisted, slowed
from rb_dynamics.loads.effect import Effect, Point
from rb_dynamics.loads.gradual_wrench import Transient, aged, with_acting
from rb_dynamics.loads.gradual_wrench import sight as sight_of_transient
from rb_dynamics.loads.gyrostat_rotor import Rotor, Spin, reaction
from rb_dynamics.loads.magnetic_field import MagneticField, Source, flux_density
from rb_dynamics.loads.magnetorquer import turned_in_field
from rb_dynamics.loads.plugin_load import (
    PluginFunction,
    flat,
    function_at,
    load_at,
    load_on_numbers,
    numbers_of,
    scale_at,
    scale_on_numbers,
)
from rb_dynamics.loads.scheduled_wrench import ScheduledWrench
from rb_dynamics.loads.uniform_gravity import UniformGravity
from rb_dynamics.loads.varying_load import evaluated
from rb_dynamics.loads.wrench import HeldWrench, combined
from rb_dynamics.loads.wrench_channels import ChannelBias, ChannelLag
from rb_dynamics.numerics.compilation import compiled_by
from rb_dynamics.numerics.rotation import Quaternion
from rb_dynamics.numerics.vector import ZERO, Vector, add, norm

if TYPE_CHECKING:
    from rb_dynamics.numerics.array_types import Numbers

# Numbers of one effect: its kind and its parameters. After the last effect comes the number of effects. All are at the
# end of a kernel's array, whatever precedes them. A function of a plug-in has its kind, its cell, and how far back
# its own numbers are, which precede those of all effects. A transient likewise has how far back its wrenches are; then
# its age at the start of the arc, the sum of the time there and its rounding error, its length, and whether it is
# linear. Transients come last.
WIDTH = 16
ATTRACTION, _RESISTANCE, _SPIN, _LIFT, _DIPOLE = 1.0, 2.0, 3.0, 4.0, 5.0
_LOAD_OF_PLUGIN, _SLOWING_OF_PLUGIN, _SIGHT_OF_PLUGIN, _TRANSIENT = 6.0, 7.0, 8.0, 9.0
# A lag is not a load of its own, see `gradual_wrench.py`.
_WITHOUT_LOAD = (UniformGravity, ScheduledWrench, MagneticField, ChannelBias, ChannelLag)

NO_EFFECTS = (0.0,)
"""Numbers for a scene without effects."""


class Underway(NamedTuple):
    """A transient in an arc.

    Attributes:
        transient: body parts in principal axes.
        age: at the start of the arc, s.
        high: the sum of the time at the start of the arc, s, see `PhaseState`.
        low: its rounding error.
    """

    transient: Transient
    age: float
    high: float
    low: float


class EffectLoad(NamedTuple):
    """A load in a kernel.

    Attributes:
        numbers: array that ends with those of the effects.
        time: start of the step, s since the start of the run.
        position: of the centre of mass at the start, world axes, m.
    """

    numbers: Numbers
    time: float
    position: Vector


class GradualLoad(NamedTuple):
    """The same, with transients.

    Attributes:
        numbers: as for `EffectLoad`, like `time` and `position`.
        high: the sum of the time at the start, s, see `PhaseState`.
        low: its rounding error.
    """

    numbers: Numbers
    time: float
    position: Vector
    high: float
    low: float


def effect_numbers(
    effects: Sequence[Effect],
    body: RigidBody,
    start: float,
    dipole: Vector = ZERO,
    *,
    plugins: bool = False,
    underway: Sequence[Underway] = (),
) -> tuple[float, ...] | None:
    """Return the numbers of `effects` from `start` (s) to the next knot; None if one of them has none.

    `dipole` (A m^2, principal axes) is that of the body in their magnetic field; with several sources there are no
    numbers. Effects of `plugins` have numbers only on request, as kernels need their functions, too. Transients that
    are `underway` are added.
    """
    found: list[Sequence[float]] = []
    before: list[float] = []
    for effect in effects:
        # Exactly these types: derived ones may behave differently.
        kind = type(effect)
        if kind in _WITHOUT_LOAD:
            continue
        if kind in _WITH_LOAD:
            found.append(_numbers(effect, body, start))
        elif not plugins or (dipole != ZERO and effect.magnetic_field() is not None):
            return None
        else:
            functions = list(_functions_of(effect, body, start))
            if functions and functions[0][0] != _LOAD_OF_PLUGIN:
                return None
            for code, cell, numbers in functions:
                before = numbers + before
                found.append((code, cell, float(len(before) + WIDTH * len(found))))
    if dipole != ZERO:
        source = source_numbers(effects)
        if source is None:
            return None
        found.append((_DIPOLE, *dipole, *source))
    for (old, new, _, length, is_linear), *clock in underway:
        before = flat((*old, *new)) + before
        found.append((_TRANSIENT, float(len(before) + WIDTH * len(found)), *clock, length, float(is_linear)))
    return (*before, *(n for each in found for n in (*each, *(0.0,) * (WIDTH - len(each)))), float(len(found)))


def _functions_of(effect: Effect, body: RigidBody, start: float) -> Iterator[tuple[float, float, list[float]]]:
    """Yield kind, cell and numbers of each function of an effect that is not of this package."""
    for code, template, part in (
        (_LOAD_OF_PLUGIN, load_on_numbers, effect.wrenching(body, start)),
        (_SLOWING_OF_PLUGIN, scale_on_numbers, effect.slowing(body)),
        (_SIGHT_OF_PLUGIN, scale_on_numbers, effect.sight(body)),
    ):
        if part is not None:
            yield code, *numbers_of(effect, template, part)


def functions_in(numbers: Sequence[float]) -> tuple[PluginFunction, ...]:
    """Return the functions of plug-ins that a kernel calls for these numbers of effects."""
    end = len(numbers) - 1
    starts = range(end - WIDTH * int(numbers[end]), end, WIDTH) if numbers else ()
    return tuple(function_at(numbers[i + 1]) for i in starts if _LOAD_OF_PLUGIN <= numbers[i] < _TRANSIENT)


def source_numbers(effects: Sequence[Effect]) -> tuple[float, ...] | None:
    """Return the numbers of the only magnetic field, for `source_at`; None if there is none, or it has no numbers."""
    fields = [effect for effect in effects if isinstance(effect, MagneticField)]
    return None if len(fields) != 1 or fields[0].model == "igrf" else tuple(flat(fields[0].source))


def gravity_numbers(effects: Sequence[Effect]) -> tuple[float, ...] | None:
    """Return mu and centre of the only gravity; zeros without any, None if it is not that of one centre."""
    found = [effect for effect in effects if effect.gravity() is not None]
    if not found:
        return 0.0, *ZERO
    center = found[0]
    if len(found) > 1 or not isinstance(center, CentralGravity) or type(center) is not CentralGravity:
        return None
    return center.gravitational_parameter, *center.center_world


def with_dipoles(numbers: Numbers, sources: Numbers, dipoles: Numbers) -> Numbers:
    """Return `effect_numbers` of many bodies with their dipoles, (N, ...); those without a dipole begin with zeros.

    Args:
        numbers: of the bodies without dipoles, (N, ...).
        sources: (N, ...), see `source_numbers`.
        dipoles: (N, 3), A m^2, principal axes.
    """
    import numpy as np

    count, width = numbers.shape
    found = np.zeros((count, width + WIDTH))
    has = (dipoles != 0.0).any(axis=1)
    found[~has, WIDTH:] = numbers[~has]
    found[has, : width - 1] = numbers[has, :-1]
    found[has, width - 1] = _DIPOLE
    found[has, width : width + 3] = dipoles[has]
    found[has, width + 3 : width + 3 + sources.shape[1]] = sources[has]
    found[has, -1] = numbers[has, -1] + 1.0
    return found


_WITH_LOAD = (CentralGravity, LinearDrag, QuadraticDrag, Rotor, Buoyancy)


def _numbers(effect: Effect, body: RigidBody, start: float) -> Sequence[float]:
    if isinstance(effect, CentralGravity):
        return (ATTRACTION, *flat(effect.attraction(body)))
    if isinstance(effect, (LinearDrag, QuadraticDrag)):
        return (_RESISTANCE, *flat(effect.resistance(body)))
    if isinstance(effect, Rotor):
        return (_SPIN, *flat(effect.spin(body, start)))
    if isinstance(effect, Buoyancy):
        return (_LIFT, *flat(effect.lift(body)))
    raise TypeError(f"{effect.kind} has no numbers")


@compiled_by(evaluated, EffectLoad)
def evaluated_by_numbers(
    load: EffectLoad,
    t: float,
    displacement: Vector,
    velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
) -> tuple[Vector, Vector]:
    """Return force (N, world axes) and torque (N m, principal axes), added up as in plain Python."""
    c = load.numbers
    count = int(c[len(c) - 1])
    i = len(c) - 1 - count * WIDTH
    here = Point(load.time + t, add(load.position, displacement), velocity, orientation, angular_velocity)
    force, torque = _load(c, i, here)
    for k in range(1, count):
        if c[i + k * WIDTH] <= _LOAD_OF_PLUGIN:
            more_force, more_torque = _load(c, i + k * WIDTH, here)
            force, torque = add(force, more_force), add(torque, more_torque)
    return force, torque


@compiled_by(evaluated, GradualLoad)
def evaluated_with_transients(
    load: GradualLoad,
    t: float,
    displacement: Vector,
    velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
) -> tuple[Vector, Vector]:
    """Return the same with transients, whose sum is added last, as in `TransientLoad`."""
    c, force, torque, acting = load.numbers, ZERO, ZERO, HeldWrench(ZERO, ZERO, ZERO, ZERO)
    count = int(c[len(c) - 1])
    i = len(c) - 1 - count * WIDTH
    if c[i] != _TRANSIENT:
        at = EffectLoad(c, load.time, load.position)
        force, torque = evaluated_by_numbers(at, t, displacement, velocity, orientation, angular_velocity)
    for k in range(count):
        j = i + k * WIDTH
        if c[j] == _TRANSIENT:
            own, age = j - int(c[j + 1]), _age_at(c, j, load.high, load.low)
            gradual = aged(_held_at(c, own), _held_at(c, own + 12), c[j + 5], c[j + 6] != 0.0, age + t)
            acting = combined(1.0, acting, 1.0, gradual)
    return with_acting(acting, force, torque, orientation)


def _age_at(c: Numbers, j: int, high: float, low: float) -> float:
    age: float = c[j + 2] + ((high - c[j + 3]) + (low - c[j + 4]))
    return age


def has_effects(c: Numbers) -> bool:
    """Return whether there are effects at the end of `c`."""
    return bool(c[len(c) - 1] != 0.0)


def has_transients(c: Numbers) -> bool:
    """Return whether there are transients at the end of `c`."""
    return bool(has_effects(c) and c[len(c) - 1 - WIDTH] == _TRANSIENT)


def is_attraction_or_none(c: Numbers) -> bool:
    """Return whether the only effect at the end of `c`, if there is any, is central gravity."""
    count = int(c[len(c) - 1])
    return count == 0 or (count == 1 and c[len(c) - 1 - WIDTH] == ATTRACTION)


def load_scales(c: Numbers, here: Point) -> tuple[float, float]:
    """Return slowing (1/s) and sight (s) of the effects at the end of `c`; see `CombinedEffects`.

    The sight is 0 where plain Python refuses what a plug-in gives.
    """
    count = int(c[len(c) - 1])
    slowing, sight = 0.0, math.inf
    for k in range(count):
        i = len(c) - 1 - (count - k) * WIDTH
        if c[i] == _RESISTANCE:
            slowing += slowed(_resistance_at(c, i + 1), here)
        elif c[i] == ATTRACTION:
            sight = min(sight, time_to_fall(_attraction_at(c, i + 1), here))
        elif c[i] == _SLOWING_OF_PLUGIN:
            rate = scale_at(c[i + 1], c, i - int(c[i + 2]), here)
            slowing += rate
            sight = sight if 0.0 <= rate < math.inf else 0.0
        elif c[i] == _SIGHT_OF_PLUGIN:
            ahead = scale_at(c[i + 1], c, i - int(c[i + 2]), here)
            sight = min(sight, ahead) if ahead > 0.0 else 0.0
    return slowing, sight


def sight_of_transients(c: Numbers, high: float, low: float) -> float:
    """Return for how long (s) the transients can be predicted from a phase with this sum of the time."""
    count, sight = int(c[len(c) - 1]), math.inf
    for k in range(count):
        i = len(c) - 1 - (count - k) * WIDTH
        if c[i] == _TRANSIENT:
            sight = min(sight, sight_of_transient(c[i + 5], c[i + 6] != 0.0, _age_at(c, i, high, low)))
    return sight


def strength(c: Numbers, here: Point) -> float:
    """Return the sum of the magnitudes (N) of the forces of the effects at the end of `c`."""
    count = int(c[len(c) - 1])
    total = 0.0
    for k in range(count):
        i = len(c) - 1 - (count - k) * WIDTH
        if c[i] <= _LOAD_OF_PLUGIN:
            force, _ = _load(c, i, here)
            total += norm(force)
    return total


def _load(c: Numbers, i: int, here: Point) -> tuple[Vector, Vector]:
    kind = c[i]
    if kind == ATTRACTION:
        return attracted(_attraction_at(c, i + 1), here)
    if kind == _RESISTANCE:
        return resisted(_resistance_at(c, i + 1), here)
    if kind == _SPIN:
        return reaction(_spin_at(c, i + 1), here)
    if kind == _LOAD_OF_PLUGIN:
        return load_at(c[i + 1], c, i - int(c[i + 2]), here)
    if kind == _DIPOLE:
        return turned_in_field(_vector_at(c, i + 1), add(ZERO, flux_density(source_at(c, i + 4), here.position)), here)
    return lifted(Lift(_vector_at(c, i + 1), _vector_at(c, i + 4)), here)


def _attraction_at(c: Numbers, i: int) -> Attraction:
    return Attraction(c[i], _vector_at(c, i + 1), c[i + 4], _vector_at(c, i + 5), c[i + 8])


def _resistance_at(c: Numbers, i: int) -> Resistance:
    axes = (c[i + 10], c[i + 11], c[i + 12], c[i + 13])
    return Resistance(c[i], _vector_at(c, i + 1), _vector_at(c, i + 4), _vector_at(c, i + 7), axes, c[i + 14])


def _spin_at(c: Numbers, i: int) -> Spin:
    return Spin(_vector_at(c, i), c[i + 3], c[i + 4], c[i + 5], c[i + 6])


def source_at(c: Numbers, i: int) -> Source:
    """Return the source of a magnetic field whose numbers begin at i, see `source_numbers`."""
    return Source(c[i] != 0.0, _vector_at(c, i + 1), _vector_at(c, i + 4), _vector_at(c, i + 7))


def _held_at(c: Numbers, i: int) -> HeldWrench:
    return HeldWrench(_vector_at(c, i), _vector_at(c, i + 3), _vector_at(c, i + 6), _vector_at(c, i + 9))


def _vector_at(c: Numbers, i: int) -> Vector:
    return (c[i], c[i + 1], c[i + 2])
