"""Proof files by cycles, verified by `certpgo.cycle_checker`.

A text of JSON whose numbers are all integers:

    format, version       "certpgo cycles", 1
    graph_sha256          of the g2o file
    d                     2 or 3
    rotation_information  how the file's information is read: tangent, quaternion or rpy
    kappa                 null, or numerator and denominator of one weight for all edges
    bits                  torques and springs are in the unit 2^-bits
    rotations             of each node, by ascending id: sine and cosine of half the angle, or a
                          quaternion x y z w, of any norm
    cycles                of each its torque (1 or 3), its steps, and a spring for each step; k is
                          the k-th measurement of the file, from 1, and -k the same backwards
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from certpgo import cycle_checker
from certpgo.certify.cycles import CycleProof
from certpgo.certify.proof_file import RefusedProof, UnreadableProof, claim_of, provable
from certpgo.errors import InputError
from certpgo.graph import Instance
from certpgo.io.format import format_of


def write_cycles(
    path: str | Path, source: str | Path, instance: Instance, proof: CycleProof
) -> cycle_checker.Answer:
    """Write a proof by cycles about the rotations of a g2o file, if the checker accepts it.

    Parameters
    ----------
    source : the file that the instance was read from
    instance : the whole graph of the file
    proof : of these rotations, by `certpgo.certify.cycles.prove`

    Returns
    -------
    The bounds verified by the checker, which are about the numbers of the file to the last bit.

    Raises
    ------
    InputError
        The checker cannot read the file as the instance was read.
    NumericalError
        The checker refuses the proof.
    """
    source = provable_by_cycles(source, instance)
    claim = claim_of(source, instance)
    kappa = claim["kappa"]
    head = {
        "format": "certpgo cycles",
        "version": 1,
        "graph_sha256": claim["graph_sha256"],
        "d": claim["d"],
        "rotation_information": claim["rotation_information"],
        "kappa": None if kappa is None else list(float(kappa).as_integer_ratio()),
        "bits": proof.bits,
    }
    lists: dict[str, Sequence[object]] = {"rotations": proof.rotations, "cycles": proof.walks}
    parts = [f'"{name}": {_written(value)}' for name, value in head.items()]
    for name, rows in lists.items():
        lines = ",\n".join([_written(row) for row in rows])
        parts.append(f'"{name}": [\n{lines}\n]')
    path = Path(path)
    path.write_text("{" + ",\n".join(parts) + "}\n", "ascii")
    try:
        return cycle_checker.check(source, path)
    except (cycle_checker.Refused, cycle_checker.Unreadable) as reason:
        path.unlink()
        kind = RefusedProof if isinstance(reason, cycle_checker.Refused) else UnreadableProof
        raise kind(str(reason)) from None


def provable_by_cycles(source: str | Path, instance: Instance) -> Path:
    """The path of a file that the checker can read, before any work.

    Raises
    ------
    InputError
        It cannot.
    """
    path = provable(source, instance)
    if (form := format_of(path).name) != "g2o":
        raise InputError(f"{path}: a proof by cycles is about a g2o file, not {form}")
    if (keep := instance.options.get("keep", "all")) != "all":
        raise InputError(
            f"{path}: a proof by cycles is about all measurements: without --keep {keep}"
        )
    if instance.graph.is_point.any() or instance.world is not None:
        said = "a proof by cycles is about measured poses alone, without landmarks and priors"
        raise InputError(f"{path}: {said} (--no-landmarks, --no-priors)")
    return path


def _written(value: object) -> str:
    return json.dumps(value, separators=(",", ":"))
