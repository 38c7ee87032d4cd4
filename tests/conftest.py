import signal
import warnings
from textwrap import dedent
from types import SimpleNamespace

import pytest
from hypothesis import settings

from certpgo import registry
from certpgo.errors import InputNotice
from certpgo.io import datasets
from certpgo.optimize import progress

# `pytest --hypothesis-profile=campaign` draws other examples in each run, and 500 where a test sets
# no number.
settings.register_profile("ci", derandomize=True, deadline=None, max_examples=50)
settings.register_profile("campaign", deadline=None, max_examples=500)
settings.load_profile("ci")

# Shells let their background jobs ignore Ctrl-C, which some tests send.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def dataset_path():
    """The local file of a dataset; skips when it is nowhere."""

    def locate(name):
        path = datasets.find(name)
        if path is None:
            pytest.skip(f"{name}: file not here")
        return path

    return locate


@pytest.fixture
def dataset(dataset_path):
    """A dataset as an Instance, read without notices; skips when its file is nowhere."""

    def load(name, **options):
        dataset_path(name)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", InputNotice)
            return datasets.load(name, download=False, **options)

    return load


@pytest.fixture
def clock(monkeypatch):
    """The clock of time limits, which the test sets: ``clock.now`` seconds."""
    stopped = SimpleNamespace(now=0.0)
    monkeypatch.setattr(progress, "time", SimpleNamespace(monotonic=lambda: stopped.now))
    return stopped


#: A method that logs each run, waits for a file from some run on, and sleeps, dies or fails on
#: graphs of as many nodes as it is told.
MISCHIEF = """
    import os
    import signal
    import time
    from dataclasses import dataclass
    from pathlib import Path

    from certpgo.optimize.methods.spanning_tree import SpanningTree

    @dataclass(frozen=True)
    class Mischief(SpanningTree):
        deed: str = ""
        nodes: int = 0

        def solve(self, problem, **more):
            n = problem.graph.num_nodes
            log = Path(os.environ["CERTPGO_TEST_LOG"])
            with log.open("a") as stream:
                stream.write(f"{n}\\n")
                stream.flush()
                place = stream.tell() // 2  # nobody else's lines count that come after
            if place >= int(os.environ.get("CERTPGO_TEST_STOP", "1000")):
                log.with_suffix(".pid").write_text(str(os.getpid()))
                while not log.with_suffix(".go").exists():
                    time.sleep(0.02)
            if self.deed == "die" and n == self.nodes:
                os.kill(os.getpid(), signal.SIGKILL)
            if self.deed == "sleep" and n == self.nodes:
                time.sleep(600)
            if self.deed == "swell" and n == self.nodes:
                raise MemoryError
            if self.deed == "err" and n == self.nodes:
                raise RuntimeError("by design")
            return super().solve(problem, **more)

    SOLVER = Mischief
"""

#: A table of six cycles of 4 to 9 nodes.
CYCLES = """
    from reports.harness.experiments.spec import Column, Method, Row, Table

    TABLE = Table(
        "cycles",
        "Cycles",
        tuple(
            Row(label=f"n = {n}", generator="cycle", arguments={"n": n, "sigma": 0.1})
            for n in range(4, 10)
        ),
        (Method("mischief"), Method("eigen_ra")),
        (Column("cost", "F"), Column("seconds", "s")),
        quick=("n = 4",),
    )
"""


@pytest.fixture
def small_checkout(tmp_path, monkeypatch):
    """A checkout of one mischievous method and one table; the path of the method's log."""
    for name, text in (("baselines/mischief", MISCHIEF), ("reports/tables/cycles", CYCLES)):
        path = tmp_path / "checkout" / f"{name}.py"
        path.parent.mkdir(parents=True)
        path.write_text(dedent(text))
    monkeypatch.setenv(registry.REPOSITORY_VARIABLE, str(tmp_path / "checkout"))
    log = tmp_path / "runs.log"
    log.touch()
    monkeypatch.setenv("CERTPGO_TEST_LOG", str(log))
    return log
