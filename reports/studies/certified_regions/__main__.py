"""What certified regions hold, how sharp and how wide they are, and what they cost.

    OPENBLAS_NUM_THREADS=1 python -m reports.studies.certified_regions [--checks N] [--again ...]

Five sections: a campaign of random estimates of random graphs of all kinds, against their regions;
the largest share of regions that an adversary reaches on public graphs; regions next to
covariances on twelve public graphs; an estimate that is certified and far; the two valleys of a
cycle. Records are kept in reports/results/certified_regions.json and the page beside it is made
from them; sections that are there are not run again, and a campaign that was interrupted goes on.
Times are process seconds on one thread.
"""

import argparse
import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from reports.studies.certified_regions import basins, far, page, public
from reports.studies.certified_regions.campaign import Tally, examine
from reports.studies.certified_regions.kinds import KINDS, own_kinds

OUT = Path(__file__).parents[2] / "results" / "certified_regions.json"

Records = dict[str, Any]


def campaign(records: Records, checks: int, keep: Callable[[], None]) -> None:
    """Graphs of each kind in turn, until there are as many checks of all of them together."""
    tallies = records.setdefault("campaign", {})
    found = {kind: Tally(**tallies.get(kind, {})) for kind in KINDS}
    with own_kinds():
        while sum(tally.checks for tally in found.values()) < checks:
            for kind, tally in found.items():
                examine(kind, tally.graphs, tally)
            tallies.update({kind: asdict(tally) for kind, tally in found.items()})
            keep()
            print(sum(tally.checks for tally in found.values()), "checks", flush=True)


SECTIONS: dict[str, Callable[[], Any]] = {
    "sharpness": lambda: [public.attacked(name, "chordal") for name in public.ATTACKED],
    "widths": public.all_widths,
    "far": far.row,
    "basins": basins.rows,
}


def main() -> None:
    """Run what is missing, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--checks", type=int, default=100_000, help="of the campaign")
    parser.add_argument("--again", nargs="*", default=(), choices=("campaign", *SECTIONS))
    parser.add_argument("--out", type=Path, default=OUT, help="records; the page is beside them")
    options = parser.parse_args()
    records: Records = json.loads(options.out.read_text()) if options.out.exists() else {}
    for name in options.again:
        records.pop(name, None)

    def keep() -> None:
        options.out.write_text(json.dumps(records, indent=1) + "\n")

    campaign(records, options.checks, keep)
    for name, run in SECTIONS.items():
        if name not in records:
            records[name] = run()
            keep()
            print(name, flush=True)
    options.out.with_suffix(".md").write_text(page.text(records))


if __name__ == "__main__":
    main()
