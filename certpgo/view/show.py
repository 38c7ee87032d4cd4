"""`certpgo.show`: look at graphs, estimates, clouds and meshes."""

from __future__ import annotations

import html
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from numpy.typing import ArrayLike

from certpgo.errors import InputError
from certpgo.graph import Estimate
from certpgo.io.writing import write_text, write_whole
from certpgo.view.live import live
from certpgo.view.load_scene import Thing, scene_of
from certpgo.view.maps import picture
from certpgo.view.scene import Scene
from certpgo.view.viewer import PORT, offline

#: Suffixes of files that show a scene: a page, or a picture.
FORMS = ("html", "png", "pdf", "svg")
#: Height of a view in a notebook, pixels.
HEIGHT = 480


def form_of(path: str | Path, *, play: bool = False) -> str:
    """What a file shows a scene as, by its suffix: ``"html"``, ``"png"``, ``"pdf"`` or ``"svg"``.

    Raises
    ------
    InputError
        Another suffix; or ``play`` for a picture.
    """
    form = Path(path).suffix.lower().removeprefix(".") or "html"
    form = "html" if form == "htm" else form
    if form not in FORMS:
        raise InputError(f"{path}: a scene is written as .{', .'.join(FORMS[:-1])} or .{FORMS[-1]}")
    if play and form != "html":
        raise InputError(f"{path}: a picture cannot play; a page can, .html")
    return form


@dataclass(frozen=True, repr=False)
class View:
    """A scene to look at: it shows itself in a notebook, as a file, or live.

    Attributes
    ----------
    scene : what there is to see
    dark : whether the background is dark; by default pages follow the reader's system, and what
        cannot is light
    colour : unit of the measure that colours edges; the first by default
    """

    scene: Scene
    dark: bool | None = None
    colour: str | None = None

    def save(self, path: str | Path, *, play: bool = False) -> None:
        """Write one HTML file that needs no network, or a picture: .png, .pdf or .svg.

        Parameters
        ----------
        path : its suffix says which; HTML without one
        play : whether a frustum walks along the trajectory, in HTML

        Raises
        ------
        InputError
            Another suffix, no edge has the measure ``colour``, or the file cannot be written.
        MissingDependency
            viser or, for pictures, Matplotlib is not installed.
        """
        form = form_of(path, play=play)
        if form == "html":
            page = offline(self.scene, dark=self.dark, colour=self.colour, play=play)
            write_text(Path(path), page)
        else:
            drawn = picture(self.scene, form, dark=bool(self.dark), colour=self.colour)
            write_whole(Path(path), drawn)

    @contextmanager
    def serve(self, *, host: str = "127.0.0.1", port: int = PORT) -> Iterator[str]:
        """Show the scene in the browser while the block runs; yields the address.

        Raises
        ------
        InputError
            No edge has the measure ``colour``.
        MissingDependency
            viser is not installed.
        """
        with live(self.scene, dark=self.dark, colour=self.colour, host=host, port=port) as address:
            yield address

    def __repr__(self) -> str:
        return f"<View: {self.scene.name}; .save(path) writes a page or picture, .serve() is live>"

    def _repr_html_(self) -> str:
        page = html.escape(offline(self.scene, dark=self.dark, colour=self.colour))
        return f'<iframe srcdoc="{page}" width="100%" height="{HEIGHT}" frameborder="0"></iframe>'


def show(
    *things: Thing,
    truth: str | Path | Estimate | None = None,
    rejected: ArrayLike | None = None,
    dark: bool | None = None,
    colour: str | None = None,
) -> View:
    """Look at a graph with its estimates, at trajectories, at a point cloud or a mesh.

    Estimates are drawn with a frustum at each pose, and edges with a colour by residual. The last
    estimate is the answer: others, and the truth, are aligned with it, and can be switched on.

    Parameters
    ----------
    things : paths, names of datasets, or objects: at most one graph or instance; estimates and
        answers in the order before, after, or pairs of a name and an estimate; clouds and meshes
        (`certpgo.io.surfaces.Surface`) in the frame and unit of the last of them
    truth : a file or estimate; by default the one that the graph was read with
    rejected : indices or flags of measurements to draw as rejected; by default those of the answer
    dark : whether the background is dark; by default pages follow the reader's system, and what
        cannot is light
    colour : unit of the measure that colours edges, such as ``"degrees"``; the first by default

    Returns
    -------
    A view, which shows itself at the end of a notebook's cell, is written by ``save`` as one HTML
    file, and is live in ``serve``.

    Raises
    ------
    InputError
        There is nothing to draw, or it does not belong together.
    FormatError
        A file cannot be read.

    Examples
    --------
    >>> import numpy as np
    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import helix
    >>> instance = helix(3, np.random.default_rng(0))
    >>> view = certpgo.show(instance, certpgo.solve(instance))
    >>> [placement.name for placement in view.scene.placements], view.scene.truth.name
    (['answer'], 'truth')
    """
    return View(scene_of(*things, truth=truth, rejected=rejected), dark, colour)
