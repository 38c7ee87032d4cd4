"""Ctrl-C ends a command promptly, with one line and exit code 130."""

import importlib
import os
import signal
import subprocess
import sys
import time
import weakref
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import typer

import certpgo as package
from certpgo.cli._interrupting import heard_late
from certpgo.io import write
from certpgo.io.datasets.synthetic import winding_cycle
from certpgo.io.datasets.thesis import langevin_graph
from certpgo.optimize.methods._sdp import Semidefinite
from certpgo.optimize.progress import Stop
from certpgo.optimize.solution import Status
from certpgo.solve import bounds_table, outlier_report, prove_files
from certpgo.solve.solving import solve

ROOT = Path(__file__).parents[2]
needs_signals = pytest.mark.skipif(os.name != "posix", reason="needs POSIX signals")
#: A module that presses Ctrl-C when it is imported.
IMPATIENT = "import os, signal, time\nos.kill(os.getpid(), signal.SIGINT)\ntime.sleep(10)\n"


def run(*arguments, folder):
    """A command in a process that finds the modules of the folder first."""
    path = os.pathsep.join([str(folder), str(ROOT)])
    return subprocess.run(
        [sys.executable, *map(str, arguments)],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )


@needs_signals
@pytest.mark.parametrize("module", ["numpy", "scipy", "typer"])
def test_during_the_imports(tmp_path, module):
    (tmp_path / f"{module}.py").write_text(IMPATIENT)
    done = run("-m", "certpgo", "list", "datasets", folder=tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "certpgo: interrupted\n")


@needs_signals
def test_during_the_imports_of_the_installed_command(tmp_path):
    (tmp_path / "scipy.py").write_text(IMPATIENT)
    script = tmp_path / "certpgo"
    script.write_text("import sys\nfrom certpgo.cli import main\nsys.exit(main())\n")
    done = run(script, "list", "datasets", folder=tmp_path)
    assert (done.returncode, done.stderr) == (130, "certpgo: interrupted\n")


@needs_signals
def test_the_library_leaves_ctrl_c_to_its_program(tmp_path):
    (tmp_path / "scipy.py").write_text(IMPATIENT)
    script = tmp_path / "mine.py"
    script.write_text(
        "try:\n    from certpgo import read\nexcept KeyboardInterrupt:\n    print('caught')\n"
    )
    assert run(script, folder=tmp_path).stdout == "caught\n"


def test_the_module_is_the_command(tmp_path):
    done = run("-m", "certpgo", "--version", folder=tmp_path)
    assert (done.returncode, done.stdout[:8]) == (0, "certpgo ")


def test_while_a_command_is_imported(certpgo, monkeypatch):
    def impatient(names):
        raise KeyboardInterrupt

    monkeypatch.setattr("certpgo.cli.application", impatient)
    done = certpgo("info", "graph.g2o")
    assert (done.code, done.err) == (130, "certpgo: interrupted\n")


@needs_signals
def test_compiled_code_is_ended_at_once(tmp_path):
    script = tmp_path / "waits.py"
    script.write_text(
        "import os, signal, time\n"
        "from certpgo.cli._interrupting import ends_at_once\n"
        "print('first')\n"
        "with ends_at_once():\n"
        "    try:\n"
        "        os.kill(os.getpid(), signal.SIGINT)\n"
        "        time.sleep(30.0)\n"
        "    finally:\n"
        "        print('Python handled it')\n"
    )
    done = run(script, folder=tmp_path)
    # What shells report as exit code 130.
    assert (done.returncode, done.stdout, done.stderr) == (-signal.SIGINT, "first\n", "")


@pytest.mark.parametrize("arguments", [("solve", "--method", "sdp_dual"), ("bounds", "--sdp")])
def test_an_interior_point_solver_can_be_ended(certpgo, square, monkeypatch, arguments):
    solve, during = Semidefinite._run, []

    def recording(self, posed):
        during.append(signal.getsignal(signal.SIGINT))
        return solve(self, posed)

    monkeypatch.setattr(Semidefinite, "_run", recording)
    before = signal.getsignal(signal.SIGINT)
    command, *options = arguments
    assert certpgo(command, square, "--rotations", *options).code == 0
    assert during == [signal.SIG_DFL]
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.parametrize("given", [False, True])
@pytest.mark.parametrize("options", [(), ("--json",)])
def test_bounds_of_half_a_search_are_not_shown(certpgo, tmp_path, monkeypatch, given, options):
    def interrupted(graph, initial=None):
        found = solve(graph, initial=initial)
        return replace(found, solution=replace(found.solution, status=Status.INTERRUPTED))

    monkeypatch.setattr(bounds_table, "solve", interrupted)
    instance, wound = winding_cycle(12, 0.1, 1)  # no optimum: its bounds need a search
    graph, estimate = tmp_path / "cycle.npz", tmp_path / "wound.npz"
    write(graph, instance)
    write(estimate, wound)
    done = certpgo("bounds", graph, *[estimate] * given, *options)
    assert (done.code, done.out, done.err) == (130, "", "certpgo: interrupted\n")


def test_the_help_says_which_interrupt_aborts(certpgo):
    said = " ".join(certpgo("solve", "--help").out.replace("│", " ").split())
    assert "With --method, the first Ctrl-C aborts" in said


def test_an_interrupted_certification_prints_what_is_proven(certpgo, tmp_path, monkeypatch):
    from certpgo.cli._show import StatusLine

    instance, wound = winding_cycle(9, 0.3, 1)
    graph, estimate, rows = tmp_path / "cycle.npz", tmp_path / "wound.npz", tmp_path / "rows.csv"
    write(graph, instance)
    write(estimate, wound)
    monkeypatch.setattr(StatusLine, "__call__", lambda *_: True)
    done = certpgo("certify", graph, estimate)
    assert done.code == 130
    assert "ended early (interrupted)" in done.out
    page = tmp_path / "page.html"
    asked = certpgo("certify", graph, estimate, "--html", page)
    stands = "certpgo: interrupted: what is proven by then stands"
    assert (asked.code, asked.err.splitlines()[0]) == (130, f"{stands}; not written: {page}")
    assert not page.exists()
    several = certpgo("certify", graph, estimate, estimate, "--csv", rows)
    assert several.code == 130
    assert several.err.endswith(f"certpgo: interrupted: {rows} has 1 of 1 estimates\n")
    assert len(rows.read_text().splitlines()) == 2
    monkeypatch.undo()
    limited = certpgo("certify", graph, estimate, "--time-limit", 0)
    assert limited.code == 5
    assert "ended early (time limit)" in limited.out
    assert certpgo("certify", graph, estimate, "--time-limit", 60).code == 4


def test_an_interrupted_search_proves_nothing_of_single_measurements(
    certpgo, square, tmp_path, monkeypatch
):
    def interrupted(*given, **options):
        found = solve(instance.graph, cost="chordal")
        return replace(found, solution=replace(found.solution, status=Status.INTERRUPTED))

    instance, _ = winding_cycle(9, 0.3, 1)
    for room, name, command in (
        (package, "solve_robustly", "outliers"),
        (prove_files, "solve", "prove"),
    ):
        monkeypatch.setattr(room, name, interrupted)
        done = certpgo(command, square)
        assert (done.code, done.out, done.err) == (130, "", "certpgo: interrupted\n")


def test_interrupted_proofs_of_outliers_are_listed(certpgo, tmp_path, monkeypatch):
    instance = langevin_graph(40, 8.0, 1.0, np.random.default_rng(1), outliers=0.1)
    path = tmp_path / "wrong.g2o"
    write(path, instance.graph)
    rises = outlier_report.proven_rises

    def pressed(problem, estimate, stop):
        stop.interrupt(signal.SIGINT, None)
        return rises(problem, estimate, stop)

    monkeypatch.setattr(outlier_report, "proven_rises", pressed)
    done = certpgo("outliers", path)
    assert done.code == 130
    assert "certpgo: interrupted: what is proven by then stands\n" in done.err
    assert "Rejected measurements" in done.out


def test_the_first_ctrl_c_says_what_the_second_does(monkeypatch):
    written = []
    stop = Stop()
    monkeypatch.setattr("certpgo.optimize.progress.os.write", lambda _, text: written.append(text))
    monkeypatch.setattr(sys, "stderr", SimpleNamespace(isatty=lambda: True, fileno=lambda: 2))
    stop.interrupt(signal.SIGINT, None)
    with pytest.raises(KeyboardInterrupt):
        stop.interrupt(signal.SIGINT, None)
    assert written == [b"\nstopping after this step; Ctrl-C again aborts\n"]


@pytest.fixture
def outputs(tmp_path):
    """A folder for outputs with an old file, and what must be in it at the end."""
    folder = tmp_path / "outputs"
    folder.mkdir()
    (folder / "s.g2o").write_text("old")
    return folder


@pytest.mark.parametrize("options", [(), ("--json",)])
def test_an_interrupted_search_says_first_what_is_not_written(
    certpgo, square, outputs, monkeypatch, options
):
    from certpgo.cli._show import StatusLine

    monkeypatch.setattr(StatusLine, "__call__", lambda *_: True)
    solved, proof = outputs / "s.g2o", outputs / "s.cert"
    done = certpgo("solve", square, "-o", solved, "--proof", proof, *options)
    assert done.code == 130
    first = done.err.splitlines()[0]
    assert first.startswith("certpgo: interrupted: the best estimate so far is ")
    assert first.endswith(f"; not written: {proof}")
    assert sorted(outputs.iterdir()) == [solved]
    assert solved.read_text().startswith("VERTEX_SE2 0 ")
    assert "if the search was stopped" not in done.out.lower()


def test_advice_after_an_interruption_is_to_go_on(certpgo, tmp_path, monkeypatch):
    from certpgo.cli._show import StatusLine

    graph, solved = tmp_path / "cycle.npz", tmp_path / "solved.npz"
    instance, wound = winding_cycle(12, 0.1, 1)
    write(graph, instance)
    write(tmp_path / "wound.npz", wound)
    monkeypatch.setattr(StatusLine, "__call__", lambda *_: True)
    begun = ("solve", graph, "--initial", tmp_path / "wound.npz", "-o", solved)
    said = certpgo(*begun).out
    assert f"The search was interrupted; go on with it: certpgo solve {graph} --initial" in said
    assert "stopped early" not in said


@needs_signals
def test_a_second_ctrl_c_leaves_no_half_written_file(certpgo, square, outputs, monkeypatch):
    from certpgo.cli._show import StatusLine

    def pressed_twice(*_):
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGINT)
        return False

    monkeypatch.setattr(StatusLine, "__call__", pressed_twice)
    solved, page = outputs / "s.g2o", outputs / "page.html"
    done = certpgo("solve", square, "-o", solved, "--html", page)
    said = f"certpgo: interrupted; not written: {solved}, {page}\n"
    assert (done.code, done.out, done.err) == (130, "", said)
    assert [path.name for path in outputs.iterdir()] == ["s.g2o"]
    assert solved.read_text() == "old"
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_ctrl_c_between_two_files_names_both(certpgo, square, outputs, monkeypatch):
    replaced, replace_file = [], os.replace

    def interrupted_second(source, target):
        replaced.append(target)
        if len(replaced) > 1:
            raise KeyboardInterrupt
        replace_file(source, target)

    monkeypatch.setattr("certpgo.io.writing.os.replace", interrupted_second)
    solved, page = outputs / "s.g2o", outputs / "page.html"
    done = certpgo("solve", square, "-o", solved, "--html", page)
    assert done.code == 130
    assert done.err.endswith(f"interrupted; written: {solved}; not written: {page}\n")
    assert [path.name for path in outputs.iterdir()] == ["s.g2o"]
    assert solved.read_text() != "old"


@needs_signals
def test_ctrl_c_while_it_is_said_that_the_command_was_interrupted(certpgo, square, monkeypatch):
    said = []

    def echo(message, **_):
        os.kill(os.getpid(), signal.SIGINT)
        said.append(message)

    monkeypatch.setattr(typer, "echo", echo)
    monkeypatch.setattr(importlib.import_module("certpgo.cli.info"), "facts", interrupting)
    assert certpgo("info", square).code == 130
    assert said[-1].startswith("certpgo: interrupted")
    assert signal.getsignal(signal.SIGINT) is not signal.SIG_IGN


def interrupting(*_, **__):
    raise KeyboardInterrupt


def test_ctrl_c_that_a_callback_drops_is_delivered_again():
    class Held:
        pass

    held = [Held()]
    dying = weakref.ref(held[0], interrupting)
    with heard_late():
        held.clear()
        with pytest.raises(KeyboardInterrupt):
            time.sleep(5.0)
    assert dying() is None
