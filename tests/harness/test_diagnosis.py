"""A sample of `reports.studies.diagnosis`: planted mistakes are named first, and none elsewhere."""

import numpy as np
import pytest

import certpgo
from reports.studies.diagnosis.__main__ import examined
from reports.studies.diagnosis.mistakes import MISTAKES, Planted, clean

#: Others are planted by the tests of the modules that find them.
SOME = (
    "inverse poses",
    "truth of another point",
    "closures inverted",
    "information of tangents",
    "one closure copied",
    "no initial values",
)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("name", SOME)
def test_it_is_named_first(name, d):
    [mistake] = [one for one in MISTAKES if one.name == name]
    if d not in mistake.dimensions:
        return
    made = clean(d, 3)
    planted = mistake.plant(made, certpgo.solve(made).estimate, np.random.default_rng(0))
    kinds, _ = examined(planted)
    assert kinds[0] in mistake.kinds


@pytest.mark.parametrize("d", [2, 3])
def test_nothing_is_found_in_clean_maps(d):
    for seed in (11, 12):
        made = clean(d, seed)
        answer = certpgo.solve(made)
        assert not answer.fit.is_unusual
        assert examined(Planted(made, answer.estimate))[0] == ()
