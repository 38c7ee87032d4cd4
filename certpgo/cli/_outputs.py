"""The outputs that a command was asked for: refused before any work, or written in one order."""

from __future__ import annotations

import importlib
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from certpgo.cli._interrupting import INTERRUPTED, tell_interrupted
from certpgo.cli._proving import REFUSED
from certpgo.cli._show import document, notice, noticing
from certpgo.cli._verdict import EXIT_CODES
from certpgo.errors import InputError

if TYPE_CHECKING:
    from certpgo.certify import Certificate
    from certpgo.graph import Estimate, Instance
    from certpgo.io.datasets.source import Source


@dataclass(frozen=True)
class Outputs:
    """The outputs that a command was asked for; None for those that it was not.

    Attributes
    ----------
    scene, estimate, graph, csv, proof, covariances, regions, html : files to write
    format : format of the estimate; by default from its suffix
    proven : the file that the proof is about
    json : whether the result is printed as JSON
    """

    scene: Path | None = None
    estimate: Path | None = None
    graph: Path | None = None
    csv: Path | None = None
    proof: Path | None = None
    covariances: Path | None = None
    regions: Path | None = None
    html: Path | None = None
    format: str | None = None
    proven: Path | None = None
    json: bool = False

    @property
    def files(self) -> list[Path]:
        """All files to write."""
        maps = (self.scene, self.estimate, self.graph)
        files = (*maps, self.csv, self.proof, self.covariances, self.regions, self.html)
        return [path for path in files if path is not None]

    def refuse(self, *inputs: Source | Path | None) -> None:
        """Refuse, before any work, what cannot be written, or would replace what is read.

        Parameters
        ----------
        inputs : what is read, as far as it is known yet, under any path: sources, other files

        Raises
        ------
        InputError
            A suffix says no format, or a file cannot be written or is named twice, or an output is
            an input, or a file in a folder that is one.
        MissingDependency
            jinja2, which draws pages, is not installed.
        """
        from certpgo.io.format import format_to_write

        for given in self.files:
            if given.is_dir():
                raise InputError(f"{given}: cannot be written: it is a folder, not a file")
        for path, format in ((self.estimate, self.format), (self.graph, None)):
            if path is not None:
                format_to_write(path, format)
        for k, path in enumerate(self.files):
            if not _is_writable(path):
                raise InputError(f"{path}: cannot be written: {_hindrance(path.parent)}")
            if any(_is_same(path, earlier) for earlier in self.files[:k]):
                raise InputError(f"{path}: given for two outputs; one would overwrite the other")
        refuse_overwriting(self.files, *inputs)
        if self.html is not None:
            importlib.import_module("certpgo.view.page")

    def about(self, source: Source, instance: Instance, cost: str) -> Outputs:
        """The same outputs, with a proof about this graph, if the checker can read that."""
        if self.proof is None:
            return self
        from certpgo.certify.proof_file import provable

        return replace(self, proven=provable(source.path(), instance, cost))

    def split(self, parts: Sequence[Instance]) -> list[Outputs]:
        """The outputs of each part: several get an estimate each, named by their smallest ids."""
        out = self.estimate
        if out is None or len(parts) == 1:
            return [self] * len(parts)
        named = (out.with_stem(f"{out.stem}-{int(part.ids.min())}") for part in parts)
        return [replace(self, estimate=path) for path in named]

    def write(self, found: Instance | Estimate, **how: Any) -> None:
        """Write an estimate, alone or as the initial one of a graph, if it is asked for."""
        from certpgo.io import write

        if self.estimate is not None:
            with noticing():
                write(self.estimate, found, format=self.format, **how)


@dataclass(frozen=True)
class Result:
    """What a command found of a connected graph, with its certificate, if any; see `emit`."""

    certificate: Certificate | None

    #: Outputs that are not written if Ctrl-C ended the work.
    needs_the_end: ClassVar[tuple[str, ...]] = ()

    @property
    def standing(self) -> str:
        """What is known, in a phrase, if Ctrl-C ended the work; else empty."""
        return ""

    def write(self, outputs: Outputs) -> None:
        """Write the scene, the estimate and the graph."""

    def show(self, outputs: Outputs) -> None:
        """Print the result."""

    def report(self, outputs: Outputs) -> dict[str, Any]:
        """The result for --json."""
        raise NotImplementedError

    def notices(self, outputs: Outputs) -> Iterable[str]:
        """What the verdict does not say, in sentences."""
        return ()

    def prove(self, out: Path, source: Path, *, json: bool) -> bool:
        """Write the proof; returns False if there is none."""
        raise NotImplementedError

    def write_covariances(self, out: Path, *, quiet: bool) -> None:
        """Write the covariance of each node."""

    def write_regions(self, out: Path, *, quiet: bool) -> bool:
        """Write the region of each node; returns False if there are none."""
        raise NotImplementedError

    def write_page(self, out: Path, outputs: Outputs) -> None:
        """Write the page of the certificate, unless `write` did."""


def emit(results: Iterable[Result], outputs: Sequence[Outputs]) -> int:
    """Write and print results as they come, each to its outputs; returns the exit code.

    Of each: scene, estimate and graph, text, notices, proof, covariances, regions, page. The JSON
    document
    is in place of the last text, and about all results. One that Ctrl-C interrupted is the last.
    """
    codes: list[int] = []
    reports: list[dict[str, Any]] = []
    said: set[str] = set()
    for k, (result, own) in enumerate(zip(results, outputs, strict=False)):
        later = outputs[k + 1 :]
        if result.standing:
            missing = [getattr(own, name) for name in result.needs_the_end]
            tell_interrupted(result.standing, [*missing, *(other.estimate for other in later)])
            lost: dict[str, Any] = dict.fromkeys(result.needs_the_end)
            own = replace(own, **lost)
            later = []
        result.write(own)
        if not own.json:
            result.show(own)
        else:
            reports.append(result.report(own))
            if not later:
                document(reports[0] if len(outputs) == 1 else reports)
        for sentence in result.notices(own):
            if sentence not in said:
                notice(sentence)
                said.add(sentence)
        codes.append(_finished(result, own))
        if result.standing:
            return INTERRUPTED
    return max(codes, default=0)


def _finished(result: Result, outputs: Outputs) -> int:
    """Write the proof, covariances, regions and page of a result; returns its exit code."""
    code = 0 if result.certificate is None else EXIT_CODES[result.certificate.verdict.value]
    proof, source = outputs.proof, outputs.proven
    if proof and source and not result.prove(proof, source, json=outputs.json):
        code = code or REFUSED
        outputs = replace(outputs, proof=None)
    if outputs.covariances is not None:
        result.write_covariances(outputs.covariances, quiet=outputs.json)
    regions = outputs.regions
    if regions is not None and not result.write_regions(regions, quiet=outputs.json):
        code = code or REFUSED
    if outputs.html is not None:
        result.write_page(outputs.html, outputs)
    return code


def refuse_overwriting(files: Iterable[Path], *inputs: Source | Path | None) -> None:
    """Refuse files to write that are inputs, as `Outputs.refuse` does."""
    named = [one if one is None or isinstance(one, Path) else one.found for one in inputs]
    read = [path for path in named if path is not None]
    for out in files:
        if any(_is_in(out, path) if path.is_dir() else _is_same(out, path) for path in read):
            raise InputError(f"{out}: is also an input, and would be overwritten")


def _hindrance(folder: Path) -> str:
    """Why no file can be written into a folder."""
    if not folder.is_dir():
        return f"{folder} is a file, not a folder" if folder.exists() else f"no folder {folder}"
    if hasattr(os, "statvfs") and os.statvfs(folder).f_flag & os.ST_RDONLY:
        return "the disk is read-only"
    return f"no permission to write into {folder}"


def _is_writable(out: Path) -> bool:
    from certpgo.io.writing import is_stream

    if is_stream(out):  # written to, so its folder need not be
        return os.access(out, os.W_OK)
    folder = Path(os.path.realpath(out)).parent
    return folder.is_dir() and os.access(folder, os.W_OK)


def _is_in(path: Path, folder: Path) -> bool:
    return path.exists() and path.resolve().is_relative_to(folder.resolve())


def _is_same(a: Path, b: Path) -> bool:
    return a.resolve() == b.resolve() or (a.exists() and b.exists() and a.samefile(b))
