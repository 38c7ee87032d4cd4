/* Balls: numbers with error bounds. `certpgo.linalg.ball_arithmetic` has the same in NumPy, with the
 * reasons; radii are doubles, and numbers doubles or of the wider format. */

#include <float.h>
#include <stddef.h>

#if FLT_EVAL_METHOD != 0
#error "balls need doubles that are rounded as doubles"
#endif

/* Dimensions of arrays at most, and arrays of a call. */
#define DIMENSIONS 6
#define OPERANDS 6
/* Rows of matrices that are eliminated, at most. */
#define LARGEST 8

/* Rounding of doubles, of radii, and a bound on underflow. */
#define ROUNDING (0.5 * DBL_EPSILON)
#define UP (1.0 + 16.0 * ROUNDING)
#define UNDERFLOWN 0x1p-1070

/* Steps through arrays of one shape, to which all are broadcast: bytes. */
typedef struct {
    int dimensions;
    Int shape[DIMENSIONS];
    Int strides[OPERANDS][DIMENSIONS];
    char *at[OPERANDS];
    int wide[OPERANDS]; /* whether it is of the wider format */
} Steps;

/* Where numbers of the wider format may begin. */
typedef struct {
    char first;
    long double wide;
} Aligned;

/* Adds one of the arrays, without its last `inner` dimensions; the first one gives the shape. */
static int step_through(Steps *steps, int k, const Py_buffer *view, int inner)
{
    int rest = view->ndim - inner;
    if (rest < 0 || rest > DIMENSIONS || (k && rest > steps->dimensions))
        return refuse("arrays of other dimensions") != NULL;
    if (!k) steps->dimensions = rest;
    int missing = steps->dimensions - rest;
    for (int a = 0; a < steps->dimensions; a++) {
        Int length = a < missing ? 1 : view->shape[a - missing];
        if (!k) steps->shape[a] = length;
        if (length != 1 && length != steps->shape[a])
            return refuse("arrays that cannot be broadcast") != NULL;
        steps->strides[k][a] = length == 1 ? 0 : view->strides[a - missing];
    }
    const char *format = view->format ? view->format : "B";
    int wide = !strcmp(format, "g") && view->itemsize == sizeof(long double);
    if (!wide && (strcmp(format, "d") || view->itemsize != sizeof(double)))
        return refuse("an array of doubles expected, or of the wider format") != NULL;
    Int unit = wide ? (Int)offsetof(Aligned, wide) : (Int)sizeof(double);
    Int odd = (Int)((uintptr_t)view->buf % (uintptr_t)unit);
    for (int a = 0; a < view->ndim; a++) odd |= view->strides[a] % unit;
    if (odd) return refuse("an array at even addresses expected") != NULL;
    steps->wide[k] = wide;
    steps->at[k] = view->buf;
    return 1;
}

/* Joins dimensions that all arrays pass through in equal steps. */
static void merge(Steps *s)
{
    int last = 0;
    for (int a = 1; a < s->dimensions; a++) {
        int joined = 1;
        if (s->shape[a] == 1) continue;
        for (int k = 0; k < OPERANDS; k++)
            joined &= s->strides[k][last] == s->strides[k][a] * s->shape[a];
        if (!joined && s->shape[last] != 1) last++;
        s->shape[last] = joined ? s->shape[last] * s->shape[a] : s->shape[a];
        for (int k = 0; k < OPERANDS; k++) s->strides[k][last] = s->strides[k][a];
    }
    for (; s->dimensions < 1; s->dimensions++) {
        s->shape[0] = 1;
        for (int k = 0; k < OPERANDS; k++) s->strides[k][0] = 0;
    }
    s->dimensions = last + 1;
}

/* The next row along the last dimension; false at the end. */
static int next_row(Steps *s, Int *index)
{
    for (int a = s->dimensions - 2; a >= 0; a--) {
        for (int k = 0; k < OPERANDS; k++) s->at[k] += s->strides[k][a];
        if (++index[a] < s->shape[a]) return 1;
        for (int k = 0; k < OPERANDS; k++) s->at[k] -= s->strides[k][a] * s->shape[a];
        index[a] = 0;
    }
    return 0;
}

typedef enum { SUM, PRODUCT, QUOTIENT, MATRICES } Operation;

/* Rows of matrices (p, q) and columns of (q, r), and the steps within matrices. */
typedef struct {
    Int p, q, r;
    Int rows[OPERANDS], columns[OPERANDS];
} Matrices;

static inline double double_at(const char *at, int wide)
{
    (void)wide;
    return *(const double *)at;
}

static inline long double wide_at(const char *at, int wide)
{
    return wide ? *(const long double *)at : (long double)*(const double *)at;
}

#define REAL double
#define IN(name) name##_double
#define READ_AT double_at
#include "ball_loops.h"
#undef REAL
#undef IN
#undef READ_AT

#define REAL long double
#define IN(name) name##_wide
#define READ_AT wide_at
#include "ball_loops.h"
#undef REAL
#undef IN
#undef READ_AT

/* combine(operation, unit, mid, radius, mid, radius, mid out, radius out): operations by their
 * letters + * / and @; `unit` is the rounding of the numbers */
static PyObject *combine(PyObject *self, PyObject *args)
{
    static const int order[OPERANDS] = {4, 5, 0, 1, 2, 3}; /* the results first */
    PyObject *objects[OPERANDS], *result = NULL;
    Py_buffer views[OPERANDS];
    const char *letter;
    double unit;
    int count = 0;
    if (!PyArg_ParseTuple(args, "sdOOOOOO", &letter, &unit, &objects[0], &objects[1], &objects[2],
                          &objects[3], &objects[4], &objects[5]))
        return NULL;
    Steps steps;
    Matrices of = {1, 1, 1, {0}, {0}};
    const char *known = strchr("+*/@", letter[0]);
    int inner = letter[0] == '@' ? 2 : 0, fits = letter[0] && !letter[1] && known != NULL;
    if (!fits) refuse("an operation + * / or @ expected");
    for (; fits && count < OPERANDS; count++) {
        int use = count < 2 ? PyBUF_WRITABLE : 0;
        if (PyObject_GetBuffer(objects[order[count]], &views[count],
                               PyBUF_FORMAT | PyBUF_STRIDES | use) < 0)
            goto done;
        fits = step_through(&steps, count, &views[count], inner);
    }
    if (!fits) goto done;
    for (int k = 0; k < OPERANDS && inner; k++) {
        const Py_buffer *v = &views[k];
        of.rows[k] = v->strides[v->ndim - 2], of.columns[k] = v->strides[v->ndim - 1];
        Int p = v->shape[v->ndim - 2], r = v->shape[v->ndim - 1];
        if (!k) of.p = p, of.r = r;
        if (k == 2) of.q = r;
        Int rows = k < 4 ? of.p : of.q, columns = k == 2 || k == 3 ? of.q : of.r;
        fits &= p == rows && r == columns;
    }
    if (steps.wide[1] || steps.wide[3] || steps.wide[5] ||
        (!steps.wide[0] && (steps.wide[2] || steps.wide[4])))
        fits = 0;
    for (int k = 2; k < OPERANDS; k++) /* a result is not read */
        fits &= views[k].buf != views[0].buf && views[k].buf != views[1].buf;
    if (!fits) {
        refuse("matrices or balls that do not fit together");
        goto done;
    }
    Py_BEGIN_ALLOW_THREADS
    if (steps.wide[0])
        combine_wide(&steps, known - "+*/@", &of, unit);
    else
        combine_double(&steps, known - "+*/@", &of, unit);
    Py_END_ALLOW_THREADS
    result = Py_NewRef(Py_None);
done:
    while (count) PyBuffer_Release(&views[--count]);
    return result;
}

/* polynomial(coefficients, unit, x, radii, mid, radius): values at balls (m,), of coefficients (k, 2) */
static PyObject *polynomial_of(Held *held, PyObject *args)
{
    Array coefficients = {held, DOUBLES}, x = {held, NUMBERS}, radii = {held, DOUBLES};
    Array mid = {held, NUMBERS, WRITTEN}, radius = {held, DOUBLES, WRITTEN};
    double unit;
    if (!PyArg_ParseTuple(args, "O&dO&O&O&O&", array, &coefficients, &unit, array, &x, array, &radii,
                          array, &mid, array, &radius))
        return NULL;
    Int m = x.length, k = coefficients.length / 2;
    if (coefficients.length % 2 || radii.length != m || mid.length != m || radius.length != m ||
        mid.itemsize != x.itemsize)
        return refuse("pairs of coefficients, balls, and room for as many expected");
    Py_BEGIN_ALLOW_THREADS
    if (x.itemsize != sizeof(double))
        evaluate_wide(m, k, coefficients.at, unit, x.at, radii.at, mid.at, radius.at);
    else
        evaluate_double(m, k, coefficients.at, unit, x.at, radii.at, mid.at, radius.at);
    Py_END_ALLOW_THREADS
    return Py_NewRef(Py_None);
}
CALL(polynomial)

/* eliminate(A, radii, count, unit, mid, radius, proven): matrices (m, p, p) to (m, p - count,
 * p - count); proven (m,) whether the leading blocks are proven positive definite */
static PyObject *eliminate_of(Held *held, PyObject *args)
{
    Array A = {held, NUMBERS}, radii = {held, DOUBLES}, mid = {held, NUMBERS, WRITTEN};
    Array radius = {held, DOUBLES, WRITTEN}, proven = {held, INTS, WRITTEN};
    double unit;
    int p, count;
    if (!PyArg_ParseTuple(args, "O&O&iidO&O&O&", array, &A, array, &radii, &p, &count, &unit, array,
                          &mid, array, &radius, array, &proven))
        return NULL;
    Int m = proven.length, q = p - count;
    if (p < 1 || p > LARGEST || count < 0 || q < 0 || A.length != m * p * p ||
        radii.length != A.length || mid.length != m * q * q || radius.length != mid.length ||
        mid.itemsize != A.itemsize)
        return refuse("small matrices in balls, and room for their complements expected");
    Py_BEGIN_ALLOW_THREADS
    if (A.itemsize != sizeof(double))
        complement_wide(m, p, count, unit, A.at, radii.at, mid.at, radius.at, proven.at);
    else
        complement_double(m, p, count, unit, A.at, radii.at, mid.at, radius.at, proven.at);
    Py_END_ALLOW_THREADS
    return Py_NewRef(Py_None);
}
CALL(eliminate)
