"""CSV and LaTeX, by hand and to the byte."""

import csv
import io

import pytest

from reports.harness.experiments.journal import from_line, to_line
from reports.harness.experiments.records import Record
from reports.harness.experiments.spec import Column, Method, Row, Table
from reports.harness.rendering.formats import forms
from reports.harness.rendering.formats.latex import escaped, numbered

COLUMNS = (Column("cost", "F_1", ".2e"), Column("verdict", "verdict"), Column("seconds", "s"))


def table(**more):
    methods = (Method("m", "50 % & more"), Method("other"))
    return Table("t", "A_title", (Row("a"),), methods, COLUMNS, notes=("50 %.",), **more)


def record(method="50 % & more", **more):
    return Record(
        "t",
        "a",
        method,
        **{"d": 3, "n": 4, "m": 5, "metrics": {"cost": 0.1 + 0.2}, **more},
        key=f"{method}/{more.get('seed')}",
    )


RECORDS = (
    record(verdict="CERTIFIED", seconds={"x": 0.25, "y": 0.5}),
    record("other", absence="failed", error='no, "x"'),
)


def test_csv_to_the_byte():
    assert forms()["csv"].render(table(), RECORDS) == (
        "row,part,seed,instances,d,n,m,method,cost,verdict,seconds,error\n"
        "a,,,1,3,4,5,50 % & more,0.30000000000000004,CERTIFIED,0.75,\n"
        'a,,,1,3,4,5,other,0.30000000000000004,,,"no, ""x"""\n'
    )


def test_latex_to_the_byte():
    assert forms()["tex"].render(table(), RECORDS).split("\n") == [
        r"% needs \usepackage{booktabs,longtable}",
        r"\begin{longtable}{@{}lrlll@{}}",
        r"\caption{A\_title}\label{tab:t}\\",
        r"\toprule",
        r"method & F\_1 & verdict & s & not run or failed \\",
        r"\midrule",
        r"\endhead",
        r"\bottomrule",
        r"\endlastfoot",
        r"\multicolumn{5}{@{}l}{\textit{a (4 nodes, 5 edges, 3D)}}\\",
        r"50 \% \& more & $3.00\times 10^{-1}$ & CERTIFIED & 0.750 (x 0.250, y 0.500) &  \\",
        r'other & $3.00\times 10^{-1}$ &  &  & no, "x" \\',
        r"\end{longtable}",
        "",
        r"\noindent 50 \%.",
        "",
    ]


def test_csv_of_a_summary_has_quartiles_and_no_seed():
    records = [record(metrics={"cost": value}, seed=k) for k, value in enumerate((1.0, 2.0, 4.0))]
    [line] = csv.DictReader(io.StringIO(forms()["csv"].render(table(summary="median"), records)))
    assert (line["cost"], line["cost.lower"], line["cost.upper"]) == ("2.0", "1.5", "3.0")
    assert (line["seed"], line["instances"]) == ("", "3")


@pytest.mark.parametrize("suffix", sorted(forms()))
@pytest.mark.parametrize("summary", ["", "mean", "median"])
def test_the_same_records_give_the_same_bytes(suffix, summary):
    render = forms()[suffix].render
    again = [from_line(to_line(one), Record) for one in RECORDS]
    assert render(table(summary=summary), again) == render(table(summary=summary), RECORDS)


@pytest.mark.parametrize("suffix", sorted(forms()))
def test_no_records_are_no_error(suffix):
    assert forms()[suffix].render(table(), ()).endswith("\n")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (r"a_b & 5% of #3 {x} $y$", r"a\_b \& 5\% of \#3 \{x\} \$y\$"),
        ("~^\\", r"\textasciitilde{}\textasciicircum{}\textbackslash{}"),
        ("F* >= <b> |L|", r"F* \textgreater{}= \textless{}b\textgreater{} \textbar{}L\textbar{}"),
    ],
)
def test_what_tex_would_act_upon_is_harmless(words, expected):
    assert escaped(words) == expected


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("1.5", "1.5"),
        ("-1.5", "$-1.5$"),
        ("1.58e+00", "1.58"),
        ("1.20e-05", r"$1.20\times 10^{-5}$"),
        ("-5e+10 (1e-3 to 2)", r"$-5\times 10^{10}$ ($1\times 10^{-3}$ to 2)"),
        ("3D, v1.2-3, x_1e-5", r"3D, v1.2-3, x\_1e-5"),
        ("gap -2.5e-07; s 1.0", r"gap $-2.5\times 10^{-7}$; s 1.0"),
    ],
)
def test_numbers_are_set_as_mathematics(words, expected):
    assert numbered(words) == expected
