"""Pages of certificates to turn and drag, which the landing page and the gallery show in frames."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from sphinx.application import Sphinx

from certpgo import Instance, certify, solve
from certpgo.io.datasets import synthetic
from certpgo.objective.quadratic import Quadratic
from certpgo.solve.assessment import assess
from certpgo.view.certificate_page import Origin, certificate_page

#: Rings of the sphere, and the noise of its rotations, radians.
RINGS, NOISE = 14, 0.1
#: Poses and laps of the corridor, and its noise, radians and metres.
POSES, LAPS, DRIFT = 480, 3, 0.02
#: Cameras of the wound-up cycle.
CAMERAS = 30


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect to Sphinx."""
    app.connect("build-finished", _write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _write(app: Sphinx, failure: Exception | None) -> None:
    if failure is not None or app.builder.format != "html":
        return
    folder = Path(app.outdir) / "_static"
    folder.mkdir(exist_ok=True)
    for name, page in PAGES.items():
        (folder / name).write_text(page(), encoding="utf-8")


def sphere() -> str:
    """The optimum of noisy measurements between poses on a sphere, as HTML."""
    instance = synthetic.sphere(RINGS, np.random.default_rng(0), rotation_noise=NOISE)
    return _solved(instance, "sphere.g2o")


def corridor() -> str:
    """The optimum of laps through the corridors of a building, as HTML."""
    rng, information = np.random.default_rng(0), DRIFT**-2
    instance = synthetic.corridor(POSES, rng, laps=LAPS, noise=DRIFT, information=information)
    return _solved(instance, "corridor.g2o")


def wound() -> str:
    """Cameras around a circle that turn once too often, as HTML: a local minimum."""
    instance, estimate = synthetic.winding_cycle(CAMERAS, 0.0, 1)
    problem = Quadratic(instance.graph)
    assessment = assess(problem, estimate, certify(instance, estimate), instance=instance)
    origin = Origin("cycle.g2o", "wound.g2o")
    return certificate_page(instance, problem, estimate, assessment, origin)


def _solved(instance: Instance, name: str) -> str:
    answer = solve(instance)
    problem, estimate, trace = answer.problem, answer.estimate, answer.solution.trace
    assessment = assess(problem, estimate, answer.certificate, instance=instance)
    origin = Origin(name, method="certified")
    return certificate_page(instance, problem, estimate, assessment, origin, trace)


#: By the names of their files among the static ones.
PAGES: dict[str, Callable[[], str]] = {
    "sphere.html": sphere,
    "corridor.html": corridor,
    "wound.html": wound,
}
