"""Thinned runs: only real samples, at most the stated number, and always both ends."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rb_dynamics.loads.wrench_channels import AppliedWrench
from rb_dynamics.numerics.vector import ZERO, Vector
from rb_dynamics.run.sample import Sample
from rb_dynamics.sinks.rerun_thinning import KeptSamples, Polyline, Thinner, Trail, WrenchHistory, WrenchPart


def still(index: int) -> Sample:
    return Sample(10 * index, ZERO, (0.0, 0.0, 0.0, 1.0), ZERO, ZERO, ZERO, ZERO, 0.0, 0.0, 0.0, ZERO, ZERO)


def push(
    time_ns: int, force: Vector, topic: str = "a", frame_id: str = "world", torque: Vector = ZERO
) -> AppliedWrench:
    return AppliedWrench(time_ns, topic, None, frame_id, force, torque)


@given(st.integers(1, 50), st.integers(0, 3000))
def test_kept_samples_grow_with_the_logarithm_and_only_get_sparser(max_rows: int, count: int) -> None:
    thinner = Thinner(max_rows)
    kept = [index for index in range(count) if thinner.kept(range(index, index + 1))]
    assert kept[:1] == [0][:count]
    assert len(kept) == thinner.rows <= max_rows * (2.0 + math.log2(1.0 + count / max_rows))
    steps = np.diff(kept)
    assert np.all(np.diff(steps) >= 0)
    assert set(steps.tolist()) <= {2**k for k in range(13)}


@given(st.integers(1, 50), st.lists(st.integers(0, 300), max_size=12))
def test_samples_are_kept_alike_one_by_one_and_many_at_once(max_rows: int, counts: list[int]) -> None:
    many, single, first = Thinner(max_rows), Thinner(max_rows), 0
    for count in counts:
        kept = [index for index in range(first, first + count) if single.kept(range(index, index + 1))]
        assert many.kept(range(first, first + count)) == kept
        first += count
    assert (many.rows, many.stride) == (single.rows, single.stride)


@pytest.mark.parametrize(
    ("duration", "rate", "stride"), [(10.0, 100.0, 1), (10.0, 101.0, 2), (1e6, 1000.0, 1_000_000), (None, 100.0, 1)]
)
def test_stride_follows_from_a_known_length(duration: float | None, rate: float, stride: int) -> None:
    assert Thinner.of_run(duration, rate, 1000).stride == stride


def test_length_of_a_run_that_logs_every_step_is_not_known() -> None:
    assert Thinner.of_run(100.0, 0.0, 10).stride == 1


@given(st.integers(1, 20), st.lists(st.integers(0, 30), max_size=20))
def test_polyline_keeps_both_ends_and_evenly_what_lies_between(max_points: int, batches: list[int]) -> None:
    line, count = Polyline(max_points), 0
    for batch in batches:
        line.extend(np.arange(count, count + batch, dtype=float)[:, None] * (1.0, 0.0, 0.0))
        count += batch
    places = [int(point[0]) for point in line.line()]
    if not count:
        assert places == []
        return
    assert places[0] == 0
    assert places[-1] == count - 1
    assert len(places) <= 2 * max_points + 1
    assert places[:-1] == list(range(0, count, line.stride))


def test_polyline_is_sent_again_when_it_has_doubled() -> None:
    line, sent = Polyline(10), []
    for i in range(1000):
        line.extend(np.array([[float(i), 0.0, 0.0]]))
        if line.due():
            line.sent()
            sent.append(i + 1)
    assert sent == [2**k for k in range(10)]


def test_edges_beyond_the_exact_ones_wait_for_a_kept_sample() -> None:
    steps = WrenchHistory("world", 0, exact=2)
    part = WrenchPart("force", "a", "world")
    assert steps.take(push(1, (1.0, 0.0, 0.0)), 0) == [part]
    for time_ns in range(2, 6):
        assert steps.take(push(time_ns, (float(time_ns), 0.0, 0.0)), 0) == []
    assert [edge.time_ns for edge in dict(steps.fetch())[part]] == [0, 1, 2]
    assert steps.unsent() == 0
    steps.settle()
    assert [(edge.time_ns, edge.value[0]) for edge in dict(steps.fetch())[part]] == [(5, 5.0)]
    steps.settle()
    assert steps.fetch() == []
    steps.finish(9, 3)
    assert dict(steps.fetch())[part] == [(9, 3, (5.0, 0.0, 0.0))]


def test_a_channel_that_changes_its_frame_ends_in_the_old_one() -> None:
    steps = WrenchHistory("world", 0, exact=10)
    steps.take(push(1, (1.0, 0.0, 0.0), frame_id="body"), 0)
    steps.take(push(2, (0.0, 2.0, 0.0)), 0)
    steps.take(push(3, (0.0, 0.0, 4.0), topic="b"), 0)
    found = {part.frame_id + part.topic: [edge.value for edge in edges] for part, edges in steps.fetch()}
    assert found["bodya"] == [ZERO, (1.0, 0.0, 0.0), ZERO]
    assert found["worlda"] == [ZERO, (0.0, 2.0, 0.0)]
    assert steps.held.force_world == (0.0, 2.0, 4.0)
    assert steps.held.force_body == ZERO


def test_a_part_that_never_acts_has_no_line() -> None:
    steps = WrenchHistory("world", 0, exact=10)
    assert steps.take(push(1, ZERO), 0) == []
    assert [part.kind for part in steps.take(push(2, ZERO, torque=(0.0, 0.0, 1.0)), 0)] == ["torque"]


def test_a_wrench_of_the_same_instant_counts_for_the_sample_a_later_one_does_not() -> None:
    rows = KeptSamples(Thinner(100), WrenchHistory("world", 0, exact=10))
    rows.take_sample(still(0))
    rows.take_wrench(push(0, (1.0, 0.0, 0.0)))
    rows.take_wrench(push(5, (2.0, 0.0, 0.0)))
    rows.take_sample(still(1))
    rows.finish(10)
    (kept,) = rows.fetch()
    assert list(zip(kept.indices, (held.force_world[0] for held in kept.held), strict=True)) == [(0, 1.0), (1, 2.0)]


def test_the_last_sample_is_kept_whatever_its_index() -> None:
    rows = KeptSamples(Thinner(100, stride=10), WrenchHistory("world", 0, exact=10))
    for i in range(34):
        rows.take_sample(still(i))
    rows.finish(330)
    (kept,) = rows.fetch()
    assert kept.indices == [0, 10, 20, 30, 33]


@given(st.integers(1, 8), st.lists(st.integers(1, 25), min_size=1, max_size=12), st.integers(0, 2**32 - 1))
def test_pieces_of_a_trail_are_the_curve(max_pieces: int, batches: list[int], seed: int) -> None:
    count, random = sum(batches), np.random.default_rng(seed)
    joined = random.random(count) < 0.8
    points = np.column_stack([np.arange(count), random.random(count)])
    times = np.column_stack([10 * np.arange(count), np.arange(count)])
    trail, pieces, start = Trail(2, max_pieces), [], 0
    for batch in batches:
        rows = slice(start, start + batch)
        pieces += trail.take(times[rows], points[rows], joined[rows])
        start += batch
    pieces += trail.finish()
    assert pieces[-1].time_ns == 10 * (count - 1)
    assert len(pieces) <= max_pieces * (2.0 + math.log2(1.0 + count / max_pieces))
    seen = np.unique(np.concatenate([strip for piece in pieces for strip in piece.strips]), axis=0)
    np.testing.assert_array_equal(seen, points)
    chords = set()
    for piece in pieces:
        assert max(strip[-1, 0] for strip in piece.strips) == piece.sample, "a piece comes when it is complete"
        chords |= {int(b) for strip in piece.strips for b in strip[1:, 0]}
        assert all(np.all(np.diff(strip[:, 0]) == 1.0) for strip in piece.strips)
    assert chords == {i for i in range(1, count) if joined[i]}


def test_trail_of_known_length_has_at_most_its_pieces() -> None:
    trail = Trail(1, 100, rows=100_000)
    n = 100_001
    pieces = trail.take(np.zeros((n, 2), dtype=np.int64), np.zeros((n, 1)), np.ones(n, dtype=bool))
    assert len(pieces) == 100
    assert len(trail.finish()) == 1
    assert Trail(1, 100).finish() == []
