"""Mutation testing itself: what mutants there are, what becomes of them, which are excused."""

import importlib.util
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "reports" / "studies" / "mutants.py"

MODULE = '''
"""A module of two functions."""

LIMIT = 2.0


def clipped(x: float = 1.0) -> float:
    """At most LIMIT."""
    return LIMIT if x > LIMIT else x


def checked(x: int) -> int:
    if x < 0 and x != -7:
        raise ValueError("not below -3")
    return abs(x) + 1
'''
TEST = """
import pytest

from certpgo.certify.small import checked, clipped


def test_small():
    assert (clipped(1.5), clipped(3.0), clipped()) == (1.5, 2.0, 1.0)
    assert (checked(-7), checked(4)) == (8, 5)
    with pytest.raises(ValueError, match="below"):
        checked(-1)
"""


@pytest.fixture(scope="module")
def tool():
    spec = importlib.util.spec_from_file_location("mutants", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    sys.modules["mutants"] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def checkout(tmp_path):
    """A checkout of one small module, its test and the tool."""
    for path, text in (
        ("certpgo/__init__.py", ""),
        ("certpgo/certify/__init__.py", ""),
        ("certpgo/certify/small.py", MODULE),
        ("tests/certify/test_small.py", TEST),
        ("pyproject.toml", '[tool.pytest.ini_options]\npythonpath = ["tests"]\n'),
        ("reports/studies/mutants.toml", ""),
    ):
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text(text)
    shutil.copy(SCRIPT, tmp_path / "reports" / "studies")
    return tmp_path


def test_a_mutant_changes_one_thing_and_no_words(tool, checkout, monkeypatch):
    monkeypatch.setattr(tool, "ROOT", checkout)
    found = tool.mutants("certpgo/certify/small.py")
    changes = {(m.function, m.after) for m in found}
    assert {
        ("", "LIMIT = 4.0"),
        ("clipped", "return LIMIT if x >= LIMIT else x"),
        ("clipped", "def clipped(x: float=0.5) -> float:"),
        ("checked", "if x < 0 or x != -7:"),
        ("checked", "if x < 0 and x != 7:"),
        ("checked", "pass"),
        ("checked", "return x + 1"),
        ("checked", "return abs(x) - 1"),
    } <= changes
    assert all(
        "not below -3" in text and "At most LIMIT" in text
        for text in found.values()
        if "raise" in text
    )
    assert len(set(found.values())) == len(found)


def test_survivors_are_found_and_the_equivalent_excused(checkout):
    def run():
        command = [
            sys.executable,
            "-m",
            "reports.studies.mutants",
            "--module",
            "certpgo/certify/small.py",
        ]
        command += ["--function", "clipped", "--out", str(checkout / "out.jsonl")]
        return subprocess.run(command, cwd=checkout, capture_output=True, text=True, timeout=300)

    done = run()
    assert done.returncode == 1, done.stderr
    assert "+ return LIMIT if x >= LIMIT else x" in done.stdout
    survivors = done.stdout.count("survived: ")
    assert 0 < survivors < 8
    assert (checkout / "certpgo/certify/small.py").read_text() == MODULE
    entry = (
        '[[mutant]]\nmodule = "certpgo/certify/small.py"\nfunction = "clipped"\n'
        'before = "return LIMIT if x > LIMIT else x"\nafter = ["*"]\nreason = "same at LIMIT"\n'
    )
    (checkout / "reports/studies/mutants.toml").write_text(entry)
    again = run()  # what was killed is not tried again
    assert again.stdout.count("survived: ") < survivors
    assert " 0 equivalent" not in again.stdout


@pytest.mark.parametrize("where", ["tests/conftest.py", "tests/certify/test_small.py"])
def test_tests_that_end_the_process_do_not_pass(tool, checkout, where):
    """What leaves as it is imported takes pytest with it."""
    (checkout / where).write_text("raise SystemExit(0)\n")
    session = tool.Session(checkout / "times.json")
    files = ["tests/certify/test_small.py"]
    code, _ = tool.forked(lambda: tool.run_tests(checkout, files, session), 60.0)
    assert code == tool.LEFT


def test_the_excused_are_mutants_of_today(tool):
    listed = tool.equivalent()
    modules = {m.module for m in listed}
    known = {
        excuse
        for name in modules
        for m in tool.mutants(name)
        if (excuse := tool.excused(m, listed))
    }
    assert set(listed) == known
    assert all(len(reason) > 20 for reason in listed.values())
