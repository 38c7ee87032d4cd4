"""What rows choose from, and what does not go together."""

from __future__ import annotations

from reports.studies.bookkeeping.covering import Rule

#: Levels of each factor; the first is the plainest.
FACTORS = {
    "dimension": ("plane", "space"),
    "relative poses": ("whole", "rotations alone"),
    "partial edges": ("none", "turns", "steps", "axes"),
    "landmarks": ("none", "some", "numbered apart"),
    "positions": ("none", "near", "far"),
    "attitudes": ("none", "some"),
    "full priors": ("none", "some"),
    "distances": ("none", "some"),
    "held": ("none", "one", "several"),
    "parallel edges": ("none", "copy", "other"),
    "noise": ("some", "none", "much"),
    "matrices": ("isotropic", "full", "none"),
    "weights": ("file", "chosen", "ones", "covariance", "quaternion"),
    "cost": ("own", "chordal", "g2o", "gtsam"),
    "file": ("g2o", "npz", "pyfg", "arrays"),
    "files": ("one", "two", "reversed", "also"),
    "ids": ("plain", "gaps", "huge"),
    "command": ("solve", "certify", "follow", "outliers", "info", "compare"),
    "outliers": ("none", "robust"),
    "rejected": ("none", "listed"),
    "estimate": ("whole", "part"),
    "truth": ("none", "given"),
    "times": ("none", "given"),
    "proof": ("none", "tier", "file", "integers"),
    "covariances": ("none", "asked"),
    "limit": ("none", "short"),
    "law": ("none", "names", "unit", "frame"),
}


def _cannot(**levels: str | tuple[str, ...]) -> Rule:
    return Rule(_levels(levels))


def _is_refused(said: str, why: str, **levels: str | tuple[str, ...]) -> Rule:
    return Rule(_levels(levels), said, why)


def _levels(levels: dict[str, str | tuple[str, ...]]) -> dict[str, tuple[str, ...]]:
    """Names with spaces, and levels as tuples."""
    return {
        name.replace("_", " "): (one,) if isinstance(one, str) else one
        for name, one in levels.items()
    }


def _priors(*, but: str = "") -> list[dict[str, str | tuple[str, ...]]]:
    """Levels with priors of each kind."""
    levels = {"positions": ("near", "far"), "attitudes": "some", "full_priors": "some"}
    return [{name: level} for name, level in levels.items() if name != but]


def _but(*levels: str) -> tuple[str, ...]:
    """All commands but these."""
    return tuple(level for level in FACTORS["command"] if level not in levels)


_PARTIAL, _HELD, _WEIGHTS = ("turns", "steps", "axes"), ("one", "several"), ("chosen", "ones")
_OTHERS, _SEVERAL = ("g2o", "gtsam"), ("two", "reversed", "also")
_PROOFS = ("file", "integers")

#: What no file or option could say.
UNASKED = (
    # Rotations alone.
    _cannot(relative_poses="rotations alone", partial_edges=_PARTIAL),
    _cannot(relative_poses="rotations alone", landmarks=("some", "numbered apart")),
    *(_cannot(relative_poses="rotations alone", **prior) for prior in _priors()),
    _cannot(relative_poses="rotations alone", distances="some"),
    _cannot(relative_poses="rotations alone", law="unit"),
    # The oracle has F of them; tests compare their other costs with SciPy.
    _cannot(relative_poses="rotations alone", cost=_OTHERS),
    # What states one block of information alone, the checker of integers does not read.
    _cannot(proof="integers", partial_edges=("turns", "steps")),
    _cannot(proof="integers", attitudes="some"),
    _cannot(proof="integers", file="npz"),  # archives of similarities alone
    # Points have numbers of their own in the plane alone, and in g2o files.
    _cannot(landmarks="numbered apart", dimension="space"),
    _cannot(landmarks="numbered apart", distances="some"),
    _cannot(landmarks="numbered apart", file=("arrays", "pyfg")),
    _cannot(landmarks="numbered apart", held=_HELD),
    # Only a file in which all have the same form can be without matrices.
    _cannot(matrices="none", partial_edges=_PARTIAL),
    _cannot(matrices="none", weights=("covariance", "quaternion")),
    _cannot(matrices="none", landmarks=("some", "numbered apart")),
    *(_cannot(matrices="none", **prior) for prior in _priors()),
    _cannot(matrices="none", distances="some"),
    _cannot(matrices="none", file=("arrays", "pyfg")),
    # What is unknown has no covariance.
    _cannot(weights="covariance", partial_edges=_PARTIAL),
    _cannot(weights="covariance", attitudes="some"),
    # What files have a place for.
    _cannot(file="g2o", distances="some"),
    _cannot(file=("npz", "pyfg"), weights=("covariance", "quaternion")),
    _cannot(file="pyfg", held=_HELD),
    _cannot(file="npz", files=_SEVERAL),
    _cannot(file="npz", distances="some", held=_HELD),
    # Arrays have their own weights and ids, and no options.
    _cannot(file="arrays", weights=("chosen", "ones", "covariance", "quaternion")),
    _cannot(file="arrays", files=_SEVERAL),
    _cannot(file="arrays", held=_HELD),
    _cannot(file="arrays", positions="far"),
    _cannot(file="arrays", relative_poses="rotations alone"),
    _cannot(file="arrays", attitudes="some"),
    _cannot(file="arrays", estimate="part"),
    _cannot(file="arrays", truth="given"),
    _cannot(file="arrays", times="given"),
    _cannot(file="arrays", proof=_PROOFS),
    _cannot(file="npz", distances="some", positions="far"),
    _cannot(file="npz", distances="some", attitudes="some"),
    # Commands.
    _cannot(command=_but("certify"), estimate="part"),
    _cannot(command=_but("certify"), rejected="listed"),
    _cannot(command=_but("solve", "follow"), outliers="robust"),
    _cannot(command=_but("solve"), covariances="asked"),
    _cannot(command=_but("solve", "certify"), proof=("tier", *_PROOFS)),
    _cannot(command=_but("solve", "certify", "compare"), truth="given"),
    _cannot(command=_but("solve", "certify", "compare"), times="given"),
    _cannot(command=_but("solve", "certify", "follow"), limit="short"),
    _cannot(command=_but("solve"), law=("names", "unit", "frame")),
    _cannot(command=_but("solve", "certify"), file="arrays"),
    _cannot(command="info", cost=("chordal", *_OTHERS)),
    _cannot(command="info", weights=_WEIGHTS),
    _cannot(outliers="robust", noise="much"),
    _cannot(limit="short", law=("names", "unit", "frame")),
    # Points are numbered as files name them, one after another.
    _cannot(file="pyfg", files=_SEVERAL, landmarks="some"),
    _cannot(weights=_WEIGHTS, law="unit"),
    _cannot(matrices="none", law="unit"),
    # Which held pose is the first one says whether the default cost is g2o's there.
    _cannot(held="several", partial_edges="axes", cost="own", law="names"),
)
#: What is refused.
REFUSED = (
    # Costs of other programs.
    _is_refused(
        "needs poses with information matrices on every edge(; other weights were chosen|, as)",
        "The costs of g2o and GTSAM have the file's matrices, no other weights.",
        weights=_WEIGHTS,
        cost=_OTHERS,
    ),
    _is_refused(
        "needs poses with information matrices on every edge; not all edges have one",
        "The costs of g2o and GTSAM need matrices.",
        matrices="none",
        cost=_OTHERS,
    ),
    _is_refused(
        "no isotropic cost is known to be below",
        "Not every residual with cross terms has a minorant.",
        rejected="listed",
        cost=_OTHERS,
    ),
    _is_refused(
        "no isotropic cost is known to be below",
        "Not every residual with cross terms has a minorant.",
        rejected="listed",
        cost="own",
        partial_edges="axes",
    ),
    _is_refused(
        "no isotropic cost is known to be below",
        "Not every residual with cross terms has a minorant.",
        command="outliers",
        cost=(*_OTHERS, "own"),
        partial_edges="axes",
    ),
    _is_refused(
        "not positive definite .what they leave open is along no axis",
        "Held poses turn what is not measured out of the axes.",
        held="several",
        partial_edges="axes",
        cost=_OTHERS,
    ),
    # Weights.
    _is_refused(
        "rotational information on a quaternion is for 3D; in 2D use the angle",
        "In the plane information is about the angle.",
        weights="quaternion",
        dimension="plane",
    ),
    # Proofs.
    _is_refused(
        "a proof is about one file",
        "A proof names the bytes of one file.",
        proof=_PROOFS,
        files=_SEVERAL,
    ),
    _is_refused(
        "a proof is about a g2o, .npz or 1DSfM file, not",
        "The checker reads g2o files, and archives.",
        proof=_PROOFS,
        file="pyfg",
    ),
    _is_refused(
        "the graph is not that of the file|a proof about rotations alone is of a text file",
        "A proof about an archive is about its own weights.",
        proof="file",
        file="npz",
        weights=_WEIGHTS,
    ),
    _is_refused(
        "a proof about rotations alone is of a text file",
        "An archive that the checker reads has positions.",
        proof="file",
        file="npz",
        relative_poses="rotations alone",
    ),
    _is_refused(
        "--proof needs an estimate of all nodes",
        "A proof is about the whole file.",
        proof=_PROOFS,
        estimate="part",
    ),
    _is_refused(
        "--proof is for --cost chordal and g2o",
        "The checker does not know GTSAM's cost.",
        proof=_PROOFS,
        cost="gtsam",
    ),
    _is_refused(
        "--robust --proof is for --cost chordal",
        "A proof of a truncated cost is about F.",
        proof=_PROOFS,
        outliers="robust",
        cost=_OTHERS,
    ),
    _is_refused(
        "is read as covariance: certpgo convert writes a g2o file with information matrices",
        "The checker reads information.",
        proof=_PROOFS,
        weights="covariance",
    ),
    _is_refused(
        "the checker holds no nodes that a file fixes",
        "The checker holds no nodes.",
        proof=_PROOFS,
        held="several",
    ),
    *(
        _is_refused(
            "the checker holds no nodes that a file fixes",
            "The checker holds no nodes.",
            proof=_PROOFS,
            held="one",
            **prior,
        )
        for prior in _priors()
    ),
    _is_refused(
        "the checker cannot read it: .* information that is not positive definite",
        "The checker reads definite matrices.",
        proof=_PROOFS,
        weights=("file", "quaternion"),
        partial_edges="axes",
    ),
    _is_refused(
        "--rejected --proof is for --cost chordal",
        "A proof of a truncated cost is about F.",
        proof=_PROOFS,
        rejected="listed",
        cost=_OTHERS,
    ),
    # Commands.
    _is_refused(
        "--timestamps needs --truth",
        "`compare` writes no estimates: times are those of the truth.",
        command="compare",
        times="given",
        truth="none",
    ),
    _is_refused(
        "are held where the file fixes them, which measurements from elsewhere do not know",
        "A stream may measure what is held.",
        command="follow",
        held="several",
    ),
    *(
        _is_refused(
            "are held where the file fixes them, which measurements from elsewhere do not know",
            "A stream may measure what is held.",
            command="follow",
            held="one",
            **prior,
        )
        for prior in _priors()
    ),
    # Files.
    _is_refused(
        "pyfg holds poses, and this graph measures rotations alone",
        "PyFG holds poses.",
        relative_poses="rotations alone",
        file="pyfg",
    ),
    _is_refused(
        "only .* files hold edges that measure only a rotation or a translation|"
        "this graph measures rotations alone",
        "PyFG has no edges of a rotation or a translation alone.",
        partial_edges=("turns", "steps"),
        file="pyfg",
    ),
    _is_refused(
        "pyfg holds covariances, and the information is not positive definite",
        "What is unknown has no covariance.",
        partial_edges="axes",
        file="pyfg",
    ),
    _is_refused(
        "pyfg has no measurements of an attitude alone",
        "PyFG has no attitudes alone.",
        attitudes="some",
        file="pyfg",
    ),
)
RULES = (*UNASKED, *REFUSED)
