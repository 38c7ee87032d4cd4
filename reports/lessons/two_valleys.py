# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # Two valleys, one region
#
# A covariance says how far off an estimate may be, as long as the true one lies in the same valley
# of the cost. This lesson looks at a cycle of cameras whose cost has two valleys, and at a region
# that is proven to hold every estimate of low cost, in whichever valley it is. It comes from the
# certificate matrix, by three lines of algebra.

# %%
import matplotlib.pyplot as plt
import numpy as np

import certpgo
from certpgo.io.datasets.synthetic import winding_cycle
from certpgo.linalg import rotations as so
from certpgo.plot import STYLE

BLUE, VERMILION, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#999999"  # Okabe and Ito's
n, theta = 12, np.radians(143.0)

# %% [markdown]
# ## Two valleys
#
# Twelve cameras in the plane, each measured against the next. Around the cycle the measurements
# miss the identity by 143 degrees. There are two good ways to distribute that: 143 degrees one way,
# or 217 the other (see *Winding*). The camera opposite of camera 0 has half the error on either
# side of it, so that in the second it is turned by half a turn.

# %%
instance, other = winding_cycle(n, theta, -1, d=2)
answer = certpgo.solve(instance.graph)
opposite, second = n // 2, answer.problem.cost(other)
print(f"{answer.verdict}: the best estimate costs {answer.cost:.3f}, the other valley {second:.3f}")
print(f"that is {second - answer.cost:.3f} more")

# %% [markdown]
# How low can the cost be if the opposite camera is turned by $\varphi$? Each half of the cycle has
# $n/2$ edges, which share what it misses equally: for $e$, up to full turns, that costs
# $\tfrac n2\, 4\,(1 - \cos\tfrac{e}{n/2})$. This profile is exact.


# %%
def half(e):
    """Least cost of half of the cycle whose measurements miss by e, radians."""
    e = (e + np.pi) % (2.0 * np.pi) - np.pi
    return 0.5 * n * 4.0 * (1.0 - np.cos(e / (0.5 * n)))


def profile(turned):
    return half(0.5 * theta + turned) + half(0.5 * theta - turned)


print(f"profile at 0: {profile(0.0):.3f}, at 180 degrees: {profile(np.pi):.3f}")

# %% [markdown]
# The covariance is the curvature of the first valley. It knows nothing of the second: where the
# excess over the best cost is $q$, it says $|\varphi| \le \sqrt q\, \sigma$.

# %%
sigma = float(np.sqrt(answer.covariance(opposite)[0, 0]))
print(f"sigma = {np.degrees(sigma):.1f} degrees")

# %% [markdown]
# ## The theorem
#
# The certificate is a matrix $S \succeq 0$ and a number $L$ with
#
# $$ F(x) - L = |X|_S^2 = \operatorname{tr}(X S X^\top) \qquad \text{for every estimate } x, $$
#
# near or far: that is how it bounds the cost (see *Three cameras*). It says more.
#
# 1. Let $x, x'$ be any two estimates. Turn each so that camera 0 is at the identity, which changes
#    neither cost. Their matrices differ by $D$, and by the triangle inequality
#    $|D|_S \le \rho = \sqrt{F(x) - L} + \sqrt{F(x') - L}$.
# 2. $D$ vanishes at camera 0, so that only $A$ counts, which is $S$ without the rows and columns of
#    that. Of all $D$ with the block $V$ at camera $j$, the least has
#    $|D|_S^2 = \operatorname{tr}(V G^{-1} V^\top)$, where $G$ is the block of camera $j$ in
#    $A^{-1}$.
# 3. $V = R - R'$ for two rotations that differ by $\varphi$, and
#    $|V|_F^2 = 8 \sin^2(\varphi/2)$. In the plane $G = g I$ here, so
#
# $$ 8 \sin^2(\varphi / 2) \le g\, \rho^2. $$
#
# Nothing was linearized, and neither estimate need be a minimum. Read backwards it is a bound on
# the profile: what turns the camera by $\varphi$ costs at least
# $L + (\sqrt{8 \sin^2(\varphi/2) / g} - \sqrt{F^* - L})^2$. The gap $F^* - L$ is rounding here.

# %%
S = answer.problem.certificate_matrix(answer.certificate.multipliers).toarray()
A_inverse = np.linalg.inv(S[2:, 2:])  # without camera 0
block = slice(2 * opposite - 2, 2 * opposite)
G = A_inverse[block, block]
g = G[0, 0]
print(np.round(G, 4))
print(f"a turn by 180 degrees costs at least {8.0 / g:.3f} more, and does cost "
      f"{profile(np.pi) - answer.cost:.3f} more")  # fmt: skip

# %% [markdown]
# ## Step by step through the excess
#
# `answer.region` computes this for any graph, with bounds on rounding. The excess is what an
# estimate may cost more than the best one; here, as a share of what the second valley costs more.

# %%
needed, found = second - answer.cost, {}
print("excess   covariance     region   holds the second valley")
for share in (0.1, 0.25, 0.5, 0.75, 1.0):
    excess = share * needed * (1.0 + 1e-9)
    region = answer.region(opposite, 0, excess=excess)
    local = np.degrees(np.sqrt(excess) * sigma)
    found[share] = local, region.degrees, region.holds(other)
    print(f"{share:6.2f}   {local:6.1f} deg   {region.degrees:6.1f} deg   {found[share][2]}")

# %% [markdown]
# The region is wider, as it is proven for all estimates: by a factor of 1.6 at small excesses. It
# excludes the second valley up to three quarters of what that costs more, and never more than the
# cost allows. Where the cost does not exclude it, the region holds both, and the covariance still
# says 81 degrees.

# %%
turns = np.linspace(-np.pi, np.pi, 721)
with plt.rc_context(STYLE):
    figure, (axes, ring) = plt.subplots(1, 2, figsize=(8.4, 3.4), width_ratios=(1.6, 1.0))
    degrees = np.degrees(turns)
    axes.plot(degrees, profile(turns) - answer.cost, color="black", label="least cost")
    axes.plot(degrees, (turns / sigma) ** 2, color=VERMILION, ls="--", label="covariance")
    axes.plot(degrees, 8.0 * np.sin(0.5 * turns) ** 2 / g, color=BLUE, label="certificate")
    for share in (0.25, 1.0):
        axes.axhline(share * needed, color=GREY, lw=0.6)
    axes.set(xlabel="turn of the opposite camera (degrees)", ylabel="cost over the best")
    axes.set(xlim=(-180, 180), xticks=range(-180, 181, 90))
    axes.set(ylim=(0.0, 1.05 * (profile(turns).max() - answer.cost)))
    axes.legend(loc="lower right")

    for radius, share in enumerate((0.25, 0.5, 1.0), 2):
        for size, color, off in zip(found[share][:2], (VERMILION, BLUE), (0.0, 0.25), strict=True):
            arc = np.radians(np.linspace(-size, size, 200))
            ring.plot((radius + off) * np.sin(arc), (radius + off) * np.cos(arc), color=color, lw=2)
        ring.text(0.0, radius + 0.32, f"{share:g}", ha="center", va="bottom", fontsize=7)
    ring.plot(0.0, 1.4, "o", color="black")
    ring.plot(0.0, -1.4, "o", mfc="white", color="black")
    ring.text(0.0, 0.9, "best", ha="center", va="top", fontsize=8)
    ring.text(0.0, -0.9, "other valley", ha="center", va="bottom", fontsize=8)
    ring.set_aspect("equal")
    ring.axis("off")

# %% [markdown]
# Left: the blue curve is nowhere above the black one, which is the theorem; the dashed one is far
# above it beyond the ridge at 108 degrees, so that what it excludes may well be true. Right: the
# directions that remain for the opposite camera, by the covariance (inner arcs) and by the
# certificate (outer arcs), for three excesses.
#
# ## How far from every optimum?
#
# With $x'$ an optimum, $\rho \le 2 \sqrt{F(x) - L}$: the gap of an estimate becomes an angle, and
# in maps metres. It is the root that counts: a gap of a millionth of the cost is a thousandth of
# its root. `certpgo certify` prints it with every verdict.

# %%
distances = {}
for size in (1e-2, 1e-3, 1e-4):
    turned = so.exp(size * np.sin(np.arange(n))[:, None])
    near = certpgo.Estimate(answer.estimate.rotations @ turned)
    judged = certpgo.certify(answer.problem, near)
    distances[size] = judged.relative_gap, judged.distance_from(0).degrees[opposite]
    gap, limit = distances[size]
    print(f"a gap of {gap:.1e} of the cost: within {limit:.3f} degrees of every optimum")

# %% [markdown]
# ## Exercises
#
# 1. The region is the whole turn before the excess reaches the second valley. From which share on?
# 2. What is said at $\theta = 180^\circ$, where both valleys cost the same?
# 3. Both estimates of the theorem may be any. Which bound on their distance follows for the answers
#    of two programs, of which neither is optimal?
#
# <details><summary>Solutions</summary>
#
# 1. From $8/g$ over what the second valley costs more, which is 0.83: the matrix allows blocks that
#    are no rotations, and those are cheaper on the way.
# 2. Two optima make $A$ singular: the difference of their matrices costs nothing. No factorization
#    proves $A \succ 0$, and nothing is said, as it should be.
# 3. $\rho = \sqrt{F(x) - L} + \sqrt{F(x') - L}$, of the two costs and one certificate.
# </details>
