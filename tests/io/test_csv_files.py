"""Tables as CSV."""

import csv

from certpgo.io.csv_files import text_of, write_csv


def test_cells_are_written_in_full_and_read_again(tmp_path):
    path = tmp_path / "table.csv"
    rows = [["a,b", 0.1 + 0.2, True], [None, float("inf"), 3]]
    write_csv(path, ["name", "value", "flag"], rows)
    assert path.read_bytes() == b'name,value,flag\n"a,b",0.30000000000000004,1\n,,3\n'
    with path.open(newline="") as file:
        assert float(next(csv.DictReader(file))["value"]) == 0.1 + 0.2


def test_no_cell_is_a_formula(tmp_path):
    path = tmp_path / "table.csv"
    texts = ["=1+1", "+a", "-b.g2o", "@x", "\t=1", "-1.5", "a=b", "'c"]
    write_csv(path, ["text", "number"], [[text, -1.5] for text in texts])
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    quoted = [f"'{text}" for text in texts[:5]]
    assert [row["text"] for row in rows] == [*quoted, "-1.5", "a=b", "'c"]
    assert [text_of(row["text"]) for row in rows] == texts
    assert {row["number"] for row in rows} == {"-1.5"}
