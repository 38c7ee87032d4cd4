"""The zoo's records as text: a pure function of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from certpgo.view.markdown_tables import bar
from reports.harness.certifiers.campaign import SET_ASIDE, WOUND_OR_LOOSE
from reports.harness.certifiers.points import Known
from reports.harness.experiments.zoo_records import (
    ALL,
    OTHER_FAULTS,
    Outcome,
    Tally,
    ZooRecord,
    total,
)

#: The outcomes that are shown, in their order.
SHOWN = (
    Outcome.CERTIFIED,
    Outcome.FALSE,
    Outcome.MISSED,
    Outcome.MISSED_LOOSE,
    Outcome.NO_ANSWER,
    Outcome.UNCONFIRMED,
    Outcome.REFUSED,
    Outcome.FAILED,
    Outcome.NOT_INSTALLED,
)

INTRODUCTION = """\
Every certifier is given a problem and a point and says whether the point is optimal. A certificate
is **false** when an estimate in hand is better by more than 1e-5 F + 1e-12 W (our tolerance; W is
the sum of kappa and tau |t_ij|^2), or when the point is no estimate at all; it is **missed** when
the point is within a tenth of that of the optimum, and not certified. A **false bound** is a proven
lower bound above the cost of an estimate in hand, a **false refutation** one by an estimate that
costs no less, a **false proof** one whose certificate matrix has a negative eigenvalue; these and
optima that are none are counted as otherwise false. Up to 200 nodes an interval factorization of
the very matrix that a bound rests on confirms it or not. **No answer** is UNDECIDED (of certpgo)
where a lower bound above the tolerance exists.
Costs in hand are enclosed in interval arithmetic. F* is known in closed form; or by an interval
L D L^T of the certificate matrix, in 160-bit balls; or by branch and bound over the angles of up to
four rotations in the plane."""

NOTES = """\
certpgo is run twice: as it comes (it descends, takes the bound from there and from a second
start, and certifies the point as given), and unrefined, on the point's own multipliers alone.

gtsam_shonan is `ShonanAveraging.checkOptimality` of GTSAM (smallest eigenvalue by Lanczos above
-1e-4, S in twice our scale). gtsam_staircase is GTSAM's `RiemannianStaircaseOptimizer` started at
the point and held at rank d: what it certifies is where its own descent ended, and that is checked,
projected to rotations. se_sync_rule requires a Cholesky factor of S + 1e-3 I, cora_rule of
S + eta I with eta = 5e-6 F/2 between 1e-7 and 1e-1; both are our reading of those rules on our
matrices, not runs of those programs. The rules are meant for stationary points, so that what they
say of points that are not (moved along the softest mode, not stationary, scaled) is a warning to
their users rather than a fault of their authors. GTSAM's two take rotations alone and refuse poses.

Under g2o's and GTSAM's costs, with full information, the costs of points are enclosed as well. Only
closed forms say what the optimum is; elsewhere the best point in hand shows that others are wrong,
and its own certificate is unconfirmed. Bounds rest on surrogates there, so that they are compared
with costs in hand alone. The proof tier refuses GTSAM's cost; the competitors' rules are about F
and refuse both.

Where the relaxation is loose no certificate of this kind can exist, and an optimal point is missed
by every certifier that is not false: "missed, loose". "Unconfirmed" is a certificate of a point
that no better one is known to and whose optimality the oracle leaves open, as that of the garage,
which is too large for it."""


def zoo_markdown(records: Sequence[ZooRecord]) -> str:
    """The report: totals, the random instances and where their truth is from, family by family."""
    lines = ["# The zoo: adversarial points for certifiers", "", INTRODUCTION, ""]
    named = [record for record in records if record.seed is None]
    drawn = [record for record in records if record.seed is not None]
    for title, group in (("Named families", named), ("Random instances", drawn)):
        if group:
            lines += [f"## {title}", "", *_shares(group), "", *_table(*totals(group)), ""]
    lines += ["## Family by family", ""]
    lines += [f"Cells: certified / false / missed; {NOTHING} where it took no point.", ""]
    lines += _table(*families(records))
    lines += ["", NOTES, ""]
    false = [f"- {record.label}: {'; '.join(record.faults)}" for record in records if record.faults]
    if false:
        lines += ["## Where certpgo is false or fails", "", *false, ""]
    if records:
        commits = dict.fromkeys(record.provenance.get("commit", "") for record in records)
        origin = {**records[-1].provenance, "commit": ", ".join(commits)}
        lines += ["; ".join(f"{key}: {origin[key]}" for key in sorted(origin)), ""]
    return "\n".join(lines)


NOTHING = "–"  # noqa: RUF001 - a dash in a cell


def totals(records: Sequence[ZooRecord]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Header and rows: each certifier's outcomes over everything."""
    counts = total(records)
    header = ("certifier", *SHOWN[:2], "otherwise false", "bounds confirmed", *SHOWN[2:])
    rows = []
    for name in certifier_names(records):
        outcomes = counts.of(name)
        own = [f"{outcomes[outcome]:,}" for outcome in SHOWN]
        extra = [NOTHING, NOTHING]
        if name.startswith("certpgo"):
            confirmed, open_ = outcomes[Outcome.CONFIRMED], outcomes[Outcome.UNDECIDED]
            others = sum(outcomes[fault] for fault in OTHER_FAULTS)
            extra = [f"{others:,}", f"{confirmed:,} of {confirmed + open_:,}"]
        rows.append((name, *own[:2], *extra, *own[2:]))
    return header, rows


def families(records: Sequence[ZooRecord]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Header and rows: each family's points and what each certifier said of them."""
    names = certifier_names(records)
    header = ("family", "points", "optimal", "not optimal", "truth from", *names)
    groups: dict[str, list[ZooRecord]] = {}
    for record in records:
        groups.setdefault(record.family, []).append(record)
    rows = []
    for family, members in groups.items():
        counts = total(members)
        truth = ", ".join(k.value for k in Known if counts.points[k.value])
        points = (counts.points[k] for k in (ALL, "optimal", "not optimal"))
        cells = (_cell(counts, name) for name in names)
        rows.append((family, *(f"{number:,}" for number in points), truth, *cells))
    return header, rows


def certifier_names(records: Sequence[ZooRecord]) -> list[str]:
    """Every certifier that a record names."""
    return list(dict.fromkeys(n for r in records for n in r.certifiers))


def _shares(records: Iterable[ZooRecord]) -> list[str]:
    """What the points are, in sentences."""
    counts = total(records)
    points, optimal, not_optimal = (counts.points[k] for k in (ALL, "optimal", "not optimal"))
    said = f"{points:,} points, {optimal:,} of them optimal and {not_optimal:,} not."
    instances = counts.instances
    every = instances[ALL]
    if not every:
        return [said]
    known = [k.value for k in Known if instances[k.value]]
    parts = ", ".join(f"{_percent(instances[k], every)} by {k}" for k in known)
    kinds = [f"{d}D {what}" for d in (2, 3) for what in ("rotations", "poses")]
    sorts = ", ".join(f"{_percent(instances[k], every)} {k}" for k in kinds)
    adverse = _percent(instances[WOUND_OR_LOOSE], every)
    return [
        f"{every:,} instances of known optimum, of 3 to 15 nodes, with {said} The optimum is known "
        f"{parts}; {sorts}; {adverse} are wound-up or loose. Half of them have their weights "
        "multiplied by a power of two between 2^-40 and 2^40. Another "
        f"{instances[SET_ASIDE]:,} problems, whose optimum stays open, were checked for what is "
        "false nevertheless."
    ]


def _percent(part: int, total: int) -> str:
    return f"{100.0 * part / total:.0f} %"


def _cell(counts: Tally, name: str) -> str:
    outcomes = counts.of(name)
    yes, false, missed = (outcomes[outcome] for outcome in SHOWN[:3])
    if not yes and not outcomes[Outcome.NOT_CERTIFIED] and not outcomes[Outcome.FAILED]:
        return NOTHING
    return f"{yes} / {f'**{false}**' if false else 0} / {missed}"


def _table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    return [bar(line) for line in (header, ["---"] * len(header), *rows)]
