"""The page on the lecture: its code runs, its claims hold, its names exist, and it covers both texts."""

from __future__ import annotations

import re
from pathlib import Path
from types import ModuleType

import pytest
from scripts import load_script

pytest.importorskip("matplotlib", reason="extra 'plot' is not installed")

# Of the equations, as they stand in both texts. In the second one (17), (23) and (24) fell out of the extraction.
NUMBERS = [
    *(1, 2, 3),  # N = d(I w)/dt
    *(4, 5, 6, 7, 8, 9),  # the inertia tensor, moments and products
    *(10, 11),  # principal axes
    *(12, 13),  # scalar inertia, radius of gyration
    *(14, 15, 16, 17),  # inertia ellipsoid
    *(18, 19),  # N in principal axes
    *(20, 21, 22),  # Euler's equations
    *(23, 24, 25),  # the same, explored
    *(26, 27, 28, 29),  # Poinsot
]

# What has no number is named by its page; the others are title, outline, or hold numbered equations alone.
PAGES = [3, *range(4, 24), 26, 27, 29, 30, 32, 33, 34, 35, 36, 37]

NAMED = [
    "impulse",
    "power",
    "work",
    "centre of mass",
    "Principal axes",
    "radius of gyration",
    "inertia ellipsoid",
    "symmetry",
    "Euler's equations",
    "Poinsot's construction",
    "invariable plane",
    "polhode",
    "herpolhode",
    "without slipping",
]


@pytest.fixture(scope="module")
def lecture(root: Path) -> ModuleType:
    return load_script(root / "tools" / "make_lecture.py")


@pytest.fixture(scope="module")
def page(lecture: ModuleType):
    return lecture.make_page()


def test_every_claim_holds(page) -> None:
    assert len(page.residuals) > 60
    assert max(page.residuals.values()) < 1e-12


def test_a_claim_that_does_not_hold_is_no_page(lecture: ModuleType) -> None:
    with pytest.raises(ValueError, match="its claim is wrong"):
        lecture.bound(1e-6)
    with pytest.raises(ValueError, match="its claim is wrong"):
        lecture.bound(float("nan"))


@pytest.mark.parametrize(("residual", "shown"), [(0.0, 1e-14), (1e-15, 1e-14), (1.1e-15, 1e-13), (9e-14, 1e-12)])
def test_residuals_are_rounded_up_with_a_margin(lecture: ModuleType, residual: float, shown: float) -> None:
    assert lecture.bound(residual) == pytest.approx(shown, rel=1e-9)


def test_every_numbered_equation_is_there(page) -> None:
    first_cells = re.findall(r"^\| ([^|]+) \|", page.text, re.MULTILINE)

    assert sorted(int(n) for cell in first_cells for n in re.findall(r"\((\d+)\)", cell)) == NUMBERS == [*range(1, 30)]


def test_every_page_is_there(page) -> None:
    rows = re.findall(r"^\| .*?p\. ([\d, ]+) \|", page.text, re.MULTILINE)
    covered = {int(n) for row in rows for n in row.split(",")}

    assert [number for number in PAGES if number not in covered] == []
    assert [name for name in NAMED if name.lower() not in page.text.lower()] == []


def test_every_function_exists_and_is_documented(lecture: ModuleType, page) -> None:
    names = set(re.findall(r"`(rb_dynamics[\w.]*)`", page.text))

    assert len(names) > 35
    for name in names:
        assert not any(part.startswith("_") for part in name.split(".")), f"{name} is private"
        found = lecture.find(name)
        assert callable(found), name
        assert found.__doc__, name
    assert not [row for row in page.text.splitlines() if row.startswith(("| (", "| p.")) and "`rb_dynamics" not in row]


def test_the_page_on_disk_is_current(lecture: ModuleType, page, root: Path) -> None:
    text = (root / "docs" / "lecture.md").read_text(encoding="utf-8")

    assert lecture.difference(text, page.text) == ""
    targets = re.findall(r"\]\(([^)#]+)\)", text)
    assert [target for target in targets if not (root / "docs" / target).exists()] == []
    assert {Path(target).name for target in targets if target.endswith(".svg")} == set(lecture.FIGURES)


def test_a_page_that_differs_is_told(lecture: ModuleType) -> None:
    page = "one\nthe plane is 1.4720 rad/s away: < 1e-14\nthree"

    assert lecture.difference(page.replace("1.4720", "1.4721"), page) == ""
    assert lecture.difference(page.replace("1e-14", "1e-13"), page) == ""
    assert "1.4740" in lecture.difference(page.replace("1.4720", "1.4740"), page)
    assert "1e-16" in lecture.difference(page.replace("1e-14", "1e-16"), page)
    assert "four" in lecture.difference(page.replace("three", "four"), page)
    assert lecture.difference(page + "\nmore", page) == "found 4 lines, expected 3"


@pytest.mark.parametrize("name", ["lecture-cylinder.svg", "lecture-herpolhodes.svg"])
def test_figures_are_the_same_every_time(lecture: ModuleType, name: str) -> None:
    first = lecture.draw(name)

    assert first.startswith(b"<?xml")
    assert first == lecture.draw(name)
    assert b"<dc:date>" not in first
