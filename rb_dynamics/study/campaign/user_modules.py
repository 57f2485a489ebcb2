"""User modules of a campaign: their source is sent with it, so that every process runs the same code.

This applies to modules beside the campaign file, and to everything that their `import` statements find there. Each is
loaded under a name that contains its hash, so that modules of the same name, or earlier versions, do not mix. Installed
modules are imported as usual, and refused if their source differs from that of the commanding process.
"""

from __future__ import annotations

import ast
import builtins
import hashlib
import os
import platform
import sys
import sysconfig
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from importlib.abc import ExecutionLoader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import decode_source, find_spec, resolve_name
from pathlib import Path
from types import ModuleType
from typing import Any

from rb_dynamics.errors import SceneError

PACKAGE = "rb_dynamics_campaign_"
"""Begin of the name of the package of the modules of a campaign; a hash follows."""


@dataclass(frozen=True)
class ModuleSource:
    """A module that is sent with the campaign.

    Attributes:
        name: dotted, as imported beside the campaign file.
        file: its path when read, for tracebacks.
        text: its source.
        is_package: whether it is the `__init__` of a package.
    """

    name: str
    file: str
    text: str
    is_package: bool


@dataclass(frozen=True)
class UserModules:
    """The modules that a campaign names, and what they import.

    Attributes:
        beside: modules beside the campaign file, which are sent with it.
        installed: top-level names of the other modules, each with the hash of its source.
    """

    beside: tuple[ModuleSource, ...] = ()
    installed: tuple[tuple[str, str], ...] = ()

    @property
    def hashes(self) -> Mapping[str, str]:
        """SHA-256 of the source of each module, by name."""
        return {each.name: _sha256(each.text.encode()) for each in self.beside} | dict(self.installed)

    def load(self, name: str) -> ModuleType:
        """Return the module `name`.

        Raises:
            SceneError: an installed module differs from the one where the campaign was read.
            Exception: whatever the import raises.
        """
        for top, there in self.installed:
            if (here := _installed(top)) != there:
                raise SceneError(
                    f"the module {top} is another on {platform.node()} (source {here[:12] or 'not found'}) than where "
                    f"the campaign was read ({there[:12]}); put it beside the campaign file, from where it travels, or "
                    "install the same everywhere and start the workers again"
                )
        if name in {each.name for each in self.beside}:
            _FINDER.known[self._package] = self
            name = f"{self._package}.{name}"
        return import_module(name)

    def find(self, name: str) -> ModuleSource | None:
        """Return the module `name` sent with the campaign; "" and folders without `__init__` are empty packages."""
        if name in self._by_name:
            return self._by_name[name]
        is_folder = any(not name or each.startswith(f"{name}.") for each in self._by_name)
        return ModuleSource(name, "", "", is_package=True) if is_folder else None

    def builtins(self) -> dict[str, Any]:
        """Return builtins for these modules, in which `import` finds the others of this campaign."""
        package, tops = self._package, {each.name.partition(".")[0] for each in self.beside}

        def own_import(
            name: str,
            globals: Mapping[str, object] | None = None,
            locals: Mapping[str, object] | None = None,
            fromlist: Sequence[str] | None = (),
            level: int = 0,
        ) -> ModuleType:
            top = name.partition(".")[0]
            if level or top not in tops:
                return builtins.__import__(name, globals, locals, fromlist, level)
            if fromlist:
                return builtins.__import__(f"{package}.{name}", globals, locals, fromlist)
            import_module(f"{package}.{name}")
            return sys.modules[f"{package}.{top}"]

        return {**vars(builtins), "__import__": own_import}

    @cached_property
    def _package(self) -> str:
        return f"{PACKAGE}{_sha256(repr(sorted(self.hashes.items())).encode())}"

    @cached_property
    def _by_name(self) -> dict[str, ModuleSource]:
        return {each.name: each for each in self.beside}


def read_modules(names: Iterable[str], folder: str) -> UserModules:
    """Return the modules of the functions `names` (`module.function`), and their imports; `folder` is searched first.

    Raises:
        SceneError: a module in `folder` cannot be read.
    """
    beside: dict[str, ModuleSource | None] = {}
    installed: dict[str, str] = {}
    named = {name.rpartition(".")[0] for name in names}
    waiting = sorted(named)
    while waiting:
        name = waiting.pop()
        for module in _with_parents(name):
            if module not in beside:
                beside[module] = source = _read(Path(folder), module)
                waiting += () if source is None else _imports(source)
        top = name.partition(".")[0]
        is_beside = any(source is not None and key.partition(".")[0] == top for key, source in beside.items())
        if not is_beside and top not in installed and (name in named or _is_user_module(top)):
            installed[top] = _installed(top)
    found = sorted((each for each in beside.values() if each is not None), key=lambda each: each.name)
    return UserModules(tuple(found), tuple(sorted((name, digest) for name, digest in installed.items() if digest)))


def _with_parents(name: str) -> Iterator[str]:
    parts = name.split(".")
    return (".".join(parts[: k + 1]) for k in range(len(parts)))


def _read(folder: Path, name: str) -> ModuleSource | None:
    place = folder.joinpath(*name.split("."))
    for path, is_package in ((place / "__init__.py", True), (place.with_name(f"{place.name}.py"), False)):
        if path.is_file():
            try:
                return ModuleSource(name, os.fspath(path), decode_source(path.read_bytes()), is_package)
            except (OSError, SyntaxError, UnicodeDecodeError) as error:
                raise SceneError(f"cannot read {path}: {error}; correct the module") from error
    return None


def _imports(source: ModuleSource) -> Iterator[str]:
    """Yield the absolute names that `source` may import; names inside modules are included, and are found nowhere."""
    package = source.name if source.is_package else source.name.rpartition(".")[0]
    try:
        tree = ast.parse(source.text, source.file)
    except (SyntaxError, ValueError) as error:
        raise SceneError(f"cannot read {source.file}: {error}; correct the module") from error
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (each.name for each in node.names)
        elif isinstance(node, ast.ImportFrom):
            try:
                # Relative to the package under which all of them are loaded.
                base = resolve_name("." * node.level + (node.module or ""), f"_.{package}".rstrip("."))
            except ImportError:
                continue
            base = base.removeprefix("_").removeprefix(".") if node.level else base
            yield from ([base] if base else [])
            yield from (f"{base}.{each.name}".lstrip(".") for each in node.names if each.name != "*")


def _is_user_module(top: str) -> bool:
    """Return whether an importable module belongs to neither Python, nor an installed package, nor this one."""
    if top in sys.stdlib_module_names or top == "rb_dynamics":
        return False
    ours = [Path(sysconfig.get_path(key)) for key in ("purelib", "platlib")]
    return any(
        not {"site-packages", "dist-packages"} & set(path.parts) and not any(path.is_relative_to(each) for each in ours)
        for path in _places(top)
    )


_seen: dict[str, str] = {}


def _installed(top: str) -> str:
    """Return the hash of `top` when first asked in this process (imports are cached, too); "" if not found."""
    if top not in _seen:
        files = [
            file for place in _places(top) for file in (sorted(place.rglob("*.py")) if place.is_dir() else [place])
        ]
        _seen[top] = _sha256(b"".join(file.read_bytes() for file in files)) if files else ""
    return _seen[top]


def _places(top: str) -> list[Path]:
    """Return the file or the folders of a top-level module."""
    try:
        spec = find_spec(top)
    except (ImportError, ValueError):
        return []
    if spec is None:
        return []
    if spec.submodule_search_locations is not None:
        return [Path(place) for place in spec.submodule_search_locations]
    return [Path(spec.origin)] if spec.has_location and spec.origin else []


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


class _Finder(MetaPathFinder):
    """Finds the modules sent with campaigns."""

    def __init__(self) -> None:
        self.known: dict[str, UserModules] = {}
        sys.meta_path.append(self)

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        package, _, name = fullname.partition(".")
        modules = self.known.get(package)
        source = None if modules is None else modules.find(name)
        if modules is None or source is None:
            return None
        spec = ModuleSpec(fullname, _Loader(modules, source), origin=source.file or None, is_package=source.is_package)
        spec.has_location = bool(source.file)
        return spec


class _Loader(ExecutionLoader):
    def __init__(self, modules: UserModules, source: ModuleSource) -> None:
        self._modules, self._source = modules, source

    def get_filename(self, fullname: str) -> str:
        return self._source.file

    def get_source(self, fullname: str) -> str:
        return self._source.text

    def is_package(self, fullname: str) -> bool:
        return self._source.is_package

    def exec_module(self, module: ModuleType) -> None:
        module.__dict__["__builtins__"] = self._modules.builtins()
        super().exec_module(module)


_FINDER = _Finder()
