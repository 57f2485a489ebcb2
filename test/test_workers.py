"""The tests of a file run in one process and in order, with any number of workers, and those of ROS go first."""

from __future__ import annotations

import os

import pytest

RUN: list[str] = []


@pytest.mark.parametrize("number", range(6))
def test_a_file_stays_together(number: int, request: pytest.FixtureRequest) -> None:
    RUN.append(request.node.name)
    assert [item.name for item in request.session.items if item.path == request.path][: len(RUN)] == RUN


@pytest.mark.skipif("PYTEST_XDIST_WORKER" not in os.environ, reason="only workers compete")
def test_a_worker_leaves_the_cores_to_the_tests_of_ros() -> None:
    assert os.nice(0) >= 5
