"""Making an entry of the register: solve, prove, have it checked, and keep it if it is better."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
import tempfile
import zipfile
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from certpgo import checker
from certpgo.certify import Certificate, Tier
from certpgo.certify.proof_file import check, claim_of
from certpgo.certify.tolerances import ATOL, RTOL, allowed
from certpgo.errors import CertPGOError, InputError, NumericalError
from certpgo.graph import Estimate, Instance
from certpgo.graph.graph import require_connected
from certpgo.io.pipes import readable
from certpgo.io.writing import folder_to_write, write_whole
from certpgo.objective.choose_cost import CHORDAL, COSTS, Certifiable, objective_of
from certpgo.optima.fingerprint import fingerprint
from certpgo.optima.recognition import sizes_of
from certpgo.optima.register import Absent, Optimum, Register, is_name, merged_names
from certpgo.solve.fit import fit_of
from certpgo.solve.proving import write_proof
from certpgo.solve.solving import solve

#: Bytes up to which a proof file is kept, and of all that are.
LARGEST_PROOF, ALL_PROOFS = 200_000, 1_600_000
#: Reading options that need not be said.
USUAL = MappingProxyType(
    {"keep": "all", "weights": "file", "information": "all", "rotation_information": "tangent"}
)


@dataclass(frozen=True)
class Added:
    """What became of an attempt to add an optimum.

    Attributes
    ----------
    entry : the optimum that the register has now, or why it has none
    what : ``"new"``, ``"improved"``, ``"unchanged"`` or ``"absent"``
    """

    entry: Optimum | Absent
    what: str


@dataclass(frozen=True)
class Evidence:
    """Bounds on an optimum, and what they rest on.

    Attributes
    ----------
    upper, lower : of the optimum
    tier : ``"standard"``, ``"proven"`` or ``"exact"``
    proof : content of the proof file, or None
    unproven : why there is no proof file, or empty
    """

    upper: float
    lower: float
    tier: str
    proof: bytes | None = None
    unproven: str = ""


@dataclass(frozen=True)
class Prepared:
    """What was found about a graph under a cost, to `enter`.

    Attributes
    ----------
    entry : the optimum, or why there is none
    proof : content of its proof file, or None
    """

    entry: Optimum | Absent
    proof: bytes | None = None


def add(register: Register, path: Path, instance: Instance, cost: str, **how: Any) -> Added:
    """Solve a graph and put the result into a register; the caller saves that.

    Parameters
    ----------
    path, instance, cost, how : as of `prepare`

    Raises
    ------
    InputError
        As of `prepare` and `enter`.
    """
    return enter(register, prepare(path, instance, cost, **how))


def prepare(
    path: Path,
    instance: Instance,
    cost: str,
    *,
    name: str = "",
    source: str = "",
    estimate: Estimate | None = None,
    proof: Path | None = None,
    exact_within: float = 0.0,
) -> Prepared:
    """Solve a graph, prove the result, and have the proof checked.

    Parameters
    ----------
    path : the file that the instance was read from
    cost : ``"chordal"``, ``"g2o"`` or ``"gtsam"``
    name, source : of the graph; by default the instance's
    estimate : a submitted one, from which the search begins
    proof : a submitted proof file, which is checked instead of solving
    exact_within : seconds for a check in integers, of a proof that is small enough to keep

    Raises
    ------
    InputError
        A submitted proof is about something else, or is refused.
    """
    name = name or instance.name
    try:
        require_connected(instance.measurements)
        problem = objective_of(instance, cost)
    except CertPGOError as error:
        reason = str(error).removeprefix(f"{instance.source}: ").removeprefix(f"{name}: ")
        return Prepared(Absent(name, cost, reason))
    fingerprints = fingerprint(instance, cost)
    if fingerprints is None:
        return Prepared(Absent(name, cost, "no information matrices"))
    if proof is None:
        found = solve(instance, cost=cost, initial=estimate, tier=_tier(problem, cost))
        certificate, point = found.certificate, found.estimate
        provable = COSTS[cost].provable
        evidence = _evidence(path, instance, point, certificate, exact_within, provable)
        verdict, scale = certificate.verdict.value, certificate.scale
    else:
        _refuse_other_claim(path, instance, cost, proof)
        evidence, point = _checked(path, proof, exact_within), _estimate_in(proof)
        scale, verdict = problem.scale, ""
    if evidence.proof is not None:
        enough = allowed(evidence.upper, RTOL, ATOL * scale)
        verdict = "CERTIFIED" if evidence.upper - evidence.lower <= enough else "BOUNDED"
    fit = fit_of(instance, problem, point)
    entry = Optimum(
        names=(name,),
        cost=cost,
        digest=fingerprints.digest,
        exact=fingerprints.exact,
        kind=instance.graph.kind,
        sizes=sizes_of(instance),
        sources=(source,) if source else (),
        reading=_reading(instance),
        file_sha256=_sha256(readable(_file(path)).read_bytes()),
        upper=evidence.upper,
        lower=evidence.lower,
        verdict="UNDECIDED" if verdict == "REFUTED" else verdict,
        tier=evidence.tier,
        chi2=None if fit is None else fit.chi2,
        freedom=None if fit is None else fit.freedom,
        proof_sha256=None if evidence.proof is None else _sha256(evidence.proof),
        proof_bytes=None if evidence.proof is None else len(evidence.proof),
        kept=False,
        unproven=evidence.unproven,
        version=_version(),
    )
    return Prepared(entry, evidence.proof)


def enter(register: Register, found: Prepared) -> Added:
    """Put an optimum into a register, and its proof if that is small enough, unless it is worse.

    Nothing there becomes worse: an entry is replaced by one of a stronger tier, or of the same with
    a cheaper estimate or a higher bound and nothing weaker. The caller saves the register.

    Raises
    ------
    InputError
        The name is no word, or that of another graph.
    """
    entry, proof = found.entry, found.proof
    if not is_name(entry.name):
        raise InputError(f"a name has letters, digits and ._+- alone, not {entry.name!r}")
    if isinstance(entry, Absent):
        register.put(entry)
        return Added(entry, "absent")
    known = register.get(entry.digest, entry.cost)
    for other in register.named(entry.name):
        if other.cost == entry.cost and other is not known:
            raise InputError(f"{entry.name} is the name of another graph: --name gives this one's")
    if known is not None and not known.improved_by(entry):
        kept = merged_names(known, entry.names, entry.sources)
        register.put(kept)
        return Added(kept, "unchanged")
    if known is not None:
        entry = merged_names(
            replace(entry, names=known.names, sources=known.sources), entry.names, entry.sources
        )
        if known.kept:
            register.proof(known).unlink(missing_ok=True)
    if proof is not None and len(proof) <= LARGEST_PROOF:
        target = register.proof(entry)
        held = sum(p.stat().st_size for p in target.parent.glob("*.cert") if p != target)
        if held + len(proof) <= ALL_PROOFS:
            folder_to_write(target.parent)
            write_whole(target, proof)
            entry = replace(entry, kept=True)
    register.put(entry)
    return Added(entry, "new" if known is None else "improved")


def _evidence(
    path: Path,
    instance: Instance,
    point: Estimate,
    certificate: Certificate,
    exact_within: float,
    provable: bool,
) -> Evidence:
    """The bounds of a proof file if there is one that is as good, else those of the certificate."""
    tier = "proven" if certificate.tier == Tier.PROOF else "standard"
    lower = max(certificate.lower_bound, 0.0)
    evidence = Evidence(certificate.cost_upper, lower, tier)
    if not provable:
        return evidence
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "proof.cert"
        try:
            write_proof(out, path, instance, point, certificate)
            proven = _checked(path, out, exact_within)
        except (InputError, NumericalError) as error:
            return replace(evidence, unproven=str(error).replace(f"{path}: ", ""))
    if proven.upper - proven.lower <= max(certificate.tolerance, certificate.gap):
        return proven
    return replace(evidence, unproven="a proof file, of the graph as a whole, is weaker")


def _tier(problem: Certifiable, cost: str) -> str:
    """The strongest tier there is for a problem."""
    provable = COSTS[cost].provable
    return "proof" if provable and not getattr(problem, "unprovable", "") else "standard"


def _checked(path: Path, proof: Path, exact_within: float) -> Evidence:
    """What the independent checkers say of a proof; InputError if they refuse it."""
    path, proof = readable(path), readable(proof)
    answer = check(path, proof)
    content = proof.read_bytes()
    found = Evidence(answer.upper, answer.lower, "proven", content)
    if exact_within <= 0.0 or len(content) > LARGEST_PROOF:
        return found
    exact = in_integers(path, proof, exact_within)
    if exact is None:
        return found
    # Either checker is to accept the entry.
    upper, lower = max(answer.upper, exact[0]), min(answer.lower, exact[1])
    return replace(found, upper=upper, lower=lower, tier="exact")


def in_integers(path: Path, proof: Path, seconds: float) -> tuple[float, float] | None:
    """Upper and lower bound by the checker in integers; None if it does not end in time."""
    program = [sys.executable, "-m", "certpgo", "check", "--exact", "--json"]
    with suppress(subprocess.TimeoutExpired):
        done = subprocess.run(
            [*program, str(path), str(proof)], capture_output=True, timeout=seconds, check=False
        )
        if done.returncode == 0:
            said = json.loads(done.stdout)
            return float(said["cost_upper"]), float(said["lower_bound"])
    return None


def _refuse_other_claim(path: Path, instance: Instance, cost: str, proof: Path) -> None:
    """Refuse a proof that is not about this cost of all measurements, as they were read."""
    expected = claim_of(path, instance, None if cost == CHORDAL else cost)
    try:
        with np.load(readable(proof), allow_pickle=False) as archive:
            claim = checker.read_claim(archive)
    except (OSError, ValueError, zipfile.BadZipFile, checker.Unreadable, checker.Refused) as error:
        raise InputError(f"{proof}: not a readable proof ({error})") from None
    differing = [key for key, value in expected.items() if claim.get(key) != value]
    if differing:
        said = ", ".join(f"{key} {json.dumps(claim.get(key))}" for key in differing)
        raise InputError(f"{proof}: about another problem than this ({said})")


def _estimate_in(proof: Path) -> Estimate:
    """The estimate that a proof contains."""
    with np.load(readable(proof), allow_pickle=False) as archive:
        q, t, s = archive["rotations"], archive.get("translations"), archive.get("scales")
    N, D = checker.exact_rotations(q)
    rotations = (N / D[:, None, None]).astype(np.float64)
    return Estimate(rotations, t, scales=s)


def _reading(instance: Instance) -> tuple[tuple[str, str], ...]:
    """The reading options that matter."""
    return tuple(sorted((k, v) for k, v in instance.options.items() if USUAL.get(k) != v))


def _file(path: Path) -> Path:
    return path / "EGs.txt" if path.is_dir() else path


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _version() -> str:
    from certpgo import __version__

    return __version__
