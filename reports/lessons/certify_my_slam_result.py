# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # Certify my SLAM result
#
# An optimizer returns poses and an error that no longer falls. Whether a better answer exists it
# cannot say: it has seen the neighbourhood of its start and nothing else. This lesson takes answers
# of GTSAM to a verdict, to the distance from the best possible answer in metres and degrees, and to
# a proof file that others can check.

# %%
import contextlib
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import certpgo
from certpgo.assess.assessment import assess
from certpgo.checker import Refused
from certpgo.cli import main
from certpgo.io.gtsam_values import estimate_from_values
from certpgo.linalg import so

try:
    import gtsam
except ImportError:
    gtsam = None
    print("GTSAM is not installed: certpgo's Newton method stands in, with other weights than F's.")

# %% [markdown]
# ## A graph
#
# A robot drives two laps of a circle with a radius of 10 m. It measures every step, and in the
# second lap recognises every place of the first. Its sensors are not equally good in all
# directions: a step is known better sideways than up, and its yaw worse than its roll and pitch.

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
# Where the graph comes from a file, `certpgo.read` reads it (g2o, TORO, iSAM and others); here it
# is written first, as a front end would: with the full information matrix $\Omega$ of every edge.
# The file of `certpgo.write` has isotropic matrices, one $\kappa$ and one $\tau$ an edge. It is
# kept for later, and a copy gets the sensors' own.

# %%
work = tempfile.TemporaryDirectory()
folder = Path(work.name)
# Isotropic stand-ins of the information: kappa = 3 / (2 sum sigma^2), tau = 3 / sum sigma^2.
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
problem = certpgo.PoseProblem(instance.graph)
print(f"{instance.graph.num_nodes} poses, {instance.graph.num_edges} measurements")

# %% [markdown]
# ## GTSAM's answer
#
# The start is the odometry. `drift` adds a yaw to every step, as a gyroscope with a bias would.


# %%
def odometry(drift=0.0):
    """Poses (R, t) composed from the steps, each turned by ``drift`` radians more."""
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
        given = certpgo.PoseProblem(certpgo.read(file, rotation_information=reading).graph)
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
    """`certify_values`, or `certify` where an estimate stands in for Values."""
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
# The judge is
#
# $$F(R, t) = \sum \kappa_{ij} \|R_j - R_i R_{ij}\|^2
#   + \sum \tau_{ij} \|t_j - t_i - R_i t_{ij}\|^2.$$
#
# `certify` finds a lower bound of its minimum $F^*$ from duality: multipliers $\Lambda_i$ (Eriksson
# et al. 2018, eq. 16) whose matrix $S$ is positive semidefinite make $\operatorname{tr} \Lambda$
# such a bound (their eq. 18), and a factorization proves it. The bound belongs to the graph, not to
# the answer; the verdict is about $F$ of the answer less the bound.
#
# | verdict | means |
# |---|---|
# | CERTIFIED | $F$ is proven to be within $10^{-5} F + 10^{-12} W$ of $F^*$ |
# | BOUNDED | a gap is proven, but it is larger |
# | REFUTED | a better answer is in hand, and descending from this one does not lead to it |
# | UNDECIDED | no useful bound was found |
#
# ($W = \sum \kappa_{ij} + \sum \tau_{ij} \|t_{ij}\|^2$ is the size of $F$'s terms; it counts where
# $F$ is almost zero.)
#
# Here is an answer of each kind, all of the same graph. The first one starts from odometry without
# a bias, and has the weights of the isotropic file. The second is the one above, and the third was
# stopped after one step. The fourth began with a bias of 360 degrees a lap: the optimizer
# converges, to a map that winds twice as often. The fifth is the fourth again, but `refine=False`
# forbids the judge to improve a copy first, and the multipliers of so poor a point prove nothing of
# use.

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
    print(f"{name:23} {c.verdict.value:10} F = {c.cost:9.2f}  F* >= {c.lower_bound:6.2f}")

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
    right.plot([low, c.cost], [row, row], color=colour, linewidth=2)
    if c.lower_bound < low:  # an arrow towards zero, which a logarithmic axis has not
        right.plot(low, row, "<", color=colour, clip_on=False)
    right.plot(c.cost, row, "o", color=colour)
    right.text(c.cost * 1.25, row, c.verdict.value, color=BLACK, va="center", fontsize=8)
right.axvline(certificate.lower_bound, color=BLACK, linewidth=0.8, linestyle=":")
right.set(xscale="log", xlim=(100, 2e5), xlabel="cost F and its lower bound")
right.set_yticks(range(len(judgements)), list(judgements))
right.invert_yaxis()
for axes in (left, right):
    axes.spines[["top", "right"]].set_visible(False)
plt.show()

# %% [markdown]
# Left: both maps from above. In the small one a full turn too many is spread over the steps of a
# lap, a few degrees each, and the loop closures fit: no small change makes it better. Right: what
# is known of each answer. The dotted line is the one lower bound of the graph; the arrow goes on to
# zero.

# %% [markdown]
# ## Why full information is not CERTIFIED
#
# GTSAM minimises $\frac12 \sum r^\top \Omega\, r$ with $r = \log(T_{ij}^{-1} T_i^{-1} T_j)$ and the
# whole $\Omega$. $F$ has one $\kappa$ and one $\tau$ an edge, which SE-Sync reads from the file as
# $\kappa = 3 / (2 \operatorname{tr} \Omega_R^{-1})$, $\tau = 3 / \operatorname{tr} \Omega_t^{-1}$.
# These are two questions, and the best answer of one is near that of the other, not at it. That the
# weights and not the logarithms make the difference here is what the isotropic file shows. So the
# gap in $F$ says nothing about how well GTSAM minimised its own error; each of the two answers is
# better by its own measure:

# %%
review = assess(problem, estimate_of(answer), certificate, ids=instance.ids)
if gtsam is not None:
    factors, _ = gtsam.readG2o(str(folder / "drive.g2o"), True)
    best_values = gtsam.Values()
    for key in range(problem.n):
        pose = gtsam.Pose3(gtsam.Rot3(review.best.rotations[key]), review.best.translations[key])
        best_values.insert(key, pose)
    print("                  F      GTSAM's error")
    print(f"GTSAM's answer    {certificate.cost_upper:.2f}  {factors.error(answer):.2f}")
    print(f"best answer of F  {review.best_cost:.2f}  {factors.error(best_values):.2f}")

# %% [markdown]
# ## What to do then
#
# **BOUNDED.** `assess` says how far the best answer in hand is, in units that a robot cares about,
# and whether it is proven to be the best. A few centimetres may be all there is to know.

# %%
away = review.distance
print(f"relative gap: {certificate.relative_gap:.2%}")
print(f"best answer proven optimal: {review.best_is_optimal}")
print(f"rotations:  {away.mean_deg:.2f} degrees away on average, {away.worst_deg:.2f} at most")
print(f"positions:  {away.mean_m:.3f} m away on average, {away.worst_m:.3f} at most")

# %% [markdown]
# `review.best` is the better answer (`--best OUT` on the command line writes it). Where another
# error is to be minimised, as here, it is a good start: proven to be best for $F$, and near where
# the other error is least, but nothing is proven of that one.
#
# **REFUTED.** The better answer comes with the verdict; restart from it. Which edges pay most of
# the cost often tells what went wrong, wrong loop closures above all. Here no measurement is
# wrong, and even the worst pays only a few percent: the error is spread over both laps.

# %%
wound = assess(problem, estimate_of(answers["wound up"]), judgements["wound up"], ids=instance.ids)
print(f"the best answer costs {wound.excess / wound.certificate.cost_upper:.1%} less")
for edge in wound.edges[:3]:
    first, second = edge.ids
    off = f"off by {np.degrees(edge.angle):.1f} degrees"
    print(f"{first:3} to {second:3}: {edge.share:.2%} of F, {off}")

again = optimized(folder / "drive.g2o", wound.best)
print("restarted from the better answer:", judged(again).verdict.value)

# %% [markdown]
# **UNDECIDED.** With `refine=True`, the default, this is rare, and means noise beyond what the
# relaxation can bound. Then `certpgo info` shows how consistent the measurements are, and
# `certpgo bounds` what every bound makes of them.
#
# ## A proof for others
#
# A certificate is believed by whoever trusts this program. A proof file is for those who do not:
# the answer, and the numbers that the lower bound follows from, tied to the graph file by its
# SHA-256. The checker is one file that needs Python and NumPy and recomputes both bounds.

# %%
best = certpgo.certify(problem, review.best)
proof = folder / "drive.cert"
certpgo.write_proof(proof, folder / "drive.g2o", instance, review.best, best)
checked = certpgo.check(folder / "drive.g2o", proof)
print(best.verdict.value)
print(checked)
print(f"{proof.stat().st_size} bytes for {problem.n} poses")

# %% [markdown]
# It is tied to the numbers in the graph file: of the other file it proves nothing.

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
# that, and other formats. What it prints is the certificate and the assessment. The exit code is
# that of the verdict, for scripts.

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
# **1.** With which `rtol` is the answer for full information CERTIFIED? Predict it from the
# certificate above, then check. Does the lower bound depend on `rtol`?

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
# CERTIFIED means gap <= rtol F + atol W: the relative gap is the threshold. The bound belongs to
# the graph, and changes with rtol by rounding at most.
threshold = certificate.relative_gap
for rtol in (0.99 * threshold, 1.01 * threshold):
    c = judged(answer, rtol=rtol)
    print(f"rtol = {rtol:.4f}: {c.verdict.value}, F* >= {c.lower_bound:.4f}")

# %% [markdown]
# **2.** A file with few digits is another answer. Round the positions of the best answer to 1, 2, 3
# and 4 decimals. From how many on is it still CERTIFIED? Why does the gap shrink a hundredfold for
# each digit?

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
# F is quadratic about its minimum, where the gradient vanishes: a tenth of the error costs a
# hundredth. Centimetres of rounding matter where tau is in the hundreds a square metre.
rounded = {}
for decimals in (1, 2, 3, 4):
    positions = np.round(review.best.translations, decimals)
    rounded[decimals] = certpgo.certify(problem, review.best.with_translations(positions))
    c = rounded[decimals]
    print(f"{decimals} decimals: {c.verdict.value:9} relative gap {c.relative_gap:.1e}")

# %% [markdown]
# **3.** Give the robot's gyroscope a bias of -360 degrees a lap instead, and of 180. What does the
# judge say of the three answers, and why is a bias of 180 degrees a lap forgiven?

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
# Closures after a lap fit any whole number of turns. Half a turn is none, so that the closures pull
# the map to one of its neighbours. With -360 degrees a lap the start does not turn at all: the
# robot would drive straight on, and closures contradict that. GTSAM ends at a map that costs three
# times as much as the one wound up once, Newton's method at the latter. Both are REFUTED.
biased = {}
for degrees in (-360, 180):
    start = odometry(drift=np.radians(degrees) / LAP)
    biased[degrees] = judged(optimized(folder / "drive.g2o", start))
    c = biased[degrees]
    print(f"{degrees:5} degrees a lap: {c.verdict.value:9} F = {c.cost:.2f}")

# %% tags=["remove-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
work.cleanup()
