"""Hooks of mkdocs: add files that pages link to outside docs/ to the site, adapt the links, set formulas in MathML.

The pages are written for the source tree, where `../config/slew.yaml` is beside docs/, and for GitHub, which sets
$`...`$. Browsers set MathML without scripts. Pages on disk are not changed.
"""

from __future__ import annotations

import posixpath
import re
from html import unescape
from pathlib import Path

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
BESIDE = ("CHANGELOG.rst", "CONTRIBUTING.md", "LICENSE", "QUALITY_DECLARATION.md")
LINK = re.compile(r"\]\(([^)\s#]+)(#[^)\s]*)?\)")
FORMULA = re.compile(r"\$<code>(.*?)</code>\$", re.DOTALL)


def on_files(files: Files, config: MkDocsConfig, **_: object) -> Files:
    """Add files that pages link to outside docs/."""
    pages = [(path.relative_to(ROOT).as_posix(), path) for path in DOCS.rglob("*.md")]
    targets = {_in_tree(place, match[1]) for place, path in pages for match in LINK.finditer(path.read_text("utf-8"))}
    for target in sorted({*targets, *BESIDE}):
        if not target.startswith("docs/") and target != "README.md" and (ROOT / target).is_file():
            files.append(File.generated(config, _on_site(target), abs_src_path=str(ROOT / target)))
    return files


def on_page_markdown(markdown: str, page: Page, **_: object) -> str:
    """Turn links of the source tree into links of the site."""
    place = page.file.src_uri if page.file.src_uri in map(_on_site, BESIDE) else f"docs/{page.file.src_uri}"

    def link(match: re.Match[str]) -> str:
        if "://" in match[1]:
            return match[0]
        relative = posixpath.relpath(_on_site(_in_tree(place, match[1])), posixpath.dirname(page.file.src_uri) or ".")
        return f"]({relative}{match[2] or ''})"

    return LINK.sub(link, markdown)


def on_page_content(html: str, **_: object) -> str:
    """Turn the LaTeX of formulas into MathML."""

    def formula(match: re.Match[str]) -> str:
        # A bar that is not one of a pair would carry the exponent alone.
        return convert(unescape(match[1]).replace(r"\lvert", r"\left|").replace(r"\rvert", r"\right|"))

    return FORMULA.sub(formula, html)


def _in_tree(place: str, target: str) -> str:
    """Return where in the source tree a link of the page at `place` leads."""
    return posixpath.normpath(posixpath.join(posixpath.dirname(place), target))


def _on_site(path: str) -> str:
    """Return where on the site a file of the source tree is; the changelog is ReStructuredText and Markdown at once."""
    return path.removeprefix("docs/").replace("README.md", "index.md").replace("CHANGELOG.rst", "CHANGELOG.md")
