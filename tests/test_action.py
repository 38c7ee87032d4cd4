"""The GitHub Action, the pre-commit hook and the workflow: what they call exists and works."""

import os
import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

from certpgo.cli import command_names

yaml = pytest.importorskip("yaml", reason="PyYAML is not installed")
ROOT = Path(__file__).parents[1]


def read(name):
    return yaml.safe_load((ROOT / name).read_text())


def test_the_hook_calls_a_command_that_exists():
    [hook] = read(".pre-commit-hooks.yaml")
    program, command, *rest = shlex.split(hook["entry"])
    assert (program, rest) == ("certpgo", [])
    assert command in command_names()
    assert {"id", "name", "language", "files"} <= {*hook}


@pytest.fixture
def repository(tmp_path):
    """A repository with two commits and, on its own path, a program that prints its arguments."""
    for needed in ("git", "bash"):
        if shutil.which(needed) is None:
            pytest.skip(f"{needed} is not installed")
    programs = tmp_path / "bin"
    programs.mkdir()
    (programs / "certpgo").write_text("#!/bin/sh\nprintf '<%s>' \"$@\"\n")
    (programs / "certpgo").chmod(0o755)
    folder = tmp_path / "repository"
    folder.mkdir()
    environment = {**os.environ, "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}"}
    for who in ("AUTHOR", "COMMITTER"):
        environment |= {f"GIT_{who}_NAME": "x", f"GIT_{who}_EMAIL": "x@example.org"}

    def run(*words, **more):
        done = subprocess.run(
            words, cwd=folder, env={**environment, **more}, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    run("git", "init", "-q")
    for files in (("old.g2o", "gone.g2o", "notes.txt"), ("new one.g2o", "more.txt")):
        for name in files:
            (folder / name).write_text(name)
        if "more.txt" in files:
            (folder / "gone.g2o").unlink()
        run("git", "add", "-A")
        run("git", "commit", "-q", "-m", files[0])
    return run


@pytest.mark.parametrize(
    ("given", "base", "cost", "graphs"),
    [
        ("", "HEAD~1", "", ["new one.g2o"]),
        ("", "HEAD", "", []),
        ("", "0" * 40, "", ["new one.g2o", "old.g2o"]),
        ("a.g2o\n\nb c.g2o\n", "HEAD", "chordal", ["a.g2o", "b c.g2o"]),
    ],
)
def test_the_action_proves_what_was_changed(repository, given, base, cost, graphs):
    steps = read("action.yml")["runs"]["steps"]
    script = steps[-1]["run"]
    said = repository(
        "bash", "-c", script, FILES=given, COST=cost, BADGE="b.svg", PROOFS="p", BASE=base
    )
    if not graphs:
        assert said == "no g2o file was changed\n"
        return
    chosen = ["--cost", cost] if cost else []
    words = ["prove", *chosen, "--badge", "b.svg", "--out", "p", "--", *graphs]
    assert said == "".join(f"<{word}>" for word in words)


def test_the_action_has_what_its_script_reads():
    action = read("action.yml")
    names = {
        value.strip("${} ").partition(".")[2]
        for value in action["runs"]["steps"][-1]["env"].values()
    }
    assert {*action["inputs"]} <= names


def test_the_workflow_builds_on_three_systems():
    jobs = read(".github/workflows/wheels.yml")["jobs"]
    systems = {name.partition("-")[0] for name in jobs["wheels"]["strategy"]["matrix"]["os"]}
    assert systems == {"ubuntu", "macos", "windows"}


def test_actions_are_pinned_by_commit():
    files = [ROOT / "action.yml", *(ROOT / ".github" / "workflows").glob("*.yml")]
    used = [one for file in files for one in re.findall(r"uses: (.*)", file.read_text())]
    assert used
    assert all(re.fullmatch(r"[\w/-]+@[0-9a-f]{40} # v[\d.]+", one) for one in used)
