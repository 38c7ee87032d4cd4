/* Lines of text: a tag, ids, numbers, and the rest. Anything unusual is left to Python. */

/* What `long double` adds to doubles: 11 bits tell how a decimal rounds. */
#define WIDE_ENOUGH (LDBL_MANT_DIG >= 64)
/* Digits of an integer that fits 64 bits, and powers of ten that are exact in 64 bits. */
#define DIGITS 19
#define EXACT_POWER (WIDE_ENOUGH ? 27 : 22)
/* Exponents are counted up to here: no text has as many decimals to make up for what is beyond. */
#define FAR_POWER 100000000000000000

static int is_space(char c) { return c == ' ' || c == '\t' || c == '\r'; }
static int is_digit(char c) { return c >= '0' && c <= '9'; }

static const char *after_spaces(const char *at, const char *end)
{
    while (at < end && is_space(*at)) at++;
    return at;
}

/* The end of an integer of at most 18 digits; NULL if there is anything else. */
static const char *read_integer(const char *at, const char *end, Int *value)
{
    int negative = at < end && *at == '-';
    if (at < end && (*at == '-' || *at == '+')) at++;
    const char *first = at;
    Int sum = 0;
    while (at < end && is_digit(*at) && at - first < DIGITS - 1) sum = 10 * sum + (*at++ - '0');
    if (at == first || (at < end && !is_space(*at))) return NULL;
    *value = negative ? -sum : sum;
    return at;
}

/* Whether m 10^power is known as it rounds to a double: exactly, or far enough from halfway. */
static int rounds(uint64_t m, Int power, double *value)
{
    static const double tens[] = {1e0,  1e1,  1e2,  1e3,  1e4,  1e5,  1e6,  1e7,
                                  1e8,  1e9,  1e10, 1e11, 1e12, 1e13, 1e14, 1e15,
                                  1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22};
    if (power < -EXACT_POWER || power > EXACT_POWER) return 0;
    Int size = power < 0 ? -power : power;
    if (m <= (uint64_t)1 << 53 && size <= 22) {
        *value = power < 0 ? (double)m / tens[size] : (double)m * tens[size];
        return 1;
    }
    if (!WIDE_ENOUGH) return 0;
    long double ten = tens[size > 22 ? 22 : size];
    if (size > 22) ten *= (long double)tens[size - 22];
    long double wide = power < 0 ? (long double)m / ten : (long double)m * ten;
    *value = (double)(wide - wide * 0x1p-63L);
    return *value == (double)(wide + wide * 0x1p-63L);
}

/* The end of a finite decimal number, rounded as Python rounds it; NULL if there is anything else. */
static const char *read_number(const char *at, const char *end, double *value)
{
    const char *start = at;
    int negative = at < end && *at == '-';
    Int digits = 0, decimals = 0, power = 0;
    if (at < end && (*at == '-' || *at == '+')) at++;
    uint64_t m = 0;
    int any = 0, point = 0;
    for (; at < end; at++) {
        if (*at == '.' && !point) {
            point = 1;
            continue;
        }
        if (!is_digit(*at)) break;
        any = 1;
        if (digits || *at != '0') digits++;
        if (digits <= DIGITS) m = 10 * m + (uint64_t)(*at - '0');
        decimals += point;
    }
    if (!any) return NULL;
    if (at < end && (*at == 'e' || *at == 'E')) {
        int below = ++at < end && *at == '-';
        if (at < end && (*at == '-' || *at == '+')) at++;
        const char *first = at;
        while (at < end && is_digit(*at)) {
            if (power < FAR_POWER) power = 10 * power + (*at - '0');
            at++;
        }
        if (at == first) return NULL;
        if (below) power = -power;
    }
    if (at < end && !is_space(*at)) return NULL;
    if (digits <= DIGITS && rounds(m, power - decimals, value)) {
        if (negative) *value = -*value;
        return at;
    }
    char *stop;
    *value = PyOS_string_to_double(start, &stop, NULL);
    if (PyErr_Occurred()) PyErr_Clear();
    return stop == at && isfinite(*value) ? at : NULL;
}

/* An array that grows. */
typedef struct {
    char *at;
    size_t size, room;
} Growing;

/* Room for more bytes at the end; NULL and an exception if there is none. */
static void *more(Growing *g, size_t size)
{
    if (!g->at || g->size + size > g->room) {
        size_t room = 2 * (g->size + size) + 256;
        char *at = realloc(g->at, room);
        if (!at) return PyErr_NoMemory();
        g->at = at;
        g->room = room;
    }
    g->size += size;
    return g->at + g->size - size;
}

/* The lines with one tag: their numbers, ids, numbers, and which of the distinct rests each has. */
typedef struct {
    const char *tag;
    Py_ssize_t length;
    int ids, numbers;
    Growing lines, integers, doubles, which;
    PyObject *distinct, *known;
    const char *last; /* the rest of the line before */
    Py_ssize_t last_length;
    Int last_which;
} Tagged;

/* The number of a text among the distinct ones; -1 and an exception without memory. */
static Int number_of(Tagged *t, const char *at, Py_ssize_t length)
{
    if (t->last && length == t->last_length && !memcmp(at, t->last, (size_t)length))
        return t->last_which;
    t->last = at;
    t->last_length = length;
    PyObject *text = PyBytes_FromStringAndSize(at, length);
    if (!text) return -1;
    PyObject *known = PyDict_GetItemWithError(t->known, text);
    Int which = known ? PyLong_AsLongLong(known) : (Int)PyList_Size(t->distinct);
    if (!known) {
        PyObject *number = PyErr_Occurred() ? NULL : PyLong_FromLongLong(which);
        if (!number || PyDict_SetItem(t->known, text, number) || PyList_Append(t->distinct, text))
            which = -1;
        Py_XDECREF(number);
    }
    Py_DECREF(text);
    return t->last_which = which;
}

/* Reads what follows the tag: 1; 0 if it is unusual; -1 and an exception without memory. */
static int read_tagged(Tagged *t, const char *at, const char *end, Int line)
{
    Int ids[4];
    double numbers[16];
    for (int k = 0; k < t->ids; k++)
        if (!(at = read_integer(after_spaces(at, end), end, &ids[k]))) return 0;
    for (int k = 0; k < t->numbers; k++)
        if (!(at = read_number(after_spaces(at, end), end, &numbers[k]))) return 0;
    at = after_spaces(at, end);
    Int which = number_of(t, at, end - at);
    if (which < 0) return -1;
    void *to[] = {more(&t->lines, sizeof line), more(&t->which, sizeof which),
                  more(&t->integers, (size_t)t->ids * sizeof(Int)),
                  more(&t->doubles, (size_t)t->numbers * sizeof(double))};
    const void *from[] = {&line, &which, ids, numbers};
    const size_t sizes[] = {sizeof line, sizeof which, (size_t)t->ids * sizeof(Int),
                            (size_t)t->numbers * sizeof(double)};
    for (int k = 0; k < 4; k++) {
        if (!to[k]) return -1;
        memcpy(to[k], from[k], sizes[k]);
    }
    return 1;
}

/* Reads all lines; those that are unusual, or have none of the tags, are appended to `rest`. */
static int read_text(Tagged *tagged, int count, const char *at, const char *end, Int line,
                     PyObject *rest)
{
    for (int last = 0; at < end; line++) {
        const char *stop = memchr(at, '\n', (size_t)(end - at));
        if (!stop) stop = end;
        const char *word = after_spaces(at, stop), *after = word;
        while (after < stop && !is_space(*after)) after++;
        int found = 0, k = last;
        for (int tried = 0; tried < count; tried++, k = (k + 1) % count)
            if (after - word == tagged[k].length &&
                !memcmp(word, tagged[k].tag, (size_t)tagged[k].length)) {
                found = read_tagged(&tagged[last = k], after, stop, line);
                break;
            }
        if (found < 0) return 0;
        if (!found && after > word) {
            PyObject *left = Py_BuildValue("Ly#", (long long)line, at, stop - at);
            int bad = !left || PyList_Append(rest, left);
            Py_XDECREF(left);
            if (bad) return 0;
        }
        at = stop + 1;
    }
    return 1;
}

static PyObject *bytes_from(const Growing *g)
{
    return PyByteArray_FromStringAndSize(g->at, (Py_ssize_t)g->size);
}

/* The text must end in a NUL, as that of bytes does. */
static PyObject *tagged_lines_of(Held *held, PyObject *args)
{
    PyObject *text, *tags, *result = NULL;
    long long line;
    if (!PyArg_ParseTuple(args, "SO!L", &text, &PyTuple_Type, &tags, &line)) return NULL;
    int count = (int)PyTuple_Size(tags);
    Tagged *tagged = memory(held, count, sizeof(Tagged));
    if (!tagged) return NULL;
    memset(tagged, 0, (size_t)(count + 1) * sizeof(Tagged));
    PyObject *rest = PyList_New(0), *all = PyList_New(0);
    int well = rest && all;
    for (int k = 0; well && k < count; k++) {
        Tagged *t = &tagged[k];
        well = PyArg_ParseTuple(PyTuple_GetItem(tags, k), "y#ii", &t->tag, &t->length, &t->ids,
                                &t->numbers);
        if (well && (t->ids < 0 || t->ids > 4 || t->numbers < 0 || t->numbers > 16))
            well = refuse("at most 4 ids and 16 numbers") != NULL;
        well = well && (t->distinct = PyList_New(0)) && (t->known = PyDict_New());
    }
    const char *at = PyBytes_AsString(text);
    well = well && read_text(tagged, count, at, at + PyBytes_Size(text), line, rest);
    for (int k = 0; k < count; k++) {
        Tagged *t = &tagged[k];
        PyObject *part = !well ? NULL
                               : Py_BuildValue("NNNNO", bytes_from(&t->lines),
                                               bytes_from(&t->integers), bytes_from(&t->doubles),
                                               bytes_from(&t->which), t->distinct);
        well = part && !PyList_Append(all, part);
        Py_XDECREF(part);
        Py_XDECREF(t->distinct);
        Py_XDECREF(t->known);
        free(t->lines.at);
        free(t->integers.at);
        free(t->doubles.at);
        free(t->which.at);
    }
    if (well) result = Py_BuildValue("OO", all, rest);
    Py_XDECREF(all);
    Py_XDECREF(rest);
    return result;
}

/* Numbers of texts, as many in each, and how long they are written; False if any is unusual. */
static PyObject *numbers_of(Held *held, PyObject *args)
{
    PyObject *texts;
    Array numbers = {held, DOUBLES, WRITTEN}, lengths = {held, INTS, WRITTEN};
    if (!PyArg_ParseTuple(args, "O!O&O&", &PyList_Type, &texts, array, &numbers, array, &lengths))
        return NULL;
    Py_ssize_t count = PyList_Size(texts), size = count ? numbers.length / count : 0;
    if (size * count != numbers.length || lengths.length != numbers.length)
        return refuse("as many numbers in each text expected");
    double *to = numbers.at;
    Int *length = lengths.at;
    for (Py_ssize_t k = 0; k < count; k++) {
        PyObject *text = PyList_GetItem(texts, k);
        const char *at = PyBytes_AsString(text);
        if (!at) return NULL;
        const char *end = at + PyBytes_Size(text);
        for (Py_ssize_t i = 0; i < size; i++) {
            const char *word = after_spaces(at, end);
            if (!(at = read_number(word, end, to++))) Py_RETURN_FALSE;
            *length++ = at - word;
        }
        if (after_spaces(at, end) != end) Py_RETURN_FALSE;
    }
    Py_RETURN_TRUE;
}

CALL(tagged_lines)
CALL(numbers)
