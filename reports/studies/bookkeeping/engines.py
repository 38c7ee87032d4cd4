"""Answers without the compiled kernel, and with SuperLU."""

from __future__ import annotations

import atexit
import os
import pickle
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import numpy as np

import certpgo
from certpgo.linalg import factor
from reports.studies.bookkeeping.drawing import Measurements, draw
from reports.studies.bookkeeping.judging import Claim, Findings, judge
from reports.studies.bookkeeping.oracle import Cost

#: What a process without the kernel does.
ALONE = "from reports.studies.bookkeeping.engines import serve; serve()"
COSTS = ("chordal", "g2o", "gtsam")


def judge_fallbacks(rng: np.random.Generator, found: Findings) -> None:
    """Verdicts are true with every engine, and the same where rounding does not lead a search.

    The search of graphs with distances begins at random, and may end at another point.
    """
    of = draw(rng, distances=0.2)
    cost = Cost(of, "chordal" if len(of.pairs) else str(rng.choice(COSTS)))
    provable = cost.name != "gtsam" and not len(of.pairs)
    tier = "proof" if provable and rng.random() < 0.5 else "standard"
    with found.refusals("solve"):
        claims = [_claim("compiled", of, cost.name, tier)]
        with environment(CERTPGO_ENGINE="superlu"):
            claims.append(_claim("superlu", of, cost.name, tier))
        claims.append(alone(of, cost.name, tier))
        judge(found, cost, claims)
        verdicts = {claim.verdict for claim in claims}
        same = len(verdicts) == 1 or len(of.pairs) > 0
        found.require(same, f"{tier}: {[c.verdict for c in claims]}")


def _claim(name: str, of: Measurements, cost: str, tier: str) -> Claim:
    answer = certpgo.solve(of.instance, cost=cost, tier=tier)
    return Claim.of(name, answer.certificate, answer.estimate)


@contextmanager
def environment(**variables: str) -> Iterator[None]:
    """Set variables of the environment during the block."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})


def alone(of: Measurements, cost: str, tier: str) -> Claim:
    """The claim of a process without the kernel."""
    process = _process()
    pickle.dump((of, cost, tier), process.stdin)
    process.stdin.flush()
    answer = pickle.load(process.stdout)
    if isinstance(answer, Exception):
        raise answer
    found: Claim = answer
    return found


@cache
def _process() -> Any:
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    left_out = os.environ | {"CERTPGO_KERNEL": "0"}
    process = subprocess.Popen([sys.executable, "-c", ALONE], env=left_out, **pipes)
    atexit.register(process.communicate)  # without more questions it ends
    return process


def serve() -> None:
    """Answer what standard input asks for until it ends."""
    assert factor.engines() == ("superlu",)  # noqa: S101
    while True:
        try:
            of, cost, tier = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        try:
            answer: object = _claim("alone", of, cost, tier)
        except Exception as error:
            answer = error
        pickle.dump(answer, sys.stdout.buffer)
        sys.stdout.buffer.flush()
