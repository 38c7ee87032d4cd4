/* Minimum degree on the quotient graph, by approximate external degrees.
 *
 * Amestoy, Davis, Duff, "An approximate minimum degree ordering algorithm" (1996). An eliminated
 * node becomes an element, whose variables are the rows below it; elements that are contained in
 * others are absorbed, and variables that cannot be told apart are eliminated together.
 */

typedef struct {
    Int n;
    Int *list;    /* of each variable: its elements, then its variables, from `begin` on */
    Int *begin;   /* (n,) */
    Int *elements, *length; /* (n,) entries that are elements; all entries */
    Int *weight;  /* (n,) variables that a variable stands for; 0 if another stands for it */
    Int *degree;  /* (n,) approximate external degree; of an element: weight of its variables */
    Int **within; /* (n,) variables of an element, or NULL */
    Int *many;    /* (n,) their number */
    Int *head, *next, *previous; /* variables by degree */
    Int *last, *follow;          /* (n,) members of a variable, linked */
} Quotient;

static void put(Quotient *q, Int i)
{
    Int d = q->degree[i], other = q->head[d];
    q->next[i] = other, q->previous[i] = -1, q->head[d] = i;
    if (other >= 0) q->previous[other] = i;
}

static void take(Quotient *q, Int i)
{
    if (q->next[i] >= 0) q->previous[q->next[i]] = q->previous[i];
    if (q->previous[i] >= 0)
        q->next[q->previous[i]] = q->next[i];
    else
        q->head[q->degree[i]] = q->next[i];
}

/* Variable i is eliminated with p. */
static void join(Quotient *q, Int p, Int i)
{
    q->weight[p] += q->weight[i];
    q->weight[i] = 0;
    q->follow[q->last[p]] = i;
    q->last[p] = q->last[i];
}

static void absorb(Quotient *q, Int e)
{
    free(q->within[e]);
    q->within[e] = NULL;
}

/* The variables of the element that p becomes; -1 without memory. */
static int make_element(Quotient *q, Int p, Int *mark, Int stamp)
{
    Int room = q->length[p] - q->elements[p], count = 0;
    const Int *list = q->list + q->begin[p];
    for (Int k = 0; k < q->elements[p]; k++) room += q->within[list[k]] ? q->many[list[k]] : 0;
    Int *found = malloc((size_t)(room + 1) * sizeof(Int));
    if (!found) return -1;
    mark[p] = stamp;
    for (Int k = 0; k < q->length[p]; k++) {
        int is_element = k < q->elements[p];
        Int e = list[k];
        if (is_element && !q->within[e]) continue;
        const Int *from = is_element ? q->within[e] : &list[k];
        for (Int l = 0; l < (is_element ? q->many[e] : 1); l++) {
            Int i = from[l];
            if (q->weight[i] > 0 && mark[i] != stamp) mark[i] = stamp, found[count++] = i;
        }
        if (is_element) absorb(q, e);
    }
    q->within[p] = found;
    q->many[p] = count;
    return 0;
}

/* What is left of the lists of variable i beside element p; returns the weight outside of p. */
static Int prune(Quotient *q, Int i, Int p, const Int *mark, Int stamp, const Int *outside,
                 const Int *seen, unsigned long long *hash)
{
    Int *list = q->list + q->begin[i], kept = 0, out = 0, old = q->elements[i];
    *hash = (unsigned long long)p;
    for (Int k = 0; k < old; k++) {
        Int e = list[k];
        if (!q->within[e]) continue;
        if (seen[e] == stamp && outside[e] == 0) {
            absorb(q, e); /* contained in p */
            continue;
        }
        out += outside[e];
        *hash += (unsigned long long)e;
        list[kept++] = e;
    }
    Int elements = kept;
    for (Int k = old; k < q->length[i]; k++) {
        Int j = list[k];
        if (q->weight[j] == 0 || mark[j] == stamp) continue;
        out += q->weight[j];
        *hash += (unsigned long long)j;
        list[kept++] = j;
    }
    /* There is room for p: an element, or a variable of p's, was dropped. */
    memmove(list + elements + 1, list + elements, (size_t)(kept - elements) * sizeof(Int));
    list[elements] = p;
    q->elements[i] = elements + 1;
    q->length[i] = kept + 1;
    return out;
}

/* Whether variables i and j have the same lists; `touched` marks those of i. */
static int are_alike(const Quotient *q, Int i, Int j, const Int *touched, Int stamp)
{
    if (q->length[i] != q->length[j] || q->elements[i] != q->elements[j]) return 0;
    for (Int k = 0; k < q->length[j]; k++)
        if (touched[q->list[q->begin[j] + k]] != stamp) return 0;
    return 1;
}

static int eliminate_all(Quotient *q, Int *order, Int *work, unsigned long long *hash)
{
    Int n = q->n, *mark = work, *seen = work + n, *outside = work + 2 * n, *touched = work + 3 * n;
    Int *bucket = work + 4 * n, *chain = work + 5 * n;
    Int lowest = 0, done = 0, placed = 0, marks = 0;
    unsigned long long slots = 1; /* a power of two: divisions would take a third of the time */
    while (2 * slots <= (unsigned long long)n) slots *= 2;
    for (Int i = 0; i < n; i++) mark[i] = seen[i] = touched[i] = bucket[i] = -1;
    while (done < n) {
        while (q->head[lowest] < 0) lowest++;
        Int p = q->head[lowest], stamp = p;
        take(q, p);
        if (make_element(q, p, mark, stamp) < 0) return -1;
        Int *variables = q->within[p], total = 0;
        for (Int k = 0; k < q->many[p]; k++) {
            Int i = variables[k];
            take(q, i);
            total += q->weight[i];
            const Int *list = q->list + q->begin[i];
            for (Int l = 0; l < q->elements[i]; l++) {
                Int e = list[l];
                if (!q->within[e]) continue;
                if (seen[e] != stamp) seen[e] = stamp, outside[e] = q->degree[e];
                outside[e] -= q->weight[i];
            }
        }
        q->degree[p] = total;
        /* p must not count as an element that is contained in itself. */
        Int left = 0;
        for (Int k = 0; k < q->many[p]; k++) {
            Int i = variables[k], out = prune(q, i, p, mark, stamp, outside, seen, &hash[i]);
            if (out == 0 && q->length[i] == 1) {
                total -= q->weight[i];
                join(q, p, i);
                continue;
            }
            /* The degree without i's own weight and that of p, which are added below. */
            q->degree[i] = out < q->degree[i] ? out : q->degree[i];
            Int slot = (Int)(hash[i] & (slots - 1));
            chain[i] = bucket[slot], bucket[slot] = i;
            variables[left++] = i;
        }
        q->many[p] = left;
        for (Int k = 0; k < left; k++) {
            Int slot = (Int)(hash[variables[k]] & (slots - 1)), i = bucket[slot];
            bucket[slot] = -1;
            for (; i >= 0; i = chain[i]) {
                if (q->weight[i] == 0) continue;
                Int compared = 0;
                for (Int j = chain[i]; j >= 0; j = chain[j]) {
                    if (q->weight[j] == 0 || hash[j] != hash[i]) continue;
                    if (!compared) {
                        for (Int l = 0; l < q->length[i]; l++)
                            touched[q->list[q->begin[i] + l]] = marks;
                        compared = 1;
                    }
                    if (are_alike(q, i, j, touched, marks)) join(q, i, j);
                }
                marks += compared;
            }
        }
        done += q->weight[p];
        Int kept = 0;
        for (Int k = 0; k < left; k++) {
            Int i = variables[k];
            if (q->weight[i] == 0) continue;
            Int most = n - done - q->weight[i], d = q->degree[i] + total - q->weight[i];
            q->degree[i] = d < most ? d : most;
            if (q->degree[i] < 0) q->degree[i] = 0;
            if (q->degree[i] < lowest) lowest = q->degree[i];
            put(q, i);
            variables[kept++] = i;
        }
        q->many[p] = kept;
        q->degree[p] = total;
        for (Int i = p;; i = q->follow[i]) {
            order[placed++] = i;
            if (i == q->last[p]) break;
        }
        q->weight[p] = 0;
        if (!kept) absorb(q, p);
    }
    return 0;
}

/* A fill-reducing order of the nodes; -1 without memory. */
static int minimum_degree(Int n, const Int *indptr, const Int *indices, Int *order)
{
    Int entries = indptr[n], outcome = -1;
    Int *work = malloc((size_t)(17 * n + entries + 1) * sizeof(Int));
    Int **within = calloc((size_t)n + 1, sizeof(Int *));
    unsigned long long *hash = malloc((size_t)(n + 1) * sizeof(*hash));
    if (work && within && hash) {
        Quotient q = {n, work + 17 * n, work, work + n, work + 2 * n, work + 3 * n, work + 4 * n,
                      within, work + 5 * n, work + 6 * n, work + 7 * n, work + 8 * n, work + 9 * n,
                      work + 10 * n};
        Int used = 0;
        for (Int i = 0; i < n; i++) q.head[i] = -1;
        for (Int i = n - 1; i >= 0; i--) {
            q.begin[i] = used;
            for (Int e = indptr[i]; e < indptr[i + 1]; e++)
                if (indices[e] != i) q.list[used++] = indices[e];
            q.elements[i] = 0;
            q.length[i] = q.degree[i] = used - q.begin[i];
            q.weight[i] = 1;
            q.last[i] = i;
            put(&q, i);
        }
        outcome = eliminate_all(&q, order, work + 11 * n, hash);
        for (Int i = 0; i < n; i++) free(within[i]);
    }
    free(work);
    free(within);
    free(hash);
    return outcome;
}
