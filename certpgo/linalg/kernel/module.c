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

/* Multiplications between two looks for Ctrl-C: about a second. */
#define PATIENCE 2e9
/* Multiplications up to which a front is eliminated without BLAS. */
#define SMALL 20000

/* ---------------------------------------------------------------- buffers */

enum { MAX_BUFFERS = 24 };

typedef struct {
    Py_buffer views[MAX_BUFFERS];
    int count;
} Buffers;

/* What arrays consist of. */
typedef enum { INTS, SHORT_INTS, DOUBLES, FLOATS, REALS } Kind;

static int is_of(const Py_buffer *view, Kind kind)
{
    static const char *const letters[] = {"lq", "il", "d", "f"};
    static const Py_ssize_t sizes[] = {8, 4, 8, 4};
    if (kind == REALS) return is_of(view, DOUBLES) || is_of(view, FLOATS);
    const char *format = view->format ? view->format : "B";
    return view->itemsize == sizes[kind] && format[0] && !format[1] &&
           strchr(letters[kind], format[0]) != NULL;
}

/* The memory of a contiguous array; NULL and an exception if it is not of this kind. */
static void *borrow(Buffers *held, PyObject *object, int writable, Kind kind, Py_ssize_t *length)
{
    static const char *const names[] = {"int64", "int32", "float64", "float32", "floats"};
    Py_buffer *view = &held->views[held->count];
    if (held->count == MAX_BUFFERS) {
        PyErr_SetString(PyExc_SystemError, "too many arrays");
        return NULL;
    }
    if (PyObject_GetBuffer(object, view, PyBUF_FORMAT | (writable ? PyBUF_CONTIG : PyBUF_CONTIG_RO)) < 0)
        return NULL;
    held->count++;
    if (!is_of(view, kind)) {
        PyErr_Format(PyExc_TypeError, "an array of %s expected", names[kind]);
        return NULL;
    }
    if (length) *length = view->len / view->itemsize;
    /* An empty array may have no memory. */
    return view->buf ? view->buf : (void *)held;
}

static void give_back(Buffers *held)
{
    while (held->count) PyBuffer_Release(&held->views[--held->count]);
}

static int refuse(const char *why)
{
    PyErr_SetString(PyExc_ValueError, why);
    return -1;
}

static int all_below(const Int *values, Py_ssize_t count, Int limit)
{
    for (Py_ssize_t k = 0; k < count; k++)
        if (values[k] < 0 || values[k] >= limit) return 0;
    return 1;
}

/* Whether pointers rise from 0 to the number of entries. */
static int are_pointers(const Int *indptr, Py_ssize_t length, Py_ssize_t entries)
{
    if (length < 1 || indptr[0] != 0 || indptr[length - 1] != entries) return 0;
    for (Py_ssize_t k = 1; k < length; k++)
        if (indptr[k] < indptr[k - 1]) return 0;
    return 1;
}

static PyObject *bytes_of(const Int *values, Int count)
{
    return PyBytes_FromStringAndSize((const char *)values, (Py_ssize_t)(count * (Int)sizeof(Int)));
}

/* --------------------------------------------------------------- analysis */

#include "analysis.h"
#include "ordering.h"

/* Refuse a pattern whose nodes' neighbours do not ascend, or are not mutual. */
static int refuse_asymmetric(Int n, const Int *indptr, const Int *indices)
{
    Int *next = malloc((size_t)(n + 1) * sizeof(Int));
    int found = 1;
    if (!next) {
        PyErr_NoMemory();
        return -1;
    }
    memcpy(next, indptr, (size_t)n * sizeof(Int));
    for (Int i = 0; i < n && found; i++)
        for (Int e = indptr[i]; e < indptr[i + 1] && found; e++) {
            Int j = indices[e];
            found = next[j] < indptr[j + 1] && indices[next[j]] == i;
            next[j]++;
        }
    free(next);
    return found ? 0 : refuse("a pattern is symmetric, with ascending neighbours");
}

static PyObject *analyze(PyObject *self, PyObject *args)
{
    PyObject *objects[4], *result = NULL;
    Buffers held = {.count = 0};
    Py_ssize_t length, count_of_sizes, pointers, entries;
    if (!PyArg_ParseTuple(args, "OOOO", &objects[0], &objects[1], &objects[2], &objects[3]))
        return NULL;
    const Int *indptr = borrow(&held, objects[0], 0, INTS, &pointers);
    const Int *indices = indptr ? borrow(&held, objects[1], 0, INTS, &entries) : NULL;
    const Int *given = indices ? borrow(&held, objects[2], 0, INTS, &length) : NULL;
    const Int *sizes = given ? borrow(&held, objects[3], 0, INTS, &count_of_sizes) : NULL;
    if (!sizes) goto done;
    Int n = length;
    if (pointers != n + 1 || count_of_sizes != n || !are_pointers(indptr, pointers, entries) ||
        !all_below(indices, entries, n) || !all_below(given, n, n)) {
        refuse("not a pattern of as many nodes as order and sizes have");
        goto done;
    }
    if (refuse_asymmetric(n, indptr, indices)) goto done;
    Int *work = malloc((size_t)(16 * n + 16) * sizeof(Int)), *rows = NULL;
    if (!work) {
        PyErr_NoMemory();
        goto done;
    }
    Int *order = work, *place = work + n, *parent = work + 2 * n, *columns = work + 3 * n;
    Int *counts = work + 4 * n, *start = work + 5 * n, *of = work + 6 * n + 2;
    Int *above = work + 7 * n + 2, *begin = work + 8 * n + 2, *scratch = work + 9 * n + 4;
    Int many = 0;
    for (Int k = 0; k < n; k++) place[k] = -1;
    for (Int k = 0; k < n; k++) place[given[k]] = k;
    for (Int k = 0; k < n; k++)
        if (place[k] < 0) {
            refuse("an order contains each node once");
            free(work);
            goto done;
        }
    Py_BEGIN_ALLOW_THREADS
    memcpy(order, given, (size_t)n * sizeof(Int));
    elimination_tree(n, indptr, indices, order, place, parent, scratch);
    postorder(n, order, place, parent, scratch, scratch + n, scratch + 2 * n);
    count(n, indptr, indices, order, place, parent, sizes, columns, counts, scratch);
    many = supernodes(n, parent, columns, start, of, scratch);
    rows = structure(n, indptr, indices, order, place, many, start, of, above, begin, scratch);
    Py_END_ALLOW_THREADS
    if (rows)
        result = Py_BuildValue("NNNNNN", bytes_of(order, n), bytes_of(counts, n),
                               bytes_of(start, many + 1), bytes_of(above, many),
                               bytes_of(begin, many + 1), bytes_of(rows, begin[many]));
    else
        PyErr_NoMemory();
    free(rows);
    free(work);
done:
    give_back(&held);
    return result;
}

/* order(indptr, indices) -> bytes of a fill-reducing order */
static PyObject *order(PyObject *self, PyObject *args)
{
    PyObject *objects[2], *result = NULL;
    Buffers held = {.count = 0};
    Py_ssize_t pointers, entries;
    if (!PyArg_ParseTuple(args, "OO", &objects[0], &objects[1])) return NULL;
    const Int *indptr = borrow(&held, objects[0], 0, INTS, &pointers);
    const Int *indices = indptr ? borrow(&held, objects[1], 0, INTS, &entries) : NULL;
    if (!indices) goto done;
    Int n = pointers - 1, outcome = -1;
    if (!are_pointers(indptr, pointers, entries) || !all_below(indices, entries, n)) {
        refuse("not a pattern");
        goto done;
    }
    if (refuse_asymmetric(n, indptr, indices)) goto done;
    Int *found_order = malloc((size_t)(n + 1) * sizeof(Int));
    Py_BEGIN_ALLOW_THREADS
    if (found_order) outcome = minimum_degree(n, indptr, indices, found_order);
    Py_END_ALLOW_THREADS
    result = outcome < 0 ? PyErr_NoMemory() : bytes_of(found_order, n);
    free(found_order);
done:
    give_back(&held);
    return result;
}

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

/* Whether each supernode's parent comes after it, or is -1. */
static int are_parents(Int many, const Int *above)
{
    for (Int s = 0; s < many; s++)
        if (above[s] != -1 && (above[s] <= s || above[s] >= many)) return 0;
    return 1;
}

/* Places of panels in L, and the memory that the updates need. */
static PyObject *measure(PyObject *self, PyObject *args)
{
    PyObject *objects[6], *result = NULL;
    Buffers held = {.count = 0};
    Py_ssize_t lengths[6];
    void *arrays[6];
    if (!PyArg_ParseTuple(args, "OOOOOO", &objects[0], &objects[1], &objects[2], &objects[3],
                          &objects[4], &objects[5]))
        return NULL;
    for (int k = 0; k < 6; k++)
        if (!(arrays[k] = borrow(&held, objects[k], k == 5, INTS, &lengths[k]))) goto done;
    Fronts f = {.offset = arrays[0], .start = arrays[1], .above = arrays[2], .begin = arrays[3],
                .rows = arrays[4]};
    Int n = lengths[0] - 1, many = lengths[2];
    if (n < 0 || lengths[1] != many + 1 || lengths[3] != many + 1 || lengths[5] != many + 1 ||
        !are_pointers(f.offset, n + 1, f.offset[n]) || f.start[many] > n ||
        !are_pointers(f.start, many + 1, f.start[many]) ||
        !are_pointers(f.begin, many + 1, lengths[4]) || !all_below(f.rows, lengths[4], n) ||
        !are_parents(many, f.above)) {
        refuse("not a tree of fronts");
        goto done;
    }
    Int *panel = arrays[5], *freed = calloc((size_t)many + 1, sizeof(Int));
    Int stack = 0, top = 0, widest = 0, tallest = 0;
    if (!freed) {
        PyErr_NoMemory();
        goto done;
    }
    panel[0] = 0;
    for (Int s = 0; s < many; s++) {
        Int m = below(&f, s), nc = width_of(&f, s);
        panel[s + 1] = panel[s] + nc * (nc + m);
        if (nc * (nc + m) > widest) widest = nc * (nc + m);
        if (nc + m > tallest) tallest = nc + m;
        if (top + m * m > stack) stack = top + m * m;
        top += m * m - freed[s];
        if (f.above[s] >= 0) freed[f.above[s]] += m * m;
    }
    free(freed);
    result = Py_BuildValue("LLL", (long long)stack, (long long)widest, (long long)tallest);
done:
    give_back(&held);
    return result;
}

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

static PyObject *item_of(PyObject *tuple, Py_ssize_t k)
{
    if (PyTuple_Check(tuple)) return PyTuple_GetItem(tuple, k);
    PyErr_SetString(PyExc_TypeError, "a tuple of arrays expected");
    return NULL;
}

/* Three arrays of doubles, of which those from `writable` on are written. */
static int borrow_three(Buffers *held, PyObject *tuple, int writable, void **arrays,
                        Py_ssize_t *lengths)
{
    for (int k = 0; k < 3; k++) {
        PyObject *item = item_of(tuple, k);
        if (!item) return -1;
        if (!(arrays[k] = borrow(held, item, k >= writable, DOUBLES, &lengths[k]))) return -1;
    }
    return 0;
}

static int fronts_of(Buffers *held, PyObject *tuple, Fronts *f)
{
    const Int **fields[] = {&f->indptr, &f->indices, &f->entry, &f->order, &f->place, &f->sizes,
                            &f->offset, &f->start, &f->above, &f->begin, &f->rows, &f->panel};
    Py_ssize_t lengths[12];
    for (int k = 0; k < 12; k++) {
        PyObject *item = item_of(tuple, k);
        if (!item || !(*fields[k] = borrow(held, item, 0, INTS, &lengths[k]))) return -1;
    }
    Py_ssize_t n = lengths[3], many = lengths[8];
    if (!lengths[0] || !lengths[9]) return refuse("pointers are never empty");
    const Py_ssize_t expected[] = {n + 1, f->indptr[lengths[0] - 1], n + 1, n, n, n, n + 1,
                                   many + 1, many, many + 1, f->begin[lengths[9] - 1], many + 1};
    for (int k = 0; k < 12; k++)
        if (lengths[k] != expected[k]) return refuse("not the fronts of a pattern");
    if (f->start[many] > n) return refuse("more nodes in fronts than in the pattern");
    for (Int k = 0; k < n; k++)
        if (f->sizes[k] < 1) return refuse("a node has at least one row");
    if (!are_pointers(f->offset, n + 1, f->offset[n]) || !are_parents(many, f->above) ||
        !are_pointers(f->start, many + 1, f->start[many]) ||
        !are_pointers(f->panel, many + 1, f->panel[many]))
        return refuse("not the fronts of a pattern");
    f->n = n, f->many = many;
    long long room[3];
    for (int k = 0; k < 3; k++) {
        PyObject *item = item_of(tuple, 12 + k);
        if (!item) return -1;
        room[k] = PyLong_AsLongLong(item);
        if (room[k] == -1 && PyErr_Occurred()) return -1;
    }
    f->stack = room[0], f->widest = room[1], f->tallest = room[2];
    return 0;
}

/* factor(fronts, data, scale | None, L | None, update | None, (weights, sums, squares) | None,
 *        (scale, v, rows) | None, single) -> bool
 * L may have single precision even if the arithmetic has not. Updates are those of
 * the roots, one after another, in the precision of the arithmetic. */
static PyObject *factor(PyObject *self, PyObject *args)
{
    PyObject *tuple, *data, *scaling, *into, *rest, *sums, *measured, *result = NULL;
    Buffers held = {.count = 0};
    Fronts f;
    Sums wanted = {0, NULL, NULL, NULL};
    Residual residual;
    int single = 0;
    void *L = NULL, *update = NULL;
    float *rounded = NULL;
    Py_ssize_t length, entries;
    if (!PyArg_ParseTuple(args, "OOOOOOOp", &tuple, &data, &scaling, &into, &rest, &sums, &measured,
                          &single))
        return NULL;
    if (fronts_of(&held, tuple, &f) < 0) goto done;
    const double *values = borrow(&held, data, 0, DOUBLES, &entries);
    if (!values) goto done;
    if (into != Py_None) {
        if (!(L = borrow(&held, into, 1, single ? FLOATS : REALS, &length))) goto done;
        if (!single && held.views[held.count - 1].itemsize == sizeof(float)) rounded = L, L = NULL;
    }
    if (entries != f.entry[f.n] || ((L || rounded) && length != f.panel[f.many])) {
        refuse("a matrix of another pattern");
        goto done;
    }
    if (rest != Py_None) {
        Py_ssize_t room;
        if (!(update = borrow(&held, rest, 1, single ? FLOATS : DOUBLES, &room))) goto done;
        for (Int s = 0; s < f.many; s++)
            if (f.above[s] < 0) room -= below(&f, s) * below(&f, s);
        if (room) {
            refuse("an update of another size");
            goto done;
        }
    }
    Py_ssize_t N = f.offset[f.n], lengths[3];
    void *arrays[3];
    const double *scale = NULL;
    if (scaling != Py_None) {
        if (!(scale = borrow(&held, scaling, 0, DOUBLES, lengths))) goto done;
        if (lengths[0] != N) {
            refuse("a scale of N rows expected");
            goto done;
        }
    }
    if (sums != Py_None) {
        if (borrow_three(&held, sums, 1, arrays, lengths) < 0) goto done;
        if (!N || lengths[2] != N || lengths[0] != lengths[1] || lengths[0] % N) {
            refuse("weights and sums differ in size");
            goto done;
        }
        wanted.columns = lengths[0] / N;
        wanted.weight = arrays[0], wanted.sums = arrays[1], wanted.squares = arrays[2];
    }
    if (measured != Py_None) {
        if (borrow_three(&held, measured, 2, arrays, lengths) < 0) goto done;
        if (lengths[0] != N || lengths[1] != N || lengths[2] != N || single) {
            refuse("a residual of N rows in double precision expected");
            goto done;
        }
        residual.scale = arrays[0], residual.v = arrays[1], residual.sums = arrays[2];
    }
    const Residual *wish = measured == Py_None ? NULL : &residual;
    int outcome;
    Py_BEGIN_ALLOW_THREADS
    outcome = single ? factor_float(&f, values, scale, L, update, &wanted, NULL, NULL)
                     : factor_double(&f, values, scale, L, update, &wanted, wish, rounded);
    Py_END_ALLOW_THREADS
    if (outcome == -1) PyErr_NoMemory();
    if (outcome >= 0) result = PyBool_FromLong(outcome);
done:
    give_back(&held);
    return result;
}

/* solve(fronts, L, X, single, way): X (k, N), in the order of L's rows, is overwritten by the
 * solution of L L^T, if way > 0 of L, if way < 0 of L^T */
static PyObject *solve(PyObject *self, PyObject *args)
{
    PyObject *tuple, *factor_object, *right, *result = NULL;
    Buffers held = {.count = 0};
    Fronts f;
    int single, way;
    Py_ssize_t length, entries;
    if (!PyArg_ParseTuple(args, "OOOpi", &tuple, &factor_object, &right, &single, &way)) return NULL;
    if (fronts_of(&held, tuple, &f) < 0) goto done;
    Kind kind = single ? FLOATS : DOUBLES;
    const void *L = borrow(&held, factor_object, 0, kind, &length);
    void *X = L ? borrow(&held, right, 1, kind, &entries) : NULL;
    if (!X) goto done;
    Int N = f.offset[f.n];
    if (!N || length != f.panel[f.many] || entries % N) {
        refuse("a factor or right-hand side of another matrix");
        goto done;
    }
    int outcome;
    Py_BEGIN_ALLOW_THREADS
    outcome = single ? solve_float(&f, L, X, entries / N, way)
                     : solve_double(&f, L, X, entries / N, way);
    Py_END_ALLOW_THREADS
    if (outcome < 0)
        PyErr_NoMemory();
    else
        result = Py_NewRef(Py_None);
done:
    give_back(&held);
    return result;
}

/* multiply(fronts, A, x, y): y, zero before, becomes A x; only half of A is read */
static PyObject *multiply(PyObject *self, PyObject *args)
{
    PyObject *tuple, *objects[3], *result = NULL;
    Buffers held = {.count = 0};
    Fronts f;
    Py_ssize_t entries, columns, rows;
    if (!PyArg_ParseTuple(args, "OOOO", &tuple, &objects[0], &objects[1], &objects[2])) return NULL;
    if (fronts_of(&held, tuple, &f) < 0) goto done;
    const double *data = borrow(&held, objects[0], 0, DOUBLES, &entries);
    const double *x = data ? borrow(&held, objects[1], 0, DOUBLES, &columns) : NULL;
    double *y = x ? borrow(&held, objects[2], 1, DOUBLES, &rows) : NULL;
    if (!y) goto done;
    if (entries != f.entry[f.n] || columns != f.offset[f.n] || rows != columns) {
        refuse("a matrix or vector of another size");
        goto done;
    }
    Int *first = malloc((size_t)(f.n + 1) * sizeof(Int));
    if (!first) {
        PyErr_NoMemory();
        goto done;
    }
    Py_BEGIN_ALLOW_THREADS
    first[0] = 0;
    for (Int i = 0; i < f.n; i++) first[i + 1] = first[i] + f.sizes[i];
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
    free(first);
    result = Py_NewRef(Py_None);
done:
    give_back(&held);
    return result;
}

/* lower(fronts, L, heights, rows, values) -> number of entries of L's lower triangle by columns */
static PyObject *lower(PyObject *self, PyObject *args)
{
    PyObject *tuple, *objects[4], *result = NULL;
    Buffers held = {.count = 0};
    Fronts f;
    Py_ssize_t length, columns, room, also;
    if (!PyArg_ParseTuple(args, "OOOOO", &tuple, &objects[0], &objects[1], &objects[2], &objects[3]))
        return NULL;
    if (fronts_of(&held, tuple, &f) < 0) goto done;
    const double *L = borrow(&held, objects[0], 0, DOUBLES, &length);
    Int *heights = L ? borrow(&held, objects[1], 1, INTS, &columns) : NULL;
    Int *rows = heights ? borrow(&held, objects[2], 1, INTS, &room) : NULL;
    double *values = rows ? borrow(&held, objects[3], 1, DOUBLES, &also) : NULL;
    if (!values) goto done;
    if (length != f.panel[f.many] || columns != f.offset[f.n] || room < length || also < length) {
        refuse("a factor of another matrix");
        goto done;
    }
    Int used = 0;
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
    result = PyLong_FromLongLong(used);
done:
    give_back(&held);
    return result;
}

/* ------------------------------------------------------------------ edges */

#include "edges.h"

/* The graph of a tuple (pairs, P, K | None, kappa, tau | None, moved | None, arms | None). */
static int edges_of(Buffers *held, PyObject *tuple, Int d, Edges *g)
{
    if (d != 2 && d != 3) return refuse("graphs are in 2 or 3 dimensions");
    const double **fields[] = {&g->P, &g->K, &g->kappa, &g->tau, &g->moved, &g->arms};
    Int lengths[] = {d * d, d * d, 1, 1, d, d};
    Py_ssize_t length;
    PyObject *item = item_of(tuple, 0);
    if (!item || !(g->pairs = borrow(held, item, 0, INTS, &length))) return -1;
    g->m = length / 2, g->d = d;
    for (int k = 0; k < 6; k++) {
        if (!(item = item_of(tuple, k + 1))) return -1;
        *fields[k] = NULL;
        if (item == Py_None) continue;
        if (!(*fields[k] = borrow(held, item, 0, DOUBLES, &length))) return -1;
        if (length != g->m * lengths[k]) return refuse("arrays of edges differ in length");
    }
    if (!g->P || !(g->K || g->kappa) || (g->tau && !g->moved))
        return refuse("measured rotations, their weights, and with tau translations expected");
    return 0;
}

/* worst_defect(R, d) -> index and size: see `certpgo.linalg.so.worst_defect` */
static PyObject *worst_defect(PyObject *self, PyObject *args)
{
    PyObject *object, *result = NULL;
    Buffers held = {.count = 0};
    Py_ssize_t size;
    int d;
    if (!PyArg_ParseTuple(args, "Oi", &object, &d)) return NULL;
    const double *R = borrow(&held, object, 0, DOUBLES, &size);
    if (!R) goto done;
    if (d < 2 || d > 3 || size % (d * d)) {
        refuse("matrices of 2 or 3 rows expected");
        goto done;
    }
    double largest;
    Int worst = d == 3 ? farthest(size / 9, 3, R, &largest) : farthest(size / 4, 2, R, &largest);
    result = Py_BuildValue("Ld", (long long)worst, largest);
done:
    give_back(&held);
    return result;
}

/* gradient(edges, d, r, R, t | None, G | None, terms): G is added to */
static PyObject *gradient(PyObject *self, PyObject *args)
{
    PyObject *tuple, *objects[4], *result = NULL;
    Buffers held = {.count = 0};
    Edges g;
    int d, r;
    Py_ssize_t many, size, positions = 0, terms_size;
    if (!PyArg_ParseTuple(args, "OiiOOOO", &tuple, &d, &r, &objects[0], &objects[1], &objects[2],
                          &objects[3]))
        return NULL;
    if (edges_of(&held, tuple, d, &g) < 0) goto done;
    const double *t = NULL, *R = borrow(&held, objects[0], 0, DOUBLES, &many);
    if (!R) goto done;
    if (g.tau && !(t = borrow(&held, objects[1], 0, DOUBLES, &positions))) goto done;
    double *G = NULL, *terms = borrow(&held, objects[3], 1, DOUBLES, &terms_size);
    if (!terms) goto done;
    if (objects[2] != Py_None && !(G = borrow(&held, objects[2], 1, DOUBLES, &size)))
        goto done;
    Int n = r > 0 ? many / (r * d) : 0;
    if (r < 1 || r > 32 || n * r * d != many || !all_below(g.pairs, 2 * g.m, n) || terms_size != g.m || (G && size != n * r * (d + (g.tau != NULL))) ||
        (g.tau && positions != n * r)) {
        refuse("points of another graph, or of a rank above 32");
        goto done;
    }
    Py_BEGIN_ALLOW_THREADS
    if (d == 3 && r == 3)
        differentiate(&g, 3, 3, R, t, G, terms);
    else if (d == 2 && r == 2)
        differentiate(&g, 2, 2, R, t, G, terms);
    else
        differentiate(&g, d, r, R, t, G, terms);
    Py_END_ALLOW_THREADS
    result = Py_NewRef(Py_None);
done:
    give_back(&held);
    return result;
}

/* coupling(edges, d, R, upper): blocks of the Hessian */
static PyObject *coupling(PyObject *self, PyObject *args)
{
    PyObject *tuple, *objects[2], *result = NULL;
    Buffers held = {.count = 0};
    Edges g;
    int d;
    Py_ssize_t many, size;
    if (!PyArg_ParseTuple(args, "OiOO", &tuple, &d, &objects[0], &objects[1])) return NULL;
    if (edges_of(&held, tuple, d, &g) < 0) goto done;
    const double *R = borrow(&held, objects[0], 0, DOUBLES, &many);
    double *upper = R ? borrow(&held, objects[1], 1, DOUBLES, &size) : NULL;
    if (!upper) goto done;
    Int b = (d == 2 ? 1 : 3) + (g.tau ? d : 0);
    if (size != g.m * b * b || !all_below(g.pairs, 2 * g.m, many / (d * d))) {
        refuse("blocks of another graph");
        goto done;
    }
    Py_BEGIN_ALLOW_THREADS
    if (d == 3)
        couple(&g, 3, R, upper);
    else
        couple(&g, 2, R, upper);
    Py_END_ALLOW_THREADS
    result = Py_NewRef(Py_None);
done:
    give_back(&held);
    return result;
}

/* assemble((indptr, own, slots, pairs), diagonal, upper, data): data, zero before, is written */
static PyObject *assemble(PyObject *self, PyObject *args)
{
    PyObject *objects[7], *result = NULL;
    Buffers held = {.count = 0};
    Py_ssize_t lengths[7];
    void *arrays[7];
    if (!PyArg_ParseTuple(args, "(OOOO)OOO", &objects[0], &objects[1], &objects[2], &objects[3],
                          &objects[4], &objects[5], &objects[6]))
        return NULL;
    for (int k = 0; k < 7; k++)
        if (!(arrays[k] = borrow(&held, objects[k], k == 6, k < 4 ? INTS : DOUBLES, &lengths[k])))
            goto done;
    Int n = lengths[1], m = lengths[3] / 2, b = 1;
    while (n && b * b * n < lengths[4]) b++;
    const Int *indptr = arrays[0];
    if (lengths[0] != n + 1 || !are_pointers(indptr, n + 1, indptr[n]) || lengths[2] != 2 * m ||
        lengths[4] != n * b * b ||
        lengths[5] != m * b * b || lengths[6] != indptr[n] * b * b ||
        !are_places(n, m, indptr, arrays[1], arrays[2], arrays[3])) {
        refuse("blocks of another pattern");
        goto done;
    }
    Py_BEGIN_ALLOW_THREADS
    place_blocks(n, m, b, indptr, arrays[1], arrays[2], arrays[3], arrays[4], arrays[5], arrays[6]);
    Py_END_ALLOW_THREADS
    result = Py_NewRef(Py_None);
done:
    give_back(&held);
    return result;
}

/* expand(indptr, indices, b, rows): the rows (32 bits) of a matrix of b x b blocks */
static PyObject *expand(PyObject *self, PyObject *args)
{
    PyObject *objects[3], *result = NULL;
    Buffers held = {.count = 0};
    Py_ssize_t pointers, blocks, size;
    int b;
    if (!PyArg_ParseTuple(args, "OOiO", &objects[0], &objects[1], &b, &objects[2])) return NULL;
    const Int *indptr = borrow(&held, objects[0], 0, INTS, &pointers);
    const Int *indices = indptr ? borrow(&held, objects[1], 0, INTS, &blocks) : NULL;
    int32_t *rows = indices ? borrow(&held, objects[2], 1, SHORT_INTS, &size) : NULL;
    if (!rows) goto done;
    if (!are_pointers(indptr, pointers, blocks) || size != blocks * b * b) {
        refuse("rows of another pattern");
        goto done;
    }
    for (Int i = 0; i + 1 < pointers; i++)
        for (Int c = 0; c < b; c++)
            for (Int e = indptr[i]; e < indptr[i + 1]; e++)
                for (Int r = 0; r < b; r++) *rows++ = (int32_t)(indices[e] * b + r);
    result = Py_NewRef(Py_None);
done:
    give_back(&held);
    return result;
}

/* diagonal_places(indptr, indices, places): where the diagonal is, in sorted columns of 32 bits */
static PyObject *diagonal_places(PyObject *self, PyObject *args)
{
    PyObject *objects[3], *result = NULL;
    Buffers held = {.count = 0};
    Py_ssize_t pointers, entries, size;
    if (!PyArg_ParseTuple(args, "OOO", &objects[0], &objects[1], &objects[2])) return NULL;
    const int32_t *indptr = borrow(&held, objects[0], 0, SHORT_INTS, &pointers);
    const int32_t *rows = indptr ? borrow(&held, objects[1], 0, SHORT_INTS, &entries) : NULL;
    Int *places = rows ? borrow(&held, objects[2], 1, INTS, &size) : NULL;
    if (!places) goto done;
    if (pointers != size + 1 || indptr[size] != entries) {
        refuse("pointers of another matrix");
        goto done;
    }
    for (Int column = 0; column < size; column++) {
        int32_t low = indptr[column], high = indptr[column + 1];
        if (low < 0 || low > high || high > entries) {
            refuse("pointers of another matrix");
            goto done;
        }
        while (low < high) {
            int32_t middle = low + (high - low) / 2;
            if (rows[middle] < column)
                low = middle + 1;
            else
                high = middle;
        }
        if (low == indptr[column + 1] || rows[low] != column) {
            refuse("a diagonal entry is not stored");
            goto done;
        }
        places[column] = low;
    }
    result = Py_NewRef(Py_None);
done:
    give_back(&held);
    return result;
}

/* scatter_sum(index, values, sums): rows of values are added to rows of sums */
static PyObject *scatter_sum(PyObject *self, PyObject *args)
{
    PyObject *objects[3], *result = NULL;
    Buffers held = {.count = 0};
    Py_ssize_t m, entries, size;
    int columns;
    if (!PyArg_ParseTuple(args, "OOOi", &objects[0], &objects[1], &objects[2], &columns)) return NULL;
    const Int *index = borrow(&held, objects[0], 0, INTS, &m);
    const double *values = index ? borrow(&held, objects[1], 0, DOUBLES, &entries) : NULL;
    double *sums = values ? borrow(&held, objects[2], 1, DOUBLES, &size) : NULL;
    if (!sums) goto done;
    if (columns < 1 || entries != m * columns || size % columns) {
        refuse("as many rows as indices expected");
        goto done;
    }
    if (!all_below(index, m, size / columns)) {
        PyErr_SetString(PyExc_IndexError, "a row out of range");
        goto done;
    }
    Py_BEGIN_ALLOW_THREADS
    for (Int e = 0; e < m; e++)
        for (Int k = 0; k < columns; k++) sums[index[e] * columns + k] += values[e * columns + k];
    Py_END_ALLOW_THREADS
    result = Py_NewRef(Py_None);
done:
    give_back(&held);
    return result;
}

/* ------------------------------------------------------------------ trees */

#include "trees.h"

/* central_tree(pairs, parents): the breadth-first tree of a node in the middle of a long path */
static PyObject *central_tree(PyObject *self, PyObject *args)
{
    PyObject *objects[2], *result = NULL;
    Buffers held = {.count = 0};
    Py_ssize_t ends, n;
    if (!PyArg_ParseTuple(args, "OO", &objects[0], &objects[1])) return NULL;
    const Int *pairs = borrow(&held, objects[0], 0, INTS, &ends);
    Int *parents = pairs ? borrow(&held, objects[1], 1, INTS, &n) : NULL;
    if (!parents) goto done;
    if (n < 1 || ends % 2 || !all_below(pairs, ends, n)) {
        refuse("pairs of the nodes that have parents expected");
        goto done;
    }
    Int *work = malloc((size_t)(2 * n + 1 + 2 * ends) * sizeof(Int));
    if (!work) {
        PyErr_NoMemory();
        goto done;
    }
    Int *queue = work, *start = work + n, *to = start + n + 1, *arcs = to + ends;
    list_neighbours(n, ends / 2, pairs, start, to, queue, arcs);
    Int end = breadth_first(n, start, to, 0, parents, queue);
    Int middle = breadth_first(n, start, to, end, parents, queue), length = 0;
    for (Int i = middle; i != end; i = parents[i]) length++;
    for (Int k = 0; k < (length + 1) / 2; k++) middle = parents[middle];
    breadth_first(n, start, to, middle, parents, queue);
    free(work);
    result = Py_NewRef(Py_None);
done:
    give_back(&held);
    return result;
}

/* compose(parents, d, R, t | None): poses in their parents' frames, in place */
static PyObject *compose(PyObject *self, PyObject *args)
{
    PyObject *objects[3], *result = NULL;
    Buffers held = {.count = 0};
    Py_ssize_t n, size, positions = 0;
    int d, is_forest;
    if (!PyArg_ParseTuple(args, "OiOO", &objects[0], &d, &objects[1], &objects[2])) return NULL;
    const Int *parents = borrow(&held, objects[0], 0, INTS, &n);
    double *t = NULL, *R = parents ? borrow(&held, objects[1], 1, DOUBLES, &size) : NULL;
    if (!R) goto done;
    if (objects[2] != Py_None && !(t = borrow(&held, objects[2], 1, DOUBLES, &positions)))
        goto done;
    int is_known = 1;
    for (Int i = 0; i < n; i++) is_known &= parents[i] < n;
    if (d < 2 || d > 3 || size != n * d * d || (t && positions != n * d) || !is_known) {
        refuse("parents and poses in 2 or 3 dimensions of the same nodes expected");
        goto done;
    }
    Int *above = malloc((size_t)(n + 1) * (sizeof(Int) + 1));
    if (!above) {
        PyErr_NoMemory();
        goto done;
    }
    char *composed = (char *)(above + n);
    is_forest = d == 3 ? compose_poses(n, parents, 3, R, t, above, composed)
                       : compose_poses(n, parents, 2, R, t, above, composed);
    free(above);
    result = is_forest ? Py_NewRef(Py_None) : NULL;
    if (!is_forest) refuse("parents are not those of trees");
done:
    give_back(&held);
    return result;
}

static PyMethodDef methods[] = {
    {"central_tree", central_tree, METH_VARARGS, "Parents in the tree of a central node."},
    {"compose", compose, METH_VARARGS, "Poses composed along a tree."},
    {"worst_defect", worst_defect, METH_VARARGS, "The matrix farthest from being a rotation."},
    {"gradient", gradient, METH_VARARGS, "Half the gradient, and the edges' terms."},
    {"coupling", coupling, METH_VARARGS, "The edges' blocks of the Hessian."},
    {"assemble", assemble, METH_VARARGS, "A block matrix in compressed columns."},
    {"expand", expand, METH_VARARGS, "The rows of a matrix of blocks."},
    {"diagonal_places", diagonal_places, METH_VARARGS, "Where the diagonal of a matrix is."},
    {"scatter_sum", scatter_sum, METH_VARARGS, "Rows summed by an index."},
    {"multiply", multiply, METH_VARARGS, "A x."},
    {"lower", lower, METH_VARARGS, "L by columns."},
    {"order", order, METH_VARARGS, "A fill-reducing order of a pattern."},
    {"analyze", analyze, METH_VARARGS, "Order, counts and supernodes of a pattern."},
    {"measure", measure, METH_VARARGS, "Places of panels, and memory needed."},
    {"factor", factor, METH_VARARGS, "Factorize; False if the matrix is not positive definite."},
    {"solve", solve, METH_VARARGS, "Solve in place."},
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
