"""The command as shells, schedulers and pipes run it."""

import gzip
import os
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
import typer

import certpgo as package
from certpgo.cli import EXIT_CODES
from certpgo.cli._show import outlasting_reader
from certpgo.errors import FormatError
from certpgo.io.datasets.synthetic import helix

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs signals, pipes and /dev")
#: A program of the command's name that sends itself what `timeout` does at the first iteration.
ENDED = """
import os, signal, sys
from certpgo.cli import main
from certpgo.cli._show import StatusLine

def ended(*_):
    for _ in range(2):
        os.kill(os.getpid(), signal.SIGTERM)
    return False

StatusLine.__call__ = ended
sys.exit(main())
"""


@pytest.fixture
def graph(tmp_path):
    path = tmp_path / "helix.g2o"
    package.write(path, helix(4, np.random.default_rng(0)))
    return path


def shell(line, folder, **options):
    """A line of a shell in which the command is `certpgo`."""
    command = f"certpgo() {{ '{sys.executable}' -m certpgo \"$@\"; }}\n{line}"
    return subprocess.run(
        ["bash", "-c", command],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT), "PYTHONIOENCODING": "utf-8"},  # strictly
        capture_output=True,
        check=False,
        timeout=60,
        **options,
    )


@pytest.mark.parametrize("begin", ["exec", "trap '' INT; exec"], ids=["usual", "background"])
def test_sigterm_ends_as_ctrl_c_does(graph, tmp_path, begin):
    (tmp_path / "certpgo").write_text(ENDED)
    done = shell(
        f"{begin} '{sys.executable}' certpgo solve helix.g2o -o best.g2o --proof best.cert",
        tmp_path,
    )
    assert done.returncode == 143
    said = done.stderr.decode().splitlines()[0]
    assert said.startswith("certpgo: interrupted: the best estimate so far is ")
    assert said.endswith("; not written: best.cert")
    read = package.read(graph)
    assert package.read_estimate(tmp_path / "best.g2o", read).num_nodes == read.graph.num_nodes
    assert not (tmp_path / "best.cert").exists()


def test_sigterm_during_the_imports(tmp_path):
    (tmp_path / "scipy.py").write_text(
        "import os, signal, time\nos.kill(os.getpid(), signal.SIGTERM)\ntime.sleep(10)\n"
    )
    done = shell(f"PYTHONPATH='{tmp_path}:{ROOT}' certpgo list methods", tmp_path)
    assert (done.returncode, done.stderr) == (143, b"certpgo: interrupted\n")


def test_sigterm_ends_a_stream_with_what_stands(graph, tmp_path):
    command = [
        sys.executable,
        "-m",
        "certpgo",
        "follow",
        "-",
        "--every",
        "3",
        "--trace",
        "-o",
        "so_far.tum",
    ]
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(command, cwd=tmp_path, env=environment, **pipes) as process:
        process.stdin.write(graph.read_bytes())
        process.stdin.flush()
        assert process.stdout.readline().startswith(b"EXACT FIT")  # four poses of a tree
        process.terminate()
        process.terminate()
        said, warned = process.communicate(timeout=60)
    assert process.returncode == 143
    stands = b"certpgo: interrupted: the estimate so far stands, with its last certificate"
    assert warned.splitlines()[0] == stands
    assert said.startswith(b"interrupted; so far: EXACT FIT")
    assert (tmp_path / "so_far.tum").exists()


def test_the_exit_codes_are_those_of_the_help(certpgo):
    assert EXIT_CODES[130], EXIT_CODES[143]
    assert "143 ended by SIGTERM" in " ".join(certpgo("--help").out.split())


@pytest.mark.parametrize("closed", [">&-", "<&- >&- 2>&-"])
def test_closed_streams(graph, tmp_path, closed):
    done = shell(f"certpgo convert helix.g2o out.npz --no-priors {closed}", tmp_path)
    assert done.returncode == 0
    assert done.stderr == b""
    assert package.read(tmp_path / "out.npz").graph.num_edges == package.read(graph).graph.num_edges


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize("asked", ["--version", "--help", "solve --help", "list methods"])
def test_a_full_disk(tmp_path, asked):
    done = shell(f"certpgo {asked} > /dev/full", tmp_path)
    said = b"certpgo: standard output: No space left on device\n"
    assert (done.returncode, done.stderr) == (1, said)


def test_help_into_a_closed_pipe(tmp_path):
    done = shell("certpgo --help | true; exit ${PIPESTATUS[0]}", tmp_path)
    assert (done.returncode, done.stderr) in [(141, b""), (0, b"")]  # 0 if the pipe took it all


def test_names_that_are_no_utf8(graph, tmp_path):
    name = b"caf\xe9.g2o"
    try:
        graph.rename(tmp_path / os.fsdecode(name))
    except OSError:
        pytest.skip("this file system takes names in UTF-8 only")
    done = shell(
        "f=$(printf 'caf\\351'); certpgo solve $f.g2o -o $f.tum --html $f.html --proof p && "
        "certpgo convert $f.g2o out.npz && certpgo view $f.g2o -o map.svg && "
        "certpgo certify $f.g2o $f.tum --csv $f.csv && certpgo compare $f.g2o --methods eigen_ra",
        tmp_path,
    )
    assert (done.returncode, b"Traceback" in done.stderr) == (0, False)
    assert b"graph          caf\xe9" in done.stdout or b" caf\xe9\n" in done.stdout
    assert b"caf\xe9.html" in done.stderr
    rows = (tmp_path / os.fsdecode(b"caf\xe9.csv")).read_text(encoding="utf-8")
    assert "caf\\udce9.tum" in rows
    assert "caf\\udce9" in (tmp_path / os.fsdecode(b"caf\xe9.html")).read_text(encoding="utf-8")
    assert package.read(tmp_path / "out.npz").name == "caf\\udce9"
    refused = shell("f=$(printf 'caf\\351'); cp $f.tum $f; certpgo check $f p", tmp_path)
    assert refused.returncode == 6
    assert refused.stdout.startswith(b"REFUSED: caf\xe9 is not the file")
    missing = shell("certpgo info $(printf '\\351').g2o", tmp_path)
    assert missing.returncode == 1
    assert missing.stderr.startswith(b"certpgo: \xe9.g2o: no such file")


def test_pipes_are_files(graph, tmp_path):
    done = shell(
        "certpgo solve helix.g2o -o best.g2o --proof best.cert >/dev/null && "
        "certpgo certify <(cat helix.g2o) <(cat best.g2o) >/dev/null && "
        "cat helix.g2o | certpgo check /dev/stdin best.cert && "
        "gzip -c helix.g2o | certpgo convert /dev/stdin out.npz && "
        "certpgo prove <(cat helix.g2o)",
        tmp_path,
    )
    assert (done.returncode, done.stderr) == (0, b"")
    assert done.stdout.count(b"PROVED: ") == 2
    read = package.read(graph).graph.num_edges
    assert package.read(tmp_path / "out.npz").graph.num_edges == read


def test_a_pipe_is_named_in_messages(certpgo, tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    text = b"EDGE_SE2 0 1 1 0 0\nEDGE_SE2 0 1 1\n"
    writer = threading.Thread(target=pipe.write_bytes, args=[gzip.compress(text)])
    writer.start()
    done = certpgo("solve", pipe)
    writer.join()
    assert done.code == 1
    assert done.err.startswith(f"certpgo: {pipe}:2: EDGE_SE2 takes 2 ids")


def test_python_reads_files_alone(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(FormatError, match="a pipe, which can be read only once"):
        package.read(pipe)
    with pytest.raises(FormatError, match="not a device"):
        package.read("/dev/zero")


def test_a_named_pipe_is_followed(certpgo, graph, tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    writer = threading.Thread(target=pipe.write_bytes, args=[graph.read_bytes()])
    writer.start()
    done = certpgo("follow", pipe)
    writer.join()
    best = package.solve(package.read(graph))
    assert done.code == 0
    assert f"{best.graph.num_nodes} nodes, {best.graph.num_edges} measurements" in done.out


def test_scans_may_come_through_pipes(tmp_path):
    line = "certpgo register <(printf '0 0 0\\n') <(printf 'x y\\n') -o out.ply"
    done = shell(line, tmp_path)
    assert done.returncode == 1
    assert done.stderr.startswith(b"certpgo: /dev/fd/")
    assert done.stderr.count(b"\n") == 1


def test_outputs_are_written_though_the_reader_is_gone(graph, tmp_path):
    outputs = "-o out.g2o --proof out.cert --covariances out.csv --html out.html"
    line = f"certpgo solve helix.g2o --cost chordal {outputs} > pipe; echo $? > code"
    done = shell(f"mkfifo pipe; head -1 pipe > first & {line}; wait", tmp_path)
    assert b"Traceback" not in done.stderr
    assert (tmp_path / "first").read_text().startswith("CERTIFIED")
    assert (tmp_path / "code").read_text() in ("141\n", "0\n")  # 0 if the pipe took it all
    for name in ("out.g2o", "out.cert", "out.csv", "out.html"):
        assert (tmp_path / name).stat().st_size > 0, name


def test_a_reader_that_is_gone_ends_the_command_after_its_outputs(monkeypatch):
    """The error comes after all that follows the first print that nobody reads."""
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w") as stream:
        monkeypatch.setattr(sys, "stdout", stream)
        done = []

        @outlasting_reader()
        def work():
            for said in ("nobody reads this", "nor this"):
                typer.echo(said)
                done.append("written")

        with pytest.raises(BrokenPipeError):
            work()
        assert sys.stdout is stream
    assert done == ["written"] * 2


def test_all_proofs_of_a_folder_are_written_though_the_reader_is_gone(graph, tmp_path):
    names = [f"g{k}.g2o" for k in range(3)]
    for name in names:
        (tmp_path / name).write_bytes(graph.read_bytes())
    line = f"certpgo prove {' '.join(names)} --cost chordal -o proofs > pipe"
    done = shell(f"mkfifo pipe; head -0 pipe & {line}; wait", tmp_path)
    assert b"Traceback" not in done.stderr
    assert len([*(tmp_path / "proofs").rglob("g*.g2o*")]) == 3
