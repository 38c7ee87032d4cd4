"""certpgo diagnose: graphs and estimates that other commands refuse become findings."""

import json

import pytest


@pytest.fixture
def two_parts(square, tmp_path):
    """The square twice, with ids from 0 and from 100."""
    path, lines = tmp_path / "two.g2o", square.read_text().splitlines()
    path.write_text("\n".join([*lines, *(shifted(line, 100) for line in lines)]) + "\n")
    return path


def shifted(line, by):
    """A line of vertices or edges of g2o with other ids."""
    tag, *words = line.split()
    count = 1 if tag.startswith("VERTEX") else 2
    moved = [str(int(word) + by) for word in words[:count]]
    return " ".join([tag, *moved, *words[count:]])


def kinds(done):
    return [one["kind"] for one in done.json["findings"]]


def test_parts_are_a_finding(certpgo, two_parts):
    done = certpgo("diagnose", two_parts, "--json")
    assert done.code == 0
    assert kinds(done) == ["components"]
    assert kinds(certpgo("diagnose", two_parts, "--components", "largest", "--json")) == []
    assert "2 parts" in certpgo("diagnose", two_parts).out


def test_ids_with_an_offset_are_a_finding(certpgo, square, tmp_path):
    solved, other = tmp_path / "solved.g2o", tmp_path / "other.g2o"
    certpgo("solve", square, "-o", solved)
    lines = [line for line in solved.read_text().splitlines() if line.startswith("VERTEX")]
    other.write_text("\n".join(shifted(line, 7) for line in lines) + "\n")
    done = certpgo("diagnose", square, other, "--json")
    assert done.json["findings"][0]["next"] == "add -7 to its ids"
    assert json.loads(certpgo("diagnose", square, solved, "--json").out)["findings"] == []


def test_held_nodes_are_a_finding(certpgo, tmp_path):
    path = tmp_path / "held.g2o"
    path.write_text(
        "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nFIX 0\nFIX 1\nEDGE_SE2 0 1 1 0 0.1 1 0 0 1 0 1\n"
    )
    done = certpgo("diagnose", path, "--json")
    assert kinds(done) == ["all-held"]


def test_what_would_have_been_seen(certpgo, two_parts):
    done = certpgo("diagnose", two_parts)
    assert "would have been seen" in done.out or "no loop closure" in done.out
