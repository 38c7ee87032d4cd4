"""Remarks on graphs: data in a file of their own."""

import pytest

from certpgo.errors import FormatError
from certpgo.io import datasets
from certpgo.optima import Register
from certpgo.optima.remarks import FILE, StatedValue, read_remarks


def test_remarks_are_of_graphs_that_exist():
    remarks = Register().remarks
    assert remarks.keys() <= set(datasets.names("graph"))
    assert remarks["ais2klinik"].of("chordal")[0].value == "1.885e2"
    assert remarks["ais2klinik"].of("g2o") == ()


def test_what_is_read(tmp_path):
    (tmp_path / FILE).write_text(
        '[loop]\nremark = "A loop."\npublished = [{cost = "g2o", value = "1", source = "S"}]\n'
    )
    assert read_remarks(tmp_path)["loop"].published == (StatedValue("g2o", "1", "S"),)
    assert read_remarks(tmp_path / "nowhere") == {}


@pytest.mark.parametrize(
    "text",
    [
        "nothing",
        "[a]\nremarks = 1\n",
        '[a]\npublished = [{cost = "huber", value = "1", source = "S"}]\n',
        '[a]\npublished = [{cost = "g2o", value = "1"}]\n',
        "a = 1\n",
    ],
)
def test_what_cannot_be_is_refused(tmp_path, text):
    (tmp_path / FILE).write_text(text)
    with pytest.raises(FormatError, match="expected remarks by graph"):
        read_remarks(tmp_path)
