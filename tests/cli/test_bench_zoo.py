"""certpgo bench zoo: what it prints, writes and says by its exit code."""

from dataclasses import replace

import pytest

pytest.importorskip("flint", reason="python-flint is not installed")

from reports.harness.certifiers import zoo


@pytest.fixture
def small(monkeypatch):
    """A zoo of one family, made in this process; the list it returns holds the records made."""
    made_here = []

    def made(jobs, workers):
        for job in jobs:
            made_here.append(zoo.record_of(job))
            yield job, made_here[-1]

    monkeypatch.setattr(zoo, "jobs", lambda *_: [zoo.Job("no rotations: reflected, scaled")])
    monkeypatch.setattr(zoo, "_made", made)
    return made_here


def test_bench_zoo_counts_and_goes_on(certpgo, tmp_path, small):
    done = certpgo("bench", "zoo", "--quick", "--out", tmp_path)
    assert done.code == 0
    assert "se_sync_rule" in done.out
    assert "# The zoo" in (tmp_path / "zoo.md").read_text(encoding="utf-8")
    again = certpgo("bench", "zoo", "--quick", "--out", tmp_path, "--json")
    assert again.json[0]["outcomes"]["certpgo standard"]["refused"] == 20
    assert len(small) == 1


def test_something_false_of_ours_is_an_exit_code(certpgo, tmp_path, small, monkeypatch):
    honest = zoo.record_of
    monkeypatch.setattr(zoo, "record_of", lambda job: replace(honest(job), faults=["false bound"]))
    assert certpgo("bench", "zoo", "--out", tmp_path).code == 1
    assert "false bound" in (tmp_path / "zoo.md").read_text(encoding="utf-8")


def test_an_unknown_benchmark_is_named(certpgo, tmp_path):
    done = certpgo("bench", "zoos", "--out", tmp_path)
    assert done.code == 1
    assert "known: scale, speed, zoo" in done.err
