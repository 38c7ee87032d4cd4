"""The zoo's records as text: a pure function of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

from certpgo.view.markdown_tables import bar
from reports.harness.certifiers.points import Known
from reports.harness.experiments.records import Record

OUTCOMES = (
    "certified",
    "false",
    "missed",
    "missed, loose",
    "no answer",
    "unconfirmed",
    "refused",
    "failed",
    "not installed",
)
#: What else may be false, of certifiers that say so much.
OTHERS = ("false bound", "false refutation", "false basin", "false proof")

INTRODUCTION = """\
Every certifier is told a problem and a point and says whether the point is optimal. A certificate
is **false** when an estimate in hand is better by more than 1e-5 F + 1e-12 W (our tolerance; W is
the sum of kappa and tau |t_ij|^2), or when the point is no estimate at all; it is **missed** when
the point is within a tenth of that of the optimum, and not certified. A **false bound** is a proven
lower bound above the cost of an estimate in hand, a **false refutation** one by an estimate that
costs no less, a
**false proof** one whose certificate matrix has a negative eigenvalue; these and optima that are
none are counted as otherwise false. Up to 200 nodes an interval factorization of the very matrix
that a bound rests on is asked to confirm it.
**No answer** is UNDECIDED (of certpgo) where a lower bound above the tolerance exists.
Costs in hand are enclosed in interval arithmetic. F* is known in closed form; or by an interval
L D L^T of the certificate matrix, in 160-bit balls; or by branch and bound over the angles of up to
four rotations in the plane."""

NOTES = """\
certpgo is asked twice: as it comes (it descends, takes the bound from there and from a second
start, and judges the point as given), and unrefined, on the point's own multipliers alone.

gtsam_shonan is `ShonanAveraging.checkOptimality` of GTSAM (smallest eigenvalue by Lanczos above
-1e-4, S in twice our scale). gtsam_staircase is GTSAM's `RiemannianStaircaseOptimizer` started at
the point and held at rank d: what it certifies is where its own descent ended, and that is judged,
projected to rotations. se_sync_rule asks for a Cholesky factor of S + 1e-3 I, cora_rule of
S + eta I with eta = 5e-6 F/2 between 1e-7 and 1e-1; both are our reading of those rules on our
matrices, not runs of those programs. The rules are meant for stationary points, so that what they
say of points that are not (moved along the softest mode, not stationary, scaled) is a warning to
their users rather than a fault of their authors. GTSAM's two take rotations alone and refuse poses.

Where the relaxation is loose no certificate of this kind can exist, and an optimal point is missed
by everybody who is not false: "missed, loose". "Unconfirmed" is a certificate of a point that
no better one is known to and whose optimality the oracle leaves open, as that of the garage, which
is too large for it."""


def markdown(records: Sequence[Record]) -> str:
    """The report: totals, the random instances and where their truth is from, family by family."""
    lines = ["# The zoo: adversarial points for certifiers", "", INTRODUCTION, ""]
    named = [record for record in records if record.seed is None]
    drawn = [record for record in records if record.seed is not None]
    for title, group in (("Named families", named), ("Random instances", drawn)):
        if group:
            lines += [f"## {title}", "", *_shares(group), "", *_table(*totals(group)), ""]
    lines += ["## Family by family", ""]
    lines += [f"Cells: certified / false / missed; {NOTHING} where it judged nothing.", ""]
    lines += _table(*families(records))
    lines += ["", NOTES, ""]
    false = [f"- {record.row}: {record.note}" for record in records if record.note]
    if false:
        lines += ["## Where certpgo is false or fails", "", *false, ""]
    if records:
        commits = dict.fromkeys(record.provenance.get("commit", "") for record in records)
        origin = {**records[-1].provenance, "commit": ", ".join(commits)}
        lines += ["; ".join(f"{key}: {origin[key]}" for key in sorted(origin)), ""]
    return "\n".join(lines)


NOTHING = "–"  # noqa: RUF001 - a dash in a cell


def totals(records: Sequence[Record]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Header and rows: each certifier's outcomes over everything."""
    counts = _sum(records)
    header = ("certifier", *OUTCOMES[:2], "otherwise false", "bounds confirmed", *OUTCOMES[2:])
    rows = []
    for name in certifiers(records):
        own = [f"{counts[f'{name}: {outcome}']:,}" for outcome in OUTCOMES]
        extra = [NOTHING, NOTHING]
        if name.startswith("certpgo"):
            confirmed, open_ = (counts[f"{name}: bound {k}"] for k in ("confirmed", "undecided"))
            others = sum(counts[f"{name}: {outcome}"] for outcome in OTHERS)
            extra = [f"{others:,}", f"{confirmed:,} of {confirmed + open_:,}"]
        rows.append((name, *own[:2], *extra, *own[2:]))
    return header, rows


def families(records: Sequence[Record]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Header and rows: each family's points and what each certifier said of them."""
    names = certifiers(records)
    header = ("family", "points", "optimal", "not optimal", "truth from", *names)
    groups: dict[str, list[Record]] = {}
    for record in records:
        groups.setdefault(record.part, []).append(record)
    rows = []
    for part, members in groups.items():
        counts = _sum(members)
        truth = ", ".join(k.value for k in Known if counts[k.value])
        points = (counts["points"], counts["optimal"], counts["not optimal"])
        cells = (_cell(counts, name) for name in names)
        rows.append((part, *(f"{number:,}" for number in points), truth, *cells))
    return header, rows


def certifiers(records: Sequence[Record]) -> list[str]:
    """Every certifier that a record names."""
    return list(dict.fromkeys(n for r in records for n in r.settings.get("certifiers", ())))


def _shares(records: Iterable[Record]) -> list[str]:
    """What the points are, in sentences."""
    counts = _sum(records)
    points, optimal, not_optimal = (counts[k] for k in ("points", "optimal", "not optimal"))
    said = f"{points:,} points, {optimal:,} of them optimal and {not_optimal:,} not."
    total = counts["instances"]
    if not total:
        return [said]
    known = [k.value for k in Known if counts[f"{k.value}, instances"]]
    parts = ", ".join(f"{_percent(counts[f'{k}, instances'], total)} by {k}" for k in known)
    kinds = [f"{d}D {what}" for d in (2, 3) for what in ("rotations", "poses")]
    sorts = ", ".join(f"{_percent(counts[f'{k}, instances'], total)} {k}" for k in kinds)
    adverse = _percent(counts["wound-up or loose, instances"], total)
    return [
        f"{total:,} instances of known optimum, of 3 to 15 nodes, with {said} The optimum is known "
        f"{parts}; {sorts}; {adverse} are wound-up or loose. Half of them have their weights "
        "multiplied by a power of two between 2^-40 and 2^40. Another "
        f"{counts['set aside']:,} problems, whose optimum stays open, were judged for what can be "
        "seen to be false all the same."
    ]


def _percent(part: int, total: int) -> str:
    return f"{100.0 * part / total:.0f} %"


def _cell(counts: Counter[str], name: str) -> str:
    yes, false, missed = (counts[f"{name}: {outcome}"] for outcome in OUTCOMES[:3])
    if not yes and not counts[f"{name}: not certified"] and not counts[f"{name}: failed"]:
        return NOTHING
    return f"{yes} / {f'**{false}**' if false else 0} / {missed}"


def _sum(records: Iterable[Record]) -> Counter[str]:
    total: Counter[str] = Counter()
    for record in records:
        total.update(record.counts)
    return total


def _table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    return [bar(line) for line in (header, ["---"] * len(header), *rows)]
