"""`command_latencies`: the latency of the commands of a node, from `.../latency` in its log."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rb_dynamics.formats.message_types import VECTOR
from rb_dynamics.logs.bag_reader import Bag
from rb_dynamics.logs.messages import LATENCY

EDGES_S = (-math.inf, 0.0, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 1e-1, math.inf)
"""Edges of the histogram, s."""


@dataclass(frozen=True)
class CommandLatency:
    """The latency of the commands of one channel, s.

    Attributes:
        topic: the channel.
        count: commands.
        transport_s: median time from sending to receiving.
        waiting_s: median time from receiving to acting, negative for one that acted from before.
        median_s: from sending to acting, and the next two.
        p99_s: not exceeded by 99 % of the commands.
        largest_s: of all.
        counts: commands from each of `EDGES_S` to the next; below 0 they act from before they were sent, because that
            was their stamp or nothing was computed since, or the sender's clock is ahead of ours.
        skipped: sequence numbers that are missing between the smallest and the largest.
    """

    topic: str
    count: int
    transport_s: float
    waiting_s: float
    median_s: float
    p99_s: float
    largest_s: float
    counts: tuple[int, ...]
    skipped: int


def command_latencies(bag: Bag) -> list[CommandLatency]:
    """Return the latencies of each channel for which the log has them."""
    found = []
    for name, topic in sorted(bag.topics.items()):
        if not (name.endswith(LATENCY) and topic.type_name == VECTOR and topic.count):
            continue
        transport, waiting, numbers = bag.vectors(name)[1].T
        total = np.sort(transport + waiting)
        counts = np.histogram(total, EDGES_S)[0]
        found.append(
            CommandLatency(
                name.removesuffix(LATENCY),
                len(total),
                float(np.median(transport)),
                float(np.median(waiting)),
                float(np.median(total)),
                float(total[min(len(total) - 1, int(0.99 * len(total)))]),
                float(total[-1]),
                tuple(counts.tolist()),
                int(np.ptp(numbers)) + 1 - len(set(numbers.tolist())),
            )
        )
    return found
