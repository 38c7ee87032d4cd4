import warnings

import pytest
from hypothesis import settings

from certpgo import datasets
from certpgo.errors import InputNotice

settings.register_profile("ci", derandomize=True, deadline=None)
settings.load_profile("ci")


@pytest.fixture
def dataset_path():
    """The local file of a dataset; skips when it is nowhere."""

    def locate(name):
        path = datasets.find(name)
        if path is None:
            pytest.skip(f"{name}: file not here")
        return path

    return locate


@pytest.fixture
def dataset(dataset_path):
    """A dataset as an Instance, read without notices; skips when its file is nowhere."""

    def load(name, **options):
        dataset_path(name)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", InputNotice)
            return datasets.load(name, download=False, **options)

    return load
