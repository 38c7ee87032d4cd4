"""The papers: their tables are the records', their citations exist, and the note becomes LaTeX."""

import json
import re
import shutil

import pytest

from paper import build

PAPER = build.SOFTWARE_PAPER.read_text(encoding="utf-8")
ENTRIES = set(re.findall(r"^@\w+\{(\w+),", (build.HERE / "paper.bib").read_text(), re.MULTILINE))


def test_tables_of_the_software_paper_are_those_of_the_records():
    assert build.filled(PAPER) == PAPER
    for name in ("certifiers", "times"):
        assert f"<!-- {name} -->\n\n|" in PAPER


def test_numbers_that_appear_again_come_from_the_same_generator():
    page = build.BENCHMARKS.read_text(encoding="utf-8")
    assert build.benchmarks(page) == page
    assert all(f"| {label} |" in page for label in (build.FALSE_ROW, *build.TIME_ROWS))
    certified = {title: certified for title, _, certified, _ in build.certifiers()[1]}
    readme = (build.ROOT / "README.md").read_text(encoding="utf-8")
    assert f"{certified['certpgo, standard tier']} certificates" in readme


def test_the_software_paper_has_its_sections_and_length():
    sections = re.findall(r"^# (.*)$", PAPER, re.MULTILINE)
    assert {"Summary", "Statement of need", "State of the field"} <= set(sections)
    assert 750 <= len(PAPER.split()) <= 1750


def test_what_is_cited_is_listed_and_the_other_way_round():
    latex = "".join(path.read_text() for path in build.HERE.glob("*.tex"))
    cited = set(re.findall(r"@(\w+\d{4}\w*)", PAPER))
    cited |= {key for keys in re.findall(r"\\cite\{([^}]*)\}", latex) for key in keys.split(",")}
    assert cited == ENTRIES


def test_prose_that_holds_numbers_holds_those_of_the_records():
    header, rows = build.optima()
    [mit] = [row for row in rows if row[0] == "MIT"]
    ratios = [float(mit[k]) for k, name in enumerate(header) if name == "chordal"]
    said = "more than 56 times"
    assert min(ratios) > 56
    manuscript = (build.HERE / "manuscript.tex").read_text()
    assert said in PAPER
    assert said in manuscript
    numbers = dict(re.findall(r"newcommand\{\\(\w+)\}\{([^}]*)\}", build.numbers()))
    assert set(numbers) <= set(re.findall(r"\\(\w+)", manuscript))
    assert int(numbers["ofGraphs"]) == len(rows)


def test_proofs_by_cycles_are_those_of_the_study():
    header, rows = build.cycles()
    records = json.loads((build.RESULTS / "cycle_proofs.json").read_text())
    assert len(rows) == len(records)
    [mit] = [dict(zip(header, row, strict=True)) for row in rows if row[0] == "MIT"]
    assert (mit["ratio"], mit["cycles"]) == (
        f"{records['MIT']['ratio']:.3g}",
        str(records["MIT"]["cycles"]),
    )
    for row, of in zip(rows, records.values(), strict=True):
        assert not of["proven"] or float(row[header.index("ratio")]) < 1.0
    assert "\\input{cycles}" in (build.HERE / "manuscript.tex").read_text()


def test_theorems_and_proofs_become_environments():
    note = "**Theorem 7.** *Let $a^* > 0$. Then*\n\n$$ a^* > 0 $$\n\n"
    note += "*too.* *Proof.* Yes. $\\square$\n\nOn."
    assert build.environments(note).split("\n\n") == [
        build.raw("\\begin{theorem}"),
        "Let $a^* > 0$. Then",
        "$$ a^* > 0 $$",
        "too.",
        build.raw("\\end{theorem}"),
        build.raw("\\begin{proof}"),
        "Yes. ",
        build.raw("\\end{proof}"),
        "On.",
    ]


@pytest.mark.skipif(shutil.which("pandoc") is None, reason="pandoc is not installed")
def test_every_theorem_of_the_note_is_in_the_manuscript():
    note = build.NOTE.read_text(encoding="utf-8")
    latex = build.body(note)
    count = len(re.findall(r"^\*\*Theorem", note, re.MULTILINE))
    assert latex.count("\\begin{theorem}") == latex.count("\\end{theorem}") == count
    assert latex.count("\\begin{proof}") == latex.count("\\end{proof}") == note.count("*Proof.*")
    assert "| graph | cost | optimum f" not in latex
    assert "\\input{related}" in latex
