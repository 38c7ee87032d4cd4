/* Normal equations of other programs' costs. `certpgo.objective.normal_equations` has the same in
 * NumPy, with the formulas of residuals in `certpgo.objective.costs`. */

/* Residuals: y and the angle or the vector part of a quaternion, or the logarithm in SE(d). */
typedef enum { QUATERNION, LOGARITHM } Residual_kind;

typedef struct {
    Residual_kind kind;
    const double *weights; /* (m, p, p) */
    const double *series;  /* of c = (1 - (theta/2) cot(theta/2)) / theta^2 in theta^2 */
    Int terms;
} Program;

/* C = A B, or A^T B, of matrices (d, d) and (d, k). */
static inline void times(Int d, Int k, const double *A, int transposed, const double *B, double *C)
{
    for (Int a = 0; a < d; a++)
        for (Int c = 0; c < k; c++) {
            double sum = 0.0;
            for (Int b = 0; b < d; b++) sum += A[transposed ? b * d + a : a * d + b] * B[b * k + c];
            C[a * k + c] = sum;
        }
}

/* w x for a tangent, (d, d). */
static inline void skew(Int d, const double *w, double *out)
{
    if (d == 2) {
        out[0] = out[3] = 0.0, out[1] = -w[0], out[2] = w[0];
        return;
    }
    for (Int k = 0; k < 3; k++) {
        Int k1 = (k + 1) % 3, k2 = (k + 2) % 3;
        out[4 * k] = 0.0, out[3 * k2 + k1] = w[k], out[3 * k1 + k2] = -w[k];
    }
}

/* The tangent of a rotation of at most pi, as `rotations.log`. */
static inline void logarithm(Int d, const double *E, double *v)
{
    if (d == 2) {
        v[0] = atan2(0.5 * (E[2] - E[1]), 0.5 * (E[0] + E[3]));
        return;
    }
    double square = 0.0, cosine = 0.5 * (E[0] + E[4] + E[8] - 1.0), angle, scale;
    for (Int k = 0; k < 3; k++) {
        Int k1 = (k + 1) % 3, k2 = (k + 2) % 3;
        v[k] = 0.5 * (E[3 * k2 + k1] - E[3 * k1 + k2]);
        square += v[k] * v[k];
    }
    angle = atan2(sqrt(square), cosine);
    if (angle <= 3.0) {
        scale = angle > 0.0 ? angle / sin(angle) : 1.0;
        for (Int k = 0; k < 3; k++) v[k] *= scale;
        return;
    }
    /* The skew part vanishes; (E + E^T)/2 = cos I + (1 - cos) a a^T has the axis. */
    Int largest = 0;
    double axis[3], along = 0.0;
    for (Int k = 1; k < 3; k++)
        if (E[4 * k] > E[4 * largest]) largest = k;
    square = 0.0;
    for (Int k = 0; k < 3; k++) {
        axis[k] = 0.5 * (E[3 * k + largest] + E[3 * largest + k]) - (k == largest ? cos(angle) : 0.0);
        square += axis[k] * axis[k];
        along += axis[k] * v[k];
    }
    scale = (along < 0.0 ? -angle : angle) / sqrt(square);
    for (Int k = 0; k < 3; k++) v[k] = scale * axis[k];
}

/* Residuals e (p,) and their derivatives in v (p, d) and in w (p, q), for y and the rotation E. */
static inline void of_quaternion(Int d, const double *P, const double *y, const double *turned,
                                 double *e, double *in_v, double *in_w)
{
    Int q = d == 2 ? 1 : 3;
    double half = 0.0, w, scale, hat[9];
    for (Int a = 0; a < d; a++)
        for (Int b = 0; b < d; b++) in_v[a * d + b] = P[b * d + a];
    for (Int a = 0; a < d; a++) e[a] = y[a];
    if (d == 2) {
        e[2] = turned[0], in_w[2] = 1.0;
        return;
    }
    for (Int k = 0; k < 3; k++) half += turned[k] * turned[k];
    half = 0.5 * sqrt(half);
    w = cos(half), scale = half > 0.0 ? 0.5 * sin(half) / half : 0.5;
    if (w < 0.0) w = 0.0; /* where the angle is rounded up to pi */
    for (Int k = 0; k < 3; k++) e[3 + k] = scale * turned[k];
    skew(3, e + 3, hat);
    for (Int k = 0; k < 9; k++) in_w[3 * q + k] = 0.5 * (hat[k] + (k % 4 ? 0.0 : w));
}

static inline void of_logarithm(const Program *of, Int d, const double *P, const double *y,
                                const double *omega, double *e, double *in_v, double *in_w)
{
    Int q = d == 2 ? 1 : 3;
    double x = 0.0, c = 0.0, slope = 0.0, hat[9], square[9], left[9], once[3], twice[3];
    for (Int k = 0; k < q; k++) x += omega[k] * omega[k];
    for (Int k = of->terms - 1; k >= 0; k--) slope = slope * x + c, c = c * x + of->series[k];
    skew(d, omega, hat);
    times(d, d, hat, 0, hat, square);
    for (Int a = 0; a < d; a++)
        for (Int b = 0; b < d; b++)
            left[a * d + b] = (a == b) - 0.5 * hat[a * d + b] + c * square[a * d + b];
    times(d, 1, left, 0, y, e);
    for (Int k = 0; k < q; k++) e[d + k] = omega[k];
    for (Int a = 0; a < d; a++) /* V^-1 P^T */
        for (Int b = 0; b < d; b++) {
            double sum = 0.0;
            for (Int k = 0; k < d; k++) sum += left[a * d + k] * P[b * d + k];
            in_v[a * d + b] = sum;
        }
    times(d, 1, hat, 0, y, once);
    times(d, 1, hat, 0, once, twice);
    if (d == 2) {
        double turned[2] = {-y[1], y[0]};
        for (Int a = 0; a < 2; a++)
            in_w[a] = -0.5 * turned[a] - 2.0 * c * omega[0] * y[a] + 2.0 * slope * twice[a] * omega[0];
        in_w[2] = 1.0;
        return;
    }
    double of_y[9], of_once[9], both[9], in_omega[9];
    skew(3, y, of_y), skew(3, once, of_once);
    times(3, 3, hat, 0, of_y, both);
    for (Int a = 0; a < 3; a++)
        for (Int b = 0; b < 3; b++)
            in_omega[3 * a + b] = 0.5 * of_y[3 * a + b] - c * (of_once[3 * a + b] + both[3 * a + b]) +
                                  2.0 * slope * twice[a] * omega[b];
    for (Int a = 0; a < 3; a++)
        for (Int b = 0; b < 3; b++) { /* times the inverse right Jacobian, the transpose of V^-1 */
            double sum = 0.0;
            for (Int k = 0; k < 3; k++) sum += in_omega[3 * a + k] * left[3 * b + k];
            in_w[3 * a + b] = sum;
            in_w[9 + 3 * a + b] = left[3 * b + a];
        }
}

/* The residuals of an edge, and their derivatives in its poses, (p, p). */
static inline void linearize(const Edges *g, const Program *of, Int d, Int e, const double *R,
                             const double *t, double *residual, double *at_i, double *at_j)
{
    Int p = d * (d + 1) / 2, q = p - d, i = g->pairs[2 * e], j = g->pairs[2 * e + 1];
    const double *Ri = R + i * d * d, *Rj = R + j * d * d, *P = g->P + e * d * d;
    double v[3], Q[9], y[3], E[9], turned[3], lever[9];
    double in_v[18] = {0.0}, in_w[18] = {0.0};
    for (Int a = 0; a < d; a++) y[a] = t[j * d + a] - t[i * d + a];
    times(d, 1, Ri, 1, y, v);
    times(d, d, Ri, 1, Rj, Q);
    for (Int a = 0; a < d; a++) turned[a] = v[a] - g->moved[e * d + a];
    times(d, 1, P, 1, turned, y);
    times(d, d, P, 1, Q, E);
    logarithm(d, E, turned);
    if (of->kind == QUATERNION)
        of_quaternion(d, P, y, turned, residual, in_v, in_w);
    else
        of_logarithm(of, d, P, y, turned, residual, in_v, in_w);
    if (d == 2)
        lever[0] = v[1], lever[1] = -v[0];
    else
        skew(3, v, lever);
    /* v moves by R_i^T (dt_j - dt_i) + v x w_i, and Q by Q exp(w_j - Q^T w_i). */
    for (Int a = 0; a < p; a++) {
        double *by_i = at_i + a * p, *by_j = at_j + a * p;
        for (Int b = 0; b < d; b++) {
            by_j[b] = 0.0;
            for (Int k = 0; k < d; k++) by_j[b] += in_v[a * d + k] * Ri[b * d + k];
            by_i[b] = -by_j[b];
        }
        for (Int b = 0; b < q; b++) {
            double moved = 0.0;
            for (Int k = 0; k < d; k++) moved += in_v[a * d + k] * lever[k * q + b];
            if (d == 2)
                moved -= in_w[a];
            else
                for (Int k = 0; k < q; k++) moved -= in_w[a * q + k] * Q[b * d + k];
            by_i[d + b] = moved;
            by_j[d + b] = in_w[a * q + b];
        }
    }
}

/* Adds A^T B of matrices (p, p). */
static inline void add_product(Int p, const double *A, const double *B, double *sum)
{
    for (Int k = 0; k < p; k++)
        for (Int a = 0; a < p; a++)
            for (Int b = 0; b < p; b++) sum[a * p + b] += A[k * p + a] * B[k * p + b];
}

/* The edges' terms (m,), and half the gradient (n, p), zero before. */
static inline void first_derivatives(const Edges *g, const Program *of, Int d, const double *R,
                                     const double *t, double *terms, double *gradient)
{
    Int p = d * (d + 1) / 2;
    double e[6], weighted[6], at_i[36], at_j[36];
    for (Int k = 0; k < g->m; k++) {
        double *at[2] = {gradient + g->pairs[2 * k] * p, gradient + g->pairs[2 * k + 1] * p};
        linearize(g, of, d, k, R, t, e, at_i, at_j);
        times(p, 1, of->weights + k * p * p, 0, e, weighted);
        terms[k] = 0.0;
        for (Int a = 0; a < p; a++) {
            terms[k] += e[a] * weighted[a];
            for (Int b = 0; b < p; b++) {
                at[0][b] += at_i[a * p + b] * weighted[a];
                at[1][b] += at_j[a * p + b] * weighted[a];
            }
        }
    }
}

/* Blocks of the Gauss-Newton matrix: (n, p, p), zero before, and (m, p, p). */
static inline void second_derivatives(const Edges *g, const Program *of, Int d, const double *R,
                                      const double *t, double *diagonal, double *upper)
{
    Int p = d * (d + 1) / 2;
    double e[6], at_i[36], at_j[36], heavy_i[36], heavy_j[36];
    for (Int k = 0; k < g->m; k++) {
        const double *W = of->weights + k * p * p;
        linearize(g, of, d, k, R, t, e, at_i, at_j);
        times(p, p, W, 0, at_i, heavy_i);
        times(p, p, W, 0, at_j, heavy_j);
        add_product(p, at_i, heavy_i, diagonal + g->pairs[2 * k] * p * p);
        add_product(p, at_j, heavy_j, diagonal + g->pairs[2 * k + 1] * p * p);
        memset(upper + k * p * p, 0, (size_t)(p * p) * sizeof(double));
        add_product(p, at_i, heavy_j, upper + k * p * p);
    }
}

/* What both calls take: (edges, d, weights, series | None, R, t, two arrays written). */
typedef struct {
    Edges g;
    Program of;
    Array R, t, one, other;
    int d;
} Equations;

static int equations_of(Held *held, PyObject *args, Equations *all)
{
    PyObject *tuple;
    Array weights = {held, DOUBLES}, series = {held, DOUBLES, OPTIONAL};
    all->R = all->t = (Array){held, DOUBLES};
    all->one = all->other = (Array){held, DOUBLES, WRITTEN};
    if (!PyArg_ParseTuple(args, "OiO&O&O&O&O&O&", &tuple, &all->d, array, &weights, array, &series,
                          array, &all->R, array, &all->t, array, &all->one, array, &all->other) ||
        !edges_of(held, tuple, all->d, &all->g))
        return 0;
    Int d = all->d, p = d * (d + 1) / 2, n = all->t.length / d;
    if (!all->g.tau || all->R.length != n * d * d || all->t.length != n * d ||
        weights.length != all->g.m * p * p || !all_below(all->g.pairs, 2 * all->g.m, n))
        return refuse("poses and weights of the same graph expected") != NULL;
    all->of = (Program){series.at ? LOGARITHM : QUATERNION, weights.at, series.at, series.length};
    return 1;
}

/* slopes(edges, d, weights, series | None, R, t, terms, gradient): the gradient is zero before;
 * residuals are logarithms if there is a series, else quaternions */
static PyObject *slopes_of(Held *held, PyObject *args)
{
    Equations a;
    if (!equations_of(held, args, &a)) return NULL;
    Int p = a.d * (a.d + 1) / 2;
    if (a.one.length != a.g.m || a.other.length != a.t.length / a.d * p)
        return refuse("terms and a gradient of the same graph expected");
    IN_SPACE(a.d, first_derivatives(&a.g, &a.of, 2, a.R.at, a.t.at, a.one.at, a.other.at),
             first_derivatives(&a.g, &a.of, 3, a.R.at, a.t.at, a.one.at, a.other.at))
    return Py_NewRef(Py_None);
}
CALL(slopes)

/* curvatures(edges, d, weights, series | None, R, t, diagonal, upper): the diagonal is zero before */
static PyObject *curvatures_of(Held *held, PyObject *args)
{
    Equations a;
    if (!equations_of(held, args, &a)) return NULL;
    Int p = a.d * (a.d + 1) / 2;
    if (a.one.length != a.t.length / a.d * p * p || a.other.length != a.g.m * p * p)
        return refuse("blocks of the same graph expected");
    IN_SPACE(a.d, second_derivatives(&a.g, &a.of, 2, a.R.at, a.t.at, a.one.at, a.other.at),
             second_derivatives(&a.g, &a.of, 3, a.R.at, a.t.at, a.one.at, a.other.at))
    return Py_NewRef(Py_None);
}
CALL(curvatures)
