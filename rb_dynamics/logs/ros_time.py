"""`in_time_of`: bags stamped with ROS time beside the log of a node, whose simulation time stood still at times."""

from __future__ import annotations

import itertools

import numpy as np

from rb_dynamics.formats.log_metadata import epochs
from rb_dynamics.formats.mcap_records import END_OF_TIME
from rb_dynamics.formats.topic_messages import Times
from rb_dynamics.logs.bag_reader import Bag


def in_time_of(log: Bag, *bags: Bag) -> float:
    """Take out of the ROS times in `bags` how long simulation time stood still by `log`; return that, s.

    A pause and a dropped lag move the ROS time of time 0. Times of the bags then count as if it had stayed what it was
    at first; those of messages within a pause are when it began. Nothing is done if a clock was set back.
    """
    known = epochs(log.metadata)
    moved = [(since + before, since + after) for (_, before), (since, after) in itertools.pairwise(known)]
    ends = [time for each in moved for time in each]
    if not moved or ends != sorted(ends) or ends[-1] >= END_OF_TIME:
        return 0.0
    begins, resumes = np.array(moved, dtype=np.int64).T
    stood = np.concatenate([[0], np.cumsum(resumes - begins)])

    def moving(times: Times) -> Times:
        at = np.searchsorted(resumes, times, side="right")
        latest = np.append(begins, np.iinfo(np.int64).max)[at]
        counted: Times = np.minimum(times, latest) - stood[at]
        return counted

    for bag in bags:
        for topic in bag.topics.values():
            topic.move(moving)
    return float(stood[-1]) * 1e-9
