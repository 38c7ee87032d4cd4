/* The residual of a Cholesky factorization, measured front by front.
 *
 * What a front passes on and what it keeps differ from what it was assembled from by E, and the sum
 * of all E is A - L L^T, but for the rounding of the assembly, which is measured too. Rows are
 * scaled by powers of two, so that those of L have norms of about one. With L = L1 + L2 and L1 in
 * multiples of 2^-24, products of L1 and their sums are multiples of 2^-48 below 2^5: no sum of
 * them is rounded, in any order. Products with L2 are 2^-24 as large, and so is their rounding.
 */

/* Columns of E that are computed at once, and the unit of L1. */
enum { STRIPE = 128 };
#define UNIT 16777216.0
#define EPS 1.1102230246251565e-16

typedef struct {
    const double *scale; /* (N,) powers of two */
    const double *v;     /* (N,) weights over scale */
    double *sums;        /* (N,) bounds on the row sums of |E| v, in the same units */
} Residual;

typedef struct {
    double *panel, *update;         /* what the front was assembled from */
    double *whole, *high, *low;     /* the scaled panel and its parts */
    double *exact, *cross;          /* products of STRIPE columns */
    double *scale, *v, *out, *tops; /* of the front's rows, and sums of its columns */
} Copies;

static void (*gemm)(char *, char *, int *, int *, int *, double *, double *, int *, double *, int *,
                    double *, double *, int *);

static void free_copies(Copies *c)
{
    free(c->panel);
    free(c->update);
    free(c->exact);
}

static int make_copies(const Fronts *f, Copies *c)
{
    Int w = f->widest, t = f->tallest, updates = 0;
    for (Int s = 0; s < f->many; s++) {
        Int m = below(f, s);
        if (m * m > updates) updates = m * m;
    }
    c->panel = malloc((size_t)(4 * w + 1) * sizeof(double));
    c->update = malloc((size_t)(updates + 1) * sizeof(double));
    c->exact = malloc((size_t)(2 * t * STRIPE + 5 * t + 1) * sizeof(double));
    if (!c->panel || !c->update || !c->exact) return -1;
    c->whole = c->panel + w, c->high = c->panel + 2 * w, c->low = c->panel + 3 * w;
    c->cross = c->exact + t * STRIPE, c->scale = c->cross + t * STRIPE;
    c->v = c->scale + t, c->out = c->scale + 2 * t, c->tops = c->scale + 3 * t;
    return 0;
}

/* Rows of a front, gathered from (N,) values. */
static void gather(const Fronts *f, Int s, const double *from, double *to)
{
    Int r = 0;
    for (Int k = f->offset[f->start[s]]; k < f->offset[f->start[s + 1]]; k++) to[r++] = from[k];
    for (Int e = f->begin[s]; e < f->begin[s + 1]; e++)
        for (Int k = f->offset[f->rows[e]]; k < f->offset[f->rows[e] + 1]; k++) to[r++] = from[k];
}

static void scatter(const Fronts *f, Int s, const double *from, double *to)
{
    Int r = 0;
    for (Int k = f->offset[f->start[s]]; k < f->offset[f->start[s + 1]]; k++) to[k] += from[r++];
    for (Int e = f->begin[s]; e < f->begin[s + 1]; e++)
        for (Int k = f->offset[f->rows[e]]; k < f->offset[f->rows[e] + 1]; k++) to[k] += from[r++];
}

static void begin_residual(const Fronts *f, Int s, const Residual *residual, const Copies *c)
{
    gather(f, s, residual->scale, c->scale);
    gather(f, s, residual->v, c->v);
    memset(c->out, 0, (size_t)f->tallest * sizeof(double));
}

/* The rounding of to += from, exactly (Knuth's TwoSum), and the sum. */
static inline double add_to(double *to, double from)
{
    double a = *to, s = a + from, b = s - a;
    *to = s;
    return (a - (s - b)) + (from - b);
}

/* Like `extend`; the rounding of the additions goes to the front's row sums. */
static void extend_measured(const double *update, Int m, const Int *run, Int runs, double *panel,
                            Int nc, Int ld, double *above, const Copies *copies)
{
    const double *scale = copies->scale, *v = copies->v;
    double *out = copies->out;
    for (Int a = 0; a < runs; a++)
        for (Int c = 0; c < run[3 * a + 2]; c++) {
            Int column = run[3 * a] + c, to = run[3 * a + 1] + c;
            const double *from = update + column * m;
            double *into = to < nc ? panel + to * ld : above + (to - nc) * (ld - nc) - nc, own = 0.0;
            for (Int b = a; b < runs; b++)
                for (Int r = b == a ? c : 0; r < run[3 * b + 2]; r++) {
                    Int row = run[3 * b + 1] + r;
                    double error = fabs(add_to(into + row, from[run[3 * b] + r]));
                    error *= scale[row] * scale[to];
                    if (row != to) out[row] += error * v[to];
                    own += error * v[row];
                }
            out[to] += own;
        }
}

/* Add |E| v of an eliminated front to `out`. */
static void measure_front(const double *panel, const double *update, Int nc, Int ld,
                          const Copies *copies)
{
    const double *scale = copies->scale, *v = copies->v;
    double *out = copies->out, *tops = copies->tops, one = 1.0, zero = 0.0;
    Int m = ld - nc;
    int lead = (int)ld;
    for (Int c = 0; c < nc; c++) {
        double high = 0.0, low = 0.0;
        for (Int r = 0; r < ld; r++) {
            Int k = c * ld + r;
            double x = r < c ? 0.0 : panel[k] * scale[r], h = rint(x * UNIT) / UNIT;
            copies->whole[k] = x, copies->high[k] = h, copies->low[k] = x - h;
            high += fabs(h) * v[r];
            low += fabs(x - h) * v[r];
        }
        tops[2 * c] = high, tops[2 * c + 1] = low;
    }
    /* The rounding of the products with L2. */
    for (Int c = 0; c < nc; c++)
        for (Int r = c; r < ld; r++) {
            Int k = c * ld + r;
            out[r] += 2.0 * ((double)nc + 8.0) * EPS *
                      (fabs(copies->high[k]) * tops[2 * c + 1] +
                       fabs(copies->low[k]) * (tops[2 * c] + tops[2 * c + 1]));
        }
    for (Int first = 0; first < ld; first += STRIPE) {
        Int last = first + STRIPE < ld ? first + STRIPE : ld;
        int rows = (int)(ld - first), columns = (int)(last - first);
        int inner = (int)(last < nc ? last : nc);
        gemm("N", "T", &rows, &columns, &inner, &one, copies->high + first, &lead,
             copies->high + first, &lead, &zero, copies->exact, &rows);
        gemm("N", "T", &rows, &columns, &inner, &one, copies->high + first, &lead,
             copies->low + first, &lead, &zero, copies->cross, &rows);
        gemm("N", "T", &rows, &columns, &inner, &one, copies->low + first, &lead,
             copies->whole + first, &lead, &one, copies->cross, &rows);
        for (Int c = first; c < last; c++) {
            const double *exact = copies->exact + (c - first) * rows - first;
            const double *cross = copies->cross + (c - first) * rows - first;
            const double *before = c < nc ? copies->panel + c * ld
                                          : copies->update + (c - nc) * m - nc;
            const double *after = c < nc ? NULL : update + (c - nc) * m - nc;
            double own = 0.0, vc = v[c];
            for (Int r = c; r < ld; r++) {
                double unit = scale[r] * scale[c], left = before[r] * unit, lost = 0.0;
                if (after) lost = add_to(&left, -after[r] * unit);
                double rest = left - exact[r], small = lost - cross[r];
                double size = fabs(rest + small) +
                              4.0 * EPS * (fabs(rest) + fabs(lost) + fabs(cross[r]));
                if (r != c) out[r] += size * vc;
                own += size * v[r];
            }
            out[c] += own;
        }
    }
}
