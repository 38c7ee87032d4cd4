"""The site names what there is: links lead somewhere, and nothing public has been left out."""

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import certpgo
from certpgo import registry
from certpgo.cli import command_names

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
#: Folders that a build fills, and what fills them.
MADE = {
    DOCS / "lessons": ROOT / "reports" / "lessons",
    DOCS / "results": ROOT / "reports" / "results",
}
#: What is made beside the methods' pages.
LISTS = ("baselines", "overview", "shared-settings")
FENCE = re.compile(r"^(`{3,}|~{3,}).*?^\1\s*$", re.M | re.S)
LINK = re.compile(r"\]\(<?([^)<>\s#]*)(?:#[^)\s]*)?>?\)")


def pages():
    """The pages that are written, not made."""
    reference = DOCS / "reference"
    made = {DOCS / "results", reference / "cli", reference / "methods", reference / "combinations"}
    return [page for page in sorted(DOCS.rglob("*.md")) if page.parent not in made]


def is_there(place):
    """Whether a page or file is there, or will be made by a build."""
    source = MADE.get(place.parent)
    if source is not None and any(source.glob(f"{place.name}*")):
        return True
    if place.parent == DOCS / "reference" / "cli":
        return place.stem in {*command_names(), "exit-codes"}
    if place.parent == DOCS / "reference" / "combinations":
        return place.stem in {"takes", "refused"}
    if place.parent == DOCS / "reference" / "methods":
        return place.stem in {*registry.solver_names(), *LISTS}
    return place.exists() or any(place.parent.glob(f"{place.name}.*"))


@pytest.mark.parametrize("page", pages(), ids=lambda page: page.relative_to(DOCS).as_posix())
def test_links_lead_somewhere(page):
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    inner = [link for link in LINK.findall(text) if link and "://" not in link]
    named = re.findall(r"\{doc\}`(?:[^`<]*<)?([^`<>]+)>?`", text)
    pictures = re.findall(r"^`{3}\{(?:image|figure|include)\} (\S+)", page.read_text(), re.M)
    for link in (*inner, *named, *pictures):
        place = DOCS / link[1:] if link.startswith("/") else page.parent / link
        assert is_there(Path(os.path.normpath(place))), f"{page.name}: {link}"


def contents(page):
    """Entries of a page's tables of contents."""
    found = re.findall(r"^```\{toctree\}\n(.*?)^```", page.read_text(), re.M | re.S)
    lines = (line.strip() for fence in found for line in fence.splitlines())
    return [line for line in lines if line and not line.startswith(":")]


def test_every_lesson_is_in_the_index():
    lessons = {path.stem for path in (ROOT / "reports" / "lessons").glob("*.py")}
    assert lessons <= set(contents(DOCS / "lessons" / "index.md"))


def described(directive):
    """Full names that a directive of the reference describes."""
    names = []
    for page in (DOCS / "reference" / "api").glob("*.rst"):
        module = ""
        for word, argument in re.findall(r"^\.\. ([\w:]+):: (\S+)", page.read_text(), re.M):
            if word in {"module", "currentmodule"}:
                module = f"{argument}."
            elif re.fullmatch(directive, word):
                names.append(argument if argument.startswith("certpgo.") else module + argument)
    return names


def test_every_public_name_is_described_once():
    names = described("autoclass|autofunction|autoexception|autodata")
    assert {f"certpgo.{name}" for name in certpgo.__all__} <= set(names)
    assert len(names) == len(set(names))


def test_every_module_of_the_reference_is_there_and_once():
    names = described("automodule")
    assert all(importlib.util.find_spec(name) for name in names)
    assert len(names) == len(set(names))


def test_every_page_of_the_reference_is_in_its_contents():
    index = (DOCS / "reference" / "api" / "index.rst").read_text()
    listed = set(re.findall(r"^   (\w+)$", index, re.M))
    assert listed == {p.stem for p in (DOCS / "reference" / "api").glob("*.rst")} - {"index"}


@pytest.fixture
def made(monkeypatch):
    """The modules that make pages."""
    monkeypatch.syspath_prepend(str(DOCS))
    from extensions import commands, methods

    yield commands.pages(), methods.pages()
    for name in [name for name in sys.modules if name.partition(".")[0] == "extensions"]:
        del sys.modules[name]


def test_every_command_has_a_page_with_every_option(made):
    commands, _ = made
    assert {f"{name}.md" for name in command_names()} == {*commands} - {"exit-codes.md"}
    for name in ("--method", "--set KEY=VALUE", "--proof OUT", "--keep", "--data DIR"):
        assert name in commands["solve.md"]
    assert "| 4 | REFUTED |" in commands["exit-codes.md"]


def test_every_method_has_a_page(made):
    _, methods = made
    named = {name for name in registry.solver_names() if f"{name}.rst" in methods}
    assert named == set(
        re.findall(r"^\| \[`(\w+)`\]\(methods/\1\.rst\)", methods["overview.txt"], re.M)
    )
    listed = set(re.findall(r"^   \* - ``(\w+)``$", methods["baselines.rst"], re.M))
    assert named | listed == {*registry.solver_names()} - {"certified"}
    assert "certpgo.solve.methods.certified.Certified" in described("autoclass")


@pytest.mark.slow
def test_the_site_is_built_without_a_warning(tmp_path):
    for package in ("sphinx", "myst_nb", "furo", "jupytext"):
        pytest.importorskip(package, reason="the docs extra is not installed")
    options = ["-q", "-W", "--keep-going", "-n", "-D", "nb_execution_mode=off"]
    # The site's own theme copies all contents into each page, which takes as long again.
    options += ["-D", "html_theme=basic", "-D", "autodoc_preserve_defaults=0"]
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", *options, "-d", tmp_path / "trees", DOCS, tmp_path],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "reference" / "api" / "certpgo.html").is_file()
    pages = "".join(path.read_text() for path in tmp_path.rglob("*.html"))
    # Links of the sources that lead to the checkout's files lead to pages here.
    assert not re.search(r'href="[^":]*reports/(lessons|results)/', pages)
    assert (
        'href="../lessons/outliers.html"' in (tmp_path / "how-to/reject_outliers.html").read_text()
    )
    assert not re.search(r'<(script|link|img)[^>]*(src|href)="(https?:)?//', pages)
