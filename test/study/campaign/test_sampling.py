"""Inputs: distributions, correlations, and independence of the block a run is in."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from campaigns import CAMPAIGN, write
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from rb_dynamics.numerics.rotation import matrix
from rb_dynamics.study.campaign.distributions import Choice, LogNormal, LogUniform, Normal, Stepped, Uniform
from rb_dynamics.study.campaign.model import SAMPLINGS, Campaign
from rb_dynamics.study.campaign.read import read_campaign
from rb_dynamics.study.campaign.sampling import INPUTS, NOISE, generator, inputs
from rb_dynamics.study.campaign.scenes import ANYHOW, Scenes, any_attitude

RUNS = 1000


def campaign(folder: Path, sampling: str, extra: str = "", runs: int = RUNS) -> Campaign:
    text = CAMPAIGN.replace("sampling: random", f"sampling: {sampling}").replace("runs: 24", f"runs: {runs}")
    return read_campaign(write(folder, text + extra))


@pytest.mark.parametrize("sampling", SAMPLINGS)
def test_a_block_is_a_part_of_the_whole(tmp_path: Path, sampling: str) -> None:
    found = campaign(tmp_path, sampling, "correlate: [{between: [body.mass, control.delay], coefficient: 0.6}]")
    whole = inputs(found, 0, RUNS)

    for first, last in ((0, 1), (1, 2), (5, 22), (0, 17), (993, RUNS)):
        assert inputs(found, first, last).tobytes() == whole[first:last].tobytes()
    other = inputs(read_campaign(tmp_path / "campaign.yaml", {"seed": 8}), 0, RUNS)
    assert not np.isclose(other, whole).all(axis=1).any()


@pytest.mark.parametrize("sampling", SAMPLINGS)
def test_samples_are_of_their_distributions(tmp_path: Path, sampling: str) -> None:
    found = campaign(tmp_path, sampling)
    columns = dict(zip([each.name for each in found.inputs], inputs(found, 0, RUNS).T, strict=True))

    expected: dict[str, Any] = {
        "body.mass": stats.uniform(1.5, 1.0),
        "initial.angular_velocity_body[1]": stats.norm(-0.3, 0.2),
        "body.inertia.second_moment[2]": stats.lognorm(0.3),
        "control.parameters.gain": stats.loguniform(0.5, 2.0),
    }
    for name, distribution in expected.items():
        assert stats.kstest(columns[name], distribution.cdf).pvalue > 1e-3, name
    counts = [np.count_nonzero(columns["control.delay"] == value) for value in (0.0, 0.1, 0.35)]
    assert sum(counts) == RUNS
    assert min(counts) > 0.27 * RUNS


@pytest.mark.parametrize(
    "edges", [(8.5, 10.0), (8.1, 9.0), (8.5, np.inf), (-9.9, -8.5), (20.0, 21.0), (-1.0, 2.0), (0.5, 9.0)]
)
def test_a_truncated_normal_distribution_is_right_far_from_its_mean(edges: tuple[float, float]) -> None:
    """Beyond 8 deviations above the mean, every value was the upper limit."""
    low, high = (10.0 + 2.0 * edge for edge in edges)
    probability = (np.arange(999) + 0.5) / 999
    found = Normal(10.0, 2.0, low, high).quantile(probability)
    # scipy's is right in the lower tail.
    mirrored = -stats.truncnorm(-edges[1], -edges[0]).ppf(1.0 - probability)
    np.testing.assert_allclose(found, 10.0 + 2.0 * mirrored, rtol=1e-7)
    assert len(np.unique(found)) == 999


def test_a_uniform_distribution_in_steps_takes_its_limits_as_often_as_the_rest() -> None:
    found = Stepped(Uniform(0.05, 0.45), 0.05).quantile((np.arange(900) + 0.5) / 900)
    values, counts = np.unique(np.rint(found / 0.05), return_counts=True)
    assert values.tolist() == list(range(1, 10))
    assert counts.tolist() == [100] * 9


def test_a_hypercube_has_one_sample_in_each_layer(tmp_path: Path) -> None:
    found = campaign(tmp_path, "latin_hypercube")
    k = [each.name for each in found.inputs].index("body.mass")
    layers = np.floor((np.sort(inputs(found, 0, RUNS)[:, k]) - 1.5) * RUNS)
    assert np.abs(layers - np.arange(RUNS)).max() <= 1.0
    assert len(np.unique(layers)) >= RUNS - 2  # the last digit of a bound may fall to either side


def test_correlations(tmp_path: Path) -> None:
    pair = "{between: [body.mass, control.parameters.gain], coefficient: -0.8}"
    found = campaign(tmp_path, "latin_hypercube", f"correlate: [{pair}]", 4000)
    names = [each.name for each in found.inputs]
    columns = inputs(found, 0, 4000).T[
        [names.index(n) for n in ("body.mass", "control.parameters.gain", "control.delay")]
    ]

    # Of normal scores r, ranks have 6/pi asin(r/2).
    rank = 6.0 / np.pi * np.arcsin(-0.4)
    assert stats.spearmanr(columns[0], columns[1]).statistic == pytest.approx(rank, abs=0.03)
    assert stats.spearmanr(columns[0], columns[2]).statistic == pytest.approx(0.0, abs=0.06)


@given(st.floats(0.0, 1.0), st.sampled_from([0.0, 1e-9, 0.1, 3.0]))
def test_samples_stay_within_their_bounds(probability: float, deviation: float) -> None:
    p = np.array([min(max(probability, 2.0**-54), 1.0 - 2.0**-53)])
    assert 0.5 <= Normal(0.5 + 0.1, deviation, 0.5, 0.7).quantile(p)[0] <= 0.7
    assert -1.0 <= Uniform(-1.0, 0.3).quantile(p)[0] <= 0.3
    assert 1e-9 <= LogUniform(1e-9, 1e9).quantile(p)[0] <= 1e9
    assert LogNormal(deviation).quantile(p)[0] > 0.0
    assert Choice((3.0, 1.0, 2.0), (0.2, 0.0, 0.8)).quantile(p)[0] in (3.0, 2.0)


def test_every_inertia_is_one_of_a_body(tmp_path: Path) -> None:
    """Wide dispersions, of a plate: each sum of two moments is at least the third."""
    text = CAMPAIGN.replace("second_moments: 0.3", "second_moments: 2.0").replace("runs: 24", "runs: 200")
    scene = "body: {mass: 1, inertia: {diagonal: [1, 2, 3]}}\nduration: 1\nsolver: {method: rk4, step: 0.05}\n"
    scene += "initial: {angular_velocity_body: [0, 0, 1]}\n"
    found = read_campaign(write(tmp_path, text, scene))
    scenes, names = Scenes(found), [each.name for each in found.inputs]

    ratios = []
    for row in inputs(found, 0, 200).tolist():
        moments = sorted(scenes.scene(dict(zip(names, row, strict=True))).body.principal_moments)
        assert moments[0] > 0.0
        assert moments[0] + moments[1] >= moments[2] * (1.0 - 1e-12)
        ratios.append(moments[2] / moments[0])
    assert max(ratios) > 20.0


def test_a_scene_with_its_text_is_the_same_scene(tmp_path: Path) -> None:
    found = campaign(tmp_path, "random")
    scenes, names = Scenes(found), [each.name for each in found.inputs]
    for row in inputs(found, 0, 5).tolist():
        values = dict(zip(names, row, strict=True))
        quick, whole = scenes.scene(values), scenes.whole(values)
        assert (quick.body, quick.initial, quick.solver) == (whole.body, whole.initial, whole.solver)
        assert whole.body.mass == values["body.mass"]


def test_any_attitude_is_any() -> None:
    r = np.random.default_rng(3)
    axes = np.array([matrix(any_attitude(*row)) for row in r.random((4000, 3)).tolist()])
    assert np.abs(axes.mean(axis=0)).max() < 0.03
    # Each component of a direction that is uniform on the sphere is uniform from -1 to 1.
    assert stats.kstest(axes[:, 0, 2], stats.uniform(-1.0, 2.0).cdf).pvalue > 1e-3
    assert len(ANYHOW) == 3


def test_streams_are_apart() -> None:
    numbers = {generator(seed, run, stream).random() for seed in (1, 2) for run in (1, 2) for stream in (INPUTS, NOISE)}
    assert len(numbers) == 8
    assert generator(1, 2, NOISE).random() == generator(1, 2, NOISE).random()
