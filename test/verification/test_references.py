"""Reference states to 30 digits and more, by independent mathematics, are reached to each method's accuracy."""

from __future__ import annotations

import json

import pytest
from motions import DATA, EPS, METHODS, STEPPED, errors, forced, free, move
from mpmath import mp, mpf
from scripts import load_script

FREE = ["dzhanibekov", "boxes_rotation"]


@pytest.mark.parametrize("method", [name for name, m in STEPPED.items() if m.order >= 4])
@pytest.mark.parametrize("time", [1, *(pytest.param(t, marks=pytest.mark.slow) for t in (2, 5))])
def test_forced_body_to_twelve_digits(method: str, time: float) -> None:
    """With h^p = 1e-12: what is left is mostly rounding, and what the motion makes of it."""
    found = errors(forced(), time, move(forced(), STEPPED[method], 1e-12 ** (1.0 / STEPPED[method].order), time))

    for name, error in found.items():
        assert error <= {1: 4e-13, 2: 4e-12, 5: 1e-9}[time], name


@pytest.mark.parametrize("method", STEPPED)
@pytest.mark.parametrize("name", FREE)
def test_free_body_as_the_order_says(name: str, method: str) -> None:
    """At the first time in the table, after one turn of the body."""
    case = free(name)
    time = min(case.states)
    rate = max(map(abs, case.initial.angular_velocity_body))
    order = STEPPED[method].order
    h = 0.02 if order < 6 else 0.05

    coarse, fine = (errors(case, time, move(case, STEPPED[method], step / rate, time)) for step in (2.0 * h, h))

    for quantity in ("attitude", "angular_velocity_body"):
        if fine[quantity] > 1e-11:
            assert fine[quantity] <= 2e5 * h**order
            # Near the middle axis a drift of the energy, of higher order, may still outweigh: then it falls faster.
            assert coarse[quantity] / fine[quantity] >= 0.8 * 2.0**order


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", FREE)
def test_free_body_goes_straight(name: str, method: str) -> None:
    case = free(name)
    time = min(case.states)

    found = errors(case, time, move(case, METHODS[method], 0.05, time))

    assert found["position_world"] <= 8.0 * EPS
    assert found["linear_velocity_world"] <= 2.0 * EPS


@pytest.mark.parametrize("name", [name for name, m in METHODS.items() if m.order is None])
@pytest.mark.parametrize("case", FREE)
def test_closed_form_is_exact_at_every_time(name: str, case: str) -> None:
    turning = free(case)
    rate = max(map(abs, turning.initial.angular_velocity_body))

    for time in turning.states:
        found = errors(turning, time, move(turning, METHODS[name], 1e6, time))
        assert found["attitude"] <= 100.0 * EPS * (1.0 + rate * time)
        assert found["angular_velocity_body"] <= 100.0 * EPS * rate * (1.0 + rate * time)


class TestData:
    """The references themselves: what can be checked without trusting how they were made."""

    def test_free_states_keep_energy_and_momentum(self) -> None:
        document = json.loads((DATA / "free_motion.json").read_text(encoding="utf-8"))
        with mp.workdps(40):
            for case in document["cases"].values():
                moments = [mpf(case["inertia"][i][i]) for i in range(3)]
                start = [mpf(w) for w in case["angular_velocity_body"]]
                energy, square = ([mpf(0)] * 2, [mpf(0)] * 2)
                for state in case["states"]:
                    w = [mpf(c) for c in state["w"]]
                    q = [mpf(c) for c in state["q"]]
                    for k, v in enumerate((start, w)):
                        energy[k] = mp.fsum(i * c * c for i, c in zip(moments, v, strict=True))
                        square[k] = mp.fsum((i * c) ** 2 for i, c in zip(moments, v, strict=True))
                    assert abs(energy[1] / energy[0] - 1) < mpf(10) ** -31
                    assert abs(square[1] / square[0] - 1) < mpf(10) ** -31
                    assert abs(mp.fdot(q, q) - 1) < mpf(10) ** -31

    def test_forced_states_are_made_again_by_their_generator(self) -> None:
        """To t = 1, with another step and another order than those that made the file."""
        generator = load_script(DATA.parent / "make_reference.py")
        with mp.workdps(50):
            motion = generator.Motion(generator.CASE)
            y = motion.start
            for _ in range(10):
                y = [generator.value(series, mpf(1) / 10) for series in motion.coefficients(y, 36)]
            again = motion.outputs(1, y)

            for name, values in forced().states[1].items():
                if name == "time":
                    continue
                for a, b in zip(*([v] if isinstance(v, str) else v for v in (again[name], values)), strict=True):
                    assert abs(mpf(a) - mpf(b)) <= mpf(10) ** -28

    def test_forced_case_is_that_of_the_generator(self) -> None:
        document = json.loads((DATA / "forced_motion.json").read_text(encoding="utf-8"))

        assert document["case"] == load_script(DATA.parent / "make_reference.py").CASE
