"""Errors: what they advise to install works in the situation where it is said."""

import pickle
import platform
import sys
from importlib import metadata

import pytest

from certpgo import errors
from certpgo.errors import MissingDependency, how_to_install

REQUIRES = [
    "numpy<3,>=2.0",
    'viser<2,>=1.0; extra == "view"',
    'trimesh<6,>=4.5; extra == "view"',
    'certpgo[pages,plots]; extra == "reports"',
    'pooch<2,>=1.8; extra == "reports"',
    'dask[distributed]>=2024.8; extra == "test"',
    f'gtsam<4.4,>=4.3; sys_platform != "{sys.platform}" and extra == "baselines"',
    f'pyceres<3,>=2.6; platform_machine != "{platform.machine()}" and extra == "baselines"',
]


@pytest.mark.parametrize(
    ("extra", "package", "expected"),
    [
        ("view", "", "pip install 'viser<2,>=1.0' 'trimesh<6,>=4.5'"),
        ("view", "viser", "pip install 'viser<2,>=1.0'"),
        ("reports", "", "pip install 'pooch<2,>=1.8'"),
        ("test", "dask", "pip install 'dask[distributed]>=2024.8'"),
        ("baselines", "", f"there is no wheel of gtsam for {sys.platform}"),
        ("baselines", "pyceres", f"there is no wheel of pyceres for {platform.machine()}"),
        ("", "ray", "pip install ray"),
    ],
)
def test_packages_are_named_and_not_certpgo(extra, package, expected, monkeypatch):
    monkeypatch.setattr(metadata, "requires", lambda name: REQUIRES)
    assert how_to_install(extra, package) == expected
    assert (
        str(MissingDependency("it", extra, package=package)) == f"it is not installed: {expected}"
    )


def test_a_remedy_stands_for_the_command():
    error = MissingDependency("the engine", remedy="build it")
    assert str(error) == "the engine is not installed: build it"


def test_errors_are_the_same_in_another_process():
    given = [
        errors.FormatError("a.g2o", 3, "numbers expected"),
        errors.NoEdges("a.g2o", None, "measurements expected", {"vertex{s}": 3}),
        errors.GraphError("apart", component_sizes=(3, 2)),
        errors.MissingDependency("GTSAM", "baselines", package="gtsam"),
        errors.UnusableFile("method.py", ValueError("broken")),
        errors.SpecError.unknown("method", "newtons", ["newton"]),
        errors.NumericalError("no bound"),
    ]
    for error in given:
        error.add_note("of item 3")
        there = pickle.loads(pickle.dumps(error))
        assert type(there) is type(error)
        assert str(there) == str(error)
        assert vars(there) == vars(error)


@pytest.mark.parametrize("extra", ["pages", "plots", "view", "rgbd", "mesh", "downloads", "ros"])
def test_each_extra_of_a_message_is_one_of_the_package(extra):
    # Those of the installed metadata: none of them names certpgo.
    assert "certpgo" not in how_to_install(extra)
