"""The page of a certificate that the landing page shows: a sphere before and after, to turn."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from sphinx.application import Sphinx

from certpgo import solve
from certpgo.assess.assessment import assess
from certpgo.datasets import synthetic
from certpgo.view.certificate_page import Origin, certificate_page

#: Name of the page among the static files.
PAGE = "sphere.html"
#: Rings of the sphere, and the noise of its rotations, radians.
RINGS, NOISE = 14, 0.1


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect to Sphinx."""
    app.connect("build-finished", _write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _write(app: Sphinx, failure: Exception | None) -> None:
    if failure is not None or app.builder.format != "html":
        return
    folder = Path(app.outdir) / "_static"
    folder.mkdir(exist_ok=True)
    (folder / PAGE).write_text(page(), encoding="utf-8")


def page() -> str:
    """The page as HTML."""
    instance = synthetic.sphere(RINGS, np.random.default_rng(0), rotation_noise=NOISE)
    answer = solve(instance)
    assessment = assess(answer.problem, answer.estimate, answer.certificate, ids=instance.ids)
    return certificate_page(
        instance,
        answer.problem,
        answer.estimate,
        assessment,
        Origin("sphere.g2o", method="certified"),
        answer.solution.trace,
    )
