"""`reports.studies.cycle_proofs`: sets run again are their records, the page is made of these."""

import json

import pytest

from reports.studies.cycle_proofs import OUT, SETS, page, row

RECORDS = json.loads(OUT.read_text())


def test_the_page_is_that_of_the_records():
    assert OUT.with_suffix(".md").read_text() == page(RECORDS)


def test_what_is_said_to_be_proven_has_bounds_that_meet():
    assert set(RECORDS) <= set(SETS)
    for of in RECORDS.values():
        assert 0.0 <= of["lower_bound"] <= of["cost"]
        assert of["proven"] == (of["cost"] - of["lower_bound"] <= 1e-6 * of["cost"])
        assert bool(of["reason"]) != of["proven"]


@pytest.mark.parametrize("name", ["cycle20_0.5_SO3", "MIT"])
def test_a_set_run_again(name, dataset_path):
    dataset_path(f"{name}.g2o")
    again, kept = row(name, 60.0), RECORDS[name]
    assert {key: again[key] for key in ("nodes", "edges", "proven", "solved")} == {
        key: kept[key] for key in ("nodes", "edges", "proven", "solved")
    }
    for key in ("ratio", "cost", "lower_bound", "residual"):
        assert again[key] == pytest.approx(kept[key], rel=1e-5)
