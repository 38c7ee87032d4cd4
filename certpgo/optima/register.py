"""The register: what is proven of public graphs, a line of JSON per graph and cost.

``register.jsonl`` holds computed numbers alone, ``remarks.toml`` what is said about graphs, and
``proofs`` the proof files that are small enough to keep.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, fields, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any

from certpgo.errors import FormatError, InputError
from certpgo.io.writing import write_whole
from certpgo.objective.costs import COSTS
from certpgo.optima.remarks import Remarks, read_remarks

#: What an optimum rests on, from weak to strong: a certificate of the standard tier; one of the
#: proof tier, or a proof file that the checker accepts; or one accepted in integers alone.
TIERS = ("standard", "proven", "exact")
#: Verdicts, from weak to strong.
VERDICTS = ("UNDECIDED", "BOUNDED", "CERTIFIED")
FILE, PROOFS = "register.jsonl", "proofs"


@dataclass(frozen=True)
class Sizes:
    """How large a graph is.

    Attributes
    ----------
    d : dimension of space
    poses, points, edges, ranges, priors : numbers; edges are all measurements but ranges, with
        priors and sightings of points
    """

    d: int
    poses: int
    points: int
    edges: int
    ranges: int
    priors: int


@dataclass(frozen=True)
class Optimum:
    """What is proven of the optimum of a graph under a cost.

    Attributes
    ----------
    names : of the graph; more than one for copies that circulate
    cost : ``"chordal"``, ``"g2o"`` or ``"gtsam"``
    digest, exact : see `certpgo.optima.fingerprint.Fingerprint`
    kind : ``"poses"`` or ``"rotations"``
    sizes : of the graph
    sources : where files with it are, ``OWNER/REPOSITORY@COMMIT:PATH``
    reading : options with which a file is read, other than the defaults
    file_sha256 : of the file that was solved, which the proof is about
    upper : cost of the best known estimate, rounded up
    lower : no estimate costs less
    verdict : of the certificate
    tier : ``"standard"``, ``"proven"`` or ``"exact"``: what it rests on
    chi2, freedom : chi^2 at the best estimate, and its degrees of freedom; None where they have no
        meaning
    proof_sha256, proof_bytes : of the proof file that the checker accepted; None without one
    kept : whether ``proofs`` holds it
    unproven : why there is no proof file, or empty
    version : of certpgo that made it
    """

    names: tuple[str, ...]
    cost: str
    digest: str
    exact: str
    kind: str
    sizes: Sizes
    sources: tuple[str, ...]
    reading: tuple[tuple[str, str], ...]
    file_sha256: str
    upper: float
    lower: float
    verdict: str
    tier: str
    chi2: float | None
    freedom: int | None
    proof_sha256: str | None
    proof_bytes: int | None
    kept: bool
    unproven: str
    version: str

    @property
    def name(self) -> str:
        """What the graph is called first."""
        return self.names[0]

    @property
    def gap(self) -> float:
        """How far apart the bounds are."""
        return self.upper - self.lower

    @property
    def relative_gap(self) -> float:
        """The gap over the upper bound; 0 for an optimum of 0."""
        return self.gap / self.upper if self.upper > 0.0 else 0.0

    @property
    def proof_name(self) -> str:
        """File name of its proof."""
        return f"{self.name}.{self.cost}.cert"

    def improved_by(self, other: Optimum) -> bool:
        """Whether another one of the same problem is better: no weaker in anything that counts.

        A stronger tier counts most, as long as the verdict is no weaker; within a tier, an estimate
        that costs less or a higher bound, neither at the expense of the other.
        """
        if VERDICTS.index(other.verdict) < VERDICTS.index(self.verdict):
            return False
        if other.tier != self.tier:
            return TIERS.index(other.tier) > TIERS.index(self.tier)
        if other.upper > self.upper or other.lower < self.lower:
            return False
        return other.upper < self.upper or other.lower > self.lower


@dataclass(frozen=True)
class Absent:
    """Why there is no optimum of a graph under a cost."""

    name: str
    cost: str
    reason: str


class Register:
    """A folder with optima, their proofs and remarks.

    Parameters
    ----------
    folder : by default the one that the package carries
    sizes : of the graphs whose optima are read; None for all

    Raises
    ------
    FormatError
        A line is not an optimum, or one stands there twice.

    Examples
    --------
    >>> from certpgo.optima import Register
    >>> register = Register()
    >>> {entry.tier for entry in register.optima} <= {"standard", "proven", "exact"}
    True
    """

    def __init__(self, folder: Path | None = None, sizes: Sizes | None = None) -> None:
        self.folder = Path(__file__).parent if folder is None else folder
        self.path = self.folder / FILE
        self._optima: dict[tuple[str, str], Optimum] = {}
        self._absent: dict[tuple[str, str], Absent] = {}
        stated = "" if sizes is None else json.dumps(asdict(sizes))
        for number, text in _lines(self.path):
            if stated in text:
                self._take(number, text)

    def _take(self, number: int, text: str) -> None:
        try:
            found = _parsed(json.loads(text))
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            said = f"expected an optimum as JSON: {str(error) or type(error).__name__}"
            raise FormatError(self.path, number, said) from None
        if isinstance(found, Absent):
            self._absent[found.name, found.cost] = found
            return
        if (found.digest, found.cost) in self._optima:
            said = f"the optimum of {found.name} under {found.cost} stands here twice"
            raise FormatError(self.path, number, said)
        self._optima[found.digest, found.cost] = found

    @property
    def optima(self) -> tuple[Optimum, ...]:
        """All optima, by name and cost."""
        return tuple(sorted(self._optima.values(), key=_by_name))

    @property
    def absent(self) -> tuple[Absent, ...]:
        """What could not be computed, by name and cost."""
        return tuple(sorted(self._absent.values(), key=_by_name))

    @cached_property
    def sizes(self) -> frozenset[tuple[str, Sizes]]:
        """The sizes that occur, by kind: other graphs need no digest."""
        return frozenset((o.kind, o.sizes) for o in self._optima.values())

    @cached_property
    def remarks(self) -> dict[str, Remarks]:
        """What is said about graphs, by name."""
        return read_remarks(self.folder)

    def get(self, digest: str, cost: str) -> Optimum | None:
        """The optimum of a problem, or None."""
        return self._optima.get((digest, cost))

    def named(self, name: str) -> tuple[Optimum, ...]:
        """The optima of a graph of this name, by cost."""
        return tuple(o for o in self.optima if name in o.names)

    def put(self, entry: Optimum | Absent) -> None:
        """Add or replace an entry, without any judgement."""
        if isinstance(entry, Absent):
            self._absent[entry.name, entry.cost] = entry
            return
        self._optima[entry.digest, entry.cost] = entry
        for name in entry.names:
            self._absent.pop((name, entry.cost), None)

    def save(self) -> None:
        """Write the file, sorted."""
        entries: list[Optimum | Absent] = [*self._optima.values(), *self._absent.values()]
        entries.sort(key=_by_name)
        write_whole(self.path, "".join(f"{_line(entry)}\n" for entry in entries).encode())

    def proof(self, entry: Optimum) -> Path:
        """Where the proof of an entry is kept."""
        return self.folder / PROOFS / entry.proof_name


@cache
def shipped(sizes: Sizes | None = None) -> Register:
    """The register that the package carries, read once: all of it, or of graphs of these sizes."""
    return Register(sizes=sizes)


def _by_name(entry: Optimum | Absent) -> tuple[str, str, str]:
    digest = entry.digest if isinstance(entry, Optimum) else ""
    return entry.name.lower(), entry.cost, digest


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    if not path.is_file():
        return
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise FormatError(path, None, "expected text in UTF-8") from None
    for number, line in enumerate(text.splitlines(), 1):
        if line.strip():
            yield number, line


def _line(entry: Optimum | Absent) -> str:
    """A line of JSON, without what is empty."""
    data = asdict(entry)
    if isinstance(entry, Optimum):
        data["reading"] = dict(entry.reading)
    return json.dumps({k: v for k, v in data.items() if v not in (None, "", {}, [], ())})


_EMPTY: dict[str, Any] = {
    "reading": {},
    "sources": [],
    "chi2": None,
    "freedom": None,
    "proof_sha256": None,
    "proof_bytes": None,
    "unproven": "",
}


def _parsed(data: Any) -> Optimum | Absent:
    if not isinstance(data, dict):
        raise ValueError("a line is an object")
    if "reason" in data:
        return Absent(**data)
    data = {**_EMPTY, **data}
    known = {field.name for field in fields(Optimum)}
    if data.keys() != known:
        raise ValueError(f"fields {', '.join(sorted(data.keys() ^ known))}")
    found = Optimum(
        **{
            **data,
            "names": tuple(map(str, data["names"])),
            "sources": tuple(map(str, data["sources"])),
            "reading": tuple(sorted((str(k), str(v)) for k, v in data["reading"].items())),
            "sizes": Sizes(**data["sizes"]),
        }
    )
    _check(found)
    return found


def _check(o: Optimum) -> None:
    """Refuse values that cannot be."""
    for what, value, known in (
        ("cost", o.cost, tuple(COSTS)),
        ("verdict", o.verdict, VERDICTS),
        ("tier", o.tier, TIERS),
    ):
        if value not in known:
            raise ValueError(f"{what} {value!r} is none of {', '.join(known)}")
    if not o.names:
        raise ValueError("no name")
    for name in o.names:
        if not is_name(name):
            raise ValueError(f"{name!r} is no name")
    bounds = (o.lower, o.upper)
    if not all(isinstance(x, float | int) and math.isfinite(x) for x in bounds):
        raise ValueError("bounds are numbers")
    if o.lower > o.upper:
        raise ValueError(f"the lower bound {o.lower} is above the upper bound {o.upper}")
    for digest in (o.digest, o.exact, o.file_sha256):
        if len(digest) != 64 or not set(digest) <= set("0123456789abcdef"):
            raise ValueError(f"{digest!r} is no SHA-256")


def is_name(name: str) -> bool:
    """Whether a graph may be called so: the name is part of a file's."""
    return re.fullmatch(r"\w[\w.+-]*", name) is not None


def merged_names(entry: Optimum, names: Iterable[str], sources: Iterable[str]) -> Optimum:
    """The entry with further names and sources."""
    return replace(
        entry,
        names=tuple(dict.fromkeys([*entry.names, *names])),
        sources=tuple(dict.fromkeys([*entry.sources, *sources])),
    )


def folder_of(path: Path | None) -> Register:
    """The register in a folder, by default the one that the package carries.

    Raises
    ------
    InputError
        There is no such folder.
    """
    if path is not None and not path.is_dir():
        raise InputError(f"{path}: no such folder")
    return Register(path)
