"""What the gallery's pictures show is so, in the quick profile and as committed."""

import json
import re
from itertools import pairwise

import pytest

from certpgo import registry
from certpgo.errors import InputError
from reports.harness.experiments import scan
from reports.harness.experiments.figure import computed, read_figure

RESULTS = registry.repository() / "reports" / "results"
GALLERY = tuple(name for name in scan.figure_names() if name.startswith("gallery_"))


@pytest.fixture(params=["quick", "committed"])
def record(request):
    """The data of a figure's record; skips where files are not here."""

    def record_of(name):
        figure = scan.get_figure(name)
        if request.param == "quick":
            try:
                return computed(figure, quick=True)
            except InputError as error:
                pytest.skip(str(error))
        kept = read_figure(figure, RESULTS)
        assert kept is not None
        return kept["data"]

    return record_of


def test_the_page_shows_every_picture_and_its_command():
    page = (registry.repository() / "docs" / "gallery.md").read_text()
    shown = re.findall(r"\.\./reports/results/(\w+)\.svg", page)
    made = re.findall(r"certpgo reproduce ([\w-]+) --out reports/results", page)
    assert sorted(shown) == sorted(GALLERY)
    assert [name.replace("-", "_") for name in made] == shown


@pytest.mark.parametrize("name", GALLERY)
def test_pictures_are_small_and_timed_where_they_show_seconds(name):
    assert (RESULTS / f"{name}.svg").stat().st_size < 400_000
    text = (RESULTS / f"{name}.json").read_text()
    assert scan.get_figure(name).timed == ('"seconds"' in json.dumps(json.loads(text)["data"]))


def test_certified_optima_cost_far_less_than_what_they_begin_with(record):
    for entry in record("gallery_trajectories")["sets"]:
        assert entry["verdict"] == "CERTIFIED"
        assert entry["lower_bound"] <= entry["cost"] < 0.01 * entry["cost_before"]


def test_maps_of_unknown_scale_are_nearer_and_their_bound_holds(record):
    shown = record("gallery_scale_drift")
    assert shown["verdict"] == {"poses": "CERTIFIED", "similarities": "CERTIFIED"}
    off = shown["error"]
    assert off["logarithms"] < off["similarities"] < off["poses"] < off["odometry"]
    assert 0.5 * shown["cost"] < shown["lower_bound"] <= shown["cost"]


def test_only_the_optimum_has_no_negative_eigenvalue(record):
    points = record("gallery_spectra")["points"]
    optimum, wound_up, moved = (points[key] for key in ("optimum", "wound_up", "moved"))
    assert optimum["eigenvalues"][:3] == pytest.approx([0.0] * 3, abs=1e-9)
    assert optimum["eigenvalues"][3] > 1e-3
    assert optimum["bound"] == pytest.approx(optimum["cost"], rel=1e-6)
    assert max(wound_up["eigenvalues"][:2]) < -1e-3
    assert wound_up["eigenvalues"][2:5] == pytest.approx([0.0] * 3, abs=1e-9)
    assert wound_up["stationarity_deg"] < 1e-6
    assert wound_up["cost"] > 2.0 * optimum["cost"]
    assert moved["eigenvalues"][0] < -1e-3
    assert moved["stationarity_deg"] > 0.1
    for point in points.values():
        assert point["bound"] <= optimum["cost"] * (1.0 + 1e-9)


def test_bounds_rise_from_rung_to_rung_and_never_above_the_cost(record):
    for graph in record("gallery_bounds")["graphs"]:
        assert graph["verdict"] == "CERTIFIED"
        assert graph["rungs"][-1]["key"] == "proven"
        values = [rung["value"] for rung in graph["rungs"]]
        assert all(low <= high * (1.0 + 1e-9) for low, high in pairwise(values))
        assert values[-1] <= graph["cost"] * (1.0 + 1e-9)
        assert graph["rungs"][0]["open"] > 1e-2 > 1e-6 > graph["rungs"][-1]["open"]


def test_no_method_is_ever_below_the_lower_bound(record):
    shown = record("gallery_convergence")
    assert [method["label"] for method in shown["methods"] if method["failed"]] == []
    starts = [method["gaps"][0] for method in shown["methods"]]
    assert max(starts) == pytest.approx(starts[0])  # none starts above the tree
    for method in shown["methods"]:
        assert min(method["gaps"]) > -1e-9 * shown["cost"]
        assert method["seconds"] == sorted(method["seconds"])
    newton = shown["methods"][0]
    assert newton["gaps"][-1] < shown["tolerance"]


def test_none_of_our_certificates_is_false_and_others_are(record):
    shown = record("gallery_zoo")
    ours = [c for name, c in shown["certifiers"].items() if name.startswith("certpgo")]
    assert len(ours) == 3
    assert shown["ours_false"] == 0
    assert shown["ours_certified"] == sum(g["certified"] for c in ours for g in c.values())
    others = [c for name, c in shown["certifiers"].items() if not name.startswith("certpgo")]
    assert all(c["named"]["false"] > 0 for c in others)
    for family in shown["families"].values():
        assert any(outcome["false"] for outcome in family.values())
