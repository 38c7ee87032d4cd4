/* Calls from Python: their arrays and memory, given back when they return, and checks of numbers. */

/* What a call holds until it returns: buffers of arrays, and memory. */
typedef struct {
    Py_buffer views[64];
    void *blocks[8];
    int count, many;
} Held;

/* What arrays consist of. */
typedef enum { INTS, SHORT_INTS, DOUBLES, FLOATS, WIDES, REALS, NUMBERS } Kind;
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
    void *block = held->many < 8 ? malloc((size_t)(count + 1) * size) : NULL;
    if (block)
        held->blocks[held->many++] = block;
    else
        PyErr_NoMemory();
    return block;
}

static int is_of(const Py_buffer *view, Kind kind)
{
    static const char *const letters[] = {"lq", "il", "d", "f", "g"};
    static const Py_ssize_t sizes[] = {8, 4, 8, 4, sizeof(long double)};
    if (kind == REALS) return is_of(view, DOUBLES) || is_of(view, FLOATS);
    if (kind == NUMBERS) return is_of(view, DOUBLES) || is_of(view, WIDES);
    const char *format = view->format ? view->format : "B";
    return view->itemsize == sizes[kind] && format[0] && !format[1] &&
           strchr(letters[kind], format[0]) != NULL;
}

/* Converts an argument to the `Array` at an address: for PyArg_ParseTuple's O&. */
static int array(PyObject *object, void *address)
{
    static const char *const names[] = {"int64",   "int32",      "float64", "float32",
                                        "longdouble", "floats", "numbers"};
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
