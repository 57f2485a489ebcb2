"""Packing of values for kernels is inverted by unpacking, for single rows and blocks."""

from __future__ import annotations

import numpy as np

from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion import Inertia, kernel_layout
from rb_dynamics.motion.phase_state import PhaseState

INERTIA = Inertia(1.0, (2.0, 3.0, 4.0))
HELD = HeldWrench((5.0, 6.0, 7.0), (8.0, 9.0, 10.0), (11.0, 12.0, 13.0), (14.0, 15.0, 16.0))
HIGH, LOW = tuple(map(float, range(8, 22))), tuple(map(float, range(22, 36)))
PHASE = PhaseState((1.0, 2.0, 3.0, 4.0), (5.0, 6.0, 7.0), HIGH, LOW)


def test_a_line_of_numbers() -> None:
    constants, phase = kernel_layout.constant_numbers(INERTIA, HELD), kernel_layout.phase_numbers(PHASE)
    numbers = np.array((*constants, *phase))

    assert constants == tuple(map(float, range(1, kernel_layout.CONSTANTS + 1)))
    assert phase == tuple(map(float, range(1, kernel_layout.PHASE + 1)))
    assert kernel_layout.constants_at(numbers) == (INERTIA, HELD)
    assert kernel_layout.phase_at(numbers, kernel_layout.CONSTANTS) == kernel_layout.phase_of(phase) == PHASE


def test_writes_where_it_reads() -> None:
    numbers, rows = np.zeros(3 + kernel_layout.PHASE), np.zeros((kernel_layout.PHASE, 2))
    kernel_layout.write_phase(numbers, 3, PHASE)
    kernel_layout.write_phase_in(rows, 1, *PHASE)

    assert numbers.tolist() == [0.0, 0.0, 0.0, *kernel_layout.phase_numbers(PHASE)]
    assert rows[:, 0].tolist() == [0.0] * kernel_layout.PHASE
    assert rows[:, 1].tolist() == list(kernel_layout.phase_numbers(PHASE))
    assert kernel_layout.phase_in(rows, 1) == PHASE


def test_constants_in_rows() -> None:
    rows = np.zeros((kernel_layout.CONSTANTS, 2))
    rows[:4, 1] = kernel_layout.constant_numbers(INERTIA, HELD)[:4]
    kernel_layout.write_held(rows, 1, HELD)

    assert rows[:, 0].tolist() == [0.0] * kernel_layout.CONSTANTS
    assert rows[:, 1].tolist() == list(kernel_layout.constant_numbers(INERTIA, HELD))
    assert kernel_layout.constants_in(rows, 1) == (INERTIA, HELD)
