/* Multifrontal Cholesky factorization of sparse symmetric block matrices.
 *
 * Duff and Reid, "The multifrontal solution of indefinite sparse symmetric linear equations" (1983),
 * for definite matrices; Liu, "The multifrontal method for sparse matrix solution" (1992). The
 * analysis is of the graph of nodes, and serves every size of the nodes' blocks. Dense work is done
 * by SciPy's BLAS and LAPACK, whose functions are found at import.
 *
 * All arrays belong to NumPy. Integers have 64 bits; nodes are numbered in elimination order unless
 * said otherwise. `certpgo.linalg.multifrontal` has the calls and their documentation.
 */

#define PY_SSIZE_T_CLEAN
#ifndef Py_LIMITED_API
#define Py_LIMITED_API 0x030B0000
#endif
#include <Python.h>
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

typedef int64_t Int;

#ifdef _MSC_VER
#define restrict __restrict /* its C is C89 with most of C99, but not this word */
#endif

/* Multiplications between two looks for Ctrl-C: about a second. */
#define PATIENCE 2e9
/* Multiplications up to which a front is eliminated without BLAS. */
#define SMALL 20000

#include "calls.h"

/* --------------------------------------------------------------- analysis */

#include "analysis.h"
#include "ordering.h"

/* Whether the nodes' neighbours ascend and are mutual; else refused. */
static int is_symmetric(Held *held, Int n, const Int *indptr, const Int *indices)
{
    Int *next = memory(held, n, sizeof(Int));
    if (!next) return 0;
    memcpy(next, indptr, (size_t)n * sizeof(Int));
    for (Int i = 0; i < n; i++)
        for (Int e = indptr[i]; e < indptr[i + 1]; e++) {
            Int j = indices[e];
            if (next[j] >= indptr[j + 1] || indices[next[j]] != i)
                return refuse("a pattern is symmetric, with ascending neighbours") != NULL;
            next[j]++;
        }
    return 1;
}

static PyObject *analyze_of(Held *held, PyObject *args)
{
    Array pointers = {held, INTS}, neighbours = {held, INTS}, sizes = {held, INTS}, given = sizes;
    if (!PyArg_ParseTuple(args, "O&O&O&O&", array, &pointers, array, &neighbours, array, &given,
                          array, &sizes))
        return NULL;
    const Int *indptr = pointers.at, *indices = neighbours.at, *before = given.at;
    Int n = given.length;
    if (pointers.length != n + 1 || sizes.length != n ||
        !are_pointers(indptr, n + 1, neighbours.length) ||
        !all_below(indices, neighbours.length, n) || !all_below(before, n, n))
        return refuse("not a pattern of as many nodes as order and sizes have");
    if (!are_sizes(sizes.at, n) || !is_symmetric(held, n, indptr, indices)) return NULL;
    Int *order = memory(held, 16 * n + 16, sizeof(Int)), *rows = NULL;
    if (!order) return NULL;
    Int *place = order + n, *parent = order + 2 * n, *columns = order + 3 * n;
    Int *counts = order + 4 * n, *start = order + 5 * n, *of = order + 6 * n + 2;
    Int *above = order + 7 * n + 2, *begin = order + 8 * n + 2, *scratch = order + 9 * n + 4;
    Int many = 0;
    for (Int k = 0; k < n; k++) place[k] = -1;
    for (Int k = 0; k < n; k++) place[before[k]] = k;
    for (Int k = 0; k < n; k++)
        if (place[k] < 0) return refuse("an order contains each node once");
    Py_BEGIN_ALLOW_THREADS
    memcpy(order, before, (size_t)n * sizeof(Int));
    elimination_tree(n, indptr, indices, order, place, parent, scratch);
    postorder(n, order, place, parent, scratch, scratch + n, scratch + 2 * n);
    count(n, indptr, indices, order, place, parent, sizes.at, columns, counts, scratch);
    many = supernodes(n, parent, columns, start, of, scratch);
    rows = structure(n, indptr, indices, order, place, many, start, of, above, begin, scratch);
    Py_END_ALLOW_THREADS
    if (!rows) return PyErr_NoMemory();
    held->blocks[held->many++] = rows;
    return Py_BuildValue("NNNNNN", bytes_of(order, n), bytes_of(counts, n),
                         bytes_of(start, many + 1), bytes_of(above, many),
                         bytes_of(begin, many + 1), bytes_of(rows, begin[many]));
}
CALL(analyze)

/* order(indptr, indices) -> bytes of a fill-reducing order */
static PyObject *order_of(Held *held, PyObject *args)
{
    Array pointers = {held, INTS}, neighbours = {held, INTS};
    if (!PyArg_ParseTuple(args, "O&O&", array, &pointers, array, &neighbours)) return NULL;
    Int n = pointers.length - 1, outcome;
    if (!are_pointers(pointers.at, n + 1, neighbours.length) ||
        !all_below(neighbours.at, neighbours.length, n))
        return refuse("not a pattern");
    if (!is_symmetric(held, n, pointers.at, neighbours.at)) return NULL;
    Int *found_order = memory(held, n, sizeof(Int));
    if (!found_order) return NULL;
    Py_BEGIN_ALLOW_THREADS
    outcome = minimum_degree(n, pointers.at, neighbours.at, found_order);
    Py_END_ALLOW_THREADS
    return outcome < 0 ? PyErr_NoMemory() : bytes_of(found_order, n);
}
CALL(order)

/* ----------------------------------------------------------------- fronts */

/* The tree of fronts of a matrix: see `certpgo.linalg.multifrontal.Fronts`. */
typedef struct {
    Int n, many;            /* nodes, supernodes */
    const Int *indptr;      /* (n + 1,) the pattern in A's own numbering of nodes */
    const Int *indices;     /* neighbours of each node, itself included, ascending */
    const Int *entry;       /* (n + 1,) where each node's columns begin in A's data */
    const Int *order;       /* (n,) A's number of each node */
    const Int *place;       /* (n,) inverse */
    const Int *sizes;       /* (n,) rows of each node of A */
    const Int *offset;      /* (n + 1,) first row of each node of L */
    const Int *start;       /* (many + 1,) first node of each supernode */
    const Int *above;       /* (many,) parent of each supernode, or -1 */
    const Int *begin;       /* (many + 1,) where the rows of each supernode begin */
    const Int *rows;        /* nodes below each supernode */
    const Int *panel;       /* (many + 1,) where each supernode's columns of L begin */
    Int stack, widest, tallest; /* entries of the stack of updates, of a panel; rows of a front */
} Fronts;

static Int below(const Fronts *f, Int s)
{
    Int m = 0;
    for (Int e = f->begin[s]; e < f->begin[s + 1]; e++)
        m += f->offset[f->rows[e] + 1] - f->offset[f->rows[e]];
    return m;
}

static Int width_of(const Fronts *f, Int s)
{
    return f->offset[f->start[s + 1]] - f->offset[f->start[s]];
}

/* The first row of each node (n + 1,) in A's numbering. */
static void first_rows(const Fronts *f, Int *first)
{
    first[0] = 0;
    for (Int i = 0; i < f->n; i++) first[i + 1] = first[i] + f->sizes[i];
}

/* Entries of the stack of updates at most, so that bytes are counted in 64 bits, too. */
#define MOST ((Int)1 << 56)

/* Whether the nodes' neighbours are nodes and ascend. */
static int is_pattern(Int n, const Int *indptr, Py_ssize_t length, const Int *indices,
                      Py_ssize_t entries)
{
    if (length != n + 1 || !are_pointers(indptr, length, entries) || !all_below(indices, entries, n))
        return 0;
    for (Int i = 0; i < n; i++)
        for (Int e = indptr[i] + 1; e < indptr[i + 1]; e++)
            if (indices[e] <= indices[e - 1]) return 0;
    return 1;
}

/* Whether supernodes contain all nodes, each with later supernodes' nodes below it, ascending, and
 * with a later parent or none. */
static int are_supernodes(const Fronts *f, Py_ssize_t rows)
{
    if (!are_pointers(f->start, f->many + 1, f->n) || !are_pointers(f->begin, f->many + 1, rows))
        return 0;
    for (Int s = 0; s < f->many; s++) {
        Int last = f->start[s + 1] - 1, up = f->above[s];
        if (last < f->start[s] || (up != -1 && (up <= s || up >= f->many))) return 0;
        for (Int e = f->begin[s]; e < f->begin[s + 1]; last = f->rows[e++])
            if (f->rows[e] <= last || f->rows[e] >= f->n) return 0;
    }
    return 1;
}

/* measure(indptr, indices, order, sizes, start, above, begin, rows, place, offset, entry, panel): the
 * last four are written -> the memory that updates and panels need */
static PyObject *measure_of(Held *held, PyObject *args)
{
    Array a[12];
    for (int k = 0; k < 12; k++) a[k] = (Array){held, INTS, k < 8 ? READ : WRITTEN};
    if (!PyArg_ParseTuple(args, "O&O&O&O&O&O&O&O&O&O&O&O&", array, &a[0], array, &a[1], array, &a[2],
                          array, &a[3], array, &a[4], array, &a[5], array, &a[6], array, &a[7], array,
                          &a[8], array, &a[9], array, &a[10], array, &a[11]))
        return NULL;
    Int n = a[2].length, many = a[5].length;
    Int *place = a[8].at, *offset = a[9].at, *entry = a[10].at, *panel = a[11].at;
    Fronts f = {.n = n, .many = many, .indptr = a[0].at, .indices = a[1].at, .order = a[2].at,
                .sizes = a[3].at, .offset = offset, .start = a[4].at, .above = a[5].at,
                .begin = a[6].at, .rows = a[7].at};
    if (!are_sizes(f.sizes, a[3].length)) return NULL;
    if (a[3].length != n || a[8].length != n || a[9].length != n + 1 || a[10].length != n + 1 ||
        a[4].length != many + 1 || a[6].length != many + 1 || a[11].length != many + 1 ||
        !is_pattern(n, f.indptr, a[0].length, f.indices, a[1].length) ||
        !all_below(f.order, n, n) || !are_supernodes(&f, a[7].length))
        return refuse("not a tree of fronts");
    Int *freed = memory(held, many, sizeof(Int));
    Int stack = 0, top = 0, widest = 0, tallest = 0;
    if (!freed) return NULL;
    memset(freed, 0, (size_t)many * sizeof(Int));
    panel[0] = offset[0] = entry[0] = 0;
    for (Int k = 0; k < n; k++) {
        Int height = 0;
        place[f.order[k]] = k;
        offset[k + 1] = offset[k] + f.sizes[f.order[k]];
        for (Int e = f.indptr[k]; e < f.indptr[k + 1]; e++) height += f.sizes[f.indices[e]];
        entry[k + 1] = entry[k] + height * f.sizes[k];
    }
    for (Int s = 0; s < many; s++) {
        Int m = below(&f, s), nc = width_of(&f, s);
        panel[s + 1] = panel[s] + nc * (nc + m);
        if (nc * (nc + m) > widest) widest = nc * (nc + m);
        if (nc + m > tallest) tallest = nc + m;
        if (nc * (nc + m) > MOST || m * m > MOST - top)
            return refuse("a matrix too large for its tree of fronts");
        if (top + m * m > stack) stack = top + m * m;
        top += m * m - freed[s];
        if (f.above[s] >= 0) freed[f.above[s]] += m * m;
    }
    return Py_BuildValue("LLL", (long long)stack, (long long)widest, (long long)tallest);
}
CALL(measure)

/* What a factorization computes besides L; each may be NULL. */
typedef struct {
    Int columns;          /* number of weight vectors */
    const double *weight; /* (columns, N) weights, in the order of L's rows */
    double *sums;         /* (columns, N) |L| |L|^T weight */
    double *squares;      /* (N,) squared norms of L's rows */
} Sums;

static int interrupted(double *patience, double work)
{
    if ((*patience -= work) > 0.0) return 0;
    *patience = PATIENCE;
    PyGILState_STATE state = PyGILState_Ensure();
    int stop = PyErr_CheckSignals() < 0;
    PyGILState_Release(state);
    return stop;
}

/* A function of SciPy whose arguments are as declared here: its integers may have 64 bits. */
static void *found(const char *module, const char *name)
{
    PyObject *library = PyImport_ImportModule(module);
    PyObject *functions = library ? PyObject_GetAttrString(library, "__pyx_capi__") : NULL;
    PyObject *capsule = functions ? PyMapping_GetItemString(functions, name) : NULL;
    const char *signature = capsule ? PyCapsule_GetName(capsule) : NULL;
    void *pointer = NULL;
    if (signature && !strstr(signature, ", int *"))
        PyErr_Format(PyExc_ImportError, "%s of %s takes %s", name, module, signature);
    else if (signature)
        pointer = PyCapsule_GetPointer(capsule, signature);
    Py_XDECREF(capsule);
    Py_XDECREF(functions);
    Py_XDECREF(library);
    return pointer;
}

#include "residual.h"

#define REAL double
#define IN(name) name##_double
#define LETTER "d"
#include "fronts.h"
#undef REAL
#undef IN
#undef LETTER

#define REAL float
#define IN(name) name##_float
#define LETTER "s"
#include "fronts.h"

#include "inverse.h"

/* Whether rows are those of nodes in an order, and panels and their room those of supernodes. */
static int are_panels(const Fronts *f)
{
    if (f->stack > MOST || f->widest > MOST || f->tallest > INT32_MAX || f->panel[0]) return 0;
    for (Int k = 0; k < f->n; k++)
        if (f->offset[k + 1] - f->offset[k] != f->sizes[f->order[k]] ||
            f->place[f->order[k]] != k)
            return 0;
    for (Int s = 0; s < f->many; s++) {
        Int nc = width_of(f, s), ld = nc + below(f, s);
        if (ld > f->tallest || nc * ld > f->widest || f->panel[s + 1] != f->panel[s] + nc * ld)
            return 0;
    }
    return 1;
}

/* Whether entries are those of blocks. */
static int are_entries(const Fronts *f)
{
    if (f->entry[0]) return 0;
    for (Int i = 0; i < f->n; i++) {
        Int height = 0;
        for (Int e = f->indptr[i]; e < f->indptr[i + 1]; e++) height += f->sizes[f->indices[e]];
        if (f->entry[i + 1] != f->entry[i] + height * f->sizes[i]) return 0;
    }
    return 1;
}

/* Whether each front has the rows of its columns and of its children, and the stack of updates its
 * room; else refused. */
static int are_assembled(Held *held, const Fronts *f)
{
    Int *mark = memory(held, f->n + 2 * f->many, sizeof(Int)), top = 0, fits = 1;
    if (!mark) return 0;
    Int *first = mark + f->n, *next = first + f->many;
    for (Int k = 0; k < f->n; k++) mark[k] = -1;
    for (Int s = 0; s < f->many; s++) first[s] = -1;
    for (Int s = 0; s < f->many; s++) {
        Int m = below(f, s), freed = 0;
        for (Int k = f->start[s]; k < f->start[s + 1]; k++) mark[k] = s;
        for (Int e = f->begin[s]; e < f->begin[s + 1]; e++) mark[f->rows[e]] = s;
        for (Int k = f->start[s]; k < f->start[s + 1]; k++)
            for (Int e = f->indptr[f->order[k]]; e < f->indptr[f->order[k] + 1]; e++) {
                Int row = f->place[f->indices[e]];
                fits &= row < k || mark[row] == s;
            }
        for (Int c = first[s]; c >= 0; c = next[c]) {
            for (Int e = f->begin[c]; e < f->begin[c + 1]; e++) fits &= mark[f->rows[e]] == s;
            freed += below(f, c) * below(f, c);
        }
        if (!fits || m * m > f->stack - top) return refuse("not the fronts of a pattern") != NULL;
        top += m * m - freed;
        if (f->above[s] >= 0) next[s] = first[f->above[s]], first[f->above[s]] = s;
    }
    return 1;
}

/* What of the fronts a call reads besides their panels, which is checked for what it costs. */
typedef enum { PANELS, ENTRIES, ASSEMBLY } Reading;

static int fronts_of(Held *held, PyObject *tuple, Reading reading, Fronts *f)
{
    const Int **fields[] = {&f->indptr, &f->indices, &f->entry, &f->order, &f->place, &f->sizes,
                            &f->offset, &f->start, &f->above, &f->begin, &f->rows, &f->panel};
    Array a[12];
    for (int k = 0; k < 12; k++) a[k] = (Array){held, INTS};
    if (!arrays_of(tuple, a, 12)) return 0;
    for (int k = 0; k < 12; k++) *fields[k] = a[k].at;
    Py_ssize_t n = a[3].length, many = a[8].length;
    if (!a[0].length || !a[9].length) return refuse("pointers are never empty") != NULL;
    const Py_ssize_t expected[] = {n + 1, f->indptr[a[0].length - 1], n + 1, n, n, n, n + 1,
                                   many + 1, many, many + 1, f->begin[a[9].length - 1], many + 1};
    for (int k = 0; k < 12; k++)
        if (a[k].length != expected[k]) return refuse("not the fronts of a pattern") != NULL;
    if (!are_sizes(f->sizes, n)) return 0;
    f->n = n, f->many = many;
    long long room[3];
    for (int k = 0; k < 3; k++) {
        PyObject *item = PyTuple_GetItem(tuple, 12 + k);
        if (!item) return 0;
        room[k] = PyLong_AsLongLong(item);
        if (room[k] == -1 && PyErr_Occurred()) return 0;
    }
    f->stack = room[0], f->widest = room[1], f->tallest = room[2];
    if (!are_pointers(f->offset, n + 1, f->offset[n]) || !all_below(f->order, n, n) ||
        !are_supernodes(f, a[10].length) || !are_panels(f) ||
        (reading != PANELS &&
         !(is_pattern(n, f->indptr, n + 1, f->indices, a[1].length) && are_entries(f))))
        return refuse("not the fronts of a pattern") != NULL;
    return reading != ASSEMBLY || are_assembled(held, f);
}

/* factor(fronts, data, scale | None, L | None, (weights, sums, squares) | None,
 *        (scale, v, rows) | None, single) -> bool
 * L may have single precision even if the arithmetic has not. */
static PyObject *factor_of(Held *held, PyObject *args)
{
    PyObject *tuple, *into, *sums, *measured;
    Array data = {held, DOUBLES}, scale = {held, DOUBLES, OPTIONAL};
    Fronts f;
    int single = 0, outcome;
    if (!PyArg_ParseTuple(args, "OO&O&OOOp", &tuple, array, &data, array, &scale, &into,
                          &sums, &measured, &single))
        return NULL;
    Array L = {held, single ? FLOATS : REALS, WRITTEN | OPTIONAL};
    if (!fronts_of(held, tuple, ASSEMBLY, &f) || !array(into, &L)) return NULL;
    Py_ssize_t N = f.offset[f.n];
    if (data.length != f.entry[f.n] || (L.at && L.length != f.panel[f.many]))
        return refuse("a matrix of another pattern");
    if (scale.at && scale.length != N) return refuse("a scale of N rows expected");
    Sums wanted = {0, NULL, NULL, NULL};
    if (sums != Py_None) {
        Array w = {held, DOUBLES}, own = {held, DOUBLES, WRITTEN}, a[] = {w, own, own};
        if (!arrays_of(sums, a, 3)) return NULL;
        if (!N || a[2].length != N || a[0].length != a[1].length || a[0].length % N)
            return refuse("weights and sums differ in size");
        wanted = (Sums){a[0].length / N, a[0].at, a[1].at, a[2].at};
    }
    Residual residual, *wish = NULL;
    if (measured != Py_None) {
        Array in = {held, DOUBLES}, a[] = {in, in, {held, DOUBLES, WRITTEN}};
        if (!arrays_of(measured, a, 3)) return NULL;
        if (a[0].length != N || a[1].length != N || a[2].length != N || single)
            return refuse("a residual of N rows in double precision expected");
        residual = (Residual){a[0].at, a[1].at, a[2].at};
        wish = &residual;
    }
    float *rounded = !single && L.at && L.itemsize == sizeof(float) ? L.at : NULL;
    void *kept = rounded ? NULL : L.at;
    Py_BEGIN_ALLOW_THREADS
    outcome = single ? factor_float(&f, data.at, scale.at, kept, &wanted, NULL, NULL)
                     : factor_double(&f, data.at, scale.at, kept, &wanted, wish, rounded);
    Py_END_ALLOW_THREADS
    if (outcome == -1) PyErr_NoMemory();
    return outcome >= 0 ? PyBool_FromLong(outcome) : NULL;
}
CALL(factor)

/* solve(fronts, L, scale | None, B, X, single): X = A^-1 B, both (N, k), in the order of A's rows.
 * L is that of A, or of A with rows and columns times `scale` (N,), in the order of L. */
static PyObject *solve_of(Held *held, PyObject *args)
{
    PyObject *tuple, *known;
    Array scale = {held, DOUBLES, OPTIONAL}, B = {held, DOUBLES}, X = {held, DOUBLES, WRITTEN};
    Fronts f;
    int single, outcome;
    if (!PyArg_ParseTuple(args, "OOO&O&O&p", &tuple, &known, array, &scale, array, &B, array, &X,
                          &single))
        return NULL;
    Array L = {held, single ? FLOATS : DOUBLES};
    if (!fronts_of(held, tuple, PANELS, &f) || !array(known, &L)) return NULL;
    Int N = f.offset[f.n];
    if (!N || L.length != f.panel[f.many] || B.length % N || X.length != B.length ||
        (scale.at && scale.length != N))
        return refuse("a factor or right-hand side of another matrix");
    Py_BEGIN_ALLOW_THREADS
    outcome = single ? solve_float(&f, L.at, scale.at, B.at, X.at, B.length / N)
                     : solve_double(&f, L.at, scale.at, B.at, X.at, B.length / N);
    Py_END_ALLOW_THREADS
    return outcome < 0 ? PyErr_NoMemory() : Py_NewRef(Py_None);
}
CALL(solve)

/* multiply(fronts, A, x, y): y, zero before, becomes A x; only half of A is read */
static PyObject *multiply_of(Held *held, PyObject *args)
{
    PyObject *tuple;
    Array A = {held, DOUBLES}, into = {held, DOUBLES, WRITTEN}, right = {held, DOUBLES};
    Fronts f;
    if (!PyArg_ParseTuple(args, "OO&O&O&", &tuple, array, &A, array, &right, array, &into) ||
        !fronts_of(held, tuple, ENTRIES, &f))
        return NULL;
    if (A.length != f.entry[f.n] || right.length != f.offset[f.n] || into.length != right.length)
        return refuse("a matrix or vector of another size");
    Int *first = memory(held, f.n, sizeof(Int));
    if (!first) return NULL;
    const double *data = A.at, *x = right.at;
    double *y = into.at;
    Py_BEGIN_ALLOW_THREADS
    first_rows(&f, first);
    for (Int i = 0; i < f.n; i++) {
        Int b = f.sizes[i], height = (f.entry[i + 1] - f.entry[i]) / b;
        const double *block = data + f.entry[i], *xi = x + first[i];
        for (Int e = f.indptr[i]; e < f.indptr[i + 1]; block += f.sizes[f.indices[e++]]) {
            Int j = f.indices[e], rows_of_j = f.sizes[j];
            if (j < i) continue;
            const double *xj = x + first[j];
            for (Int c = 0; c < b; c++) {
                const double *column = block + c * height;
                double sum = 0.0;
                for (Int r = 0; r < rows_of_j; r++) {
                    y[first[j] + r] += column[r] * xi[c];
                    sum += column[r] * xj[r];
                }
                if (j > i) y[first[i] + c] += sum;
            }
        }
    }
    Py_END_ALLOW_THREADS
    return Py_NewRef(Py_None);
}
CALL(multiply)

/* lower(fronts, L, heights, rows, values) -> number of entries of L's lower triangle by columns */
static PyObject *lower_of(Held *held, PyObject *args)
{
    PyObject *tuple;
    Array known = {held, DOUBLES}, columns = {held, INTS, WRITTEN}, indices = columns;
    Array entries = {held, DOUBLES, WRITTEN};
    Fronts f;
    if (!PyArg_ParseTuple(args, "OO&O&O&O&", &tuple, array, &known, array, &columns, array,
                          &indices, array, &entries) ||
        !fronts_of(held, tuple, PANELS, &f))
        return NULL;
    if (known.length != f.panel[f.many] || columns.length != f.offset[f.n] ||
        indices.length < known.length || entries.length < known.length)
        return refuse("a factor of another matrix");
    const double *L = known.at;
    double *values = entries.at;
    Int *heights = columns.at, *rows = indices.at, used = 0;
    for (Int s = 0; s < f.many; s++) {
        Int nc = width_of(&f, s), ld = nc + below(&f, s), first = f.offset[f.start[s]];
        for (Int c = 0; c < nc; c++) {
            const double *column = L + f.panel[s] + c * ld;
            heights[first + c] = ld - c;
            memcpy(values + used, column + c, (size_t)(ld - c) * sizeof(double));
            for (Int r = c; r < nc; r++) rows[used++] = first + r;
            for (Int e = f.begin[s]; e < f.begin[s + 1]; e++)
                for (Int r = f.offset[f.rows[e]]; r < f.offset[f.rows[e] + 1]; r++)
                    rows[used++] = r;
        }
    }
    return PyLong_FromLongLong(used);
}
CALL(lower)

/* ---------------------------------------------------- matrices and graphs */

#include "matrices.h"
#include "graphs.h"
#include "equations.h"
#include "refresh.h"

#undef REAL
#undef IN
#include "balls.h"

#include "words.h"

static PyMethodDef methods[] = {
    {"components", components, METH_VARARGS, "Connected components."},
    {"tree", tree, METH_VARARGS, "A breadth-first tree, and its nodes in order."},
    {"compose", compose, METH_VARARGS, "Poses composed along a tree."},
    {"worst_defect", worst_defect, METH_VARARGS, "The matrix farthest from being a rotation."},
    {"gradient", gradient, METH_VARARGS, "Half the gradient, and the edges' terms."},
    {"first_order", first_order, METH_VARARGS, "Derivatives along the rotations."},
    {"hessian", hessian, METH_VARARGS, "Blocks of the Hessian."},
    {"settle", settle, METH_VARARGS, "F at the minimum near a point, and its bound."},
    {"turn", turn, METH_VARARGS, "Rotations turned by tangents."},
    {"angles", angles, METH_VARARGS, "Angles of residual rotations."},
    {"residuals", residuals, METH_VARARGS, "Norms of residuals."},
    {"lessen", lessen, METH_VARARGS, "Multipliers less a shift."},
    {"blocks", blocks, METH_VARARGS, "The occupied blocks of a graph's matrices."},
    {"assemble", assemble, METH_VARARGS, "A block matrix in compressed columns."},
    {"subtract", subtract, METH_VARARGS, "Blocks off the diagonal blocks of a matrix."},
    {"expand", expand, METH_VARARGS, "The rows of a matrix of blocks."},
    {"diagonal_places", diagonal_places, METH_VARARGS, "Where the diagonal of a matrix is."},
    {"pin", pin, METH_VARARGS, "Rows and columns of a matrix set to zero."},
    {"lever_sums", lever_sums, METH_VARARGS, "Sizes of levers summed by nodes."},
    {"scatter_sum", scatter_sum, METH_VARARGS, "Rows summed by an index."},
    {"polynomial", polynomial, METH_VARARGS, "Values of a polynomial at balls."},
    {"eliminate", eliminate, METH_VARARGS, "Schur complements of balls."},
    {"slopes", slopes, METH_VARARGS, "Terms and half the gradient of a cost."},
    {"curvatures", curvatures, METH_VARARGS, "Blocks of a Gauss-Newton matrix."},
    {"tagged_lines", tagged_lines, METH_VARARGS, "Ids and numbers of lines by tag, and other lines."},
    {"numbers", numbers, METH_VARARGS, "The numbers in texts; False if any is unusual."},
    {"combine", combine, METH_VARARGS, "An operation on balls."},
    {"multiply", multiply, METH_VARARGS, "A x."},
    {"lower", lower, METH_VARARGS, "L by columns."},
    {"order", order, METH_VARARGS, "A fill-reducing order of a pattern."},
    {"analyze", analyze, METH_VARARGS, "Order, counts and supernodes of a pattern."},
    {"measure", measure, METH_VARARGS, "Places of panels, and memory needed."},
    {"factor", factor, METH_VARARGS, "Factorize; False if the matrix is not positive definite."},
    {"solve", solve, METH_VARARGS, "A^-1 B."},
    {"inverse_blocks", inverse_blocks, METH_VARARGS, "Blocks of A^-1 on the pattern of L."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT, "_kernel", NULL, -1, methods,
                                        NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__kernel(void)
{
    if (connect_double() < 0 || connect_float() < 0) return NULL;
    *(void **)&gemm = found("scipy.linalg.cython_blas", "dgemm");
    if (!gemm) return NULL;
    return PyModule_Create(&definition);
}
