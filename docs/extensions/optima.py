"""The directive ``optima``: the register of certified optima as a table that can be sorted."""

from __future__ import annotations

from html import escape
from pathlib import Path

import numpy as np
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from certpgo.graph.phrases import bound_shown, cost_shown, gap_shown
from certpgo.optima import Absent, Optimum, Register
from certpgo.optima.remarks import Remarks

COLUMNS = (
    ("", ""),
    ("graph", ""),
    ("poses", "and points"),
    ("edges", "and distances"),
    ("cost", ""),
    ("no estimate costs less than", ""),
    ("the best known costs at most", ""),
    ("relative gap", ""),
    ("trust", "verdict, tier"),
    ("chi<sup>2</sup>", "degrees of freedom"),
    ("in print", ""),
    ("remarks", ""),
)
#: The columns' titles before the cells of a narrow screen.
PLAIN_COLUMNS = tuple((title.replace("<sup>2</sup>", "^2"), below) for title, below in COLUMNS)
#: Points of a drawing, and its size in pixels.
POINTS, SIZE = 150, 56


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect to Sphinx."""
    app.add_directive("optima", Optima)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


class Optima(SphinxDirective):
    """The table, and below it what has no optimum."""

    def run(self) -> list[nodes.Node]:
        """The directive's content."""
        register = Register()
        for path in register.folder.glob("*.*l*"):
            self.env.note_dependency(str(path))
        return [nodes.raw("", html(register), format="html")]


def html(register: Register) -> str:
    """The register as a table and a list."""
    head = "".join(
        f'<th scope="col"><button type="button">{title}</button><small>{below}</small></th>'
        if title
        else "<td></td>"
        for title, below in COLUMNS
    )
    drawings = {name: drawing(register, name) for name in {o.name for o in register.optima}}
    rows = "".join(row(register, o, drawings[o.name]) for o in register.optima)
    counts = f"{len(register.optima)} optima of {len(drawings)} graphs."
    absent = "".join(map(item, register.absent))
    return (
        f'<p>{counts} <label>Show those with <input type="search" id="optima-filter" '
        'placeholder="a name, cost or word"></label></p>'
        f'<div class="wide"><table class="docutils optima"><thead><tr>{head}</tr></thead>'
        f"<tbody>{rows}</tbody></table></div>"
        f"<details><summary>Costs that a graph does not have, and what was not computed"
        f"</summary><ul>{absent}</ul></details>"
    )


def row(register: Register, o: Optimum, picture: str) -> str:
    """An optimum's row."""
    s, remarks = o.sizes, register.remarks.get(o.name, Remarks())
    names = f"<b>{escape(o.name)}</b>" + "".join(f"<br>{escape(n)}" for n in o.names[1:])
    poses = f"{s.poses}" + (f" + {s.points}" if s.points else "")
    edges = f"{s.edges}" + (f" + {s.ranges}" if s.ranges else "")
    printed = "<br>".join(f"{escape(p.value)}, {escape(p.source)}" for p in remarks.of(o.cost))
    said = [escape(remarks.text)] if remarks.text else []
    said += [
        f"Not {escape(w.value)}: {escape(w.source)}." for w in remarks.wrong if w.cost == o.cost
    ]
    chi2 = "" if o.chi2 is None else f"{o.chi2:.6g}<br>{o.freedom}"
    cells = (
        (picture, None),
        (names, o.name.lower()),
        (f"{poses}<br><small>{s.d}D {o.kind}</small>", s.poses),
        (edges, s.edges),
        (o.cost, o.cost),
        (bound_shown(o.lower), o.lower),
        (cost_shown(o.upper), o.upper),
        (gap_shown(o.relative_gap), o.relative_gap),
        (f"{o.verdict}<br>{o.tier}{proof(o)}", f"{o.verdict} {o.tier}"),
        (chi2, o.chi2),
        (printed, None),
        (" ".join(said), None),
    )
    made = [
        (f'data-title="{title}"' + ("" if key is None else f' data-key="{key}"'), text)
        for (title, _), (text, key) in zip(PLAIN_COLUMNS, cells, strict=True)
    ]
    return "<tr>" + "".join(f"<td {given}>{text}</td>" for given, text in made) + "</tr>"


def proof(o: Optimum) -> str:
    """What is said of the proof file."""
    if o.proof_sha256 is None:
        return ""
    held = "kept" if o.kept else "made again by solve --proof"
    return f'<br><small title="SHA-256 {o.proof_sha256}">proof {held}</small>'


def item(absent: Absent) -> str:
    """Why there is no optimum."""
    return f"<li>{escape(absent.name)}, {absent.cost}: {escape(absent.reason)}</li>"


def drawing(register: Register, name: str) -> str:
    """The optimal trajectory from above, from a proof that is kept; or empty."""
    kept = [register.proof(o) for o in register.named(name) if o.kept and o.kind == "poses"]
    return outline(kept[0]) if kept else ""


def outline(path: Path) -> str:
    """The positions in a proof, in the plane in which they extend most."""
    with np.load(path, allow_pickle=False) as archive:
        t = archive["translations"]
    centred = t - t.mean(axis=0)
    plane = np.linalg.svd(centred, full_matrices=False)[2][:2]
    flat = centred @ plane.T
    extent = np.ptp(flat, axis=0).max()
    if not extent > 0.0:
        return ""
    chosen = flat[np.unique(np.linspace(0, len(flat) - 1, POINTS).astype(int))]
    places = (chosen - flat.min(axis=0)) * ((SIZE - 4) / extent) + 2.0
    points = " ".join(f"{x:.0f},{SIZE - y:.0f}" for x, y in places)
    line = f'<polyline points="{points}" fill="none" stroke="currentColor"/>'
    return f'<svg width="{SIZE}" height="{SIZE}" aria-hidden="true">{line}</svg>'
