/* The arithmetic of module.c in one precision: REAL, IN(name) and LETTER are defined there. */

static void (*IN(potrf))(char *, int *, REAL *, int *, int *);
static void (*IN(trsm))(char *, char *, char *, char *, int *, int *, REAL *, REAL *, int *, REAL *,
                        int *);
static void (*IN(syrk))(char *, char *, int *, int *, REAL *, REAL *, int *, REAL *, REAL *, int *);

static int IN(connect)(void)
{
    *(void **)&IN(potrf) = found("scipy.linalg.cython_lapack", LETTER "potrf");
    *(void **)&IN(trsm) = found("scipy.linalg.cython_blas", LETTER "trsm");
    *(void **)&IN(syrk) = found("scipy.linalg.cython_blas", LETTER "syrk");
    return IN(potrf) && IN(trsm) && IN(syrk) ? 0 : -1;
}

/* Copy A's columns of supernode s into its panel (ld x nc); `at` is each node's row in the front.
 * Rows and columns are multiplied by `scale`, in the order of L, unless it is NULL. */
static void IN(assemble)(const Fronts *f, Int s, const double *data, const double *scale,
                         const Int *at, REAL *panel, Int ld)
{
    for (Int k = f->start[s]; k < f->start[s + 1]; k++) {
        Int node = f->order[k], b = f->sizes[node], column = at[k];
        const Int *first = f->indices + f->indptr[node], *last = f->indices + f->indptr[node + 1];
        Int height = (f->entry[node + 1] - f->entry[node]) / b;
        const double *from = data + f->entry[node];
        for (const Int *i = first; i < last; from += f->sizes[*i++]) {
            Int row = f->place[*i];
            if (row < k) continue;
            for (Int c = 0; c < b; c++) {
                REAL *to = panel + (column + c) * ld + at[row];
                if (scale) {
                    double own = scale[f->offset[k] + c];
                    const double *other = scale + f->offset[row];
                    for (Int r = row == k ? c : 0; r < f->sizes[*i]; r++)
                        to[r] = (REAL)(from[c * height + r] * own * other[r]);
                } else {
                    for (Int r = row == k ? c : 0; r < f->sizes[*i]; r++)
                        to[r] = (REAL)from[c * height + r];
                }
            }
        }
    }
}

/* Add a child's update (m x m, lower) to its parent's panel and update. */
static void IN(extend)(const REAL *update, Int m, const Int *run, Int runs, REAL *panel, Int nc,
                       Int ld, REAL *above)
{
    /* A run is three numbers: first row in the child, its row in the front, length. */
    for (Int a = 0; a < runs; a++) {
        for (Int c = 0; c < run[3 * a + 2]; c++) {
            Int column = run[3 * a] + c, to = run[3 * a + 1] + c;
            const REAL *from = update + column * m;
            REAL *into = to < nc ? panel + to * ld : above + (to - nc) * (ld - nc) - nc;
            for (Int r = c; r < run[3 * a + 2]; r++) into[run[3 * a + 1] + r] += from[run[3 * a] + r];
            for (Int b = a + 1; b < runs; b++) {
                const REAL *source = from + run[3 * b];
                REAL *target = into + run[3 * b + 1];
                for (Int r = 0; r < run[3 * b + 2]; r++) target[r] += source[r];
            }
        }
    }
}

/* Add a panel's part of |L| |L|^T w and of the squared row norms. */
static void IN(add_sums)(const Fronts *f, Int s, const REAL *panel, Int nc, Int ld, const Sums *to,
                         double *gathered)
{
    Int N = f->offset[f->n], first = f->offset[f->start[s]];
    double *w = gathered, *out = gathered + ld;
    for (Int q = 0; q < to->columns + 1; q++) {
        const double *weight = to->weight + q * N;
        double *sums = q < to->columns ? to->sums + q * N : to->squares;
        if (q < to->columns) {
            Int r = nc;
            memcpy(w, weight + first, (size_t)nc * sizeof(double));
            for (Int e = f->begin[s]; e < f->begin[s + 1]; e++)
                for (Int k = f->offset[f->rows[e]]; k < f->offset[f->rows[e] + 1]; k++)
                    w[r++] = weight[k];
        }
        memset(out, 0, (size_t)ld * sizeof(double));
        for (Int c = 0; c < nc; c++) {
            const REAL *column = panel + c * ld;
            if (q < to->columns) {
                /* Four partial sums, for the processor's sake. */
                double v[4] = {0.0, 0.0, 0.0, 0.0};
                Int r = c;
                for (; r + 4 <= ld; r += 4)
                    for (int k = 0; k < 4; k++) v[k] += fabs((double)column[r + k]) * w[r + k];
                for (; r < ld; r++) v[0] += fabs((double)column[r]) * w[r];
                double sum = (v[0] + v[1]) + (v[2] + v[3]);
                for (r = c; r < ld; r++) out[r] += fabs((double)column[r]) * sum;
            } else {
                for (Int r = c; r < ld; r++) out[r] += (double)column[r] * (double)column[r];
            }
        }
        Int r = nc;
        for (Int k = 0; k < nc; k++) sums[first + k] += out[k];
        for (Int e = f->begin[s]; e < f->begin[s + 1]; e++)
            for (Int k = f->offset[f->rows[e]]; k < f->offset[f->rows[e] + 1]; k++)
                sums[k] += out[r++];
    }
}

/* Subtract L L^T from the first `count` columns of a lower triangle, for `width` columns of L. */
static inline void IN(subtract)(REAL *restrict to, Int lead, Int count, Int rows,
                                const REAL *restrict L, Int ld, Int width)
{
    Int k = 0;
    for (; k + 4 <= width; k += 4, L += 4 * ld) {
        const REAL *a = L, *b = L + ld, *c = L + 2 * ld, *d = L + 3 * ld;
        for (Int j = 0; j < count; j++) {
            REAL *column = to + j * lead, p = a[j], q = b[j], r = c[j], s = d[j];
            for (Int i = j; i < rows; i++)
                column[i] -= (a[i] * p + b[i] * q) + (c[i] * r + d[i] * s);
        }
    }
    for (; k < width; k++, L += ld)
        for (Int j = 0; j < count; j++) {
            REAL *column = to + j * lead, p = L[j];
            for (Int i = j; i < rows; i++) column[i] -= L[i] * p;
        }
}

/* `eliminate` for fronts in which calls of BLAS would take most of the time. Sums are those of
 * docs/multifrontal.md in another order, and columns are divided by multiplying with a reciprocal. */
static int IN(eliminate_small)(REAL *panel, Int nc, Int ld, REAL *update)
{
    for (Int c = 0; c < nc; c++) {
        REAL *column = panel + c * ld + c;
        IN(subtract)(column, ld, 1, ld - c, panel + c, ld, c);
        if (!(*column > 0 && *column < (REAL)INFINITY)) return 0;
        REAL root = (REAL)sqrt((double)*column), over = 1 / root;
        column[0] = root;
        for (Int i = 1; i < ld - c; i++) column[i] *= over;
    }
    IN(subtract)(update, ld - nc, ld - nc, ld - nc, panel + nc, ld, nc);
    return 1;
}

/* The Cholesky factor of a front's columns, and the update of the rest; 0 if it is not definite. */
static int IN(eliminate)(REAL *panel, Int nc, Int ld, REAL *update)
{
    if (nc * ld * ld <= SMALL) return IN(eliminate_small)(panel, nc, ld, update);
    int columns = (int)nc, rows = (int)(ld - nc), lead = (int)ld, info = 0;
    REAL one = 1, minus = -1;
    IN(potrf)("L", &columns, panel, &lead, &info);
    if (info) return 0;
    for (Int c = 0; c < nc; c++)
        if (!(panel[c * ld + c] > 0 && panel[c * ld + c] < (REAL)INFINITY)) return 0;
    if (rows) {
        IN(trsm)("R", "L", "T", "N", &rows, &columns, &one, panel, &lead, panel + nc, &lead);
        IN(syrk)("L", "N", &rows, &columns, &minus, panel + nc, &lead, &one, update, &rows);
    }
    return 1;
}

/* The runs of consecutive rows of child c in its parent's front, of which none crosses row nc. */
static Int IN(find_runs)(const Fronts *f, Int c, const Int *at, Int nc, Int *run, Int *size)
{
    Int runs = 0;
    *size = 0;
    for (Int e = f->begin[c]; e < f->begin[c + 1]; e++) {
        Int k = f->rows[e], b = f->offset[k + 1] - f->offset[k];
        if (runs && run[3 * runs - 2] + run[3 * runs - 1] == at[k] && at[k] != nc) {
            run[3 * runs - 1] += b;
        } else {
            run[3 * runs] = *size, run[3 * runs + 1] = at[k], run[3 * runs + 2] = b;
            runs++;
        }
        *size += b;
    }
    return runs;
}

/* 1 if A = L L^T was factorized, 0 if it is not positive definite, -1 without memory, -2 if
 * interrupted. Without L, panels are dropped as soon as they are summed, or kept in single precision
 * in `rounded`. A residual is measured in double precision only, where the casts below are none. */
static int IN(factor)(const Fronts *f, const double *data, const double *scale, REAL *L,
                      const Sums *sums, const Residual *residual, float *rounded)
{
    REAL *stack = malloc((size_t)f->stack * sizeof(REAL) + 1);
    REAL *own = L ? NULL : malloc((size_t)f->widest * sizeof(REAL) + 1);
    double *gathered = malloc((size_t)(2 * f->tallest + 1) * sizeof(double));
    Int *at = malloc((size_t)(f->n + 3 * f->tallest + 2 * f->many + 4) * sizeof(Int));
    int outcome = -1;
    Copies copies = {0};
    if (residual && make_copies(f, &copies) < 0) goto done;
    if (!stack || !(L || own) || !gathered || !at) goto done;
    Int *run = at + f->n, *first = run + 3 * f->tallest + 1, *next = first + f->many;
    Int top = 0;
    double patience = PATIENCE;
    for (Int s = 0; s < f->many; s++) first[s] = -1;
    for (Int s = 0; s < f->many; s++) {
        Int nc = width_of(f, s), m = below(f, s), ld = nc + m, row = 0;
        REAL *panel = L ? L + f->panel[s] : own, *update = stack + top, *freed = update;
        for (Int k = f->start[s]; k < f->start[s + 1]; k++)
            at[k] = row, row += f->offset[k + 1] - f->offset[k];
        for (Int e = f->begin[s]; e < f->begin[s + 1]; e++)
            at[f->rows[e]] = row, row += f->offset[f->rows[e] + 1] - f->offset[f->rows[e]];
        memset(panel, 0, (size_t)(nc * ld) * sizeof(REAL));
        memset(update, 0, (size_t)(m * m) * sizeof(REAL));
        IN(assemble)(f, s, data, scale, at, panel, ld);
        if (residual) begin_residual(f, s, residual, &copies);
        /* Children are listed last first: the top of the stack is the last one's. */
        for (Int c = first[s]; c >= 0; c = next[c]) {
            Int size, runs = IN(find_runs)(f, c, at, nc, run, &size);
            freed -= size * size;
            if (residual)
                extend_measured((double *)freed, size, run, runs, (double *)panel, nc, ld,
                                (double *)update, &copies);
            else
                IN(extend)(freed, size, run, runs, panel, nc, ld, update);
        }
        if (residual) {
            memcpy(copies.panel, panel, (size_t)(nc * ld) * sizeof(REAL));
            memcpy(copies.update, update, (size_t)(m * m) * sizeof(REAL));
        }
        if (!IN(eliminate)(panel, nc, ld, update)) {
            outcome = 0;
            goto done;
        }
        if (residual) {
            measure_front((double *)panel, (double *)update, nc, ld, &copies);
            scatter(f, s, copies.out, residual->sums);
        }
        if (rounded)
            for (Int k = 0; k < nc * ld; k++) rounded[f->panel[s] + k] = (float)panel[k];
        if (freed != update) memmove(freed, update, (size_t)(m * m) * sizeof(REAL));
        top = (freed - stack) + m * m;
        if (f->above[s] >= 0) next[s] = first[f->above[s]], first[f->above[s]] = s;
        if (sums->squares) IN(add_sums)(f, s, panel, nc, ld, sums, gathered);
        if (interrupted(&patience, (double)nc * (double)ld * (double)ld)) {
            outcome = -2;
            goto done;
        }
    }
    outcome = 1;
done:
    free_copies(&copies);
    free(stack);
    free(own);
    free(gathered);
    free(at);
    return outcome;
}

/* x := L^-1 x in the rows of supernode s, and what that changes below; `y` is room for work. */
static void IN(forward)(const Fronts *f, Int s, const REAL *panel, Int ld, REAL *x, REAL *y)
{
    Int nc = width_of(f, s), m = ld - nc, r = 0;
    REAL *own = x + f->offset[f->start[s]];
    memset(y, 0, (size_t)m * sizeof(REAL));
    for (Int c = 0; c < nc; c++) {
        const REAL *column = panel + c * ld;
        REAL value = own[c] / column[c];
        own[c] = value;
        for (Int i = c + 1; i < nc; i++) own[i] -= column[i] * value;
        for (Int i = 0; i < m; i++) y[i] += column[nc + i] * value;
    }
    for (Int e = f->begin[s]; e < f->begin[s + 1]; e++)
        for (Int i = f->offset[f->rows[e]]; i < f->offset[f->rows[e] + 1]; i++) x[i] -= y[r++];
}

/* The inner product of a and b (n,), in four sums that do not wait for each other. */
static inline REAL IN(dot)(const REAL *a, const REAL *b, Int n)
{
    REAL v[4] = {0, 0, 0, 0};
    Int i = 0;
    for (; i + 4 <= n; i += 4)
        for (int l = 0; l < 4; l++) v[l] += a[i + l] * b[i + l];
    for (; i < n; i++) v[0] += a[i] * b[i];
    return (v[0] + v[1]) + (v[2] + v[3]);
}

/* x := L^-T x in the rows of supernode s, from what is solved below; `y` is room for work. */
static void IN(backward)(const Fronts *f, Int s, const REAL *panel, Int ld, REAL *x, REAL *y)
{
    Int nc = width_of(f, s), m = ld - nc, r = 0;
    REAL *own = x + f->offset[f->start[s]];
    for (Int e = f->begin[s]; e < f->begin[s + 1]; e++)
        for (Int i = f->offset[f->rows[e]]; i < f->offset[f->rows[e] + 1]; i++) y[r++] = x[i];
    /* The rows below first, in the order of memory, which the processor then reads in advance. */
    for (Int c = 0; c < nc; c++) own[c] -= IN(dot)(panel + c * ld + nc, y, m);
    for (Int c = nc - 1; c >= 0; c--) {
        const REAL *column = panel + c * ld;
        own[c] = (own[c] - IN(dot)(column + c + 1, own + c + 1, nc - c - 1)) / column[c];
    }
}

/* X (k, N) := (L L^T)^-1 X. */
static int IN(substitute)(const Fronts *f, const REAL *L, REAL *X, Int k)
{
    Int N = f->offset[f->n];
    REAL *y = malloc((size_t)(f->tallest + 1) * sizeof(REAL));
    if (!y) return -1;
    for (Int s = 0; s < f->many; s++) {
        Int ld = (f->panel[s + 1] - f->panel[s]) / width_of(f, s);
        for (Int q = 0; q < k; q++) IN(forward)(f, s, L + f->panel[s], ld, X + q * N, y);
    }
    for (Int s = f->many - 1; s >= 0; s--) {
        Int ld = (f->panel[s + 1] - f->panel[s]) / width_of(f, s);
        for (Int q = 0; q < k; q++) IN(backward)(f, s, L + f->panel[s], ld, X + q * N, y);
    }
    free(y);
    return 0;
}

/* X := A^-1 B, both (N, k) in A's order; L is that of A, or of A with rows and columns times `scale`. */
static int IN(solve)(const Fronts *f, const REAL *L, const double *scale, const double *B, double *X,
                     Int k)
{
    Int N = f->offset[f->n], outcome = -1;
    Int *first = malloc((size_t)(f->n + 1 + N) * sizeof(Int)), *row = first + f->n + 1;
    REAL *x = malloc((size_t)(k * N + 1) * sizeof(REAL));
    double *units = malloc((size_t)(k + 1) * sizeof(double));
    if (!first || !x || !units) goto done;
    first_rows(f, first);
    for (Int i = 0; i < f->n; i++)
        for (Int r = f->offset[i]; r < f->offset[i + 1]; r++)
            row[r] = first[f->order[i]] + r - f->offset[i];
    for (Int q = 0; q < k; q++) {
        /* Within the range of any precision. */
        double largest = 0.0;
        int exponent = 0;
        for (Int r = 0; r < N; r++) {
            double size = fabs(B[row[r] * k + q] * (scale ? scale[r] : 1.0));
            if (size > largest) largest = size;
        }
        if (largest < INFINITY) frexp(largest, &exponent);
        units[q] = ldexp(1.0, exponent);
        for (Int r = 0; r < N; r++)
            x[q * N + r] = (REAL)(B[row[r] * k + q] * (scale ? scale[r] : 1.0) / units[q]);
    }
    outcome = IN(substitute)(f, L, x, k);
    for (Int q = 0; q < k && outcome == 0; q++)
        for (Int r = 0; r < N; r++)
            X[row[r] * k + q] = x[q * N + r] * (units[q] * (scale ? scale[r] : 1.0));
done:
    free(first);
    free(x);
    free(units);
    return outcome;
}
