"""Commands and code of the README, the tutorials and the how-to pages work as written, in order."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
import yaml
from command_line import command

from rb_dynamics import parse_scene

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    ROOT / "README.md",
    ROOT / "docs" / "campaigns.md",
    ROOT / "docs" / "logs.md",
    *sorted((ROOT / "docs" / "tutorials").glob("*.md")),
    *sorted((ROOT / "docs" / "how-to").glob("*.md")),
]
WRITTEN = sorted({*PAGES, *(ROOT / "docs").glob("*.md")} - {ROOT / "docs" / "verification.md"})
LINKED = [*PAGES, *sorted((ROOT / "docs").glob("*.md")), *sorted((ROOT / "docs" / "reference").glob("*.md"))]

COMMAND = ".venv/bin/rb-dynamics "
# What stays until it is stopped, or needs a viewer; the node and what listens to it are in test/ros/test_examples.py.
STAYS = re.compile(r"rb-dynamics node |--into ros|rerun\+http")
# Each of these takes a minute or more, or is much like another.
SLOW = re.compile(r"--video|campaign (?!.*--runs)|trade .*--budget|out/few|run106")


class Step(NamedTuple):
    """One instruction of a page."""

    page: Path
    kind: str
    text: str
    shown: str = ""


def blocks(page: Path) -> Iterator[tuple[str, str, str]]:
    """Yield (language, title, text) of every block of code."""
    yield from re.findall(
        r'^```(\w+)(?: title="([^"]+)")?\n(.*?)^```', page.read_text("utf-8"), re.MULTILINE | re.DOTALL
    )


def steps(page: Path) -> Iterator[Step]:
    """Yield the instructions of a page, in order."""
    for language, title, text in blocks(page):
        if language == "sh":
            for line in text.splitlines():
                if line.startswith(COMMAND) and not STAYS.search(line):
                    yield Step(page, "command", line.removeprefix(COMMAND))
        elif language == "console":
            line, _, shown = text.partition("\n")
            yield Step(page, "shows", line.removeprefix("$ " + COMMAND), shown.strip())
        elif language == "python":
            yield Step(page, "python", text)
        elif language == "yaml" and title.startswith("out/"):
            yield Step(page, "file", text, title)


def marks(step: Step) -> list[pytest.MarkDecorator]:
    slow = step.kind == "command" and SLOW.search(step.text)
    return [pytest.mark.slow, pytest.mark.timeout(900)] if slow else []


def name(page: Path) -> str:
    return page.relative_to(ROOT).with_suffix("").as_posix()


STEPS = [step for page in PAGES for step in steps(page)]


class Reader:
    """Follow the pages from the top, each instruction once."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.done = folder, set[tuple[str, str]]()
        self.failures: dict[Path, str] = {}

    def do(self, last: Step) -> None:
        for step in STEPS[: STEPS.index(last) + 1]:
            if step.page == last.page and (step.kind, step.text) not in self.done:
                if step != last and marks(step):
                    continue
                self.done.add((step.kind, step.text))
                try:
                    self._do(step)
                except AssertionError as error:
                    # What follows may need its files: a package that is missing is why they fail, too.
                    self.failures[step.page] = f"{self.failures.get(step.page, '')}{error}\n"
                    raise AssertionError(self.failures[step.page]) from error

    def _do(self, step: Step) -> None:
        if step.kind == "file":
            (self.folder / step.shown).write_text(step.text, "utf-8")
            return
        if step.kind == "python":
            line = [sys.executable, "-c", step.text]
            result = subprocess.run(line, cwd=self.folder, capture_output=True, text=True, check=False)
        else:
            with pytest.MonkeyPatch.context() as patch:
                patch.chdir(self.folder)
                result = command(*words(step.text))
                if result.returncode == 1 and "--time 10" in step.text:
                    # Other tests share the machine, so this takes longer than a reader's.
                    result = command(*words(step.text.replace("--time 10", "--time 40")))
        if step.kind == "shows":
            assert result.returncode in (0, 1, 2), result.stderr
            assert step.shown
            pattern = ".*".join(re.escape(piece.strip()) for piece in step.shown.split("..."))
            assert re.search(pattern, result.stdout + result.stderr, re.DOTALL), result.stdout + result.stderr
        else:
            assert result.returncode == 0, result.stderr + result.stdout
            assert result.stdout or step.kind == "python"


def words(line: str) -> list[str]:
    """Return the arguments, as a shell splits them."""
    return [word.strip("'") for word in line.partition("  #")[0].split()]


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> Reader:
    """A reader in a folder like the source tree, in which the commands may leave their files."""
    folder = tmp_path_factory.mktemp("readme")
    for each in ("config", "examples"):
        (folder / each).symlink_to(ROOT / each)
    (folder / "out").mkdir()
    return Reader(folder)


def test_every_page_but_the_one_on_installing_asks_for_something() -> None:
    with_steps = {step.page for step in STEPS}
    assert {name(page) for page in PAGES if page not in with_steps} == {
        "docs/tutorials/attitude-loop",
        "docs/how-to/install",
    }


@pytest.mark.timeout(600)  # a campaign compiles, or waits for the processes that do
@pytest.mark.parametrize(
    "step",
    [
        pytest.param(step, id=f"{name(step.page)}-{i}", marks=marks(step))
        for i, step in enumerate(STEPS)
        if step.kind != "file"
    ],
)
def test_step(step: Step, reader: Reader) -> None:
    reader.do(step)


INSTALLS = [
    pytest.param(line, id=f"{name(page)}-{i}")
    for page in [*PAGES, ROOT / "docs" / "campaigns.md", ROOT / "docs" / "extending.md"]
    for i, line in enumerate(re.findall(r"pip install [^`\n]*\.[^`\n]*", page.read_text("utf-8")))
]


@pytest.mark.parametrize("line", INSTALLS)
def test_install_line_names_what_there_is(line: str) -> None:
    """test/packaging checks the content; `make wheels` checks the installation, which needs the network."""
    target, _, asked = shlex.split(line)[-1].rstrip("]").partition("[")
    known = re.findall(r'^    "(\w+)": \[', (ROOT / "setup.py").read_text("utf-8"), re.MULTILINE)
    assert (ROOT / target.removeprefix("./src/rb_dynamics")).is_dir()
    assert {*filter(None, asked.split(","))} <= {*known}


SCENES = [
    pytest.param(title, text, id=f"{name(page)}-{i}")
    for page in PAGES
    for i, (language, title, text) in enumerate(blocks(page))
    if language == "yaml"
]


@pytest.mark.parametrize(("title", "text"), SCENES)
def test_scene_block(title: str, text: str) -> None:
    path, in_part, _ = title.partition(", in part")
    if in_part:
        whole = yaml.safe_load((ROOT / path).read_text("utf-8"))
        assert is_part(yaml.safe_load(text), whole)
    else:
        assert parse_scene(text).body.mass > 0.0


def is_part(part: object, whole: object) -> bool:
    """Whether every value of `part` stands in `whole`."""
    if isinstance(part, dict) and isinstance(whole, dict):
        return all(key in whole and is_part(value, whole[key]) for key, value in part.items())
    return part == whole


def test_the_spacecraft_is_sixty_lines_and_the_node_flies_the_scene_of_the_campaign() -> None:
    """With comments; of the satellite that only detumbles and holds, too."""
    campaign = ROOT / "config" / "campaigns" / "spacecraft.yaml"
    scene = campaign.parent / yaml.safe_load(campaign.read_text("utf-8"))["scene"]
    page = (ROOT / "docs" / "tutorials" / "spacecraft.md").read_text("utf-8")
    count, alone = (
        sum(len(file.read_text("utf-8").splitlines()) for file in files)
        for files in ((campaign, scene), (ROOT / "config" / "wheels.yaml",))
    )
    assert max(count, alone) <= 60
    assert f"Scene and campaign are {count} lines." in page
    assert f"rb-dynamics node {scene.relative_to(ROOT)} " in page


def test_a_part_is_told_from_what_is_none() -> None:
    assert is_part({"a": {"b": 1}}, {"a": {"b": 1, "c": 2}, "d": 3})
    assert not is_part({"a": {"b": 2}}, {"a": {"b": 1, "c": 2}})
    assert not is_part({"e": 1}, {"a": 1})


@pytest.mark.parametrize("page", LINKED, ids=name)
def test_every_link_leads_somewhere(page: Path) -> None:
    text = re.sub(r"^```.*?^```", "", page.read_text("utf-8"), flags=re.MULTILINE | re.DOTALL)
    targets = [target for target in re.findall(r"\]\(([^)\s]+)\)", text) if "://" not in target]
    for target in targets:
        path, _, anchor = target.partition("#")
        file = (page.parent / path) if path else page
        assert file.exists(), target
        assert not anchor or anchor in anchors(file), target


def anchors(page: Path) -> set[str]:
    """Return the anchors of the headings, as GitHub and the site make them."""
    titles = re.findall(r"^#+ (.+)$", page.read_text("utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).strip().replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", WRITTEN, ids=name)
def test_lines_are_not_too_long(page: Path) -> None:
    text = re.sub(r"^```.*?^```", "", page.read_text("utf-8"), flags=re.MULTILINE | re.DOTALL)
    lines = text.splitlines()
    assert [line for line in lines if len(line) > 120 and not line.startswith(("|", "!["))] == []
