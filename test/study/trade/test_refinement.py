"""`refine`: methods get equal time, no run exceeds the deadline, and refusals end what they should."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence

from hypothesis import given
from hypothesis import strategies as st

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.motion import METHODS
from rb_dynamics.scene.model import Solver
from rb_dynamics.study.trade.refinement import TIME_IS_UP, Refinement, refine


class Machine:
    """A simulated clock, and runs of given durations."""

    def __init__(self, cost: Callable[[Solver], float]) -> None:
        self.now = 0.0
        self.log: list[tuple[str, float, float]] = []
        self._cost = cost

    def clock(self) -> float:
        return self.now

    def measure(self, solver: Solver, limit: float) -> tuple[float, str]:
        cost = self._cost(solver)
        self.log.append((solver.method, cost, limit))
        self.now += min(cost, limit)
        return (cost, "") if cost <= limit else (math.inf, TIME_IS_UP)


def refinement(method: str, rungs: int = 40, growth: float = 2.0) -> Refinement:
    return Refinement(method, [Solver(method, step=0.5**k, accuracy=None) for k in range(rungs)], growth)


def test_methods_get_the_same_time() -> None:
    prices = {"rk4": 1e-5, "radau": 1e-3}
    machine = Machine(lambda solver: prices[solver.method] / (solver.step or 1.0))
    refinements = [refinement("rk4"), refinement("radau")]

    refine(refinements, machine.measure, 10.0, machine.clock)

    # Runs double, so that each may be short of its half by what the next run would have taken.
    assert machine.now <= 10.0
    for one in refinements:
        assert 1.2 < one.spent < 8.0
        assert one.ended == TIME_IS_UP
    assert refinements[0].runs - refinements[1].runs in (6, 7)


def test_where_all_settings_take_too_long_those_far_from_what_is_asked_for_are_passed_over() -> None:
    """Compiled from 0.1 s on, a hundred times as fast; the 14th setting is near what is asked for."""

    def cost(solver: Solver) -> float:
        plain = 1e-3 / (solver.step or 1.0)
        return plain if plain <= 0.1 else 0.01 * plain

    def foresee(coming: Sequence[Solver]) -> tuple[int, float]:
        return max(0, len(coming) - 27), 0.1

    def tried(end: float) -> list[float]:
        machine = Machine(cost)
        refine([refinement("rk4")], machine.measure, end, machine.clock, foresee=foresee)
        return [price for _, price, _ in machine.log]

    settings = [cost(Solver("rk4", step=0.5**k, accuracy=None)) for k in range(40)]
    assert tried(1.0)[:3] == [settings[0], settings[13], settings[14]]
    # With time for all of them, none is passed over; nor where the one that is near takes too long itself.
    assert tried(1e9) == settings
    assert tried(0.3)[:4] == settings[:4]


def test_what_one_leaves_the_others_get() -> None:
    machine = Machine(lambda solver: 1e-3 / (solver.step or 1.0))
    refinements = [refinement("rk4", rungs=2), refinement("radau")]

    refine(refinements, machine.measure, 10.0, machine.clock)

    assert refinements[0].ended == "its finest setting"
    assert refinements[1].spent > 4.0


@given(
    st.lists(st.floats(1e-6, 1.0), min_size=1, max_size=6),
    st.floats(0.1, 10.0),
    st.floats(1.0, 1.9),
)
def test_no_run_is_started_that_would_not_end_in_time(prices: list[float], end: float, true_growth: float) -> None:
    """If run times grow as expected, only the first run of a method can be cut off."""
    names = list(METHODS)[: len(prices)]
    machine = Machine(lambda solver: prices[names.index(solver.method)] * true_growth ** -math.log2(solver.step or 1.0))
    refinements = [refinement(name) for name in names]

    refine(refinements, machine.measure, end, machine.clock)

    assert machine.now <= end * (1.0 + 1e-12)
    assert all(one.ended for one in refinements)
    seen = set()
    for method, cost, limit in machine.log:
        assert method not in seen or cost <= limit
        seen.add(method)
    assert seen == set(names) or machine.now > 0.0


def test_refused_at_first_a_method_goes_on_to_finer_settings_and_no_further_than_it_can() -> None:
    def measure(solver: Solver, limit: float) -> tuple[float, str]:
        if not 1e-3 < (solver.step or 0.0) < 0.2:
            raise ConvergenceError("too long or too short")
        return 1e-9, ""

    able, unable = refinement("rk4"), refinement("radau", rungs=3)
    refine([able, unable], measure, 1.0, itertools.count(0.0, 1e-6).__next__)

    assert able.runs == 7
    assert able.ended == unable.ended == "refused: too long or too short"
    assert unable.runs == 0
