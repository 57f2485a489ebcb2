"""The page on verification names every method and only existing tests, and its generator works."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from types import ModuleType

import pytest
from motions import EPS, METHODS, STEPPED
from scripts import load_script

pytest.importorskip("matplotlib", reason="extra 'plot' is not installed")


@pytest.fixture(scope="module")
def generator(root: Path) -> ModuleType:
    return load_script(root / "tools" / "make_verification.py")


@pytest.fixture(scope="module")
def page(root: Path) -> str:
    return (root / "docs" / "verification.md").read_text(encoding="utf-8")


def section(page: str, title: str) -> str:
    return page.split(f"## {title}\n", 1)[1].split("\n## ", 1)[0]


@pytest.mark.parametrize(
    ("title", "methods"),
    [
        ("Order", STEPPED),
        ("Invariants of free motion", METHODS),
        ("References to 30 digits", METHODS),
        ("Extremes", METHODS),
    ],
)
def test_every_method_is_on_the_page(page: str, title: str, methods: dict[str, object]) -> None:
    """If this fails, run python tools/make_verification.py."""
    named = set(re.findall(r"^\| `(\w+)`", section(page, title), re.MULTILINE))

    assert named == set(methods)


def test_every_test_on_the_page_exists(page: str, root: Path) -> None:
    paths = re.findall(r"`(test/[\w/]+\.py(?:::\w+)*)`", page)

    assert len(paths) > 30
    for path in paths:
        file, *names = path.split("::")
        body = ast.parse((root / file).read_text(encoding="utf-8")).body
        for name in names:
            found = [n for n in body if isinstance(n, (ast.ClassDef, ast.FunctionDef)) and n.name == name]
            assert found, path
            body = found[0].body


def test_the_claims_are_those_of_the_generator(page: str, generator: ModuleType) -> None:
    shown = section(page, "The test for each claim")

    for claim, path in generator.CLAIMS:
        assert f"| {claim.replace('|', chr(92) + '|')} | `{path}` |" in shown


def test_every_figure_exists(page: str, root: Path) -> None:
    names = re.findall(r"!\[[^]]+\]\((images/verification-\w+\.svg)\)", page)

    assert len(names) == 3
    for name in names:
        assert (root / "docs" / name).read_text(encoding="utf-8").lstrip().startswith("<?xml")


def test_tables_have_the_same_number_of_cells_in_every_row(page: str) -> None:
    """An unescaped bar in a formula would start a new cell."""
    for block in re.findall(r"(?:^\|.*\n)+", page + "\n", re.MULTILINE):
        assert len({len(re.split(r"(?<!\\)\|", line)) for line in block.splitlines()}) == 1, block


def test_no_measured_drift_on_the_page_is_large(page: str) -> None:
    """For declared invariants, since the page must not publish a defect."""
    rows = re.findall(r"^\| `\w+` \|(.*)\|$", section(page, "Invariants of free motion"), re.MULTILINE)
    kept = [float(value) for row in rows for value in re.findall(r"kept \| (\S+)", row)]

    assert len(kept) > 20
    assert max(kept) < 1e-13


class TestTheLongDrift:
    """It takes a quarter of an hour; a page made without it keeps the previous value."""

    def test_is_that_of_the_page(self, page: str, generator: ModuleType) -> None:
        kept = generator.kept_drifts(page)

        assert kept.count("\n") == 2 + len(generator.long_runners())
        assert f"\n{kept}\n" in section(page, "Invariants of free motion")
        assert "After 1e9 steps (" in page

    def test_of_other_methods_is_not_kept(self, page: str, generator: ModuleType) -> None:
        with pytest.raises(ValueError, match=r"expected that of .*'midpoint'\]; run with --long"):
            generator.kept_drifts(page.replace("| `midpoint` |", "| `middle` |"))


class TestMeasures:
    """The quick parts of the generator."""

    def test_order(self, generator: ModuleType) -> None:
        ((name, declared, *slopes),) = generator.order_rows(["rk4"])

        assert (name, declared) == ("`rk4`", "4")
        assert [float(s) for s in slopes] == pytest.approx([4.0] * 7, abs=0.3)

    def test_walk(self, generator: ModuleType) -> None:
        found = generator.walk("midpoint", 100, 0)

        assert found.marks[0] == 10
        assert found.marks[-1] == 100
        assert 0.0 < max(found.energy) < 100 * EPS
        assert 0.0 < max(found.angular_momentum) < 100 * EPS

    def test_exponent_of_a_known_growth(self, generator: ModuleType) -> None:
        marks = generator.marks_up_to(10_000)
        walks = [generator.Walk("", marks, tuple(EPS * n**0.5 for n in marks), tuple(EPS * n for n in marks))] * 2

        assert generator.exponent(walks, "energy") == pytest.approx(0.5, rel=1e-9)
        assert generator.exponent(walks, "angular_momentum") == pytest.approx(1.0, rel=1e-9)

    def test_references(self, generator: ModuleType) -> None:
        ((name, step, *values),) = generator.reference_rows(["dlm6"])

        assert (name, step) == ("`dlm6`", "0.01")
        assert max(map(float, values)) < 1e-12

    def test_exactness(self, generator: ModuleType) -> None:
        found = generator.exactness((1.0, 2.0, 3.0), (0.1, 2.0, 0.1), 10.0)

        assert 0.0 < found.attitude < 100.0
        assert max(found.energy, found.angular_momentum) < 20.0

    @pytest.mark.parametrize(
        ("value", "shown"), [(0.0, "0"), (1.23e-15, "1e-15"), (0.26, "0.3"), (2.4, "2"), (4.4e7, "4e7")]
    )
    def test_one_digit(self, generator: ModuleType, value: float, shown: str) -> None:
        assert generator.digit(value) == shown
