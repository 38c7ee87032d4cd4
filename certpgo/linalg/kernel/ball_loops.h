/* Operations on balls whose numbers are of one format, REAL. */

/* What is added to a radius for the rounding of its number. */
static inline double IN(rounded)(REAL mid, double radius, double unit)
{
    return (radius + unit * fabs((double)mid) + UNDERFLOWN) * UP;
}

static inline REAL IN(multiply)(REAL a, double u, REAL b, double v, double unit, double *radius)
{
    REAL mid = a * b;
    double size = fabs((double)b);
    *radius = IN(rounded)(mid, fabs((double)a) * v + u * ((size + v) * UP), unit);
    return mid;
}

static inline REAL IN(divide)(REAL a, double u, REAL b, double v, double unit, double *radius)
{
    REAL mid = a / b;
    double least = fabs((double)b) * (1.0 - 4.0 * ROUNDING) - v * UP;
    double error = (u + fabs((double)mid) * v) / (least * (1.0 - 4.0 * ROUNDING));
    *radius = IN(rounded)(mid, least > 0.0 ? error : INFINITY, unit);
    return mid;
}

static inline void IN(keep)(Steps *s, Int offset, Int radius_offset, REAL mid, double radius)
{
    *(REAL *)(s->at[0] + offset) = mid;
    *(double *)(s->at[1] + radius_offset) = radius;
}

/* One row of sums, products or quotients. */
static inline void IN(combine_row)(Steps *s, int operation, double unit)
{
    int last = s->dimensions - 1;
    Int step[OPERANDS];
    for (int k = 0; k < OPERANDS; k++) step[k] = s->strides[k][last];
    for (Int e = 0; e < s->shape[last]; e++) {
        REAL a = READ_AT(s->at[2] + e * step[2], s->wide[2]), mid;
        REAL b = READ_AT(s->at[4] + e * step[4], s->wide[4]);
        double u = double_at(s->at[3] + e * step[3], 0), v = double_at(s->at[5] + e * step[5], 0);
        double radius;
        if (operation == SUM)
            mid = a + b, radius = IN(rounded)(mid, u + v, unit);
        else if (operation == PRODUCT)
            mid = IN(multiply)(a, u, b, v, unit, &radius);
        else
            mid = IN(divide)(a, u, b, v, unit, &radius);
        IN(keep)(s, e * step[0], e * step[1], mid, radius);
    }
}

/* One product of matrices, or a row of them. */
static inline void IN(multiply_row)(Steps *s, const Matrices *of, double unit)
{
    int last = s->dimensions - 1;
    double terms = (double)of->q;
    for (Int e = 0; e < s->shape[last]; e++) {
        const char *at[OPERANDS];
        for (int k = 0; k < OPERANDS; k++) at[k] = s->at[k] + e * s->strides[k][last];
        for (Int i = 0; i < of->p; i++)
            for (Int j = 0; j < of->r; j++) {
                REAL mid = 0;
                double error = 0.0, sizes = 0.0;
                for (Int k = 0; k < of->q; k++) {
                    REAL a = READ_AT(at[2] + i * of->rows[2] + k * of->columns[2], s->wide[2]);
                    REAL b = READ_AT(at[4] + k * of->rows[4] + j * of->columns[4], s->wide[4]);
                    double u = double_at(at[3] + i * of->rows[3] + k * of->columns[3], 0);
                    double v = double_at(at[5] + k * of->rows[5] + j * of->columns[5], 0);
                    double left = fabs((double)a), size = fabs((double)b);
                    mid += a * b;
                    error += left * v + u * ((size + v) * UP);
                    sizes += left * size;
                }
                error += (terms + 2.0) * unit * sizes;
                error = error * (1.0 + 2.0 * terms * ROUNDING) + terms * UNDERFLOWN;
                IN(keep)(s, e * s->strides[0][last] + i * of->rows[0] + j * of->columns[0],
                         e * s->strides[1][last] + i * of->rows[1] + j * of->columns[1], mid,
                         IN(rounded)(mid, error, unit));
            }
    }
}

static void IN(combine)(Steps *s, int operation, const Matrices *of, double unit)
{
    Int index[DIMENSIONS] = {0};
    for (int a = 0; a < s->dimensions; a++)
        if (!s->shape[a]) return;
    merge(s);
    do {
        if (operation == MATRICES)
            IN(multiply_row)(s, of, unit);
        else if (operation == SUM)
            IN(combine_row)(s, SUM, unit);
        else if (operation == PRODUCT)
            IN(combine_row)(s, PRODUCT, unit);
        else
            IN(combine_row)(s, QUOTIENT, unit);
    } while (next_row(s, index));
}

/* Values of a polynomial of k coefficients, doubles with what they leave, at m balls. */
static void IN(evaluate)(Int m, Int k, const double *coefficients, double unit, const REAL *x,
                         const double *radii, REAL *mid, double *radius)
{
    for (Int e = 0; e < m; e++) {
        REAL a = 0;
        double u = 0.0;
        for (Int i = k - 1; i >= 0; i--) {
            double high = coefficients[2 * i], low = coefficients[2 * i + 1];
            a = IN(multiply)(a, u, x[e], radii[e], unit, &u) + low;
            u = IN(rounded)(a, u + ROUNDING * fabs(low), unit);
            a += high;
            u = IN(rounded)(a, u, unit);
        }
        mid[e] = a, radius[e] = u;
    }
}

/* Schur complements of the leading `count` rows of matrices (m, p, p), see `eliminated`. */
static void IN(complement)(Int m, Int p, Int count, double unit, const REAL *A, const double *radii,
                          REAL *mid, double *radius, Int *proven)
{
    Int q = p - count;
    REAL a[LARGEST * LARGEST];
    double u[LARGEST * LARGEST];
    for (Int e = 0; e < m; e++, A += p * p, radii += p * p, mid += q * q, radius += q * q) {
        for (Int k = 0; k < p * p; k++) a[k] = A[k], u[k] = radii[k];
        proven[e] = 1;
        for (Int c = 0; c < count; c++) {
            REAL pivot = a[c * p + c];
            double off = u[c * p + c];
            if (!(pivot - off > 0)) proven[e] = 0;
            for (Int i = c + 1; i < p; i++)
                for (Int j = c + 1; j < p; j++) {
                    double v;
                    REAL taken = IN(multiply)(a[i * p + c], u[i * p + c], a[j * p + c],
                                              u[j * p + c], unit, &v);
                    taken = IN(divide)(taken, v, pivot, off, unit, &v);
                    a[i * p + j] -= taken;
                    u[i * p + j] = IN(rounded)(a[i * p + j], u[i * p + j] + v, unit);
                }
        }
        for (Int i = 0; i < q; i++)
            for (Int j = 0; j < q; j++) {
                mid[i * q + j] = a[(count + i) * p + count + j];
                radius[i * q + j] = u[(count + i) * p + count + j];
            }
    }
}
