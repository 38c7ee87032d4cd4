# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # How big is the map?
#
# A monocular camera cannot tell a room from a doll's house. Its map has no unit, and the unit that
# it takes for one drifts. This lesson gives every pose a scale, looks at what then fixes the size
# of the map, sees a map shrink, and reads from the multipliers why. In the end it is certified.

# %%
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import certpgo
from certpgo.io.datasets.monocular import drifting, ring_of_depths
from certpgo.io.datasets.synthetic import helix
from certpgo.objective.quadratic import Quadratic
from certpgo.plot import STYLE

truth = helix(20, np.random.default_rng(0)).truth
n = truth.num_nodes
loops = [(k, k + 20) for k in range(0, n - 20, 20)]
graph, with_scales = drifting(
    truth, loops, np.random.default_rng(3), walk=0.05, turn=0.02, move=0.05
)
print(graph.size_in_words)

# %% [markdown]
# ## A scale for every pose
#
# Pose $i$ maps $x$ to $A_i x + t_i$ with $A_i = s_i R_i$. An edge measures the rotation, the ratio
# of scales and the step in the unit of pose $i$:
#
# $$ F = \sum \kappa\,\|A_j - s_{ij} A_i R_{ij}\|_F^2 + \tau\,|t_j - t_i - A_i t_{ij}|^2. $$
#
# It is a quadratic form, as for rotations. But its minimum is $A = 0$, $t = 0$: a map of size zero
# explains everything. Without a unit there is no problem to solve.

# %%
held_at_0 = Quadratic(graph.with_unknown_scales(np.arange(n) > 0))
elsewhere = (graph.edges > 0).all(axis=1)
for size in (1.0, 0.5, 0.1):
    smaller = replace(
        with_scales,
        scales=np.r_[1.0, size * with_scales.scales[1:]],
        translations=size * truth.translations,
    )
    terms = held_at_0.edge_costs(smaller)
    print(f"{size:3} times the true map: {terms[elsewhere].sum():8.2f}", end=" ")
    print(f"and {terms[~elsewhere].sum():8.2f} of the edges at pose 0, which keeps its size")

# %% [markdown]
# ## A unit that is held
#
# The obvious choice is to hold the first pose, $s_0 = 1$. The relaxation is tight, and the answer
# is certified, yet it is too small, the more the farther away.

# %%
held = certpgo.solve(graph.with_unknown_scales(np.arange(n) > 0))
mean = certpgo.solve(graph)
for name, answer in (("pose 0 held", held), ("mean unit", mean)):
    off = np.log(answer.estimate.scales / with_scales.scales)
    print(f"{name:12} {answer.verdict}, F = {answer.cost:.2f}", end=", ")
    print(f"scales off by {100 * np.std(off):.1f} % around a mean of {100 * off.mean():.1f} %")

# %% [markdown]
# The multipliers say why. $F$ is homogeneous: multiply $A$ and $t$ by $1 + \epsilon$, and it grows
# by $2 \epsilon F$. At a minimum nothing changes to first order if only the unknown scales and the
# positions grow, so the whole of $2F$ comes from the pose that is held. The trace of its multiplier
# is $F$, and that of all others is zero:

# %%
traces = np.trace(held.certificate.multipliers, axis1=1, axis2=2)
print(f"trace at pose 0 {traces[0]:.4f}, elsewhere at most {np.abs(traces[1:]).max():.1e}")

# %% [markdown]
# That trace is a force. The map hangs at pose 0, and its own weight, which noise has put into every
# edge, pulls all of it towards zero.
#
# ## A unit of the whole
#
# So let the unit be that of the map, the root mean square of all scales: the cost is
# $F / \overline{s^2}$. A map of another size costs the same, and the force is spread evenly.

# %%
traces = np.trace(mean.certificate.multipliers, axis1=1, axis2=2)
print(f"traces {traces.min():.6f} to {traces.max():.6f}, the cost over n {mean.cost / n:.6f}")
larger = replace(
    mean.estimate,
    scales=7.0 * mean.estimate.scales,
    translations=7.0 * mean.estimate.translations,
)
print("seven times as large:", certpgo.certify(graph, larger).verdict)

# %%
with plt.rc_context(STYLE):
    figure, axes = plt.subplots(figsize=(6.0, 3.2))
    axes.plot(with_scales.scales, color="0.6", label="truth")
    for answer, label in ((held, "pose 0 held"), (mean, "mean unit")):
        scales = answer.estimate.scales
        axes.plot(scales * with_scales.scales[0] / scales[0], label=label)
    axes.set(xlabel="pose", ylabel="scale")
    axes.legend()

# %% [markdown]
# ## Points at depths without a unit
#
# The same happens where cameras see points, at depths that a network has guessed in a unit of each
# image's own. Thirty cameras look inwards from a ring. The noisier their depths, the smaller all
# that is not held, while every answer is the certified optimum of its cost.

# %%
noises, shrunk = (0.0, 0.02, 0.04, 0.06, 0.08), {"first camera held": [], "mean unit": []}
for noise in noises:
    seen, real = ring_of_depths(30, 150, 6, np.random.default_rng(0), noise=noise)
    free = ~seen.is_point & (np.arange(seen.num_nodes) > 0)
    units = zip(shrunk, (seen.with_unknown_scales(free), seen), strict=True)
    for name, one in units:
        answer = certpgo.solve(one)
        off = np.log(answer.estimate.scales / real.scales)[:30]
        shrunk[name].append(np.exp((off - off[0])[1:].mean()))
with plt.rc_context(STYLE):
    figure, axes = plt.subplots(figsize=(6.0, 3.2))
    for name, sizes in shrunk.items():
        axes.plot(100.0 * np.array(noises), sizes, marker="o", label=name)
    axes.set(xlabel="noise of depths, per cent", ylabel="size of the others", ylim=(0.0, 1.2))
    axes.legend()

# %% [markdown]
# ## What is certified
#
# With $S = M - \operatorname{blkdiag}(0, \Lambda) \succeq 0$,
#
# $$ F = \operatorname{tr}(X S X^\top) + \sum_i s_i^2 \operatorname{tr} \Lambda_i
#    \;\ge\; \min_i \operatorname{tr} \Lambda_i \sum_i s_i^2, $$
#
# which bounds $F / \overline{s^2}$ by $n \min_i \operatorname{tr} \Lambda_i$, whatever the scales
# are. The certificate is about this cost, with these weights: that no map fits better, not that the
# map is right. A cost of logarithms, as g2o and GTSAM have it, would fit drift better still; no
# quadratic form is below it everywhere, and nothing certifies it.

# %%
print(f"{n * traces.min():.6f} <= minimum <= {mean.cost:.6f}")
print(f"the certificate's bound: {mean.certificate.lower_bound:.6f}")

# %% [markdown]
# ## Exercises
#
# 1. Hold pose 200 instead of pose 0. What does the first answer say about the new minimum?
# 2. Why is the trace of a free pose's multiplier zero, if another pose is held?
#
# <details><summary>Solutions</summary>
#
# 1. Divide its scales and positions by $s_{200}$: that is a map of the new problem, and costs
#    $F / s_{200}^2$. So the new minimum is at most that.
# 2. The trace is the derivative in the logarithm of its scale, over $2 s_i^2$, which vanishes.
# </details>
