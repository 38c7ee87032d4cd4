# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # Certify my SLAM result
#
# An optimizer returns poses and an error that no longer decreases. It cannot tell whether a
# lower-cost estimate exists: it has explored only the neighbourhood of its initial estimate. This
# lesson computes, for GTSAM's estimates, a verdict, the distance from the optimum in metres and
# degrees, and a proof file that others can check.

# %%
import contextlib
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import certpgo
from certpgo.checker import Refused
from certpgo.cli import main
from certpgo.io.gtsam_values import estimate_from_values
from certpgo.linalg import rotations as so
from certpgo.solve.assessment import assess

try:
    import gtsam
except ImportError:
    gtsam = None
    print("GTSAM is not installed: certpgo's Newton method stands in, with weights other than F's.")

# %% [markdown]
# ## A graph
#
# A robot drives two laps of a circle with a radius of 10 m. It measures every step, and in the
# second lap recognises every place of the first. Its sensors are not equally accurate in all
# directions: a step is more accurate sideways than vertically, and its yaw less accurate than its
# roll and pitch.

# %%
LAP, RADIUS = 60, 10.0
SIGMA_T = np.array([0.05, 0.02, 0.10])  # of x, y, z; metres
SIGMA_R = np.radians([0.5, 0.5, 1.0])  # of roll, pitch, yaw; radians
rng = np.random.default_rng(1)

node = np.arange(2 * LAP)
heading = 2.0 * np.pi * node / LAP
R = so.exp(heading[:, None] * np.array([0.0, 0.0, 1.0]))
t = RADIUS * np.stack([np.sin(heading), 1.0 - np.cos(heading), 0.0 * heading], axis=1)

steps = np.stack([node[:-1], node[1:]], axis=1)
closures = np.stack([node[:LAP], node[LAP:]], axis=1)
edges = np.concatenate([steps, closures])
i, j = edges.T
turned = so.exp(SIGMA_R * rng.standard_normal((len(edges), 3)))
moved = SIGMA_T * rng.standard_normal((len(edges), 3))
R_ij = np.swapaxes(R[i], 1, 2) @ R[j] @ turned  # R_i^T R_j, disturbed
t_ij = np.einsum("mba,mb->ma", R[i], t[j] - t[i]) + moved  # R_i^T (t_j - t_i), disturbed

# %% [markdown]
# `certpgo.read` reads a graph from a file (g2o, TORO, iSAM and others). Here we write one first, as
# a front end would, with the full information matrix $\Omega$ of every edge. The file of
# `certpgo.write` has isotropic matrices, one $\kappa$ and one $\tau$ per edge. We keep it for
# later, and put the sensors' own matrices in a copy.

# %%
work = tempfile.TemporaryDirectory()
folder = Path(work.name)
# Isotropic approximations of the information: kappa = 3 / (2 sum sigma^2), tau = 3 / sum sigma^2.
kappa, tau = 1.5 / np.sum(SIGMA_R**2), 3.0 / np.sum(SIGMA_T**2)
rotation = certpgo.RotationGraph(len(node), edges, R_ij, np.full(len(edges), kappa))
graph = certpgo.PoseGraph(rotation, t_ij, np.full(len(edges), tau))
certpgo.write(folder / "isotropic.g2o", graph)

information = np.diag(np.r_[SIGMA_T, SIGMA_R] ** -2.0)[np.triu_indices(6)]
full = " ".join(f"{entry:.6g}" for entry in information)
lines = (folder / "isotropic.g2o").read_text().splitlines()
# EDGE_SE3:QUAT i j, the pose in 7 numbers, then the upper triangle of the information matrix.
lines = [
    " ".join(line.split()[:10]) + f" {full}" if line.startswith("EDGE") else line for line in lines
]
(folder / "drive.g2o").write_text("\n".join(lines) + "\n")

instance = certpgo.read(folder / "drive.g2o")
problem = certpgo.Quadratic(instance.graph)
print(f"{instance.graph.num_nodes} poses, {instance.graph.num_edges} measurements")

# %% [markdown]
# ## GTSAM's estimate
#
# The initial estimate is the odometry. `drift` adds a yaw to every step, as a gyroscope with a bias
# would.


# %%
def odometry(drift=0.0):
    """Poses (R, t) composed from the steps, each turned by ``drift`` more radians."""
    rotations, positions = [np.eye(3)], [np.zeros(3)]
    turn = so.exp(np.array([0.0, 0.0, drift]))
    for step in range(len(steps)):
        positions.append(positions[-1] + rotations[-1] @ t_ij[step])
        rotations.append(rotations[-1] @ R_ij[step] @ turn)
    return certpgo.Estimate(so.project(np.array(rotations)), np.array(positions))


def optimized(file, start, iterations=100):
    """GTSAM's Levenberg-Marquardt on a g2o file from an estimate: its Values."""
    if gtsam is None:
        reading = "tangent" if file.name == "isotropic.g2o" else "quaternion"
        given = certpgo.Quadratic(certpgo.read(file, rotation_information=reading).graph)
        newton = certpgo.get_solver("newton")(max_iterations=iterations)
        return newton.solve(given, initial=start).estimate
    factors, _ = gtsam.readG2o(str(file), True)
    values = gtsam.Values()
    for key, (R_k, t_k) in enumerate(zip(start.rotations, start.translations, strict=True)):
        values.insert(key, gtsam.Pose3(gtsam.Rot3(R_k), t_k))
    anchor = gtsam.noiseModel.Isotropic.Precision(6, 1e6)
    factors.add(gtsam.PriorFactorPose3(0, values.atPose3(0), anchor))
    settings = gtsam.LevenbergMarquardtParams()
    settings.setMaxIterations(iterations)
    settings.setRelativeErrorTol(1e-12)
    return gtsam.LevenbergMarquardtOptimizer(factors, values, settings).optimize()


def judged(values, **options):
    """`certify_values`, or `certify` for an estimate that replaces Values."""
    if gtsam is None:
        return certpgo.certify(problem, values, **options)
    return certpgo.certify_values(instance, values, **options)


def estimate_of(values):
    """The poses of Values as an estimate."""
    return values if gtsam is None else estimate_from_values(values, instance.ids, 3, True)[0]


# %%
answer = optimized(folder / "drive.g2o", odometry())
certificate = judged(answer)
print(certificate.verdict.value)
print(certificate.reason)

# %% [markdown]
# ## What a verdict means
#
# The cost is
#
# $$F(R, t) = \sum \kappa_{ij} \|R_j - R_i R_{ij}\|^2
#   + \sum \tau_{ij} \|t_j - t_i - R_i t_{ij}\|^2.$$
#
# `certify` finds a lower bound on its minimum $F^*$ from duality. If the matrix $S$ of the
# multipliers $\Lambda_i$ (Eriksson et al. 2018, eq. 16) is positive semidefinite,
# $\operatorname{tr} \Lambda$ is such a bound (their eq. 18), and a factorization proves it. The
# bound belongs to the graph, not to the estimate; the verdict depends on the estimate's $F$ minus
# the bound.
#
# | verdict | means |
# |---|---|
# | CERTIFIED | $F$ is proven to be within $10^{-5} F + \min(10^{-12} W, 10^{-3} F)$ of $F^*$ |
# | BOUNDED | a gap is proven, but it is larger |
# | REFUTED | local descent from this one does not reach a known better one, or was given up |
# | UNDECIDED | no useful bound was found |
#
# ($W = \sum \kappa_{ij} + \sum \tau_{ij} \|t_{ij}\|^2$ is the magnitude of $F$'s terms; it matters
# where $F$ is almost zero.)
#
# Here is an estimate with each verdict, all for the same graph. The first is initialized with
# unbiased odometry, and uses the weights of the isotropic file. The second is the one above, and
# the third was stopped after one step. The fourth was initialized with a bias of 360 degrees per
# lap: the optimizer converges to a map that winds twice as often. The fifth is the fourth again,
# but with `refine=False`: no copy is refined first, and the multipliers of so poor a point give no
# useful bound.

# %%
wound_start = odometry(drift=2.0 * np.pi / LAP)
answers = {
    "isotropic weights": optimized(folder / "isotropic.g2o", odometry()),
    "full information": answer,
    "stopped early": optimized(folder / "drive.g2o", odometry(), iterations=1),
    "wound up": optimized(folder / "drive.g2o", wound_start),
}
judgements = {name: judged(values) for name, values in answers.items()}
judgements["wound up, refine=False"] = judged(answers["wound up"], refine=False)

for name, c in judgements.items():
    print(f"{name:23} {c.verdict.value:10} F = {c.cost_upper:9.2f}  F* >= {c.lower_bound:6.2f}")

# %%
BLACK, ORANGE, GREEN, BLUE, VERMILION = "#000000", "#E69F00", "#009E73", "#0072B2", "#D55E00"
COLOURS = {"CERTIFIED": GREEN, "BOUNDED": BLUE, "REFUTED": VERMILION, "UNDECIDED": ORANGE}

figure, (left, right) = plt.subplots(
    1, 2, figsize=(7.1, 2.9), layout="constrained", width_ratios=(1.0, 1.25)
)
shown = ("full information", "wound up")
for name, label in zip(shown, ("found from odometry", "wound up"), strict=True):
    x, y, _ = estimate_of(answers[name]).translations.T
    left.plot(x, y, color=COLOURS[judgements[name].verdict.value], label=label)
left.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
left.legend(loc="upper left", fontsize=7, frameon=False)
left.set_ylim(-2, 28)
for row, c in enumerate(judgements.values()):
    colour = COLOURS[c.verdict.value]
    low = max(c.lower_bound, 100.0)
    right.plot([low, c.cost_upper], [row, row], color=colour, linewidth=2)
    if c.lower_bound < low:  # an arrow towards zero, which a logarithmic axis lacks
        right.plot(low, row, "<", color=colour, clip_on=False)
    right.plot(c.cost_upper, row, "o", color=colour)
    right.text(c.cost_upper * 1.25, row, c.verdict.value, color=BLACK, va="center", fontsize=8)
right.axvline(certificate.lower_bound, color=BLACK, linewidth=0.8, linestyle=":")
right.set(xscale="log", xlim=(100, 2e5), xlabel="cost F and its lower bound")
right.set_yticks(range(len(judgements)), list(judgements))
right.invert_yaxis()
for axes in (left, right):
    axes.spines[["top", "right"]].set_visible(False)
plt.show()

# %% [markdown]
# Left: both maps from above. In the small one an extra full turn is spread over the steps of a lap,
# a few degrees each, and the loop closures fit: no small change improves it. Right: the interval
# known for each estimate. The dotted line is the graph's lower bound; the arrow extends to zero.

# %% [markdown]
# ## Why full information is not CERTIFIED
#
# GTSAM minimises $\frac12 \sum r^\top \Omega\, r$ with $r = \log(T_{ij}^{-1} T_i^{-1} T_j)$ and the
# full $\Omega$. $F$ has one $\kappa$ and one $\tau$ per edge, which SE-Sync reads from the file as
# $\kappa = 3 / (2 \operatorname{tr} \Omega_R^{-1})$, $\tau = 3 / \operatorname{tr} \Omega_t^{-1}$.
# These are two objectives, and the optimum of one is near that of the other, not at it. The
# isotropic file shows that here the weights, not the logarithms, make the difference. So the gap in
# $F$ does not tell how well GTSAM minimised its own error, which can be certified too: see the
# lesson *Certify the cost you minimise*. Each of the two estimates is better by its own measure:

# %%
review = assess(problem, estimate_of(answer), certificate, instance=instance)
if gtsam is not None:
    factors, _ = gtsam.readG2o(str(folder / "drive.g2o"), True)
    best_values = gtsam.Values()
    for key in range(problem.n):
        pose = gtsam.Pose3(gtsam.Rot3(review.best.rotations[key]), review.best.translations[key])
        best_values.insert(key, pose)
    print("                  F      GTSAM's error")
    print(f"GTSAM's estimate  {certificate.cost_upper:.2f}  {factors.error(answer):.2f}")
    print(f"best F            {review.best_cost:.2f}  {factors.error(best_values):.2f}")

# %% [markdown]
# ## What to do next
#
# **BOUNDED.** `assess` gives the distance to the best known estimate, in metres and degrees, and
# whether that estimate is proven optimal. A few centimetres may not matter.

# %%
away = review.distance
print(f"relative gap: {certificate.relative_gap:.2%}")
print(f"best estimate proven optimal: {review.best_is_optimal}")
print(f"rotations:  {away.mean_deg:.2f} degrees away on average, {away.worst_deg:.2f} at most")
print(f"positions:  {away.mean_m:.3f} m away on average, {away.worst_m:.3f} at most")

# %% [markdown]
# `review.best` is the better estimate (`--best OUT` on the command line writes it). To minimise
# another error, as here, it is a good initial estimate: proven optimal for $F$, and near the
# minimum of the other error, about which nothing is proven.
#
# **REFUTED.** The verdict comes with the lower-cost estimate; restart from it. The edges with the
# largest share of the cost often show the cause, above all wrong loop closures. Here no measurement
# is wrong, and even the largest share is only a few percent: the error is spread over both laps.

# %%
wound = assess(problem, estimate_of(answers["wound up"]), judgements["wound up"], instance=instance)
print(f"the best estimate costs {wound.excess / wound.certificate.cost_upper:.1%} less")
for edge in wound.edges[:3]:
    first, second = edge.ids
    off = f"off by {np.degrees(edge.angle):.1f} degrees"
    print(f"{first:3} to {second:3}: {edge.share:.2%} of F, {off}")

again = optimized(folder / "drive.g2o", wound.best)
print("reinitialized by the better estimate:", judged(again).verdict.value)

# %% [markdown]
# **UNDECIDED.** With `refine=True`, the default, this is rare, and means noise beyond what the
# relaxation can bound. Then `certpgo info` shows how consistent the measurements are, and
# `certpgo bounds` evaluates every bound.
#
# ## A proof for others
#
# A certificate convinces only those who trust this program. A proof file is for everyone else: it
# contains the estimate and the numbers from which the lower bound follows, tied to the graph file
# by its SHA-256. The checker is one file that needs Python and NumPy and recomputes both bounds.

# %%
best = certpgo.certify(problem, review.best)
proof = folder / "drive.cert"
certpgo.write_proof(proof, folder / "drive.g2o", instance, review.best, best)
checked = certpgo.check(folder / "drive.g2o", proof)
print(best.verdict.value)
print(checked)
print(f"{proof.stat().st_size} bytes for {problem.n} poses")

# %% [markdown]
# The proof is tied to the numbers in the graph file; for the other file it proves nothing.

# %%
try:
    certpgo.check(folder / "isotropic.g2o", proof)
except Refused as refusal:
    refused = str(refusal).replace(f"{folder}/", "")
    print(f"{type(refusal).__name__}: {refused}")

# %% [markdown]
# ## The same on the command line
#
# GTSAM writes its Values with `gtsam.writeG2o(factors, values, "answer.g2o")`; the program reads
# that, and other formats. It prints the certificate and the assessment. The exit code gives the
# verdict to scripts.

# %%
if gtsam is None:
    certpgo.write(folder / "answer.g2o", answer, instance=instance)
else:
    gtsam.writeG2o(factors, answer, str(folder / "answer.g2o"))


def run(command):
    """Run a command of certpgo in the lesson's folder; returns its exit code."""
    print(f"$ certpgo {command}")
    with contextlib.chdir(folder), contextlib.redirect_stderr(sys.stdout):
        code = main(command.split())
    print(f"(exit code {code})\n")
    return code


codes = [
    run("certify drive.g2o answer.g2o --best better.g2o"),
    run("certify drive.g2o better.g2o --proof better.cert"),
    run("check drive.g2o better.cert"),
]

# %% [markdown]
# ## Exercises
#
# **1.** With which `rtol` is the estimate for full information CERTIFIED? Predict it from the
# certificate above, then check. Does the lower bound depend on `rtol`?

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
# CERTIFIED means gap <= rtol F + atol W: the relative gap is the threshold. The bound belongs to
# the graph, and changes with rtol at most by rounding.
threshold = certificate.relative_gap
for rtol in (0.99 * threshold, 1.01 * threshold):
    c = judged(answer, rtol=rtol)
    print(f"rtol = {rtol:.4f}: {c.verdict.value}, F* >= {c.lower_bound:.4f}")

# %% [markdown]
# **2.** A file with few digits contains a different estimate. Round the positions of the best
# estimate to 1, 2, 3 and 4 decimals. How many decimals keep it CERTIFIED? Why does the gap shrink a
# hundredfold per digit?

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
# F is quadratic about its minimum, where the gradient vanishes: a tenth of the error costs a
# hundredth. Centimetres of rounding matter if tau is in the hundreds per square metre.
rounded = {}
for decimals in (1, 2, 3, 4):
    positions = np.round(review.best.translations, decimals)
    rounded[decimals] = certpgo.certify(problem, review.best.with_translations(positions))
    c = rounded[decimals]
    print(f"{decimals} decimals: {c.verdict.value:9} relative gap {c.relative_gap:.1e}")

# %% [markdown]
# **3.** Give the robot's gyroscope a bias of -360 degrees per lap instead, and of 120. What are the
# verdicts for the three estimates, and why does a bias of 120 degrees per lap do no harm?

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
# Closures after a lap fit any integer number of turns. A third of a turn is not an integer, so the
# closures pull the map to a neighbouring one. With -360 degrees per lap the initial estimate does
# not turn at all: the robot would drive straight on, and the closures contradict that. GTSAM ends
# at a map that costs three times as much as the one wound up once, Newton's method at the latter.
# Both are REFUTED.
biased = {}
for degrees in (-360, 120):
    start = odometry(drift=np.radians(degrees) / LAP)
    biased[degrees] = judged(optimized(folder / "drive.g2o", start))
    c = biased[degrees]
    print(f"{degrees:5} degrees a lap: {c.verdict.value:9} F = {c.cost_upper:.2f}")

# %% tags=["remove-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
work.cleanup()
