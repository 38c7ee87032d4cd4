"""The gate on made-up records: every kind of movement, its direction and amount."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from certpgo import registry
from certpgo.errors import FormatError, InputError
from reports.harness.experiments import metrics, regression, scan
from reports.harness.experiments.absence import Absence
from reports.harness.experiments.journal import to_line
from reports.harness.experiments.records import Record
from reports.harness.experiments.zoo_records import ZooRecord

COMMITTED = Record(
    "t",
    "row",
    "method",
    solver="newton",
    settings={"tol": 1e-9},
    d=3,
    n=10,
    m=20,
    metrics={
        "cost": 100.0,
        "f_ml": 50.0,
        "lower_bound": 99.999,
        "gap": 1e-3,
        "relative_gap": 1e-5,
        "lambda1": 1e-7,
        "rmse_deg": 2.0,
        "kept_percent": 90.0,
        "ratio": 3.0,
        "total_seconds": 1.0,
    },
    verdict="CERTIFIED",
    certified_by="Theorem 4.1, factorization",
    status="converged",
    iterations=10,
    counts={"factorizations": 4, "products": 100, "starts": 1},
    provenance={"engine": "multifrontal"},
)
KEY = regression.Key("full", "t", "row", "", "method", None)


def compared(after, before=COMMITTED, **options):
    return regression.compare_records({KEY: after}, {KEY: before}, **options)


def moves(after, before=COMMITTED, **options):
    return {m.metric: m.direction for m in compared(after, before, **options).movements}


def with_metric(name, value, record=COMMITTED):
    return replace(record, metrics={**record.metrics, name: value})


def with_count(name, value, record=COMMITTED):
    return replace(record, counts={**record.counts, name: value})


def test_the_same_record_moves_nothing():
    found = compared(COMMITTED)
    assert (found.compared, found.movements, found.holds(complete=True)) == (1, (), True)


@pytest.mark.parametrize(
    ("metric", "factor", "direction"),
    [
        ("cost", 1.0 + 2e-6, "worse"),
        ("cost", 1.0 - 2e-6, "better"),
        ("f_ml", 1.0 - 2e-6, "worse"),
        ("f_ml", 1.0 + 2e-6, "better"),
        ("lower_bound", 1.0 - 2e-6, "worse"),
        ("lower_bound", 1.0 + 2e-6, "better"),
        ("gap", 1.2, "worse"),
        ("relative_gap", 0.5, "better"),
        ("lambda1", 1.001, "different"),
        ("lambda1", 0.999, "different"),
        ("rmse_deg", 1.001, "worse"),
        ("rmse_deg", 0.999, "better"),
        ("kept_percent", 1.001, "different"),
        ("ratio", 1.6, "worse"),
        ("ratio", 0.6, "better"),
    ],
)
def test_a_metric_beyond_its_tolerance_moves(metric, factor, direction):
    value = COMMITTED.metrics[metric] * factor
    found = compared(with_metric(metric, value))
    [move] = found.movements
    assert (move.metric, move.direction) == (metric, direction)
    assert (move.before, move.after) == (COMMITTED.metrics[metric], value)
    assert move.change == pytest.approx(factor - 1.0)
    assert found.holds() == (direction == "better")


@pytest.mark.parametrize(
    ("metric", "factor"),
    [
        ("cost", 1.0 + 5e-7),
        ("lambda1", 1.0 - 5e-7),
        ("rmse_deg", 1.0 + 5e-5),
        ("gap", 1.05),  # within 1e-6 of F
        ("relative_gap", 1.05),
        ("ratio", 1.45),
        ("ratio", 0.7),
        ("total_seconds", 100.0),
    ],
)
def test_a_metric_within_its_tolerance_stays(metric, factor):
    assert moves(with_metric(metric, COMMITTED.metrics[metric] * factor)) == {}


def test_costs_that_are_zero_to_rounding_are_equal():
    zero = replace(COMMITTED, metrics={"cost": 1e-25, "error": -1e-18})
    other = replace(COMMITTED, metrics={"cost": 3e-24, "error": 1e-17})
    assert moves(other, zero) == {}
    assert moves(replace(other, metrics={"cost": 1e-9, "error": 0.0}), zero) == {"cost": "worse"}


def test_ratios_of_times_move_by_the_factor_that_is_asked_for():
    slower = with_metric("ratio", 4.0)
    assert moves(slower) == {}
    assert moves(slower, times=1.2) == {"ratio": "worse"}


@pytest.mark.parametrize(
    ("name", "value", "direction"),
    [
        ("factorizations", 5, "worse"),
        ("factorizations", 3, "better"),
        ("products", 106, "worse"),
        ("products", 94, "better"),
        ("starts", 2, "different"),
        ("inverses", 1, "different"),
    ],
)
def test_counts_are_compared_tightly(name, value, direction):
    assert moves(with_count(name, value)) == {name: direction}


def test_long_counts_may_move_by_one_in_twenty():
    assert moves(with_count("products", 105)) == {}
    assert moves(with_count("products", 95)) == {}


def test_iterations_are_a_count():
    assert moves(replace(COMMITTED, iterations=11)) == {"iterations": "worse"}
    assert moves(replace(COMMITTED, iterations=None)) == {}  # of an older record


def test_another_engine_may_take_one_step_more_and_fills_in_as_it_likes():
    before = with_count("nonzeros", 1000)
    other = replace(
        with_count("nonzeros", 5000, with_metric("ratio", 30.0)),
        iterations=11,
        provenance={"engine": "superlu"},
    )
    found = compared(other, before)
    assert (found.movements, found.other_engine) == ((), 1)
    assert moves(replace(other, iterations=12), before) == {"iterations": "worse"}
    assert moves(with_count("nonzeros", 5000), before) == {"nonzeros": "worse"}


@pytest.mark.parametrize(
    ("before", "after", "direction"),
    [
        ("CERTIFIED", "BOUNDED", "worse"),
        ("CERTIFIED", "UNDECIDED", "worse"),
        ("CERTIFIED", "REFUTED", "worse"),
        ("CERTIFIED", "", "worse"),
        ("BOUNDED", "UNDECIDED", "worse"),
        ("BOUNDED", "CERTIFIED", "better"),
        ("UNDECIDED", "BOUNDED", "better"),
        ("REFUTED", "CERTIFIED", "better"),
        ("BOUNDED", "REFUTED", "noted"),
        ("UNDECIDED", "REFUTED", "noted"),
        ("REFUTED", "BOUNDED", "noted"),
    ],
)
def test_a_verdict_is_never_worse_and_a_refutation_is_noted(before, after, direction):
    found = compared(replace(COMMITTED, verdict=after), replace(COMMITTED, verdict=before))
    [move] = found.movements
    assert (move.metric, move.direction, move.change) == ("verdict", direction, None)
    assert found.holds() == (direction in ("better", "noted"))


@pytest.mark.parametrize(
    ("change", "direction"),
    [
        ({"certified_by": "factorization"}, "worse"),
        ({"certified_by": "none"}, "worse"),
        ({"certified_by": "rows, Theorem 4.1, factorization"}, "better"),
        ({"certified_by": "rows, factorization"}, "worse"),
        ({"status": "iteration limit"}, "worse"),
        ({"settings": {"tol": 1e-6}}, "different"),
        ({"n": 11}, "different"),
    ],
)
def test_other_fields_move_too(change, direction):
    [name] = change
    assert moves(replace(COMMITTED, **change)) == {name: direction}


def test_values_of_another_problem_are_not_compared():
    other = replace(with_metric("cost", 1.0), n=11, m=30)
    assert moves(other) == {"n": "different", "m": "different"}


def test_an_answer_where_there_was_an_error_is_better_and_another_error_is_noted():
    failed = replace(COMMITTED, absence=Absence.FAILED, error="it broke", metrics={})
    assert moves(COMMITTED, failed) == {"error": "better"}
    assert moves(failed) == {"error": "worse"}
    assert moves(replace(failed, error="it broke elsewhere"), failed) == {"error": "noted"}
    assert moves(failed, failed) == {}


def test_a_metric_that_is_gone_fails_and_a_new_one_is_noted():
    without = replace(COMMITTED, metrics={**COMMITTED.metrics, "lower_bound": None})
    assert moves(without) == {"lower_bound": "different"}
    assert moves(COMMITTED, without) == {"lower_bound": "noted"}


def test_a_cost_below_a_proven_bound_fails_though_it_is_lower():
    loose = {"metrics": {"cost": 100.0, "lower_bound": 99.0}}
    low = {"metrics": {"cost": 98.0, "lower_bound": 97.0}}
    found = moves(replace(COMMITTED, **low), replace(COMMITTED, **loose))
    assert found["cost"] == "better"
    assert found["cost below the committed bound"] == "worse"
    back = moves(replace(COMMITTED, **loose), replace(COMMITTED, **low))
    assert back["bound above the committed cost"] == "worse"


def test_records_on_one_side_alone_are_named_and_fail_only_a_complete_gate():
    other, third = KEY._replace(row="other"), KEY._replace(row="third")
    found = regression.compare_records(
        {KEY: COMMITTED, other: COMMITTED}, {KEY: COMMITTED, third: COMMITTED}
    )
    assert (list(found.missing), found.added) == ([third], (other,))
    assert found.holds()
    assert not found.holds(complete=True)


def test_a_row_that_was_not_run_is_missing_with_its_reason():
    absent = replace(COMMITTED, absence=Absence.NOT_HERE, error="file not here", metrics={})
    found = compared(absent)
    assert (found.compared, found.missing) == (0, {KEY: "not run: file not here"})
    assert compared(COMMITTED, absent).added == (KEY,)
    both = compared(absent, absent)
    assert (both.compared, both.missing, both.added) == (0, {}, ())
    package = replace(absent, absence=Absence.MISSING_PACKAGE, error="pip install gtsam")
    assert list(compared(package).missing) == [KEY]


def test_tables_without_a_new_record_are_named_within_the_profile():
    elsewhere = KEY._replace(table="u")
    quick = KEY._replace(table="v", profile="quick")
    committed = {KEY: COMMITTED, elsewhere: COMMITTED, quick: COMMITTED}
    found = regression.compare_records({KEY: COMMITTED}, committed)
    assert (found.untouched, found.missing) == (("u",), {})
    assert not found.holds(complete=True)


@given(st.floats(-1e-2, 1e-2), st.sampled_from(sorted(COMMITTED.metrics)))
def test_what_is_worse_one_way_is_better_the_other(change, metric):
    after = with_metric(metric, COMMITTED.metrics[metric] * (1.0 + change))
    there, back = compared(after), compared(COMMITTED, after)
    opposite = {"worse": "better", "better": "worse", "different": "different"}
    found = [m for m in there.movements if m.metric == metric]
    # Beside the tolerance, which is relative to what is committed, both ways agree.
    if abs(abs(change) - metrics.SAME) > 1e-8 and abs(abs(change) - metrics.SAME_ANGLE) > 1e-7:
        assert [opposite[m.direction] for m in found] == [
            m.direction for m in back.movements if m.metric == metric
        ]


ZOO = ZooRecord(
    family="wound-up cycles",
    points={"all": 54, "closed form": 54},
    outcomes={
        "certpgo standard": {"certified": 30, "not certified": 24, "missed": 2},
        "gtsam_shonan": {"certified": 40, "false": 40},
    },
    provenance={"engine": "multifrontal"},
)


def with_outcome(certifier, **counts):
    counts = {name.replace("_", " "): count for name, count in counts.items()}
    return replace(ZOO, outcomes={**ZOO.outcomes, certifier: {**ZOO.of(certifier), **counts}})


@pytest.mark.parametrize(
    ("after", "expected"),
    [
        (ZOO, {}),
        (with_outcome("certpgo standard", false=1), {"certpgo standard: false": "worse"}),
        (with_outcome("certpgo standard", failed=1), {"certpgo standard: failed": "worse"}),
        (with_outcome("certpgo standard", missed=3), {"certpgo standard: missed": "worse"}),
        (with_outcome("certpgo standard", missed=1), {"certpgo standard: missed": "better"}),
        (with_outcome("certpgo standard", certified=29), {"certpgo standard: certified": "noted"}),
        (with_outcome("gtsam_shonan", false=43), {"gtsam_shonan: false": "different"}),
        (with_outcome("gtsam_shonan", false=42), {}),  # within one in twenty
        (replace(ZOO, faults=["n=5: certpgo standard: false"]), {"faults": "worse"}),
        (replace(ZOO, points={"all": 53}), {"points": "different"}),
        (replace(ZOO, instances={"all": 50}), {"instances": "different"}),
        (with_outcome("cora_rule", certified=1), {"cora_rule": "noted"}),
        (with_outcome("gtsam_shonan", not_installed=54), {"gtsam_shonan": "noted"}),
        (
            replace(ZOO, outcomes={"gtsam_shonan": ZOO.of("gtsam_shonan")}),
            {"certpgo standard": "different"},
        ),
    ],
)
def test_the_zoo_is_compared(after, expected):
    key = regression.Key("full", "zoo", ZOO.family, "", "every certifier", None)
    found = regression.compare_records({key: after}, {key: ZOO})
    assert {move.metric: move.direction for move in found.movements} == expected
    assert found.holds() == (not set(expected.values()) & {"worse", "different"})


def test_another_engine_may_miss_one_point_more_but_is_never_false():
    key = regression.Key("full", "zoo", ZOO.family, "", "every certifier", None)

    def moved(**counts):
        after = replace(
            with_outcome("certpgo standard", **counts), provenance={"engine": "superlu"}
        )
        return regression.compare_records({key: after}, {key: ZOO}).failures

    assert moved(missed=3) == ()
    assert moved(missed=4)
    assert moved(false=1)


def test_zoo_records_without_points_are_left_out(tmp_path):
    path = write(tmp_path / "zoo.jsonl", replace(ZOO, points={}, outcomes={}))
    committed = write(tmp_path / "committed" / "zoo.jsonl", ZOO)
    found = regression.compare_records(*map(regression.load_records, (path, committed)))
    assert (found.compared, list(found.missing.values())) == (0, ["not run: its file is not here"])


def test_the_committed_zoo_is_compared_with_the_rest():
    results = registry.repository() / "reports" / "results"
    committed = regression.load_records(results)
    alone = regression.load_records(results / "zoo.jsonl")
    assert len(alone) > 200
    assert {key for key in committed if key.table == "zoo"} == set(alone)
    found = regression.compare_records(alone, committed)
    assert (found.compared, found.movements) == (len(alone), ())


def write(path, *records):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("".join(to_line(record) + "\n" for record in records))
    return path


def test_the_last_record_of_a_key_counts(tmp_path):
    path = write(tmp_path / "t.jsonl", COMMITTED, with_metric("cost", 7.0))
    [record] = regression.load_records(path).values()
    assert record.metrics["cost"] == 7.0


def test_quick_records_are_never_compared_with_full_ones(tmp_path):
    write(tmp_path / "a" / "t.jsonl", COMMITTED)
    quick = replace(with_metric("cost", 7.0), profile="quick")
    write(tmp_path / "a" / "quick" / "t.jsonl", quick)
    both = regression.load_records(tmp_path / "a")
    assert [(key.profile, r.metrics["cost"]) for key, r in both.items()] == [
        ("full", 100.0),
        ("quick", 7.0),
    ]
    quick = regression.load_records(tmp_path / "a" / "quick")
    assert [key.profile for key in quick] == ["quick"]
    assert regression.load_records(tmp_path / "a" / "quick" / "t.jsonl") == quick
    full = regression.load_records(tmp_path / "a" / "t.jsonl")
    assert regression.compare_records(quick, full).compared == 0


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (b'{"table": "t"}\n{}\n', r"t\.jsonl:1: a record, one JSON object a line"),
        (b'{"table": "t", "row": "r", "method": "m", "metrics": [1]}\n', "must be numbers"),
        (
            b'{"table": "t", "row": "r", "method": "m", "metrics": {"cost": "low"}}\n',
            r"t\.jsonl: metrics and counts must be numbers \(r, m\)",
        ),
        (b'{"table": "t", "row": "r", "method": "m", "counts": {"a": {}}}\n', "must be numbers"),
        (b"\xff\xfe\n", "UTF-8"),
    ],
)
def test_a_malformed_file_is_one_clear_line(tmp_path, text, said):
    path = tmp_path / "t.jsonl"
    path.write_bytes(text)
    with pytest.raises(FormatError, match=said):
        regression.load_records(path)


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ('"outcomes": []', "a record, one JSON object a line"),
        ('"points": {"all": "many"}', r"must be numbers \(f, every certifier\)"),
    ],
)
def test_a_malformed_zoo_is_one_clear_line(tmp_path, fields, said):
    path = tmp_path / "zoo.jsonl"
    path.write_text(f'{{"family": "f", {fields}}}\n\n')
    with pytest.raises(FormatError, match=said):
        regression.load_records(path)


def test_a_place_without_records_is_refused(tmp_path):
    with pytest.raises(InputError, match="no records"):
        regression.load_records(tmp_path)
    with pytest.raises(InputError, match="no such file or folder"):
        regression.load_records(tmp_path / "nowhere")


def test_the_fixed_tables_have_committed_quick_records():
    assert set(regression.FIXED) <= set(scan.table_names())
    committed = regression.load_records(registry.repository() / "reports" / "results")
    quick = {key.table for key in committed if key.profile == "quick"}
    assert quick >= set(regression.FIXED)
    assert not any(scan.get_table(name).reference for name in regression.FIXED)


def test_the_fixed_set_agrees_with_what_is_committed():
    new, refused = regression.run_quick(("eriksson2018_table1",))
    assert refused == {}
    found = regression.compare_records(
        new, regression.load_records(registry.repository() / "reports" / "results")
    )
    assert found.compared + len(found.missing) == len(new)
    assert found.compared
    assert found.failures == ()
