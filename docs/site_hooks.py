"""Hooks of the documentation site, named in mkdocs.yml: pages of the root folder, linked source files, equations."""

import html
import logging
import re
from pathlib import Path, PurePosixPath
from typing import Any

from math_core import LatexError, LatexToMathML
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
#: Pages of the root folder, by their names in the site. The README is outside navigation and search: links are checked.
ROOT_PAGES = {"CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md", "README.md": "readme.md"}
#: Pages of links to files of the root folder. The start page replaces the README.
_REPLACED = ROOT_PAGES | {"README.md": "index.md"}

_log = logging.getLogger("mkdocs.hooks")  # warnings of this logger fail the strict build
_CONVERTER = LatexToMathML()
_LINK = re.compile(r"(?<=\]\()([\w./-]+?)(?=[)#])")
_EQUATION = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.DOTALL)
_SOURCE_PAGE = """<!doctype html>
<html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{name}</title>
<style>:root {{ color-scheme: light dark }} body {{ margin: 2em; font: 14px/1.5 monospace }}</style>
<h1>{name}</h1><pre>{text}</pre></html>
"""


def on_files(files: Files, *, config: MkDocsConfig) -> Files:
    """Add the pages of the root folder and all source files to which pages link."""
    for name, page in ROOT_PAGES.items():
        head = "---\nsearch: {exclude: true}\n---\n" if name == "README.md" else ""
        files.append(File.generated(config, page, content=head + (ROOT / name).read_text(encoding="utf-8")))
    pages = [(file.content_string, _folder(file.src_uri)) for file in files.documentation_pages()]
    targets = {target for text, folder in pages for link in _LINK.findall(text) if (target := _source(link, folder))}
    for target in sorted(targets):
        text = html.escape((ROOT / target).read_text(encoding="utf-8"))
        files.append(File.generated(config, _page(target), content=_SOURCE_PAGE.format(name=target, text=text)))
    return files


def on_page_markdown(markdown: str, *, page: Any, config: MkDocsConfig, files: Files) -> str:
    """Redirect links to files outside docs/ to their pages in the site. Links to missing files stay, and fail."""
    folder = _folder(page.file.src_uri)

    def redirected(link: re.Match[str]) -> str:
        path = _path(link[1], folder)
        if path in _REPLACED:
            return _REPLACED[path]
        if folder == "." and path.startswith("docs/"):
            return path.removeprefix("docs/")
        target = _source(link[1], folder)
        return _page(target) if target else link[1]

    return _LINK.sub(redirected, markdown)


def on_page_content(content: str, *, page: Any, **_: Any) -> str:
    """Convert TeX equations to MathML, which browsers draw without scripts. Errors in equations are warnings."""

    def converted(equation: re.Match[str]) -> str:
        tex, display = html.unescape(equation[3]).strip(), equation[2] == "["
        try:
            mathml = _CONVERTER.convert_with_local_state(tex, displaystyle=display)
        except LatexError as error:
            _log.warning("Doc file '%s' contains an invalid equation '%s': %s", page.file.src_uri, tex, error)
            return equation[0]
        return f'<div class="equation">{mathml}</div>' if display else str(mathml)

    return _EQUATION.sub(converted, content)


def _folder(page: str) -> str:
    """Return the folder of a page's Markdown file, relative to the root."""
    return "." if page in ROOT_PAGES.values() else str(PurePosixPath("docs") / PurePosixPath(page).parent)


def _path(link: str, folder: str) -> str:
    """Return the path of a link's target relative to the root, empty if the target is outside."""
    path = (ROOT / folder / link).resolve()
    return str(path.relative_to(ROOT)) if path.is_relative_to(ROOT) else ""


def _source(link: str, folder: str) -> str | None:
    """Return the path of a linked source file relative to the root; None for pages, pictures and missing files."""
    path = _path(link, folder)
    return path if not path.startswith("docs/") and path not in _REPLACED and (ROOT / path).is_file() else None


def _page(source: str) -> str:
    """Return the page of a source file in the site."""
    return f"source/{source}.html"
