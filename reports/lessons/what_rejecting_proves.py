# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # What rejecting proves, and what it does not
#
# A robust method keeps some measurements and rejects others. A certificate for the kept ones says
# that nothing fits *these* better. It says nothing about the choice. This lesson certifies the
# choice too: a rejected measurement becomes an edge of *negative* weight, and one factorization
# covers all $2^k$ ways to take some back. At the end we see what this still cannot show.

# %%
import itertools

import matplotlib.pyplot as plt
import numpy as np

import certpgo
from certpgo import PoseGraph, certify, solve, solve_robustly
from certpgo.graph import RotationGraph
from certpgo.io.datasets import synthetic
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.solve.outlier_report import outlier_report

BLUE, VERMILION, GREEN, BLACK = "#0072B2", "#D55E00", "#009E73", "#000000"

# %% [markdown]
# ## The truncated cost
#
# Leaving a measurement out must cost something, else we would leave out all of them. So give each
# rejected measurement a price $c_e$. With kept measurements $K$ and rejected ones $O$,
#
# $$ f_T(x) = \sum_{e \in K} f_e(x) + \sum_{e \in O} \min(f_e(x), c_e) . $$
#
# A measurement with $f_e > c_e$ is left out, and pays its price. One with $f_e < c_e$ is taken
# back. So the minimum of $f_T$ is over all estimates *and* over all choices among $O$.
#
# $f_T$ is not convex, not even in the relaxation. But for a bound we need only something simpler
# that lies below it.

# %% [markdown]
# ## The negative edge
#
# Take one number $z$, measured as 0 with weight $\kappa$ and rejected, as the estimate is far
# away at $p$. We look for a parabola below $\min(\kappa z^2, c)$ that touches at $p$. As $\min$
# is flat there, the parabola has its top at $p$: $m(z) = c - \beta (z - p)^2$. It has to pass
# below $\kappa z^2$ near 0. The sum $\kappa z^2 + \beta (z - p)^2$ is smallest at $z = \beta p /
# (\kappa + \beta)$, where it is
#
# $$ \frac{\kappa \beta}{\kappa + \beta}\, p^2 . $$
#
# So $m$ is a minorant if and only if this *parallel sum* of $\kappa$ and $\beta$, times $p^2$, is
# at least $c$. The farther away the measurement, the flatter the parabola may be.

# %%
kappa, price = 1.0, 4.0
z = np.linspace(-3.0, 9.0, 600)


def weight(p):
    """The smallest beta with kappa beta / (kappa + beta) p^2 = c."""
    return kappa * price / (kappa * p**2 - price)


def minorant(z, p):
    return price - weight(p) * (z - p) ** 2


figure, axes = plt.subplots(figsize=(7.0, 3.2))
axes.plot(z, np.minimum(kappa * z**2, price), color=BLACK, label=r"$\min(f, c)$")
for p, colour in ((3.0, VERMILION), (6.0, BLUE)):
    axes.plot(z, minorant(z, p), color=colour, label=rf"$\beta$ = {weight(p):.3f}")
    axes.plot(p, price, "o", color=colour)
axes.set(ylim=(-3.0, 5.0), xlabel="$z$, measured as 0", ylabel="cost")
axes.legend(loc="lower right")
figure.tight_layout()

gaps = {p: float((np.minimum(kappa * z**2, price) - minorant(z, p)).min()) for p in (3.0, 6.0)}
print({p: f"weight {weight(p):.3f}, smallest gap {gap:.1e}" for p, gap in gaps.items()})

# %% [markdown]
# In a pose graph $m$ is an edge: it measures the estimate's own relative pose, with weight
# $-\beta$. At the estimate it has no residual, so it pulls at nothing, and the multipliers stay
# as they are. The certificate matrix changes from $S_K$ to
#
# $$ S_K - \sum_{e \in O} B_e W_e B_e^\top , $$
#
# $W_e$ the weights and $B_e$ the columns of the edges. If it is positive semidefinite, the
# estimate is optimal over all estimates and all choices. That is one factorization, for any
# number of rejections.

# %% [markdown]
# ## A grid with wrong loops
#
# Poses on a grid, and six wrong loop closures.

# %%
rng = np.random.default_rng(0)
clean = synthetic.grid3d(4, rng).graph
n, wrong_count = clean.num_nodes, 6
ends = np.array([rng.choice(n, 2, replace=False) for _ in range(wrong_count)])
rotation = RotationGraph(
    n,
    np.concatenate([clean.edges, ends]),
    np.concatenate([clean.rotations, so.random(rng, wrong_count, 3)]),
    np.r_[clean.kappa, np.full(wrong_count, np.median(clean.kappa))],
)
graph = PoseGraph(
    rotation,
    np.concatenate([clean.translations, rng.normal(size=(wrong_count, 3))]),
    np.r_[clean.tau, np.full(wrong_count, np.median(clean.tau))],
)
answer = solve_robustly(graph)
print("rejected:", answer.solution.rejected, "of", graph.num_edges)
print(answer.rejection.sentence)

# %% [markdown]
# The price is a quantile of $\chi^2$: what a correct measurement exceeds in one clean graph of a
# hundred. Six doubtful measurements are few enough to try the choices that take back one or two.

# %%
prices = answer.rejection.prices
tried = {}
for choice in itertools.product((0, 1), repeat=wrong_count):
    factors = np.ones(graph.num_edges)
    factors[answer.solution.rejected] = choice
    if sum(choice) <= 2:
        taken = solve(graph.reweighted(factors), initial=answer.estimate, max_rank=3)
        tried[choice] = taken.cost + prices @ (1 - np.array(choice))
ranked = sorted(tried.values())
print(f"{len(tried)} choices: the best costs {ranked[0]:.3f}, the next {ranked[1]:.1f}")
print(f"certified: at least {answer.rejection.certificate.lower_bound:.3f}")

# %% [markdown]
# ## What accepting one costs
#
# How much would $F$ rise if one rejected measurement were accepted? The largest $W_e$ that $S_K$
# can spare is $G_e^{-1}$, where $G_e = B_e^\top S_K^+ B_e$ is the *effective resistance* between
# the ends of the edge. With it, the parallel sum proves a rise of
#
# $$ \operatorname{tr}\left(P\, (D_e^{-1} + G_e)^{-1} P^\top\right) , $$
#
# $P$ the residual and $D_e$ the weights of the measurement. That is the innovation of a Kalman
# filter, but as a bound over all estimates.

# %%
report = outlier_report(answer)
for edge in report.edges[:4]:
    print(f"{edge.i}-{edge.j}: term {edge.cost:.0f}, accepting costs at least {edge.rise:.0f}")
print(f"{len(report.cores)} sets that share nothing contain a wrong measurement each")

# %% [markdown]
# Each rise is above the budget of a right measurement (its quantile at $10^{-6}$), so each is
# wrong *if the kept ones are right*. The last line needs no such trust: a wrong loop with a path
# between its ends does not close, whatever the rest says, and disjoint sets count separately.

# %% [markdown]
# ## Where it fails
#
# The certificate fails when a measurement was rejected that the estimate is too uncertain to
# contradict. Here is a chain of 30 poses and one loop that does not fit. With the loop left out
# the chain is straight, and descent sees no reason to bend it: the loop's term is far above its
# price.

# %%
steps = 30
chain = np.array([(i, i + 1) for i in range(steps - 1)] + [(0, steps - 1)])
turns = np.tile(np.eye(2), (steps, 1, 1))
forward = np.tile([1.0, 0.0], (steps, 1))
forward[-1] = [steps - 1.0, 1.5]
loop = PoseGraph(
    RotationGraph(steps, chain, turns, np.full(steps, 300.0)), forward, np.full(steps, 100.0)
)
along = certpgo.Estimate(
    np.tile(np.eye(2), (steps, 1, 1)), np.c_[np.arange(steps), np.zeros(steps)]
)
doubtful = certify(loop, along, rejected=np.array([steps - 1]))
together = solve(loop)
print(f"left out: {doubtful.cost_upper:.2f}, taken back: {together.cost:.2f}")
print(doubtful.verdict, "-", doubtful.limited_by.value)

# %% [markdown]
# But a chain of 30 bends easily, and taking the loop back costs much less than its price. The
# edge of negative weight would need more resistance than the chain has, and the certificate names
# the loop as ambiguous.

# %% [markdown]
# ## What it does not prove
#
# 1. **That the kept measurements are right.** They are not truncated in $f_T$. If two loops are
#    wrong in the same way, and the right one was rejected, the choice can be certified.
# 2. **That the price is right.** A larger price takes more back. The verdict names the price.
# 3. **Anything about measurements that nothing checks.** A bridge always fits.
#
# The first in an example: three measurements between two rotations, of which two agree on a wrong
# turn.

# %%
quarter = so.exp(np.array([[0.0], [1.5], [1.5]]))
majority = RotationGraph(2, np.array([[0, 1]] * 3), quarter, np.full(3, 100.0))
fooled = certpgo.Estimate(quarter[[0, 1]])
verdict = certify(majority, fooled, rejected=np.array([0]))
out = Quadratic(majority).cost(fooled)
print(verdict.verdict, f"although the only right measurement, of cost {out:.0f}, is out")

# %% [markdown]
# ## Exercises
#
# 1. The weight $\beta$ grows without bound as $\kappa p^2$ falls to $c$. What does that say about
#    measurements whose residual is just above the threshold?
# 2. Set `quantile=0.9` in `solve_robustly` for the grid. Does the verdict change? Which way is
#    easier to certify, a high price or a low one?
#
# :::{dropdown} Solutions
# 1. No parabola passes between them: at $f = c$ the truncated cost has a corner. Such
#    measurements are ambiguous, and the certificate names them.
# 2. It is still CERTIFIED. A lower price needs less negative weight, so it is easier to certify,
#    but it rejects more.
# :::
