/* Calls about graphs: derivatives, residuals, trees. `certpgo.objective` has the same in NumPy. */

#include "edges.h"
#include "trees.h"

/* The graph of a tuple (pairs, P, K | None, kappa, tau | None, moved | None, arms | None). */
static int edges_of(Held *held, PyObject *tuple, Int d, Edges *g)
{
    if (d != 2 && d != 3) return refuse("graphs are in 2 or 3 dimensions") != NULL;
    const double **fields[] = {&g->P, &g->K, &g->kappa, &g->tau, &g->moved, &g->arms};
    Int lengths[] = {d * d, d * d, 1, 1, d, d};
    Array a[7] = {{held, INTS}};
    for (int k = 1; k < 7; k++) a[k] = (Array){held, DOUBLES, OPTIONAL};
    if (!arrays_of(tuple, a, 7)) return 0;
    g->pairs = a[0].at, g->m = a[0].length / 2, g->d = d;
    for (int k = 0; k < 6; k++) {
        *fields[k] = a[k + 1].at;
        if (a[k + 1].at && a[k + 1].length != g->m * lengths[k])
            return refuse("arrays of edges differ in length") != NULL;
    }
    if (!g->P || !(g->K || g->kappa) || (g->tau && !g->moved))
        return refuse("measured rotations, their weights, and with tau translations expected") != NULL;
    return 1;
}

/* Calls function(..., d, ...) with d as a constant, for which it is compiled. */
#define IN_SPACE(d, call_of_2, call_of_3) \
    Py_BEGIN_ALLOW_THREADS                \
    if (d == 3)                           \
        call_of_3;                        \
    else                                  \
        call_of_2;                        \
    Py_END_ALLOW_THREADS

/* worst_defect(R, d) -> index and size: see `certpgo.linalg.so.worst_defect` */
static PyObject *worst_defect_of(Held *held, PyObject *args)
{
    Array R = {held, DOUBLES};
    int d;
    if (!PyArg_ParseTuple(args, "O&i", array, &R, &d)) return NULL;
    if (d < 2 || d > 3 || R.length % (d * d)) return refuse("matrices of 2 or 3 rows expected");
    double largest;
    Int worst = d == 3 ? farthest(R.length / 9, 3, R.at, &largest)
                       : farthest(R.length / 4, 2, R.at, &largest);
    return Py_BuildValue("Ld", (long long)worst, largest);
}
CALL(worst_defect)

/* turn(R, v, d, left, out): R exp(v), or exp(v) R, of tangents (n, p) */
static PyObject *turn_of(Held *held, PyObject *args)
{
    Array R = {held, DOUBLES}, v = {held, DOUBLES}, out = {held, DOUBLES, WRITTEN};
    int d, left;
    if (!PyArg_ParseTuple(args, "O&O&ipO&", array, &R, array, &v, &d, &left, array, &out))
        return NULL;
    Int p = d == 2 ? 1 : 3, n = v.length / p;
    if (d < 2 || d > 3 || v.length != n * p || R.length != n * d * d || out.length != R.length)
        return refuse("as many rotations as tangents in 2 or 3 dimensions expected");
    IN_SPACE(d, turn_by(n, 2, R.at, v.at, left, out.at), turn_by(n, 3, R.at, v.at, left, out.at))
    return Py_NewRef(Py_None);
}
CALL(turn)

/* gradient(edges, d, r, R, t | None, G | None, terms): G is added to */
static PyObject *gradient_of(Held *held, PyObject *args)
{
    PyObject *tuple;
    Array R = {held, DOUBLES}, t = {held, DOUBLES, OPTIONAL};
    Array G = {held, DOUBLES, WRITTEN | OPTIONAL}, terms = {held, DOUBLES, WRITTEN};
    Edges g;
    int d, r;
    if (!PyArg_ParseTuple(args, "OiiO&O&O&O&", &tuple, &d, &r, array, &R, array, &t, array, &G,
                          array, &terms) ||
        !edges_of(held, tuple, d, &g))
        return NULL;
    Int n = r > 0 && r <= 32 ? R.length / (r * d) : 0;
    if (r < 1 || r > 32 || n * r * d != R.length || !all_below(g.pairs, 2 * g.m, n) ||
        terms.length != g.m || (G.at && G.length != n * r * (d + (g.tau != NULL))) ||
        (g.tau && t.length != n * r))
        return refuse("points of another graph, or of a rank above 32");
    Py_BEGIN_ALLOW_THREADS
    if (d == 3 && r == 3)
        differentiate(&g, 3, 3, R.at, t.at, G.at, terms.at);
    else if (d == 2 && r == 2)
        differentiate(&g, 2, 2, R.at, t.at, G.at, terms.at);
    else
        differentiate(&g, d, r, R.at, t.at, G.at, terms.at);
    Py_END_ALLOW_THREADS
    return Py_NewRef(Py_None);
}
CALL(gradient)

/* first_order(edges, d, R, t | None, turning, moving | None, tangent, multipliers, terms) -> the
 * stationarity: see `certpgo.objective.operators.first_order` */
static PyObject *first_order_of(Held *held, PyObject *args)
{
    PyObject *tuple;
    Array R = {held, DOUBLES}, t = {held, DOUBLES, OPTIONAL}, turning = {held, DOUBLES}, moving = t;
    Array tangent = {held, DOUBLES, WRITTEN}, multipliers = tangent, terms = tangent;
    Edges g;
    int d;
    if (!PyArg_ParseTuple(args, "OiO&O&O&O&O&O&O&", &tuple, &d, array, &R, array, &t, array,
                          &turning, array, &moving, array, &tangent, array, &multipliers, array,
                          &terms) ||
        !edges_of(held, tuple, d, &g))
        return NULL;
    Int n = turning.length, move = g.tau != NULL, b = (d == 2 ? 1 : 3) + (move ? d : 0);
    if (R.length != n * d * d || !all_below(g.pairs, 2 * g.m, n) || terms.length != g.m ||
        (move && t.length != n * d) || (moving.at && moving.length != n) ||
        tangent.length != n * b || multipliers.length != R.length)
        return refuse("points of another graph");
    double *G = memory(held, n * d * (d + move), sizeof(double)), largest;
    if (!G) return NULL;
    memset(G, 0, (size_t)(n * d * (d + move)) * sizeof(double));
    const Stiffness stiffness = {turning.at, moving.at};
    IN_SPACE(d,
             (differentiate(&g, 2, 2, R.at, t.at, G, terms.at),
              largest = project(n, 2, move, R.at, G, &stiffness, tangent.at, multipliers.at)),
             (differentiate(&g, 3, 3, R.at, t.at, G, terms.at),
              largest = project(n, 3, move, R.at, G, &stiffness, tangent.at, multipliers.at)))
    return PyFloat_FromDouble(largest);
}
CALL(first_order)

/* hessian(edges, d, R, multipliers, spread, first | None, degree | None, diagonal, upper): blocks of
 * the Hessian */
static PyObject *hessian_of(Held *held, PyObject *args)
{
    PyObject *tuple;
    Array R = {held, DOUBLES}, multipliers = R, spread = R;
    Array first = {held, DOUBLES, OPTIONAL}, degree = first;
    Array diagonal = {held, DOUBLES, WRITTEN}, upper = diagonal;
    Edges g;
    int d;
    if (!PyArg_ParseTuple(args, "OiO&O&O&O&O&O&O&", &tuple, &d, array, &R, array, &multipliers,
                          array, &spread, array, &first, array, &degree, array, &diagonal, array,
                          &upper) ||
        !edges_of(held, tuple, d, &g))
        return NULL;
    Int n = R.length / (d * d), b = (d == 2 ? 1 : 3) + (g.tau ? d : 0);
    if (upper.length != g.m * b * b || diagonal.length != n * b * b || R.length != n * d * d ||
        !all_below(g.pairs, 2 * g.m, n) || spread.length != R.length ||
        multipliers.length != R.length ||
        (g.tau && (first.length != n * d || degree.length != n)))
        return refuse("blocks of another graph");
    const Nodes nodes = {n, spread.at, multipliers.at, first.at, degree.at};
    int move = g.tau != NULL;
    IN_SPACE(d,
             (couple(&g, 2, R.at, upper.at),
              restrict_to_tangents(&nodes, move, 2, R.at, diagonal.at)),
             (couple(&g, 3, R.at, upper.at),
              restrict_to_tangents(&nodes, move, 3, R.at, diagonal.at)))
    return Py_NewRef(Py_None);
}
CALL(hessian)

/* angles(edges, d, R, angles): of the edges' residual rotations */
static PyObject *angles_of(Held *held, PyObject *args)
{
    PyObject *tuple;
    Array R = {held, DOUBLES}, angles = {held, DOUBLES, WRITTEN};
    Edges g;
    int d;
    if (!PyArg_ParseTuple(args, "OiO&O&", &tuple, &d, array, &R, array, &angles) ||
        !edges_of(held, tuple, d, &g))
        return NULL;
    if (angles.length != g.m || !g.kappa || !all_below(g.pairs, 2 * g.m, R.length / (d * d)))
        return refuse("rotations of another graph");
    IN_SPACE(d, measure_angles(&g, 2, R.at, angles.at), measure_angles(&g, 3, R.at, angles.at))
    return Py_NewRef(Py_None);
}
CALL(angles)

/* residuals(edges, d, R, t | None, turned, moved | None): norms of the edges' residuals */
static PyObject *residuals_of(Held *held, PyObject *args)
{
    PyObject *tuple;
    Array R = {held, DOUBLES}, t = {held, DOUBLES, OPTIONAL};
    Array turned = {held, DOUBLES, WRITTEN}, moved = {held, DOUBLES, WRITTEN | OPTIONAL};
    Edges g;
    int d;
    if (!PyArg_ParseTuple(args, "OiO&O&O&O&", &tuple, &d, array, &R, array, &t, array, &turned,
                          array, &moved) ||
        !edges_of(held, tuple, d, &g))
        return NULL;
    Int n = R.length / (d * d);
    if (turned.length != g.m || !all_below(g.pairs, 2 * g.m, n) ||
        (moved.at && (moved.length != g.m || !g.moved || t.length != n * d)))
        return refuse("an estimate of another graph");
    IN_SPACE(d, measure_residuals(&g, 2, R.at, t.at, turned.at, moved.at),
             measure_residuals(&g, 3, R.at, t.at, turned.at, moved.at))
    return Py_NewRef(Py_None);
}
CALL(residuals)

/* lessen(shift, G | None, Y, nodes, d, multipliers): see `certpgo.certify.shifted.Shifted.less` */
static PyObject *lessen_of(Held *held, PyObject *args)
{
    Array G = {held, DOUBLES, OPTIONAL}, Y = {held, DOUBLES}, nodes = {held, INTS};
    Array multipliers = {held, DOUBLES, WRITTEN};
    double shift;
    int d;
    if (!PyArg_ParseTuple(args, "dO&O&O&iO&", &shift, array, &G, array, &Y, array, &nodes, &d, array,
                          &multipliers))
        return NULL;
    Int n = d == 2 || d == 3 ? multipliers.length / (d * d) : 0, r = n ? Y.length / (n * d) : 0;
    if (d < 2 || d > 3 || r > 32 || multipliers.length != n * d * d || Y.length != n * r * d ||
        (G.at && G.length != r * r) || !all_below(nodes.at, nodes.length, n))
        return refuse("multipliers of other nodes, or a rank above 32");
    take_off(nodes.length, nodes.at, r, d, Y.at, G.at, shift, multipliers.at);
    return Py_NewRef(Py_None);
}
CALL(lessen)

/* lever_sums(edges, d, sums): sums (n, 4), zero before, of tau |b| at i and tau |a| at j, of tau |b|
 * and tau |a| times |a| + |b| there, of tau |b| at j and tau |a| at i, and of tau at both, with 1-norms */
static PyObject *lever_sums_of(Held *held, PyObject *args)
{
    PyObject *tuple;
    Array into = {held, DOUBLES, WRITTEN};
    Edges g;
    int d;
    if (!PyArg_ParseTuple(args, "OiO&", &tuple, &d, array, &into) || !edges_of(held, tuple, d, &g))
        return NULL;
    if (!g.tau || into.length % 4 || !all_below(g.pairs, 2 * g.m, into.length / 4))
        return refuse("sums at the nodes of a graph of poses expected");
    double *sums = into.at;
    for (Int e = 0; e < g.m; e++) {
        double tau = fabs(g.tau[e]), b = 0.0, a = 0.0;
        for (Int k = 0; k < d; k++) b += fabs(g.moved[e * d + k]);
        for (Int k = 0; k < d && g.arms; k++) a += fabs(g.arms[e * d + k]);
        for (int end = 0; end < 2; end++) {
            double *at = sums + 4 * g.pairs[2 * e + end], own = end ? a : b, other = end ? b : a;
            at[0] += tau * own;
            at[1] += tau * own * (a + b);
            at[2] += tau * other;
            at[3] += tau;
        }
    }
    return Py_NewRef(Py_None);
}
CALL(lever_sums)

/* components(pairs, labels): the connected components */
static PyObject *components_of(Held *held, PyObject *args)
{
    Array pairs = {held, INTS}, labels = {held, INTS, WRITTEN};
    if (!PyArg_ParseTuple(args, "O&O&", array, &pairs, array, &labels)) return NULL;
    if (pairs.length % 2 || !all_below(pairs.at, pairs.length, labels.length))
        return refuse("pairs of the nodes that have labels expected");
    label_components(labels.length, pairs.length / 2, pairs.at, labels.at);
    return Py_NewRef(Py_None);
}
CALL(components)

/* tree(pairs, root, parents, order): the breadth-first tree of a root, or of a node in the middle of a
 * long path if that is -1, and its nodes in order; the order of what it does not reach is -1 */
static PyObject *tree_of(Held *held, PyObject *args)
{
    Array pairs = {held, INTS}, into = {held, INTS, WRITTEN}, order = {held, INTS, WRITTEN};
    Py_ssize_t root;
    if (!PyArg_ParseTuple(args, "O&nO&O&", array, &pairs, &root, array, &into, array, &order))
        return NULL;
    Int n = into.length, ends = pairs.length, *parents = into.at, *queue = order.at;
    if (n < 1 || order.length != n || root < -1 || root >= n || ends % 2 ||
        !all_below(pairs.at, ends, n))
        return refuse("pairs and a root of the nodes that have parents expected");
    Int *start = memory(held, n + 1 + 2 * ends, sizeof(Int)), length = 0;
    if (!start) return NULL;
    Int *to = start + n + 1, *arcs = to + ends;
    list_neighbours(n, ends / 2, pairs.at, start, to, queue, arcs);
    if (root < 0) {
        Int end = breadth_first(n, start, to, 0, parents, queue);
        root = breadth_first(n, start, to, end, parents, queue);
        for (Int i = root; i != end; i = parents[i]) length++;
        for (Int k = 0; k < (length + 1) / 2; k++) root = parents[root];
    }
    for (Int i = 0; i < n; i++) queue[i] = -1;
    breadth_first(n, start, to, root, parents, queue);
    return Py_NewRef(Py_None);
}
CALL(tree)

/* compose(edges, d, parents, R, t | None): poses of the edges between children and parents, composed */
static PyObject *compose_of(Held *held, PyObject *args)
{
    PyObject *tuple;
    Array above = {held, INTS}, R = {held, DOUBLES, WRITTEN}, t = {held, DOUBLES, WRITTEN | OPTIONAL};
    Edges g;
    int d, is_forest, is_known = 1;
    if (!PyArg_ParseTuple(args, "OiO&O&O&", &tuple, &d, array, &above, array, &R, array, &t) ||
        !edges_of(held, tuple, d, &g))
        return NULL;
    const Int *parents = above.at;
    Int n = above.length;
    for (Int i = 0; i < n; i++) is_known &= parents[i] < n;
    if (R.length != n * d * d || (t.at && (t.length != n * d || !g.moved)) || !is_known ||
        !g.kappa || !all_below(g.pairs, 2 * g.m, n))
        return refuse("parents and poses in 2 or 3 dimensions of the same nodes expected");
    Int *path = memory(held, n, sizeof(Int) + 1);
    if (!path) return NULL;
    char *composed = (char *)(path + n);
    is_forest = take_steps(&g, n, parents, d, R.at, t.at, path);
    if (is_forest)
        is_forest = d == 3 ? compose_poses(n, parents, 3, R.at, t.at, path, composed)
                           : compose_poses(n, parents, 2, R.at, t.at, path, composed);
    return is_forest ? Py_NewRef(Py_None) : refuse("parents are not those of trees");
}
CALL(compose)
