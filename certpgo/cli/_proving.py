"""Writing proof files (--proof)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from certpgo.cli._show import facts, notice, working
from certpgo.errors import NumericalError

#: Exit code of a proof that is refused or could not be found.
REFUSED = 6

if TYPE_CHECKING:
    from certpgo.certify import Certificate
    from certpgo.graph import Estimate, Instance
    from certpgo.linalg.arrays import FloatArray


def prove(
    out: Path,
    source: Path,
    instance: Instance,
    estimate: Estimate,
    certificate: Certificate,
    *,
    prices: FloatArray | None = None,
    json: bool,
) -> bool:
    """Write the proof and print the checker's result (to stderr if stdout has a JSON document).

    With ``prices`` it is about the truncated cost.

    Returns False, with a notice, if there is no proof; the verdict stands without it.
    """
    from certpgo.certify.certificate import CHORDAL
    from certpgo.solve.proving import write_proof

    try:
        with working(f"proving the bound for {instance.name}"):
            proven = write_proof(out, source, instance, estimate, certificate, prices=prices)
    except NumericalError as reason:
        notice(f"no proof was written to {out}: {reason}")
        return False
    result = f"{out}: {proven} (certpgo check)"
    if json:
        notice(result)
    else:
        facts([("proof", result), ("about", proven.about)])
    enough = certificate.rtol * certificate.cost_upper
    if certificate.objective == CHORDAL and certificate.gap <= enough < proven.upper - proven.lower:
        notice(
            f"the bound in {out} is weaker than the certificate's: the proof is for the graph as a "
            "whole, the certificate for the parts between long bridges"
        )
    return True
