"""`Campaign`: a validated campaign as values, sent to workers as they are; `read.py` makes one from a file."""

from __future__ import annotations

import math
from dataclasses import dataclass

from rb_dynamics.study.campaign.distributions import Distribution
from rb_dynamics.study.campaign.user_modules import UserModules

SAMPLINGS = ("random", "latin_hypercube", "sobol")


@dataclass(frozen=True)
class Input:
    """One number that differs from run to run.

    Attributes:
        name: of its column: a dotted key of the scene or of `control`, or a part of one that is dispersed as a whole.
        distribution: of the number.
        whole: the dotted key that it is a part of, "" where the name is a key itself.
    """

    name: str
    distribution: Distribution
    whole: str = ""


@dataclass(frozen=True)
class Control:
    """A closed loop: a law that is sampled at its own rate and commands a torque.

    Attributes:
        law: a name in `laws.LAWS`, or the dotted name of a function of the user's.
        period_ns: between two samples, integer nanoseconds.
        numbers: dotted key and value of all that may be dispersed: `control.delay` (s), `control.saturation` (N m, of
            each axis), `control.bias[i]` (N m), `control.noise.attitude` (rad, of each axis), `control.noise.rate`
            (rad/s, likewise), and `control.parameters.*` of the law.
    """

    law: str
    period_ns: int
    numbers: tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class Metric:
    """One number that a run is judged by.

    Attributes:
        name: of its column.
        reduction: `final`, `worst`, `least`, `mean` or `time_to`.
        quantity: a name in `metrics.QUANTITIES`, or the dotted name of a function of the user's.
        target_xyzw: attitude that `attitude` is the angle from.
        below: threshold of `time_to`, or
        above: threshold of `time_to`.
        stays: whether the condition of `time_to` has to hold from then on to the end.
    """

    name: str
    reduction: str
    quantity: str
    target_xyzw: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0)
    below: float = math.inf
    above: float = -math.inf
    stays: bool = True


@dataclass(frozen=True)
class Requirement:
    """What a metric has to be: less than `below` and more than `above`."""

    metric: str
    below: float = math.inf
    above: float = -math.inf


@dataclass(frozen=True)
class Campaign:
    """A campaign, validated.

    Attributes:
        text: the campaign file as read.
        source: its file name, for messages.
        modules: of the user, which it names.
        scene_text: the base scene, with what `set` says and the channel of the controller; it alone makes the scene.
        runs: number of them.
        seed: of the random numbers.
        sampling: one of `SAMPLINGS`.
        inputs: what is dispersed.
        mixing: for each input the row of the lower triangular matrix that gives standard normal numbers their
            correlations; empty where nothing is correlated.
        control: the closed loop, or None.
        observe_ns: between two looks at the quantities of `metrics`, integer nanoseconds.
        metrics: what a run is judged by.
        requirements: what makes a run a success.
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
    observe_ns: int
    metrics: tuple[Metric, ...]
    requirements: tuple[Requirement, ...]
