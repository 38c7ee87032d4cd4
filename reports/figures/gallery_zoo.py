"""How often certifiers are false on the zoo's points, from the committed records."""

from __future__ import annotations

from pathlib import Path

from certpgo.registry import repository
from reports.harness.certifiers.summary import certifier_names
from reports.harness.experiments.absence import Absence, NotRun
from reports.harness.experiments.figure import Data, Figure
from reports.harness.experiments.journal import read_entries
from reports.harness.experiments.zoo_records import ALL, Outcome, Tally, ZooRecord, total

from . import _style

LABELS = {
    "certpgo standard": "certpgo, standard",
    "certpgo proof": "certpgo, proof",
    "certpgo standard, unrefined": "certpgo, unrefined",
    "cora_rule": "CORA's rule",
    "gtsam_shonan": "GTSAM, Shonan's check",
    "gtsam_staircase": "GTSAM, staircase at rank d",
    "se_sync_rule": "SE-Sync's rule",
}
#: For where there is little room.
SHORT = {
    "certpgo standard": "standard",
    "certpgo proof": "proof",
    "certpgo standard, unrefined": "unrefined",
    "cora_rule": "CORA",
    "gtsam_shonan": "Shonan",
    "gtsam_staircase": "staircase",
    "se_sync_rule": "SE-Sync",
}
GROUPS = {"named": "named families", "random": "random instances"}
COLOURS = {"named": _style.BLUE, "random": _style.ORANGE}
#: Share from which on cells are dark, percent.
DARK = 50.0
#: Families of points that are shown.
WORST = 14


def compute(quick: bool, data: Path | None) -> Data:
    """False certificates and all, by certifier; and the families in which most are false."""
    path = repository() / "reports" / "results" / "zoo.jsonl"
    if not path.is_file():
        reason = "file not here (zoo.jsonl); certpgo bench zoo --campaign 10000"
        raise NotRun(Absence.NOT_HERE, reason)
    records = read_entries(path, ZooRecord)
    named = [record for record in records if record.seed is None]
    drawn = [record for record in records if record.seed is not None]
    names = certifier_names(records)
    outcomes = {
        name: {"named": _outcome(total(named), name), "random": _outcome(total(drawn), name)}
        for name in names
    }
    families = {}
    for family in dict.fromkeys(record.family for record in named):
        members = total(record for record in named if record.family == family)
        families[family] = {name: _outcome(members, name) for name in names}
    caught = sorted(families, key=lambda part: -_most(families[part]))
    shown = [part for part in caught[: WORST // 2 if quick else WORST] if _most(families[part])]
    ours = [name for name in names if name.startswith("certpgo")]
    return {
        "points": total(records).points[ALL],
        "certifiers": outcomes,
        "families": {part: families[part] for part in shown},
        "families_in_all": len(families),
        "families_shown": len(shown),
        "ours_false": sum(outcomes[n][g]["false"] for n in ours for g in GROUPS),
        "ours_certified": sum(outcomes[n][g]["certified"] for n in ours for g in GROUPS),
    }


def _outcome(tally: Tally, name: str) -> dict[str, int]:
    """Points that a certifier judged, certified, and certified falsely."""
    counts = tally.of(name)
    yes, no = counts[Outcome.CERTIFIED], counts[Outcome.NOT_CERTIFIED]
    return {"judged": yes + no, "certified": yes, "false": counts[Outcome.FALSE]}


def _most(outcomes: dict[str, dict[str, int]]) -> float:
    """The largest share of points that a certifier certifies falsely."""
    return max((o["false"] / o["judged"] for o in outcomes.values() if o["judged"]), default=0.0)


def draw(figure, record: Data) -> None:
    """Shares of false certificates by certifier, and of falsely certified points by family."""
    figure.set_size_inches(_style.PAGE, 0.95 * _style.PAGE)
    shares, by_family = figure.subplots(2, 1, height_ratios=(1.0, 1.3))
    names = list(record["certifiers"])
    for shift, (group, label) in zip((-0.19, 0.19), GROUPS.items(), strict=True):
        for row, name in enumerate(names):
            counts = record["certifiers"][name][group]
            share = 100.0 * counts["false"] / max(counts["certified"], 1)
            named = label if row == 0 else None
            shares.barh(row + shift, share, 0.34, color=COLOURS[group], label=named)
            said = f"{counts['false']:,} of {counts['certified']:,}"
            shares.text(share + 0.8, row + shift, said, va="center", fontsize=6.5)
    shares.set_yticks(range(len(names)), [LABELS.get(name, name) for name in names])
    shares.invert_yaxis()
    shares.set(xlabel="% of its certificates")
    shares.set_xlim(0.0, shares.get_xlim()[1] * 1.4)
    figure.legend(loc="outside upper left", ncols=2)
    _style.panel(shares, "a", "certificates that are false")
    _families(by_family, record["families"], names)
    _style.panel(by_family, "b", "points certified falsely, % of the family's")


def _families(axes, families: Data, names: list[str]) -> None:
    import numpy as np

    shares = [
        [100.0 * o["false"] / o["judged"] if o["judged"] else np.nan for o in row.values()]
        for row in families.values()
    ]
    axes.imshow(shares, aspect="auto", cmap="Blues", vmin=0.0, vmax=100.0)
    for (i, j), share in np.ndenumerate(shares):
        said = "–" if np.isnan(share) else f"{share:.0f}"  # noqa: RUF001
        ink = "white" if share > DARK else "black" if share > 0.0 else _style.GREY
        axes.text(j, i, said, ha="center", va="center", color=ink, fontsize=7)
    axes.set_xticks(range(len(names)), [SHORT.get(name, name) for name in names])
    axes.set_yticks(range(len(families)), list(families))
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)


FIGURE = Figure(
    name="gallery_zoo",
    title="How often certifiers are false",
    source="`certpgo bench zoo --campaign 10000`; what each certifier is, and how the truth is "
    "known, in zoo.md",
    compute=compute,
    draw=draw,
    caption=(
        "(a) Of {points:,} points of known truth, certificates that are false, by certifier: of "
        "{ours_certified:,} of ours, in three modes, {ours_false}. (b) The {families_shown} of "
        "{families_in_all} named families in which most is certified falsely; a dash where a "
        "certifier takes none."
    ),
    notes=(
        "A certificate is false when a point better by more than 1e-5 F + 1e-12 W is in hand, or "
        "the point is no estimate at all.",
        "SE-Sync's and CORA's rules are our reading of them on our matrices, not runs of those "
        "programs; GTSAM's two are its wheel's, whose version the records name. All are meant for "
        "stationary points, which those moved along the softest mode are not.",
    ),
)
