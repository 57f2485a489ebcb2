"""Results of `trade`: the front, the recommendation, and the solver line to paste."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rb_dynamics.scene.read import parse_scene
from rb_dynamics.study.trade.refinement import TIME_IS_UP
from rb_dynamics.study.trade.result import HOPELESS, Reference, Trade, TradeRow, recommend, with_front

BODY = "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\n"
ROW = TradeRow("rk4", 0.1, None, 1e-5, 2e-5, 3e-5, 1e-5, False, 0.0, 0.0, 0.0, 1e-3, 1e3, 5e-4, 10, 40, False)


def row(seconds: float, error: float, method: str = "rk4") -> TradeRow:
    return replace(ROW, method=method, time_per_s=seconds, real_time_factor=1.0 / seconds, error=error)


ROWS = st.lists(
    st.builds(row, st.sampled_from([1e-6, 1e-5, 3e-5, 1e-4, 1.0]), st.sampled_from([0.0, 1e-12, 1e-9, 1e-3, 3.0])),
    max_size=30,
)


@given(ROWS)
def test_the_front_is_what_nothing_beats(rows: list[TradeRow]) -> None:
    marked = with_front(rows)

    assert [replace(one, front=False) for one in marked] == rows
    for one in marked:
        beaten = any(
            other.time_per_s <= one.time_per_s
            and other.error <= one.error
            and (other.time_per_s, other.error) != (one.time_per_s, one.error)
            for other in rows
        )
        assert one.front is (not beaten and one.error <= HOPELESS)


@given(ROWS, st.sampled_from([1e-13, 1e-9, 1e-6, 10.0]))
def test_the_recommended_row_keeps_the_target_and_none_that_does_is_faster(rows: list[TradeRow], target: float) -> None:
    found = recommend(rows, target, None)
    able = [one for one in rows if one.error <= target]
    assert (found is None) is (not able)
    if found is not None:
        assert found.row in able
        assert found.row.time_per_s == min(one.time_per_s for one in able)


@given(ROWS, st.sampled_from([1e-3, 1.0, 5e4, 1e7]))
def test_the_recommended_row_keeps_the_budget_and_none_that_does_is_more_accurate(
    rows: list[TradeRow], budget: float
) -> None:
    found = recommend(rows, None, budget)
    able = [one for one in rows if one.real_time_factor >= budget and one.error <= HOPELESS]
    assert (found is None) is (not able)
    if found is not None:
        assert found.row in able
        assert found.row.error == min(one.error for one in able)


@pytest.mark.parametrize("faster", ["exact", "auto"])
@pytest.mark.parametrize("wish", [(1e-9, None), (None, 1.0)])
def test_where_auto_comes_down_to_a_method_that_method_is_named(
    faster: str, wish: tuple[float | None, float | None]
) -> None:
    """Which of the two was faster is chance."""
    rows = with_front([row(1e-6 if method == faster else 2e-6, 1e-12, method) for method in ("exact", "auto")])
    found = recommend(rows, *wish)
    assert found is not None
    assert found.row.method == "exact"
    assert [one.method for one in rows if one.front] == ["exact"]


def test_what_auto_alone_does_is_recommended() -> None:
    rows = with_front([row(2e-6, 1e-12, "exact"), replace(row(1e-6, 1e-12, "auto"), steps=2)])
    found = recommend(rows, 1e-9, None)
    assert found is not None
    assert found.row.method == "auto"
    assert [one.method for one in rows if one.front] == ["auto"]


@pytest.mark.parametrize(
    ("methods", "said"),
    [(("rk4", "auto"), "1 method and auto"), (("rk4", "exact"), "2 methods"), (("auto",), "auto"), ((), "")],
)
def test_auto_is_not_counted_as_a_method(methods: tuple[str, ...], said: str) -> None:
    rows = tuple(row(1e-6, 1e-12, method) for method in methods)
    reference = Reference("taylor", "dop853", 0.0, 0.0, 0.0, 0.0, 1.0)
    found = Trade("scene.yaml", 1.0, reference, rows, None, 1e-9, None, {"rk4": "refused"}, {}, (), 1.0, None)
    assert found.measured == said
    assert ("nothing could be measured (rk4: refused)" in found.shortfall) is (not methods)


def test_a_run_that_is_fast_enough_but_not_known_to_the_end_is_not_called_too_slow() -> None:
    reference = Reference("taylor", "dop853", 0.0, 0.0, 0.0, 0.0, 1.0)
    found = Trade("scene.yaml", 1.0, reference, (row(1e-6, 1e-12),), None, None, 10.0, {}, {}, (), 9.0, None)
    assert "at 10 times real time or faster is known to follow the motion for all 9 s" in found.shortfall
    assert "the fastest that does at 1e+06" in replace(found, budget=1e7).shortfall


def test_what_the_times_do_not_tell_apart_is_said() -> None:
    """On a busy machine each trade recommended another setting, with no word of doubt."""
    reference = Reference("taylor", "dop853", 0.0, 0.0, 0.0, 0.0, 1.0)
    rows = (
        replace(row(1.0e-3, 1e-7), time_spread=0.2),
        replace(row(1.1e-3, 1e-8), step=0.05, time_spread=0.2),
        replace(row(1.15e-3, 1e-9, "dverk"), time_spread=0.2),
        replace(row(1.19e-3, 1e-3, "cf4"), time_spread=0.1),
        replace(row(1.3e-3, 1e-9, "dop853"), time_spread=None),
    )
    late = {"rk4": "its finest setting", "dverk": TIME_IS_UP, "cf4": TIME_IS_UP, "radau": TIME_IS_UP}

    def doubts(target: float | None, budget: float | None) -> tuple[str, ...]:
        taken = recommend(rows, target, budget)
        return Trade("scene.yaml", 1.0, reference, rows, taken, target, budget, late, {}, (), 1.0, None).doubts

    assert doubts(1e-6, None) == (
        "times vary by 20% from run to run, so these may be as fast: rk4, step 0.05 s; dverk, step 0.1 s",
        "no time to reach the target with cf4, radau: a better setting may be among theirs; more time (--time) tells",
    )
    assert doubts(None, 800.0)[0] == "its time varies by 20% from run to run, so it may miss the budget"
    assert not any("budget" in doubt for doubt in doubts(None, 100.0)[:-1])
    assert doubts(1e-12, None) == ()


@pytest.mark.parametrize(
    ("method", "step", "accuracy", "line"),
    [
        ("rk4", 0.01, None, "solver: {method: rk4, step: 0.01}"),
        ("rk4", 1e-7, None, "solver: {method: rk4, step: 1.0e-7}"),
        ("dop853", None, 2.5e-9, "solver: {method: dop853, accuracy: 2.5e-9}"),
        ("exact", None, None, "solver: {method: exact}"),
    ],
)
def test_the_line_to_paste_says_what_was_measured(
    method: str, step: float | None, accuracy: float | None, line: str
) -> None:
    assert replace(ROW, method=method, step=step, accuracy=accuracy).solver == line
    solver = parse_scene(f"{BODY}{line}").solver
    assert (solver.method, solver.step) == (method, step)
    assert accuracy is None or solver.accuracy == accuracy
