/* The optimum near a point and its bound, of a graph of poses with isotropic weights: all that a
 * session does when a measurement closes a loop. `certpgo.objective.plain_edges` has the calls.
 *
 * The descent is Newton's with few factors, of rotations and translations together; then the
 * translations are solved for. `certpgo.optimize` and `certpgo.certify.dual` have the general ways.
 */

/* Unit roundoff. */
#define ROUNDOFF 1.1102230246251565e-16
/* Of `certpgo.linalg.rounding_bound`: operations besides products, agreement, least diagonal. */
#define OTHERS 8.0
#define AGREEMENT 1e-6
#define LEAST_DIAGONAL 1e-250
/* Of `certpgo.certify.dual`: the shift in units of rounding, |L| |L|^T over |A|, and what is
 * compensated of the demand. */
#define SHIFT 128.0
#define AMPLE 4.75
#define COVER 1.05
/* Factors, and steps with each, at most; actual over predicted decrease at least; predicted decrease
 * over that of the step before, from which a new factor does better. */
#define FACTORS 8
#define STEPS 12
#define GAIN 0.5
#define SLOW 0.1
/* Steps towards the nearest rotation in space, of a start only. */
#define ALIGNING 4

/* What all matrices of a graph share. */
typedef struct {
    Edges edges;
    Int n;
    const Int *indptr, *own, *slots; /* see place_blocks */
    const double *spread, *first, *degree;
} Whole;

/* The graph, and its sums at nodes: `certpgo.objective.operators.NodeSums`. Both sums of a diagonal
 * entry are added up first, so that no product is rounded more often than `entry_errors` says. */
static int whole_of(Held *held, PyObject *edges, Int d, PyObject *places, Whole *w)
{
    Array at = {held, INTS}, p[] = {at, at, at};
    const Edges *g = &w->edges;
    if (!edges_of(held, edges, d, &w->edges) || !arrays_of(places, p, 3)) return 0;
    Int n = w->n = p[1].length, m = g->m;
    w->indptr = p[0].at, w->own = p[1].at, w->slots = p[2].at;
    if (!n || !g->tau || !g->kappa || g->K || g->arms || p[0].length != n + 1 ||
        !are_pointers(w->indptr, n + 1, w->indptr[n]) || p[2].length != 2 * m ||
        !are_places(n, m, w->indptr, w->own, w->slots, g->pairs))
        return refuse("a graph of poses with isotropic weights expected") != NULL;
    double *spread = memory(held, n * (d * d + d + 2), sizeof(double));
    if (!spread) return 0;
    double *first = spread + n * d * d, *degree = first + n * d, *turning = degree + n;
    memset(spread, 0, (size_t)(n * (d * d + d + 2)) * sizeof(double));
    for (Int e = 0; e < m; e++) {
        Int i = g->pairs[2 * e], j = g->pairs[2 * e + 1];
        const double *lever = g->moved + e * d;
        degree[i] += g->tau[e], degree[j] += g->tau[e];
        turning[i] += g->kappa[e], turning[j] += g->kappa[e];
        for (Int a = 0; a < d; a++) {
            first[i * d + a] += g->tau[e] * lever[a];
            for (Int b = 0; b < d; b++) spread[(i * d + a) * d + b] += g->tau[e] * lever[a] * lever[b];
        }
    }
    for (Int i = 0; i < n; i++)
        for (Int a = 0; a < d; a++) spread[(i * d + a) * d + a] += turning[i];
    w->spread = spread, w->first = first, w->degree = degree;
    return 1;
}

/* Whether fronts are of the graph's matrices with blocks of b rows; else refused. */
static int are_of(const Whole *w, const Fronts *f, Int b)
{
    int fits = f->n == w->n && f->entry[f->n] == b * b * w->indptr[w->n];
    for (Int i = 0; i < w->n && fits; i++) fits = f->sizes[i] == b && f->indptr[i] == w->indptr[i];
    return fits || refuse("fronts of another graph") != NULL;
}

/* A point, and F and its derivatives there. */
typedef struct {
    double *R, *t, *tangent, *multipliers, cost;
} Place;

static void evaluate(const Whole *w, Int d, double *G, double *terms, Place *x)
{
    Int n = w->n;
    double largest;
    const Stiffness none = {w->degree, NULL};
    memset(G, 0, (size_t)(n * d * (d + 1)) * sizeof(double));
    if (d == 2) {
        differentiate(&w->edges, 2, 2, x->R, x->t, G, terms);
        largest = project(n, 2, 1, x->R, G, &none, x->tangent, x->multipliers);
    } else {
        differentiate(&w->edges, 3, 3, x->R, x->t, G, terms);
        largest = project(n, 3, 1, x->R, G, &none, x->tangent, x->multipliers);
    }
    (void)largest;
    x->cost = 0.0;
    for (Int e = 0; e < w->edges.m; e++) x->cost += terms[e];
}

/* The Hessian of F/2, its gauge fixed at the heaviest node, into zeros. */
static void assemble_hessian(const Whole *w, Int d, const Place *x, double *diagonal, double *upper,
                             double *data)
{
    Int p = d == 2 ? 1 : 3, b = p + d, heaviest = 0;
    const Nodes nodes = {w->n, w->spread, x->multipliers, w->first, w->degree};
    if (d == 2) {
        couple(&w->edges, 2, x->R, upper);
        restrict_to_tangents(&nodes, 1, 2, x->R, diagonal);
    } else {
        couple(&w->edges, 3, x->R, upper);
        restrict_to_tangents(&nodes, 1, 3, x->R, diagonal);
    }
    for (Int i = 1; i < w->n; i++)
        if (w->spread[i * d * d] > w->spread[heaviest * d * d]) heaviest = i;
    double *block = diagonal + heaviest * b * b;
    for (Int k = 0; k < b; k++) block[k * b + k] *= 2.0;
    place_blocks(w->n, w->edges.m, b, w->indptr, w->own, w->slots, w->edges.pairs, diagonal, upper,
                 data);
}

/* The translations become the best for the rotations: their Laplacian without the first node is
 * factorized. 1, or as `factor` says. Room: diagonal (n,), upper (m,), data (entries,). */
static int solve_translations(const Whole *w, Int d, const Fronts *f, double *L, Place *x,
                              double *diagonal, double *upper, double *data, double *force,
                              double *correction)
{
    Int n = w->n, b = d + (d == 2 ? 1 : 3);
    const Sums none = {0, NULL, NULL, NULL};
    memcpy(diagonal, w->degree, (size_t)n * sizeof(double));
    for (Int e = 0; e < w->edges.m; e++) upper[e] = -w->edges.tau[e];
    memset(data, 0, (size_t)w->indptr[n] * sizeof(double));
    place_blocks(n, w->edges.m, 1, w->indptr, w->own, w->slots, w->edges.pairs, diagonal, upper,
                 data);
    for (Int i = 0; i < n; i++) /* the first node is the first of each column that has it */
        if (i && w->indptr[i] < w->own[i] && f->indices[w->indptr[i]] == 0) data[w->indptr[i]] = 0.0;
    for (Int e = w->indptr[0]; e < w->indptr[1]; e++)
        if (e != w->own[0]) data[e] = 0.0;
    int outcome = factor_double(f, data, NULL, L, &none, NULL, NULL);
    if (outcome != 1) return outcome;
    for (Int i = 0; i < n; i++)
        for (Int a = 0; a < d; a++) force[i * d + a] = i ? x->tangent[i * b + a] : 0.0;
    if (solve_double(f, L, NULL, force, correction, d) < 0) return -1;
    for (Int k = 0; k < n * d; k++) x->t[k] -= correction[k];
    return 1;
}

/* R becomes the rotation nearest to M, from near it: a rotation to rounding, as by a step of Newton and
 * Schulz, then the turn of it that aligns them, by its skew part. */
static void align(Int d, const double *M, double *R)
{
    double Q[9];
    for (Int a = 0; a < d; a++)
        for (Int b = 0; b < d; b++) {
            Q[a * d + b] = 1.5 * R[a * d + b];
            for (Int c = 0; c < d; c++)
                for (Int k = 0; k < d; k++)
                    Q[a * d + b] -= 0.5 * R[a * d + c] * R[k * d + c] * R[k * d + b];
        }
    memcpy(R, Q, (size_t)(d * d) * sizeof(double));
    for (int step = d == 2 ? ALIGNING - 1 : 0; step < ALIGNING; step++) {
        double B[9], turn[3], turned[9], trace = 0.0;
        for (Int a = 0; a < d; a++)
            for (Int b = 0; b < d; b++) {
                B[a * d + b] = 0.0;
                for (Int k = 0; k < d; k++) B[a * d + b] += R[k * d + a] * M[k * d + b];
            }
        for (Int a = 0; a < d; a++) trace += B[a * d + a];
        if (d == 2)
            turn[0] = atan2(B[2] - B[1], trace);
        else if (trace > 0.0)
            for (Int a = 0; a < 3; a++) {
                Int b = (a + 1) % 3, c = (a + 2) % 3;
                turn[a] = 1.5 * (B[3 * c + b] - B[3 * b + c]) / trace;
            }
        else
            return;
        turn_by(1, d, R, turn, 0, turned);
        memcpy(R, turned, (size_t)(d * d) * sizeof(double));
    }
}

/* The nodes from `first` on, one after another, are placed anew: where measurements from nodes before
 * them say on average. 0 without memory. */
static int place_anew(const Edges *g, Int n, Int d, Int first, Place *x)
{
    Int *last = malloc((size_t)(n + g->m) * sizeof(Int)), *previous = last + n;
    if (!last) return 0;
    for (Int i = first; i < n; i++) last[i] = -1;
    for (Int e = 0; e < g->m; e++) {
        Int i = g->pairs[2 * e], j = g->pairs[2 * e + 1], later = i > j ? i : j;
        if (later >= first) previous[e] = last[later], last[later] = e;
    }
    for (Int k = first; k < n; k++) {
        double M[9] = {0.0}, t[3] = {0.0}, tau = 0.0, *own = x->R + k * d * d;
        if (last[k] < 0) continue;
        for (Int e = last[k]; e >= 0; e = previous[e]) {
            Int ends = g->pairs[2 * e + 1] == k, other = g->pairs[2 * e + !ends];
            const double *R = x->R + other * d * d, *P = g->P + e * d * d;
            double said[9];
            for (Int a = 0; a < d; a++)
                for (Int b = 0; b < d; b++) {
                    said[a * d + b] = 0.0;
                    for (Int c = 0; c < d; c++)
                        said[a * d + b] += R[a * d + c] * (ends ? P[c * d + b] : P[b * d + c]);
                    M[a * d + b] += g->kappa[e] * said[a * d + b];
                }
            if (previous[e] < 0) memcpy(own, said, (size_t)(d * d) * sizeof(double));
        }
        align(d, M, own);
        for (Int e = last[k]; e >= 0; e = previous[e]) {
            Int ends = g->pairs[2 * e + 1] == k, other = g->pairs[2 * e + !ends];
            const double *R = x->R + g->pairs[2 * e] * d * d, *lever = g->moved + e * d;
            for (Int a = 0; a < d; a++) {
                double step = 0.0;
                for (Int b = 0; b < d; b++) step += R[a * d + b] * lever[b];
                t[a] += g->tau[e] * (x->t[other * d + a] + (ends ? step : -step));
            }
            tau += g->tau[e];
        }
        for (Int a = 0; a < d && tau > 0.0; a++) x->t[k * d + a] = t[a] / tau;
    }
    free(last);
    return 1;
}

/* Room for a descent: gradient, terms, blocks of nodes and edges, matrix, factor and its scale, step,
 * turns. */
typedef struct {
    double *G, *terms, *diagonal, *upper, *data, *scale, *step, *turn;
    void *L;
} Room;

/* L of the Hessian, in single precision with rows and columns scaled by powers of two. */
static int factor_single(const Whole *w, Int b, const Fronts *f, const Room *of)
{
    const Sums none = {0, NULL, NULL, NULL};
    for (Int k = 0; k < w->n; k++) {
        Int node = f->order[k], height = b * (w->indptr[node + 1] - w->indptr[node]);
        const double *block = of->data + f->entry[node] + b * (w->own[node] - w->indptr[node]);
        for (Int r = 0; r < b; r++) {
            double entry = block[r * height + r];
            if (!(entry > 0.0 && entry < INFINITY)) return 0;
            of->scale[f->offset[k] + r] = ldexp(1.0, -(int)nearbyint(0.5 * log2(entry)));
        }
    }
    return factor_float(f, of->data, of->scale, of->L, &none, NULL, NULL);
}

/* Steps with the factor of the Hessian at x, or near it, while they make progress. 1 if the last one
 * promised to lower F by at most the share `enough`; 0 if another factor must follow, and `taken` is
 * how many were taken; -1 without memory. */
static int take_chords(const Whole *w, Int d, const Fronts *f, double enough, const Room *of, Place *x,
                       Place *there, int single, int *taken)
{
    Int n = w->n, p = d == 2 ? 1 : 3, b = p + d, N = n * b;
    double last = INFINITY;
    for (*taken = 0; *taken < STEPS; ++*taken) {
        double predicted = 0.0;
        int solved = single ? solve_float(f, of->L, of->scale, x->tangent, of->step, 1)
                            : solve_double(f, of->L, NULL, x->tangent, of->step, 1);
        if (solved < 0) return -1;
        for (Int r = 0; r < N; r++) predicted += of->step[r] * x->tangent[r];
        if (!(predicted < SLOW * last)) return 0;
        for (Int i = 0; i < n; i++) {
            const double *step = of->step + i * b;
            for (Int a = 0; a < d; a++) there->t[i * d + a] = x->t[i * d + a] - step[a];
            for (Int a = 0; a < p; a++) of->turn[i * p + a] = -step[d + a];
        }
        turn_by(n, d, x->R, of->turn, 0, there->R);
        evaluate(w, d, of->G, of->terms, there);
        if (!(there->cost <= x->cost - GAIN * predicted + 1e-12 * x->cost)) return 0;
        int ends = predicted <= enough * x->cost;
        memcpy(x->R, there->R, (size_t)(n * d * d) * sizeof(double));
        memcpy(x->t, there->t, (size_t)(n * d) * sizeof(double));
        memcpy(x->tangent, there->tangent, (size_t)N * sizeof(double));
        memcpy(x->multipliers, there->multipliers, (size_t)(n * d * d) * sizeof(double));
        x->cost = there->cost, last = predicted;
        if (ends) return 1;
    }
    return 0;
}

/* 1 if the descent ended at a minimum near x, which it becomes; 0 if it did not, or as `factor`. */
static int descend_near(const Whole *w, Int d, const Fronts *f, const Fronts *scalars, double enough,
                        Place *x)
{
    Int n = w->n, m = w->edges.m, b = d + (d == 2 ? 1 : 3), N = n * b, entries = f->entry[n];
    Int rows = n * d, blocks = n * d * d, of_scalars = scalars->panel[scalars->many];
    Int room = (d + 1) * rows + m + n * b * b + m * b * b + entries + f->panel[f->many] + 4 * N;
    double *all = malloc((size_t)(room + of_scalars + rows + 2 * blocks + 1) * sizeof(double));
    if (!all) return -1;
    Room of = {.G = all, .terms = all + (d + 1) * rows};
    of.diagonal = of.terms + m, of.upper = of.diagonal + n * b * b, of.data = of.upper + m * b * b;
    of.L = of.data + entries, of.step = of.data + entries + f->panel[f->many];
    of.turn = of.step + N, of.scale = of.turn + N;
    double *L1 = all + room;
    Place there = {L1 + of_scalars, L1 + of_scalars + blocks, of.scale + N, NULL, 0.0};
    there.multipliers = there.t + rows;
    const Sums none = {0, NULL, NULL, NULL};
    int outcome = 0, taken = 1, single = 1;
    evaluate(w, d, of.G, of.terms, x);
    for (int k = 0; k < FACTORS && taken && !outcome; k++) {
        memset(of.data, 0, (size_t)entries * sizeof(double));
        assemble_hessian(w, d, x, of.diagonal, of.upper, of.data);
        if (single) outcome = factor_single(w, b, f, &of);
        single = single && outcome;
        if (!single) outcome = factor_double(f, of.data, NULL, of.L, &none, NULL, NULL);
        if (outcome != 1) break;
        outcome = take_chords(w, d, f, enough, &of, x, &there, single, &taken);
        /* Where it made no progress, the precision may be why. */
        if (single && taken < 2) single = 0, taken = 1;
    }
    if (outcome == 1)
        outcome = solve_translations(w, d, scalars, L1, x, of.diagonal, of.upper, of.data, there.t,
                                     of.step);
    if (outcome == 1) evaluate(w, d, of.G, of.terms, x);
    free(all);
    return outcome;
}

/* The pose nearest to the centroid, at which positions are pinned; arms (n, d) from it, and the power
 * of two nearest to their root mean square. */
static Int pin_centre(Int n, Int d, const double *t, double *arms, double *weight)
{
    double mean[3] = {0.0, 0.0, 0.0}, nearest = INFINITY, square = 0.0;
    Int pin = 0;
    for (Int k = 0; k < n * d; k++) mean[k % d] += t[k] / (double)n;
    for (Int i = 0; i < n; i++) {
        double off = 0.0;
        for (Int a = 0; a < d; a++) off += (t[i * d + a] - mean[a]) * (t[i * d + a] - mean[a]);
        if (off < nearest) nearest = off, pin = i;
    }
    for (Int k = 0; k < n * d; k++) {
        arms[k] = t[k] - t[pin * d + k % d];
        square += arms[k] * arms[k];
    }
    double rms = sqrt(square / (double)n);
    *weight = rms > 0.0 && rms < INFINITY ? ldexp(1.0, (int)nearbyint(log2(rms))) : 1.0;
    return pin;
}

/* M's blocks of the nodes, (n, d + 1, d + 1), and of the edges: `objective.operators.data_matrix`. */
static void fill_form(const Whole *w, Int d, double *diagonal, double *upper)
{
    Int c = d + 1;
    const Edges *g = &w->edges;
    for (Int i = 0; i < w->n; i++) {
        double *out = diagonal + i * c * c;
        out[0] = w->degree[i];
        for (Int a = 0; a < d; a++) out[1 + a] = out[(1 + a) * c] = w->first[i * d + a];
        for (Int a = 0; a < d; a++)
            for (Int b = 0; b < d; b++) out[(1 + a) * c + 1 + b] = w->spread[(i * d + a) * d + b];
    }
    memset(upper, 0, (size_t)(g->m * c * c) * sizeof(double));
    for (Int e = 0; e < g->m; e++) {
        double *out = upper + e * c * c;
        out[0] = -g->tau[e];
        for (Int a = 0; a < d; a++) {
            out[(1 + a) * c] = -g->tau[e] * g->moved[e * d + a];
            for (Int b = 0; b < d; b++)
                out[(1 + a) * c + 1 + b] = -g->kappa[e] * g->P[(e * d + a) * d + b];
        }
    }
}

/* Sums at a node by which rounding of its rows is bounded: its edges, kappa, and with 1-norms of the
 * levers b tau |b| and tau |b|^2 where they begin, and tau |b| where they end. */
typedef struct {
    double edges, kappa, out, square, across;
} AtNode;

static void sum_at_nodes(const Whole *w, Int d, AtNode *at)
{
    const Edges *g = &w->edges;
    memset(at, 0, (size_t)w->n * sizeof(AtNode));
    for (Int e = 0; e < g->m; e++) {
        AtNode *i = at + g->pairs[2 * e], *j = at + g->pairs[2 * e + 1];
        double lever = 0.0;
        for (Int a = 0; a < d; a++) lever += fabs(g->moved[e * d + a]);
        i->edges += 1.0, j->edges += 1.0;
        i->kappa += g->kappa[e], j->kappa += g->kappa[e];
        i->out += g->tau[e] * lever, i->square += g->tau[e] * lever * lever;
        j->across += g->tau[e] * lever;
    }
}

/* Row sums of the rounding in a node's entries of the certificate matrix, with `weight` on
 * translations: see `certpgo.certify.assembly_errors`. */
static void entry_errors(const AtNode *at, Int d, double degree, const double *multipliers,
                         double weight, double defect, double *move, double *turn)
{
    double sums = (at->edges + 4.0) * ROUNDOFF, size = 0.0;
    for (Int a = 0; a < d; a++) {
        double row = 0.0;
        for (Int b = 0; b < d; b++) row += fabs(multipliers[a * d + b]);
        if (row > size) size = row;
    }
    *turn = (sums + defect) * at->kappa * (1.0 + sqrt((double)d)) +
            sums * (size + at->square + 2.0 * at->out * weight);
    *move = sums * (2.0 * degree * weight + 2.0 * at->out + at->across);
}

/* The certificate matrix of multipliers, without the row of the pinned position, and with `demand`
 * (n,) off the diagonal of positions; its diagonal (N,) in A's order. */
static void certificate_matrix(const Whole *w, Int d, const double *multipliers, Int pin,
                               const double *demand, double *diagonals, double *upper, double *data,
                               double *diagonal)
{
    Int n = w->n, c = d + 1, m = w->edges.m;
    fill_form(w, d, diagonals, upper);
    for (Int i = 0; i < n; i++) {
        double *block = diagonals + i * c * c;
        for (Int a = 0; a < d; a++)
            for (Int b = 0; b < d; b++)
                block[(1 + a) * c + 1 + b] -= multipliers[(i * d + a) * d + b];
        block[0] -= demand[i];
        for (Int a = 0; a < c; a++) diagonal[i * c + a] = block[a * c + a];
        for (Int a = 1; a < c && i == pin; a++) block[a] = block[a * c] = 0.0;
    }
    for (Int e = 0; e < m; e++) {
        double *block = upper + e * c * c;
        for (Int a = 0; a < c; a++) {
            if (w->edges.pairs[2 * e] == pin) block[a] = 0.0;
            if (w->edges.pairs[2 * e + 1] == pin) block[a * c] = 0.0;
        }
    }
    memset(data, 0, (size_t)(c * c * w->indptr[n]) * sizeof(double));
    place_blocks(n, m, c, w->indptr, w->own, w->slots, w->edges.pairs, diagonals, upper, data);
}

/* Multipliers (n, d, d) become those of a bound: less a shift and the rounding of a factorization,
 * with S positive semidefinite. 1; 0 if this shift does not suffice; or as `factor` says. */
static int lower_multipliers(const Whole *w, Int d, const Fronts *f, const double *lengths,
                             double defect, const double *R, const double *t, double *multipliers)
{
    Int n = w->n, c = d + 1, N = n * c, m = w->edges.m, entries = f->entry[n];
    Int room = n * d + n + n * c * c + m * c * c + entries + 9 * N;
    double *arms = malloc((size_t)(room + 1) * sizeof(double));
    AtNode *at = malloc((size_t)(n + 1) * sizeof(AtNode));
    Int *nodes = malloc((size_t)(n + 1) * sizeof(Int));
    int outcome = -1;
    if (!arms || !at || !nodes) goto done;
    double *demand = arms + n * d, *diagonals = demand + n, *upper = diagonals + n * c * c;
    double *data = upper + m * c * c, *diagonal = data + entries, *weights = diagonal + N;
    double *sums = weights + 2 * N, *squares = sums + 2 * N, *bound = squares + N;
    double weight, unit = 0.0, gauge[9] = {0.0};
    Int pin = pin_centre(n, d, t, arms, &weight);
    sum_at_nodes(w, d, at);
    for (Int i = 0; i < n; i++) {
        double size = 2.0 * w->degree[i] * weight + at[i].across;
        for (Int a = 0; a < d; a++) {
            size += fabs(w->first[i * d + a]);
            unit += fabs(w->spread[(i * d + a) * d + a]) * ROUNDOFF / (double)(n * d);
        }
        demand[i] = i == pin ? 0.0 : AMPLE * ROUNDOFF * (lengths[i * c] + OTHERS) * size / weight;
        nodes[i] = i;
        for (Int a = 0; a < d * d; a++)
            gauge[a] += COVER * demand[i] * arms[i * d + a / d] * arms[i * d + a % d] / (double)n;
    }
    take_off(n, nodes, d, d, R, gauge, SHIFT * unit, multipliers);
    certificate_matrix(w, d, multipliers, pin, demand, diagonals, upper, data, diagonal);
    for (Int k = 0; k < n; k++)
        for (Int r = 0; r < c; r++) {
            Int of = f->order[k] * c + r, to = f->offset[k] + r;
            weights[to] = of % c ? 1.0 : weight;
            weights[N + to] = sqrt(lengths[of] + OTHERS) * weights[to];
        }
    memset(sums, 0, (size_t)(3 * N) * sizeof(double));
    const Sums wanted = {2, weights, sums, squares};
    outcome = factor_double(f, data, NULL, NULL, &wanted, NULL, NULL);
    for (Int k = 0; k < n && outcome == 1; k++)
        for (Int r = 0; r < c; r++) {
            Int of = f->order[k] * c + r, to = f->offset[k] + r;
            double terms = lengths[of] + OTHERS, by_row = terms * sums[to];
            double by_mean = sqrt(terms) * sums[N + to], entry = diagonal[of];
            bound[of] = ROUNDOFF * (by_row < by_mean ? by_row : by_mean);
            if (!(fabs(squares[to] - entry) <= AGREEMENT * entry && entry >= LEAST_DIAGONAL &&
                  entry < INFINITY && bound[of] < INFINITY))
                outcome = 0;
        }
    for (Int i = 0; i < n && outcome == 1; i++) {
        double move, turn;
        entry_errors(at + i, d, w->degree[i], multipliers + i * d * d, weight, defect, &move, &turn);
        move = 1.001 * (bound[i * c] + move) / weight;
        if (i != pin && !(move <= demand[i])) outcome = 0;
        for (Int a = 0; a < d; a++) {
            double *entry = multipliers + (i * d + a) * d + a;
            *entry = nextafter(*entry - 1.001 * (bound[i * c + 1 + a] + turn), -INFINITY);
        }
    }
done:
    free(arms);
    free(at);
    free(nodes);
    return outcome;
}

/* F at a point, rounded up: `certpgo.objective.enclosure`. Room: turned (m,) and moved (m,). */
static double cost_above(const Whole *w, Int d, double defect, const Place *x, double *turned,
                         double *moved)
{
    const Edges *g = &w->edges;
    double own, sum = 0.0;
    farthest(w->n, d, x->R, &own);
    own = 0.51 * (double)d * (own + 16.0 * ROUNDOFF);
    measure_residuals(g, d, x->R, x->t, turned, moved);
    for (Int e = 0; e < g->m; e++) {
        double square = 0.0, size;
        for (Int a = 0; a < d; a++) square += g->moved[e * d + a] * g->moved[e * d + a];
        size = turned[e] * (1.0 + 32.0 * ROUNDOFF) + 2.0 * own + defect + 32.0 * ROUNDOFF;
        sum += g->kappa[e] * size * size;
        size = moved[e] * (1.0 + 32.0 * ROUNDOFF) + (own + 32.0 * ROUNDOFF) * sqrt(square);
        sum += g->tau[e] * size * size;
    }
    return sum * (1.0 + (2.0 * (double)g->m + 16.0) * 2.0 * ROUNDOFF);
}

/* settle(edges, d, (indptr, own, slots), fronts of tangents, of scalars, of M, lengths, defect, enough,
 * first, R, t, multipliers, proven) -> F at the minimum near (R, t), which are changed, rounded up, from
 * where `place_anew` puts the nodes from `first` on, where a step has just promised to lower F by a share of at most `enough`, and whether its multipliers with the
 * first shift are proven; None if there is no minimum near */
static PyObject *settle_of(Held *held, PyObject *args)
{
    PyObject *edges, *places, *tangents, *scalars, *form;
    Array R = {held, DOUBLES, WRITTEN}, t = R, multipliers = R, proven = R;
    Array lengths = {held, DOUBLES};
    Whole w;
    Fronts of_tangents, of_scalars, of_form;
    double enough, defect;
    long long first;
    int d, outcome, settled;
    if (!PyArg_ParseTuple(args, "OiOOOOO&ddLO&O&O&O&", &edges, &d, &places, &tangents, &scalars,
                          &form, array, &lengths, &defect, &enough, &first, array, &R, array, &t,
                          array, &multipliers, array, &proven) ||
        !whole_of(held, edges, d, places, &w) ||
        !fronts_of(held, tangents, ASSEMBLY, &of_tangents) ||
        !fronts_of(held, scalars, ASSEMBLY, &of_scalars) ||
        !fronts_of(held, form, ASSEMBLY, &of_form) ||
        !are_of(&w, &of_tangents, d + (d == 2 ? 1 : 3)) || !are_of(&w, &of_scalars, 1) ||
        !are_of(&w, &of_form, d + 1))
        return NULL;
    Int n = w.n, m = w.edges.m;
    if (R.length != n * d * d || t.length != n * d || multipliers.length != R.length ||
        proven.length != R.length || lengths.length != n * (d + 1))
        return refuse("poses of another graph");
    if (first < 0 || first > n) return refuse("the first of the nodes expected");
    double *tangent = memory(held, of_tangents.offset[n] + 2 * m, sizeof(double));
    if (!tangent) return NULL;
    double *turned = tangent + of_tangents.offset[n];
    Place x = {R.at, t.at, tangent, multipliers.at, 0.0};
    Py_BEGIN_ALLOW_THREADS
    outcome = -1;
    if (place_anew(&w.edges, n, d, first, &x))
        outcome = descend_near(&w, d, &of_tangents, &of_scalars, enough, &x);
    settled = outcome == 1;
    if (settled) {
        memcpy(proven.at, multipliers.at, (size_t)(n * d * d) * sizeof(double));
        outcome = lower_multipliers(&w, d, &of_form, lengths.at, defect, x.R, x.t, proven.at);
        x.cost = cost_above(&w, d, defect, &x, turned, turned + m);
    }
    Py_END_ALLOW_THREADS
    if (outcome == -1) return PyErr_NoMemory();
    if (outcome < 0) return NULL;
    return settled ? Py_BuildValue("dN", x.cost, PyBool_FromLong(outcome)) : Py_NewRef(Py_None);
}
CALL(settle)
