"""A sample of `reports.studies.bookkeeping`: nothing is false about sessions, maps and files."""

import json
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from reports.studies.bookkeeping import __main__ as study
from reports.studies.bookkeeping import covering, sessions
from reports.studies.bookkeeping.drawing import draw
from reports.studies.bookkeeping.factors import FACTORS, RULES
from reports.studies.bookkeeping.judging import Claim, Findings, judge
from reports.studies.bookkeeping.oracle import Cost

#: Moments of Ctrl-C in a command differ from run to run; `tests/cli/test_interrupts` chooses them.
BY_CHANCE = {"Ctrl-C in commands"}


@pytest.mark.parametrize("kind", sorted(study.KINDS.keys() - BY_CHANCE))
def test_nothing_is_false(kind):
    numbers = range(20 if kind == "readers" else 3)
    assert [study.judged(kind, 0, number)["false"] for number in numbers] == [[] for _ in numbers]


def test_no_row_of_a_sample_of_the_covering_arrays_is_false():
    """The answers are right by an own oracle, or refused as documented."""
    records = [draw() for _, _, draw in islice(study.rows(200, 0), 0, None, 5)]
    assert {r["number"]: r["false"] for r in records if r["false"]} == {}
    assert {record["rule"] for record in records} == {False, True}


@pytest.mark.parametrize("seed", range(3))
def test_every_pair_that_is_allowed_is_in_a_row(seed):
    rows = covering.rows(FACTORS, RULES, np.random.default_rng(seed))
    assert not any(rule.forbids(row) for row in rows for rule in RULES)
    met = set().union(*map(covering.pairs_of, rows))
    # What is left needs a third that is forbidden.
    left = set(covering.pairs(FACTORS, RULES)) - met
    assert len(left) < 0.01 * len(met)
    for pair in left:
        third = [
            {**dict(pair), name: level}
            for name in FACTORS.keys() - dict(pair)
            for level in FACTORS[name]
        ]
        by_name = {name: [r for r in third if name in r] for name in FACTORS.keys() - dict(pair)}
        assert any(
            all(any(rule.forbids(r) for rule in RULES) for r in of) for of in by_name.values()
        )


def test_draws_are_added_to_what_was_recorded(tmp_path, monkeypatch):
    monkeypatch.setattr(study, "KINDS", {"readers": study.KINDS["readers"]})
    monkeypatch.setattr(study, "WHOLE", study.KINDS["readers"][1])
    out = tmp_path / "records.jsonl"
    study.campaign(study.drawn(3, 0), 0, out)
    before = out.read_text()
    records = study.campaign(study.drawn(5, 0), 0, out)
    assert out.read_text().startswith(before)
    assert [json.loads(line)["number"] for line in out.read_text().splitlines()] == list(range(5))
    [row] = study.summary(records)
    assert (row["kind"], row["draws"], row["false"]) == ("readers", 5, 0)


@pytest.fixture
def posed():
    of = draw(np.random.default_rng(2), points=0.0, priors=0.0, noises=(0.05,))
    return Cost(of), (of.R, of.t)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({}, ""),
        ({"lower": 1.001}, "bound"),
        ({"upper": 0.999}, "cost"),
        ({"upper": 1.001}, "cost"),
        ({"tolerance": 1e-3}, "the tolerance is"),
    ],
)
def test_what_is_false_is_seen(posed, change, said):
    cost, start = posed
    best, where = cost.descent(start)
    claim = Claim("claim", where, best, best, 1e-6 * best, "CERTIFIED")
    changed = {name: factor * best for name, factor in change.items()}
    found = Findings()
    judge(found, cost, [replace(claim, **changed)])
    assert bool(found.false) == bool(change)
    assert all(said in what for what in found.false)


def test_a_point_that_is_not_the_best_is_not_certified(posed):
    cost, start = posed
    value = cost.value(start)
    found = Findings()
    judge(found, cost, [Claim("claim", start, value, 0.0, 1e-6 * value, "CERTIFIED")])
    assert ["is attained" in what for what in found.false] == [True]


def test_a_session_that_loses_measurements_is_seen(monkeypatch):
    def forgetful(rng, of, part):
        return whole(rng, of, part[:1] if len(part) > 1 else part)

    whole = sessions.part_of
    monkeypatch.setattr(sessions, "part_of", forgetful)
    records = [study.judged("sessions", 0, number) for number in range(6)]
    assert any("were given" in what for record in records for what in record["false"])
