from __future__ import annotations

import resource

import numpy as np
import pytest

from rb_dynamics.numerics import growing_array
from rb_dynamics.numerics.growing_array import GrowingArray, give_back


def grown(parts: int) -> tuple[GrowingArray, np.ndarray]:
    numbers = np.random.default_rng(1).normal(size=(parts, 100, 7))
    found = GrowingArray()
    for part in numbers:
        found.add(part[:, ::-1])
    return found, numbers[:, :, ::-1].ravel()


@pytest.mark.parametrize("in_memory", [0, 2**15, 2**22])
def test_numbers_come_back_to_the_last_bit(in_memory: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(growing_array, "_IN_MEMORY", in_memory)
    found, numbers = grown(20)
    assert len(found) == len(numbers)
    view = found.view("f8")
    rows = view.reshape(-1, 7)[5:, 2:]
    give_back(rows)
    assert view.tobytes() == numbers.tobytes()
    assert rows.tolist() == numbers.reshape(-1, 7)[5:, 2:].tolist()
    assert found.view("u8").tobytes() == numbers.tobytes()
    assert GrowingArray().view("f8").shape == (0,)


def test_a_full_disk_leaves_them_in_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(growing_array, "_IN_MEMORY", 2**14)
    monkeypatch.setattr(growing_array, "_WAITING", 2**13)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, hard))
    try:
        found, numbers = grown(20)
        view = found.view("f8")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert view.tobytes() == numbers.tobytes()
    assert found._file is None
