"""Numbers in text: what counts as a decimal number, independent of Python's own rules."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction

import pytest

from rb_dynamics.numerics.number_parsing import is_decimal, real_number, rounded_multiple, whole_number

NUMBERS = ["0", "-0", "+1", "1.", ".5", "-1.5e-3", "007", "1E9", "9223372036.854775807", "1e-9999"]
NONE = ["", " 1", "1 ", "1_0", "1/3", "0x10", "١", "1e99999", "1e", ".", "e5", "1,5", "--1", "1e1.5", "True", "\n1"]


@pytest.mark.parametrize("text", NUMBERS)
def test_a_decimal_number_is_read_as_python_reads_it(text: str) -> None:
    assert is_decimal(text)
    assert real_number(text) == float(text)
    for unit in (1, 1000, 10**9):
        assert rounded_multiple(text, unit) == round(Fraction(text) * unit)


def test_a_multiple_is_rounded_to_even_from_all_digits() -> None:
    halves = [rounded_multiple(text, 10**9) for text in ("0.0000000005", "0.0000000015", "-1.0000000005")]
    assert halves == [0, 2, -1_000_000_000]
    assert rounded_multiple("1700000000.123456789", 10**9) == 1_700_000_000_123_456_789
    assert rounded_multiple("1.50", 1) == 2


@pytest.mark.parametrize("read", [real_number, lambda text: rounded_multiple(text, 10**9), whole_number])
@pytest.mark.parametrize("text", NONE)
def test_nothing_else_is_a_number(read: Callable[[str], object], text: str) -> None:
    assert not is_decimal(text)
    with pytest.raises(ValueError, match="is not a number"):
        read(text)


def test_what_is_not_finite_is_real_only() -> None:
    assert [real_number(text) for text in ("inf", "-Infinity", "1e400")] == [float("inf"), -float("inf"), float("inf")]
    assert real_number("NaN") != real_number("NaN")
    with pytest.raises(ValueError, match="is not a number"):
        rounded_multiple("inf", 1)


def test_a_whole_number_has_no_more_digits_than_one_reads_at_once() -> None:
    assert whole_number("-0042") == -42
    for text in ("1.0", "1e3", "9" * 301):
        with pytest.raises(ValueError, match="is not a number"):
            whole_number(text)
