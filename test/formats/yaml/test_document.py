"""The YAML tree: lines of keys and values, and limits that hold for any file."""

from __future__ import annotations

import time

import pytest

from rb_dynamics.errors import SceneError
from rb_dynamics.formats.yaml.document import MAX_CHARACTERS, MAX_DEPTH, Node, parse, to_text
from rb_dynamics.formats.yaml.problems import Problems


def tree(text: str) -> dict[str, Node]:
    value = parse(text, Problems("s.yaml")).value
    assert isinstance(value, dict)
    return value


def test_lines_of_keys_and_values() -> None:
    document = tree("# comment\na: 1\n\nb:\n  c:\n    [1,\n     2]\n")
    assert (document["a"].key_line, document["a"].line) == (2, 2)
    b = document["b"].value
    assert isinstance(b, dict)
    assert (b["c"].key_line, b["c"].line) == (5, 6)
    c = b["c"].value
    assert isinstance(c, list)
    assert [item.line for item in c] == [6, 7]


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1", 1.0),
        ("-0", -0.0),
        ("1e-9", 1e-9),
        ("'1'", "1"),
        ("yes", True),
        ("off", False),
        ("~", None),
        ("", None),
        (".inf", float("inf")),
        ("-.Inf", float("-inf")),
        ("nan", "nan"),
        ("010", "010"),
        ("0b1", "0b1"),
        ("1:30", "1:30"),
        ("1_0", "1_0"),
        ("2024-01-01", "2024-01-01"),
        ("٣", "٣"),  # a digit, but not a decimal one
        ("=", "="),
    ],
)
def test_scalars(text: str, value: object) -> None:
    found = tree(f"a: {text}")["a"].value
    assert found == value
    assert type(found) is type(value)


def test_keys_are_names_whatever_yaml_makes_of_them() -> None:
    assert list(tree("on: 1\n5: 2\nnull: 3\n")) == ["on", "5", "null"]


LAUGHS = "a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1]\n" + "".join(
    f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 20)
)


@pytest.mark.parametrize(
    ("text", "fragment"),
    [
        (LAUGHS, "more than 100000 values"),
        ("a: &a [*a]", f"nested more than {MAX_DEPTH} deep"),
        ("a: &a {b: *a}", f"nested more than {MAX_DEPTH} deep"),
        ("a: " + "[" * 100_000, f"nested more than {MAX_DEPTH} deep"),
        ("a: " + "{b: " * 100_000, f"nested more than {MAX_DEPTH} deep"),
        ("- " * 100_000, f"nested more than {MAX_DEPTH} deep"),
        ("? " * 100_000, f"nested more than {MAX_DEPTH} deep"),
        ("a: " + "x" * MAX_CHARACTERS, f"expected at most {MAX_CHARACTERS}"),
    ],
    ids=["aliases", "list in itself", "mapping in itself", "brackets", "braces", "dashes", "question marks", "length"],
)
def test_bounds(text: str, fragment: str) -> None:
    start = time.process_time()
    with pytest.raises(SceneError, match=fragment):
        parse(text, Problems("s.yaml"))
    assert time.process_time() - start < 20.0


def test_nesting_up_to_the_limit_is_read() -> None:
    assert tree("a: " + "[" * (MAX_DEPTH - 1) + "]" * (MAX_DEPTH - 1))
    assert tree("a: " + "[" * MAX_DEPTH + "]" * MAX_DEPTH)
    with pytest.raises(SceneError):
        tree("a: " + "[" * (MAX_DEPTH + 1) + "]" * (MAX_DEPTH + 1))


def test_a_text_that_is_written_has_whole_numbers_as_they_were() -> None:
    text = "a: 60\nb: [1.0, -0, 3]\nc: 1e3\n"
    written = to_text(parse(text, Problems("x")), "x")
    assert written == "# x\na: 60\nb: [1.0, -0.0, 3]\nc: 1000.0\n"
