"""The page of the records."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from certpgo.view.markdown_tables import markdown_table
from reports.studies.certified_regions.campaign import QUANTITIES

HEAD = """# Certified regions

Made by `python -m reports.studies.certified_regions`. The guide *How far off an estimate can be*
says what is proven, and why.
"""
CAMPAIGN = """## Is an estimate ever outside?

Random graphs of 4 to 12 nodes, of every kind, by both factorization engines in turn. Pairs of
estimates: near ones, by a millionth to a metre or radian; any; and those moved along eigenvectors
of a node's block of the inverse, which the bound says are the worst, by steps of all sizes, made
rotations again. Each is in a frame of its own. A check is one node of such a pair, seen from one
pose: whether the region of all estimates that cost no more than the other holds it. Costs are
enclosed upward. The last columns are the largest shares of the limits that were reached, of the
ellipsoid, the distance, the angle, and the difference of scales. Where one is near one, no smaller
region would do.
"""
SHARPNESS = """## How sharp are they?

On public graphs under F, the least moves that move one node the worst way, in steps of several
sizes: the largest share of its region's limits that is reached, over {nodes} nodes or more each.
"""
WIDTHS = """## How wide are they, and how long do they take?

Regions at a level of 95 %, over covariances at the same level: half-widths of {nodes} nodes each,
seen from the pose whose measurements weigh most, median and largest. Angles are compared where the
region has less than 180 degrees; *whole turn* counts the others. *Time* is that of all nodes'
regions over that of all nodes' covariances, in process seconds, median of {rounds} ratios in turn.
"""
FAR = """## Certified, and metres away

The positions of MIT, moved where the cost hardly changes: {verdict}, with a gap of {gap:.2g} of the
cost, while a node is {off:.2f} m from where the optimum has it, seen from node {reference}.
`certpgo certify --reference {reference}` says that it is within {proven:.2f} m of every optimum.
In a running program the verdict takes {alone:.1f} ms, and {both:.1f} ms with the distances of all
nodes; the whole command {command:.2f} s.
"""
BASINS = """## Two valleys

A cycle of equal weights in the plane, whose measurements do not close by so many degrees. The
optimum distributes that; one turn less, distributed the other way, is another local minimum, in
which the node opposite of the reference is turned by 180 degrees. For several excesses over the
optimum, as shares of what the other minimum costs more, the largest angle of that node by the
covariance and by the region, and whether the region holds the other minimum. It must where the
excess is one or more.
"""


def text(records: dict[str, Any]) -> str:
    """The page as Markdown."""
    from reports.studies.certified_regions import far, public

    row = records["far"]
    parts = [
        HEAD,
        CAMPAIGN,
        *campaign(records["campaign"]),
        SHARPNESS.format(nodes=public.NODES),
        table(("graph", "estimates", *QUANTITIES[:3]), map(_sharpness, records["sharpness"])),
        WIDTHS.format(nodes=public.NODES, rounds=public.ROUNDS),
        table(
            ("graph", "cost", "poses", "verdict", "position", "largest", "angle", "largest",
             "whole turn", "regions, ms", "time"),
            map(_widths, records["widths"]),
        ),
        FAR.format(
            verdict=row["verdict"],
            gap=row["relative gap"],
            off=row["metres off"],
            proven=row["proven metres"],
            alone=row["verdict ms"],
            both=row["verdict and distance ms"],
            command=row["command s"],
            reference=far.REFERENCE,
        ),
        BASINS,
        table(
            ("nodes", "degrees", "excess", "covariance", "region", "holds the other"),
            (line for of in records["basins"] for line in _basins(of)),
        ),
    ]  # fmt: skip
    return "\n".join(parts)


def campaign(tallies: dict[str, Any]) -> list[str]:
    """The table of the campaign, and its sums."""
    checks, outside = (sum(t[key] for t in tallies.values()) for key in ("checks", "outside"))
    lines = []
    for kind, tally in tallies.items():
        largest = [_share(tally["largest"][quantity]) for quantity in QUANTITIES]
        counts = (tally["graphs"] - tally["refused"], tally["unknown"], tally["checks"])
        lines.append((kind, *(f"{n:,}" for n in counts), str(tally["outside"]), *largest))
    header = ("kind", "graphs", "nothing proven", "checks", "outside", *QUANTITIES)
    return [f"**{checks:,} checks, {outside} outside.**\n", table(header, lines)]


def _sharpness(row: dict[str, Any]) -> Sequence[str]:
    largest = (_share(row["largest"][quantity]) for quantity in QUANTITIES[:3])
    return (row["graph"], f"{row['estimates']:,}", *largest)


def _widths(row: dict[str, Any]) -> Sequence[str]:
    ratios = [f"{ratio:.2f}" for ratio in (*row["metres"], *(row["degrees"] or ()))]
    return (
        row["graph"],
        row["cost"],
        f"{row['poses']:,}",
        row["verdict"],
        *[*ratios, "", ""][:4],
        str(row["without angle"] or ""),
        f"{row['regions ms']:.0f}",
        f"{row['time']:.2f}",
    )


def _basins(row: dict[str, Any]) -> Iterable[Sequence[str]]:
    from reports.studies.certified_regions.basins import SHARES

    found = zip(SHARES, row["local degrees"], row["degrees"], row["holds"], strict=True)
    for share, local, degrees, holds in found:
        start = (str(row["nodes"]), f"{row['closing error']:g}", f"{share:g}")
        yield *start, f"{local:.0f}", f"{degrees:.0f}", "yes" if holds else "no"


def _share(value: float) -> str:
    """Rounded down: one means that it was reached."""
    return f"{int(1e4 * value) / 1e4:.4f}" if value else ""


def table(header: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """A table of the page."""
    return "\n".join([*markdown_table(header, list(lines)), ""])
