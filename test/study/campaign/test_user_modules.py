"""User modules: what is sent with a campaign, and that each campaign runs its own version."""

from __future__ import annotations

import pickle
import sys
from pathlib import Path
from typing import Any

import pytest

from rb_dynamics.errors import SceneError
from rb_dynamics.study.campaign.user_modules import UserModules, read_modules


def modules(folder: Path, files: dict[str, str], *names: str) -> UserModules:
    for file, text in files.items():
        path = folder / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return read_modules(names, str(folder))


def result(found: UserModules, name: str = "law") -> Any:
    module, _, function = name.rpartition(".")
    return getattr(found.load(module or "law"), function or "law")()


TAKEN = {
    "beside": ("import gains\n\n\ndef law():\n    return gains.K\n", ["gains.py"]),
    "from": ("from gains import K as k\n\n\ndef law():\n    return k\n", ["gains.py"]),
    "all": ("from gains import *\n\n\ndef law():\n    return K\n", ["gains.py"]),
    "relative": ("from . import gains\n\n\ndef law():\n    return gains.K\n", ["gains.py"]),
    "late": ("def law():\n    import gains\n\n    return gains.K\n", ["gains.py"]),
    "as": ("import part.gains as g\n\n\ndef law():\n    return g.K\n", ["part/gains.py"]),
    "dotted": ("import part.gains\n\n\ndef law():\n    return part.gains.K\n", ["part/gains.py", "part/__init__.py"]),
    "of a folder": ("from part import gains\n\n\ndef law():\n    return gains.K\n", ["part/gains.py"]),
    "in a package": ("from part import K\n\n\ndef law():\n    return K\n", ["part/__init__.py"]),
}


@pytest.mark.parametrize(("text", "files"), TAKEN.values(), ids=TAKEN)
def test_what_a_module_imports_beside_it_goes_along(tmp_path: Path, text: str, files: list[str]) -> None:
    found = []
    for number in (1, 2):
        helpers = dict.fromkeys(files, f"K = {number}\n")
        read = modules(tmp_path / str(number), {"law.py": text, **helpers, "not_imported.py": "1 / 0\n"}, "law.law")
        found.append(pickle.loads(pickle.dumps(read)))
        for file in (tmp_path / str(number)).rglob("*.py"):
            file.unlink()
    # The files are no longer there; both are in one process, and each has its own.
    assert [result(each) for each in found] == [1, 2]
    assert found[0].hashes.keys() == found[1].hashes.keys()
    assert found[0].hashes["law"] == found[1].hashes["law"]
    assert "not_imported" not in found[0].hashes
    assert not {"law", "gains", "part"} & sys.modules.keys()


def test_relative_imports_in_a_package(tmp_path: Path) -> None:
    files = {
        "own/__init__.py": "",
        "own/laws/damp.py": "from ..gains import K\nfrom .more import M\n\n\ndef law():\n    return K + M\n",
        "own/laws/more.py": "M = 2\n",
        "own/gains.py": "K = 40\n",
    }
    found = modules(tmp_path, files, "own.laws.damp.law")
    assert set(found.hashes) == {"own", "own.laws.damp", "own.laws.more", "own.gains"}
    assert result(found, "own.laws.damp.law") == 42


def test_a_file_beside_hides_no_library_from_libraries(tmp_path: Path) -> None:
    """The user's module is used for the name, while numpy still imports Python's own `random`."""
    files = {"law.py": "import random\nimport numpy\n\n\ndef law():\n    return random.X\n", "random.py": "X = 5\n"}
    assert result(modules(tmp_path, files, "law.law")) == 5
    import random

    assert random.random() < 1.0


def test_the_same_source_is_the_same_module_wherever_it_lies(tmp_path: Path) -> None:
    read = [modules(tmp_path / name, {"law.py": "def law():\n    return []\n"}, "law.law") for name in "ab"]
    assert read[0].hashes == read[1].hashes
    assert read[0].load("law") is read[1].load("law")


def test_tracebacks_show_the_line(tmp_path: Path) -> None:
    found = modules(tmp_path, {"law.py": "def law():\n    return 1 / 0\n"}, "law.law")
    with pytest.raises(ZeroDivisionError) as caught:
        result(found)
    assert caught.traceback[-1].path == tmp_path / "law.py"


@pytest.mark.parametrize("text", ["def law(:\n", "\0", "# coding: none-such\n"])
def test_a_module_that_is_none_is_named(tmp_path: Path, text: str) -> None:
    with pytest.raises(SceneError, match=r"^cannot read \S+law.py: [^\n]*; correct the module$"):
        modules(tmp_path, {"law.py": text}, "law.law")


def test_an_installed_module_that_is_another_elsewhere_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that the campaign names, and one that only its module imports: both are found on the path of Python."""
    there = tmp_path / "there"
    monkeypatch.syspath_prepend(str(there))
    modules(there, {"own_installed.py": "def law():\n    return 1\n", "own_helper.py": "K = 3\n"})
    beside = {"law.py": "import own_helper\n\n\ndef law():\n    return own_helper.K\n"}
    found = modules(tmp_path / "here", beside, "law.law", "own_installed.law")
    assert [name for name, _ in found.installed] == ["own_helper", "own_installed"]
    assert (result(found), result(found, "own_installed.law")) == (3, 1)

    monkeypatch.setattr("rb_dynamics.study.campaign.user_modules._seen", {"own_helper": "0" * 64})
    with pytest.raises(SceneError, match=r"the module own_helper is another on .* \(source 0{12}\) than where "):
        found.load("law")
