"""Equations of both papers that no method computes: definitions, and steps of derivations.

Each is evaluated as printed (slips: as docs/notes/source_papers.md has it) on random rotations.
Eriksson et al. have world <- camera rotations; the thesis their inverses.
"""

import math

import numpy as np
import pytest

from certpgo.linalg import rotations as so

RNG = np.random.default_rng(7)
N = 6
EDGES = np.array([(0, 1), (1, 2), (2, 3), (3, 4), (4, 5), (5, 0), (0, 2), (1, 4)])
FROM, TO = EDGES.T
A = np.zeros((N, N))
A[FROM, TO] = A[TO, FROM] = 1.0
DEGREES = A.sum(axis=1)
LAPLACIAN = np.diag(DEGREES) - A
#: A bound on residuals, and rotations, measured to within it.
ALPHA = 0.4


def turns(m, largest):
    axis = RNG.standard_normal((m, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    return so.exp(RNG.uniform(-largest, largest, (m, 1)) * axis)


R = so.random(RNG, N, 3)
MEASURED = np.swapaxes(R[FROM], 1, 2) @ turns(len(EDGES), ALPHA) @ R[TO]


def block_matrix(measured):
    """Eriksson eq. 9."""
    blocks = np.zeros((N, 3, N, 3))
    blocks[FROM, :, TO], blocks[TO, :, FROM] = measured, np.swapaxes(measured, 1, 2)
    return blocks.reshape(3 * N, 3 * N)


def beside(R):
    """Eriksson eq. 10."""
    return np.concatenate(list(R), axis=1)


RTILDE = block_matrix(MEASURED)


def residuals(R):
    """(n, n, 3, 3) of E_ij = R_i Rtilde_ij R_j^T, zero without an edge."""
    blocks = RTILDE.reshape(N, 3, N, 3).transpose(0, 2, 1, 3)
    return np.einsum("iab,ijbc,jdc->ijad", R, blocks, R)


def multipliers(R):
    """Eriksson eq. 16, symmetrized, as a block diagonal matrix in the frame of the cameras."""
    E = residuals(R).sum(axis=1)
    Lam = np.swapaxes(R, 1, 2) @ (0.5 * (E + np.swapaxes(E, 1, 2))) @ R
    return diagonal(Lam)


def diagonal(blocks):
    whole = np.zeros((N, 3, N, 3))
    whole[np.arange(N), :, np.arange(N)] = blocks
    return whole.reshape(3 * N, 3 * N)


def test_graphs_eriksson_1_2_thesis_a_2():
    assert np.array_equal(A, A.T)
    assert (A.sum() / 2, np.trace(np.diag(DEGREES))) == (len(EDGES), 2 * len(EDGES))
    values = np.linalg.eigvalsh(LAPLACIAN)
    assert values[0] == pytest.approx(0.0, abs=1e-12)
    assert values[1] > 0.1  # Theorem A.2.1: connected; Definition A.2.5: Fiedler's value
    parted = np.kron(np.eye(2), LAPLACIAN)
    assert np.sum(np.linalg.eigvalsh(parted) < 1e-9) == 2


def test_the_problem_eriksson_4_6_to_11():
    exact = np.swapaxes(R[FROM], 1, 2) @ R[TO]
    np.testing.assert_allclose(R[FROM] @ exact, R[TO], atol=1e-12)
    Q = so.random(RNG, N, 3)
    distance = np.linalg.norm(Q[FROM] @ MEASURED - Q[TO], axis=(1, 2))
    angle = so.angle(np.swapaxes(Q[TO], 1, 2) @ Q[FROM] @ MEASURED)
    np.testing.assert_allclose(distance, 2.0 * math.sqrt(2.0) * np.sin(angle / 2.0), atol=1e-12)
    F, traces = (distance**2).sum(), np.einsum("mab,mbc,mac->", Q[FROM], MEASURED, Q[TO])
    assert pytest.approx(6.0 * len(EDGES) - 2.0 * traces) == F  # eq. 8 is half of (P)
    P = -np.trace(beside(Q) @ RTILDE @ beside(Q).T)
    assert pytest.approx(-2.0 * traces) == P
    assert np.array_equal(RTILDE, RTILDE.T)


def test_duality_eriksson_14_15_19_20():
    Q, S = beside(so.random(RNG, N, 3)), multipliers(R)
    left = -np.trace(Q @ RTILDE @ Q.T) - np.trace(S @ (np.eye(3 * N) - Q.T @ Q))
    assert left == pytest.approx(np.trace(Q @ (S - RTILDE) @ Q.T) - np.trace(S))
    # of exact measurements R is stationary, and the certificate matrix has no negative eigenvalue
    exact = block_matrix(np.swapaxes(R[FROM], 1, 2) @ R[TO])
    best = diagonal(DEGREES[:, None, None] * np.eye(3))
    np.testing.assert_allclose((best - exact) @ beside(R).T, 0.0, atol=1e-12)
    x = RNG.standard_normal((50, 3 * N))
    assert np.all(np.einsum("ka,ab,kb->k", x, best - exact, x) >= -1e-9)
    bound = np.trace(best) - np.trace(Q @ exact @ Q.T)
    assert 0.0 <= np.trace(Q @ (best - exact) @ Q.T) == pytest.approx(bound)


def delta():
    frame = diagonal(R)
    return frame @ (multipliers(R) - RTILDE) @ frame.T - np.kron(LAPLACIAN, np.eye(3))


def test_the_certificate_matrix_in_their_frame_eriksson_23_to_26():
    frame, E = diagonal(R), residuals(R)
    turned = (frame @ (multipliers(R) - RTILDE) @ frame.T).reshape(N, 3, N, 3)
    for i in range(N):
        row = E[i].sum(axis=0)
        np.testing.assert_allclose(turned[i, :, i], 0.5 * (row + row.T), atol=1e-12)
    np.testing.assert_allclose(turned[0, :, 1], -E[0, 1], atol=1e-12)
    exact = block_matrix(np.swapaxes(R[FROM], 1, 2) @ R[TO])
    best = diagonal(DEGREES[:, None, None] * np.eye(3))
    np.testing.assert_allclose(
        frame @ (best - exact) @ frame.T, np.kron(LAPLACIAN, np.eye(3)), atol=1e-12
    )


def test_bounds_on_its_blocks_eriksson_27_to_37():
    D = delta()
    norms = np.linalg.norm(D.reshape(N, 3, N, 3).transpose(0, 2, 1, 3), 2, axis=(2, 3))
    largest, half = np.abs(np.linalg.eigvalsh(D)).max(), math.sin(ALPHA / 2.0)
    assert largest <= norms.sum(axis=1).max()  # 27, 28
    assert np.all(np.diagonal(norms) <= 2.0 * DEGREES * half**2 + 1e-12)  # 29, 33
    assert np.all(norms[FROM, TO] <= 2.0 * half + 1e-12)  # 34, 36
    assert largest <= 2.0 * DEGREES.max() * half * (1.0 + half)  # 37
    angle, V = 0.7, R[0]
    c, s = math.cos(angle), math.sin(angle)
    E = V @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ V.T  # 30
    assert so.angle(E) == pytest.approx(angle)
    even = 0.5 * (E + E.T)
    np.testing.assert_allclose(even, V @ np.diag([c, c, 1.0]) @ V.T, atol=1e-12)  # 31
    values = np.linalg.eigvalsh(even - np.eye(3))
    assert c - 1.0 - 1e-12 <= values[0] <= values[-1] <= 1e-12  # 32
    v = RNG.standard_normal(3)
    v /= np.linalg.norm(v)
    between = math.acos(v @ E @ v)
    assert np.linalg.norm(v - E @ v) ** 2 == pytest.approx(2.0 - 2.0 * math.cos(between))  # 35
    assert np.linalg.norm(v - E @ v) <= math.sqrt(2.0 * (1.0 - c)) + 1e-12


def test_the_null_space_filled_up_eriksson_38_to_42():
    D, N_ = delta(), np.kron(np.ones((N, 1)), np.eye(3))
    fiedler = np.linalg.eigvalsh(LAPLACIAN)[1]
    filled = np.kron(LAPLACIAN, np.eye(3)) + 10.0 * N_ @ N_.T
    assert np.linalg.eigvalsh(filled)[0] == pytest.approx(fiedler)
    least = np.linalg.eigvalsh(filled + D)[0]  # 38, 39
    assert least >= fiedler - np.abs(np.linalg.eigvalsh(D)).max() - 1e-12  # 40
    most = DEGREES.max()
    for angle in (0.05, 0.2, 0.4, 0.8):
        x = math.sin(angle / 2.0)
        holds = fiedler - 2.0 * most * x * (1.0 + x) >= 0.0  # 41
        assert holds == ((x + 0.5) ** 2 <= fiedler / (2.0 * most) + 0.25)  # 42


T = RNG.standard_normal((N, 3))
#: The thesis' rotations, and its measurements of steps.
Q = np.swapaxes(R, 1, 2)
STEPS = RNG.standard_normal((len(EDGES), 3))


def misfits(Q, t):
    relative = Q[FROM] @ np.swapaxes(Q[TO], 1, 2)
    return STEPS - t[FROM] + np.einsum("mab,mb->ma", relative, t[TO]), MEASURED - relative


def log_likelihood(Q, t, sigma_t=0.7, sigma_r=0.3):
    """Thesis eq. 4.1."""
    traces = np.einsum("mab,mbc,mac->", MEASURED, Q[TO], Q[FROM])
    return -0.5 * (misfits(Q, t)[0] ** 2).sum() / sigma_t**2 + traces / sigma_r**2


def poses(Q, t):
    M = np.tile(np.eye(4), (len(Q), 1, 1))
    M[:, :3, :3], M[:, :3, 3] = Q, t
    return M


def test_distances_of_poses_thesis_2_2_2_3_2_8():
    M = poses(Q, T)
    whole = poses(MEASURED, STEPS) - M[FROM] @ np.linalg.inv(M[TO])
    steps, turned = misfits(Q, T)
    assert (whole**2).sum() == pytest.approx((steps**2).sum() + (turned**2).sum())
    traces = np.einsum("mab,mbc,mac->", MEASURED, Q[TO], Q[FROM])
    chordal = ((Q[FROM] - MEASURED @ Q[TO]) ** 2).sum()  # 2.8, with R_j for its R_j^T
    assert chordal == pytest.approx(6.0 * len(EDGES) - 2.0 * traces)


def test_newtons_step_thesis_2_16_2_17():
    H = np.diag([1.0, 2.0, 3.0]) + 0.1
    g, x = np.array([0.3, -0.2, 0.5]), RNG.standard_normal(3)
    step = -np.linalg.solve(H, g)
    value = lambda d: g @ d + 0.5 * d @ H @ d  # noqa: E731
    assert all(value(step) <= value(step + 0.01 * k * x) for k in (-1, 1))


def test_the_terms_of_rotations_thesis_4_2_to_4_6():
    t, k_t, k_r = T, 0.7**-2, 0.3**-2
    relative = Q[FROM] @ np.swapaxes(Q[TO], 1, 2)
    of_rotations = -k_t * np.einsum("ma,mab,mb->", STEPS - t[FROM], relative, t[TO])
    of_rotations += k_r * np.einsum("mab,mbc,mac->", MEASURED, Q[TO], Q[FROM])
    squares = (STEPS - t[FROM]) ** 2, t[TO] ** 2
    alone = -0.5 * k_t * sum(part.sum() for part in squares)
    assert log_likelihood(Q, t) == pytest.approx(of_rotations + alone)
    X = np.einsum("ma,mb->mab", t[TO], t[FROM] - STEPS) @ MEASURED
    for S in k_t * X + k_r * np.eye(3):  # 4.3, for any rotation in its place
        assert np.trace(S @ R[0]) <= np.linalg.svd(S, compute_uv=False).sum() + 1e-12
    # Hypothesis 4.1.1 with R_ij: exact measurements make X symmetric
    exact = relative
    steps = t[FROM] - np.einsum("mab,mb->ma", relative, t[TO])
    X = np.einsum("ma,mb->mab", t[TO], t[FROM] - steps) @ exact
    np.testing.assert_allclose(X, np.swapaxes(X, 1, 2), atol=1e-12)
    column, traces = Q.reshape(-1, 3), np.einsum("mab,mbc,mac->", MEASURED, Q[TO], Q[FROM])
    with_identities = RTILDE + np.eye(3 * N)
    assert np.trace(column.T @ with_identities @ column) == pytest.approx(2.0 * traces + 3.0 * N)
    weighted = np.kron(LAPLACIAN, np.ones((3, 3))) * with_identities  # 4.6
    assert np.trace(column.T @ weighted @ column) == pytest.approx((misfits(Q, t)[1] ** 2).sum())


def test_the_loss_of_eigenrao_never_vanishes_as_printed_thesis_4_9():
    rho = lambda exponent: -1.75 + 0.85 * math.exp(exponent)  # noqa: E731
    assert rho(math.pi - math.pi / 2.0) > 2.0
    assert rho((math.pi - math.radians(98.0)) / 2.0) < 0.0 < rho((math.pi - math.radians(96)) / 2.0)


def slope(f, X, k):
    h = np.zeros_like(X)
    h.flat[k] = 1e-6
    return (f(X + h) - f(X - h)) / 2e-6


def test_derivatives_thesis_b_2_to_b_8():
    B, C, v = RNG.standard_normal((4, 3)), RNG.standard_normal((3, 2)), RNG.standard_normal(3)
    D = RNG.standard_normal((4, 2))
    misfit = D - B @ C
    for function, at, derivative in (
        (lambda x: ((B @ x) ** 2).sum(), v, 2.0 * (B @ v) @ B),  # B.2
        (lambda x: ((x - B @ C) ** 2).sum(), D, 2.0 * misfit),  # B.3
        (lambda x: ((D - x @ C) ** 2).sum(), B, -2.0 * misfit @ C.T),  # B.4, put right
        (lambda x: log_likelihood(Q, x, 1.0), T, by_translations()),
    ):
        slopes = [slope(function, at, k) for k in range(at.size)]
        np.testing.assert_allclose(slopes, np.ravel(derivative), rtol=1e-6, atol=1e-6)


def by_translations():
    """Half of thesis eq. B.8, with t_j for its t_i, at sigma_t = 1."""
    total = -DEGREES[:, None] * T
    relative = Q[FROM] @ np.swapaxes(Q[TO], 1, 2)
    ahead = np.einsum("mab,mb->ma", relative, T[TO]) + STEPS
    # the edge seen from j: t_ji = -R_ji t_ij with the *estimated* R_ji, as B.6 has it
    behind = np.einsum("mba,mb->ma", relative, T[FROM] - STEPS)
    np.add.at(total, FROM, ahead)
    np.add.at(total, TO, behind)
    return total


def test_rotations_thesis_a_2_a_6():
    omega = so.hat(RNG.standard_normal(3))
    tangent = R[0] @ omega
    np.testing.assert_allclose(R[0].T @ tangent, -(R[0].T @ tangent).T, atol=1e-12)
    samples = R[0] @ turns(40, 0.5)
    mean = so.project(samples.sum(axis=0)[None])[0]
    likelihood = lambda S: np.trace(S.T @ samples.sum(axis=0))  # noqa: E731
    others = mean @ turns(50, 0.2)
    assert all(likelihood(other) <= likelihood(mean) for other in others)
