"""Pages generated before a build: copies of lessons and results, commands, methods.

They are written next to the pages they belong to and are ignored by git. A file whose text has not
changed is not rewritten, so that a second build has nothing to do.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import importlib.util
import re
from collections.abc import Mapping
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.errors import ExtensionError
from sphinx.util.fileutil import copy_asset_file

from extensions import combinations, commands, methods

DOCS = Path(__file__).parents[1]
ROOT = DOCS.parent

#: One file with all of TeX and glyphs as outlines: nothing else is loaded, not even a font.
MATHJAX = "tex-svg-full.js"

#: Links to source files in the repository become links to the copies made here.
_COPIED = {
    "reports/lessons/": "lessons/",
    "reports/results/": "results/",
    "CONTRIBUTING.md": "contributing.md",
}
_TO_COPIED = re.compile(rf"(\]\((?:\.\./)*)\.\./({'|'.join(map(re.escape, _COPIED))})")

#: Files of `reports/results` that pages show or link to.
RESULTS = ("*.md", "*.svg", "*.bib")


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect to Sphinx."""
    # Sphinx rereads pages when a setting changes, but not when these files do.
    app.add_config_value("extensions_key", _digest(Path(__file__).parent), "env")
    app.connect("config-inited", lambda app, config: write_pages())
    app.connect("source-read", _link_to_copies)
    app.connect("build-finished", _copy_mathjax)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def write_pages() -> None:
    """Write the pages generated from other sources."""
    lessons = ROOT / "reports" / "lessons"
    sync(DOCS / "lessons", {p.name: p.read_bytes() for p in lessons.glob("*.py")}, ("*.py",))
    results = ROOT / "reports" / "results"
    found = (path for pattern in RESULTS for path in results.glob(pattern))
    sync(DOCS / "results", {p.name: p.read_bytes() for p in found})
    sync(DOCS / "reference" / "cli", encoded(commands.pages()))
    sync(DOCS / "reference" / "methods", encoded(methods.pages()))
    sync(DOCS / "reference" / "combinations", encoded(combinations.pages()))


def encoded(pages: Mapping[str, str]) -> dict[str, bytes]:
    """Texts as they are stored."""
    return {name: text.encode() for name, text in pages.items()}


def sync(folder: Path, files: Mapping[str, bytes], patterns: tuple[str, ...] = ("*",)) -> None:
    """Make the files of a folder that match ``patterns`` equal to these; write only changes."""
    folder.mkdir(parents=True, exist_ok=True)
    for pattern in patterns:
        for path in folder.glob(pattern):
            if path.name not in files:
                path.unlink()
    for name, content in files.items():
        path = folder / name
        if not path.is_file() or path.read_bytes() != content:
            path.write_bytes(content)


def _link_to_copies(app: Sphinx, page: str, source: list[str]) -> None:
    source[0] = _TO_COPIED.sub(lambda link: link[1] + _COPIED[link[2]], source[0])


def package_key() -> str:
    """What a lesson's output depends on besides its text: the package and its dependencies."""
    foundations = ("numpy", "scipy", "matplotlib", "cvxpy", "clarabel", "gtsam")
    return "-".join([_digest(ROOT / "certpgo"), *map(_version, foundations)])


def _version(package: str) -> str:
    # GTSAM has no wheel for some platforms; lessons report its absence.
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "none"


def _digest(folder: Path) -> str:
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _copy_mathjax(app: Sphinx, failure: Exception | None) -> None:
    if failure is not None or app.builder.format != "html":
        return
    # The wheel's module name is not an identifier, but its folder can be found.
    spec = importlib.util.find_spec("sphinx-mathjax-offline")
    if spec is None or spec.origin is None:
        raise ExtensionError("sphinx-mathjax-offline is not installed")
    source = Path(spec.origin).parent / "static" / "mathjax" / MATHJAX
    copy_asset_file(source, Path(app.outdir) / "_static" / MATHJAX, force=True)
