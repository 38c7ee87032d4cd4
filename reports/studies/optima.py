"""The register of certified optima, computed for every dataset that is here.

    python -m reports.studies.optima [NAME ...] [--seconds S] [--again] [--register DIR]

Each graph and cost is a process of its own with a limit of CPU time, whatever else runs: `certpgo
optima --add NAME --cost COST --exact`. What the register has already is not computed again, so an
interrupted run goes on where it ended; ``--again`` tries to improve it. What takes too long is
entered as that.
"""

from __future__ import annotations

import argparse
import functools
import resource
import subprocess
import sys
import time
from pathlib import Path

from certpgo.io import datasets
from certpgo.objective.costs import COSTS
from certpgo.optima import Absent, Register

#: The reason of what no run has come to: the next one does.
LATER = "not computed yet"
#: Seconds of CPU time for a graph under a cost, without the check in integers.
SECONDS = 300


def main() -> int:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("names", nargs="*")
    parser.add_argument("--seconds", type=int, default=SECONDS)
    parser.add_argument("--costs", nargs="*", default=[*COSTS])
    parser.add_argument("--no-exact", action="store_true", help="without the check in integers")
    parser.add_argument("--again", action="store_true")
    parser.add_argument("--register", type=Path, default=None)
    parser.add_argument("--pending", action="store_true", help="only enter what is not computed")
    given = parser.parse_args()
    if given.pending:
        enter_pending(given.register)
        return 0
    for name in given.names or by_size():
        for cost in given.costs:
            if given.again or not is_known(given.register, name, cost):
                compute(name, cost, given.seconds, given.register, not given.no_exact)
    return 0


def by_size() -> list[str]:
    """The graphs that are here, small ones first."""
    here = [name for name in datasets.names("graph") if datasets.find(name) is not None]
    return sorted(here, key=lambda name: datasets.entry(name).edges or 0)


def is_known(folder: Path | None, name: str, cost: str) -> bool:
    """Whether the register says something about a graph under a cost."""
    register = Register(folder)
    absent = {(one.name, one.cost) for one in register.absent if one.reason != LATER}
    return (name, cost) in absent or any(one.cost == cost for one in register.named(name))


def enter_pending(folder: Path | None) -> None:
    """Enter what no run has come to, of graphs that have an optimum."""
    register = Register(folder)
    for name in {one.name for one in register.optima}:
        for cost in COSTS:
            if not is_known(folder, name, cost):
                register.put(Absent(name, cost, LATER))
    register.save()


def compute(name: str, cost: str, seconds: int, folder: Path | None, exact: bool) -> None:
    """Add an optimum in a process of its own."""
    line = [sys.executable, "-m", "certpgo", "optima", "--add", name, "--cost", cost]
    line += ["--exact"] if exact else []
    line += ["--register", str(folder)] if folder else []
    start = time.perf_counter()
    limited = functools.partial(resource.setrlimit, resource.RLIMIT_CPU, (seconds, seconds))
    done = subprocess.run(line, capture_output=True, text=True, preexec_fn=limited, check=False)
    said = f"{done.stdout}{done.stderr}".strip()
    if done.returncode < 0:  # killed at the limit
        said = f"not computed within {seconds} seconds"
    if done.returncode:
        reason = said.removeprefix("certpgo: ")
        register = Register(folder)
        register.put(Absent(name, cost, reason))
        register.save()
    print(f"{time.perf_counter() - start:6.1f} s  {name} {cost}: {said}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
