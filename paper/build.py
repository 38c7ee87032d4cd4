"""The manuscript, from the note it reports and the records that its tables are of.

``make paper`` writes ``build/paper/manuscript.pdf`` and ``build/paper/paper.pdf``. It needs pandoc
and LaTeX: Debian's packages pandoc, texlive-latex-base and texlive-latex-recommended.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from certpgo.view.markdown_tables import markdown_table
from reports.harness.experiments.journal import latest, read_entries
from reports.harness.experiments.records import Record
from reports.harness.experiments.zoo_records import Outcome, ZooRecord, total
from reports.harness.rendering.formats.latex import numbered
from reports.harness.speed.measuring import SpeedRecord

HERE = Path(__file__).parent
ROOT = HERE.parent
RESULTS = ROOT / "reports" / "results"
NOTE = ROOT / "docs" / "notes" / "certificates_for_any_cost.md"
SOFTWARE_PAPER = HERE / "paper.md"
BENCHMARKS = ROOT / "docs" / "benchmarks.md"
OUT = ROOT / "build" / "paper"

#: The section of the note in whose place the manuscript has one of its own.
REPLACED = "Related work"
#: How often LaTeX runs: for references to settle, with BibTeX after the first.
RUNS = 3
#: What the tables call a certifier.
CERTIFIERS = {
    "certpgo standard": "certpgo, standard tier",
    "certpgo proof": "certpgo, proof tier",
    "se_sync_rule": "SE-Sync's rule",
    "cora_rule": "CORA's rule",
    "gtsam_shonan": "GTSAM, Shonan averaging",
    "gtsam_staircase": "GTSAM, Riemannian staircase",
}
#: Whose costs the table of optima is of.
WHOSE = ("g2o", "GTSAM")
#: What stands above the headers of tables.
ABOVE = {
    "optima": rf"& & & \multicolumn{{3}}{{c}}{{{WHOSE[0]}'s cost}} "
    rf"& \multicolumn{{3}}{{c}}{{{WHOSE[1]}'s cost}} \\"
    r"\cmidrule(lr){4-6}\cmidrule(lr){7-9}",
    "regions": r"& & \multicolumn{3}{c}{chordal cost} & \multicolumn{3}{c}{g2o's cost} \\"
    r"\cmidrule(lr){3-5}\cmidrule(lr){6-8}",
}
#: The columns of the table of times, by cost and what it is compared with.
COSTS = {
    ("g2o", "g2o's Gauss-Newton"): "g2o's cost / g2o",
    ("gtsam", "GTSAM"): "GTSAM's cost / GTSAM",
    ("chordal", "GTSAM, isotropic weights"): "chordal cost / GTSAM",
}
#: The rows of the documentation's tables that hold the same numbers: how often certifiers are
#: false, with what stands before each certifier's, and times.
FALSE_ROW = "false certificates / points tested"
FALSE_CELLS = (
    {"certpgo standard": ""},
    {"se_sync_rule": "its rule: "},
    {"gtsam_shonan": "Shonan: ", "gtsam_staircase": "staircase: "},
    {"cora_rule": "its rule: "},
)
TIME_ROWS = {
    "g2o's cost, the default, over g2o's": ("g2o", "g2o's Gauss-Newton"),
    "GTSAM's cost, over GTSAM's": ("gtsam", "GTSAM"),
    "chordal cost, over GTSAM's": ("chordal", "GTSAM, isotropic weights"),
    "chordal cost, over SE-Sync, which certifies": ("chordal", "SE-Sync"),
}


def main() -> int:
    """Write tables and PDFs; 1 where a program is missing or fails."""
    SOFTWARE_PAPER.write_text(filled(SOFTWARE_PAPER.read_text()))
    BENCHMARKS.write_text(benchmarks(BENCHMARKS.read_text()))
    missing = [name for name in ("pandoc", "pdflatex", "bibtex") if shutil.which(name) is None]
    if missing:
        print(
            f"make paper needs {', '.join(missing)}; in Debian: apt-get install pandoc "
            "texlive-latex-base texlive-latex-recommended",
            file=sys.stderr,
        )
        return 1
    OUT.mkdir(parents=True, exist_ok=True)
    for name, (header, rows) in tables().items():
        (OUT / f"{name}.tex").write_text(tabular(header, rows, ABOVE.get(name, "")))
    (OUT / "numbers.tex").write_text(numbers())
    (OUT / "body.tex").write_text(body(NOTE.read_text()))
    for name in ("manuscript.tex", "related.tex", "cycles.tex", "paper.bib"):
        shutil.copy(HERE / name, OUT / name)
    said = [_latex("manuscript"), _of_journal()]
    for problem in filter(None, said):
        print(problem, file=sys.stderr)
    return 1 if any(said) else 0


def tables() -> dict[str, tuple[Sequence[str], list[Sequence[str]]]]:
    """Header and rows of each table, by its name."""
    return {
        "optima": optima(),
        "certifiers": certifiers(),
        "times": times(),
        "regions": regions(),
        "cycles_table": cycles(),
    }


def filled(text: str) -> str:
    """The software paper with the tables of the records between its marks."""
    for name, (header, rows) in tables().items():
        table = "\n".join(["", *markdown_table(header, rows), ""])
        marks = f"(<!-- {name} -->\n).*?(<!-- /{name} -->)"
        text = re.sub(marks, lambda m, table=table: f"{m[1]}{table}\n{m[2]}", text, flags=re.DOTALL)
    return text


def benchmarks(text: str) -> str:
    """The documentation's page with the numbers of the records in the rows that hold them."""
    ratios, false = _ratios(), {title: cells for title, *cells in certifiers()[1]}
    titles: list[str] = []
    lines = text.split("\n")
    for k, line in enumerate(lines):
        first, *others = [cell.strip() for cell in line.strip("|").split("|")]
        if k + 1 < len(lines) and lines[k + 1].startswith("|---"):
            titles = others
        if first == FALSE_ROW:
            cells = [_false(false, of) for of in FALSE_CELLS]
        elif first in TIME_ROWS:
            cells = [_two_digits(ratios.get((graph, TIME_ROWS[first]))) for graph in titles]
        else:
            continue
        lines[k] = re.sub(" +", " ", f"| {' | '.join([first, *cells])} |")
    return "\n".join(lines)


def _false(false: dict[str, list[str]], before: dict[str, str]) -> str:
    """Of each certifier: how often it is false, of how many points; none in bold."""
    said = []
    for name, prefix in before.items():
        tested, _, wrong = false[CERTIFIERS[name]]
        said.append(f"{prefix}{'**0**' if wrong == '0' else wrong} / {tested}")
    return ", ".join(said)


def optima() -> tuple[Sequence[str], list[Sequence[str]]]:
    """Optima under g2o's and GTSAM's costs, of ``own_cost``."""
    records = latest(read_entries(RESULTS / "own_cost.jsonl", Record))
    by_graph: dict[str, dict[tuple[str, str], Record]] = {}
    for record in records:
        graph = record.row.partition(", ")[0]
        by_graph.setdefault(graph, {})[record.objective, record.method] = record
    rows = [row for graph, of in by_graph.items() if (row := _optimum(graph, of))]
    each = ("optimum", "gap", "chordal")
    return ("graph", "$n$", "$m$", *each * len(WHOSE)), rows


def numbers() -> str:
    """What the text says of optima and regions, as commands of LaTeX."""
    records = latest(read_entries(RESULTS / "own_cost.jsonl", Record))
    ours = [
        record
        for record in records
        for cost, who in zip(("g2o", "gtsam"), WHOSE, strict=True)
        if (record.objective, record.method) == (cost, f"optimum of {who}'s cost")
        and "cost" in record.metrics
    ]
    left = [r for r in ours if r.verdict != "CERTIFIED"]
    tallies = _of_regions()["campaign"].values()
    by_cycles = [row["proven"] for row in _of_cycles().values()]
    said = {
        "ofGraphs": len({r.row.partition(", ")[0] for r in ours}),
        "openGtwoo": sum(r.objective == "g2o" for r in left),
        "openGTSAM": sum(r.objective == "gtsam" for r in left),
        "slowest": f"{max(r.metrics['total_seconds'] for r in ours if r not in left):.1f}",
        "regionChecks": f"{sum(tally['checks'] for tally in tallies):,}",
        "regionsOutside": sum(tally["outside"] for tally in tallies),
        "cyclesProven": sum(by_cycles),
        "cyclesTried": len(by_cycles),
    }
    return "".join(f"\\newcommand{{\\{name}}}{{{value}}}\n" for name, value in said.items())


def _optimum(graph: str, of: dict[tuple[str, str], Record]) -> Sequence[str] | None:
    cells: list[str] = []
    size: tuple[str, str] | None = None
    for cost, who in zip(("g2o", "gtsam"), WHOSE, strict=True):
        found, chordal = of.get((cost, f"optimum of {who}'s cost")), of.get((cost, "optimum of F"))
        if found is None or "cost" not in found.metrics:
            return None
        size = f"{found.n:,}", f"{found.m:,}"
        value = found.metrics["cost"]
        shown = f"{value:.7g}" if found.verdict == "CERTIFIED" else f"{value:.7g}*"
        other = chordal.metrics.get("cost") if chordal is not None else None
        ratio = "" if other is None or value < 1e-9 else f"{other / value:.4g}"
        cells += [shown, f"{found.metrics['relative_gap']:.0e}", ratio]
    return None if size is None else (graph, *size, *cells)


def certifiers() -> tuple[Sequence[str], list[Sequence[str]]]:
    """False certificates, of the zoo."""
    counts = total(latest(read_entries(RESULTS / "zoo.jsonl", ZooRecord)))
    rows: list[Sequence[str]] = []
    asked = counts.points["all"]
    for name, title in CERTIFIERS.items():
        outcomes = counts.of(name)
        tested = asked - outcomes[Outcome.REFUSED] - outcomes[Outcome.NOT_INSTALLED]
        numbers = (tested, outcomes[Outcome.CERTIFIED], outcomes[Outcome.FALSE])
        rows.append((title, *(f"{number:,}" for number in numbers)))
    return ("certifier", "points tested", "certified", "of these false"), rows


def times() -> tuple[Sequence[str], list[Sequence[str]]]:
    """Seconds to a certified answer over those of Gauss-Newton in other programs."""
    found = _ratios()
    graphs = list(dict.fromkeys(graph for graph, both in found if both in COSTS))
    rows: list[Sequence[str]] = [
        (graph, *(_two_digits(found.get((graph, both))) for both in COSTS)) for graph in graphs
    ]
    return ("graph", *COSTS.values()), rows


def _ratios() -> dict[tuple[str, tuple[str, str]], float | None]:
    """Ratios of times by graph, and by cost and what it is compared with."""
    records = latest(read_entries(RESULTS / "speed.jsonl", SpeedRecord))
    return {
        (record.subject, (cost, other)): record.ratio
        for record in records
        for cost, other in {*COSTS, *TIME_ROWS.values()}
        if record.section == "solving"
        and (record.what, record.against) == (f"solve, cost {cost}", other)
    }


def regions() -> tuple[Sequence[str], list[Sequence[str]]]:
    """Widths of regions over those of covariances, and times, of ``certified_regions``."""
    found = {(row["graph"], row["cost"]): row for row in _of_regions()["widths"]}
    rows: list[Sequence[str]] = []
    for graph in dict.fromkeys(graph for graph, _ in found):
        cells = [f"{found[graph, 'chordal']['poses']:,}"]
        for cost in ("chordal", "g2o"):
            row = found.get((graph, cost))
            widths = ("", "") if row is None else (_both(row["metres"]), _both(row["degrees"]))
            cells += [*widths, _two_digits(row and row["time"])]
        rows.append((graph, *cells))
    return ("graph", "$n$", *("position", "angle", "time") * 2), rows


def cycles() -> tuple[Sequence[str], list[Sequence[str]]]:
    """Proofs of rotations by cycles, of ``cycle_proofs``."""
    header = ("graph", "$n$", "$m$", "residual", "ratio", "cycles", "gap", "check, s", "file, kB")
    rows: list[Sequence[str]] = [
        (
            name.removesuffix("_SO3").replace("_", " "),
            f"{of['nodes']:,}",
            f"{of['edges']:,}",
            f"{of['residual']:.1f}",
            f"{of['ratio']:.3g}" if of["solved"] else "",
            f"{of['cycles']:,}",
            f"{1.0 - of['lower_bound'] / of['cost']:.0e}",
            f"{of['check_seconds']:.1f}",
            f"{of['bytes'] / 1e3:,.0f}",
        )
        for name, of in _of_cycles().items()
    ]
    return header, rows


def _of_cycles() -> dict[str, Any]:
    """The records of ``reports.studies.cycle_proofs``."""
    read: dict[str, Any] = json.loads((RESULTS / "cycle_proofs.json").read_text())
    return read


def _of_regions() -> dict[str, Any]:
    """The records of ``reports.studies.certified_regions``."""
    read: dict[str, Any] = json.loads((RESULTS / "certified_regions.json").read_text())
    return read


def _both(ratios: Sequence[float] | None) -> str:
    """Median and largest."""
    return "" if ratios is None else " / ".join(f"{ratio:.2f}" for ratio in ratios)


def _two_digits(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"


def body(note: str) -> str:
    """The note's sections as LaTeX, its table of optima that of the records."""
    sections = re.split(r"^## (?:\d+\. )?", note, flags=re.MULTILINE)[1:]
    kept = []
    for section in sections:
        title, _, text = section.partition("\n")
        if title == REPLACED:
            kept.append(raw("\\input{related}"))
        else:
            kept.append(f"# {title}\n{text}")
    text = "\n\n".join(kept)
    text = re.sub(OF_OPTIMA, lambda _: raw(OPTIMA) + "\n\n", text, flags=re.DOTALL | re.MULTILINE)
    text = text.replace("\n### ", "\n## ")
    text = re.sub(r"(?<!\!)\[([^\]\[$]+)\]\([^)\s]+\)", r"\1", text)  # links lead out of a paper
    return latex_of(environments(text))


#: The note's own table of optima, and what the manuscript says in its place.
OF_OPTIMA = r"^\| graph \| cost \| optimum f .*?\n\n"
OPTIMA = """\
Table~\\ref{tab:optima} lists them; \\emph{gap} is relative, and \\emph{chordal} is the cost of the
optimum of the chordal cost in units of the optimum. A star marks optima that are not certified, of
which the gap bounds the error."""


def raw(latex: str) -> str:
    """A paragraph that pandoc leaves alone."""
    return f"```{{=latex}}\n{latex}\n```"


def environments(markdown: str) -> str:
    """Theorems and proofs as the environments of amsthm."""
    parts = []
    for paragraph in re.split(r"\n\n+", markdown):
        parts += _of_theorem(paragraph)
    return "\n\n".join(_closed(parts))


def _of_theorem(paragraph: str) -> Iterator[str]:
    """The paragraph, with marks where a theorem or a proof begins and ends."""
    statement, proof, rest = paragraph.partition("*Proof.*")
    if statement.startswith(("**Theorem", "**Lemma")):
        head, statement = re.fullmatch(r"\*\*(\w+)[^*]*\*\*(.*)", statement, re.DOTALL).groups()
        yield BEGIN[head]
    if statement.strip():
        yield statement.strip()
    if proof:
        yield BEGIN["Proof"]
        yield rest.strip()


#: What opens an environment, and where it closes: a theorem where its proof opens.
BEGIN = {name: f"\0begin {name.lower()}" for name in ("Theorem", "Lemma", "Proof")}
QED = "$\\square$"


def _closed(parts: Iterable[str]) -> Iterator[str]:
    """The parts, with environments opened and closed."""
    inside = ""
    for part in parts:
        if part.startswith("\0begin "):
            if inside:
                yield raw(f"\\end{{{inside}}}")
            inside = part.removeprefix("\0begin ")
            yield raw(f"\\begin{{{inside}}}")
        elif inside == "proof" and QED in part:
            yield part.replace(QED, "")
            yield raw(f"\\end{{{inside}}}")
            inside = ""
        elif inside in ("theorem", "lemma"):
            yield re.sub(r"^\*(?!\*)|(?<!\*)\*$", "", part)
        else:
            yield part


def tabular(header: Sequence[str], rows: Iterable[Sequence[str]], above: str = "") -> str:
    """A table as LaTeX, the first column to the left and the others to the right.

    Parameters
    ----------
    above : lines of LaTeX above the header
    """
    lines = [" & ".join(map(_cell, row)) + r" \\" for row in (header, *rows)]
    kinds = "l" + "r" * (len(header) - 1)
    body = [lines[0], r"\midrule", *lines[1:]]
    return "\n".join(
        [
            rf"\begin{{tabular}}{{{kinds}}}",
            r"\toprule",
            above,
            *body,
            r"\bottomrule",
            r"\end{tabular}",
            "",
        ]
    )


def _cell(text: str) -> str:
    return text if text.startswith("$") else numbered(text)


def latex_of(markdown: str) -> str:
    """Markdown as LaTeX, by pandoc."""
    command = ["pandoc", "-f", "markdown-auto_identifiers", "-t", "latex", "--wrap=preserve"]
    done = subprocess.run(command, input=markdown, capture_output=True, text=True, check=True)
    return done.stdout


def _latex(name: str) -> str:
    """Typeset a file of `OUT`; what went wrong, or nothing."""
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", f"{name}.tex"]
    for run in range(RUNS):
        done = subprocess.run(command, cwd=OUT, capture_output=True, text=True, check=False)
        if done.returncode:
            return f"{name}.tex: " + done.stdout[-2000:]
        if run == 0:
            cited = subprocess.run(
                ["bibtex", name], cwd=OUT, capture_output=True, text=True, check=False
            )
            if cited.returncode:
                return f"{name}.bib: " + cited.stdout
    log = (OUT / f"{name}.log").read_text(errors="replace")
    return "\n".join(re.findall(r".*undefined.*", log))


def _of_journal() -> str:
    """Typeset the software paper, without the journal's style; what went wrong, or nothing."""
    command = ["pandoc", "paper.md", "--citeproc", "--bibliography", "paper.bib"]
    command += ["-V", "geometry:margin=25mm", "-V", "fontfamily=amsfonts", "-V", "fontenc=OT1"]
    command += ["-o", str(OUT / "paper.pdf")]
    done = subprocess.run(command, cwd=HERE, capture_output=True, text=True, check=False)
    return done.stderr


if __name__ == "__main__":
    sys.exit(main())
