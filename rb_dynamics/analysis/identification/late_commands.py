"""`late_commands`: what errors of the times of commands do to a fit that takes these as they were recorded."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rb_dynamics.analysis.identification.flights import WrenchSeries
from rb_dynamics.analysis.identification.measurement_model import DRAWN, Model
from rb_dynamics.analysis.identification.stacked_rows import covariance_of
from rb_dynamics.analysis.track import Array

# Errors of times that are tried: small, as the motion follows them in proportion, and above rounding; ns.
_TRIED_NS = 1e5
# Commands are recorded this late, if the motion does not tell; and no more than this, each by itself; in the above.
_USUAL, _MOST = 10.0, 200.0


class LateCommands(NamedTuple):
    """Of p numbers near the solution.

    Attributes:
        seconds: root mean square of the errors of times, each by itself, as the residuals show them, s.
        spread: (p, p), covariance by such errors.
    """

    seconds: float
    spread: Array


def late_commands(model: Model, weighted: Array, left: Callable[[Model], Array | None]) -> LateCommands:
    """Return what errors of the times of commands do where these are uncertain; zero where none are.

    How large they are the residuals tell, in the directions in which such errors move them and no number of the fit
    does: each by itself by the moment estimate of a variance component (Searle, Casella and McCulloch, Variance
    Components (1992), chapter 5), and all of a topic together, as by a delay, by their posterior mean square.

    Args:
        model: with its solution.
        weighted: (n, p), derivatives of the residuals over noise by each number.
        left: returns the residuals (n,) over noise of a model with the numbers of the solution; None without any.
    """
    count = weighted.shape[1]
    none = LateCommands(0.0, np.zeros((count, count)))
    topics = sorted({each.topic for flight in model.flights for each in flight.channels if each.within_ns})
    if not topics:
        return none
    others = [_each_late(model, number) for number in range(DRAWN)] + [_delayed(model, topic) for topic in topics]
    found = [left(other) for other in (model, *others)]
    here, *there = [each for each in found if each is not None and len(each) == len(weighted)] or [weighted[:0, 0]]
    if len(there) < len(others) or not np.isfinite(there).all():
        return none
    draws = np.array(there) - here
    moves = draws @ weighted @ covariance_of(weighted)
    remains = draws - moves @ weighted.T
    shown = (remains @ here) ** 2
    products = remains[:DRAWN] @ remains[:DRAWN].T
    same = np.eye(DRAWN, dtype=bool)
    gain = float(np.mean(products[~same] ** 2))
    part = (np.mean(shown[:DRAWN]) - np.mean(products[same])) / gain if gain > 0.0 else 0.0
    part = min(max(0.0, float(part)), _MOST**2)
    of_delay = 1.0 / (np.sum(remains[DRAWN:] ** 2, axis=1) + _USUAL**-2)
    squares = np.concatenate([np.full(DRAWN, part / DRAWN), of_delay + of_delay**2 * shown[DRAWN:]])
    return LateCommands(1e-9 * _TRIED_NS * part**0.5, (moves.T * squares) @ moves)


def _each_late(model: Model, number: int) -> Model:
    """Return the same with commands at other times, each by an error of its own; of a `number` always the same."""
    draw = np.random.default_rng(number)

    def late(channel: WrenchSeries) -> WrenchSeries:
        moved = channel.time_ns + (_TRIED_NS * draw.standard_normal(len(channel.time_ns))).astype(np.int64)
        return replace(channel, time_ns=np.maximum.accumulate(moved)) if channel.within_ns else channel

    return model.with_commands(late)


def _delayed(model: Model, topic: str) -> Model:
    return model.with_commands(
        lambda each: replace(each, time_ns=each.time_ns + round(_TRIED_NS)) if each.topic == topic else each
    )
