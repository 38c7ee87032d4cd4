"""Numbers in tables, which are not broken at the sign of their exponents."""

from __future__ import annotations

from docutils import nodes
from sphinx.application import Sphinx

from certpgo.view.page import NUMBER


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect to Sphinx."""
    app.connect("doctree-read", lambda app, doctree: mark(doctree))
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def mark(doctree: nodes.document) -> None:
    """Give cells that hold a number, and nothing else, the class ``number``."""
    for cell in doctree.findall(nodes.entry):
        if NUMBER.fullmatch(cell.astext().strip()):
            cell["classes"].append("number")
