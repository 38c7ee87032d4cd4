"""Runs that are stopped and go on, on the command line."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest
from repeated import by_key

from reports.harness.experiments.journal import read_entries
from reports.harness.experiments.records import Record

#: Records of the table of cycles: six rows, two methods.
ALL = 12


@pytest.fixture
def started(small_checkout, tmp_path):
    """Starts `reproduce` in a process whose runs wait from the third on, and waits for that one."""
    processes = []

    def start(*arguments):
        code = "import sys; from certpgo.cli import main; sys.exit(main())"
        process = subprocess.Popen(
            [sys.executable, "-c", code, "reproduce", *arguments, "--out", str(tmp_path / "out")],
            env={**os.environ, "CERTPGO_TEST_STOP": "3"},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        processes.append(process)
        while len(runs(small_checkout)) < 3 and process.poll() is None:
            time.sleep(0.02)
        return process

    yield start
    for process in processes:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def runs(log):
    return log.read_text().split()


def lines_of(folder):
    return read_entries(folder / "cycles.jsonl", Record)


@pytest.fixture
def whole(certpgo, small_checkout, tmp_path):
    """The records of a run that nothing stops."""
    certpgo("reproduce", "cycles", "--out", tmp_path / "whole")
    small_checkout.write_text("")
    return lines_of(tmp_path / "whole")


def test_a_killed_run_goes_on(certpgo, whole, started, small_checkout, tmp_path):
    os.killpg(started("cycles").pid, signal.SIGKILL)
    out = tmp_path / "out"
    before = lines_of(out)
    assert len(before) == 4
    with (out / "cycles.jsonl").open("a") as stream:
        stream.write('{"table": "cycles", "row": "n')
    done = certpgo("reproduce", "cycles", "--out", out)
    assert done.code == 0
    after = lines_of(out)
    assert after[: len(before)] == before
    assert by_key(after) == by_key(whole)
    assert runs(small_checkout) == ["4", "5", "6", "6", "7", "8", "9"]
    assert "| mischief |" in (out / "cycles.md").read_text()


@pytest.mark.parametrize("workers", ["1", "2"])
def test_an_interrupted_run_says_how_to_go_on(
    certpgo, whole, started, small_checkout, tmp_path, workers
):
    process = started("cycles", "--workers", workers)
    os.killpg(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "the same command goes on from there" in err
    assert "Traceback" not in err
    out = tmp_path / "out"
    assert sorted(path.name for path in out.iterdir()) == ["cycles.jsonl", "cycles.md"]
    assert "**Interrupted" in (out / "cycles.md").read_text()
    before = lines_of(out)
    # Of two processes one may be behind when the other's third run waits.
    assert len(before) == 4 if workers == "1" else 0 < len(before) < ALL
    assert certpgo("reproduce", "cycles", "--out", out, "--workers", workers).code == 0
    assert lines_of(out)[: len(before)] == before
    assert by_key(lines_of(out)) == by_key(whole)
    assert "Interrupted" not in (out / "cycles.md").read_text()


def test_nothing_is_done_twice_unless_asked(certpgo, small_checkout, tmp_path):
    common = ("reproduce", "cycles", "--out", tmp_path)
    first = certpgo(*common)
    assert len(first.err.splitlines()) == 7
    assert "12 of 12: cycles: n = 9, seed 0 (" in first.err
    text = (tmp_path / "cycles.md").read_bytes()
    again = certpgo(*common)
    assert again.out == first.out
    assert "Up to date; use --again to recompute" in again.err
    assert (len(lines_of(tmp_path)), len(runs(small_checkout))) == (ALL, 6)
    assert (tmp_path / "cycles.md").read_bytes() == text
    assert certpgo(*common, "--again").code == 0
    assert (len(lines_of(tmp_path)), len(runs(small_checkout))) == (2 * ALL, 12)
    assert len(certpgo(*common, "--json").json) == ALL


def test_more_seeds_are_what_is_lacking(certpgo, small_checkout, tmp_path):
    common = ("reproduce", "cycles", "--out", tmp_path)
    certpgo(*common)
    certpgo(*common, "--seeds", "2")
    assert len(runs(small_checkout)) == 12
    assert len({record.key for record in lines_of(tmp_path)}) == 24


def test_quick_and_full_never_mix(certpgo, tmp_path, small_checkout):
    certpgo("reproduce", "cycles", "--quick", "--out", tmp_path)
    certpgo("reproduce", "cycles", "--out", tmp_path)
    quick, full = lines_of(tmp_path / "quick"), lines_of(tmp_path)
    assert {record.profile for record in quick} == {"quick"}
    assert {record.profile for record in full} == {"full"}
    assert not {record.key for record in quick} & {record.key for record in full}
    # Even where somebody puts the ones among the others.
    with (tmp_path / "cycles.jsonl").open("a") as stream:
        stream.write((tmp_path / "quick" / "cycles.jsonl").read_text())
    found = certpgo("reproduce", "cycles", "--out", tmp_path, "--json").json
    assert {record["profile"] for record in found} == {"full"}


def test_processes_print_and_write_what_one_does(certpgo, small_checkout, tmp_path):
    texts = []
    for workers in ("1", "2"):
        out = tmp_path / workers
        found = certpgo("reproduce", "cycles", "--out", out, "--workers", workers, "--json").json
        texts.append([(r["row"], r["method"], r["metrics"]["cost"], r["verdict"]) for r in found])
    assert texts[0] == texts[1]


def test_a_time_limit_is_a_row(certpgo, small_checkout, tmp_path, monkeypatch):
    monkeypatch.setenv("CERTPGO_TEST_STOP", "6")
    done = certpgo("reproduce", "cycles", "--out", tmp_path, "--time-limit", "0.5")
    assert done.code == 0
    assert "not finished within 0.5 s" in (tmp_path / "cycles.md").read_text()
    assert "1 failed" in done.err


def test_all_runs_tables_and_figures_and_goes_on(certpgo, small_checkout, tmp_path):
    figures = tmp_path / "checkout" / "reports" / "figures"
    figures.mkdir()
    for name, body in (("bar", "return {'height': 1}"), ("bad", "raise ValueError('by design')")):
        (figures / f"{name}.py").write_text(
            "from reports.harness.experiments.figure import Figure\n"
            f"def compute(quick, data):\n    {body}\n"
            "def draw(figure, record):\n    figure.add_subplot().bar([0], [record['height']])\n"
            f"FIGURE = Figure('{name}', 'A bar', 'nobody', compute, draw, 'm')\n"
        )
    common = ("reproduce", "--all", "--out", tmp_path / "out")
    done = certpgo(*common)
    assert done.code == 0
    assert done.out.splitlines() == [
        "cycles: 12 results",
        "bad: ValueError: by design",
        "bar: drawn",
    ]
    again = certpgo(*common)
    assert len(runs(small_checkout)) == 6
    assert "bar" not in again.err  # drawn by this version already
    found = certpgo(*common, "--json").json
    assert {name: bool(data) for name, data in found.items()} == {
        "cycles": True,
        "bad": False,
        "bar": True,
    }
    kept = json.loads((tmp_path / "out" / "bar.json").read_text())
    assert (kept["profile"], len(kept["key"])) == ("full", 16)


def test_a_name_or_all_is_needed(certpgo, small_checkout):
    for arguments in ((), ("cycles", "--all")):
        done = certpgo("reproduce", *arguments)
        assert (done.code, done.err) == (
            1,
            "certpgo: give the name of a table or figure, or --all\n",
        )
