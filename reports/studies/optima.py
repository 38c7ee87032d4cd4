"""The register of certified optima, computed for every dataset that is here.

    python -m reports.studies.optima [NAME ...] [--timeout SECONDS] [--again] [--register DIR]

Each graph and cost is a process of its own with a time limit: `certpgo optima --add NAME --cost
COST --exact`. What the register has already is not computed again, so an interrupted run goes on
where it ended; ``--again`` tries to improve it. What takes too long is entered as that.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from pathlib import Path

from certpgo.io import datasets
from certpgo.objective.costs import CHORDAL, COSTS
from certpgo.optima import Absent, Register

#: Seconds for a graph under a cost.
TIMEOUT = 300.0


def main() -> int:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("names", nargs="*")
    parser.add_argument("--timeout", type=float, default=TIMEOUT)
    parser.add_argument("--no-exact", action="store_true", help="without the check in integers")
    parser.add_argument("--again", action="store_true")
    parser.add_argument("--register", type=Path, default=None)
    given = parser.parse_args()
    for name in given.names or by_size():
        for cost in (CHORDAL, *COSTS):
            if given.again or not is_known(given.register, name, cost):
                compute(name, cost, given.timeout, given.register, not given.no_exact)
    return 0


def by_size() -> list[str]:
    """The graphs that are here, small ones first."""
    here = [name for name in datasets.names("graph") if datasets.find(name) is not None]
    return sorted(here, key=lambda name: datasets.entry(name).edges or 0)


def is_known(folder: Path | None, name: str, cost: str) -> bool:
    """Whether the register says something about a graph under a cost."""
    register = Register(folder)
    absent = {(one.name, one.cost) for one in register.absent}
    return (name, cost) in absent or any(one.cost == cost for one in register.named(name))


def compute(name: str, cost: str, timeout: float, folder: Path | None, exact: bool) -> None:
    """Add an optimum in a process of its own."""
    line = [sys.executable, "-m", "certpgo", "optima", "--add", name, "--cost", cost]
    line += ["--exact"] if exact else []
    line += ["--register", str(folder)] if folder else []
    start = time.perf_counter()
    try:
        done = subprocess.run(line, capture_output=True, text=True, timeout=timeout, check=False)
        said = f"{done.stdout}{done.stderr}".strip()
        reason = "" if done.returncode == 0 else said.removeprefix("certpgo: ")
    except subprocess.TimeoutExpired:
        reason = said = f"not computed within {timeout:.0f} seconds"
    if reason:
        register = Register(folder)
        register.put(Absent(name, cost, reason))
        register.save()
    print(f"{time.perf_counter() - start:6.1f} s  {name} {cost}: {said}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
