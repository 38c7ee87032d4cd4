"""What a figure is: a record, computed once, and a drawing that is a function of it alone."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from certpgo.errors import MissingDependency
from certpgo.io.json_values import plain
from certpgo.io.writing import folder_to_write, write_whole
from certpgo.linalg.factor import default_engine
from certpgo.registry import source
from certpgo.solve.provenance import provenance
from certpgo.view.style import STYLE
from reports.harness.experiments.claims import Claim
from reports.harness.experiments.keys import QUICK_NOTES, Profile, content_key

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

#: Numbers, texts, lists and mappings of such, as JSON has them.
Data = dict[str, Any]

#: Where a record keeps views for the report: a list of ``title`` and ``scene``, which is of
#: `certpgo.view.page_scene.page_scene`.
VIEWS = "views"

#: Light on dark, hues kept; the background is nearly black, as that of dark pages.
DARK = (
    "<style>@media (prefers-color-scheme: dark) "
    "{ svg { filter: invert(.92) hue-rotate(180deg) } }</style>"
)


@dataclass(frozen=True)
class Figure:
    """A figure of a report.

    Attributes
    ----------
    name : name of its file
    title, source : heading, and the citation of the figure it is compared with
    compute : the record: everything that is drawn, and the numbers that the caption states. Called
        with whether to make the quick profile's small one, and the folder to look for files in
        first; raises InputError where they are not here
    draw : draws the record, called with a Matplotlib figure and the record
    caption : a format string whose fields are the record's
    notes : sentences printed below the caption
    claims : what the paper says of it in words, checked against the record
    timed : it shows times, so that nothing else may run while it is computed
    """

    name: str
    title: str
    source: str
    compute: Callable[[bool, Path | None], Data]
    draw: Callable[[Canvas, Data], None]
    caption: str
    notes: tuple[str, ...] = ()
    claims: tuple[Claim, ...] = ()
    timed: bool = False

    def captioned(self, record: Data) -> str:
        """The caption with the record's numbers."""
        return self.caption.format_map(record)


def computed(figure: Figure, *, quick: bool = False, data: Path | None = None) -> Data:
    """The figure's record, as it is when read from its file.

    Parameters
    ----------
    quick : the small profile
    data : folder to look for files in first

    Raises
    ------
    InputError
        The files are not here.
    """
    record: Data = json.loads(_text(figure.compute(quick, data)))
    return record


def figure_key(figure: Figure, profile: Profile) -> str:
    """The key of a figure's record: of its name, its profile and the version that computed it."""
    from certpgo import __version__

    return content_key({"figure": figure.name, "profile": profile, "version": __version__})


def document(figure: Figure, record: Data, *, profile: Profile = "full") -> Data:
    """The record with what it shows and its provenance."""
    return {
        "figure": figure.name,
        "key": figure_key(figure, profile),
        "profile": profile,
        "title": figure.title,
        "source": figure.source,
        "caption": figure.captioned(record),
        "notes": [*([QUICK_NOTES] if profile == "quick" and figure.notes else []), *figure.notes],
        "data": record,
        "provenance": provenance(default_engine(), source()),
    }


def figure_bytes(figure: Figure, record: Data, form: str = "svg") -> bytes:
    """The drawing; the same record gives the same bytes.

    Parameters
    ----------
    form : ``"svg"``, or ``"png"`` to look at
    """
    try:
        import matplotlib as mpl
    except ImportError:
        raise MissingDependency("matplotlib, which draws figures,", "plots") from None
    from matplotlib.figure import Figure as Canvas

    stream = io.BytesIO()
    with mpl.rc_context():
        mpl.rcdefaults()  # not the reader's own settings
        settings: Any = {**STYLE, "svg.hashsalt": figure.name}
        mpl.rcParams.update(settings)
        canvas = Canvas(layout="constrained")
        figure.draw(canvas, record)
        dated: Mapping[str, Any] = {"Date": None} if form == "svg" else {}
        canvas.savefig(stream, format=form, metadata={**dated, "Title": figure.title})
    drawing = stream.getvalue()
    return dark_too(drawing) if form == "svg" else drawing


def dark_too(drawing: bytes) -> bytes:
    """An SVG that is light on dark where its reader prefers that."""
    at = drawing.index(b">", drawing.index(b"<svg")) + 1
    return drawing[:at] + b"\n " + DARK.encode() + drawing[at:]


def read_figure(figure: Figure, folder: Path) -> Data | None:
    """The figure's document in the folder, or None where it is missing or incomplete."""
    try:
        kept = json.loads((folder / f"{figure.name}.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    whole = isinstance(kept, dict) and "data" in kept and (folder / f"{figure.name}.svg").exists()
    return kept if whole else None


def publish(figure: Figure, record: Data, folder: Path, *, profile: Profile = "full") -> Path:
    """Write ``NAME.json`` and ``NAME.svg``, each whole or not at all; returns the drawing's path.

    Raises
    ------
    InputError
        The folder cannot be written to.
    """
    drawing = figure_bytes(figure, record)
    text = _text(document(figure, record, profile=profile))
    folder_to_write(folder)
    write_whole(folder / f"{figure.name}.json", text.encode() + b"\n")
    return write_whole(folder / f"{figure.name}.svg", drawing)


def _text(data: Data) -> str:
    return json.dumps(plain(data), allow_nan=False, separators=(",", ":"))
