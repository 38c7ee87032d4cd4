"""certpgo bench speed: what it prints, writes and says by its exit code."""

from contextlib import contextmanager

import pytest

from reports.harness.speed import bench
from reports.harness.speed.measuring import Comparison, Group, Lap

#: Sections that start many processes, read large files or solve large graphs.
SLOW = ("processes", "reading", "sessions", "solving")


def group(subject, *timers):
    """Steps called a and b, with these timers."""

    @contextmanager
    def prepared():
        yield dict(zip("ab", timers, strict=True))

    return Group("solving", subject, prepared, (Comparison("a", "b", 1.0),), rounds=1)


@pytest.mark.gtsam
def test_the_quick_sample_measures_sections(certpgo, tmp_path):
    chosen = [name for name in bench.SECTIONS if name not in SLOW]
    options = [word for name in chosen for word in ("--section", name)]
    done = certpgo("bench", "speed", "--quick", *options, "--out", tmp_path)
    assert done.code == 0, done.err
    assert "ratios with a goal" in done.out
    assert "written to" in done.err
    page = (tmp_path / "speed.md").read_text(encoding="utf-8")
    for section in chosen:
        assert f"## {section.capitalize()}" in page
    assert "CERTIFIED" in page
    assert (tmp_path / "speed.csv").read_text().startswith("section,")


def test_ctrl_c_keeps_what_is_measured(certpgo, tmp_path, monkeypatch):
    def one():
        return Lap(1.0)

    def interrupted():
        raise KeyboardInterrupt

    groups = [group("measured", one, one), group("stopped", interrupted, one)]
    monkeypatch.setattr(bench, "groups", lambda *_: groups)
    done = certpgo("bench", "speed", "--out", tmp_path)
    assert done.code == 130
    assert "goes on from there" in done.err
    page = (tmp_path / "speed.md").read_text(encoding="utf-8")
    assert "| measured |" in page
    assert "stopped" not in page


def test_what_fails_is_an_exit_code(certpgo, tmp_path, monkeypatch):
    def failing():
        raise MemoryError

    monkeypatch.setattr(bench, "groups", lambda *_: [group("first", failing, failing)])
    done = certpgo("bench", "speed", "--out", tmp_path, "--json")
    assert done.code == 1
    assert done.json[0]["error"] == "not enough memory"
