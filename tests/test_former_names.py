"""Modules can be imported by their former names, with a warning."""

import importlib
import sys

import pytest

import certpgo
from certpgo import _former_names
from certpgo._former_names import name_today
from certpgo.io import datasets
from certpgo.io.datasets import synthetic
from certpgo.objective import choose_cost
from certpgo.objective.information_problem import InformationProblem


@pytest.fixture
def afresh():
    """No module was imported by a former name yet."""
    for name in list(sys.modules):
        if name.startswith("certpgo.") and name_today(name.removeprefix("certpgo.")):
            del sys.modules[name]


@pytest.mark.usefixtures("afresh")
def test_a_former_name_is_deprecated_and_gives_the_same():
    with pytest.warns(DeprecationWarning, match=r"datasets(.synthetic)? is now certpgo"):
        from certpgo.datasets.synthetic import helix
    from certpgo.datasets import Entry, load

    assert (helix, load, Entry) == (synthetic.helix, datasets.load, datasets.Entry)


@pytest.mark.usefixtures("afresh")
@pytest.mark.parametrize("former", [*_former_names._ROOMS, *_former_names._MODULES])
def test_every_former_name_is_of_a_module(former):
    with pytest.warns(DeprecationWarning, match="is now"):
        old = importlib.import_module(f"certpgo.{former}")
    new = importlib.import_module(f"certpgo.{name_today(former)}")
    public = [name for name in dir(new) if not name.startswith("_")]
    assert all(getattr(old, name) is getattr(new, name) for name in public)


@pytest.mark.usefixtures("afresh")
def test_former_rooms_are_attributes_with_their_modules():
    """As they were after `import certpgo` alone."""
    certpgo.__dict__.pop("costs", None)
    with pytest.warns(DeprecationWarning, match=r"certpgo.costs is now"):
        assert certpgo.costs.own_cost is choose_cost.own_cost
    with pytest.warns(DeprecationWarning, match=r"costs.problem is now"):
        assert certpgo.costs.problem.InformationProblem is InformationProblem


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_other_names_are_not_touched():
    assert name_today("graph.trees") is None
    assert not hasattr(certpgo, "nothing")
    assert not hasattr(importlib.import_module("certpgo.costs"), "nothing")
    with pytest.raises(ModuleNotFoundError):
        importlib.import_module("certpgo.solvers.nothing")
