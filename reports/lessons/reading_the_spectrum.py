# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # Reading the spectrum
#
# Two matrices are known before any estimation: the Laplacian of the graph, which contains the
# edges, and the connection Laplacian, which also contains the measured rotations. The difference of
# their eigenvalues shows how inconsistent the measurements are; the eigenvectors give an estimate,
# and the eigenvalues a lower bound on the minimum cost. A conjecture about them, nearly true for
# random graphs, is false, and it is instructive to see why.

# %%
import matplotlib.pyplot as plt
import numpy as np

from certpgo import Estimate, Instance, Quadratic, get_solver, solve
from certpgo.graph import RotationGraph
from certpgo.io.datasets.synthetic import winding_cycle
from certpgo.io.datasets.thesis import langevin_graph
from certpgo.linalg import rotations as so
from certpgo.optimize.spectral import smallest_eigenpairs, spectral_bound
from certpgo.plot import STYLE
from certpgo.solve.consistency import consistency, perturbation_bound

# %% [markdown]
# ## Two Laplacians
#
# A graph with $n$ nodes and weights $\kappa_{ij}$ has the Laplacian $L_G = D - A$ (Eriksson et al.,
# eq. 2): degrees on the diagonal, $-\kappa_{ij}$ at the edges. Its smallest eigenvalue is 0, with
# the vector of ones. The second one, $\lambda_2(L_G)$, is the *Fiedler value*: 0 if the graph is
# disconnected, small if a few edges connect it, $n$ for the complete graph.
#
# The *connection Laplacian* $L$ replaces each number by a rotation: blocks $\deg_i I$ on the
# diagonal and $-\kappa_{ij} \tilde R_{ij}$ at the edges (thesis, eq. 4.6). It is the matrix of the
# problem: $F(R) = \sum \kappa_{ij} \|R_j - R_i \tilde R_{ij}\|_F^2 = \operatorname{tr}(R L R^\top)$
# with $R = [R_1 \dots R_n]$.
#
# Our graph is random, with 60 nodes and a Fiedler value near 3. The noise is the thesis', a
# Langevin distribution whose $\sigma_R$ is given in degrees.


# %%
def measured(instance, sigma_deg, seed=0):
    """The instance's graph with measurements of the truth with that noise; unit weights."""
    rng = np.random.default_rng(seed)
    i, j = instance.graph.edges.T
    R, m = instance.truth.rotations, instance.graph.num_edges
    noise = so.langevin(rng, np.radians(sigma_deg) ** -2, m, 3) if sigma_deg > 0.0 else np.eye(3)
    rotations = np.swapaxes(R[i], 1, 2) @ R[j] @ noise
    return Quadratic(RotationGraph(len(R), instance.graph.edges, rotations, np.ones(m)))


sparse = langevin_graph(60, 3.0, 0.0, np.random.default_rng(4))
truth = sparse.truth
perfect = measured(sparse, 0.0)
print("nodes, edges:", perfect.n, perfect.graph.num_edges)
print("L_G is", perfect.laplacian.shape, "and L is", perfect.matrix.shape)
print("Fiedler value:", round(consistency(perfect).graph[1], 4))

# %% [markdown]
# ## Consistent measurements: one spectrum, three times
#
# Suppose the measurements are perfect, $\tilde R_{ij} = R_i^\top R_j$. Then with
# $D = \operatorname{blkdiag}(R_1, \dots, R_n)$, which is orthogonal,
#
# $$ L = D^\top (L_G \otimes I_3)\, D . $$
#
# So $L$ has the eigenvalues of $L_G$, each three times (Proposition 3.2.4), whatever the rotations
# are. Its kernel has three dimensions and gives the solution: the columns of $R^\top$.

# %%
repeated = consistency(perfect, 4)
print("L_G:", repeated.graph.round(6))
print("L, by threes:")
print(abs(repeated.measured.round(6)))
answer = np.swapaxes(truth.rotations, 1, 2).reshape(-1, 3)  # R^T
print("largest entry of L R^T:", f"{abs(perfect.matrix @ answer).max():.0e}")

# %% [markdown]
# ## Noise: Weyl's inequality
#
# Noise adds a symmetric matrix $P$ with blocks $-\kappa_{ij}(\tilde R_{ij} - R_i^\top R_j)$. By
# Weyl's inequality no eigenvalue, in ascending order, moves by more than $\|P\|$, and
#
# $$ |\lambda_i(L_G) - \lambda_{3i-k}(L)| \;\le\; \|P\| \;\le\;
#    \max_i \sum_j \kappa_{ij} \|\tilde R_{ij} - R_i^\top R_j\|, \qquad k = 0, 1, 2. $$
#
# The norm of a block is $2 \sin(\alpha/2)$, where $\alpha$ is the angle of the residual. (The
# thesis states it for $k = 0$, with the larger $\|P\|_\infty$.) `perturbation_bound` computes the
# right-hand side, here at the true rotations.

# %%
SIGMAS = (0.0, 2.0, 5.0, 10.0, 20.0, 40.0)
weyl = {}
print("sigma_R (degrees)   largest difference    bound")
for sigma in SIGMAS:
    problem = measured(sparse, sigma)
    weyl[sigma] = consistency(problem, 60).differences.max(), perturbation_bound(problem, truth)
    print(f"{sigma:17.0f}   {weyl[sigma][0]:18.4f} {weyl[sigma][1]:8.4f}")

# %% [markdown]
# The bound holds, but is loose: it allows for errors that all add up, and random ones do not. Its
# direction is what matters. Spectra that are far apart *prove* that every set of rotations leaves
# large residuals, because the inequality holds for any $R$, the best one included.
#
# ## EigenRA: an estimate from three eigenvectors
#
# With perfect measurements the kernel is the solution, so with good ones the three eigenvectors of
# the smallest eigenvalues nearly are. Their $3 \times 3$ blocks are not quite rotations, so they
# are projected to the nearest ones. That is EigenRA (thesis, section 4.2). Since it drops
# constraints, it also gives a bound: $n(\lambda_1 + \lambda_2 + \lambda_3) \le F^*$ (after eq.
# 4.7).

# %%
problem = measured(sparse, 10.0)
values, vectors = np.linalg.eigh(problem.matrix.toarray())
blocks = np.swapaxes(vectors[:, :3].reshape(-1, 3, 3), 1, 2)  # R^T stacks the R_i^T
if np.linalg.det(blocks).sum() < 0.0:
    blocks[:, 0] *= -1.0  # eigenvectors have no sign: undo a common reflection
by_hand = Estimate(so.project(blocks))
packaged = get_solver("eigen_ra")().solve(problem)
print(f"F by hand {problem.cost(by_hand):.8f}, by the package {packaged.cost:.8f}")

# %%
eigenra = {}
print("sigma_R      bound <= F* (certified) <= F(EigenRA)")
for sigma in SIGMAS[1:]:
    problem = measured(sparse, sigma)
    pairs = smallest_eigenpairs(problem)
    optimum = solve(problem)
    estimate = get_solver("eigen_ra")().solve(problem)
    eigenra[sigma] = spectral_bound(problem, pairs), optimum.cost, estimate.cost
    bound, best, cost = eigenra[sigma]
    print(f"{sigma:7.0f} {bound:10.3f} <= {best:9.3f} ({optimum.verdict.value}) <= {cost:9.3f}")

# %% [markdown]
# While the noise is small the three numbers nearly coincide: the eigenvectors are so close to
# rotations that dropping constraints loses little. The gap between the outer two is known without
# knowing $F^*$, and it grows with the noise.
#
# ## A conjecture
#
# How does the smallest eigenvalue change as the noise grows? It starts at 0. Conjecture 3.2.1 of
# the thesis states that its expectation rises monotonically, and tends to the Fiedler value:
# $\lim_{\sigma_R \to \pi} \bar\lambda_1(L) = \lambda_2(L_G)$. The ratio
# $\lambda_1(L) / \lambda_2(L_G)$, `Consistency.inconsistency`, would then show how consistent any
# measurements are, from 0 (perfect) to 1 (noise). Here are the means of five draws, on our graph
# and on a denser one:

# %%
GRID = (0.0, 5.0, 10.0, 20.0, 40.0, 60.0, 90.0, 180.0, 1e6)  # the last: uniformly random


def smallest(problem):
    """lambda_1(L), by dense algebra, which is fast at this size."""
    return np.linalg.eigvalsh(problem.matrix.toarray())[0]


def mean_ratios(instance, draws=5):
    """Means of lambda_1(L) / lambda_2(L_G) over draws of the noise, one for each sigma."""
    fiedler = consistency(measured(instance, 0.0)).graph[1]
    found = [[smallest(measured(instance, s, seed)) for seed in range(draws)] for s in GRID]
    return np.mean(found, axis=1) / fiedler


dense = langevin_graph(60, 20.0, 0.0, np.random.default_rng(4))
ratios = {3: mean_ratios(sparse), 20: mean_ratios(dense)}
for fiedler, row in ratios.items():
    print(f"Fiedler value near {fiedler:2d}:", abs(row.round(3)))

# %% [markdown]
# The ratio rises, and levels off 6 to 9 percent below 1; more draws do not change that (exercise
# 4). On these graphs the smallest eigenvalue stays below the Fiedler value, comes near it, but does
# not tend to it.
#
# ## Why the conjecture is false
#
# On other graphs it fails by much more, in the other direction. Take two complete graphs of 20
# nodes and join them by a single edge; let every measurement be a uniformly random rotation.

# %%
CLIQUE = np.argwhere(np.tri(20, k=-1))
EDGES = np.concatenate([CLIQUE, CLIQUE + 20, [[0, 20]]])
SAME = np.broadcast_to(np.eye(3), (len(EDGES), 3, 3))
graph = RotationGraph(40, EDGES, SAME, np.ones(len(EDGES)))
cliques = Instance("cliques", graph, np.arange(40), truth=Estimate(SAME[:40]))

joined = measured(cliques, 1e6)
spectra = consistency(joined)
print("lambda_2(L_G):", spectra.graph[1].round(5))
print("lambda_1(L):  ", spectra.measured[0, 0].round(5))
print("ratio:        ", round(spectra.inconsistency, 1))

# %% [markdown]
# The ratio is above 100. Two short arguments show that this is not an accident of the draw:
#
# - *The Fiedler value is small because of one cut.* The vector that is $+1$ on one side and $-1$ on
#   the other is orthogonal to the ones, so $\lambda_2(L_G)$ is at most its Rayleigh quotient: the
#   weight of the cut times $n / (|S|\,|S'|)$, here $40/400$.
# - *The smallest eigenvalue of $L$ does not see the cut.* Each edge adds a positive semidefinite
#   term to $L$. Without the one between the cliques, the eigenvalues can only decrease; what
#   remains are two cliques, each inconsistent in itself. So $\lambda_1(L)$ is at least the smaller
#   of their smallest eigenvalues, which is large.
#
# In numbers:

# %%
cut_bound = 1.0 * 40 / 20**2
L = joined.matrix.toarray().reshape(40, 3, 40, 3)
R = joined.graph.rotations[-1]
L[0, :, 0] -= np.eye(3)  # remove the term of the edge between them
L[20, :, 20] -= np.eye(3)
L[0, :, 20] += R
L[20, :, 0] += R.T
apart = np.linalg.eigvalsh(L.reshape(120, 120))[0]
print(f"lambda_2(L_G) = {spectra.graph[1]:.5f} <= {cut_bound}")
print(f"lambda_1(L) = {spectra.measured[0, 0]:.5f} >= {apart:.5f}, of the separate cliques")

# %% [markdown]
# The conjecture can fail wherever a graph has a bottleneck and its parts have cycles of their own,
# as maps do. The thesis' Table 5.6 prints 0.22 for both eigenvalues of its Sphere. We find the same
# $\lambda_1(L)$ in the public file with unit weights, but another Fiedler value, 0.0153, and with
# it a ratio above 14 (a test in `tests/solve/test_consistency.py`); no reading of the file gives
# the printed one. On random graphs the ratio stays below 1 for a reason: $\lambda_1(L)$ is at most
# the smallest degree, the Rayleigh quotient of a vector at a single node, and there the weakest cut
# is hardly weaker than the one around a single node.

# %%
of_cliques = mean_ratios(cliques, draws=1)
BLUE, VERMILION, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#777777"
with plt.rc_context(STYLE):
    figure, (left, right) = plt.subplots(2, 1, figsize=(3.46, 5.2), layout="constrained")
    index = np.arange(1, 37)
    left.step(
        index, np.repeat(consistency(perfect, 12).graph, 3), where="mid", color="k", label="$L_G$"
    )
    for sigma, colour, marker in ((5.0, GREEN, "o"), (20.0, BLUE, "s"), (40.0, VERMILION, "D")):
        found = consistency(measured(sparse, sigma), 12).measured.ravel()
        label = f"$L$, {sigma:.0f} degrees"
        left.plot(index, found, marker, ms=2.5, color=colour, label=label)
    left.set(xlabel="index (eigenvalues of $L_G$ three times)", ylabel="eigenvalue")
    left.legend(loc="lower right")
    left.set_title("(a) two spectra", loc="left")
    shown = np.minimum(GRID[1:], 250.0)  # the last: uniformly random
    right.plot(shown, of_cliques[1:], "D-", color=VERMILION, label="two $K_{20}$, one edge between")
    for (fiedler, row), colour, marker in zip(ratios.items(), (BLUE, GREEN), "so", strict=True):
        label = f"random graph, $\\lambda_2 \\approx {fiedler}$"
        right.plot(shown, row[1:], f"{marker}-", color=colour, label=label)
    right.axhline(1.0, color=GREY, ls=":")
    right.set(
        yscale="log", xlabel="$\\sigma_R$ (degrees)", ylabel="$\\lambda_1(L)/\\lambda_2(L_G)$"
    )
    right.set_xticks([0, 60, 120, 180, 250], ["0", "60", "120", "180", "uniform"])
    right.legend(loc="lower right")
    right.set_title("(b) the conjecture's ratio", loc="left")

# %% [markdown]
# ## What the spectrum does show
#
# Three statements survive, whatever the graph:
#
# 1. $\lambda_1(L) = 0$ if and only if some nonzero field of vectors agrees with all measurements;
#    in a connected graph all three vanish if and only if rotations do, that is, if $F^* = 0$. (Of
#    several components one that fits is enough for three zeros, whatever the others cost.)
# 2. $3 n \lambda_1(L) \le n(\lambda_1 + \lambda_2 + \lambda_3) \le F^*$: an eigenvalue above zero
#    is a *proof* that no estimate fits.
# 3. To judge whether it is large, compare not with the Fiedler value but with the same graph with
#    random measurements, which are cheap to draw.
#
# The two cliques with a noise of only 5 degrees show the difference:

# %%
mild = smallest(measured(cliques, 5.0))
against_fiedler = mild / spectra.graph[1]
against_random = mild / spectra.measured[0, 0]
print(f"lambda_1 over the Fiedler value:           {against_fiedler:.4f}")
print(f"lambda_1 over that of random measurements: {against_random:.4f}")

# %% [markdown]
# Read according to the conjecture, the first number classifies good measurements as mostly noise;
# the second one is correct.
#
# ## Exercises
#
# **1.** Replace the rotation that is measured between the two cliques by any other. What happens to
# $F^*$, and why? What happens to the spectrum of $L$?

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
# F* is unchanged: the edge is a bridge, and rotating one whole side, R_i -> Q R_i, compensates for
# it and changes no other residual. Only cycles can be inconsistent. The eigenvalues still change a
# little: an eigenvector need not be a row of rotations, so it depends on how the two sides' errors
# match across the bridge. The spectral bound is not a function of the cycles alone; F* is.
plain = measured(cliques, 20.0).graph
other = plain.rotations.copy()
other[-1] = so.random(np.random.default_rng(1), 1, 3)[0]
turned = RotationGraph(40, EDGES, other, plain.kappa)
before, after = (consistency(Quadratic(graph)).measured for graph in (plain, turned))
optima = [solve(graph).cost for graph in (plain, turned)]
print("F*:", *optima)
print("lambda_1:", before[0, 0], after[0, 0])

# %% [markdown]
# **2.** In the plane, a ring of $n$ measurements, all the identity except one rotation by $\theta$,
# has $F^* = 8 n \sin^2(\theta/2n)$. What are the eigenvalues of its $L$? Show that the spectral
# bound is exact here.

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
# Distribute theta evenly around the ring by gauge: L becomes a circulant matrix, with a rotation by
# theta / n between neighbours, with eigenvalues 2 - 2 cos((theta +- 2 pi k) / n). The smallest one
# occurs twice, and n (lambda_1 + lambda_2) = 2 n (2 - 2 cos(theta / n)) = 8 n sin^2(theta / 2 n) =
# F*.
ring = Quadratic(winding_cycle(12, 0.9, 0, d=2)[0].graph)
ring_bound = ring.n * consistency(ring).measured[0].sum()
ring_optimum = 8 * 12 * np.sin(0.9 / 24) ** 2
print(f"bound {ring_bound:.12f}, F* {ring_optimum:.12f}")

# %% [markdown]
# **3.** One of the measurements of a perfect $K_{20}$ is replaced by a half turn away. What upper
# bound on the rise of $\lambda_1(L)$ does Weyl's inequality give? What bound does $F^*$ give? How
# much does it rise?

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
# Weyl: the block of P has the norm 2 sin(90 degrees) = 2. The cost: the true rotations cost
# |R_j - R_i R_ij|^2 = 4 (1 - cos 180 degrees) = 8, so 3 n lambda_1 <= F* <= 8, far less: one wrong
# measurement among many costs little, and is hard to see. Here it is invisible: vectors along the
# half turn's axis agree with all measurements, so that lambda_1 stays 0, and the next two rise.
one_wrong = np.broadcast_to(np.eye(3), (len(CLIQUE), 3, 3)).copy()
one_wrong[0] = np.diag([-1.0, -1.0, 1.0])
wrong = Quadratic(RotationGraph(20, CLIQUE, one_wrong, np.ones(len(CLIQUE))))
wrong_values = np.linalg.eigvalsh(wrong.matrix.toarray())[:3]
print("Weyl: at most 2; by the cost: at most", round(8 / 60, 4))
print("smallest eigenvalues:", abs(wrong_values.round(6)))

# %% [markdown]
# **4.** Is it chance that the ratio of random measurements ends below 1 on the sparser random
# graph? Draw 40 sets of uniformly random rotations.

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
# No: the mean is below 1 by many times its standard error, and every single draw is below 1.
draws = np.array([smallest(measured(sparse, 1e6, seed)) for seed in range(40)])
uniform = draws / consistency(perfect).graph[1]
mean_error = uniform.std() / np.sqrt(len(uniform))
print(f"mean {uniform.mean():.4f} +- {mean_error:.4f}, largest {uniform.max():.4f}")

# %% [markdown]
# ## What to remember
#
# - Perfect measurements repeat the graph's spectrum three times; the kernel of $L$ is the solution.
# - Weyl's inequality turns a difference of spectra into a lower bound on residuals, and eigenvalues
#   into a lower bound on $F^*$.
# - The Fiedler value depends on the weakest cut of the graph, $\lambda_1(L)$ on the cycles on its
#   sides. Neither bounds the other.
#
# Sources: G. Moreira, *A Unified Approach for Pose Graph Optimization*, 2020, sections 3.2 and 4.2;
# A. Eriksson, C. Olsson, F. Kahl, T.-J. Chin, *Rotation Averaging and Strong Duality*, CVPR 2018.
# `certpgo info GRAPH` prints the spectra of a graph; `certpgo reproduce moreira2020-figure3.1`
# draws the thesis' figure with its conjecture.
