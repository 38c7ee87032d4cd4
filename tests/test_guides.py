"""The documentation's pages: Python is run, printed output compared, command lines parsed."""

import contextlib
import importlib.util
import io
import re
import shlex
import shutil
import subprocess
import warnings
from pathlib import Path

import click
import pytest
import typer

from certpgo.cli import application, command_names
from certpgo.errors import InputNotice

DOCS = Path(__file__).parents[1] / "docs"
#: The README and pages of their own; what the build copies here is run elsewhere.
PAGES = [
    DOCS.parent / "README.md",
    *(path for path in sorted(DOCS.rglob("*.md")) if not {"results", "lessons"} & set(path.parts)),
]
FENCE = re.compile(r"^```(?P<kind>[a-z]*)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL)
#: Datasets that a page's Python reads, named in a comment of the page.
NEEDS = re.compile(r"^<!-- needs: ([\w ]*\w)", re.MULTILINE)
#: Programs that a page may use, and that may be missing.
PROGRAMS = "gtsam|evo|open3d|pycolmap|rosbags|small_gicp|distributed"
OPTIONAL = re.compile(rf"^\s*(?:import|from) ({PROGRAMS})\b", re.MULTILINE)
#: What is smaller here than on the page.
SMALLER = re.compile(r"^<!-- tests: (.*) is (.*) -->$", re.MULTILINE)
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


def blocks(page, *kinds):
    return [match for match in FENCE.finditer(page.read_text()) if match["kind"] in kinds]


def name(page):
    return page.relative_to(DOCS.parent).with_suffix("").as_posix()


def stretches(page):
    """The Python blocks in order: line, section, code, and the output shown right after it."""
    text, found = page.read_text(), blocks(page, "python", "text")
    for block, after in zip(found, [*found[1:], None], strict=True):
        if block["kind"] == "python":
            follows = (
                after and after["kind"] == "text" and not text[block.end() : after.start()].strip()
            )
            yield (
                text.count("\n", 0, block.start()) + 2,
                len(re.findall(r"^## ", text[: block.start()], flags=re.MULTILINE)),
                block["text"],
                after["text"] if follows else "",
            )


def same(shown, printed):
    """Whether lines say the same; small numbers, being rounding, need only be numbers."""
    if NUMBER.sub("#", shown).split() != NUMBER.sub("#", printed).split():
        return False
    pairs = zip(NUMBER.findall(shown), NUMBER.findall(printed), strict=True)
    return all(
        abs(float(a)) < 1e-3 > abs(float(b)) or float(b) == pytest.approx(float(a), rel=0.02)
        for a, b in pairs
    )


@pytest.mark.parametrize("page", [p for p in PAGES if blocks(p, "python")], ids=name)
def test_python_runs_and_prints_what_the_page_shows(page, tmp_path, monkeypatch, dataset_path):
    for needed in " ".join(NEEDS.findall(page.read_text())).split():
        path = dataset_path(needed)
        shutil.copy(path, tmp_path / path.name)
    monkeypatch.chdir(tmp_path)
    namespace, missing = {"__name__": "guide"}, {}
    for line, section, code, shown in stretches(page):
        lacking = [
            name for name in OPTIONAL.findall(code) if importlib.util.find_spec(name) is None
        ]
        missing.setdefault(section, []).extend(lacking)
        if missing[section]:  # and what comes after it in the section builds on it
            continue
        for large, small in SMALLER.findall(page.read_text()):
            code = code.replace(large, small)
        printed = io.StringIO()
        program = compile("\n" * (line - 1) + code, str(page), "exec")
        with contextlib.redirect_stdout(printed), warnings.catch_warnings():
            warnings.simplefilter("ignore", InputNotice)
            exec(program, namespace)
        if shown:
            lines = printed.getvalue().splitlines()
            wanted = [text for text in shown.splitlines() if text.strip() != "..."]
            trimmed = len(wanted) < len(shown.splitlines())
            assert trimmed or len(wanted) == len(lines)
            for text in wanted:
                assert any(same(text, other) for other in lines), f"{page.name}:{line}: {text}"
    if lacking := sorted({name for names in missing.values() for name in names}):
        pytest.skip(f"sections were not run that need {', '.join(lacking)}, not installed")


def commands(page):
    text = "\n".join(match["text"] for match in blocks(page, "console")).replace("\\\n", " ")
    return [line[2:] for line in text.splitlines() if re.match(r"\$ (\w+=\S+ )*certpgo\b", line)]


@pytest.mark.parametrize("page", [p for p in PAGES if commands(p)], ids=name)
def test_command_lines_have_a_command_and_options_that_exist(page):
    group = typer.main.get_command(application(command_names()))
    for line in commands(page):
        words = shlex.split(line.partition("|")[0].partition(" > ")[0], comments=True)
        words = words[words.index("certpgo") + 1 :]
        if words == ["--version"]:
            continue
        command = group.get_command(click.Context(group), words[0])
        assert command, f"no command {words[0]}"
        with command.make_context(words[0], words[1:]) as parsed:  # wrong options raise
            assert parsed.params


def test_a_wrong_option_would_be_noticed():
    group = typer.main.get_command(application(command_names()))
    with pytest.raises(Exception, match="--no-such"):
        group.get_command(click.Context(group), "solve").make_context("solve", ["x", "--no-such"])


def test_the_entry_to_cite_is_that_of_the_citation_file():
    cited = (DOCS / "citing.md").read_text()
    file = (DOCS.parent / "CITATION.cff").read_text()
    title = re.search(r'^title: "(.*)"$', file, flags=re.MULTILINE)[1]
    version = re.search(r"^version: (.*)$", file, flags=re.MULTILINE)[1]
    assert f"title   = {{{title}}}" in cited
    assert f"version = {{{version}}}" in cited


def test_a_release_fills_in_the_address_and_the_date_everywhere(tmp_path):
    address, root = "https://forge.example/certpgo", DOCS.parent
    for name in ("Makefile", "README.md", "CITATION.cff", "docs/citing.md"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        shutil.copy(root / name, tmp_path / name)
    for command in (["git", "init", "-q"], ["git", "add", "."]):
        subprocess.run(command, cwd=tmp_path, check=True)
    make = ["make", "release", f"ADDRESS={address}", "DATE=2031-02-03"]
    subprocess.run(make, cwd=tmp_path, check=True)
    texts = [(tmp_path / name).read_text() for name in ("README.md", "CITATION.cff")]
    cited = (tmp_path / "docs/citing.md").read_text()
    assert address in texts[0]
    assert f"repository-code: {address}\n" in texts[1]
    assert "\ndate-released: 2031-02-03\n" in texts[1]
    assert "year    = {2031}" in cited
    assert f"url     = {{{address}}}" in cited
    assert "example.org" not in "".join([*texts, cited])
