/* Sparse matrices of blocks: `certpgo.linalg.blocks` has the same in NumPy. */

/* An end of entry k of a list of nodes, edges and reversed edges: its row, or its column. */
static Int end_of(Int n, Int m, const Int *pairs, Int k, int column)
{
    if (k < n) return k;
    int back = k >= n + m;
    return pairs[2 * (k - n - (back ? m : 0)) + (back != column)];
}

/* The occupied blocks of a graph's matrices by rows, columns ascending, and in `slots` (n + 2 m) the
 * block of each entry of that list; returns their number. `work` has room for 2 (n + 2 m) + n + 1. */
static Int find_blocks(Int n, Int m, const Int *pairs, Int *indptr, Int *indices, Int *slots, Int *work)
{
    Int all = n + 2 * m, *by_column = work, *sorted = work + all, *next = sorted + all, blocks = 0;
    for (int column = 1; column >= 0; column--) {
        Int *to = column ? by_column : sorted;
        memset(next, 0, (size_t)(n + 1) * sizeof(Int));
        for (Int k = 0; k < all; k++) next[end_of(n, m, pairs, k, column) + 1]++;
        for (Int i = 0; i < n; i++) next[i + 1] += next[i];
        for (Int q = 0; q < all; q++) {
            Int k = column ? q : by_column[q];
            to[next[end_of(n, m, pairs, k, column)]++] = k;
        }
    }
    indptr[0] = 0;
    for (Int q = 0, row = -1, column = -1; q < all; q++) {
        Int i = end_of(n, m, pairs, sorted[q], 0), j = end_of(n, m, pairs, sorted[q], 1);
        if (i != row || j != column) indices[blocks++] = j;
        row = i, column = j;
        slots[sorted[q]] = blocks - 1;
        indptr[i + 1] = blocks;
    }
    return blocks;
}

/* Whether so many blocks of b x b have that many entries, for any b. */
static int are_blocks(Int count, Int b, Int entries)
{
    return b > 0 && entries % (b * b) == 0 && entries / (b * b) == count;
}

/* Whether each block's place is in its node's column. */
static int are_places(Int n, Int m, const Int *indptr, const Int *own, const Int *slots,
                      const Int *pairs)
{
    if (!all_below(pairs, 2 * m, n)) return 0;
    for (Int i = 0; i < n; i++)
        if (own[i] < indptr[i] || own[i] >= indptr[i + 1]) return 0;
    for (Int e = 0; e < m; e++)
        for (int back = 0; back < 2; back++) {
            Int i = pairs[2 * e + back], at = slots[back * m + e];
            if (at < indptr[i] || at >= indptr[i + 1]) return 0;
        }
    return 1;
}

/* Blocks into a matrix in compressed columns; those of parallel edges are added. */
static void place_blocks(Int n, Int m, Int b, const Int *indptr, const Int *own, const Int *slots,
                         const Int *pairs, const double *diagonal, const double *upper, double *data)
{
    for (Int i = 0; i < n; i++) {
        Int height = b * (indptr[i + 1] - indptr[i]);
        double *to = data + b * b * indptr[i] + b * (own[i] - indptr[i]);
        for (Int c = 0; c < b; c++)
            memcpy(to + c * height, diagonal + (i * b + c) * b, (size_t)b * sizeof(double));
    }
    for (Int e = 0; e < m; e++) {
        const double *block = upper + e * b * b;
        for (int back = 0; back < 2; back++) {
            Int i = pairs[2 * e + back], height = b * (indptr[i + 1] - indptr[i]);
            double *to = data + b * b * indptr[i] + b * (slots[back * m + e] - indptr[i]);
            for (Int c = 0; c < b; c++)
                for (Int r = 0; r < b; r++)
                    to[c * height + r] += back ? block[r * b + c] : block[c * b + r];
        }
    }
}

/* blocks(pairs, indptr, indices, slots) -> how many: see `certpgo.linalg.blocks.BlockPattern` */
static PyObject *blocks_of(Held *held, PyObject *args)
{
    Array pairs = {held, INTS}, indptr = {held, INTS, WRITTEN}, indices = indptr, slots = indptr;
    if (!PyArg_ParseTuple(args, "O&O&O&O&", array, &pairs, array, &indptr, array, &indices, array,
                          &slots))
        return NULL;
    Int n = indptr.length - 1, m = pairs.length / 2, all = n + 2 * m;
    if (n < 0 || pairs.length != 2 * m || indices.length != all || slots.length != all ||
        !all_below(pairs.at, 2 * m, n))
        return refuse("pairs of other nodes");
    Int *work = memory(held, 2 * all + n + 1, sizeof(Int));
    if (!work) return NULL;
    return PyLong_FromLongLong(
        find_blocks(n, m, pairs.at, indptr.at, indices.at, slots.at, work));
}
CALL(blocks)

/* assemble((indptr, own, slots, pairs), diagonal, upper, data): data, zero before, is written */
static PyObject *assemble_of(Held *held, PyObject *args)
{
    Array a[7];
    for (int k = 0; k < 7; k++) a[k] = (Array){held, k < 4 ? INTS : DOUBLES, k == 6 ? WRITTEN : READ};
    if (!PyArg_ParseTuple(args, "(O&O&O&O&)O&O&O&", array, &a[0], array, &a[1], array, &a[2],
                          array, &a[3], array, &a[4], array, &a[5], array, &a[6]))
        return NULL;
    Int n = a[1].length, m = a[3].length / 2, b = 1;
    while (n && b * b * n < a[4].length) b++;
    const Int *indptr = a[0].at;
    if (a[0].length != n + 1 || !are_pointers(indptr, n + 1, indptr[n]) || a[2].length != 2 * m ||
        a[4].length != n * b * b || a[5].length != m * b * b || a[6].length != indptr[n] * b * b ||
        !are_places(n, m, indptr, a[1].at, a[2].at, a[3].at))
        return refuse("blocks of another pattern");
    Py_BEGIN_ALLOW_THREADS
    place_blocks(n, m, b, indptr, a[1].at, a[2].at, a[3].at, a[4].at, a[5].at, a[6].at);
    Py_END_ALLOW_THREADS
    return Py_NewRef(Py_None);
}
CALL(assemble)

/* subtract(indptr, own, b, values, d, data): blocks (n, d, d) from the last rows and columns of the
 * diagonal blocks of a matrix of b x b blocks */
static PyObject *subtract_of(Held *held, PyObject *args)
{
    Array pointers = {held, INTS}, slots = {held, INTS}, values = {held, DOUBLES};
    Array into = {held, DOUBLES, WRITTEN};
    int b, d;
    if (!PyArg_ParseTuple(args, "O&O&iO&iO&", array, &pointers, array, &slots, &b, array, &values, &d,
                          array, &into))
        return NULL;
    Int n = slots.length;
    const Int *indptr = pointers.at, *own = slots.at;
    if (d < 1 || b < d || pointers.length != n + 1 || !are_pointers(indptr, n + 1, indptr[n]) ||
        !are_blocks(indptr[n], b, into.length) || values.length != n * d * d ||
        !are_places(n, 0, indptr, own, NULL, NULL))
        return refuse("blocks of another pattern");
    for (Int i = 0; i < n; i++) {
        const double *from = (const double *)values.at + i * d * d;
        Int height = b * (indptr[i + 1] - indptr[i]);
        double *to = (double *)into.at + b * b * indptr[i] + b * (own[i] - indptr[i]) +
                     (b - d) * (height + 1);
        for (Int c = 0; c < d; c++)
            for (Int r = 0; r < d; r++) to[c * height + r] -= from[c * d + r];
    }
    return Py_NewRef(Py_None);
}
CALL(subtract)

/* expand(indptr, indices, b, rows): the rows (32 bits) of a matrix of b x b blocks */
static PyObject *expand_of(Held *held, PyObject *args)
{
    Array pointers = {held, INTS}, blocks = {held, INTS}, into = {held, SHORT_INTS, WRITTEN};
    int b;
    if (!PyArg_ParseTuple(args, "O&O&iO&", array, &pointers, array, &blocks, &b, array, &into))
        return NULL;
    const Int *indptr = pointers.at, *indices = blocks.at;
    int32_t *rows = into.at;
    Int n = pointers.length - 1;
    if (!are_pointers(indptr, n + 1, blocks.length) || !are_blocks(blocks.length, b, into.length) ||
        n > INT32_MAX / b || !all_below(indices, blocks.length, n))
        return refuse("rows of another pattern");
    for (Int i = 0; i < n; i++)
        for (Int c = 0; c < b; c++)
            for (Int e = indptr[i]; e < indptr[i + 1]; e++)
                for (Int r = 0; r < b; r++) *rows++ = (int32_t)(indices[e] * b + r);
    return Py_NewRef(Py_None);
}
CALL(expand)

/* Where the entry of a row is among those of a column, whose rows ascend; -1 if there is none. */
static Int place_of(const int32_t *indptr, const int32_t *rows, Int row, Int column)
{
    Int low = indptr[column], high = indptr[column + 1];
    while (low < high) {
        Int middle = low + (high - low) / 2;
        if (rows[middle] < row)
            low = middle + 1;
        else
            high = middle;
    }
    return low < indptr[column + 1] && rows[low] == row ? low : -1;
}

/* diagonal_places(indptr, indices, places): where the diagonal is, in sorted columns of 32 bits */
static PyObject *diagonal_places_of(Held *held, PyObject *args)
{
    Array pointers = {held, SHORT_INTS}, entries = {held, SHORT_INTS}, into = {held, INTS, WRITTEN};
    if (!PyArg_ParseTuple(args, "O&O&O&", array, &pointers, array, &entries, array, &into))
        return NULL;
    const int32_t *indptr = pointers.at, *rows = entries.at;
    Int size = into.length, *places = into.at;
    if (pointers.length != size + 1 || indptr[size] != entries.length)
        return refuse("pointers of another matrix");
    for (Int column = 0; column < size; column++) {
        if (indptr[column] < 0 || indptr[column] > indptr[column + 1] ||
            indptr[column + 1] > entries.length)
            return refuse("pointers of another matrix");
        places[column] = place_of(indptr, rows, column, column);
        if (places[column] < 0) return refuse("a diagonal entry is not stored");
    }
    return Py_NewRef(Py_None);
}
CALL(diagonal_places)

/* pin(indptr, indices, data, rows): zeros in these rows and columns, but on the diagonal, of a symmetric
 * matrix in sorted columns of 32 bits */
static PyObject *pin_of(Held *held, PyObject *args)
{
    Array pointers = {held, SHORT_INTS}, entries = {held, SHORT_INTS};
    Array data = {held, DOUBLES, WRITTEN}, pinned = {held, INTS};
    if (!PyArg_ParseTuple(args, "O&O&O&O&", array, &pointers, array, &entries, array, &data, array,
                          &pinned))
        return NULL;
    const int32_t *indptr = pointers.at, *indices = entries.at;
    const Int *rows = pinned.at;
    Int n = pointers.length - 1;
    double *values = data.at;
    if (data.length != entries.length || n < 0 || !all_below(rows, pinned.length, n))
        return refuse("entries or rows of another matrix");
    for (Int i = 0; i < n; i++)
        if (indptr[i] < 0 || indptr[i] > indptr[i + 1] || indptr[i + 1] > entries.length)
            return refuse("pointers of another matrix");
    for (Int k = 0; k < pinned.length; k++)
        for (Int e = indptr[rows[k]]; e < indptr[rows[k] + 1]; e++) {
            Int i = indices[e], mirrored;
            if (i == rows[k]) continue;
            if (i < 0 || i >= n || (mirrored = place_of(indptr, indices, rows[k], i)) < 0)
                return refuse("a symmetric pattern with ascending rows expected");
            values[e] = values[mirrored] = 0.0;
        }
    return Py_NewRef(Py_None);
}
CALL(pin)

/* scatter_sum(index, values, sums): rows of values are added to rows of sums */
static PyObject *scatter_sum_of(Held *held, PyObject *args)
{
    Array rows = {held, INTS}, from = {held, DOUBLES}, into = {held, DOUBLES, WRITTEN};
    int columns;
    if (!PyArg_ParseTuple(args, "O&O&O&i", array, &rows, array, &from, array, &into, &columns))
        return NULL;
    if (columns < 1 || from.length != rows.length * columns || into.length % columns)
        return refuse("as many rows as indices expected");
    if (!all_below(rows.at, rows.length, into.length / columns)) {
        PyErr_SetString(PyExc_IndexError, "a row out of range");
        return NULL;
    }
    const Int *index = rows.at;
    const double *values = from.at;
    double *sums = into.at;
    Py_BEGIN_ALLOW_THREADS
    for (Int e = 0; e < rows.length; e++)
        for (Int k = 0; k < columns; k++) sums[index[e] * columns + k] += values[e * columns + k];
    Py_END_ALLOW_THREADS
    return Py_NewRef(Py_None);
}
CALL(scatter_sum)
