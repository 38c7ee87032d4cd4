"""The result of certpgo solve for one connected graph: printed, as JSON, as a proof, as a page."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, cast

import typer

from certpgo.cli import _uncertainty, _verdict
from certpgo.cli._cause import cause, cause_as_json, cause_of, cause_of_squares, remark_of
from certpgo.cli._next import Asked, steps_after
from certpgo.cli._outputs import Outputs, Result
from certpgo.cli._paging import origin_of, write_page
from certpgo.cli._proving import prove
from certpgo.cli._show import facts, notice
from certpgo.cli._truth import KnownPoses

if TYPE_CHECKING:
    from certpgo.certify.region import ProvenDistance
    from certpgo.diagnosis import Finding
    from certpgo.graph import Estimate, Instance
    from certpgo.objective.choose_cost import Certifiable
    from certpgo.optimize.solution import Solution
    from certpgo.solve.assessment import Assessment
    from certpgo.solve.fit import Fit
    from certpgo.solve.metrics import TrajectoryErrors
    from certpgo.solve.outliers import Disagreement
    from certpgo.solve.rejection import Rejection
    from certpgo.solve.result import CertifiedSolution

UNPROVABLE = (
    "a proof is about all measurements of a file, or about rejected ones at their prices, which "
    "only --robust certifies"
)

#: Gigabytes from which it is said how many were needed.
MUCH_MEMORY = 1.0


@dataclass(frozen=True)
class Solved(Result):
    """The result for a connected graph."""

    part: Instance
    method: str
    solution: Solution
    asked: Asked
    found: CertifiedSolution | None = None  # by the certified pipeline
    truth: KnownPoses | None = None
    reference: int | None = None
    level: float | None = None

    needs_the_end: ClassVar = ("proof",)

    @property
    def standing(self) -> str:
        """What is known of the estimate, in a phrase, if Ctrl-C ended the search; else empty."""
        if self.solution.status.value != "interrupted":
            return ""
        if self.certificate is None:
            return "the best estimate so far is not certified"
        return f"the best estimate so far is {self.certificate.verdict.value}"

    @property
    def disagreement(self) -> Disagreement | None:
        """Measurements that disagree with the rest."""
        return None if self.found is None else self.found.disagreement

    @property
    def rejection(self) -> Rejection | None:
        """What is proven about the rejected measurements."""
        return None if self.found is None else self.found.rejection

    @property
    def accuracy(self) -> TrajectoryErrors | None:
        """Trajectory errors, if the truth is known."""
        return None if self.truth is None else self.truth.errors(self.solution.estimate)

    @property
    def _of_all(self) -> str | None:
        """The name of the cost, if it is that of all measurements."""
        return self.asked.known_cost if self.solution.kept is None else None

    @property
    def certified_cost(self) -> float:
        """The cost of the certified measurements, those that a robust method kept."""
        if self.solution.weights is None:
            return self.solution.cost
        return self._problem.cost(self.solution.estimate)

    @cached_property
    def fit(self) -> Fit | None:
        """chi^2 of the certified measurements."""
        return self._fit_at(self.solution.estimate)

    def _fit_at(self, estimate: Estimate) -> Fit | None:
        from certpgo.solve.fit import fit_of

        return fit_of(self.part, self._judged, estimate, self.solution.weights)

    @property
    def _best_fit(self) -> Fit | None:
        """The same of the best estimate known, which certifying that of a method may find."""
        return self.fit if self.assessment is None else self.assessment.best_fit

    @cached_property
    def cause(self) -> Finding | None:
        """What explains errors against the truth, or the contradictions of all measurements."""
        if self.solution.kept is not None:
            return None
        known = self.certificate, self.truth
        found = cause_of(self.part, self._judged, self.solution.estimate, *known)
        return cause_of_squares(self.found, self.fit) if found is None else found

    @property
    def distance(self) -> ProvenDistance | None:
        """How far all optima can be, whatever is rejected of them where that is proven."""
        certificate, rejection = self.certificate, self.rejection
        if certificate is not None and rejection is not None:
            certificate = rejection.standing(certificate)
        return _verdict.distance_of(certificate, self.reference, self.part)

    @cached_property
    def assessment(self) -> Assessment | None:
        """The costliest measurements and the rest of the page; None without a certificate."""
        from certpgo.solve.assessment import assess

        if self.certificate is None:
            return None
        kept, at = self.solution.judged_instance(self.part), self.solution.estimate
        return assess(self._problem, at, self.certificate, instance=kept, fitting=self._fit_at)

    def write(self, outputs: Outputs) -> None:
        """Write the estimate."""
        outputs.write(self.solution.estimate, instance=self.part)

    def notices(self, outputs: Outputs) -> list[str]:
        """What the verdict does not say."""
        return _verdict.warnings(self._best_fit, len(self.solution.rejected), self._count_kept or 0)

    def report(self, outputs: Outputs) -> dict[str, Any]:
        """The result for --json."""
        solution, found = self.solution, self.found
        levels = () if found is None else found.levels
        return {
            **_verdict.as_json(
                self.part,
                self.certificate,
                self.certified_cost,
                disagreement=self.disagreement,
                accuracy=self.accuracy,
                fit=self.fit,
                best_fit=self._best_fit,
                under=self._of_all,
            ),
            **_verdict.distance_as_json(self.distance, self.part),
            **cause_as_json(self.cause),
            "solution": {
                "method": self.method,
                "start": None if found is None else found.start,
                "levels": [{**asdict(level), "status": level.status.value} for level in levels],
                "status": solution.status.value,
                "cost": solution.cost,
                "cost_of_all": solution.cost,
                "cost_of_kept": self.certified_cost,
                "iterations": solution.iterations,
                "counts": dict(solution.counts),
                "seconds": dict(solution.seconds),
                "note": solution.note,
                "undetermined": self._undetermined,
                "kept": self._count_kept,
                "noise_scale": None if found is None else found.noise_scale,
                "rejected": _verdict.edges_as_json(self.part, solution.rejected),
                "rejection": _verdict.rejection_as_json(self.part, self.rejection),
                "at_stated_noise": _verdict.stated_noise_as_json(self.part, found),
                "own_bound": solution.lower_bound,
                "settings": None if found is None else asdict(found.settings),
                "written": None if outputs.estimate is None else str(outputs.estimate),
            },
        }

    def show(self, outputs: Outputs) -> None:
        """Print the verdict, how the estimate was found, what is proven, and what to do next."""
        certificate, written = self.certificate, str(outputs.estimate or "")
        if certificate is None:
            facts([*self._search(written), *self._uncertified()])
            notice(f"{self._own_bound()}; --certify certifies the estimate")
            return
        _verdict.headline(certificate, self.rejection)
        facts(self._search(written))
        typer.echo()
        _verdict.show(
            certificate,
            self.part,
            self.assessment,
            self.disagreement,
            more=[
                *cause(self.cause),
                *_verdict.distance(self.distance, self.part),
                *self._uncertified(),
            ],
            cost=self._of_all,
            steps=self._steps(written),
            fit=self.fit,
        )
        uncertified = certificate.verdict.value != "CERTIFIED"
        if self.found is None and self.solution.kept is None and uncertified:
            notice("without --method, certpgo searches for the best estimate")

    def _search(self, written: str) -> Iterator[tuple[str, str]]:
        """How the estimate was found, as names and values."""
        from certpgo.solve.provenance import peak_memory

        solution, part = self.solution, self.part
        if self.found is not None and self.found.noise:
            yield "noise", self.found.noise
        yield "graph", part.name
        yield "method", self.method
        yield "ended", solution.status.value
        if solution.iterations:
            yield "iterations", str(solution.iterations)
        yield "seconds", ", ".join(f"{phase} {s:.3f}" for phase, s in solution.seconds.items())
        if (memory := peak_memory()) >= MUCH_MEMORY:
            yield "memory", f"{memory:.1f} GB at most"
        if solution.note:
            yield "note", solution.note
        yield from self._kept()
        if written:
            yield "written", written
        if self._undetermined is not None:
            yield "undetermined", self._undetermined

    @property
    def _count_kept(self) -> int | None:
        """How many measurements a robust method kept; what holds fixed nodes is none."""
        kept = self.solution.kept
        return None if kept is None else kept - int((~self.part.is_measured).sum())

    @property
    def _number_kept(self) -> str:
        """The same in words."""
        others = sum(block.num_measurements for block in self.part.graph.blocks)
        return f"{self._count_kept} of {self.part.num_measurements + others} measurements"

    @property
    def _about_kept(self) -> str:
        """What is said of them alone."""
        certificate, rejection = self.certificate, self.rejection
        if certificate is None or rejection is None or not rejection.covers(certificate):
            return "the verdict is about these"
        return "the cost, its bound and the gap are of these"

    def _kept(self) -> Iterator[tuple[str, str]]:
        """What a robust method kept and rejected."""
        from certpgo.solve.accuracy_wording import few_edges

        solution, part = self.solution, self.part
        if solution.kept is not None:
            yield "kept", f"{self._number_kept}; {self._about_kept}, with their final weights"
        if len(solution.rejected):
            yield "rejected", few_edges(part, solution.rejected)
        if self.rejection is not None:
            yield from self.rejection.in_words(self.certificate)
            if len(self.rejection.ambiguous):
                yield "ambiguous", few_edges(part, self.rejection.ambiguous)

    def _uncertified(self) -> Iterator[tuple[str, str]]:
        """The numbers that no certificate is about."""
        from certpgo.graph.phrases import cost_shown
        from certpgo.solve import accuracy_wording as wording

        solution = self.solution
        if self.certificate is None:
            yield "cost", f"{cost_shown(self.certified_cost)}  (chordal cost F)"
        if len(solution.rejected):
            yield "cost of all", f"{cost_shown(solution.cost)}  (with those rejected)"
        if self.accuracy is not None:
            yield from wording.accuracy(self.accuracy)

    def _own_bound(self) -> str:
        """The method's own bound, in words."""
        if (bound := self.solution.lower_bound) is None:
            return "the gap to the optimum is not known"
        return f"the method's own lower bound, which ignores rounding, is {bound:.12g}"

    def _steps(self, written: str) -> list[str]:
        """What to do next after the certified search, or a robust fit."""
        if self.certificate is None or self.method not in ("certified", "robust"):
            return []
        asked, robust = self.asked._replace(estimate=written), self.method == "robust"
        how: dict[str, Any] = {"robust": robust, "disagreement": self.disagreement}
        return steps_after(self.certificate, self.part, asked, searched=True, **how)

    def prove(self, out: Path, source: Path, *, json: bool) -> bool:
        """Write the proof; returns False if there is none."""
        certificate, prices, estimate = self.certificate, None, self.solution.estimate
        if len(self.solution.rejected):
            if self.rejection is None:
                notice(f"no proof is written: {UNPROVABLE}")
                return False
            certificate, prices = self.rejection.certificate, self.rejection.problem.prices
        if certificate is None:
            return True
        return prove(out, source, self.part, estimate, certificate, prices=prices, json=json)

    def write_covariances(self, out: Path, *, quiet: bool) -> None:
        """Write the covariances of all nodes."""
        of = self.part, self._judged, self.solution.estimate
        _uncertainty.write_covariances(out, *of, quiet=quiet)

    def write_regions(self, out: Path, *, quiet: bool) -> bool:
        """Write how far each node is in all estimates of low cost; False if that is not known."""
        return _uncertainty.write_regions(
            out,
            self.part,
            self._judged,
            self.certificate,
            reference=self.reference,
            level=self.level,
            quiet=quiet,
        )

    @property
    def _undetermined(self) -> str | None:
        """What the measurements leave open, in words."""
        found = None if self.found is None else replace(self.found, instance=self.part).undetermined
        return None if found is None else found.in_words(self.part.named)

    @property
    def _judged(self) -> Certifiable:
        """The same, with what the certified pipeline knows of it."""
        return self._problem if self.found is None else self.found.problem

    @property
    def _problem(self) -> Certifiable:
        """The problem that the estimate solves."""
        from certpgo.objective.choose_cost import objective_of

        posed: Any = objective_of(self.part, self.asked.cost, self.asked.kernel)
        rejects = self.solution.weights is not None
        return cast("Certifiable", self.solution.judged(posed) if rejects else posed)

    def write_page(self, out: Path, outputs: Outputs) -> None:
        """Write the page of the certificate."""
        from certpgo.solve.accuracy_wording import disagreeing, ends
        from certpgo.solve.rejection import headline

        solution, part, assessment = self.solution, self.part, self.assessment
        if assessment is None:
            return
        remarks = [*remark_of(self.cause)]
        if solution.note:
            remarks.append(f"Status: {solution.status.value}; {solution.note}.")
        if solution.kept is not None:
            remarks.append(
                f"The method kept {self._number_kept}: {self._about_kept}, with their final "
                "weights; the view shows the others in red."
            )
        if len(solution.rejected):
            pairs = part.pairs[solution.rejected].tolist()
            remarks.append(f"Rejected: {', '.join(ends(part, i, j) for i, j in pairs)}.")
        if many := _verdict.rejecting_many(len(solution.rejected), self._count_kept or 0):
            remarks.append(f"{many[0].upper()}{many[1:]}.")
        if self.disagreement is not None:
            remarks.append(f"{disagreeing(self.disagreement, assessment.certificate)}.")
        origin = origin_of(
            self.asked.graph,
            self.asked.reading,
            judging=self.asked.judged_again(part),
            estimate=outputs.estimate,
            proof=outputs.proof,
            method=self.method,
            meaning=headline(assessment.certificate, self.rejection),
            remarks=remarks,
            choice=()
            if self.rejection is None
            else tuple(self.rejection.in_words(assessment.certificate)),
            partial=len(solution.rejected) > 0,
            disagreeing=self.disagreement is not None,
            settings=None if self.found is None else self.found.settings,
        )
        write_page(
            out,
            part,
            self._problem,
            solution.estimate,
            assessment,
            origin,
            solution.trace,
            rejected=part.graph.pairs[solution.rejected],
            distance=self.distance,
        )
