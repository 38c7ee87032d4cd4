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

/* ---------------------------------------------------------------- calls */

/* What a call holds until it returns: buffers of arrays, and memory. */
typedef struct {
    Py_buffer views[24];
    void *blocks[4];
    int count, many;
} Held;

/* What arrays consist of. */
typedef enum { INTS, SHORT_INTS, DOUBLES, FLOATS, REALS } Kind;
enum { READ = 0, WRITTEN = 1, OPTIONAL = 2 };

/* A contiguous array; no memory if it is optional and None. */
typedef struct {
    Held *held;
    Kind kind;
    int use;
    void *at;
    Py_ssize_t length;
    int itemsize;
} Array;

/* name_of(held, args) computes, and may return at any point. */
#define CALL(name)                                        \
    static PyObject *name(PyObject *self, PyObject *args) \
    {                                                     \
        Held held = {.count = 0, .many = 0};              \
        PyObject *result = name##_of(&held, args);        \
        give_back(&held);                                 \
        return result;                                    \
    }

static void give_back(Held *held)
{
    while (held->count) PyBuffer_Release(&held->views[--held->count]);
    while (held->many) free(held->blocks[--held->many]);
}

/* NULL, or 0 for what says whether all is well. */
static void *refuse(const char *why)
{
    PyErr_SetString(PyExc_ValueError, why);
    return NULL;
}

/* Memory that `give_back` frees; NULL and an exception if there is none. */
static void *memory(Held *held, Int count, size_t size)
{
    void *block = held->many < 4 ? malloc((size_t)(count + 1) * size) : NULL;
    if (block)
        held->blocks[held->many++] = block;
    else
        PyErr_NoMemory();
    return block;
}

static int is_of(const Py_buffer *view, Kind kind)
{
    static const char *const letters[] = {"lq", "il", "d", "f"};
    static const Py_ssize_t sizes[] = {8, 4, 8, 4};
    if (kind == REALS) return is_of(view, DOUBLES) || is_of(view, FLOATS);
    const char *format = view->format ? view->format : "B";
    return view->itemsize == sizes[kind] && format[0] && !format[1] &&
           strchr(letters[kind], format[0]) != NULL;
}

/* Converts an argument to the `Array` at an address: for PyArg_ParseTuple's O&. */
static int array(PyObject *object, void *address)
{
    static const char *const names[] = {"int64", "int32", "float64", "float32", "floats"};
    Array *a = address;
    Held *held = a->held;
    if ((a->use & OPTIONAL) && object == Py_None) return 1;
    if (held->count == sizeof(held->views) / sizeof(held->views[0])) {
        PyErr_SetString(PyExc_SystemError, "too many arrays");
        return 0;
    }
    Py_buffer *view = &held->views[held->count];
    int contiguous = a->use & WRITTEN ? PyBUF_CONTIG : PyBUF_CONTIG_RO;
    if (PyObject_GetBuffer(object, view, PyBUF_FORMAT | contiguous) < 0) return 0;
    held->count++;
    if (!is_of(view, a->kind)) {
        PyErr_Format(PyExc_TypeError, "an array of %s expected", names[a->kind]);
        return 0;
    }
    a->length = view->len / view->itemsize;
    a->itemsize = (int)view->itemsize;
    /* An empty array may have no memory. */
    a->at = view->buf ? view->buf : (void *)held;
    return 1;
}

/* The arrays of a tuple, as many as there are or more. */
static int arrays_of(PyObject *tuple, Array *arrays, int count)
{
    if (!PyTuple_Check(tuple)) {
        PyErr_SetString(PyExc_TypeError, "a tuple of arrays expected");
        return 0;
    }
    for (int k = 0; k < count; k++) {
        PyObject *item = PyTuple_GetItem(tuple, k);
        if (!item || !array(item, &arrays[k])) return 0;
    }
    return 1;
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

/* Whether each node has a row, and all of them no more than BLAS can count; else refused. */
static int are_sizes(const Int *sizes, Py_ssize_t count)
{
    Int rows = 0;
    for (Py_ssize_t k = 0; k < count; rows += sizes[k++]) {
        if (sizes[k] < 1) return refuse("a node has at least one row") != NULL;
        if (sizes[k] > INT32_MAX - rows) return refuse("a matrix has fewer than 2^31 rows") != NULL;
    }
    return 1;
}

static PyObject *bytes_of(const Int *values, Int count)
{
    return PyBytes_FromStringAndSize((const char *)values, (Py_ssize_t)(count * (Int)sizeof(Int)));
}

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

/* Whether each supernode's parent comes after it, or is -1. */
static int are_parents(Int many, const Int *above)
{
    for (Int s = 0; s < many; s++)
        if (above[s] != -1 && (above[s] <= s || above[s] >= many)) return 0;
    return 1;
}

/* measure(indptr, indices, order, sizes, start, above, begin, rows, place, offset, entry, panel): the
 * last four are written -> the memory that updates and panels need, and the entries of the updates
 * of the roots */
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
        !are_pointers(f.indptr, a[0].length, a[1].length) || a[0].length != n + 1 ||
        !all_below(f.indices, a[1].length, n) || !all_below(f.order, n, n) ||
        f.start[many] > n || !are_pointers(f.start, many + 1, f.start[many]) ||
        !are_pointers(f.begin, many + 1, a[7].length) || !all_below(f.rows, a[7].length, n) ||
        !are_parents(many, f.above))
        return refuse("not a tree of fronts");
    Int *freed = memory(held, many, sizeof(Int));
    Int stack = 0, top = 0, widest = 0, tallest = 0, rest = 0;
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
        if (top + m * m > stack) stack = top + m * m;
        top += m * m - freed[s];
        if (f.above[s] >= 0)
            freed[f.above[s]] += m * m;
        else
            rest += m * m;
    }
    return Py_BuildValue("LLLL", (long long)stack, (long long)widest, (long long)tallest,
                         (long long)rest);
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

static int fronts_of(Held *held, PyObject *tuple, Fronts *f)
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
    if (f->start[many] > n) return refuse("more nodes in fronts than in the pattern") != NULL;
    if (!are_sizes(f->sizes, n)) return 0;
    if (!are_pointers(f->offset, n + 1, f->offset[n]) || !are_parents(many, f->above) ||
        !are_pointers(f->start, many + 1, f->start[many]) ||
        !are_pointers(f->panel, many + 1, f->panel[many]))
        return refuse("not the fronts of a pattern") != NULL;
    f->n = n, f->many = many;
    long long room[3];
    for (int k = 0; k < 3; k++) {
        PyObject *item = PyTuple_GetItem(tuple, 12 + k);
        if (!item) return 0;
        room[k] = PyLong_AsLongLong(item);
        if (room[k] == -1 && PyErr_Occurred()) return 0;
    }
    f->stack = room[0], f->widest = room[1], f->tallest = room[2];
    return 1;
}

/* factor(fronts, data, scale | None, L | None, update | None, (weights, sums, squares) | None,
 *        (scale, v, rows) | None, single) -> bool
 * L may have single precision even if the arithmetic has not. Updates are those of
 * the roots, one after another, in the precision of the arithmetic. */
static PyObject *factor_of(Held *held, PyObject *args)
{
    PyObject *tuple, *into, *rest, *sums, *measured;
    Array data = {held, DOUBLES}, scale = {held, DOUBLES, OPTIONAL};
    Fronts f;
    int single = 0, outcome;
    if (!PyArg_ParseTuple(args, "OO&O&OOOOp", &tuple, array, &data, array, &scale, &into, &rest,
                          &sums, &measured, &single))
        return NULL;
    Array L = {held, single ? FLOATS : REALS, WRITTEN | OPTIONAL};
    Array update = {held, single ? FLOATS : DOUBLES, WRITTEN | OPTIONAL};
    if (!fronts_of(held, tuple, &f) || !array(into, &L) || !array(rest, &update)) return NULL;
    Py_ssize_t N = f.offset[f.n];
    if (data.length != f.entry[f.n] || (L.at && L.length != f.panel[f.many]))
        return refuse("a matrix of another pattern");
    if (scale.at && scale.length != N) return refuse("a scale of N rows expected");
    Int room = 0;
    for (Int s = 0; s < f.many; s++)
        if (f.above[s] < 0) room += below(&f, s) * below(&f, s);
    if (update.at && update.length != room) return refuse("an update of another size");
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
    outcome = single ? factor_float(&f, data.at, scale.at, kept, update.at, &wanted, NULL, NULL)
                     : factor_double(&f, data.at, scale.at, kept, update.at, &wanted, wish, rounded);
    Py_END_ALLOW_THREADS
    if (outcome == -1) PyErr_NoMemory();
    return outcome >= 0 ? PyBool_FromLong(outcome) : NULL;
}
CALL(factor)

/* substitute(fronts, L, X, single, way): X (k, N), in the order of L's rows, is overwritten by the
 * solution of L L^T, if way > 0 of L, if way < 0 of L^T */
static PyObject *substitute_of(Held *held, PyObject *args)
{
    PyObject *tuple, *known, *right;
    Fronts f;
    int single, way, outcome;
    if (!PyArg_ParseTuple(args, "OOOpi", &tuple, &known, &right, &single, &way)) return NULL;
    Array L = {held, single ? FLOATS : DOUBLES}, X = {held, L.kind, WRITTEN};
    if (!fronts_of(held, tuple, &f) || !array(known, &L) || !array(right, &X)) return NULL;
    Int N = f.offset[f.n];
    if (!N || L.length != f.panel[f.many] || X.length % N)
        return refuse("a factor or right-hand side of another matrix");
    Py_BEGIN_ALLOW_THREADS
    outcome = single ? substitute_float(&f, L.at, X.at, X.length / N, way)
                     : substitute_double(&f, L.at, X.at, X.length / N, way);
    Py_END_ALLOW_THREADS
    return outcome < 0 ? PyErr_NoMemory() : Py_NewRef(Py_None);
}
CALL(substitute)

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
    if (!fronts_of(held, tuple, &f) || !array(known, &L)) return NULL;
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
        !fronts_of(held, tuple, &f))
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
        !fronts_of(held, tuple, &f))
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

/* ------------------------------------------------------------------ edges */

#include "edges.h"

/* The graph of a tuple (pairs, P, K | None, kappa, tau | None, moved | None, arms | None). */
static int edges_of(Held *held, PyObject *tuple, Int d, Edges *g)
{
    if (d != 2 && d != 3) return refuse("graphs are in 2 or 3 dimensions") != NULL;
    const double **fields[] = {&g->P, &g->K, &g->kappa, &g->tau, &g->moved, &g->arms};
    Int lengths[] = {d * d, d * d, 1, 1, d, d};
    Array a[7] = {{held, INTS}};
    for (int k = 1; k < 7; k++) a[k] = (Array){held, DOUBLES, OPTIONAL};
    if (!arrays_of(tuple, a, 7)) return 0;
    g->pairs = a[0].at, g->m = a[0].length / 2, g->d = d;
    for (int k = 0; k < 6; k++) {
        *fields[k] = a[k + 1].at;
        if (a[k + 1].at && a[k + 1].length != g->m * lengths[k])
            return refuse("arrays of edges differ in length") != NULL;
    }
    if (!g->P || !(g->K || g->kappa) || (g->tau && !g->moved))
        return refuse("measured rotations, their weights, and with tau translations expected") != NULL;
    return 1;
}

/* Calls function(..., d, ...) with d as a constant, for which it is compiled. */
#define IN_SPACE(d, call_of_2, call_of_3) \
    Py_BEGIN_ALLOW_THREADS                \
    if (d == 3)                           \
        call_of_3;                        \
    else                                  \
        call_of_2;                        \
    Py_END_ALLOW_THREADS

/* worst_defect(R, d) -> index and size: see `certpgo.linalg.so.worst_defect` */
static PyObject *worst_defect_of(Held *held, PyObject *args)
{
    Array R = {held, DOUBLES};
    int d;
    if (!PyArg_ParseTuple(args, "O&i", array, &R, &d)) return NULL;
    if (d < 2 || d > 3 || R.length % (d * d)) return refuse("matrices of 2 or 3 rows expected");
    double largest;
    Int worst = d == 3 ? farthest(R.length / 9, 3, R.at, &largest)
                       : farthest(R.length / 4, 2, R.at, &largest);
    return Py_BuildValue("Ld", (long long)worst, largest);
}
CALL(worst_defect)

/* turn(R, v, d, left, out): R exp(v), or exp(v) R, of tangents (n, p) */
static PyObject *turn_of(Held *held, PyObject *args)
{
    Array R = {held, DOUBLES}, v = {held, DOUBLES}, out = {held, DOUBLES, WRITTEN};
    int d, left;
    if (!PyArg_ParseTuple(args, "O&O&ipO&", array, &R, array, &v, &d, &left, array, &out))
        return NULL;
    Int p = d == 2 ? 1 : 3, n = v.length / p;
    if (d < 2 || d > 3 || v.length != n * p || R.length != n * d * d || out.length != R.length)
        return refuse("as many rotations as tangents in 2 or 3 dimensions expected");
    IN_SPACE(d, turn_by(n, 2, R.at, v.at, left, out.at), turn_by(n, 3, R.at, v.at, left, out.at))
    return Py_NewRef(Py_None);
}
CALL(turn)

/* gradient(edges, d, r, R, t | None, G | None, terms): G is added to */
static PyObject *gradient_of(Held *held, PyObject *args)
{
    PyObject *tuple;
    Array R = {held, DOUBLES}, t = {held, DOUBLES, OPTIONAL};
    Array G = {held, DOUBLES, WRITTEN | OPTIONAL}, terms = {held, DOUBLES, WRITTEN};
    Edges g;
    int d, r;
    if (!PyArg_ParseTuple(args, "OiiO&O&O&O&", &tuple, &d, &r, array, &R, array, &t, array, &G,
                          array, &terms) ||
        !edges_of(held, tuple, d, &g))
        return NULL;
    Int n = r > 0 && r <= 32 ? R.length / (r * d) : 0;
    if (r < 1 || r > 32 || n * r * d != R.length || !all_below(g.pairs, 2 * g.m, n) ||
        terms.length != g.m || (G.at && G.length != n * r * (d + (g.tau != NULL))) ||
        (g.tau && t.length != n * r))
        return refuse("points of another graph, or of a rank above 32");
    Py_BEGIN_ALLOW_THREADS
    if (d == 3 && r == 3)
        differentiate(&g, 3, 3, R.at, t.at, G.at, terms.at);
    else if (d == 2 && r == 2)
        differentiate(&g, 2, 2, R.at, t.at, G.at, terms.at);
    else
        differentiate(&g, d, r, R.at, t.at, G.at, terms.at);
    Py_END_ALLOW_THREADS
    return Py_NewRef(Py_None);
}
CALL(gradient)

/* first_order(edges, d, R, t | None, turning, moving | None, tangent, multipliers, terms) -> the
 * stationarity: see `certpgo.objective.operators.first_order` */
static PyObject *first_order_of(Held *held, PyObject *args)
{
    PyObject *tuple;
    Array R = {held, DOUBLES}, t = {held, DOUBLES, OPTIONAL}, turning = {held, DOUBLES}, moving = t;
    Array tangent = {held, DOUBLES, WRITTEN}, multipliers = tangent, terms = tangent;
    Edges g;
    int d;
    if (!PyArg_ParseTuple(args, "OiO&O&O&O&O&O&O&", &tuple, &d, array, &R, array, &t, array,
                          &turning, array, &moving, array, &tangent, array, &multipliers, array,
                          &terms) ||
        !edges_of(held, tuple, d, &g))
        return NULL;
    Int n = turning.length, move = g.tau != NULL, b = (d == 2 ? 1 : 3) + (move ? d : 0);
    if (R.length != n * d * d || !all_below(g.pairs, 2 * g.m, n) || terms.length != g.m ||
        (move && t.length != n * d) || (moving.at && moving.length != n) ||
        tangent.length != n * b || multipliers.length != R.length)
        return refuse("points of another graph");
    double *G = memory(held, n * d * (d + move), sizeof(double)), largest;
    if (!G) return NULL;
    memset(G, 0, (size_t)(n * d * (d + move)) * sizeof(double));
    const Stiffness stiffness = {turning.at, moving.at};
    IN_SPACE(d,
             (differentiate(&g, 2, 2, R.at, t.at, G, terms.at),
              largest = project(n, 2, move, R.at, G, &stiffness, tangent.at, multipliers.at)),
             (differentiate(&g, 3, 3, R.at, t.at, G, terms.at),
              largest = project(n, 3, move, R.at, G, &stiffness, tangent.at, multipliers.at)))
    return PyFloat_FromDouble(largest);
}
CALL(first_order)

/* hessian(edges, d, R, multipliers, spread, first | None, degree | None, diagonal, upper): blocks of
 * the Hessian */
static PyObject *hessian_of(Held *held, PyObject *args)
{
    PyObject *tuple;
    Array R = {held, DOUBLES}, multipliers = R, spread = R;
    Array first = {held, DOUBLES, OPTIONAL}, degree = first;
    Array diagonal = {held, DOUBLES, WRITTEN}, upper = diagonal;
    Edges g;
    int d;
    if (!PyArg_ParseTuple(args, "OiO&O&O&O&O&O&O&", &tuple, &d, array, &R, array, &multipliers,
                          array, &spread, array, &first, array, &degree, array, &diagonal, array,
                          &upper) ||
        !edges_of(held, tuple, d, &g))
        return NULL;
    Int n = R.length / (d * d), b = (d == 2 ? 1 : 3) + (g.tau ? d : 0);
    if (upper.length != g.m * b * b || diagonal.length != n * b * b || R.length != n * d * d ||
        !all_below(g.pairs, 2 * g.m, n) || spread.length != R.length ||
        multipliers.length != R.length ||
        (g.tau && (first.length != n * d || degree.length != n)))
        return refuse("blocks of another graph");
    const Nodes nodes = {n, spread.at, multipliers.at, first.at, degree.at};
    IN_SPACE(d,
             (couple(&g, 2, R.at, upper.at), restrict_to_tangents(&nodes, g.tau != NULL, 2, R.at, diagonal.at)),
             (couple(&g, 3, R.at, upper.at), restrict_to_tangents(&nodes, g.tau != NULL, 3, R.at, diagonal.at)))
    return Py_NewRef(Py_None);
}
CALL(hessian)

/* angles(edges, d, R, angles): of the edges' residual rotations */
static PyObject *angles_of(Held *held, PyObject *args)
{
    PyObject *tuple;
    Array R = {held, DOUBLES}, angles = {held, DOUBLES, WRITTEN};
    Edges g;
    int d;
    if (!PyArg_ParseTuple(args, "OiO&O&", &tuple, &d, array, &R, array, &angles) ||
        !edges_of(held, tuple, d, &g))
        return NULL;
    if (angles.length != g.m || !g.kappa || !all_below(g.pairs, 2 * g.m, R.length / (d * d)))
        return refuse("rotations of another graph");
    IN_SPACE(d, measure_angles(&g, 2, R.at, angles.at), measure_angles(&g, 3, R.at, angles.at))
    return Py_NewRef(Py_None);
}
CALL(angles)

/* residuals(edges, d, R, t | None, turned, moved | None): norms of the edges' residuals */
static PyObject *residuals_of(Held *held, PyObject *args)
{
    PyObject *tuple;
    Array R = {held, DOUBLES}, t = {held, DOUBLES, OPTIONAL};
    Array turned = {held, DOUBLES, WRITTEN}, moved = {held, DOUBLES, WRITTEN | OPTIONAL};
    Edges g;
    int d;
    if (!PyArg_ParseTuple(args, "OiO&O&O&O&", &tuple, &d, array, &R, array, &t, array, &turned,
                          array, &moved) ||
        !edges_of(held, tuple, d, &g))
        return NULL;
    Int n = R.length / (d * d);
    if (turned.length != g.m || !all_below(g.pairs, 2 * g.m, n) ||
        (moved.at && (moved.length != g.m || !g.moved || t.length != n * d)))
        return refuse("an estimate of another graph");
    IN_SPACE(d, measure_residuals(&g, 2, R.at, t.at, turned.at, moved.at),
             measure_residuals(&g, 3, R.at, t.at, turned.at, moved.at))
    return Py_NewRef(Py_None);
}
CALL(residuals)

/* lessen(shift, G | None, Y, nodes, d, multipliers): see `certpgo.certify.shifted.Shifted.less` */
static PyObject *lessen_of(Held *held, PyObject *args)
{
    Array G = {held, DOUBLES, OPTIONAL}, Y = {held, DOUBLES}, nodes = {held, INTS};
    Array multipliers = {held, DOUBLES, WRITTEN};
    double shift;
    int d;
    if (!PyArg_ParseTuple(args, "dO&O&O&iO&", &shift, array, &G, array, &Y, array, &nodes, &d, array,
                          &multipliers))
        return NULL;
    Int n = d == 2 || d == 3 ? multipliers.length / (d * d) : 0, r = n ? Y.length / (n * d) : 0;
    if (d < 2 || d > 3 || r > 32 || multipliers.length != n * d * d || Y.length != n * r * d ||
        (G.at && G.length != r * r) || !all_below(nodes.at, nodes.length, n))
        return refuse("multipliers of other nodes, or a rank above 32");
    take_off(nodes.length, nodes.at, r, d, Y.at, G.at, shift, multipliers.at);
    return Py_NewRef(Py_None);
}
CALL(lessen)

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
        values.length != n * d * d || into.length != indptr[n] * b * b ||
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
    Int entries = (Int)b * b;
    if (!are_pointers(indptr, pointers.length, blocks.length) || b < 1 ||
        into.length % entries || into.length / entries != blocks.length)
        return refuse("rows of another pattern");
    for (Int i = 0; i + 1 < pointers.length; i++)
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

/* lever_sums(edges, d, sums): sums (n, 4), zero before, of tau |b| at i and tau |a| at j, of tau |b|
 * and tau |a| times |a| + |b| there, of tau |b| at j and tau |a| at i, and of tau at both, with 1-norms */
static PyObject *lever_sums_of(Held *held, PyObject *args)
{
    PyObject *tuple;
    Array into = {held, DOUBLES, WRITTEN};
    Edges g;
    int d;
    if (!PyArg_ParseTuple(args, "OiO&", &tuple, &d, array, &into) || !edges_of(held, tuple, d, &g))
        return NULL;
    if (!g.tau || into.length % 4 || !all_below(g.pairs, 2 * g.m, into.length / 4))
        return refuse("sums at the nodes of a graph of poses expected");
    double *sums = into.at;
    for (Int e = 0; e < g.m; e++) {
        double tau = fabs(g.tau[e]), b = 0.0, a = 0.0;
        for (Int k = 0; k < d; k++) b += fabs(g.moved[e * d + k]);
        for (Int k = 0; k < d && g.arms; k++) a += fabs(g.arms[e * d + k]);
        for (int end = 0; end < 2; end++) {
            double *at = sums + 4 * g.pairs[2 * e + end], own = end ? a : b, other = end ? b : a;
            at[0] += tau * own;
            at[1] += tau * own * (a + b);
            at[2] += tau * other;
            at[3] += tau;
        }
    }
    return Py_NewRef(Py_None);
}
CALL(lever_sums)

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

/* ------------------------------------------------------------------ trees */

#include "trees.h"

/* central_tree(pairs, parents): the breadth-first tree of a node in the middle of a long path */
static PyObject *central_tree_of(Held *held, PyObject *args)
{
    Array pairs = {held, INTS}, into = {held, INTS, WRITTEN};
    if (!PyArg_ParseTuple(args, "O&O&", array, &pairs, array, &into)) return NULL;
    Int n = into.length, ends = pairs.length, *parents = into.at;
    if (n < 1 || ends % 2 || !all_below(pairs.at, ends, n))
        return refuse("pairs of the nodes that have parents expected");
    Int *queue = memory(held, 2 * n + 1 + 2 * ends, sizeof(Int)), length = 0;
    if (!queue) return NULL;
    Int *start = queue + n, *to = start + n + 1, *arcs = to + ends;
    list_neighbours(n, ends / 2, pairs.at, start, to, queue, arcs);
    Int end = breadth_first(n, start, to, 0, parents, queue);
    Int middle = breadth_first(n, start, to, end, parents, queue);
    for (Int i = middle; i != end; i = parents[i]) length++;
    for (Int k = 0; k < (length + 1) / 2; k++) middle = parents[middle];
    breadth_first(n, start, to, middle, parents, queue);
    return Py_NewRef(Py_None);
}
CALL(central_tree)

/* compose(edges, d, parents, R, t | None): poses of the edges between children and parents, composed */
static PyObject *compose_of(Held *held, PyObject *args)
{
    PyObject *tuple;
    Array above = {held, INTS}, R = {held, DOUBLES, WRITTEN}, t = {held, DOUBLES, WRITTEN | OPTIONAL};
    Edges g;
    int d, is_forest, is_known = 1;
    if (!PyArg_ParseTuple(args, "OiO&O&O&", &tuple, &d, array, &above, array, &R, array, &t) ||
        !edges_of(held, tuple, d, &g))
        return NULL;
    const Int *parents = above.at;
    Int n = above.length;
    for (Int i = 0; i < n; i++) is_known &= parents[i] < n;
    if (R.length != n * d * d || (t.at && (t.length != n * d || !g.moved)) || !is_known ||
        !g.kappa || !all_below(g.pairs, 2 * g.m, n))
        return refuse("parents and poses in 2 or 3 dimensions of the same nodes expected");
    Int *path = memory(held, n, sizeof(Int) + 1);
    if (!path) return NULL;
    char *composed = (char *)(path + n);
    is_forest = take_steps(&g, n, parents, d, R.at, t.at, path);
    if (is_forest)
        is_forest = d == 3 ? compose_poses(n, parents, 3, R.at, t.at, path, composed)
                           : compose_poses(n, parents, 2, R.at, t.at, path, composed);
    return is_forest ? Py_NewRef(Py_None) : refuse("parents are not those of trees");
}
CALL(compose)

static PyMethodDef methods[] = {
    {"central_tree", central_tree, METH_VARARGS, "Parents in the tree of a central node."},
    {"compose", compose, METH_VARARGS, "Poses composed along a tree."},
    {"worst_defect", worst_defect, METH_VARARGS, "The matrix farthest from being a rotation."},
    {"gradient", gradient, METH_VARARGS, "Half the gradient, and the edges' terms."},
    {"first_order", first_order, METH_VARARGS, "Derivatives along the rotations."},
    {"hessian", hessian, METH_VARARGS, "Blocks of the Hessian."},
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
    {"multiply", multiply, METH_VARARGS, "A x."},
    {"lower", lower, METH_VARARGS, "L by columns."},
    {"order", order, METH_VARARGS, "A fill-reducing order of a pattern."},
    {"analyze", analyze, METH_VARARGS, "Order, counts and supernodes of a pattern."},
    {"measure", measure, METH_VARARGS, "Places of panels, and memory needed."},
    {"factor", factor, METH_VARARGS, "Factorize; False if the matrix is not positive definite."},
    {"substitute", substitute, METH_VARARGS, "Solve with L or L^T in place."},
    {"solve", solve, METH_VARARGS, "A^-1 B."},
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
