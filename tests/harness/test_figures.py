"""Figures: the contract that every one keeps, and what single ones show."""

import json
from itertools import pairwise

import numpy as np
import pytest

from certpgo import registry
from certpgo.errors import InputError, SpecError
from reports.harness.experiments import claim_outcomes, scan
from reports.harness.experiments.figure import Figure, computed, figure_bytes, publish


@pytest.fixture(scope="module")
def quick():
    """The record of a figure's quick profile, computed once; skips where files are not here."""
    records = {}

    def record_of(name):
        if name not in records:
            try:
                records[name] = computed(scan.get_figure(name), quick=True)
            except InputError as error:
                pytest.skip(str(error))
        return records[name]

    return record_of


@pytest.mark.parametrize("name", scan.figure_names())
def test_every_figure_keeps_the_contract(name, quick, tmp_path):
    figure = scan.get_figure(name)
    assert figure.name == name
    record = json.loads(json.dumps(quick(name)))  # a drawing needs no more than is kept
    assert "{" not in figure.captioned(record)
    path = publish(figure, record, tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == [f"{name}.json", f"{name}.svg"]
    kept = json.loads(path.with_suffix(".json").read_text())
    assert kept["data"] == record
    assert kept["provenance"]["versions"]
    drawing = path.read_bytes()
    assert drawing.startswith(b"<?xml")
    assert len(drawing) < 400_000
    assert all(
        o.found is not claim_outcomes.ClaimStatus.NOT_RUN
        for o in claim_outcomes.of_figure(figure, record)
    )


@pytest.mark.parametrize("name", scan.figure_names())
def test_every_committed_claim_that_differs_is_remarked_upon(name):
    path = registry.repository() / "reports" / "results" / f"{name}.json"
    if not path.is_file():
        pytest.skip(f"{name} was not made here")
    outcomes = claim_outcomes.of_figure(scan.get_figure(name), json.loads(path.read_text())["data"])
    assert all(outcome.claim.source for outcome in outcomes)
    differing = [o for o in outcomes if o.found is claim_outcomes.ClaimStatus.DIFFERS]
    assert [o.claim.text for o in differing if not o.claim.remark] == []


@pytest.fixture
def bar():
    """A figure of one bar."""

    def draw(canvas, record):
        canvas.add_subplot().bar([0], [record["height"]])

    return Figure("bar", "A bar", "nobody", lambda quick, data: {"height": 2}, draw, "{height} m")


def test_a_figure_is_drawn_from_its_record_alone(bar):
    record = computed(bar)
    assert bar.captioned(record) == "2 m"
    assert figure_bytes(bar, record) == figure_bytes(bar, record)
    assert figure_bytes(bar, record) != figure_bytes(bar, {"height": 3})


def test_a_drawing_is_a_function_of_what_is_kept(quick):
    figure, record = scan.get_figure("gallery_spectra"), quick("gallery_spectra")
    drawing = figure_bytes(figure, record)
    assert figure_bytes(figure, json.loads(json.dumps(record))) == drawing


def test_a_figure_ignores_the_reader_s_own_matplotlib_settings(bar):
    import matplotlib as mpl

    before = figure_bytes(bar, {"height": 2})
    with mpl.rc_context({"font.size": 20, "axes.facecolor": "red"}):
        assert figure_bytes(bar, {"height": 2}) == before
        assert mpl.rcParams["font.size"] == 20


def test_numbers_that_are_not_finite_are_null_in_a_record():
    spec = Figure("f", "", "", lambda quick, data: {"x": [float("nan"), 1.5]}, print, "")
    assert computed(spec) == {"x": [None, 1.5]}


def test_a_folder_that_cannot_be_written_to_is_one_line(bar, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot write there"):
        publish(bar, {"height": 2}, tmp_path / "file")


def test_names_are_completed_over_tables_and_figures():
    assert scan.get_experiment("eriksson2018-figure1").name == "eriksson2018_figure1"
    assert scan.get_experiment("eriksson2018-table1").name == "eriksson2018_table1"
    with pytest.raises(
        SpecError, match="did you mean eriksson2018_figure2 or eriksson2018_figure1"
    ):
        scan.get_experiment("eriksson2018-figure")
    with pytest.raises(SpecError, match="unknown figure"):
        scan.get_figure("eriksson2018-table1")


def test_figure_1_of_eriksson_shows_three_minima_of_which_the_lowest_is_certified(quick):
    minima = quick("eriksson2018_figure1")["minima"]
    assert [m["verdict"] for m in minima] == ["CERTIFIED", "REFUTED", "REFUTED"]
    costs = [m["cost"] for m in minima]
    assert costs == sorted(costs)
    assert costs[1] > 2 * costs[0]


def test_a_figure_whose_file_is_nowhere_says_which(monkeypatch, tmp_path):
    monkeypatch.setenv("CERTPGO_DATA", str(tmp_path))
    monkeypatch.setattr("certpgo.io.datasets.lookup.cache_folder", lambda: tmp_path)
    with pytest.raises(InputError, match=r"file not here \(Ellis_Island\)"):
        computed(scan.get_figure("moreira2020_figure4_4"))


def test_descent_ends_near_the_truth_whatever_the_start(quick):
    record = quick("moreira2020_figure2_3")
    assert record["mean_errors_deg"][0] > 60.0
    assert record["last_mean_error_deg"] < 5.0


def test_without_noise_the_smallest_eigenvalue_is_zero_and_then_it_rises(quick):
    record = quick("moreira2020_figure3_1")
    for graph in record["graphs"]:
        assert graph["means"][0] == pytest.approx(0.0, abs=1e-9)
        low = graph["means"][: record["sigma_deg"].index(50)]
        assert low == sorted(low)


def test_bounds_and_costs_stand_in_their_order(quick):
    record = quick("moreira2020_figure5_1")
    ladder = ("spectral_bound", "proven_bound", "optimum", "refined", "eigen_ra")
    for rungs in zip(*(record[key] for key in ladder), strict=True):
        for lower, upper in pairwise(rungs):
            assert lower <= upper * (1.0 + 1e-9) + 1e-9


def test_errors_vanish_without_noise_and_are_larger_on_sparser_graphs(quick):
    record = quick("moreira2020_figure5_2")
    for curve in (*record["graphs"], *record["curves"].values()):
        assert curve["rmse_deg"][0] < 1e-4
    errors = [graph["rmse_deg"][-1] for graph in record["graphs"]]
    assert errors == sorted(errors, reverse=True)


def test_eigen_rao_s_iterates_are_its_answers(quick, dataset):
    from certpgo import Quadratic
    from certpgo.io.datasets import truth
    from certpgo.optimize.methods.eigen_ra import EigenRA
    from certpgo.optimize.methods.eigen_rao import EigenRAO
    from certpgo.solve import metrics

    record = quick("moreira2020_figure5_3")
    instance = dataset("Ellis_Island")
    nodes, known = truth("Ellis_Island", instance)
    problem = Quadratic(instance.graph).with_unit_weights()
    # EigenRAO asks for less exact eigenvectors than EigenRA.
    for k, method, rel in (
        (0, EigenRA(weights="unit"), 1e-2),
        (3, EigenRAO(max_iterations=3), 1e-9),
    ):
        answer = method.solve(problem).estimate.subset(nodes)
        error = metrics.angular_errors(answer, known).median_deg
        assert record["errors_deg"]["median_deg"][k] == pytest.approx(error, rel=rel)


def test_angles_of_langevin_samples_are_distributed_as_the_formula_says(quick):
    record = quick("moreira2020_figureA_1")
    assert record["largest_distance"] < record["critical"]


@pytest.mark.parametrize("k", [0.0, 0.7, 20.0])
def test_the_mean_trace_of_langevin_s_distribution_is_its_integral(k):
    from scipy.integrate import quad

    scan.get_figure("moreira2020_figureA_2")
    from certpgo_figures.moreira2020_figureA_2 import mean_trace

    def weight(t):
        return (1.0 - np.cos(t)) * np.exp(2.0 * k * (np.cos(t) - 1.0))

    total = quad(weight, 0.0, np.pi)[0]
    expected = quad(lambda t: (1.0 + 2.0 * np.cos(t)) * weight(t), 0.0, np.pi)[0] / total
    assert mean_trace(k) == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_means_of_rotations_are_as_good_as_the_fisher_information_allows(quick):
    record = quick("moreira2020_figureA_2")
    for curve in record["curves"]:
        assert curve["last_ratio"] == pytest.approx(1.0, abs=0.35)  # of 20 repetitions


def test_the_printed_likelihoods_of_garage(quick):
    # Moreira 2020, Table 5.7.
    assert quick("moreira2020_figureC_1")["sets"][0]["f_ml"] == pytest.approx(18824.3, abs=0.05)
    refined = quick("moreira2020_figureC_2")["sets"][0]["refined_f_ml"]
    assert refined == pytest.approx(18824.4, abs=0.05)


def test_eigen_ma_is_nearer_to_the_path_than_eig_se3_at_the_thesis_noise(quick):
    panels = quick("moreira2020_figureC_4")["panels"]
    for panel in panels[:4]:
        assert panel["eigen_ma_rmse"] < panel["eig_se3_rmse"]
    growing = [panel["eigen_ma_rmse"] for panel in panels]
    assert growing[0] < growing[3] < growing[4] < growing[5]


def test_times_are_positive_and_every_method_is_named(quick):
    record = quick("scaling")
    assert len({method["label"] for method in record["methods"]}) == len(record["methods"]) >= 9
    for method in record["methods"]:
        assert method["stopped"] or len(method["seconds"]) == len(record["sizes"])
        assert all(seconds > 0.0 for seconds in method["seconds"])
