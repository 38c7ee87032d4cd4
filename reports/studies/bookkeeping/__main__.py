"""A campaign over what is kept between answers: sessions, maps, files, limits.

    python -m reports.studies.bookkeeping --instances 10000 --seed 0 --out campaign.jsonl

Each draw is a random small graph of a kind's generator, and a judgement of everything that the
package says about it, against costs in plain NumPy and descents by SciPy. One line of JSON a draw,
added to the file; draws that are there already are not made again. A table by kind is printed at
the end; exit code 1 if anything was false. ``--only KIND:NUMBER`` makes one draw, and says more.
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
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from certpgo import InputNotice
from reports.studies._printing import print_table
from reports.studies.bookkeeping import (
    covariances,
    engines,
    merging,
    readers,
    robust,
    sessions,
    stopping,
    weights,
)
from reports.studies.bookkeeping.judging import Findings

Kind = Callable[[np.random.Generator, Findings], None]
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
    found, begin = Findings(), time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", InputNotice)
        try:
            KINDS[kind][0](rng, found)
        except Exception as error:
            frame = traceback.extract_tb(error.__traceback__)[-1]
            place = f"{Path(frame.filename).name}:{frame.lineno}"
            found.false.append(f"{type(error).__name__}: {str(error)[:200]} ({place})")
    seconds = round(time.process_time() - begin, 3)
    return {
        "kind": kind,
        "seed": seed,
        "number": number,
        "said": dict(found.said),
        "false": found.false,
        "seconds": seconds,
    }


def campaign(instances: int, seed: int, out: Path) -> list[dict[str, Any]]:
    """Make the draws that are not in the file yet, and add them; returns all of them."""
    known = {}
    if out.exists():
        records = [json.loads(line) for line in out.read_text().splitlines()]
        known = {(r["kind"], r["number"]): r for r in records if r["seed"] == seed}
    false = 0
    with out.open("a") as file:
        for k, (kind, number) in enumerate(plan(instances), 1):
            if (kind, number) not in known:
                record = known[kind, number] = judged(kind, seed, number)
                file.write(json.dumps(record) + "\n")
                file.flush()
            false += bool(known[kind, number]["false"])
            print(f"\r{k} of {instances}, {false} false", end="", file=sys.stderr)
    print(file=sys.stderr)
    return [known[key] for key in plan(instances)]


def summary(records: list[dict[str, Any]]) -> list[dict[str, object]]:
    """One row a kind."""
    rows = []
    for kind in KINDS:
        own = [r for r in records if r["kind"] == kind]
        said = sum((Counter(r["said"]) for r in own), Counter())
        rows.append(
            {
                "kind": kind,
                "draws": len(own),
                "answers": sum(n for what, n in said.items() if "refused" not in what),
                "refused": sum(n for what, n in said.items() if "refused" in what),
                "false": sum(bool(r["false"]) for r in own),
                "s": f"{sum(r['seconds'] for r in own):.1f}",
            }
        )
    return rows


def main() -> int:
    """Run, print, and return 1 if anything was false."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--instances", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("campaign.jsonl"))
    parser.add_argument("--only", metavar="KIND:NUMBER")
    options = parser.parse_args()
    if options.only:
        kind, _, number = options.only.partition(":")
        records = [judged(kind, options.seed, int(number))]
        print(json.dumps(records[0], indent=1))
    else:
        records = campaign(options.instances, options.seed, options.out)
    for record in records:
        for what in record["false"]:
            print(f"{record['kind']}:{record['number']}: {what}")
    if not options.only:
        print_table(summary(records), None)
    return int(any(record["false"] for record in records))


if __name__ == "__main__":
    sys.exit(main())
