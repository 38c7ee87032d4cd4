"""Writing the proof of an answer, where a command is asked to."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from certpgo.cli._show import facts, notice, working
from certpgo.errors import NumericalError

#: Exit code of a proof that is refused, or could not be had.
REFUSED = 6

if TYPE_CHECKING:
    from certpgo.certify import Certificate
    from certpgo.datasets.source import Source
    from certpgo.graph import Estimate, Instance


def provable_source(source: Source) -> Path:
    """The graph's file, if the checker reads it: said before the work and not after.

    Raises
    ------
    InputError
        Its format is another.
    """
    from certpgo.certify.proof_file import provable

    return provable(source.path())


def prove(
    out: Path,
    source: Path,
    instance: Instance,
    estimate: Estimate,
    certificate: Certificate,
    *,
    json: bool,
) -> bool:
    """Write the proof, and say what the checker said of it (on stderr beside a JSON document).

    Where there is none, that is said, and False returned: the verdict stands without it.
    """
    from certpgo.certify.proof_file import write_proof

    try:
        with working(f"proving the answer for {instance.name}"):
            answer = write_proof(out, source, instance, estimate, certificate)
    except NumericalError as reason:
        notice(f"no proof was written to {out}: {reason}")
        return False
    said = f"{out}: {answer} (certpgo check)"
    if json:
        notice(said)
    else:
        facts([("proof", said), ("about", answer.about)])
    if certificate.gap <= certificate.rtol * certificate.cost_upper < answer.upper - answer.lower:
        notice(
            f"the bound in {out} is weaker than the certificate's: a proof file takes the graph as "
            "a whole, a certificate the parts between long bridges one by one"
        )
    return True
