"""kappa and tau are the exact rational functions of the information's text, rounded once."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from certpgo.errors import InputError
from certpgo.io.exact import weighing
from certpgo.io.exact.information import ROW_MAJOR_2D, ROW_MAJOR_3D, TORO_2D, weights


def inverse_trace(A):
    """tr(A^-1) by Gauss-Jordan elimination in Fractions."""
    n = len(A)
    rows = [[*A[i], *(Fraction(i == j) for j in range(n))] for i in range(n)]
    for k in range(n):
        pivot = rows[k][k]
        rows[k] = [x / pivot for x in rows[k]]
        for i in range(n):
            if i != k:
                factor = rows[i][k]
                rows[i] = [x - factor * y for x, y in zip(rows[i], rows[k], strict=True)]
    return sum(rows[i][n + i] for i in range(n))


def expected(text, layout):
    numbers = [Fraction(token) for token in text.split()]
    A = [[numbers[p] for p in row] for row in layout.positions]
    d = layout.d
    t = [row[:d] for row in A[:d]]
    R = [row[d:] for row in A[d:]]
    tau = Fraction(d) / inverse_trace(t)
    kappa = R[0][0] if d == 2 else Fraction(3) / (2 * inverse_trace(R))
    return float(kappa), float(tau)


def text_of(A, layout, digits):
    p = len(layout.positions)
    tokens = [""] * layout.size
    for i in range(p):
        for j in range(i, p):
            tokens[layout.positions[i][j]] = f"{A[i, j]:.{digits}g}"
    return " ".join(tokens)


@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([ROW_MAJOR_2D, ROW_MAJOR_3D, TORO_2D]),
    st.sampled_from([3, 6, 9, 17]),
    st.integers(-6, 6),
)
def test_weights_equal_fractions(seed, layout, digits, exponent):
    rng = np.random.default_rng(seed)
    p = len(layout.positions)
    B = rng.standard_normal((p, p))
    text = text_of((B @ B.T + np.eye(p)) * 10.0**exponent, layout, digits)
    assert weights(text, layout) == expected(text, layout)
    kappa, tau, *_ = weighing.weigh([text.encode()], layout)
    assert (kappa[0], tau[0]) == expected(text, layout)


@given(st.integers(0, 2**32 - 1), st.sampled_from([ROW_MAJOR_2D, ROW_MAJOR_3D]))
def test_batches_equal_the_definition(seed, layout):
    rng = np.random.default_rng(seed)
    p = len(layout.positions)
    texts = []
    for k in range(40):
        B = rng.standard_normal((p, p - (k % 3 == 0)))
        # Some are nearly singular, some have more digits than doubles hold.
        A = B @ B.T + 10.0 ** rng.integers(-7, 1) * np.eye(p)
        texts.append(text_of(A, layout, int(rng.integers(6, 18))))
    exact = []
    for text in texts:
        try:
            exact.append((text, *weights(text, layout)))
        except InputError:
            continue  # rounding the text made it indefinite
    kappa, tau, *_ = weighing.weigh([text.encode() for text, _, _ in exact], layout)
    assert kappa.tolist() == [k for _, k, _ in exact]
    assert tau.tolist() == [t for _, _, t in exact]


def test_most_batches_need_no_integers(monkeypatch):
    rng = np.random.default_rng(1)
    asked = []
    definition = weighing.weights

    def counting(text, layout):
        asked.append(text)
        return definition(text, layout)

    monkeypatch.setattr(weighing, "weights", counting)
    B = rng.standard_normal((500, 6, 6))
    texts = [text_of(b @ b.T + np.eye(6), ROW_MAJOR_3D, 8).encode() for b in B]
    weighing.weigh(texts, ROW_MAJOR_3D)
    assert len(asked) < 5


@pytest.mark.parametrize(
    ("text", "layout", "kappa", "tau"),
    [
        ("10 0 0 0 0 0 10 0 0 0 0 10 0 0 0 100 0 0 100 0 25", ROW_MAJOR_3D, 25.0, 10.0),
        ("44.635358 -7.96222 0 376.51638 0 9745.79165", ROW_MAJOR_2D, 9745.79165, None),
        ("1 0 4 9 0 0", TORO_2D, 9.0, 1.6),
        ("+1. 0 0 1E0 0 .5", ROW_MAJOR_2D, 0.5, 1.0),
        ("0.1 0 0 0.1 0 0.3", ROW_MAJOR_2D, 0.3, 0.1),
    ],
)
def test_known_weights(text, layout, kappa, tau):
    found = weights(text, layout)
    assert found[0] == kappa
    assert tau is None or found[1] == tau


def test_each_text_gives_weights():
    texts = [b"1 0 0 1 0 2", b"3 0 0 3 0 4", b"1 0 0 1 0 2"]
    kappa, tau, indefinite, _ = weighing.weigh(texts, ROW_MAJOR_2D)
    assert (kappa.tolist(), tau.tolist()) == ([2, 4, 2], [1, 3, 1])
    assert not indefinite.any()


def test_coupling_makes_the_whole_indefinite_but_not_the_blocks():
    coupled = b"1 0 5 1 0 1"
    kappa, tau, indefinite, *_ = weighing.weigh([coupled, coupled], ROW_MAJOR_2D)
    assert (kappa.tolist(), tau.tolist(), indefinite.tolist()) == ([1, 1], [1, 1], [True, True])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 0 0 1 0", "6 information numbers expected, 5 found"),
        ("1 0 0 1 0 1 1", "6 information numbers expected, 7 found"),
        ("1 0 0 1 0 x", "decimal numbers"),
        ("1 0 0 1 0 1_0", "decimal numbers"),
        ("1 0 0 1 0 nan", "decimal numbers"),
        ("1 0 0 1 0 inf", "decimal numbers"),
        ("1 0 0 1 0 1e", "decimal numbers"),
        ("1 0 0 1 0 ;", "decimal numbers"),
        ("1e400 0 0 1 0 1", "out of range"),
        ("1e-5000 0 0 1 0 1", "out of range"),
        ("1e9999999999 0 0 1 0 1", "out of range"),
        ("1 0 0 1 0 1e-390", "double's range"),
        ("1 0 0 1 0 1e390", "double's range"),
        ("0 0 0 0 0 0", "nothing is measured"),
        ("1 0 0 1 0 -2", "rotation block"),
        ("1 1 0 1 0 1", "translation block"),
        ("-1 0 0 -1 0 1", "translation block"),
    ],
)
def test_bad_information_is_refused(text, message):
    for attempt in (
        lambda: weights(text, ROW_MAJOR_2D),
        lambda: weighing.weigh([b"1 0 0 1 0 1", text.encode()], ROW_MAJOR_2D),
    ):
        with pytest.raises(InputError, match=message):
            attempt()


def test_surplus_and_lack_in_two_texts_do_not_cancel():
    with pytest.raises(InputError, match="5 found"):
        weighing.weigh([b"1 0 0 1 0", b"1 0 0 1 0 1 1"], ROW_MAJOR_2D)
