"""Files of graphs solved, and proofs of the answers written and checked."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from certpgo.certify.certificate import Verdict
from certpgo.certify.proof_file import provable
from certpgo.checker import Answer
from certpgo.errors import CertPGOError, NumericalError
from certpgo.graph import Instance
from certpgo.graph.components import require_pose
from certpgo.io.accept_paths import AnyPath
from certpgo.io.reading import read
from certpgo.io.writing import folder_to_write
from certpgo.objective.choose_cost import own_cost
from certpgo.optimize.monitor import Monitor, silent
from certpgo.optimize.solution import Status
from certpgo.solve.accuracy_wording import hint
from certpgo.solve.outliers import Disagreement
from certpgo.solve.proving import seen_from, write_proof
from certpgo.solve.result import CertifiedSolution
from certpgo.solve.solving import solve

#: What the checker says of a proof, or why there is none; and notices about the graph's file.
Attempt = tuple[Answer | CertPGOError, tuple[str, ...]]
#: Metres and degrees; None where nothing is said.
Within = tuple[float | None, float | None]


def attempt(
    files: tuple[AnyPath, AnyPath],
    monitor: Monitor = silent,
    *,
    cost: str | None = None,
    time_limit: float | None = None,
    within: Within | None = None,
    reference: int | None = None,
) -> Attempt:
    """Solve a file's graph, write a proof of the answer and check it.

    Errors are returned.

    Parameters
    ----------
    files : the graph's, and the proof's, whose folder is made
    monitor, cost, time_limit : as for `certpgo.solve`
    within : metres and degrees that every node is proven to be this near to all optima, too
    reference : id of the pose that these are seen from, see `certpgo.write_proof`

    Raises
    ------
    KeyboardInterrupt
        Ctrl-C, or the monitor, ended the search.
    """
    graph, proof = files
    notices: tuple[str, ...] = ()
    try:
        instance = read(graph, quiet=True)
        notices = instance.notices
        seen = None if within is None else _seen(instance, within, reference)
        provable(graph, instance, cost or own_cost(instance))
        found: list[Disagreement] = []
        how: dict[str, Any] = {"cost": cost, "time_limit": time_limit, "monitor": monitor}
        answer = solve(instance, tier="proof", on_disagreement=found.append, **how)
        notices += tuple(map(hint, found))
        return _proven(graph, Path(proof), answer, within, seen), notices
    except CertPGOError as error:
        return error, notices


def _seen(instance: Instance, within: Within, reference: int | None) -> int:
    """The pose that distances are seen from."""
    require_pose(reference, [instance], "reference")
    node = None if reference is None else instance.pose_called(reference)
    return seen_from(instance, within, node)


def _proven(
    graph: AnyPath,
    proof: Path,
    answer: CertifiedSolution,
    within: Within | None,
    seen: int | None,
) -> Answer:
    """The bounds of a graph's answer, as the checker accepts them before the file is in place."""
    if answer.solution.status is Status.INTERRUPTED:
        raise KeyboardInterrupt
    if answer.verdict is not Verdict.CERTIFIED or answer.instance is None:
        raise NumericalError(f"{answer.verdict}: {answer.certificate.reason}")
    folder_to_write(proof.parent)
    proven = answer.instance, answer.estimate, answer.certificate
    return write_proof(proof, graph, *proven, within=within, reference=seen)
