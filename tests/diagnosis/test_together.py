"""Mistakes of two robots, of a truth beside a right estimate, and two mistakes at once."""

import numpy as np
import pytest

import certpgo
from certpgo.diagnosis import KnownTruth
from reports.studies.diagnosis.mistakes import MISTAKES, N, clean

NAMES = (
    "ids of two robots",
    "a right estimate, truth of another run",
    "a right estimate, truth mirrored",
    "inverse poses and a wrong closure",
    "millimetres, robust to a wrong closure",
)
BY_NAME = {mistake.name: mistake for mistake in MISTAKES}


@pytest.fixture(scope="module", params=[2, 3])
def map_of(request):
    made = clean(request.param, 5)
    return made, certpgo.solve(made).estimate


@pytest.mark.parametrize("name", NAMES)
def test_each_is_named(name, map_of):
    mistake = BY_NAME[name]
    planted = mistake.plant(*map_of, np.random.default_rng(5))
    found = certpgo.diagnose(planted.instance, planted.estimate, truth=planted.truth)
    assert mistake.is_named([one.kind for one in found.findings])


def test_ids_of_two_robots_say_where_the_second_begins(map_of):
    planted = BY_NAME["ids of two robots"].plant(*map_of, np.random.default_rng(5))
    [found, *_] = certpgo.diagnose(planted.instance).findings
    assert f"from measurement {map_of[0].graph.num_edges} on" in found.said
    assert f"add {N} to the ids" in found.next
    assert found.cost < 0.1 * found.cost_as_given


def test_right_truth_is_not_blamed(map_of):
    made, best = map_of
    known = KnownTruth(np.arange(N), made.truth)
    assert certpgo.diagnose(made, best, truth=known).findings == ()


def test_progress_names_each_mistake_that_is_tried(map_of):
    seen = []
    found = certpgo.diagnose(*map_of, progress=seen.append)
    assert len(seen) == found.tried
    assert {"stiff-edge", "noise"} <= set(seen)
