"""Tables as CSV."""

import csv

from certpgo.io.csv_files import write_csv


def test_cells_are_written_in_full_and_read_again(tmp_path):
    path = tmp_path / "table.csv"
    rows = [["a,b", 0.1 + 0.2, True], [None, float("inf"), 3]]
    write_csv(path, ["name", "value", "flag"], rows)
    assert path.read_bytes() == b'name,value,flag\n"a,b",0.30000000000000004,1\n,,3\n'
    with path.open(newline="") as file:
        assert float(next(csv.DictReader(file))["value"]) == 0.1 + 0.2
