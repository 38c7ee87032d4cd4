"""Checking the register: every proof that is kept, by the independent checkers."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from certpgo import checker, integer_checker
from certpgo.errors import SpecError
from certpgo.io.datasets.source import dataset
from certpgo.optima.register import Optimum, Register

#: What can become of a proof.
ACCEPTED, REFUSED, NOT_KEPT, NO_FILE, NO_PROOF = (
    "accepted",
    "REFUSED",
    "not kept",
    "graph not here",
    "no proof",
)


@dataclass(frozen=True)
class Checked:
    """What became of the proof of an optimum.

    Attributes
    ----------
    entry : the optimum
    result : ``"accepted"``, ``"REFUSED"``, ``"not kept"``, ``"graph not here"`` or ``"no proof"``
    detail : how it was checked, why it was refused, or the command that makes the proof again
    """

    entry: Optimum
    result: str
    detail: str


def verify(
    register: Register,
    find: Callable[[Optimum], Path | None],
    *,
    exact: bool = False,
) -> Iterator[Checked]:
    """Check every proof of a register that is kept, against its graph's file.

    Parameters
    ----------
    find : the file of a graph, or None; see `local_file`
    exact : whether to check in integers
    """
    for entry in register.optima:
        yield _checked(register, entry, find, exact)


def local_file(entry: Optimum, data: Path | None = None) -> Path | None:
    """The file that an optimum was computed from, if a dataset of its name has it here."""
    for name in entry.names:
        with suppress(SpecError):
            path = dataset(name, data).found
            if path is not None and _sha256(path) == entry.file_sha256:
                return path
    return None


def command(entry: Optimum) -> str:
    """The command that makes the proof of an optimum again."""
    return f"certpgo solve {entry.name} --cost {entry.cost} --proof {entry.proof_name}"


def _checked(
    register: Register, entry: Optimum, find: Callable[[Optimum], Path | None], exact: bool
) -> Checked:
    if entry.proof_sha256 is None:
        why = entry.unproven or f"there are no proof files about the cost of {entry.cost}"
        return Checked(entry, NO_PROOF, why)
    if not entry.kept:
        return Checked(entry, NOT_KEPT, command(entry))
    proof = register.proof(entry)
    if not proof.is_file() or _sha256(proof) != entry.proof_sha256:
        return Checked(entry, REFUSED, f"{proof.name} is missing, or not the registered file")
    path = find(entry)
    if path is None:
        return Checked(entry, NO_FILE, f"certpgo fetch {entry.name}")
    judge = integer_checker if exact else checker
    try:
        answer = judge.check(path, proof)
    except (checker.Refused, integer_checker.Refused) as reason:
        return Checked(entry, REFUSED, str(reason))
    except (checker.Unreadable, integer_checker.Unreadable) as reason:
        return Checked(entry, REFUSED, str(reason))
    if answer.upper > entry.upper or answer.lower < entry.lower:
        said = f"it proves {float(answer.lower):.17g} to {float(answer.upper):.17g} alone"
        return Checked(entry, REFUSED, said)
    return Checked(entry, ACCEPTED, "in integers" if exact else "in doubles")


def _sha256(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
