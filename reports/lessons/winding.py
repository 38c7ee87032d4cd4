# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # Winding
#
# Cameras on a ring, each measured against the next. A wrong estimate of such a ring can look right
# at every edge: it makes one full turn more than the cameras did, and every residual is small. This
# lesson derives those estimates, shows why descent stops at them and why a certificate rejects
# them, and then escapes from them through a third dimension.

# %%
from collections import Counter

import matplotlib.pyplot as plt
import numpy as np

import certpgo
from certpgo.graph.relaxed_point import Lift
from certpgo.io.datasets.synthetic import winding_cycle
from certpgo.linalg import rotations as so
from certpgo.objective import operators
from certpgo.optimize.curvature import negative_curvature
from certpgo.optimize.low_rank_descent import descend, tangent_basis
from certpgo.optimize.methods.cycle_closed_form import stationary_point
from certpgo.optimize.riemannian_newton import newton

BLUE, VERMILION, GREY = "#0072B2", "#D55E00", "#999999"  # Okabe and Ito's
n, theta = 24, np.radians(20.0)

# %% [markdown]
# ## Stationary points in closed form
#
# A cycle of $n$ cameras in the plane, all weights 1. Composed around the cycle, the measurements
# miss the identity by the closing error $\theta$. The cost is
# $F(R) = \sum \|R_j - R_i R_{ij}\|_F^2$; an edge whose residual is a rotation by $a$ adds
# $4(1 - \cos a)$, and pulls its two cameras with strength $4 \sin a$. At a stationary point the two
# edges of every camera pull equally, so all residuals may be one angle $a$. They add up to the
# closing error, which is defined up to full turns:
#
# $$n a_k = \theta + 2 \pi k, \qquad
# F_k = 4 n (1 - \cos a_k) = 8 n \sin^2\frac{\theta + 2 \pi k}{2 n}.$$
#
# The integer $k$ is the *winding number*. `stationary_point(graph, k)` computes the rotations.

# %%
graph = winding_cycle(n, theta, 0, d=2)[0].graph  # identities, except one rotation by theta
problem = certpgo.Quadratic(graph)
points = {k: stationary_point(graph, k) for k in range(-3, 4)}
costs = {k: problem.cost(point) for k, point in points.items()}
formula = {k: 8 * n * np.sin((theta + 2 * np.pi * k) / (2 * n)) ** 2 for k in points}

print("winding   each residual      F      by the formula   gradient")
for k, point in points.items():
    angle = np.degrees(problem.residual_angles(point).max())
    print(
        f"{k:5}   {angle:10.2f} deg   {costs[k]:9.5f}   {formula[k]:9.5f}"
        f"   {problem.stationarity(point):9.1e}"
    )

# %% [markdown]
# Winding 0 distributes the closing error and is optimal. The others are wrong by up to half a turn,
# and yet their residuals are small: about 360 degrees over $n$ for one turn. On a ring of a
# thousand cameras that is a third of a degree.
#
# ## Why local search stops there
#
# To second order, turning the cameras by small angles $x$ changes $F$ by
# $2 \cos a_k\; x^T L_G\, x$, where $L_G$ is the cycle's graph Laplacian. As long as
# $|a_k| < 90^\circ$, that is nonnegative, and zero only if all cameras turn together. Hence every
# winding with $|\theta + 2 \pi k| < n \pi / 2$ is a strict local minimum. The package's exact
# Hessian of $F/2$ confirms this.


# %%
def hessian_eigenvalues(problem, estimate):
    """Of the Riemannian Hessian of F/2, ascending; one is zero: all cameras turn together."""
    blocks = problem.hessian(estimate, problem.multipliers(estimate))
    return np.linalg.eigvalsh(problem.pattern.assemble(*blocks).toarray())


second = {k: hessian_eigenvalues(problem, stationary_point(graph, k)) for k in range(-11, 12)}
minima = [k for k, values in second.items() if values[0] > -1e-9 and values[1] > 1e-9]
print(f"windings that are local minima: {minima[0]} ... {minima[-1]}, {len(minima)} in all")
print(f"second eigenvalue at winding 1: {second[1][1]:.6f}")
slope = 2 * np.cos((theta + 2 * np.pi) / n) * (2 - 2 * np.cos(2 * np.pi / n))
print(f"2 cos a_1 lambda_2(L_G):        {slope:.6f}")

# %% [markdown]
# Descent needs a good initial estimate; random ones are not good enough. Newton's method from 200
# random initial estimates:

# %%
rng = np.random.default_rng(0)
i, j = graph.edges.T


def winding_of(estimate):
    """Number of full turns of the residuals, beyond the closing error."""
    R = estimate.rotations
    residuals = so.log(R[i] @ graph.rotations @ np.swapaxes(R[j], 1, 2))[:, 0]
    return round((residuals.sum() - theta) / (2 * np.pi))


ended = Counter(
    winding_of(newton(problem, certpgo.Estimate(so.random(rng, n, 2))).estimate) for _ in range(200)
)
for k in sorted(ended):
    print(f"winding {k:2}: {ended[k]:3} of 200")

# %% [markdown]
# ## Why the certificate rejects them
#
# The certificate matrix $S = L - \operatorname{blkdiag}(\Lambda)$ of a stationary point must be
# positive semidefinite for a proof of optimality (see *Three cameras*). In the gauge of the point
# it is circulant, with $2 \cos a_k\, I$ on the diagonal and rotations by $\pm a_k$, negated, off
# the diagonal. Its eigenvalues, twice each, are $2 \cos a_k - 2 \cos(2 \pi j / n - a_k)$. With
# $j = k$ the second angle is $\theta / n$ only, and
#
# $$\lambda_{\min}(S) = 2 \cos \frac{\theta + 2 \pi k}{n} - 2 \cos \frac{\theta}{n},$$
#
# zero for $k = 0$ and negative for all other windings.

# %%
smallest = {}
for k, point in points.items():
    S = problem.certificate_matrix(problem.multipliers(point)).toarray()
    smallest[k] = np.linalg.eigvalsh(S)[0]
    expected = 2 * np.cos((theta + 2 * np.pi * k) / n) - 2 * np.cos(theta / n)
    verdict = certpgo.certify(problem, point).verdict.value
    print(f"winding {k:2}: eigenvalue {smallest[k] + 0.0:9.6f}, formula {expected:9.6f}, {verdict}")

# %% [markdown]
# A negative eigenvalue rules out the *proof*; it does not yet refute the estimate, because the
# relaxation might be loose. REFUTED says more: a lower-cost estimate is known. `certify` first
# descends from the estimate, without improvement. From another initialization it then reaches a
# lower-cost point that descent from the first does not, and keeps it.

# %%
certificate = certpgo.certify(problem, points[1])
print(certificate.verdict.value)
print(certificate.reason)
print(f"winding of the better estimate: {winding_of(certificate.better)}")

# %% [markdown]
# ## The way out: one more dimension
#
# A rotation $R_i$ of the plane is two orthonormal columns in $\mathbb R^2$. The *Riemannian
# staircase* (Boumal 2015; SE-Sync, IJRR 2019) lets them be orthonormal columns in $\mathbb R^3$:
# blocks $Y_i$ of size 3 x 2, with the same cost $\sum \|Y_j - Y_i R_{ij}\|_F^2$. There are more
# points, so a lower cost may be reachable, but none is below the value of the semidefinite
# relaxation.
#
# An eigenvector of $S$ with a negative eigenvalue is a descent direction. Written as a row $v_i$
# for each camera, it moves $Y_i$ from $[R_i; 0]$ towards $[R_i; v_i]$, into the new dimension, and
# $F$ changes by $\lambda_{\min} \|v\|^2 < 0$ to second order: the minimum has become a saddle.
#
# This uses the package's own low-rank descent. It is deterministic, so stopping it after 0, 1, 2,
# ... steps shows its intermediate points.


# %%
def on_the_way(start, rank, steps):
    """The descent's point after some steps from a point, first along the negative eigenvector."""
    _, direction = negative_curvature(problem, start)
    return descend(problem, start, rank, direction=direction, max_iterations=steps)


once = [on_the_way(points[1], 3, steps) for steps in (0, 1)]
caught = on_the_way(points[1], 3, 100)
freed = on_the_way(caught.point, 4, 100)
twice = [on_the_way(points[2], 3, steps) for steps in (0, 3, 6)]
straight = on_the_way(points[2], 3, 100)
print(f"winding 1: F {costs[1]:.4f}, in 3 dimensions {caught.cost:.4f}, in 4 {freed.cost:.4f}")
print(f"winding 2: F {costs[2]:.4f}, in 3 dimensions {straight.cost:.4f}")
print(f"winding 0: F {costs[0]:.4f}")

# %% [markdown]
# Each camera is drawn as two points on a sphere, the images of two axes of its body, joined from
# camera to camera along the ring. The axes turn by a share $\theta / n$ of the closing error from
# camera to camera, so that winding 0 is one point for all cameras, and winding $k$ goes $k$ times
# around the equator. Of all such pairs of axes, the figure shows the pair on which the descent acts
# most differently.

# %%
shares = so.exp(np.arange(n)[:, None] * theta / n)


def pictured(descents):
    """The (n, 3, 2) blocks of points of one descent, in the three dimensions that matter."""
    blocks = [point.rotations @ shares for point in descents]
    # The body axis whose images stay closest together comes first, and points up.
    axes = np.linalg.svd(blocks[2].mean(axis=0))[2].T
    up = np.sign((blocks[2] @ axes)[:, 2, 0].sum())
    seen = []
    for Y in blocks:
        rank = Y.shape[1]
        main = np.linalg.svd(np.moveaxis(Y, 1, 0).reshape(rank, -1))[0][:, :3].T
        three = np.pad(Y, ((0, 0), (0, 1), (0, 0))) if rank == 2 else Y if rank == 3 else main @ Y
        seen.append(three @ axes * np.array([1.0, 1.0, up])[:, None])
    return seen


def sphere(axes, Y, title):
    """Both points of every camera, seen from 25 degrees above the equator; the back is pale."""
    tilt, turn = np.radians(25.0), np.linspace(0.0, 2.0 * np.pi, 121)
    up = np.array([0.0, np.sin(tilt), np.cos(tilt)])
    towards = np.array([0.0, -np.cos(tilt), np.sin(tilt)])
    axes.plot(np.cos(turn), np.sin(turn), color=GREY, lw=0.6)
    axes.plot(np.cos(turn), np.sin(tilt) * np.sin(turn), color=GREY, lw=0.6, ls=":")
    for column, colour, size in ((1, VERMILION, 14), (0, BLUE, 7)):
        loop = np.concatenate([Y[:, :, column], Y[:1, :, column]]).T
        axes.plot(loop[0], up @ loop, color=colour, lw=0.8, alpha=0.6)
        alpha = np.where(towards @ loop >= -1e-9, 1.0, 0.3)
        axes.scatter(loop[0], up @ loop, s=size, color=colour, alpha=alpha, linewidths=0)
    axes.set(aspect="equal", xlim=(-1.08, 1.08), ylim=(-1.08, 1.08))
    axes.set_title(title, fontsize=8)
    axes.set_axis_off()


labels = (
    ["winding 1", "left the plane", "step 1", "caught, rank 3", "free, rank 4"],
    ["winding 2", "left the plane", "step 3", "step 6", "free, rank 3"],
)
paths = (
    [points[1], *(found.point for found in (*once, caught, freed))],
    [points[2], *(found.point for found in (*twice, straight))],
)
figure, rows = plt.subplots(2, 5, figsize=(7.6, 4.0), layout="constrained")
for row, path, names in zip(rows, paths, labels, strict=True):
    for axes, point, blocks, name in zip(row, path, pictured(path), names, strict=True):
        sphere(axes, blocks, f"{name}\nF = {problem.cost(point):.2f}")
for colour, label in ((BLUE, "images of one body axis"), (VERMILION, "of the other")):
    rows[0, 0].plot([], [], "o-", color=colour, ms=4, lw=0.8, label=label)
handles = rows[0, 0].get_legend_handles_labels()
figure.legend(*handles, loc="outside lower center", ncols=2, frameon=False, fontsize=8)
plt.show()

# %% [markdown]
# Top row: the blue points leave the equator and contract towards the pole. The red ones cannot
# follow. They go around a great circle, now about the axis that the blue points mark. This is again
# a local minimum, at about half the cost. Bottom row, winding 2: both leave the equator, and the
# descent ends at winding 0 without another dimension.
#
# The reason why two turns can be undone but one cannot is topological. A block of two orthonormal
# columns in $\mathbb R^3$ is a rotation of space (the third column follows), and in $SO(3)$ a loop
# of one full turn cannot be contracted to a point, while a loop of two can (the belt trick). In
# $\mathbb R^4$ every such loop can be contracted.
#
# The same facts in numbers: the smallest eigenvalues of the Hessian of $F/2$ at the local minimum
# that winding 1 reaches, and the smallest of the certificate matrix there. None of the former is
# negative (three zeros are rotations of the world, one is a common rotation of all cameras' body
# axes). The latter is negative, and its eigenvector leads into the fourth dimension.


# %%
def lifted_hessian_eigenvalues(lift):
    """Of the Hessian of F/2 at a point of the relaxation."""
    blocks = operators.lifted_hessian(
        problem.graph, tangent_basis(lift.rotations), problem.multipliers(lift)
    )
    return np.linalg.eigvalsh(problem.pattern.assemble(*blocks).toarray())


at_caught = lifted_hessian_eigenvalues(caught.point)
eigenvalue, _ = negative_curvature(problem, caught.point)
print(f"Hessian, rank 3:    {at_caught[:6].round(6) + 0.0}")
print(f"certificate matrix: {eigenvalue:.6f}")

# %% [markdown]
# `solve` does all of this by itself: it descends in the plane, finds the negative eigenvalue,
# escapes through a new dimension, rounds the point found there to rotations and descends from these
# in the plane again, adding dimensions until the estimate is certified. Rounding may lead to the
# optimum before the relaxation gets there, so fewer dimensions may suffice than above.

# %%
answer = certpgo.solve(graph, initial=points[1], try_own_start=False)
for level in answer.levels:
    print(f"rank {level.rank}: F {level.cost:.6f}")
print(f"answer: F {answer.cost:.6f}, winding {winding_of(answer.estimate)}, {answer.verdict.value}")

# %% [markdown]
# ## In space: a conjecture that fails
#
# In $SO(3)$ the cameras may leave the plane, and two turns can be undone there. Is every local
# minimum global in space, then? That was conjectured from experiments, by Tron and Vidal (2009) as
# Moreira (2020, section 2.2.3) reports. It is false, for the smallest ring already.
#
# *Proof.* Let all residuals be rotations about $z$ by $a = a_k$, and turn camera $i$ by the small
# vector $x_i = (u_i, z_i)$, with $u_i$ in the plane as a complex number. Expanding
# $-2 \operatorname{tr}(\exp[x_i]_\times E \exp[x_j]_\times^T)$ to second order, the terms of first
# order cancel around the ring, and what is left of $F$ is
#
# $$\sum_i\; 2 \cos a\, (z_i - z_{i+1})^2 + (1 + \cos a)\, |u_i - u_{i+1}|^2
#   + 2 \sin a\; \mathrm{Im}(\bar u_i u_{i+1}) .$$
#
# On $u_i = e^{\mathrm i \varphi i}$, $\varphi = 2 \pi m / n$, the terms in $u$ are, per camera,
#
# $$2 (1 + \cos a)(1 - \cos \varphi) + 2 \sin a \sin \varphi
#   = 8 \cos\frac a2\; \sin\frac\varphi2\; \sin\frac{\varphi + a}2 .$$
#
# For $m = 0$ this is zero, a rotation of the world. For $0 < m < n$ the first two factors are
# positive, and so is the third, for every $m$, exactly if $|a| < 2 \pi / n$. With $|a| < \pi / 2$
# the terms in $z$ are positive too, and the point is a strict local minimum up to rotations of the
# world. Now take a closing error $0 < \theta < 2\pi$: windings 0 and $-1$ have
# $a_0 = \theta / n$ and $a_{-1} = (\theta - 2 \pi)/n$, both below $2 \pi / n$ in size. For
# $\theta \ne \pi$ their costs differ, so that one of these local minima is not global.
# $\square$
#
# Three cameras suffice, with $\theta$ between 90 and 270 degrees. Here they are, and the ring from
# above:


# %%
def by_the_formula(n, a):
    """Eigenvalues of the Hessian of F/2 in space at residuals of one angle about z, ascending."""
    phi = 2 * np.pi * np.arange(n) / n
    across = 8 * np.cos(a / 2) * np.sin(phi / 2) * np.sin((phi + a) / 2)
    along = 4 * np.cos(a) * (1 - np.cos(phi))
    return np.sort(np.concatenate([np.repeat(across, 2), along]))


for size, closing in ((3, np.radians(120.0)), (n, theta)):
    ring = certpgo.Quadratic(winding_cycle(size, closing, 0, d=3)[0].graph)
    for k in (0, -1, 1):
        point = stationary_point(ring.graph, k)
        found = hessian_eigenvalues(ring, point)
        expected = by_the_formula(size, (closing + 2 * np.pi * k) / size)
        print(
            f"n = {size:2}, winding {k:2}: F {ring.cost(point):.4f}, Hessian's least "
            f"{found[0]:+.6f}, fourth {found[3]:+.6f}, off the formula by "
            f"{np.abs(found - expected).max():.0e}"
        )

# %% [markdown]
# ## Exercises
#
# **1.** How small does the negative eigenvalue of winding 1 become as the ring grows? From how many
# cameras on does a rule that accepts every eigenvalue above -0.001, whatever the weights, accept
# winding 1 (take $\theta = 0$)? What is the verdict of `certify` for a ring of that size?

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
# 2 cos(2 pi / n) - 2 is about -(2 pi / n)^2. An absolute threshold also changes its meaning with
# the unit of the weights: with all of them divided by 1000, every ring of 7 or more passes.
sizes = np.arange(3, 1000)
first = int(sizes[2 * np.cos(2 * np.pi / sizes) - 2 > -1e-3][0])
large = winding_cycle(first, 0.0, 1, d=2)
large_problem = certpgo.Quadratic(large[0].graph)
large_verdicts = [
    certpgo.certify(large_problem, point).verdict.value for point in (large[1], large[0].truth)
]
print(f"from n = {first} on; winding 1 and 0 of that ring: {large_verdicts}")

# %% [markdown]
# **2.** Take perfect measurements, $\theta = 0$. Write down the local minimum that winding 1
# reaches in three dimensions. Show that its cost is exactly half of winding 1's.

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
# One body axis points to the pole in all cameras, the other goes around the equator once. Only the
# second column costs anything: sum |y_j - y_i|^2 = n (2 sin(pi / n))^2 = 4 n sin^2(pi / n), while
# winding 1 has two columns that each cost that much.
perfect = certpgo.Quadratic(winding_cycle(n, 0.0, 0, d=2)[0].graph)
turn = 2 * np.pi * np.arange(n) / n
Y = np.zeros((n, 3, 2))
Y[:, 2, 0] = 1.0
Y[:, 0, 1], Y[:, 1, 1] = np.cos(turn), np.sin(turn)
half = Lift(Y)
half_cost = perfect.cost(half)
full_cost = perfect.cost(stationary_point(perfect.graph, 1))
left_over = perfect.gradient(half) - Y @ perfect.multipliers(half)
print(f"F {half_cost:.9f}, half of winding 1's {full_cost / 2:.9f}")
print(f"gradient beyond what the multipliers hold: {np.abs(left_over).max():.1e}")

# %% [markdown]
# **3.** Give one edge of the ring a tenth of the weight. What do the residuals of winding 0 look
# like, is its largest one below $\pi/n$ (Theorem 4.2 of Eriksson et al. 2018, for equal weights),
# and is it certified? Take a closing error of 90 degrees.

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
# Edges pull with kappa sin(angle), so the weak edge takes a large angle: more than pi / n. It is
# still optimal. In a weighted cycle it suffices that the residuals share axis and sign and add up
# to at most half a turn.
weights = np.ones(n)
weights[5] = 0.1
weak_graph = winding_cycle(n, np.radians(90.0), 0, d=2)[0].graph.with_weights(weights)
weak = certpgo.Quadratic(weak_graph)
weak_point = stationary_point(weak_graph)
weak_angles = weak.residual_angles(weak_point)
weak_certificate = certpgo.certify(weak, weak_point)
pulls = weights * np.sin(weak_angles)
print(f"residuals {np.degrees(weak_angles.min()):.2f} and {np.degrees(weak_angles.max()):.2f} deg,")
print(f"pi/n {180 / n:.2f} deg, sum {np.degrees(weak_angles.sum()):.2f} deg")
print(f"pulls equal up to {np.ptp(pulls):.1e}; {weak_certificate.verdict.value}")

# %% [markdown]
# **4.** Put the ring in space: all rotations about the $z$ axis, but free to leave it. Which
# windings are still local minima? Explain with the belt trick.

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
# Only 0 and -1, as the proof above says: |a_k| < 2 pi / n. A loop in SO(3) with an odd number of
# turns can always be deformed into a single turn, an even one into none. Winding -1 turns by 340
# degrees in all, the least of the odd ones (winding 1 turns by 380). Every other winding is a
# saddle, and descent leaves it without lifting.
space = winding_cycle(n, theta, 0, d=3)[0].graph
space_problem = certpgo.Quadratic(space)
space_minima = [
    k
    for k in range(-3, 4)
    if hessian_eigenvalues(space_problem, stationary_point(space, k))[0] > -1e-9
]
print(f"local minima in space: windings {space_minima}")
