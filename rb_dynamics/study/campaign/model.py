"""`Campaign`: a validated campaign as plain values, which are sent to workers; `read.py` makes one from a file."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

from rb_dynamics.study.campaign.distributions import Distribution
from rb_dynamics.study.campaign.user_modules import UserModules

SAMPLINGS = ("random", "latin_hypercube", "sobol")


@dataclass(frozen=True)
class Input:
    """One number that differs from run to run.

    Attributes:
        name: of its column: a dotted key of the scene or of `control`, or an element of a value that is dispersed as a
            whole.
        distribution: of the number.
        whole: the dotted key that it is an element of, "" if the name is a key itself.
    """

    name: str
    distribution: Distribution
    whole: str = ""


@dataclass(frozen=True)
class Control:
    """A closed loop: a law that is sampled at its own rate and commands a torque, a force and actuators.

    Attributes:
        law: a name in `laws.LAWS`, or the dotted name of a user function.
        period_ns: exact sampling period, ns; sample k is at k periods, rounded to a nanosecond, as those of sensors.
        numbers: dotted key and value of everything that may be dispersed: `control.delay` (s), `control.saturation` (N
            m, per axis), `control.bias[i]` (N m), `control.noise.attitude` (rad, per axis), `control.noise.rate`
            (rad/s, per axis), and `control.parameters.*` of the law.
        through: names of the reaction wheels that give the torque; none if it acts by itself.
    """

    law: str
    period_ns: Fraction
    numbers: tuple[tuple[str, float], ...]
    through: tuple[str, ...] = ()


NO_VALUE = "no value"


@dataclass(frozen=True)
class Metric:
    """One number computed for each run.

    Attributes:
        name: of its column.
        reduction: `final`, `worst`, `least`, `mean` or `time_to`.
        quantity: a name in `metrics.QUANTITIES`, or the dotted name of a user function.
        target_xyzw: attitude from which `attitude` measures the angle.
        below: upper threshold of `time_to`.
        above: lower threshold of `time_to`.
        stays: whether the condition of `time_to` must then hold to the end.
    """

    name: str
    reduction: str
    quantity: str
    target_xyzw: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0)
    below: float = math.inf
    above: float = -math.inf
    stays: bool = True

    @property
    def if_nan(self) -> str:
        """What is said of a completed run of which this metric is NaN."""
        return "never" if self.reduction == "time_to" else NO_VALUE


@dataclass(frozen=True)
class Requirement:
    """Limits of a metric: less than `below` and more than `above`."""

    metric: str
    below: float = math.inf
    above: float = -math.inf

    def allows_never(self, metric: Metric) -> bool:
        """Return whether a completed run meets it that never met the condition of `metric`: its time is infinite."""
        return metric.reduction == "time_to" and math.isinf(self.below)


@dataclass(frozen=True)
class Campaign:
    """A campaign, validated.

    Attributes:
        text: content of the campaign file.
        source: its file name, for messages.
        modules: user modules that it names.
        scene_text: the base scene, with the values of `set` and the channel of the controller; it defines the scene
            completely.
        runs: number of them.
        seed: of the random numbers.
        sampling: one of `SAMPLINGS`.
        inputs: the dispersed numbers.
        mixing: for each input, its row of the lower triangular matrix that correlates standard normal numbers; empty if
            nothing is correlated.
        control: the closed loop, or None.
        observe_ns: exact interval between observations of the quantities of `metrics`, ns, as the period of `control`.
        metrics: computed for each run.
        requirements: a run that meets all of them passes.
    """

    text: str
    source: str
    modules: UserModules
    scene_text: str
    runs: int
    seed: int
    sampling: str
    inputs: tuple[Input, ...]
    mixing: tuple[tuple[float, ...], ...]
    control: Control | None
    observe_ns: Fraction
    metrics: tuple[Metric, ...]
    requirements: tuple[Requirement, ...]
