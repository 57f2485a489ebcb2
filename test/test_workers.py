"""The tests of a file run in one process and in order, with any number of workers."""

from __future__ import annotations

import pytest

RUN: list[str] = []


@pytest.mark.parametrize("number", range(6))
def test_a_file_stays_together(number: int, request: pytest.FixtureRequest) -> None:
    RUN.append(request.node.name)
    assert [item.name for item in request.session.items if item.path == request.path][: len(RUN)] == RUN
