"""A campaign over what is kept between answers: sessions, maps, files, limits.

    python -m reports.studies.bookkeeping --instances 10000 --seed 0 --out campaign.jsonl
    python -m reports.studies.bookkeeping --rows 10000 --seed 0 --out rows.jsonl

Each draw is a random small graph of a kind's generator, and a judgement of everything that the
package says about it, against costs in plain NumPy and descents by SciPy. With ``--rows`` they are
rows of covering arrays instead, in which every pair of features meets: see `factors`. One line of
JSON a draw, added to the file; draws that are there already are not made again. A table by kind, or
by feature, is printed at the end; exit code 1 if anything was false. ``--only KIND:NUMBER`` makes
one draw, and says more; rows are of the kind ``row``.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
import traceback
import warnings
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from certpgo import InputNotice
from reports.studies._printing import print_table
from reports.studies.bookkeeping import (
    covariances,
    covering,
    engines,
    merging,
    readers,
    robust,
    sessions,
    stopping,
    weights,
)
from reports.studies.bookkeeping.factors import FACTORS, RULES
from reports.studies.bookkeeping.judging import Findings
from reports.studies.bookkeeping.rows import judge_row

Kind = Callable[[np.random.Generator, Findings], None]
Draw = Callable[[], dict[str, Any]]
#: What is drawn, and its share of 10,000.
KINDS: dict[str, tuple[Kind, int]] = {
    "sessions": (sessions.judge_poses, 900),
    "sessions with priors": (sessions.judge_priors, 900),
    "sessions with LANDMARK2": (sessions.judge_landmarks, 400),
    "merge": (merging.judge_merge, 700),
    "sparsify": (merging.judge_sparsify, 500),
    "robust": (robust.judge_batch, 500),
    "robust sessions": (robust.judge_session, 500),
    "suspicions": (robust.judge_suspicion, 300),
    "mahalanobis": (weights.judge_mahalanobis, 600),
    "weights": (weights.judge_extremes, 700),
    "covariances": (covariances.judge, 900),
    "readers": (readers.judge, 1000),
    "fallbacks": (engines.judge_fallbacks, 400),
    "time limits": (stopping.judge_limits, 600),
    "Ctrl-C": (stopping.judge_interrupts, 450),
    "Ctrl-C in commands": (stopping.judge_commands, 400),
}
WHOLE = sum(share for _, share in KINDS.values())


def plan(instances: int) -> Iterator[tuple[str, int]]:
    """Kinds and numbers of draws, in the shares of `KINDS` at every moment."""
    made: Counter[str] = Counter()
    for k in range(1, instances + 1):
        name = max(KINDS, key=lambda name: k * KINDS[name][1] / WHOLE - made[name])
        yield name, made[name]
        made[name] += 1


def judged(kind: str, seed: int, number: int) -> dict[str, Any]:
    """One draw, as it is recorded."""
    rng = np.random.default_rng([seed, zlib.crc32(kind.encode()), number])
    return {"kind": kind, "seed": seed, "number": number, **said(partial(KINDS[kind][0], rng))}


def said(judge: Callable[[Findings], None]) -> dict[str, Any]:
    """What was said and what of it is false, with the seconds that it took."""
    found, begin = Findings(), time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", InputNotice)
        try:
            judge(found)
        except Exception as error:
            frame = traceback.extract_tb(error.__traceback__)[-1]
            place = f"{Path(frame.filename).name}:{frame.lineno}"
            found.false.append(f"{type(error).__name__}: {str(error)[:200]} ({place})")
    seconds = round(time.process_time() - begin, 3)
    return {"said": dict(found.said), "false": found.false, "seconds": seconds}


def drawn(instances: int, seed: int) -> Iterator[tuple[str, int, Draw]]:
    """Kinds, numbers, and how each is made."""
    for kind, number in plan(instances):
        yield kind, number, partial(judged, kind, seed, number)


def rows(count: int, seed: int) -> Iterator[tuple[str, int, Draw]]:
    """The same of rows: covering arrays one after another, each with what is refused."""
    number, array = 0, 0
    while number < count:
        rng = np.random.default_rng([seed, zlib.crc32(b"array"), array])
        valid = [(row, None) for row in covering.rows(FACTORS, RULES, rng)]
        for row, rule in [*valid, *covering.refused(FACTORS, RULES, rng)][: count - number]:
            yield "row", number, partial(_row, seed, number, row, rule)
            number += 1
        array += 1


def _row(seed: int, number: int, row: covering.Row, rule: covering.Rule | None) -> dict[str, Any]:
    rng = np.random.default_rng([seed, zlib.crc32(b"row"), number])
    names = {name: level for name, level in row.items() if level != FACTORS[name][0]}
    known = {"kind": "row", "seed": seed, "number": number, "row": names, "rule": rule is not None}
    return {**known, **said(partial(judge_row, rng, row=row, rule=rule))}


def campaign(draws: Iterable[tuple[str, int, Draw]], seed: int, out: Path) -> list[dict[str, Any]]:
    """Make the draws that are not in the file yet, and add them; returns all of them."""
    known, made = {}, []
    if out.exists():
        records = [json.loads(line) for line in out.read_text().splitlines()]
        known = {(r["kind"], r["number"]): r for r in records if r["seed"] == seed}
    false = 0
    with out.open("a") as file:
        for k, (kind, number, draw) in enumerate(draws, 1):
            if (kind, number) not in known:
                record = known[kind, number] = draw()
                file.write(json.dumps(record) + "\n")
                file.flush()
            made.append(known[kind, number])
            false += bool(made[-1]["false"])
            print(f"\r{k}, {false} false", end="", file=sys.stderr)
    print(file=sys.stderr)
    return made


def summary(records: list[dict[str, Any]]) -> list[dict[str, object]]:
    """One row a kind, or a level of a factor."""
    found = {"kind": [r for r in records if "row" not in r]}
    table = [
        {"kind": kind, **_counts([r for r in found["kind"] if r["kind"] == kind])}
        for kind in KINDS
        if found["kind"]
    ]
    for factor, levels in FACTORS.items() if len(found["kind"]) < len(records) else ():
        for level in levels:
            own = [r for r in records if r["row"].get(factor, levels[0]) == level]
            table.append({"kind": f"{factor}: {level}", **_counts(own)})
    return table


def _counts(own: list[dict[str, Any]]) -> dict[str, object]:
    said = sum((Counter(r["said"]) for r in own), Counter())
    return {
        "draws": len(own),
        "answers": sum(n for what, n in said.items() if "refused" not in what),
        "refused": sum(n for what, n in said.items() if "refused" in what),
        "false": sum(bool(r["false"]) for r in own),
        "s": f"{sum(r['seconds'] for r in own):.1f}",
    }


def main() -> int:
    """Run, print, and return 1 if anything was false."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--instances", type=int, default=10_000)
    parser.add_argument("--rows", type=int)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("campaign.jsonl"))
    parser.add_argument("--only", metavar="KIND:NUMBER")
    options = parser.parse_args()
    if options.only:
        kind, _, number = options.only.partition(":")
        known = rows(int(number) + 1, options.seed) if kind == "row" else []
        draws = [draw for _, k, draw in known if k == int(number)]
        records = [draws[0]() if draws else judged(kind, options.seed, int(number))]
        print(json.dumps(records[0], indent=1))
    elif options.rows:
        records = campaign(rows(options.rows, options.seed), options.seed, options.out)
    else:
        records = campaign(drawn(options.instances, options.seed), options.seed, options.out)
    for record in records:
        for what in record["false"]:
            print(f"{record['kind']}:{record['number']}: {what}")
    if not options.only:
        print_table(summary(records), None)
    return int(any(record["false"] for record in records))


if __name__ == "__main__":
    sys.exit(main())
