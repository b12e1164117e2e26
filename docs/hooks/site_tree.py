"""Add the README, and files outside docs/ that pages link to, to the site, with their paths in the repository."""

from __future__ import annotations

import re
from pathlib import Path, PurePosixPath
from posixpath import normpath, relpath
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]
HOME = "index.md"
PAGES = (
    Path("CHANGELOG.md"),
    Path("CODE_OF_CONDUCT.md"),
    Path("CONTRIBUTING.md"),
    Path("SECURITY.md"),
    *(path.relative_to(ROOT) for path in sorted((ROOT / "deploy").rglob("README.md"))),
)
"""Pages outside docs/; the README is the home page, too."""

_LINK = re.compile(r"(\]\()([^)#:\s]+)((?:#[^)]*)?\))")
_FENCE = re.compile(r"^```(\w+) ([\w.-]+)$", re.MULTILINE)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages from outside docs/, and the files that pages link to there."""
    files.append(_brought(config, HOME, ROOT / "README.md"))
    for place in PAGES:
        files.append(_brought(config, place.as_posix(), ROOT / place))
    for page in files.documentation_pages():
        for target in _targets(page.content_string, _place(page.src_uri)):
            if target.parts[0] != "docs" and files.get_file_from_path(str(target)) is None:
                files.append(_brought(config, str(target), ROOT / target))
    return files


def on_page_markdown(markdown: str, *, page: Page, **_context: Any) -> str:
    """Change links to the tree of the site; the name of a file that a block shows becomes its title."""
    place = _place(page.file.src_uri)
    here = _in_site(place)

    def moved(link: re.Match[str]) -> str:
        target = _in_site(PurePosixPath(normpath(place.parent / link[2])))
        return f"{link[1]}{relpath(target, here.parent)}{link[3]}"

    return _FENCE.sub(r'```\1 title="\2"', _LINK.sub(moved, markdown))


def _brought(config: MkDocsConfig, uri: str, path: Path) -> File:
    return File.generated(config, uri, abs_src_path=str(path))


def _place(uri: str) -> PurePosixPath:
    """Return the path of a page in the repository."""
    if uri == HOME:
        return PurePosixPath("README.md")
    return PurePosixPath(uri) if Path(uri) in PAGES else PurePosixPath("docs", uri)


def _in_site(place: PurePosixPath) -> PurePosixPath:
    """Return the path in the site of a file of the repository."""
    if place == PurePosixPath("README.md"):
        return PurePosixPath(HOME)
    return place.relative_to("docs") if place.parts[0] == "docs" else place


def _targets(markdown: str, place: PurePosixPath) -> list[PurePosixPath]:
    return [PurePosixPath(normpath(place.parent / target)) for _, target, _ in _LINK.findall(markdown)]
