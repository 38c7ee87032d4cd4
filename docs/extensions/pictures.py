"""Alternative text for pictures without one: those that a lesson's cells draw."""

from __future__ import annotations

from docutils import nodes
from sphinx.application import Sphinx


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect to Sphinx."""
    app.connect("doctree-read", lambda app, doctree: describe(doctree))
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def describe(doctree: nodes.document) -> None:
    """Use the section's heading for each picture without alternative text.

    Otherwise the text is the name of the picture's file, which for a cell's output is a digest.
    """
    for image in doctree.findall(nodes.image):
        section: nodes.Node | None = image
        while section is not None and not isinstance(section, nodes.section):
            section = section.parent
        if "alt" not in image and section is not None:
            title = next(section.findall(nodes.title))
            image["alt"] = f"Plot of the section: {title.astext()}"
