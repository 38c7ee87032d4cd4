# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # Cycles of springs
#
# Theorem 4.2 proves a single ring of cameras optimal by looking at its angles. The dual proves any
# graph, but needs an eigenvalue. Between them is a proof by hand: each residual is a spring and a
# torque, torques flow around cycles, and a cycle holds if a fold of its springs stays positive.
# Drag the residuals of two small graphs and watch.

# %%
from html import escape

import numpy as np

import certpgo
from certpgo.certify.cycles import prove
from certpgo.linalg import rotations as so
from certpgo.optimize.riemannian_newton import newton

# %% [markdown]
# ## A residual is a spring and a torque
#
# In the plane the residual $R_i R_{ij} R_j^T$ of an edge turns by an angle $\alpha$. Put
#
# $$c = \kappa \cos\alpha, \qquad \varphi = \kappa \sin\alpha .$$
#
# Other rotations are $Z_i R_i$. Let $z_i$ be a row of $Z_i$. Then exactly, with no small quantity
# left out,
#
# $$F(ZR) - F(R) = \sum_{\text{rows}} \sum_e
#   c_e\, |z_i - z_j|^2 + 2 \varphi_e\, (z_i \times z_j) .$$
#
# The first term is a spring of stiffness $c$ between two vectors; it is negative beyond 90 degrees.
# The second is a torque. At a stationary point the torques at each camera add up to zero, so they
# are a *flow*: what enters a camera leaves it. A flow without sources is a sum of cycles.


# %%
def springs_and_torques(problem, point):
    """c and phi of each edge, in the plane."""
    graph, (i, j) = problem.graph, problem.graph.edges.T
    R = point.rotations
    E = R[i] @ graph.rotations @ np.swapaxes(R[j], 1, 2)
    return graph.kappa * E[:, 0, 0], graph.kappa * E[:, 1, 0]


SQUARE = np.array([[0, 1], [1, 2], [2, 3], [3, 0], [0, 2]])  # the last is the chord


def stationary(edges, degrees, kappa):
    """A graph that measures these angles, and its stationary point near the identities."""
    n = int(edges.max()) + 1
    measured = so.exp(np.radians(degrees)[:, None])
    problem = certpgo.Quadratic(certpgo.RotationGraph(n, edges, measured, kappa))
    start = certpgo.Estimate(np.tile(np.eye(2), (n, 1, 1)))
    return problem, newton(problem, start).estimate


kappa = np.array([1.0, 2.0, 1.0, 1.0, 0.5])
problem, point = stationary(SQUARE, [40.0, 0.0, 70.0, 0.0, 0.0], kappa)
c, phi = springs_and_torques(problem, point)
for (i, j), stiffness, torque in zip(SQUARE, c, phi, strict=True):
    print(f"edge {i}{j}: spring {stiffness:7.4f}, torque {torque:7.4f}")
print(f"01 and 12 differ by {abs(phi[0] - phi[1]):.1e}; the chord has", end=" ")
print(f"23 less 01, up to {abs(phi[4] - (phi[2] - phi[0])):.1e}")

rng = np.random.default_rng(0)
Z = so.random(rng, 4, 2)
i, j = SQUARE.T
cross = (Z[i, :, 0] * Z[j, :, 1] - Z[i, :, 1] * Z[j, :, 0]).sum(axis=1)
by_springs = (c * ((Z[i] - Z[j]) ** 2).sum(axis=(1, 2)) + 2 * phi * cross).sum()
by_cost = problem.cost(certpgo.Estimate(Z @ point.rotations)) - problem.cost(point)
print(f"far away F rises by {by_cost:.12f}, by springs and torques {by_springs:.12f}")

# %% [markdown]
# ## Springs in series
#
# Walk around a cycle with torque $f$. Two springs that follow each other, $u$ and $w$, act
# together like one:
#
# $$\frac{u w - f^2}{u + w} .$$
#
# Without a torque these are springs in series; the torque makes them weaker. (Minimise over the
# vector in the middle.) Fold spring after spring until one is left. It joins the two ends of the
# last edge, parallel to the last spring, and **the cycle holds if these two add up to at least
# zero** (and all sums $u + w$ on the way are positive). Only $+$, $-$, $\times$ and $/$ occur: with
# fractions for numbers that is a proof to check by hand.
#
# Write $w_k = f \cot\theta_k$ and the fold becomes the addition theorem of the cotangent: the cycle
# holds exactly if $\theta_1 + \cdots + \theta_m \le 180^\circ$. In a ring each edge gives its whole
# spring, $\theta_k$ is its residual, and this is Theorem 4.2, with any weights. Three equal
# residuals may be 60 degrees each: like the angles of a triangle, they add up to 180.
#
# `prove` asks a cone program for the smallest share of the springs with which all cycles hold, the
# *ratio*. At most 1 is a proof. On the ring it is $\tan\alpha / \tan(180^\circ/n)$.


# %%
def folded(springs, torque):
    """All springs of a cycle but the last, as one; minus infinity if one sum is not positive."""
    u = springs[0]
    for w in springs[1:-1]:
        if u + w <= 0.0:
            return -np.inf
        u = (u * w - torque**2) / (u + w)
    return u


TRIANGLE = np.array([[0, 1], [1, 2], [2, 0]])
ratios = {}
for closing in (60.0, 120.0, 174.0, 186.0):
    ring, even = stationary(TRIANGLE, np.full(3, closing / 3.0), np.ones(3))
    stiffness, torque = springs_and_torques(ring, even)
    left = folded(stiffness, torque[0]) + stiffness[-1]
    proof = prove(ring, even)
    ratios[closing] = proof.ratio, left, proof.proven
    formula = np.tan(np.radians(closing / 3.0)) / np.tan(np.pi / 3.0)
    print(
        f"3 residuals of {closing / 3:.0f} deg: left over {left:7.4f}, ratio {proof.ratio:.6f}, "
        f"formula {formula:.6f}, proven: {proof.proven}"
    )

# %% [markdown]
# ## A square with a chord
#
# Now two cycles share an edge. The left triangle, 0-1-2, has torque $\varphi_{01}$; the right one,
# 0-2-3, has $\varphi_{23}$; the chord carries the difference. Each triangle folds its two outer
# springs to one between cameras 0 and 2, $u_{012}$ and $u_{230}$. If that is negative the triangle
# *demands* so much stiffness of the chord. There is a split exactly if the chord can serve both:
#
# $$u_{012} + u_{230} + c_{02} \ge 0 .$$
#
# Here this is also necessary. Eliminating cameras 1 and 3 from the certificate matrix $S$ is the
# same computation, so that in this graph springs prove exactly what the dual proves.

# %%


def chord_left(c, phi):
    """What both triangles leave of the chord."""
    return folded(c[[0, 1, 4]], phi[0]) + folded(c[[2, 3, 4]], phi[2]) + c[4]


def least_eigenvalue(problem, point):
    """Of S."""
    S = problem.certificate_matrix(problem.multipliers(point)).toarray()
    return np.linalg.eigvalsh(S)[0].round(9) + 0.0


shown = []
for first, second in ((40.0, 70.0), (60.0, 60.0), (110.0, 110.0), (150.0, 150.0), (150.0, -150.0)):
    square, here = stationary(SQUARE, [first, 0.0, second, 0.0, 0.0], np.ones(5))
    c, phi = springs_and_torques(square, here)
    proof, least = prove(square, here), least_eigenvalue(square, here)
    shown.append((chord_left(c, phi), proof.proven, proof.ratio, least))
    print(
        f"closing errors {first:4.0f} and {second:4.0f}: the chord has {shown[-1][0]:7.4f} left, "
        f"ratio {proof.ratio:.4f}, proven: {proof.proven}; S from {least:8.5f}"
    )

# %% [markdown]
# ## Drag the residuals
#
# Drag an edge to the right or left: its measurement turns, and the cameras give way until the
# torques balance again. Sliders change the weight of one edge. Blue springs are positive, red ones
# negative; orange arrows are torques, and at each camera what comes in goes out. The page computes
# the folds and the verdict in the browser, by the formulas above.

# %%
SCRIPT = r"""
// Angles x of cameras, measurements m and weights k of edges: residuals x_i + m - x_j.
function residuals(g, x) { return g.edges.map(([i, j], e) => x[i] + g.m[e] - x[j]); }
// The stationary point near x by Newton's method, camera 0 held; null if there is none.
function balanced(g, x0) {
  const x = x0.slice(), n = x.length;
  for (let step = 0; step < 60; step++) {
    const H = x.map(() => Array(n + 1).fill(0));
    residuals(g, x).forEach((a, e) => {
      const [i, j] = g.edges[e], c = g.k[e] * Math.cos(a), s = g.k[e] * Math.sin(a);
      H[i][i] += c; H[j][j] += c; H[i][j] -= c; H[j][i] -= c; H[i][n] -= s; H[j][n] += s;
    });
    if (H.every((row) => Math.abs(row[n]) < 1e-12)) return x;
    for (let p = 1; p < n; p++) {
      let best = p;
      for (let r = p; r < n; r++) if (Math.abs(H[r][p]) > Math.abs(H[best][p])) best = r;
      [H[p], H[best]] = [H[best], H[p]];
      if (Math.abs(H[p][p]) < 1e-9) return null;
      for (let r = 1; r < n; r++) {
        if (r === p) continue;
        const by = H[r][p] / H[p][p];
        for (let q = p; q <= n; q++) H[r][q] -= by * H[p][q];
      }
    }
    for (let p = 1; p < n; p++) {
      const move = H[p][n] / H[p][p];
      if (!(Math.abs(move) < 0.5)) return null;
      x[p] += move;
    }
  }
  return null;
}
// Two springs in series under a torque.
function series(u, w, f) { return u + w > 0 ? (u * w - f * f) / (u + w) : -Infinity; }
// Springs, torques, the folds of the outer springs, and what is left of the last edge.
function judged(g, x) {
  const a = residuals(g, x);
  const c = a.map((angle, e) => g.k[e] * Math.cos(angle));
  const f = a.map((angle, e) => g.k[e] * Math.sin(angle));
  const folds = g.pairs.map(([p, q]) => series(c[p], c[q], f[p]));
  const left = folds.reduce((sum, u) => sum + u, c[g.last]);
  return {a, c, f, folds, left, proven: left >= 0};
}
const GRAPHS = [
  {name: "triangle", edges: [[0, 1], [1, 2], [2, 0]], m: [0.7, 0.7, 0.7], k: [1, 1, 1],
   at: [[60, 230], [260, 230], [160, 60]], pairs: [[0, 1]], last: 2},
  {name: "square with a chord", edges: [[0, 1], [1, 2], [2, 3], [3, 0], [0, 2]],
   m: [0.5, 0.5, 0.65, 0.65, 0], k: [1, 1, 1, 1, 1],
   at: [[60, 240], [60, 60], [260, 60], [260, 240]], pairs: [[0, 1], [2, 3]], last: 4},
];
"""

DRAWING = r"""
const NS = "http://www.w3.org/2000/svg";
function add(parent, tag, attributes, text) {
  const made = parent.appendChild(document.createElementNS(NS, tag));
  for (const key in attributes) made.setAttribute(key, attributes[key]);
  if (text !== undefined) made.textContent = text;
  return made;
}
function zigzag([x, y], [X, Y]) {
  const n = 12, dx = X - x, dy = Y - y, length = Math.hypot(dx, dy);
  let path = `M${x},${y}`;
  for (let s = 1; s < n; s++) {
    const side = s < 3 || s > n - 3 ? 0 : s % 2 ? 6 : -6;
    path += `L${x + dx * s / n - dy / length * side},${y + dy * s / n + dx / length * side}`;
  }
  return path + `L${X},${Y}`;
}
const show = (value) => value === -Infinity ? "no fold" : value.toFixed(3);
for (const g of GRAPHS) {
  const panel = document.body.appendChild(document.createElement("section"));
  panel.innerHTML = `<h4>${g.name}</h4><svg viewBox="0 0 320 300" role="img"></svg>
    <label>weight of edge ${g.edges[g.last].join("")}
    <input type="range" min="-0.8" max="2" step="0.05" value="0"></label><output></output>`;
  const svg = panel.querySelector("svg"), said = panel.querySelector("output");
  svg.setAttribute("aria-label", `${g.name}: springs and torques`);
  let x = balanced(g, g.at.map(() => 0)), held = null, from = 0;
  // A change of the graph, taken back where the stationary point ends.
  function change(list, e, value) {
    const before = list[e];
    list[e] = value;
    const found = balanced(g, x);
    if (found) x = found; else list[e] = before;
    draw();
  }
  function draw() {
    const now = judged(g, x);
    svg.replaceChildren();
    g.edges.forEach(([i, j], e) => {
      const a = g.at[i], b = g.at[j], mid = [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2];
      const ink = now.c[e] < 0 ? "#D55E00" : "#0072B2";
      const width = 1 + 2.5 * Math.min(Math.abs(now.c[e]), 2);
      add(svg, "path", {d: zigzag(a, b), fill: "none", stroke: ink, "stroke-width": width});
      const hit = {x1: a[0], y1: a[1], x2: b[0], y2: b[1], stroke: "transparent",
        "stroke-width": 30, style: "cursor:ew-resize"};
      const way = (now.f[e] < 0 ? -1 : 1) / Math.hypot(b[0] - a[0], b[1] - a[1]);
      const u = [(b[0] - a[0]) * way, (b[1] - a[1]) * way];
      const size = 40 * Math.min(Math.abs(now.f[e]), 1.5);
      if (size > 0.4) {
        const tip = [mid[0] + u[0] * size / 2, mid[1] + u[1] * size / 2], h = 5 + size / 8;
        const tail = [mid[0] - u[0] * size / 2, mid[1] - u[1] * size / 2];
        const corner = (s) =>
          `${tip[0] - h * (u[0] + u[1] * s)},${tip[1] - h * (u[1] - u[0] * s)}`;
        add(svg, "path", {d: `M${tail}L${tip}M${corner(1)}L${tip}L${corner(-1)}`, fill: "none",
          stroke: "#E69F00", "stroke-width": 3});
      }
      const degrees = (Math.atan2(now.f[e], now.c[e]) * 180 / Math.PI).toFixed(1);
      const label = {x: mid[0], y: mid[1] - 12, "text-anchor": "middle"};
      add(svg, "text", label, `${degrees}°  c ${show(now.c[e])}`);
      const line = add(svg, "line", hit);
      line.addEventListener("pointerdown", (event) => { held = e; from = event.clientX; });
    });
    g.at.forEach((at, k) => {
      add(svg, "circle", {cx: at[0], cy: at[1], r: 11, fill: "white", stroke: "#333"});
      add(svg, "text", {x: at[0], y: at[1] + 4, "text-anchor": "middle"}, k);
    });
    const sums = [...now.folds, now.c[g.last]].map(show).join(" + ").replaceAll("+ -", "- ");
    said.innerHTML = `folds and edge ${g.edges[g.last].join("")}: ${sums} = ${show(now.left)}<br>`
      + (now.proven ? "<b class=yes>proven optimal</b>"
                    : "<b class=no>not proven: S has a negative eigenvalue</b>");
  }
  window.addEventListener("pointermove", (event) => {
    if (held === null) return;
    change(g.m, held, g.m[held] + 0.01 * (event.clientX - from));
    from = event.clientX;
  });
  window.addEventListener("pointerup", () => { held = null; });
  panel.querySelector("input").addEventListener("input", (event) => {
    change(g.k, g.last, 2 ** Number(event.target.value));
  });
  draw();
}
"""

STYLE = """
body { display: flex; flex-wrap: wrap; gap: 1em; margin: 0; background: white; color: #222;
  font: 13px sans-serif; }
section { flex: 1 1 260px; max-width: 360px; } h4 { margin: .4em 0; } svg { touch-action: none; }
svg text { font-size: 11px; user-select: none; pointer-events: none; }
output { display: block; min-height: 3.2em; } .yes { color: #007a55; } .no { color: #b34700; }
"""


class Picture:
    """A page of its own in a frame: it needs no network, and leaves the page around it alone."""

    def _repr_html_(self):
        page = f"<!doctype html><meta charset=utf-8><style>{STYLE}</style><body>"
        page += f"<script>{SCRIPT}{DRAWING}</script>"
        frame = "width:100%;height:470px;border:0"
        title = "Springs and torques of a triangle and of a square with a chord, to drag"
        return f'<iframe title="{title}" style="{frame}" srcdoc="{escape(page)}"></iframe>'


Picture()

# %% [markdown]
# Try this. On the triangle, make the residuals add up to 180 degrees: the verdict changes exactly
# there, with another weight as well, and with a residual beyond 90 degrees. On the square, drag
# both sides until the verdict changes, then make the chord heavier: it serves both triangles again.
# Where two closing errors are opposite, the chord takes the torque of both.
#
# ## Numbers that are almost right
#
# An estimate from a file is never exactly stationary, and a solver's numbers are rounded. Then the
# cycles still give a bound. With $\delta_e$ what an edge's springs ask for beyond $c_e$, and $r_e$
# the torque that no cycle carries,
#
# $$F^* \ge F(R) - 4 \sum_e \left(\delta_e + \sqrt{\delta_e^2 + r_e^2}\right) .$$
#
# An edge with slack, $\delta_e < 0$, loses about $2 r_e^2 / |\delta_e|$: second order. A tenth of
# the error costs a hundredth.

# %%
square, optimum = stationary(SQUARE, [40.0, 0.0, 70.0, 0.0, 0.0], np.ones(5))
direction = rng.standard_normal((4, 1))
losses = {}
for size in (0.1, 0.01, 0.001):
    moved = certpgo.Estimate(optimum.rotations @ so.exp(size * direction))
    found = prove(square, moved)
    losses[size] = found.cost - found.lower_bound
    print(f"off by {size:5}: F {found.cost:.9f}, F* >= {found.lower_bound:.9f}")
print(f"                F* = {square.cost(optimum):.9f}")

# %% [markdown]
# On larger graphs a cone program finds the split over all short cycles, and a program of two
# hundred lines checks it in fractions: `certpgo bounds MIT --cycles MIT.cycles`. It does not always
# succeed where the dual does: on four cameras with all six edges there are optima with
# $S \succeq 0$ that no split over cycles proves. The page *Bounds* has statements, proofs and that
# example; poses have forces as well, and springs that are matrices.
#
# ## Exercises
#
# **1.** Two parallel edges between two cameras are a cycle of two. What does the fold say of them?
# How large may their residuals be?

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
# Nothing is folded: w_1 + w_2 >= 0. With the same torque, c_1 + c_2 = f (cot a_1 + cot a_2), which
# is sin(a_1 + a_2) times something positive: together at most 180 degrees, each at most 90 if the
# weights are equal.
PARALLEL = np.array([[0, 1], [1, 0]])
pairs = {}
for closing in (170.0, 178.0, 182.0):
    two, here = stationary(PARALLEL, [closing / 2.0, closing / 2.0], np.ones(2))
    pairs[closing] = prove(two, here).proven
    print(f"two residuals of {closing / 2:.0f} degrees, proven: {pairs[closing]}")

# %% [markdown]
# **2.** In the square with equal weights let both closing errors be $\theta$, with the same sign.
# What does the chord carry, and how large may $\theta$ be? And if they have opposite signs?

# %% tags=["hide-cell"] jupyter={"source_hidden": true, "outputs_hidden": true}
# With the same sign the chord has torque 0 and residual 0, and the outer edges theta / 2 each. A
# fold is (c^2 - s^2) / 2c = cos(theta) / (2 cos(theta/2)), and the chord has 1: proven while
# cos(theta) + cos(theta/2) >= 0, that is up to 120 degrees.
# With opposite signs the outer residuals are a, the chord carries sin b = 2 sin a, and 2a + b is
# theta. In units of sin a each fold is cot(2a) and the chord 2 cot(b). They add up to at least zero
# while 2a + b <= 180 degrees: up to 180.
same, opposite = {}, {}
for theta in (118.0, 122.0):
    square, here = stationary(SQUARE, [theta / 2, theta / 2, theta / 2, theta / 2, 0.0], np.ones(5))
    same[theta] = prove(square, here).proven
for theta in (150.0, 170.0):
    square, here = stationary(SQUARE, [theta, 0.0, -theta, 0.0, 0.0], np.ones(5))
    opposite[theta] = prove(square, here).proven
print(f"the same sign: {same}, opposite signs: {opposite}")
