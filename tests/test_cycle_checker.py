"""The checker of proofs by cycles: its numbers, its refusals; damage proves nothing wrong."""

import hashlib
import json
import os
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import pose_graph, rng_of, seeds
from test_integer_checker import CLAIM

import certpgo
from certpgo import cycle_checker, integer_reader
from certpgo.certify.cycle_file import write_cycles
from certpgo.certify.cycles import prove
from certpgo.graph import Estimate
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.riemannian_newton import NewtonSettings, newton

#: How many damaged proofs are tried; more on demand.
PROOFS = int(os.environ.get("CERTPGO_MUTATIONS", "60")) // 2


def proven(folder, d, seed=3, n=7):
    """The file of a graph with a proof whose springs leave little, its document and F*."""
    graph = pose_graph(rng_of(seed), n, d, extra=4, noise=0.25)[0]
    path, proof = folder / "graph.g2o", folder / "graph.cycles"
    certpgo.write(path, graph)
    instance = certpgo.read(path, quiet=True)
    problem = Quadratic(instance.graph.rotations_alone)
    best = certpgo.solve(problem.graph, cost="chordal").estimate
    here = newton(problem, Estimate(best.rotations), NewtonSettings(max_iterations=99)).estimate
    answer = write_cycles(proof, path, instance, prove(problem, here))
    return path, json.loads(proof.read_text()), answer


def tried(path, document):
    """What is proven by a document, or None."""
    text = document if isinstance(document, str) else json.dumps(document)
    proof = path.with_name("tried.cycles")
    proof.write_text(text)
    try:
        return cycle_checker.check(path, proof)
    except (cycle_checker.Refused, cycle_checker.Unreadable):
        return None


@pytest.fixture(scope="module", params=[2, 3])
def example(request, tmp_path_factory):
    return proven(tmp_path_factory.mktemp("cycles"), request.param)


# --- Numbers


@given(st.floats(-7.0, 7.0) | st.floats(-64.0, 64.0) | st.floats(-1e-300, 1e-300))
@settings(max_examples=60)
def test_half_angles_are_those_of_the_integer_reader(theta):
    if 0.0 < abs(theta) < 1e-300:
        return
    one = integer_reader.ONE
    cosine, sine = integer_reader.half_angle(int(Fraction(theta) * one))
    assert cycle_checker.half_angle(theta) == [0, 0, sine / one, cosine / one]


def test_angles_beyond_are_refused():
    with pytest.raises(ValueError, match="too large"):
        cycle_checker.half_angle(65.0)


@given(seeds, st.sampled_from([2, 3]), st.sampled_from(["tangent", "quaternion"]))
@settings(max_examples=8)
def test_a_file_is_read_as_by_the_integer_checker(tmp_path_factory, seed, d, read_as):
    if d == 2:
        read_as = "tangent"
    path = tmp_path_factory.mktemp("read") / "graph.g2o"
    certpgo.write(path, pose_graph(rng_of(seed), 5, d)[0])
    text, claim = path.read_bytes(), {**CLAIM, "d": d, "rotation_information": read_as}
    one = integer_reader.ONE
    theirs = integer_reader.read_graph(text, claim, None).edges
    ours = cycle_checker.read_graph(text.decode(), claim)
    assert len(ours) == len(theirs)
    for (i, j, q, kappa), edge in zip(ours, theirs, strict=True):
        assert (i, j, kappa) == (edge.i, edge.j, Fraction(edge.kappa, one))
        ratio = {Fraction(a, b) for a, b in zip(q, edge.q, strict=True) if b}
        assert len(ratio) == 1
        assert [bool(a) for a in q] == [bool(b) for b in edge.q]


def test_bounds_of_a_triangle_by_hand():
    """Residuals of a quarter turn beside exact quaternions: F and the loss in closed form."""
    turn = [0, 0, 1, 3]  # cos a = 4/5, sin a = 3/5
    edges = [(0, 1, turn, Fraction(5)), (1, 2, turn, Fraction(5)), (2, 0, turn, Fraction(5))]
    R = {k: [0, 0, 0, 1] for k in range(3)}
    # c = 4, phi = 3: three springs of 3/sqrt(3) or more pass.
    upper, lower = cycle_checker.bounds(edges, R, [([3], [1, 2, 3], [2, 2, 2])], Fraction(1))
    assert upper == 12
    assert 0 <= upper - lower < Fraction(1, 10**50)
    with pytest.raises(cycle_checker.Refused, match="too soft"):
        cycle_checker.bounds(edges, R, [([3], [1, 2, 3], [1, 1, 1])], Fraction(1))
    # Without the cycle each edge loses 4 (sqrt(4^2 + 3^2) - 4).
    assert cycle_checker.bounds(edges, R, [], Fraction(1))[1] == 0
    # Half the torque: 4 (sqrt(2^2 + 1.5^2) - 2) each.
    half = [([1], [1, 2, 3], [1, 1, 1])]
    _, lower = cycle_checker.bounds(edges, R, half, Fraction(3, 2))
    assert float(lower) == pytest.approx(12 - 3 * 4 * (1.5 - 4 + np.hypot(1.5 - 4, 1.5)), rel=1e-14)


def test_walks_backwards_count_against(example):
    path, document, answer = example
    for cycle in document["cycles"]:
        cycle[1] = [-k for k in cycle[1][::-1]]
        cycle[2] = cycle[2][::-1]
    assert tried(path, document).lower < answer.lower
    for cycle in document["cycles"]:
        cycle[0] = [-f for f in cycle[0]]
    assert tried(path, document) == answer


# --- Files


def test_the_program(tmp_path):
    path, document, answer = proven(tmp_path, 3)
    proof = path.with_name("program.cycles")
    proof.write_text(json.dumps(document))
    program = Path(cycle_checker.__file__)
    run = [sys.executable, "-I", str(program)]
    done = subprocess.run([*run, path, proof], capture_output=True, text=True)
    assert (done.returncode, done.stdout.splitlines()[0]) == (0, str(answer))
    assert done.stdout.startswith("PROVED: F(x) <= ")
    proof.write_text(json.dumps({**document, "graph_sha256": ""}))
    done = subprocess.run([*run, path, proof], capture_output=True, text=True)
    assert (done.returncode, done.stdout[:8]) == (6, "REFUSED:")
    done = subprocess.run([*run, path, path], capture_output=True, text=True)
    assert (done.returncode, done.stderr[:6]) == (1, "error:")
    assert subprocess.run(run, capture_output=True).returncode == 2


@pytest.mark.parametrize(
    "changes",
    [
        {"format": "certpgo proof"},
        {"version": 2},
        {"d": 4},
        {"bits": 0.5},
        {"bits": "40"},
        {"rotations": []},
        {"kappa": [1, 0]},
        {"cycles": [[[1], [1], [1]]]},
        {"cycles": [[[1], [0, 0, 0], [1, 1, 1]]]},
        {"cycles": [[[1], [1, -1, 99], [1, 1, 1]]]},
        {"cycles": [[[1], [], []]]},
        {"cycles": None},
        {"rotation_information": "nonsense"},
        {"d": 2, "rotation_information": "quaternion"},
        {"bits": 10**30},
        {"bits": -(10**30)},
        {"kappa": ["1e999999999"]},
        {"kappa": [True, 1]},
    ],
)
def test_wrong_documents_are_refused(example, changes):
    path, document, _ = example
    assert tried(path, {**document, **changes}) is None


def test_what_is_no_document_is_refused(example):
    path, document, _ = example
    text = json.dumps(document)
    first = str(document["rotations"][0][0])
    for wrong in ("", "[" * 100000, text[:-9], text.replace(first, first + ".0", 1)):
        assert tried(path, wrong) is None
    for number in ("NaN", "1e999", "Infinity", "1" * 5000):
        assert tried(path, text.replace(first, number, 1)) is None


@pytest.mark.parametrize(
    "line",
    [
        "EDGE_SE2_XY 0 1 1 1 1 0 1",
        "EDGE_SE2 0 0 1 1 0 1 0 0 1 0 1",
        "EDGE_SE2 0 1 1 1 nan 1 0 0 1 0 1",
        "EDGE_SE2 0 1 1 1 1_0 1 0 0 1 0 1",
        "EDGE_SE2 0 1 1 1 0 1 0 0 1 0",
        "EDGE_SE3:QUAT 0 1 1 1 0 0 0 0 1",
        "EDGE_SE2 0 1 1 1 0 1 0 0 1 0 1\x0bEDGE_SE2 0 1 1 1 0 1 0 0 1 0 1",
        "EDGE_SE2 0 1 1 1 0 1 0 0 1 0 -1",
        "ELSE",
    ],
)
def test_other_lines_are_refused(tmp_path, line):
    path, document, _ = proven(tmp_path, 2)
    path.write_text(f"{path.read_text()}{line}\n")
    document["graph_sha256"] = hashlib.sha256(path.read_bytes()).hexdigest()
    assert tried(path, document) is None


# --- Damage


def damaged(rng, document):
    """One number, list or word of a document changed."""
    document = json.loads(json.dumps(document))
    kind = rng.integers(8)
    cycles, rotations = document["cycles"], document["rotations"]
    c = int(rng.integers(len(cycles)))
    row = (
        cycles[c][int(rng.integers(3))]
        if kind < 5
        else rotations[int(rng.integers(len(rotations)))]
    )
    if kind < 7:
        k = int(rng.integers(len(row)))
        change = [
            lambda x: x + 1,
            lambda x: x - 1,
            lambda x: -x,
            lambda x: 2 * x,
            lambda x: x // 2,
            lambda x: 0,
            lambda x: x ^ (1 << int(rng.integers(60))),
            lambda x: x << 200,
        ]
        row[k] = change[int(rng.integers(len(change)))](row[k])
        return document
    which = rng.integers(7)
    if which == 0:
        document["bits"] += int(rng.choice([-300, -1, 1, 2, 300]))
    elif which == 1:
        cycles.append(cycles[c])
    elif which == 2:
        del cycles[c]
    elif which == 3:
        cycles[c][1].reverse()
    elif which == 4:
        rotations[0], rotations[1] = rotations[1], rotations[0]
    elif which == 5:
        document["d"] = 5 - document["d"]
    else:
        cycles[c][2] = cycles[c][2][1:]
    return document


def test_damaged_proofs_prove_nothing_wrong(example):
    """Accepted ones state bounds that are true: F* is known to twenty digits."""
    path, document, answer = example
    accepted, wrong = 0, []
    for seed in range(PROOFS):
        found = tried(path, damaged(rng_of(seed), document))
        accepted += found is not None
        # Relative, as F* is between the bounds of the proof.
        if found is not None and not found.lower <= answer.upper <= found.upper * (
            1 + Fraction(1, 10**15)
        ):
            wrong.append(seed)
    assert wrong == []
    assert 0 < accepted < PROOFS
