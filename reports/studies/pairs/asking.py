"""What each operation is: commands, in the words of their options."""

from __future__ import annotations

import contextlib
import io
import re
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from certpgo import CertPGOError, write
from certpgo.cli import main
from certpgo.graph.held import with_held
from reports.studies.pairs.graphs import between, drawn

#: Exit codes of answers, and of what is refused: a proof that is not found is one.
CERTIFIED, ANSWERED, REFUSED = 0, (3, 4, 5), (1, 2, 6)
#: What is said where a file's format has no record of something.
NO_RECORD = re.compile(r"^only .* files? .*holds? |^pyfg (holds|has) |^g2o has ")
#: Verdicts of rejections that are none.
UNCERTIFIED = re.compile(r"rejections are not certified: ([^\n]*)")
UNPROVEN = re.compile(r"no proof was written to \S*: ([^\n]*)")


@dataclass(frozen=True)
class Way:
    """An operation.

    Attributes
    ----------
    commands : one after another; ``{g}`` is the graph's file, ``{o}`` a name for what is written
    takes_cost : whether the last command has ``--cost``
    wrong : whether one measurement is to be wrong by far
    """

    commands: tuple[str, ...]
    takes_cost: bool = False
    wrong: bool = False


def _of(*commands: str, cost: bool = False, wrong: bool = False) -> Way:
    return Way(commands, cost, wrong)


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
    """``certified``, ``answered``, ``unwritten``, ``refused`` or ``broken``, and what was said.

    Unwritten is what a file's format has no record of.
    """

    how: str
    said: str = ""


def answered(one: Asked, folder: Path, seed: int) -> Answer:
    """The weaker answer of those in the plane and in space."""
    found = [_answered(one, folder, seed, d) for d in (2, 3)]
    order = ["broken", "refused", "unwritten", "answered", "certified"]
    return min(found, key=lambda answer: order.index(answer.how))


def _answered(one: Asked, folder: Path, seed: int, d: int) -> Answer:
    """The answer for a g2o file, where that holds the graph, or else for an archive."""
    for suffix in (".g2o", ".npz"):
        for path in folder.iterdir():  # an answer is not that of another question
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        found = _asked(one, folder, seed, d, suffix)
        if found.how not in ("refused", "unwritten"):
            return found
    return found


def _asked(one: Asked, folder: Path, seed: int, d: int, suffix: str) -> Answer:
    way = OPERATIONS[one.operation]
    names = {"o": str(folder / "out")}
    try:
        whole = drawn(one.kinds, seed, d, wrong=way.wrong)
        path = folder / "graph.npz"
        if suffix == ".g2o":
            with contextlib.suppress(CertPGOError):
                write(folder / "graph.g2o", whole)
                path = folder / "graph.g2o"
        if path.suffix == ".npz":
            # As by `certpgo convert --constraints`.
            held = whole if suffix == ".g2o" else replace(with_held(whole), released=None)
            write(path, held)
        names["g"] = str(path)
        if "{j}" in way.commands[-1]:
            names["j"] = str(folder / "between.npz")
            write(folder / "between.npz", between(whole, 1000))
    except CertPGOError as error:
        return Answer("refused", f"{error}")
    codes, text = [], ""
    for command in way.commands:
        words = [word.format(**names) for word in command.split()]
        if one.cost and command.split()[0] != "check":
            words += ["--cost", one.cost]
        code, text = _run(words)
        codes.append(code)
        if code in REFUSED:
            said = UNPROVEN.search(text)
            message = said[1] if said else _short(text, folder)
            unwritten = command.startswith("convert") and NO_RECORD.match(message)
            return Answer("unwritten" if unwritten else "refused", message)
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
    return code, err.getvalue() if code in REFUSED else out.getvalue()


def _short(text: str, folder: Path) -> str:
    """The last line, without names of files."""
    lines = [line for line in text.strip().splitlines() if line.strip()]
    said = lines[-1] if lines else ""
    said = re.sub(rf"{re.escape(str(folder))}/\S*?:? ", "", said)
    return re.sub(r"^(error|certpgo): ", "", said).replace("|", "/")
