/* Blocks of an inverse on the pattern of a Cholesky factor: `certpgo.linalg.selected_inverse` has the
 * same in NumPy, and says why rounding is bounded in whatever order sums are evaluated. */

/* A factor by columns, in runs of columns with one pattern, and the blocks that are wanted. */
typedef struct {
    Int N, many;
    const Int *indptr, *rows;
    const double *values;
    Int *start;       /* (many + 1,) the first column of each run */
    Int *of;          /* (N,) the run of each column */
    Int *waiting;     /* (many,) runs that need this one's block of the inverse */
    Int *place;       /* (N,) room: a front's rows in that of its parent */
    Int count, q;     /* blocks, and rows of each */
    const Int *at;    /* (count, q) rows, -1 for none */
    const Int *order; /* (count,) blocks by their first rows */
    double *blocks;   /* (count, q, q) */
    int above;        /* whether blocks are to be upper bounds */
} Selection;

/* C (rows x columns) := beta C + alpha A B, or A^T B; alpha is 1 or -1, beta 0 or 1. */
static void product(int transposed, Int rows, Int columns, Int inner, double alpha, const double *A,
                    Int lda, const double *B, Int ldb, double beta, double *C, Int ldc)
{
    int sizes[] = {(int)rows, (int)columns, (int)inner}, leads[] = {(int)lda, (int)ldb, (int)ldc};
    if (inner && rows)
        gemm(transposed ? "T" : "N", "N", &sizes[0], &sizes[1], &sizes[2], &alpha, (double *)A,
             &leads[0], (double *)B, &leads[1], &beta, C, &leads[2]);
}

static double norm(const double *A, Int rows, Int columns, Int lead)
{
    double sum = 0.0;
    for (Int c = 0; c < columns; c++) sum += dot_double(A + c * lead, A + c * lead, rows);
    return sqrt(sum);
}

/* X (k x k) := the inverse of a lower triangle. */
static void invert_triangle(const double *L, Int lead, Int k, double *X)
{
    int size = (int)k, ld = (int)lead;
    double one = 1.0;
    memset(X, 0, (size_t)(k * k) * sizeof(double));
    for (Int c = 0; c < k; c++) X[c * k + c] = 1.0;
    trsm_double("L", "L", "N", "N", &size, &size, &one, (double *)L, &ld, X, &size);
}

/* What is added to the diagonal for the rounding of a front; negative if that is unbounded.
 * See `_round_up` there; `E` is room for k x k numbers. */
static double rounding_of_front(const double *P, const double *X, const double *carried,
                                const double *Z, Int k, Int ld, double *E)
{
    Int m = ld - k;
    double x = norm(X, k, k, k), q = norm(P + k, m, k, ld), c = norm(carried, m, k, m);
    double w = norm(Z + k * ld + k, m, m, ld), unit = ((double)ld + 8.0) * EPS;
    product(0, k, k, k, 1.0, X, k, P, ld, 0.0, E, k);
    for (Int i = 0; i < k; i++) E[i * k + i] = 1.0 - E[i * k + i];
    double e = norm(E, k, k, k) + unit * (x * norm(P, k, k, ld) + 1.0);
    if (!(e < 0.5)) return -1.0;
    double off = 2.0 * e * x, off_carried = q * off + unit * q * x;
    double missed = off * (2.0 * x + off) + off_carried * w * (1.0 + 2.0 * c + off_carried);
    return 1.01 * (missed + 4.0 * unit * (x * x + w * (1.0 + c) * (1.0 + c)));
}

/* The rest of Z (ld x ld), which is known of the rows below; 0 if rounding is unbounded. `work` is
 * room for (2 k + ld) k numbers. */
static int invert_front(const Selection *s, const double *P, double *Z, Int k, Int ld, double *work)
{
    Int m = ld - k;
    double *X = work, *E = X + k * k, *carried = E + k * k, more = 0.0;
    invert_triangle(P, ld, k, X);
    product(0, m, k, k, 1.0, P + k, ld, X, k, 0.0, carried, m);
    product(0, m, k, m, -1.0, Z + k * ld + k, ld, carried, m, 0.0, Z + k, ld);
    product(1, k, k, k, 1.0, X, k, X, k, 0.0, Z, ld);
    product(1, k, k, m, -1.0, carried, m, Z + k, ld, 1.0, Z, ld);
    for (Int c = 0; c < k; c++) {
        for (Int r = c + 1; r < k; r++)
            Z[c * ld + r] = Z[r * ld + c] = 0.5 * (Z[c * ld + r] + Z[r * ld + c]);
        for (Int r = k; r < ld; r++) Z[r * ld + c] = Z[c * ld + r];
    }
    if (s->above && (more = rounding_of_front(P, X, carried, Z, k, ld, E)) < 0.0) return 0;
    for (Int r = 0; s->above && r < ld; r++) Z[r * ld + r] += more;
    return 1;
}

/* Where a row is among those of a run's front; -1 if it is not. */
static Int row_in_front(const Selection *s, Int run, Int row)
{
    Int first = s->start[run], last = s->start[run + 1], low = s->indptr[last - 1] + 1;
    if (row < last) return row >= first ? row - first : -1;
    Int begin = low, end = s->indptr[last], high = end;
    while (low < high) {
        Int middle = low + (high - low) / 2;
        if (s->rows[middle] < row)
            low = middle + 1;
        else
            high = middle;
    }
    return low < end && s->rows[low] == row ? last - first + low - begin : -1;
}

/* The wanted blocks whose first rows are a run's; 0 if one is not in its front. */
static int take_blocks(const Selection *s, Int run, const double *Z, Int ld, Int *left, Int *place)
{
    for (; *left; --*left) {
        Int block = s->order[*left - 1], q = s->q, first = s->N;
        const Int *at = s->at + block * q;
        double *to = s->blocks + block * q * q;
        for (Int i = 0; i < q; i++)
            if (at[i] >= 0 && at[i] < first) first = at[i];
        if (first < s->start[run]) return 1;
        for (Int i = 0; i < q; i++)
            if (at[i] >= 0 && (place[i] = row_in_front(s, run, at[i])) < 0) return 0;
        for (Int i = 0; i < q; i++)
            for (Int j = 0; j < q; j++)
                to[i * q + j] = at[i] < 0 || at[j] < 0 ? 0.0 : Z[place[i] * ld + place[j]];
    }
    return 1;
}

static void find_runs_of_columns(Selection *s)
{
    s->many = 0;
    for (Int c = 0; c < s->N; c++) {
        Int from = s->indptr[c], length = s->indptr[c + 1] - from;
        if (!c || from - s->indptr[c - 1] != length + 1 ||
            memcmp(s->rows + s->indptr[c - 1] + 1, s->rows + from, (size_t)length * sizeof(Int)))
            s->start[s->many++] = c;
        s->of[c] = s->many - 1;
    }
    s->start[s->many] = s->N;
}

/* The run that contains the first row below a run; -1 if there is none. */
static Int parent_of(const Selection *s, Int run)
{
    Int end = s->indptr[s->start[run + 1]], first = s->indptr[s->start[run + 1] - 1] + 1;
    return first < end ? s->of[s->rows[first]] : -1;
}

/* The block of the rows below a run, from its parent's; 0 if that has not all of them. */
static int gather_below(const Selection *s, Int run, const double *from, double *Z, Int k, Int ld)
{
    Int up = parent_of(s, run), wide = s->start[up + 1] - s->start[up], at = wide;
    const Int *below = s->rows + s->indptr[s->start[run + 1] - 1] + 1;
    const Int *other = s->rows + s->indptr[s->start[up + 1] - 1] + 1 - wide;
    Int lead = wide + s->indptr[s->start[up + 1]] - s->indptr[s->start[up + 1] - 1] - 1;
    for (Int r = 0; r < ld - k; r++) {
        if (below[r] < s->start[up + 1]) {
            s->place[r] = below[r] - s->start[up];
            continue;
        }
        while (at < lead && other[at] < below[r]) at++;
        if (at == lead || other[at] != below[r]) return 0;
        s->place[r] = at;
    }
    for (Int c = 0; c < ld - k; c++) {
        const double *column = from + s->place[c] * lead;
        double *to = Z + (k + c) * ld + k;
        for (Int r = 0; r < ld - k; r++) to[r] = column[s->place[r]];
    }
    return 1;
}

/* 1 if all blocks were computed, 0 if rounding cannot be bounded, -1 without memory, -2 if
 * interrupted, -3 if a front or a block has rows that the pattern of another one lacks. */
static int select_blocks(Selection *s)
{
    int outcome = -1;
    Int left = s->count, largest = 0;
    double patience = PATIENCE, *work = NULL, **known = calloc((size_t)s->many + 1, sizeof(double *));
    Int *place = malloc((size_t)(s->q + 1) * sizeof(Int));
    for (Int r = 0; r < s->many; r++) {
        Int k = s->start[r + 1] - s->start[r], up = parent_of(s, r);
        Int ld = s->indptr[s->start[r] + 1] - s->indptr[s->start[r]];
        if ((2 * ld + 2 * k) * k > largest) largest = (2 * ld + 2 * k) * k;
        if (up >= 0) s->waiting[up]++;
    }
    work = malloc((size_t)(largest + 1) * sizeof(double));
    if (!known || !place || !work) goto done;
    for (Int r = s->many - 1; r >= 0; r--) {
        Int first = s->start[r], k = s->start[r + 1] - first, up = parent_of(s, r);
        Int ld = s->indptr[first + 1] - s->indptr[first];
        double *Z = known[r] = malloc((size_t)(ld * ld) * sizeof(double)), *P = work;
        outcome = -1;
        if (!Z) goto done;
        outcome = -3;
        if (up >= 0) {
            if (!gather_below(s, r, known[up], Z, k, ld)) goto done;
            if (!--s->waiting[up]) free(known[up]), known[up] = NULL;
        }
        for (Int c = 0; c < k; c++) {
            memset(P + c * ld, 0, (size_t)c * sizeof(double));
            memcpy(P + c * ld + c, s->values + s->indptr[first + c], (size_t)(ld - c) * sizeof(double));
        }
        outcome = 0;
        if (!invert_front(s, P, Z, k, ld, work + k * ld)) goto done;
        outcome = -3;
        if (!take_blocks(s, r, Z, ld, &left, place)) goto done;
        if (!s->waiting[r]) free(Z), known[r] = NULL;
        outcome = -2;
        if (interrupted(&patience, 2.0 * (double)k * (double)ld * (double)ld)) goto done;
    }
    outcome = 1;
done:
    for (Int r = 0; known && r < s->many; r++) free(known[r]);
    free(known);
    free(place);
    free(work);
    return outcome;
}

/* Whether columns begin on the diagonal and their rows ascend. */
static int is_lower_triangle(Int N, const Int *indptr, const Int *rows)
{
    for (Int c = 0; c < N; c++) {
        if (indptr[c] == indptr[c + 1] || rows[indptr[c]] != c) return 0;
        for (Int e = indptr[c] + 1; e < indptr[c + 1]; e++)
            if (rows[e] <= rows[e - 1] || rows[e] >= N) return 0;
    }
    return 1;
}

/* inverse_blocks(indptr, indices, L, at, order, above, blocks) -> True; False if rounding cannot be
 * bounded; None if the pattern is not closed under fill, or lacks rows of a block */
static PyObject *inverse_blocks_of(Held *held, PyObject *args)
{
    Array indptr = {held, INTS}, rows = {held, INTS}, values = {held, DOUBLES}, at = {held, INTS};
    Array order = {held, INTS}, blocks = {held, DOUBLES, WRITTEN};
    int above, outcome;
    if (!PyArg_ParseTuple(args, "O&O&O&O&O&pO&", array, &indptr, array, &rows, array, &values, array,
                          &at, array, &order, &above, array, &blocks))
        return NULL;
    Int N = indptr.length - 1, count = order.length, q = count ? at.length / count : 0;
    if (N < 0 || N > INT32_MAX || !are_pointers(indptr.at, N + 1, rows.length) || values.length != rows.length ||
        !is_lower_triangle(N, indptr.at, rows.at))
        return refuse("a lower triangle by sorted columns expected");
    if (at.length != count * q || blocks.length != count * q * q || !all_below(order.at, count, count))
        return refuse("as many blocks as orders expected");
    for (Int i = 0; i < count * q; i++)
        if (((Int *)at.at)[i] >= N) return refuse("a row out of range");
    Int *room = memory(held, 4 * N + 1, sizeof(Int));
    if (!room) return NULL;
    memset(room + 2 * N + 1, 0, (size_t)N * sizeof(Int));
    Selection s = {.N = N, .indptr = indptr.at, .rows = rows.at, .values = values.at, .start = room,
                   .of = room + N + 1, .waiting = room + 2 * N + 1, .place = room + 3 * N + 1,
                   .count = count, .q = q, .at = at.at, .order = order.at, .blocks = blocks.at,
                   .above = above};
    Py_BEGIN_ALLOW_THREADS
    find_runs_of_columns(&s);
    outcome = select_blocks(&s);
    Py_END_ALLOW_THREADS
    if (outcome == -1) return PyErr_NoMemory();
    if (outcome == -2) return NULL;
    return outcome < 0 ? Py_NewRef(Py_None) : PyBool_FromLong(outcome);
}
CALL(inverse_blocks)
