"""Time limits and Ctrl-C at random moments: what is returned is true, and files are whole."""

from __future__ import annotations

import json
import os
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from functools import cache
from io import StringIO
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn, TextIO

import numpy as np

import certpgo
from certpgo import Estimate, Iteration, _start, certify, checker, solve
from certpgo.cli import main
from reports.studies.bookkeeping.drawing import Measurements, draw, turns
from reports.studies.bookkeeping.judging import Claim, Findings, judge, poses_of
from reports.studies.bookkeeping.oracle import Cost

COSTS = ("chordal", "g2o", "gtsam")
#: Exit codes that the documentation names.
DOCUMENTED = {0, 1, 3, 4, 5, 6, 130}


def judge_limits(rng: np.random.Generator, found: Findings) -> None:
    """Limits from 0.1 ms on, or a monitor that stops."""
    of, cost = _posed(rng)
    limit = float(10.0 ** rng.uniform(-4.0, -1.0)) if rng.random() < 0.8 else None
    _judge_both(rng, found, of, cost, limit, int(rng.integers(1, 60)))


def judge_interrupts(rng: np.random.Generator, found: Findings) -> None:
    """Ctrl-C in a program that calls the library."""
    of, cost = _posed(rng)
    try:
        with pressed(float(10.0 ** rng.uniform(-4.0, -1.0))):
            _judge_both(rng, found, of, cost, None, sys.maxsize)
    except KeyboardInterrupt:
        found.said["KeyboardInterrupt"] += 1


def _posed(rng: np.random.Generator) -> tuple[Measurements, Cost]:
    of = draw(rng, distances=0.3, nodes=(3, 10))
    return of, Cost(of, "chordal" if len(of.pairs) else str(rng.choice(COSTS)))


def _judge_both(
    rng: np.random.Generator,
    found: Findings,
    of: Measurements,
    cost: Cost,
    limit: float | None,
    most: int,
) -> None:
    count = 0

    def monitor(iteration: Iteration) -> bool:
        nonlocal count
        count += 1
        return count >= most

    if rng.random() < 0.5:
        with found.refusals("solve"):
            answer = solve(of.instance, cost=cost.name, time_limit=limit, monitor=monitor)
            with unpressed():
                judge(found, cost, [Claim.of("solve", answer.certificate, answer.estimate)])
        return
    given = Estimate(turns(rng, of.n, of.d), rng.standard_normal((of.n, of.d)))
    if rng.random() < 0.5:
        R = of.R.copy()
        R[of.points] = np.eye(of.d)
        given = Estimate(R, of.t)
    with found.refusals("certify"):
        c = certify(of.instance, given, cost=cost.name, time_limit=limit, monitor=monitor)
        with unpressed():
            judge(found, cost, [Claim.of("certify", c, given)], [poses_of(c.best)])
            if c.verdict == "REFUTED":
                better = cost.value(poses_of(c.best))
                worse = cost.value(poses_of(given))
                found.require(better < worse, f"REFUTED {worse!r} by {better!r}")


@contextmanager
def pressed(seconds: float) -> Iterator[None]:
    """Press Ctrl-C once during the block, after so many seconds."""

    def press(signum: int, frame: FrameType | None) -> None:
        signal.raise_signal(signal.SIGINT)

    before = signal.signal(signal.SIGALRM, press)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


@contextmanager
def unpressed() -> Iterator[None]:
    """No Ctrl-C during the oracle's own work."""
    left, _ = signal.setitimer(signal.ITIMER_REAL, 0.0)
    yield
    if left:
        signal.setitimer(signal.ITIMER_REAL, left)


def judge_commands(rng: np.random.Generator, found: Findings) -> None:
    """Ctrl-C, once or twice, while `certpgo solve` or `certify` runs: files are whole or absent."""
    import_commands()
    of = draw(rng, nodes=(5, 40), points=0.2, priors=0.2, full=0.3)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        graph, given = folder / "g.g2o", folder / "given.g2o"
        graph.write_text(of.text)
        certpgo.write(given, Estimate(of.R, of.t), instance=of.read())
        outputs = [folder / "out.g2o", folder / "out.cert", folder / "out.html"]
        arguments = ["solve", str(graph), "-o", str(outputs[0])]
        if rng.random() < 0.3:
            arguments = ["certify", str(graph), str(given)]
        asked = (["--proof", str(outputs[1])], ["--html", str(outputs[2])], ["--json"])
        for option in asked:
            arguments += option if rng.random() < 0.5 else []
        waits = [float(10.0 ** rng.uniform(-2.3, -0.3))]
        waits += [float(10.0 ** rng.uniform(-3.0, -1.0))] if rng.random() < 0.3 else []
        code, said, complained = run(arguments, folder, waits)
        found.said[f"{arguments[0]}: exit {code}"] += 1
        found.require(code in DOCUMENTED, f"exit {code}: {complained[-300:]}")
        found.require("Traceback" not in complained, complained[-500:])
        if "--json" in arguments and said:
            _judge_said(found, of, json.loads(said), outputs[0] if "-o" in arguments else given)
        _judge_files(found, of, graph, outputs)
        known = {path.name for path in (*outputs, graph, given)} | {"stdout", "stderr"}
        unexpected = sorted({path.name for path in folder.iterdir()} - known)
        found.require(not unexpected, f"left behind: {unexpected}")


@cache
def import_commands() -> None:
    """Import what the commands do, so that it is not what Ctrl-C meets in each child."""
    of = draw(np.random.default_rng(0))
    with tempfile.TemporaryDirectory() as name, redirect_stdout(StringIO()):
        graph, out = Path(name) / "g.g2o", Path(name) / "out.g2o"
        graph.write_text(of.text)
        with redirect_stderr(StringIO()):
            written = ["-o", str(out), "--proof", f"{out}.cert", "--html", f"{out}.html"]
            main(["solve", str(graph), *written])
            main(["certify", str(graph), str(out), "--json"])


def _judge_said(found: Findings, of: Measurements, said: dict[str, Any], path: Path) -> None:
    """Judge the JSON on standard output, of the estimate in a file."""
    cost = Cost(of, "g2o" if said["objective"].startswith("g2o") else "chordal")
    estimate, c = None, said["certificate"]
    if path.exists():
        estimate = poses_of(certpgo.read_estimate(path, of.read()))
    upper, lower = c["cost_upper"], said["lower_bound"]
    tolerance, exact = c["tolerance"], c["is_exact_fit"]
    judge(found, cost, [Claim("JSON", estimate, upper, lower, tolerance, said["verdict"], exact)])


def run(arguments: list[str], folder: Path, waits: list[float]) -> tuple[int, str, str]:
    """The command in a process of its own, which is sent SIGINT after these seconds."""
    files = folder / "stdout", folder / "stderr"
    with files[0].open("w") as out, files[1].open("w") as err, warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # other threads only wait
        child = os.fork()
        if not child:
            _become(arguments, out, err)
    for wait in waits:
        time.sleep(wait)
        os.kill(child, signal.SIGINT)
    _, status = os.waitpid(child, 0)
    code = os.waitstatus_to_exitcode(status)
    code = 130 if code == -signal.SIGINT else code
    return code, files[0].read_text(), files[1].read_text()


def _become(arguments: list[str], out: TextIO, err: TextIO) -> NoReturn:
    """Be the command: only its handler of Ctrl-C, and its warnings."""
    code = 99
    try:
        signal.signal(signal.SIGINT, _start._end)
        warnings.simplefilter("ignore", ResourceWarning)
        for number, file in ((1, out), (2, err)):
            os.dup2(file.fileno(), number)
        sys.stdout, sys.stderr = out, err
        code = main(arguments)
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    except BaseException:
        if code == 99:  # later, the command had ended
            err.write(traceback.format_exc())
    finally:
        out.flush()
        err.flush()
        os._exit(code)


def _judge_files(found: Findings, of: Measurements, graph: Path, outputs: list[Path]) -> None:
    estimate, proof, page = outputs
    if estimate.exists():
        found.said["estimate written"] += 1
        ids = certpgo.read_estimate(estimate, certpgo.read(graph, quiet=True)).num_nodes
        found.require(ids == of.n, f"an estimate of {ids} nodes was written, of {of.n}")
    if proof.exists():
        found.said["proof written"] += 1
        answer = checker.check(graph, proof)
        cost = Cost(of, "g2o" if answer.about.startswith("g2o") else "chordal")
        best, where = cost.best([(of.R, of.t)])
        slack = 4.0 * cost.rounding(where)
        found.require(answer.lower <= best + slack, f"proof of {answer.lower!r} above {best!r}")
    if page.exists():
        found.said["page written"] += 1
        found.require(page.read_text().rstrip().endswith("</html>"), "half a page")
