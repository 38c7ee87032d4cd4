/* Sums over the edges of a graph: gradients, Hessians and block matrices.
 *
 * `certpgo.objective` has the same in NumPy; there are the formulas. Matrices are stored by rows.
 */

/* A graph of m edges (i, j) with measured rotations P and, unless `tau` is NULL, translations. */
typedef struct {
    Int m, d;
    const Int *pairs;     /* (m, 2) */
    const double *P;      /* (m, d, d) */
    const double *K;      /* (m, d, d) weights on the right, or NULL for kappa I */
    const double *kappa;  /* (m,) */
    const double *tau;    /* (m,) or NULL */
    const double *moved;  /* (m, d) measured translations */
    const double *arms;   /* (m, d) or NULL */
} Edges;

/* The edges' terms, and unless G is NULL half the gradient (n, r, d + 1); without translations
 * (n, r, d). */
static inline void differentiate(const Edges *g, Int d, Int r, const double *R, const double *t,
                                 double *G, double *terms)
{
    Int move = g->tau != NULL, width = d + move;
    double E[3 * 32], F[3 * 32];
    for (Int e = 0; e < g->m; e++) {
        Int i = g->pairs[2 * e], j = g->pairs[2 * e + 1];
        const double *Ri = R + i * r * d, *Rj = R + j * r * d, *P = g->P + e * d * d;
        double *Gi = NULL, *Gj = NULL, term = 0.0;
        if (G) Gi = G + i * r * width, Gj = G + j * r * width;
        for (Int a = 0; a < r; a++)
            for (Int c = 0; c < d; c++) {
                double sum = Rj[a * d + c];
                for (Int b = 0; b < d; b++) sum -= Ri[a * d + b] * P[b * d + c];
                E[a * d + c] = sum;
            }
        for (Int a = 0; a < r; a++)
            for (Int c = 0; c < d; c++) {
                double sum = 0.0;
                if (g->K)
                    for (Int b = 0; b < d; b++) sum += E[a * d + b] * g->K[(e * d + b) * d + c];
                else
                    sum = g->kappa[e] * E[a * d + c];
                F[a * d + c] = sum;
                term += sum * E[a * d + c];
            }
        for (Int a = 0; a < r && G; a++) {
            double *gi = Gi + a * width + move, *gj = Gj + a * width + move;
            for (Int c = 0; c < d; c++) {
                double sum = 0.0;
                for (Int b = 0; b < d; b++) sum += F[a * d + b] * P[c * d + b];
                gi[c] -= sum;
                gj[c] += F[a * d + c];
            }
        }
        for (Int a = 0; a < r && move; a++) {
            double rest = t[j * r + a] - t[i * r + a], force;
            for (Int c = 0; c < d; c++) rest -= Ri[a * d + c] * g->moved[e * d + c];
            if (g->arms)
                for (Int c = 0; c < d; c++) rest += Rj[a * d + c] * g->arms[e * d + c];
            force = g->tau[e] * rest;
            term += force * rest;
            if (!G) continue;
            Gi[a * width] -= force;
            Gj[a * width] += force;
            for (Int c = 0; c < d; c++) Gi[a * width + 1 + c] -= force * g->moved[e * d + c];
            if (g->arms)
                for (Int c = 0; c < d; c++) Gj[a * width + 1 + c] += force * g->arms[e * d + c];
        }
        terms[e] = term;
    }
}

/* lever(x) w = -hat(w) x, times the rotation R: (d, p). */
static inline void turned_lever(Int d, const double *R, const double *x, double *out)
{
    if (d == 2) {
        for (Int a = 0; a < 2; a++) out[a] = R[2 * a] * x[1] - R[2 * a + 1] * x[0];
        return;
    }
    for (Int a = 0; a < 3; a++)
        for (Int k = 0; k < 3; k++) {
            Int k1 = (k + 1) % 3, k2 = (k + 2) % 3;
            out[3 * a + k] = R[3 * a + k1] * x[k2] - R[3 * a + k2] * x[k1];
        }
}

/* The edges' blocks (m, b, b) of the Riemannian Hessian of F/2. */
static inline void couple(const Edges *g, Int d, const double *R, double *upper)
{
    Int move = g->tau != NULL, p = d == 2 ? 1 : 3, b = p + (move ? d : 0), o = move ? d : 0;
    for (Int e = 0; e < g->m; e++) {
        const double *Ri = R + g->pairs[2 * e] * d * d, *Rj = R + g->pairs[2 * e + 1] * d * d;
        const double *P = g->P + e * d * d;
        double *out = upper + e * b * b, N[9], B[9], at_i[9], at_j[9];
        for (Int a = 0; a < d; a++)
            for (Int c = 0; c < d; c++) {
                double sum = 0.0, product = 0.0;
                for (Int k = 0; k < d; k++) sum += Rj[k * d + a] * Ri[k * d + c];
                B[a * d + c] = sum;
                if (g->K)
                    for (Int k = 0; k < d; k++) product += P[a * d + k] * g->K[(e * d + k) * d + c];
                else
                    product = g->kappa[e] * P[a * d + c];
                N[a * d + c] = product;
            }
        for (Int k = 0; k < b * b; k++) out[k] = 0.0;
        /* -tr(hat(v) N hat(w)^T B) */
        if (d == 2)
            out[o * b + o] = -(N[3] * B[0] + N[0] * B[3] - N[2] * B[2] - N[1] * B[1]);
        else
            for (Int k = 0; k < 3; k++)
                for (Int l = 0; l < 3; l++) {
                    Int k1 = (k + 1) % 3, k2 = (k + 2) % 3, l1 = (l + 1) % 3, l2 = (l + 2) % 3;
                    out[(o + k) * b + o + l] =
                        -(N[3 * k1 + l1] * B[3 * l2 + k2] - N[3 * k1 + l2] * B[3 * l1 + k2] -
                          N[3 * k2 + l1] * B[3 * l2 + k1] + N[3 * k2 + l2] * B[3 * l1 + k1]);
                }
        if (!move) continue;
        double tau = g->tau[e];
        for (Int a = 0; a < d; a++) out[a * b + a] = -tau;
        turned_lever(d, Ri, g->moved + e * d, at_i);
        for (Int a = 0; a < d; a++)
            for (Int k = 0; k < p; k++) out[(d + k) * b + a] = tau * at_i[a * p + k];
        if (!g->arms) continue;
        turned_lever(d, Rj, g->arms + e * d, at_j);
        for (Int a = 0; a < d; a++)
            for (Int k = 0; k < p; k++) {
                out[a * b + d + k] = tau * at_j[a * p + k];
                for (Int l = 0; l < p; l++)
                    out[(d + l) * b + d + k] -= tau * at_i[a * p + l] * at_j[a * p + k];
            }
    }
}

/* Of the nodes: what the diagonal of a Hessian consists of, see `operators.NodeSums`. */
typedef struct {
    Int n;
    const double *spread;      /* (n, d, d) */
    const double *multipliers; /* (n, d, d) */
    const double *first;       /* (n, d) and (n,); without translations NULL */
    const double *degree;
} Nodes;

/* The nodes' blocks (n, b, b) of the Riemannian Hessian of F/2. */
static inline void restrict_to_tangents(const Nodes *nodes, Int move, Int d, const double *R,
                                        double *diagonal)
{
    Int p = d == 2 ? 1 : 3, o = move ? d : 0, b = p + o;
    for (Int i = 0; i < nodes->n; i++, R += d * d) {
        double S[9], at[9], trace = 0.0, *out = diagonal + i * b * b;
        for (Int k = 0; k < d * d; k++)
            S[k] = nodes->spread[i * d * d + k] - nodes->multipliers[i * d * d + k];
        for (Int a = 0; a < d; a++) trace += S[a * d + a];
        for (Int k = 0; k < b * b; k++) out[k] = 0.0;
        for (Int k = 0; k < p; k++)
            for (Int l = 0; l < p; l++)
                out[(o + k) * b + o + l] = (k == l ? trace : 0.0) - (d == 2 ? 0.0 : S[k * d + l]);
        if (!move) continue;
        for (Int a = 0; a < d; a++) out[a * b + a] = nodes->degree[i];
        turned_lever(d, R, nodes->first + i * d, at);
        for (Int a = 0; a < d; a++)
            for (Int k = 0; k < p; k++)
                out[a * b + d + k] = out[(d + k) * b + a] = -at[a * p + k];
    }
}

/* What gradients are divided by, (n,): INFINITY for points, which have no rotation. */
typedef struct {
    const double *turning;
    const double *moving; /* or NULL: translations do not count */
} Stiffness;

/* Tangents (n, b) and multipliers (n, d, d) of half the gradient G at rotations R; returns the
 * largest part of a tangent over its stiffness, or NaN. */
static inline double project(Int n, Int d, Int move, const double *R, const double *G,
                             const Stiffness *stiffness, double *tangent, double *multipliers)
{
    Int p = d == 2 ? 1 : 3, width = d + move;
    double largest = -INFINITY;
    for (Int i = 0; i < n; i++, R += d * d, G += d * width, multipliers += d * d) {
        double product[9], sizes[2] = {0.0, 0.0}, *moved = tangent, *turn = tangent + (move ? d : 0);
        for (Int a = 0; a < d; a++)
            for (Int c = 0; c < d; c++) {
                double sum = 0.0;
                for (Int k = 0; k < d; k++) sum += G[k * width + move + a] * R[k * d + c];
                product[a * d + c] = sum;
            }
        for (Int a = 0; a < d; a++)
            for (Int c = 0; c < d; c++)
                multipliers[a * d + c] = 0.5 * (product[a * d + c] + product[c * d + a]);
        if (d == 2)
            turn[0] = product[1] - product[2];
        else
            for (Int k = 0; k < 3; k++) {
                Int k1 = (k + 1) % 3, k2 = (k + 2) % 3;
                turn[k] = product[3 * k1 + k2] - product[3 * k2 + k1];
            }
        for (Int k = 0; k < p; k++) sizes[0] += turn[k] * turn[k];
        for (Int a = 0; a < d && move; a++) moved[a] = G[a * width], sizes[1] += moved[a] * moved[a];
        for (int of = 0; of < 2; of++) {
            const double *weights = of ? stiffness->moving : stiffness->turning;
            double size = weights ? sqrt(sizes[of]) / weights[i] : -INFINITY;
            if (size > largest || size != size) largest = size;
        }
        tangent = turn + p;
    }
    return largest;
}

/* Rotations turned by tangents: R exp(v), or exp(v) R. */
static inline void turn_by(Int n, Int d, const double *R, const double *v, int left, double *out)
{
    for (Int i = 0; i < n; i++, R += d * d, out += d * d) {
        double E[9];
        if (d == 2) {
            E[0] = E[3] = cos(v[i]), E[2] = sin(v[i]), E[1] = -E[2];
        } else {
            const double *w = v + 3 * i;
            double square = w[0] * w[0] + w[1] * w[1] + w[2] * w[2], angle = sqrt(square);
            double half = 0.5 * angle, a = angle > 0.0 ? sin(angle) / angle : 1.0;
            double b = half > 0.0 ? sin(half) / half : 1.0;
            /* I + a hat(w) + b^2 / 2 hat(w)^2 */
            b *= 0.5 * b;
            for (Int k = 0; k < 3; k++) {
                Int k1 = (k + 1) % 3, k2 = (k + 2) % 3;
                E[4 * k] = 1.0 - b * (w[k1] * w[k1] + w[k2] * w[k2]);
                E[3 * k + k1] = b * w[k] * w[k1] - a * w[k2];
                E[3 * k1 + k] = b * w[k] * w[k1] + a * w[k2];
            }
        }
        const double *A = left ? E : R, *B = left ? R : E;
        for (Int a = 0; a < d; a++)
            for (Int c = 0; c < d; c++) {
                double sum = 0.0;
                for (Int k = 0; k < d; k++) sum += A[a * d + k] * B[k * d + c];
                out[a * d + c] = sum;
            }
    }
}

/* Angles (m,) between R_i P and R_j, 0 where no rotation is measured. */
static inline void measure_angles(const Edges *g, Int d, const double *R, double *angles)
{
    for (Int e = 0; e < g->m; e++) {
        const double *Ri = R + g->pairs[2 * e] * d * d, *Rj = R + g->pairs[2 * e + 1] * d * d;
        double B[9], Q[9], sine = 0.0, trace = 0.0;
        for (Int a = 0; a < d; a++)
            for (Int c = 0; c < d; c++) {
                B[a * d + c] = 0.0;
                for (Int k = 0; k < d; k++) B[a * d + c] += Rj[k * d + a] * Ri[k * d + c];
            }
        for (Int a = 0; a < d; a++)
            for (Int c = 0; c < d; c++) {
                Q[a * d + c] = 0.0;
                for (Int k = 0; k < d; k++) Q[a * d + c] += B[a * d + k] * g->P[(e * d + k) * d + c];
            }
        for (Int a = 0; a < d; a++) {
            trace += Q[a * d + a];
            for (Int c = 0; c < a; c++) {
                double skew = 0.5 * (Q[a * d + c] - Q[c * d + a]);
                sine += skew * skew;
            }
        }
        angles[e] = g->kappa[e] > 0.0 ? atan2(sqrt(sine), 0.5 * (d == 2 ? trace : trace - 1.0)) : 0.0;
    }
}

/* Norms (m,) of R_j - R_i P, and of t_j - t_i - R_i b where translations are measured. */
static inline void measure_residuals(const Edges *g, Int d, const double *R, const double *t,
                                     double *turned, double *moved)
{
    for (Int e = 0; e < g->m; e++) {
        Int i = g->pairs[2 * e], j = g->pairs[2 * e + 1];
        double square = 0.0;
        for (Int a = 0; a < d; a++)
            for (Int c = 0; c < d; c++) {
                double product = 0.0, off;
                for (Int b = 0; b < d; b++)
                    product += R[(i * d + a) * d + b] * g->P[(e * d + b) * d + c];
                off = R[(j * d + a) * d + c] - product;
                square += off * off;
            }
        turned[e] = sqrt(square);
        if (!moved) continue;
        square = 0.0;
        for (Int a = 0; a < d; a++) {
            double step = 0.0, off;
            for (Int b = 0; b < d; b++) step += R[(i * d + a) * d + b] * g->moved[e * d + b];
            off = t[j * d + a] - t[i * d + a] - step;
            square += off * off;
        }
        moved[e] = sqrt(square);
    }
}

/* Subtract shift I and the symmetric part of Y_i^T G Y_i, unless G is NULL, of some nodes' blocks Y
 * (n, r, d), from multipliers (n, d, d). */
static void take_off(Int count, const Int *nodes, Int r, Int d, const double *Y, const double *G,
                     double shift, double *multipliers)
{
    double Z[3 * 32];
    for (Int k = 0; k < count; k++) {
        const double *block = Y + nodes[k] * r * d;
        double *of = multipliers + nodes[k] * d * d;
        for (Int a = 0; a < d; a++) of[a * d + a] -= shift;
        if (!G) continue;
        for (Int u = 0; u < r; u++)
            for (Int c = 0; c < d; c++) {
                Z[u * d + c] = 0.0;
                for (Int v = 0; v < r; v++)
                    Z[u * d + c] += 0.5 * (G[u * r + v] + G[v * r + u]) * block[v * d + c];
            }
        for (Int a = 0; a < d; a++)
            for (Int c = a; c < d; c++) {
                double sum = 0.0;
                for (Int u = 0; u < r; u++) sum += block[u * d + a] * Z[u * d + c];
                of[a * d + c] -= sum;
                if (c > a) of[c * d + a] -= sum;
            }
    }
}

/* The matrix (n, d, d) farthest from being a rotation, and the largest entry of |R^T R - I|. */
static inline Int farthest(Int n, Int d, const double *R, double *largest)
{
    Int worst = 0;
    *largest = 0.0;
    for (Int k = 0; k < n; k++, R += d * d) {
        double off = 0.0, determinant;
        for (Int a = 0; a < d; a++)
            for (Int c = a; c < d; c++) {
                double sum = a == c ? -1.0 : 0.0, product = 0.0;
                for (Int b = 0; b < d; b++) product += R[b * d + a] * R[b * d + c];
                sum = fabs(product + sum);
                if (!(sum <= off)) off = sum;
            }
        if (d == 2)
            determinant = R[0] * R[3] - R[1] * R[2];
        else
            determinant = R[0] * (R[4] * R[8] - R[5] * R[7]) + R[1] * (R[5] * R[6] - R[3] * R[8]) +
                          R[2] * (R[3] * R[7] - R[4] * R[6]);
        if (!(determinant > 0.0) || !(off < INFINITY)) off = INFINITY;
        if (off > *largest) *largest = off, worst = k;
    }
    return worst;
}
