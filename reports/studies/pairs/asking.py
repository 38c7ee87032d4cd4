"""What each operation is: commands, in the words of their options."""

from __future__ import annotations

import contextlib
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from certpgo import CertPGOError, write
from certpgo.cli import main
from certpgo.graph import Instance
from reports.studies.pairs.graphs import between, drawn

#: Exit codes of answers; 1 and 2 are refusals.
CERTIFIED, ANSWERED = 0, (3, 4, 5)
#: Verdicts of rejections that are none.
UNCERTIFIED = re.compile(r"rejections are not certified: ([^\n]*)")


@dataclass(frozen=True)
class Way:
    """An operation.

    Attributes
    ----------
    commands : one after another; ``{g}`` is the graph's file, ``{o}`` a name for what is written
    takes_cost : whether the last command has ``--cost``
    wrong : whether one measurement is to be wrong by far
    suffix : of the file that it needs, if not any
    """

    commands: tuple[str, ...]
    takes_cost: bool = False
    wrong: bool = False
    suffix: str = ""


def _of(*commands: str, cost: bool = False, wrong: bool = False, suffix: str = "") -> Way:
    return Way(commands, cost, wrong, suffix)


OPERATIONS = {
    "info": _of("info {g}"),
    "solve": _of("solve {g}", cost=True),
    "certify": _of("solve {g} -o {o}.npz", "certify {g} {o}.npz", cost=True),
    "covariances": _of("solve {g} --covariances {o}.csv", cost=True),
    "regions": _of("solve {g} --regions {o}.csv", cost=True),
    "page": _of("solve {g} --html {o}.html", cost=True),
    "proof tier": _of("solve {g} --tier proof", cost=True),
    "proof": _of("solve {g} --proof {o}.cert", "check {g} {o}.cert", cost=True),
    "robust": _of("solve {g} --robust", cost=True, wrong=True),
    "robust proof": _of(
        "solve {g} --robust --proof {o}.cert", "check {g} {o}.cert", cost=True, wrong=True
    ),
    "outliers": _of("outliers {g}", cost=True, wrong=True),
    "follow": _of("follow {g}", cost=True),
    "robust follow": _of("follow {g} --robust", cost=True, wrong=True),
    "compare": _of("compare {g} --methods certified,newton -o {o}", cost=True),
    "bounds": _of("bounds {g}"),
    "diagnose": _of("diagnose {g}", cost=True, wrong=True),
    "merge": _of("merge {g} {g} --offset 1000 --between {j}"),
    "robust merge": _of("merge {g} {g} --offset 1000 --between {j} --robust"),
    "sparsify": _of("sparsify {g} --keep 50%"),
    "suggest": _of("suggest {g}"),
    "write npz": _of("convert {g} {o}.npz"),
    "write g2o": _of("convert {g} {o}.g2o"),
    "write pyfg": _of("convert {g} {o}.pyfg"),
}


@dataclass(frozen=True)
class Asked:
    """A pair: kinds, an operation, and a cost where it is not the graph's own."""

    group: str
    kinds: tuple[str, ...]
    operation: str
    cost: str = ""


@dataclass(frozen=True)
class Answer:
    """``certified``, ``answered``, ``refused`` or ``broken``, and what was said."""

    how: str
    said: str = ""


def answered(one: Asked, folder: Path, seed: int) -> Answer:
    """The weaker answer of those in the plane and in space."""
    found = [_answered(one, folder, seed, d) for d in (2, 3)]
    order = ["broken", "refused", "answered", "certified"]
    return min(found, key=lambda answer: order.index(answer.how))


def _answered(one: Asked, folder: Path, seed: int, d: int) -> Answer:
    way = OPERATIONS[one.operation]
    names = {"o": str(folder / "out")}
    try:
        whole = drawn(one.kinds, seed, d, wrong=way.wrong)
        names["g"] = str(_written(whole, folder / "graph"))
        if "{j}" in way.commands[-1]:
            names["j"] = str(_written(between(whole, 1000), folder / "between"))
    except CertPGOError as error:
        return Answer("refused", f"{error}")
    codes, text = [], ""
    for command in way.commands:
        words = [word.format(**names) for word in command.split()]
        if one.cost and command.split()[0] != "check":
            words += ["--cost", one.cost]
        code, text = _run(words)
        codes.append(code)
        if code in (1, 2):
            return Answer("refused", _short(text, folder))
    uncertified = UNCERTIFIED.search(text)
    if uncertified:
        return Answer("refused", uncertified[1])
    if set(codes) <= {CERTIFIED}:
        return Answer("certified")
    good = set(codes) <= {CERTIFIED, *ANSWERED}
    return Answer("answered" if good else "broken", f"{codes}: {_short(text, folder)}")


def _run(words: Sequence[str]) -> tuple[int, str]:
    """The exit code of a command, and the last lines that it printed on either stream."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main(words)
        except Exception as error:  # what is no message is a fault
            return -1, f"{type(error).__name__}: {error}"
    return code, err.getvalue() if code in (1, 2) else out.getvalue()


def _short(text: str, folder: Path) -> str:
    """The last line, without names of files."""
    lines = [line for line in text.strip().splitlines() if line.strip()]
    said = lines[-1] if lines else ""
    said = re.sub(rf"{re.escape(str(folder))}/\S*?:? ", "", said)
    return re.sub(r"^(error|certpgo): ", "", said).replace("|", "/")


def _written(whole: Instance, path: Path) -> Path:
    """A file that holds a graph: a g2o file where that does."""
    with contextlib.suppress(CertPGOError):
        write(path.with_suffix(".g2o"), whole)
        return path.with_suffix(".g2o")
    write(path.with_suffix(".npz"), whole)
    return path.with_suffix(".npz")
