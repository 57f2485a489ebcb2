"""Invalid numbers on the command line give a plain message without names of functions or types."""

from __future__ import annotations

import pytest

from rb_dynamics.cli import main, parser


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("simulate s.yaml --flush soon", "argument --flush: found 'soon', expected a number of seconds, 0 or more"),
        (
            "simulate s.yaml --max-bag-duration=-1",
            "argument --max-bag-duration: found '-1', expected a number of seconds, 0 or more",
        ),
        (
            "simulate s.yaml --max-bag-size 1.5",
            "argument --max-bag-size: found '1.5', expected a whole number of bytes, 0 or more",
        ),
        ("simulate s.yaml --duration 5s", "argument --duration: found '5s', expected a number of seconds, such as 10"),
        ("simulate s.yaml --accuracy nan", "argument --accuracy: found 'nan', expected a number such as 1e-9"),
        ("inspect run.mcap --bound 0", "argument --bound: found '0', expected a number greater than 0 such as 1e-6"),
        ("replay run.mcap --rate fast", "argument --rate: found 'fast', expected a number, 0 or more"),
        ("campaign c.yaml --runs 0", "argument --runs: found '0', expected a whole number of 1 or more"),
        ("campaign c.yaml --seed -1", "argument --seed: found '-1', expected a whole number of 0 or more"),
        ("campaign c.yaml --workers two", "argument --workers: found 'two', expected a whole number of 0 or more"),
        ("trade s.yaml --target inf", "argument --target: found 'inf', expected a finite number greater than 0"),
        ("body s.yaml --mesh m.stl --scale 0", "argument --scale: found '0', expected a number greater than 0"),
        ("body s.yaml --axis 1 0 z", "argument --axis: found 'z', expected a finite number"),
        ("simulate s.yaml --duration 1_0", "argument --duration: found '1_0', expected a number of seconds"),
        ("campaign c.yaml --runs 1_0", "argument --runs: found '1_0', expected a whole number"),
        ("campaign c.yaml --runs " + "9" * 5000, "expected a whole number"),
        ("body s.yaml --through inf 0 0", "argument --through: found 'inf', expected a finite number"),
    ],
)
def test_what_is_no_such_number_is_answered(line: str, message: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(line.split())
    assert message in capsys.readouterr().err


def test_numbers_are_read() -> None:
    args = parser().parse_args(["simulate", "s.yaml", "--max-bag-size", "100", "--flush", "0", "--step", "1e-3"])
    assert (args.max_bag_size, args.flush, args.step) == (100, 0.0, 1e-3)
