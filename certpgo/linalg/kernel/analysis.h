/* The elimination tree, its supernodes and their rows, of a graph of nodes.
 *
 * Nodes are numbered in elimination order, but in `indptr` and `indices`.
 */

/* Supernodes of up to these many nodes are merged with their parent if at most this share of the
 * result is zeros; the last applies to all. */
static const Int MERGED[] = {2, 4, 8};
static const double ZEROS[] = {1.0, 0.3, 0.08, 0.02};

static int compare(const void *a, const void *b)
{
    Int x = *(const Int *)a, y = *(const Int *)b;
    return (x > y) - (x < y);
}

/* Sort in place: most lists are so short that calls of qsort's would take most of the time. */
static void ascend(Int *values, Int count)
{
    if (count > 40) {
        qsort(values, (size_t)count, sizeof(Int), compare);
        return;
    }
    for (Int k = 1; k < count; k++) {
        Int value = values[k], at = k;
        for (; at && values[at - 1] > value; at--) values[at] = values[at - 1];
        values[at] = value;
    }
}

static int is_merged(Int columns, double zeros, double entries)
{
    int k = 0;
    while (k < 3 && columns > MERGED[k]) k++;
    return zeros <= ZEROS[k] * entries;
}

/* The elimination tree in a given order (Liu 1990): `place` is the order's inverse. */
static void elimination_tree(Int n, const Int *indptr, const Int *indices, const Int *order,
                             const Int *place, Int *parent, Int *ancestor)
{
    for (Int k = 0; k < n; k++) {
        parent[k] = ancestor[k] = -1;
        for (Int e = indptr[order[k]]; e < indptr[order[k] + 1]; e++) {
            for (Int i = place[indices[e]]; i >= 0 && i < k;) {
                Int next = ancestor[i];
                ancestor[i] = k;
                if (next < 0) parent[i] = k;
                i = next;
            }
        }
    }
}

/* Renumber in postorder: `order`, `place` and `parent` are replaced. */
static void postorder(Int n, Int *order, Int *place, Int *parent, Int *first, Int *next, Int *post)
{
    for (Int k = 0; k < n; k++) first[k] = -1;
    for (Int k = n - 1; k >= 0; k--)
        if (parent[k] >= 0) next[k] = first[parent[k]], first[parent[k]] = k;
    Int count = 0;
    for (Int root = 0; root < n; root++) {
        if (parent[root] >= 0) continue;
        for (Int k = root;;) {
            while (first[k] >= 0) k = first[k];
            post[k] = count++;
            if (k == root) break;
            Int up = parent[k];
            first[up] = next[k];
            k = up;
        }
    }
    for (Int k = 0; k < n; k++) first[post[k]] = order[k], next[post[k]] = parent[k];
    for (Int k = 0; k < n; k++) {
        order[k] = first[k];
        place[order[k]] = k;
        parent[k] = next[k] < 0 ? -1 : post[next[k]];
    }
}

/* Nonzeros of L's columns without the diagonal, and of its rows with it, weighted by sizes. */
static void count(Int n, const Int *indptr, const Int *indices, const Int *order, const Int *place,
                  const Int *parent, const Int *sizes, Int *columns, Int *rows, Int *mark)
{
    for (Int k = 0; k < n; k++) columns[k] = 0, mark[k] = -1;
    for (Int k = 0; k < n; k++) {
        mark[k] = k;
        rows[k] = sizes[order[k]];
        for (Int e = indptr[order[k]]; e < indptr[order[k] + 1]; e++)
            for (Int i = place[indices[e]]; i < k && mark[i] != k; i = parent[i]) {
                mark[i] = k;
                columns[i]++;
                rows[k] += sizes[order[i]];
            }
    }
}

/* First nodes of supernodes, merged where that adds few zeros; returns their number. */
static Int supernodes(Int n, const Int *parent, const Int *columns, Int *start, Int *of, Int *scratch)
{
    Int many = 0;
    for (Int k = 0; k < n; k++) {
        if (!(k && parent[k - 1] == k && columns[k - 1] == columns[k] + 1)) start[many++] = k;
        of[k] = many - 1;
    }
    start[many] = n;
    /* Of the merged supernode that begins with s: its columns, rows of the first, entries, zeros. */
    Int *up = scratch, *width = scratch + n, *height = scratch + 2 * n, *zeros = scratch + 3 * n;
    for (Int s = many - 1; s >= 0; s--) {
        width[s] = start[s + 1] - start[s];
        height[s] = columns[start[s]] + 1;
        zeros[s] = 0;
        up[s] = -1; /* the supernode that took this one in */
        Int last = parent[start[s + 1] - 1], p = last < 0 ? -1 : of[last];
        while (p >= 0 && up[p] >= 0) p = up[p];
        if (p != s + 1) continue;
        Int all = width[s] + width[p], tall = width[s] + height[p];
        double added = (double)width[s] * (double)(tall - height[s]) + (double)zeros[p];
        double entries = 0.5 * (double)all * (double)(all + 1) + (double)all * (double)(tall - all);
        if (!is_merged(all, added, entries)) continue;
        up[p] = s;
        width[s] = all, height[s] = tall, zeros[s] = (Int)added;
    }
    Int kept = 0;
    for (Int s = 0; s < many; s++)
        if (up[s] < 0) start[kept++] = start[s];
    start[kept] = n;
    for (Int s = 0; s < kept; s++)
        for (Int k = start[s]; k < start[s + 1]; k++) of[k] = s;
    return kept;
}

/* Rows below each supernode, ascending; returns them, with `begin` where those of each begin. */
static Int *structure(Int n, const Int *indptr, const Int *indices, const Int *order,
                      const Int *place, Int many, const Int *start, const Int *of, Int *above,
                      Int *begin, Int *mark)
{
    Int capacity = 4 * n + 16, used = 0;
    Int *rows = malloc((size_t)capacity * sizeof(Int));
    Int *first = malloc((size_t)(2 * many + 1) * sizeof(Int)), *next = first + many;
    if (!rows || !first) goto failed;
    for (Int k = 0; k < n; k++) mark[k] = -1;
    for (Int s = 0; s < many; s++) first[s] = -1;
    for (Int s = 0; s < many; s++) {
        Int last = start[s + 1] - 1;
        begin[s] = used;
        if (capacity - used < n - last) { /* at most all later nodes */
            capacity = 2 * capacity + n;
            Int *more = realloc(rows, (size_t)capacity * sizeof(Int));
            if (!more) goto failed;
            rows = more;
        }
        for (Int c = first[s]; c >= 0; c = next[c])
            for (Int e = begin[c]; e < begin[c + 1]; e++)
                if (rows[e] > last && mark[rows[e]] != s) mark[rows[e]] = s, rows[used++] = rows[e];
        for (Int k = start[s]; k <= last; k++)
            for (Int e = indptr[order[k]]; e < indptr[order[k] + 1]; e++) {
                Int i = place[indices[e]];
                if (i > last && mark[i] != s) mark[i] = s, rows[used++] = i;
            }
        ascend(rows + begin[s], used - begin[s]);
        begin[s + 1] = used;
        above[s] = used > begin[s] ? of[rows[begin[s]]] : -1;
        if (above[s] >= 0) next[s] = first[above[s]], first[above[s]] = s;
    }
    free(first);
    return rows;
failed:
    free(rows);
    free(first);
    return NULL;
}

