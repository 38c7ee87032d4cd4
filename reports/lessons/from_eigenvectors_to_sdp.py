# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # From eigenvectors to SDP
#
# How low can the cost be? Every lower bound on $F^*$ in rotation averaging, from a few eigenvalues
# to a semidefinite program, is one inequality with different parameters. This lesson states it once
# and computes these bounds one by one on one real graph: the run time of each, and the improvement.
# The strongest is not the most expensive one.

# %%
import tempfile
import time
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import certpgo
from certpgo import Quadratic, get_solver, solve
from certpgo.errors import InputError
from certpgo.io import datasets
from certpgo.io.datasets.synthetic import helix
from certpgo.linalg import rotations as so
from certpgo.plot import STYLE
from certpgo.solve.bounds_table import ladder

# %% [markdown]
# ## The graph
#
# MIT is a robot's drive through the corridors of a university building (`MIT.g2o` of SE-Sync's
# repository): long chains of poses, and a few places where they close. We use only its rotations,
# in the plane, with the weights of the file. If the file is missing, a simulated helix replaces it.

# %%
try:
    instance = datasets.load("MIT", download=False, quiet=True)
except InputError:
    print("MIT.g2o is not here (CERTPGO_DATA names a folder): a simulated helix instead")
    instance = helix(7, np.random.default_rng(0), rotation_noise=0.2)
problem = Quadratic(instance.graph.rotations_alone)
n, d = problem.n, problem.d
print(instance.name, "in", d, "dimensions:", n, "nodes,", problem.graph.num_edges, "edges")

# %% [markdown]
# ## One inequality
#
# Let $F(R) = \operatorname{tr}(R L R^\top)$, $L$ the connection Laplacian. Choose *any* symmetric
# $d \times d$ blocks $\Lambda_i$ and *any* weights $w_i > 0$, and put
# $S = L - \operatorname{blkdiag}(\Lambda)$, $W = \operatorname{blkdiag}(w_i I)$. Every feasible $R$
# has $R_i^\top R_i = I$, hence
# $\operatorname{tr}(R \operatorname{blkdiag}(\Lambda) R^\top) = \operatorname{tr} \Lambda$; and it
# has $R_i R_i^\top = I$, hence $R W R^\top = (\sum w_i)\, I$. So
#
# $$ F(R) = \operatorname{tr} \Lambda + \operatorname{tr}(R S R^\top) \;\ge\;
#    \operatorname{tr} \Lambda + \Bigl(\sum_i w_i\Bigr) \sum_{k=1}^{d}
#    \lambda_k\bigl(W^{-1/2} S\, W^{-1/2}\bigr), $$
#
# because the rows of $R W^{1/2}$ are orthogonal and of squared length $\sum w_i$, and the trace of
# a symmetric matrix over $d$ orthonormal vectors is at least the sum of its $d$ smallest
# eigenvalues. The right-hand side does not depend on $R$: it is a lower bound on $F^*$. In code:


# %%
def lower_bound(multipliers, weights):
    """The inequality's right-hand side, by dense eigenvalues."""
    scale = np.repeat(weights**-0.5, d)
    scaled = scale[:, None] * problem.certificate_matrix(multipliers).toarray() * scale
    smallest = np.linalg.eigvalsh(scaled)[:d].sum()
    return np.trace(multipliers, axis1=1, axis2=2).sum() + weights.sum() * smallest


def timed(step, repeat=1):
    """The result of a step, and the seconds of its fastest repetition."""
    seconds = []
    for _ in range(repeat):
        start = time.perf_counter()
        result = step()
        seconds.append(time.perf_counter() - start)
    return result, min(seconds)


rungs = {}  # bound and seconds
nothing, alike = np.zeros((n, d, d)), np.ones(n)

# %% [markdown]
# ## Bound one: eigenvalues
#
# $\Lambda = 0$ and $w = 1$ give $n(\lambda_1 + \dots + \lambda_d)$, the bound that the thesis
# derives from its eq. 4.7. No estimate is needed. `EigenRA` computes it as a by-product, from a
# sparse factorization, and subtracts a bound on the eigenvalues' error.

# %%
eigen, seconds = timed(lambda: get_solver("eigen_ra")().solve(problem), repeat=3)
rungs["eigenvalues"] = eigen.lower_bound, seconds
print(f"by EigenRA {eigen.lower_bound:.6f}, by the inequality {lower_bound(nothing, alike):.6f}")

# %% [markdown]
# ## Bound two: weights
#
# With $\Lambda = 0$ and $w_i = \deg_i$, the weighted degrees, the matrix is the *normalized*
# connection Laplacian. A node with few or weak measurements no longer lowers the eigenvalues as
# easily. (The time is that of dense eigenvalues. Sparse ones would take as long as bound one.)

# %%
weighted, seconds = timed(lambda: lower_bound(nothing, problem.node_weights))
rungs["weighted, dense"] = weighted, seconds
print(f"weighted by degrees {weighted:.6f}")

# %% [markdown]
# ## Bound three: the best multipliers
#
# Which $\Lambda$ is best? If $S \succeq 0$ the eigenvalues can be omitted, and
#
# $$ \max_\Lambda \; \operatorname{tr} \Lambda \quad \text{such that} \quad
#    L - \operatorname{blkdiag}(\Lambda) \succeq 0 $$
#
# is Eriksson et al.'s dual program (D), eq. 18, in our sign: their $\Lambda_i$ is $\deg_i I$ less
# ours. Its dual is (DD), eq. 45: minimise $\operatorname{tr}(L Y)$ over $Y \succeq 0$ with
# $Y_{ii} = I$, which is the original problem with $Y = R^\top R$ without the rank constraint.
#
# *An interior-point method* (Clarabel, by way of CVXPY) solves (D). The value that a solver reports
# is not a bound, because its multipliers are feasible only up to a tolerance; `sdp_dual` shifts
# them until the matrix has a factor, and returns that bound.

# %%
sdp, seconds = timed(lambda: get_solver("sdp_dual")().solve(problem))
rungs["SDP"] = sdp.lower_bound, seconds
print(f"value {sdp.relaxation.value:.9f}, bound {sdp.lower_bound:.9f}")

# %% [markdown]
# *Block coordinate descent*, their Algorithm 1, works on (DD): it visits the nodes in turn, and
# finds each one's block row of $Y$ in closed form. Each $Y$ has multipliers, which give a bound by
# the inequality. The sweeps are cheap. But information travels one edge per visit: on chains as
# long as MIT's convergence is slow, while the helix, which is short, needs some tens of sweeps.

# %%
SWEEPS = 800
descent, seconds = timed(
    lambda: get_solver("block_coordinate_descent")(max_iterations=SWEEPS).solve(problem)
)
descended = lower_bound(descent.relaxation.multipliers, alike)
rungs["block descent"] = descended, seconds
print(f"{descent.iterations} sweeps, {descent.status.value}: bound {descended:.6f}")

# %% [markdown]
# ## Bound four: multipliers from a stationary point
#
# At a stationary point $R$ of the original problem the multipliers need no program. The KKT
# equations determine them: $\Lambda_i = \operatorname{sym}((L R^\top)_i R_i)$ (eq. 16). For these,
# whatever $R$ is, $\operatorname{tr}\Lambda = F(R)$, so if $S \succeq 0$ then the bound *is* the
# cost, and $R$ optimal. Finding $R$ takes a few sparse Newton steps from a good initial estimate,
# and checking $S \succeq 0$ one factorization. `certpgo.solve` does this, and its bound accounts
# for the rounding of the factorization:

# %%
answer, seconds = timed(lambda: solve(problem), repeat=3)
rungs["certificate"] = answer.certificate.lower_bound, seconds
F = answer.cost
by_inequality = lower_bound(problem.multipliers(answer.estimate), alike)
print(f"F           {F:.12f}  ({answer.verdict.value})")
print(f"certificate {answer.certificate.lower_bound:.12f}")
print(f"inequality  {by_inequality:.12f}  (dense, its rounding not bounded)")

# %% [markdown]
# ## Bound five: a proof
#
# The certificate trusts that the factorization satisfies the usual rounding bound. A proof trusts
# less: the multipliers are stored in a file with the estimate, and an independent program repeats
# the arithmetic, exactly where it matters. It factorizes once or twice, in plain NumPy, and takes
# as long as 40 to 240 compiled factorizations (`reports/results/proofs.md`); the time
# below is the checker's.

# %%
with tempfile.TemporaryDirectory() as folder:
    graph_file, proof_file = Path(folder, "rotations.g2o"), Path(folder, "rotations.cert")
    certpgo.write(graph_file, problem.graph)
    written = certpgo.read(graph_file, quiet=True)
    certificate = certpgo.certify(Quadratic(written.graph), answer.estimate)
    certpgo.write_proof(proof_file, graph_file, written, answer.estimate, certificate)
    proof, seconds = timed(lambda: certpgo.check(graph_file, proof_file))
rungs["proof"] = proof.lower, seconds
print(proof)

# %% [markdown]
# ## All bounds

# %%
print(f"{'':22s}{'bound':>18s}{'gap to F, relative':>22s}{'seconds':>10s}")
for name, (bound, seconds) in rungs.items():
    print(f"{name:22s}{bound:18.9f}{(F - bound) / F:22.1e}{seconds:10.4f}")

# %%
BLUE, VERMILION, GREY = "#0072B2", "#D55E00", "#777777"
with plt.rc_context(STYLE):
    figure, (upper, lower) = plt.subplots(
        2, 1, figsize=(3.46, 5.0), sharex=True, layout="constrained"
    )
    bounds, spent = np.transpose(list(rungs.values()))
    upper.axhline(F, color=VERMILION, label="$F^*$")
    upper.plot(spent, np.maximum(bounds, 0.0), "o", color=BLUE, label="lower bounds, named in (b)")
    upper.set(ylabel="bound on $F^*$", ylim=(0.0, 1.1 * F))
    upper.legend(loc="lower left")
    upper.set_title("(a) bounds", loc="left")
    gaps = np.maximum((F - bounds) / F, 1e-12)
    lower.loglog(spent, gaps, "o", color=BLUE)
    for k, name in enumerate(rungs):
        right = spent[k] > np.sqrt(spent.min() * spent.max())
        lower.annotate(
            name,
            (spent[k], gaps[k]),
            xytext=(-4 if right else 4, -9 if k % 2 else 4),
            textcoords="offset points",
            ha="right" if right else "left",
            fontsize=7,
        )
    lower.set(xlabel="seconds", ylabel="$(F^* - $ bound$)\\,/\\,F^*$", ylim=(1e-13, 10.0))
    lower.set_title("(b) what is missing", loc="left")

# %% [markdown]
# Note three things. Eigenvalues are nearly free and give the right order of magnitude. The
# general-purpose program gives nearly the full bound, but takes much longer. And the strongest
# bound is cheap: given a stationary point, its multipliers solve the program, and it only remains
# to check that they do. The program explains why this works (its optimum is what
# $\operatorname{tr}\Lambda$ attains), and where it cannot work: if the relaxation is not tight, no
# $\Lambda$ closes the gap, and the verdict is BOUNDED.
#
# ## The same from the command line
#
# `certpgo bounds GRAPH` prints such bounds, each with its run time and implication; `--sdp` adds
# the program. In Python it is `certpgo.solve.bounds_table.ladder`. Here it runs on the poses,
# translations included. Its middle entries are residual-angle bounds: Eriksson et al.'s Theorem 4.1
# states that a stationary point of rotation averaging whose residuals are all below an angle is
# optimal. For a pose graph they therefore concern rotation averaging on its rotations alone, never
# the full cost: there a point can be stationary, with zero rotation residuals, and far from optimal
# (exercise 4). They take one eigenvalue, and constrain every edge: where the Fiedler value is small
# relative to the degrees, as on long chains, the angle is tiny, and a single larger residual makes
# them inconclusive.

# %%
climbed = ladder(Quadratic(instance.graph))
print(f"F = {climbed.cost:.9g}, {climbed.certificate.verdict.value}")
for rung in climbed.rungs:
    if rung.value is not None:
        print(f"{rung.title}: {rung.shown}, {rung.seconds:.3f} s\n    {rung.says}")

# %% [markdown]
# ## Exercises
#
# **1.** Are the degrees the best weights? Try $w_i = \deg_i^p$ for $p$ from $-1$ to 2, with
# $\Lambda = 0$.

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
# Not in general. In the plane eigenvalues come in pairs, and to choose w is to choose multipliers
# mu w_i I, multiples of the identity: mu is where the smallest eigenvalue ends up. In space the
# three smallest differ, and the bound is larger than what their least gives as such a mu. The best
# choice of mu w_i is a semidefinite program as well.
powers = {0: eigen.lower_bound, 1: weighted}
for p in (-1, 2):
    powers[p] = lower_bound(nothing, problem.node_weights**p)
for p in sorted(powers):
    print(f"p = {p:2d}: {powers[p]:.6f}")

# %% [markdown]
# **2.** Compute the multipliers from EigenRA's rotations instead, which are near the optimum but
# not stationary. Is the bound above or below the true $F^*$, and which is nearer to it, the bound
# or the cost of the rotations? And at the optimum, with each rotation turned by a hundredth of a
# degree?

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
# tr Lam = F(R) holds anywhere, but S R^T = 0 only at a stationary point. Elsewhere the rows of R
# are not eigenvectors, and eigenvalues fall below zero, by about the gradient squared over the next
# eigenvalue. The bound stays valid, but is weaker the farther away the point is; certify descends
# to a stationary point first, because the bound belongs to the problem.
rng = np.random.default_rng(0)
tiny = so.exp(np.radians(0.01) * rng.standard_normal((n, so.tangent_dim(d))))
nearby = certpgo.Estimate(answer.estimate.rotations @ tiny)
off = {}
for name, point in (("EigenRA", eigen.estimate), ("0.01 degrees off", nearby)):
    off[name] = lower_bound(problem.multipliers(point), alike), problem.cost(point)
    print(f"{name}: {off[name][0]:.6f} <= {F:.6f} <= {off[name][1]:.6f}")

# %% [markdown]
# **3.** Is the relaxation tight here, and how does the solution of (DD) show it? Look at the rank
# of the program's $Y$ (`sdp.relaxation.rank`), and compare the rounded rotations' cost with the
# bound.

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
# Y = R^T R has the rank d. If the program's Y has it too, its factor consists of orthogonal
# matrices. If their determinants have one sign, they are rotations up to one reflection of the
# world: the dropped constraints hold, and the bound is attained. (The sign must be checked: see
# exercise 4 of *When duality fails*. The rounded cost below checks it.)
print("rank", sdp.relaxation.rank, "of", d * n, "in dimension", d)
print(f"bound {sdp.lower_bound:.7f} <= F* <= {sdp.cost:.7f}, of the rounded Y")

# %% [markdown]
# **4.** Two poses measure each other, $(0, 1)$ and $(1, 0)$: each measures the other as not turned
# and one metre ahead. Take $\kappa = 10^{-3}$ and $\tau = 1$. Find a stationary point of $F$ whose
# rotation residuals are zero. Is it optimal?

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
# Both rotations I: the positions cannot fit both measurements, and share the error of two metres.
# With pose 1 turned by half a turn about z each sees the other ahead, and only the rotations
# contribute, 2 kappa 8 = 0.016. The residual-angle bound holds for the rotations' own cost, which
# is zero at I, I.
both = np.array([[0, 1], [1, 0]])
ahead = np.array([[1.0, 0.0, 0.0]] * 2)
unturned = certpgo.RotationGraph(2, both, np.array([np.eye(3)] * 2), np.full(2, 1e-3))
facing = certpgo.Quadratic(certpgo.PoseGraph(unturned, ahead, np.ones(2)))
same = facing.complete(np.array([np.eye(3), np.eye(3)]))
opposed = facing.complete(np.array([np.eye(3), np.diag([-1.0, -1.0, 1.0])]))
print(f"F = {facing.cost(same):.3f}, gradient {facing.stationarity(same):.0e}, residuals zero")
print(f"F = {facing.cost(opposed):.3f} at half a turn")

# %% [markdown]
# ## What to remember
#
# - All these bounds are $\operatorname{tr} \Lambda$ plus eigenvalues of the remainder. Any
#   $\Lambda$ gives a valid one; the semidefinite program gives the best one.
# - Where the relaxation is tight, the best $\Lambda$ is a function of the optimal rotations. So
#   search first, by any means, and prove afterwards: the proof does not depend on how the point was
#   found.
#
# Sources: A. Eriksson, C. Olsson, F. Kahl, T.-J. Chin, *Rotation Averaging and Strong Duality*,
# CVPR 2018; G. Moreira, *A Unified Approach for Pose Graph Optimization*, 2020; D. Rosen, L.
# Carlone, A. Bandeira, J. Leonard, *SE-Sync*, IJRR 2019.
