"""Claims of papers, held against made-up records."""

import pytest

from certpgo.errors import SpecError
from reports.harness.experiments import claim_outcomes
from reports.harness.experiments.claim_outcomes import ClaimStatus
from reports.harness.experiments.claims import (
    Claim,
    below,
    number,
    numbers,
    together,
    unknown,
    within,
)
from reports.harness.experiments.figure import Figure
from reports.harness.experiments.records import Record
from reports.harness.experiments.spec import Column, Method, Row, Table

FASTER = below("total_seconds", "mine", "theirs")


def table(*stated, **more):
    methods = (Method("m", "mine"), Method("m", "theirs"))
    rows = tuple(Row(label) for label in "abc")
    return Table("t", "A title", rows, methods, (Column("cost", "F"),), claims=stated, **more)


def record(row, method, value=None, **more):
    metrics = {} if value is None else {"total_seconds": value}
    return Record("t", row, method, metrics=metrics, **more)


def pair(row, mine, theirs):
    return [record(row, "mine", mine), record(row, "theirs", theirs)]


def outcome(claim, records, **more):
    [found] = claim_outcomes.of_table(table(claim, **more), records)
    return found


def test_a_claim_of_each_row_holds_where_it_could_be_run():
    found = outcome(Claim("x", FASTER, each=True), [*pair("a", 1.0, 2.0), *pair("b", 2.0, 2.0)])
    assert (found.found, found.held, found.decided, found.asked) == (ClaimStatus.HOLDS, 2, 2, 3)
    assert found.in_brief == "holds in 2 of 2 rows; 1 row not run"


def test_one_row_is_enough_to_differ():
    claim = Claim("x", FASTER, each=True, remark="Ours waits")
    found = outcome(claim, [*pair("a", 1.0, 2.0), *pair("b", 3.0, 2.0)])
    assert found.found is ClaimStatus.DIFFERS
    assert found.in_full == "differs: holds in 1 of 2 rows; 1 row not run. Ours waits"


def test_nearly_all_rows_are_enough_where_the_paper_says_so():
    records = [*pair("a", 1.0, 2.0), *pair("b", 3.0, 2.0), *pair("c", 1.0, 2.0)]
    assert outcome(Claim("x", FASTER, each=True, share=0.6), records).found is ClaimStatus.HOLDS
    assert outcome(Claim("x", FASTER, each=True, share=0.7), records).found is ClaimStatus.DIFFERS


@pytest.mark.parametrize(
    "records", [[], [record("a", "mine", 1.0)], pair("a", 1.0, None), pair("b", 1.0, 3.0)]
)
def test_without_its_numbers_a_claim_is_not_run(records):
    found = outcome(Claim("x", FASTER, each=True, rows=("a",), remark="Gone"), records)
    assert found.found is ClaimStatus.NOT_RUN
    assert found.in_full == "not run. Gone"


def test_a_claim_of_the_table_sees_the_rows_it_is_about():
    def two(records):
        return {r.row for r in records} == {"a", "c"}

    records = [record(row, "mine", 1.0) for row in "abc"]
    assert outcome(Claim("x", two, rows=("a", "c")), records).in_brief == "holds"
    assert outcome(Claim("x", two), records).in_brief == "differs"


def test_claims_are_of_means_where_the_table_shows_means():
    records = [
        record("a", method, value, seed=seed)
        for method, values in (("mine", (1.0, 5.0)), ("theirs", (4.0, 4.0)))
        for seed, value in enumerate(values)
    ]
    claim = Claim("x", FASTER, each=True)
    assert outcome(claim, records, summary="mean").found is ClaimStatus.HOLDS
    # the other way about: the second instance alone would hold
    assert outcome(claim, records[::-1]).found is ClaimStatus.DIFFERS


def test_a_figures_claim_is_asked_of_its_record():
    claim = Claim("x", lambda record: record["height"] > 1)
    figure = Figure(
        "f", "t", "s", lambda quick, data: {}, lambda canvas, data: None, "", (), (claim,)
    )
    said = [
        claim_outcomes.of_figure(figure, data)[0].in_brief
        for data in ({"height": 2}, {"height": 1}, None)
    ]
    assert said == ["holds", "differs", "not run"]


def test_numbers_are_found_by_method():
    records = [record("a", "mine"), record("b", "mine", 2.0), record("c", "mine", 3.0)]
    assert number(records, "mine", "total_seconds") == 2.0
    assert numbers(records, "mine", "total_seconds") == [2.0, 3.0]
    assert number(records, "theirs", "total_seconds") is None


def test_conditions():
    records = pair("a", 1.0, 2.0)
    assert below("total_seconds", "mine", "theirs", 0.5)(records)
    assert not below("total_seconds", "mine", "theirs", 0.49)(records)
    assert below("total_seconds", "mine", "theirs", 0.25, slack=0.5)(records)
    assert within("total_seconds", "mine", 1.0, 1.0)(records)
    assert not within("total_seconds", "mine", 1.1, 2.0)(records)
    assert within("cost", "mine", 0.0, 1.0)(records) is None
    assert unknown(records) is None
    assert together(FASTER, unknown)(records)
    assert together(unknown, unknown)(records) is None
    assert not together(FASTER, within("total_seconds", "mine", 2.0, 3.0))(records)


def test_a_claim_about_no_row_is_refused():
    with pytest.raises(SpecError, match="'d'"):
        table(Claim("x", FASTER, rows=("d",)))
    with pytest.raises(SpecError, match="share"):
        Claim("x", FASTER, share=0.0)
