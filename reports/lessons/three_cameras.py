# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # Three cameras
#
# Three cameras, with a measured relative rotation for each pair. The three measurements disagree by
# some angle. Which orientations fit them best, and how can one *know* that no others fit better?
# With three cameras in the plane, all matrices are 6 x 6 and can be inspected. The package does the
# same for thousands of cameras in space.

# %%
import matplotlib.pyplot as plt
import numpy as np
from scipy.optimize import brentq

import certpgo
from certpgo.certify.bounds import alpha_max, fiedler_value
from certpgo.io.datasets.synthetic import complete, winding_cycle

BLUE, VERMILION, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#999999"  # Okabe and Ito's
plt.rcParams.update({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False})

# %%
corners = np.array([[0.0, 0.0], [2.0, 0.0], [1.0, 1.7]])
fig, ax = plt.subplots(figsize=(4.2, 3.2), layout="constrained")
for i, j in ((0, 1), (1, 2), (2, 0)):
    ax.annotate("", corners[j], corners[i], arrowprops={"arrowstyle": "->", "color": GREY})
    ax.text(*(0.5 * (corners[i] + corners[j]) + (0.0, 0.08)), f"$R_{{{i}{j}}}$", color=GREY)
for k, at in enumerate(corners):
    for axis, ink in zip(np.eye(2), (VERMILION, GREEN), strict=True):
        turn = np.radians(-40.0 * k)
        turned = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]) @ axis
        ax.annotate("", at + 0.45 * turned, at, arrowprops={"arrowstyle": "-|>", "color": ink})
    ax.text(*(at - (0.55 if k == 2 else 0.0, 0.25 * (k < 2))), f"camera {k}", ha="center")
ax.set(xlim=(-0.6, 2.6), ylim=(-0.5, 2.4), aspect="equal")
ax.set_axis_off()

# %% [markdown]
# ## The problem
#
# $R_i \in SO(2)$ maps camera $i$'s frame to the world's. An edge $(i, j)$ measures
# $R_{ij} \approx R_i^T R_j$, here with weight 1, and the cost is
#
# $$F(R) = \sum_{(i,j)} \|R_j - R_i R_{ij}\|_F^2 .$$
#
# Turning all cameras together, $R_i \to Q R_i$, changes no measured angle and leaves $F$ unchanged.
# This freedom is called the *gauge*: orientations are known up to a common rotation.
#
# Each camera's axes can be chosen freely: replacing $R_i$ by $R_i Q_i$ changes $R_{ij}$ to
# $Q_i^T R_{ij} Q_j$ and leaves $F$ unchanged. So two of the three measurements can be made the
# identity. The third is then a rotation by the *closing error* $\theta$: the composition of the
# measurements around the triangle.


# %%
def rotation(angle):
    """The rotation of the plane by an angle, radians."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def measurements(theta):
    """R_ij of each edge (i, j)."""
    return {(0, 1): rotation(0.0), (1, 2): rotation(0.0), (2, 0): rotation(theta)}


def cost(R, theta):
    """F, edge by edge."""
    return sum(((R[j] - R[i] @ M) ** 2).sum() for (i, j), M in measurements(theta).items())


# %% [markdown]
# $F$ is quadratic in the entries of $R = [R_1\; R_2\; R_3]$, a 2 x 6 matrix. Multiplied out,
# $F(R) = \operatorname{tr}(R L R^T)$ with the *connection Laplacian* $L$: the number of neighbours
# times the identity on the diagonal, $-R_{ij}$ off the diagonal.


# %%
def connection_laplacian(theta):
    """L, 6 x 6."""
    L = 2.0 * np.eye(6)
    for (i, j), M in measurements(theta).items():
        L[2 * i : 2 * i + 2, 2 * j : 2 * j + 2] = -M
        L[2 * j : 2 * j + 2, 2 * i : 2 * i + 2] = -M.T
    return L


rng = np.random.default_rng(1)
theta = np.radians(120.0)
L = connection_laplacian(theta)
R = np.stack([rotation(angle) for angle in rng.uniform(-np.pi, np.pi, 3)])
row = np.hstack(R)  # 2 x 6
by_edges, by_matrix = cost(R, theta), np.trace(row @ L @ row.T)
print(f"F, edge by edge {by_edges:.12f}, tr(R L R^T) {by_matrix:.12f}")

# %% [markdown]
# ## A stationary point
#
# Distribute the closing error evenly: camera $k$ turns by $-k\theta/3$, and every residual
# $R_i R_{ij} R_j^T$ is then a rotation by $a = \theta/3$. In angles a term of $F$ is
# $4(1 - \cos a)$, with derivative $4\sin a$. Camera $k$ lies between two edges that pull with the
# same strength in opposite senses, so the gradient is zero, and
#
# $$F = 3 \cdot 4(1 - \cos a) = 24 \sin^2\tfrac{a}{2}.$$
#
# This is called a *stationary point*. It may be the global minimum, a local minimum, or a saddle.


# %%
def shared_out(theta):
    """The rotations that give each edge a third of the closing error."""
    return np.stack([rotation(-k * theta / 3.0) for k in range(3)])


R = shared_out(theta)
F = cost(R, theta)
print(f"F = {F:.12f}, 24 sin^2(a/2) = {24 * np.sin(theta / 6) ** 2:.12f}")

# %% [markdown]
# ## The Lagrangian
#
# The constraints, $R_i^T R_i = I$ for each camera, make the problem hard. (A rotation also has
# determinant 1. Dropping that admits more points, so a bound that holds without it also holds with
# it.) Lagrange's idea is to drop a constraint and penalise its violation. A symmetric matrix
# $\Lambda_i$ of penalties for each camera, its *multipliers*, gives
#
# $$\ell(R, \Lambda) = \operatorname{tr}(R L R^T) + \sum_i \operatorname{tr}\bigl(\Lambda_i
# (I - R_i^T R_i)\bigr) = \operatorname{tr}(R\, S\, R^T) + \operatorname{tr}\Lambda,
# \qquad S = L - \operatorname{blkdiag}(\Lambda_1, \Lambda_2, \Lambda_3).$$
#
# Wherever the constraints hold, $\ell = F$, for any multipliers. (The derivation is that of
# Eriksson, Olsson, Kahl and Chin, *Rotation Averaging and Strong Duality*, CVPR 2018.)
#
# Now minimise $\ell$ over *all* 2 x 6 matrices. A quadratic form without constraints is easy: if
# $S$ has a negative eigenvalue, $\ell$ is unbounded below; if $S$ is positive semidefinite, written
# $S \succeq 0$, the minimum is $\operatorname{tr}\Lambda$, at $R = 0$. The minimum over more points
# is no larger, hence **weak duality**:
#
# $$S \succeq 0 \quad\Longrightarrow\quad \operatorname{tr}\Lambda \le F(R') \quad
# \text{for all rotations } R'.$$
#
# Any multipliers with $S \succeq 0$ prove that no rotations cost less than
# $\operatorname{tr}\Lambda$. Such multipliers are called *feasible*. Here are a thousand such
# proofs. Random symmetric blocks become feasible by adding the smallest eigenvalue of $S$ to their
# diagonals, which shifts that of $S$ to zero.


# %%
def certificate_matrix(L, multipliers):
    """S = L - blkdiag(Lam)."""
    S = L.copy()
    for i, block in enumerate(multipliers):
        S[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] -= block
    return S


def random_feasible(L):
    """Random multipliers, shifted until S is positive semidefinite."""
    blocks = rng.normal(scale=0.2, size=(3, 2, 2))
    blocks = blocks + np.swapaxes(blocks, 1, 2)
    smallest = np.linalg.eigvalsh(certificate_matrix(L, blocks))[0]
    return blocks + smallest * np.eye(2)


dual_values = [np.trace(random_feasible(L), axis1=1, axis2=2).sum() for _ in range(1000)]
angles = rng.uniform(-np.pi, np.pi, (1000, 3))
primal_values = [cost(np.stack([rotation(x) for x in triple]), theta) for triple in angles]
print(f"largest of 1000 random lower bounds {max(dual_values):.4f}")
print(f"smallest of 1000 random costs {min(primal_values):.4f}, F at the stationary point {F:.4f}")

# %%
fig, ax = plt.subplots(figsize=(5.2, 2.6), layout="constrained")
bins = np.linspace(min(0.0, min(dual_values)), max(primal_values), 80)
ax.hist(dual_values, bins, color=BLUE, label="1000 lower bounds")
ax.hist(primal_values, bins, color=VERMILION, label="1000 costs")
ax.axvline(F, color="black", linestyle="--", label="the stationary point")
ax.set(xlabel="$F$, or a bound on it", ylabel="how many")
ax.legend(frameon=False)

# %% [markdown]
# Every bound is below every cost, and the stationary point is cheaper than all random rotations.
# Whether some bound reaches it is the question of the next section.
#
# ## The dual problem
#
# The best lower bound of this kind is the *dual problem*:
#
# $$\text{(D)}\qquad \max_\Lambda\ \operatorname{tr}\Lambda \quad\text{such that}\quad
# L - \operatorname{blkdiag}(\Lambda) \succeq 0 .$$
#
# It is a semidefinite program: convex, hence without spurious local optima, and solvers exist. Its
# own dual replaces $R^T R$ in $F = \operatorname{tr}(L R^T R)$ by any positive semidefinite matrix
# with identities as diagonal blocks. That is the *convex relaxation* of the problem. $R^T R$ has
# rank 2, and what is dropped is this condition on the rank: a solution of rank 2 is the product
# $R^T R$ of orthogonal matrices again. The relaxation has the same value as (D), and is called
# *tight* where this value is $F^*$. Here is the result of
# a solver in the package.


# %%
def triangle(a):
    """The same three measurements, residual angle a, as the package's problem."""
    return certpgo.Quadratic(winding_cycle(3, 3.0 * a, 0, d=2)[0].graph)


program = certpgo.get_solver("sdp_dual")()
problem = triangle(theta / 3.0)
dual_value = program.solve(problem).relaxation.value
print(f"value of (D) {dual_value:.6f}, F at the stationary point {F:.6f}")

# %% [markdown]
# The bound reaches the cost. So the stationary point is optimal: **strong duality**, no gap.
#
# ## The multipliers in closed form
#
# No solver was needed. If $R$ is stationary, the multipliers at which $\ell$ is stationary too
# follow from $R$ itself. The derivative of $\ell$ in $R$ is $2RS$; setting its $i$-th block to zero
# gives $R_i \Lambda_i = (RL)_i$, so that
#
# $$\Lambda_i = R_i^T (R L)_i = \deg_i I - \sum_j R_i^T R_j R_{ji}.$$
#
# Such $\Lambda_i$ are symmetric exactly where $R$ is stationary: turning camera $i$ by a small
# $\Omega$, $R_i \to R_i(I + \Omega)$ with $\Omega^T = -\Omega$, changes $F$ by
# $2\operatorname{tr}(\Omega^T \Lambda_i)$, which is zero for all $\Omega$ if and only if
# $\Lambda_i$ has no skew part. Their traces add up to $\operatorname{tr}(R L R^T) = F(R)$. Here
# $\Lambda_i = 2(1 - \cos a)\, I$.


# %%
def multipliers(R, L):
    """Lam_i = R_i^T (R L)_i, symmetrized (which changes nothing at a stationary point)."""
    product = np.hstack(R) @ L
    blocks = np.stack([R[i].T @ product[:, 2 * i : 2 * i + 2] for i in range(3)])
    return (blocks + np.swapaxes(blocks, 1, 2)) / 2.0


Lam = multipliers(R, L)
S = certificate_matrix(L, Lam)
eigenvalues = np.linalg.eigvalsh(S)
trace = np.trace(Lam, axis1=1, axis2=2).sum()
print(f"Lam_0 =\n{Lam[0].round(6) + 0.0}")
print(f"largest entry of R S: {np.abs(np.hstack(R) @ S).max():.1e}; tr(Lam) = {trace:.12f}")
print(f"eigenvalues of S: {eigenvalues.round(6) + 0.0}")

# %% [markdown]
# $S$ is the *certificate matrix*. Two of its eigenvalues are zero, since $RS = 0$: rotating the
# world does not change $F$. The others are positive, so $S \succeq 0$, $\Lambda$ is feasible for
# (D), and its value there is $F(R)$. For any other rotations $R'$, in one line:
#
# $$F(R') = \operatorname{tr}(R' S R'^T) + \operatorname{tr}\Lambda \;\ge\; \operatorname{tr}\Lambda
# = F(R).$$
#
# That is the complete proof of optimality: one matrix is positive semidefinite. `certify` checks
# this by a factorization whose rounding errors it bounds.

# %%
certificate = certpgo.certify(problem, certpgo.Estimate(R))
print(f"{certificate.verdict.value}: {certificate.reason}")

# %% [markdown]
# ## Where the proof ends
#
# Let the residual angle $a = \theta/3$ grow. In the gauge of $R$ (block $(i, j)$ of $S$ multiplied
# by $R_i$ and $R_j^T$) $S$ is circulant, with $2\cos a\, I$ on the diagonal and rotations by
# $\pm a$, negated, off the diagonal. Its eigenvalues are, twice each, $0$ and
#
# $$3 \cos a \pm \sqrt3 \sin a .$$
#
# The smaller one is $2\sqrt3\,\cos(a + 30^\circ)$, which changes sign at $a = 60^\circ$. The code
# below does not use the closed form: it computes eigenvalues and finds the zero. Adding a large
# multiple of $R^T R$ removes the two zeros of the world's rotation.


# %%
def smallest_eigenvalue(a):
    """Of the certificate matrix at residual angle a, excluding the world's rotation."""
    L, R = connection_laplacian(3.0 * a), shared_out(3.0 * a)
    row = np.hstack(R)
    return np.linalg.eigvalsh(certificate_matrix(L, multipliers(R, L)) + 10.0 * row.T @ row)[0]


grid = np.radians(np.linspace(0.0, 90.0, 91))
smallest = np.array([smallest_eigenvalue(a) for a in grid])
off = np.abs(smallest - (3.0 * np.cos(grid) - np.sqrt(3.0) * np.sin(grid))).max()
zero = brentq(smallest_eigenvalue, 0.1, 1.5)
print(f"largest difference from the closed form: {off:.1e}")
print(f"the eigenvalue changes sign at {np.degrees(zero):.6f} degrees")

# %% [markdown]
# What happens at 60 degrees? There $\theta = 180^\circ$. Beyond it, going around the other way
# costs less: the closing error is also $\theta - 360^\circ$, with residuals $a - 120^\circ$. That
# is a second stationary point, a *rival*, and from $a = 60^\circ$ on it has the lower cost. The
# certificate matrix stops being positive semidefinite at exactly the angle where the point stops
# being optimal.
#
# The first point stays a local minimum: turning the cameras by small angles $x$ changes $F$ by
# $2 \cos a\; x^T L_G\, x$ to second order, with $L_G$ the triangle's graph Laplacian, and this is
# nonnegative up to $a = 90^\circ$. Local descent from the point does not find the rival.

# %%
for a in np.radians((50.0, 70.0)):
    judged = certpgo.certify(triangle(a), certpgo.Estimate(shared_out(3.0 * a)))
    print(f"residuals of {np.degrees(a):.0f} degrees: {judged.verdict.value}\n  {judged.reason}")

# %% [markdown]
# With a negative eigenvalue $-\eta$ the multipliers still give a bound. $\Lambda - \eta I$ is
# feasible for (D), and its value is $F - d n \eta$, here with $d n = 6$. The figure shows this
# bound, the cost of the point and of its rival, and the value of (D) from the semidefinite-program
# solver.

# %%
point = 24.0 * np.sin(grid / 2.0) ** 2
rival = 24.0 * np.sin((2.0 * np.pi / 3.0 - grid) / 2.0) ** 2
own_bound = point - 6.0 * np.maximum(-smallest, 0.0)
solved_at = np.radians(np.arange(5.0, 90.0, 10.0))
dual_curve = np.array([program.solve(triangle(a)).relaxation.value for a in solved_at])
s = np.sin(grid / 2.0)
guaranteed = 3.0 - 4.0 * s * (1.0 + s)  # see below

figure, (left, right) = plt.subplots(1, 2, figsize=(7.4, 2.9), layout="constrained")
left.plot(np.degrees(grid), smallest, color=BLUE, label="computed")
left.plot(np.degrees(grid), guaranteed, color=VERMILION, ls="--", label="guaranteed")
left.axhline(0.0, color=GREY, lw=0.8)
left.set(ylabel="smallest eigenvalue", title="(a) the certificate matrix")
inset = left.inset_axes((0.71, 0.58, 0.28, 0.33))
inset.plot(np.degrees(grid), smallest - guaranteed, color=BLUE)
inset.set(xlim=(0, 90), ylim=(0, 0.1), xticks=(0, 60), yticks=(0, 0.1))
inset.set_title("difference", fontsize=7.5)
inset.tick_params(labelsize=7.5)
inset.axvline(60.0, color=GREY, lw=0.8)
right.plot(np.degrees(grid), point, color=BLUE, label="F of the point")
right.plot(np.degrees(grid), rival, color=GREEN, ls="--", label="F of its rival")
right.plot(np.degrees(grid), own_bound, color=VERMILION, ls=":", label="bound from its multipliers")
right.plot(np.degrees(solved_at), dual_curve, "k.", label="value of (D)")
right.set(ylabel="cost", ylim=(-1, 19), title="(b) primal and dual values")
for axes in (left, right):
    axes.axvline(60.0, color=GREY, lw=0.8)
    axes.set(xlabel="residual angle a, degrees", xticks=range(0, 91, 15), xlim=(0, 90))
    axes.legend(frameon=False, fontsize=7.5)
plt.show()

# %% [markdown]
# Left of 60 degrees the point, the bound from its own multipliers and the dual value coincide.
# Right of it the dual value follows the rival: the relaxation is tight on both sides, but
# the *point* is no longer optimal. A lower bound belongs to the problem, not to the point whose
# multipliers prove it, and here even the wrong point's multipliers, shifted, prove the best bound
# possible. (This is due to the triangle's symmetry. In general they prove less.)
#
# ## A bound on angles, and its 60 degrees
#
# Other graphs have no closed form, but a bound holds for all of them. In the gauge of $R$,
# $S = L_G \otimes I + \Delta$: the graph Laplacian, each entry times an identity block, and a
# perturbation made of the residuals $E_{ij} = R_i R_{ij} R_j^T$. With spectral norms, all residual
# angles at most $a$, and $s = \sin(a/2)$,
#
# - $\|\Delta_{ij}\| = \|I - E_{ij}\| \le 2s$ for each neighbour $j$ of $i$,
# - $\|\Delta_{ii}\| \le \deg_i (1 - \cos a) = 2 \deg_i s^2$,
#
# so no eigenvalue of $\Delta$ exceeds in absolute value the largest sum of norms over a row of
# blocks (Gershgorin, by blocks), $2 d_{\max}\, s(1 + s)$. Both $S$ and $L_G \otimes I$
# vanish on rotations of the world. On its complement $L_G$ is at least its second eigenvalue
# $\lambda_2$, the *Fiedler value*, which measures how well connected the graph is. So $S \succeq 0$
# as long as
#
# $$\lambda_2 \ge 2 d_{\max}\, s (1 + s)
# \quad\Longleftrightarrow\quad
# a \le \alpha_{\max} = 2 \arcsin\Bigl(\sqrt{\tfrac14 + \tfrac{\lambda_2}{2 d_{\max}}}
# - \tfrac12\Bigr),$$
#
# which is Theorem 4.1 of the paper. A triangle has $\lambda_2 = 3$ and $d_{\max} = 2$: the root
# is $1$, the sine $\tfrac12$, and $\alpha_{\max} = 60^\circ$. The dashed curve of panel (a) is
# $\lambda_2 - 2 d_{\max}\, s (1 + s)$. It lies below the computed eigenvalue (the inset shows by
# how much) and meets it at zero: for three cameras the theorem is sharp. A complete graph of $n$
# cameras has $\lambda_2 = n$ and $d_{\max} = n - 1$; its angle decreases to a limit that holds for
# complete graphs of any size (Corollary 4.1).

# %%
fiedler = fiedler_value(problem)
triangle_bound = alpha_max(fiedler / problem.node_weights.max())
print(f"lambda_2 = {fiedler:.6f}, alpha_max = {np.degrees(triangle_bound):.6f} degrees")
print(f"smallest (computed - guaranteed): {(smallest - guaranteed).min():.1e}")

complete_bounds = {}
for n in (3, 4, 5, 10, 30, 100):
    graph = complete(n, 0.0, np.random.default_rng(0)).graph
    bound = alpha_max(fiedler_value(certpgo.Quadratic(graph)) / (n - 1))
    complete_bounds[n] = np.degrees(bound)
    print(f"K_{n:<4} {complete_bounds[n]:8.4f} degrees")
limit = np.degrees(alpha_max(1.0))
print(f"limit  {limit:8.4f} degrees")

# %% [markdown]
# ## Exercises
#
# **1.** Take perfect measurements, $\theta = 0$, and turn camera 0 by 40 degrees. All residuals are
# below 60 degrees, and yet $F > 0 = F^*$. Why does the bound not apply to this point? What does
# the certificate matrix show?

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
# The theorem is about stationary points, and this is not one: F decreases as the camera turns back.
# The multipliers still exist, and so does the bound F - d n eta. It is useless, as it must be: S >=
# 0 would prove tr(Lam) = F > 0 to be a lower bound on F* = 0.
L0 = connection_laplacian(0.0)
turned = np.stack([rotation(np.radians(40.0)), rotation(0.0), rotation(0.0)])
negative = np.linalg.eigvalsh(certificate_matrix(L0, multipliers(turned, L0)))[0]
turned_cost = cost(turned, 0.0)
turned_bound = turned_cost + 6.0 * negative
print(f"F = {turned_cost:.4f}, smallest eigenvalue {negative:.4f}, bound {turned_bound:.4f}")

# %% [markdown]
# **2.** At $a = 60^\circ$ the point and its rival cost the same. How many eigenvalues of $S$ are
# zero there, and how is that related to the two optima?

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
# S certifies both optima R and R' at once: F(R') = tr(R' S R'^T) + tr(Lam) = F(R) makes tr(R' S
# R'^T) zero, so the rows of R' lie in the null space too. Two optima, two rows each, make four
# zeros. The relaxation's solution is then not unique: any mixture of R^T R and R'^T R' has the
# same value, and a mixture has rank 4 instead of 2.
L1, R1 = connection_laplacian(np.pi), shared_out(np.pi)
R2 = np.stack([rotation(k * np.pi / 3.0) for k in range(3)])
S1 = certificate_matrix(L1, multipliers(R1, L1))
zeros = int((np.abs(np.linalg.eigvalsh(S1)) < 1e-12).sum())
mixture = (np.hstack(R1).T @ np.hstack(R1) + np.hstack(R2).T @ np.hstack(R2)) / 2.0
mixture_rank = int(np.linalg.matrix_rank(mixture, tol=1e-9))
print(f"{zeros} zeros; costs {cost(R1, np.pi):.9f} and {cost(R2, np.pi):.9f}")
print(f"the mixture: value {np.trace(L1 @ mixture):.9f}, rank {mixture_rank}")

# %% [markdown]
# **3.** Put the same three cameras in space, with rotations about the $z$ axis. Which eigenvalues
# of the certificate matrix are new, and does the sign still change at 60 degrees?

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
# Residuals about z fix the z axis: there E_ij is 1 and S is the graph Laplacian itself, with
# eigenvalues 0, 3, 3. Three zeros now belong to rotations of the world; the rest, including the
# angle, is unchanged.
space, best = winding_cycle(3, theta, 0, d=3)
problem3 = certpgo.Quadratic(space.graph)
S3 = problem3.certificate_matrix(problem3.multipliers(best)).toarray()
eigenvalues3 = np.linalg.eigvalsh(S3)
print((eigenvalues3.round(6) + 0.0).tolist())
