/* Components, spanning trees, and poses composed along them.
 *
 * `certpgo.graph.trees` has the same in NumPy and SciPy.
 */

/* The component of each node (n,), counted from 0 by the components' first nodes: sets are united
 * under their first nodes, so that a node's parent comes before it. */
static void label_components(Int n, Int m, const Int *pairs, Int *labels)
{
    for (Int i = 0; i < n; i++) labels[i] = i;
    for (Int e = 0; e < m; e++) {
        Int i = pairs[2 * e], j = pairs[2 * e + 1];
        while (labels[i] != i) i = labels[i] = labels[labels[i]];
        while (labels[j] != j) j = labels[j] = labels[labels[j]];
        if (i < j)
            labels[j] = i;
        else
            labels[i] = j;
    }
    for (Int i = 0, count = 0; i < n; i++) labels[i] = labels[i] == i ? count++ : labels[labels[i]];
}

/* The neighbours of each node, those with higher numbers first, either ascending: `start` (n + 1,)
 * and `to` (2 m,). `next` (n,) and `arcs` (2 m,) are room for work. */
static void list_neighbours(Int n, Int m, const Int *pairs, Int *start, Int *to, Int *next, Int *arcs)
{
    memset(start, 0, (size_t)(n + 1) * sizeof(Int));
    for (Int a = 0; a < 2 * m; a++) start[pairs[a] + 1]++;
    for (Int i = 0; i < n; i++) start[i + 1] += start[i];
    memcpy(next, start, (size_t)n * sizeof(Int));
    for (Int a = 0; a < 2 * m; a++) arcs[next[pairs[a ^ 1]]++] = a;
    memcpy(next, start, (size_t)n * sizeof(Int));
    for (int lower = 0; lower < 2; lower++)
        for (Int k = 0; k < 2 * m; k++) {
            Int i = pairs[arcs[k]], j = pairs[arcs[k] ^ 1];
            if ((j < i) == lower) to[next[i]++] = j;
        }
}

/* Parents (n,) in the breadth-first tree of a root, -1 for the root and for nodes that it does not
 * reach; returns the last node that it reaches. `queue` (n,) is room for work. */
static Int breadth_first(Int n, const Int *start, const Int *to, Int root, Int *parents, Int *queue)
{
    Int read = 0, write = 0;
    for (Int i = 0; i < n; i++) parents[i] = -1;
    for (queue[write++] = root; read < write; read++) {
        Int i = queue[read];
        for (Int e = start[i]; e < start[i + 1]; e++)
            if (parents[to[e]] < 0 && to[e] != root) parents[to[e]] = i, queue[write++] = to[e];
    }
    return queue[write - 1];
}

/* Each node's pose in the frame of its parent by the heaviest edge between them, of equals the first;
 * roots are at the origin. `edge` (n,) is room for work. 0 if there is no edge. */
static inline int take_steps(const Edges *g, Int n, const Int *parents, Int d, double *R, double *t,
                             Int *edge)
{
    for (Int i = 0; i < n; i++) edge[i] = -1;
    for (Int e = 0; e < g->m; e++)
        for (int back = 0; back < 2; back++) {
            Int child = g->pairs[2 * e + !back];
            if (parents[child] != g->pairs[2 * e + back]) continue;
            if (edge[child] < 0 || g->kappa[e] > g->kappa[edge[child]]) edge[child] = e;
        }
    for (Int i = 0; i < n; i++) {
        Int e = edge[i];
        if (parents[i] >= 0 && e < 0) return 0;
        int back = e >= 0 && g->pairs[2 * e] == i;
        for (Int a = 0; a < d; a++)
            for (Int c = 0; c < d; c++)
                R[(i * d + a) * d + c] =
                    e < 0 ? a == c : g->P[(e * d + (back ? c : a)) * d + (back ? a : c)];
        for (Int a = 0; a < d && t; a++) {
            double step = e < 0 ? 0.0 : g->moved[e * d + a];
            if (back) {
                step = 0.0;
                for (Int b = 0; b < d; b++) step -= R[(i * d + a) * d + b] * g->moved[e * d + b];
            }
            t[i * d + a] = step;
        }
    }
    return 1;
}

/* Each node's pose in the frame of its parent becomes the one in the frame of its root. t may be
 * NULL. `above` (n,) and `done` (n,) are room for work. 0 if the parents are not a forest. */
static inline int compose_poses(Int n, const Int *parents, Int d, double *R, double *t, Int *above,
                                char *done)
{
    memset(done, 0, (size_t)n);
    for (Int start = 0; start < n; start++) {
        Int count = 0;
        for (Int i = start; !done[i] && parents[i] >= 0; i = parents[i]) {
            if (count == n) return 0;
            above[count++] = i;
        }
        while (count--) {
            Int i = above[count];
            const double *P = R + parents[i] * d * d;
            double own[9], *to = R + i * d * d;
            memcpy(own, to, (size_t)(d * d) * sizeof(double));
            for (Int a = 0; a < d; a++)
                for (Int c = 0; c < d; c++) {
                    double sum = 0.0;
                    for (Int b = 0; b < d; b++) sum += P[a * d + b] * own[b * d + c];
                    to[a * d + c] = sum;
                }
            if (t) {
                double step[3];
                memcpy(step, t + i * d, (size_t)d * sizeof(double));
                for (Int a = 0; a < d; a++) {
                    double sum = t[parents[i] * d + a];
                    for (Int b = 0; b < d; b++) sum += P[a * d + b] * step[b];
                    t[i * d + a] = sum;
                }
            }
            done[i] = 1;
        }
    }
    return 1;
}
