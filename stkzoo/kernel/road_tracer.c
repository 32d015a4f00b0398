/* Builds the line of the road ahead, with evenly spaced points, from a track's segments. */

#include "geometry.h"

enum { MOST_SEGMENTS = 128, MOST_POINTS = 2 * MOST_SEGMENTS + 1 };

/* Indices of `rules`. */
enum { POINT_SPACING, TOUCHING, LONGEST_JUMP, TAIL, NUM_RULES };

/* The segments ahead of a kart. */
typedef struct {
    npy_intp count;
    float starts[MOST_SEGMENTS][3], ends[MOST_SEGMENTS][3], widths[MOST_SEGMENTS];
} Segments;

/* ---------------------------------------------------------------- vectors */

/* Copies a vector of `width` numbers and returns 1. Returns 0 if it cannot be converted, with an
   exception set, or if it has another size, without an exception. */
static int read_vector(PyObject *vector, npy_intp width, float *out)
{
    PyArrayObject *array = (PyArrayObject *)vector;
    if (PyArray_CheckExact(vector) && PyArray_TYPE(array) == NPY_FLOAT32 &&
        PyArray_ISCARRAY_RO(array)) {
        Py_INCREF(vector);
    } else {
        array = (PyArrayObject *)PyArray_FROMANY(vector, NPY_FLOAT32, 0, 1,
                                                 NPY_ARRAY_CARRAY_RO | NPY_ARRAY_FORCECAST);
    }
    const int fits = array && PyArray_SIZE(array) == width;
    const float *data = fits ? PyArray_DATA(array) : NULL;
    for (npy_intp i = 0; fits && i < width; i++) out[i] = data[i];
    Py_XDECREF(array);
    return fits;
}

/* Copies at most `most` vectors from an array or a sequence of arrays. Returns the number of
   vectors copied, or -1 with an exception set. */
static npy_intp read_vectors(PyObject *rows, npy_intp width, npy_intp most, float *out)
{
    if (PyArray_Check(rows)) {
        PyArrayObject *array = (PyArrayObject *)PyArray_FROMANY(
            rows, NPY_FLOAT32, 0, 2, NPY_ARRAY_CARRAY_RO | NPY_ARRAY_FORCECAST);
        if (!array) return -1;
        const npy_intp size = PyArray_SIZE(array), count = size / width;
        const npy_intp taken = count < most ? count : most;
        if (size == count * width) {
            memcpy(out, PyArray_DATA(array), (size_t)(taken * width) * sizeof *out);
        }
        Py_DECREF(array);
        return size == count * width ? taken : refuse("vectors have the wrong width");
    }
    PyObject *all = PySequence_Fast(rows, "expected vectors");
    if (!all) return -1;
    npy_intp taken = 0;
    int fits = 1;
    for (; fits && taken < most && taken < PySequence_Fast_GET_SIZE(all); taken++) {
        PyObject *row = PySequence_Fast_GET_ITEM(all, taken);
        Py_INCREF(row);
        fits = read_vector(row, width, out + width * taken);
        Py_DECREF(row);
    }
    Py_DECREF(all);
    return fits ? taken : refuse("vectors have the wrong width");
}

/* stack_vectors(rows, blank, out): writes the vectors of each row, padded with `blank`. */
PyObject *stack_vectors(PyObject *Py_UNUSED(module), PyObject *args)
{
    PyObject *rows;
    float blank;
    Floats out;
    if (!PyArg_ParseTuple(args, "O!fO&", &PyTuple_Type, &rows, &blank, as_written_floats, &out)) {
        return NULL;
    }
    const npy_intp count = PyTuple_GET_SIZE(rows), most = count ? out.size / (3 * count) : 0;
    if (out.size != 3 * most * count) {
        return PyErr_Format(PyExc_ValueError,
                            "out must have the same number of vectors in each row");
    }
    for (npy_intp i = 0; i < count; i++) {
        float *row = out.data + 3 * most * i;
        const npy_intp taken = read_vectors(PyTuple_GET_ITEM(rows, i), 3, most, row);
        if (taken < 0) return NULL;
        for (npy_intp k = 3 * taken; k < 3 * most; k++) row[k] = blank;
    }
    Py_RETURN_NONE;
}

/* ---------------------------------------------------------------- the line */

static int is_touching(const Segments *s, double touching)
{
    for (npy_intp i = 1; i < s->count; i++) {
        float most = 0;
        for (int k = 0; k < 3; k++) {
            const float jump = fabsf(s->starts[i][k] - s->ends[i - 1][k]);
            if (!(jump <= most)) most = jump;
        }
        if (!(most < (float)touching)) return 0;
    }
    return 1;
}

/* Writes the indices of consecutive segments, beginning with the first. Returns their number. */
static npy_intp chain_of(const Segments *s, const double *rules, npy_intp *chain)
{
    if (is_touching(s, rules[TOUCHING])) {
        for (npy_intp i = 0; i < s->count; i++) chain[i] = i;
        return s->count;
    }
    const float longest = (float)(rules[LONGEST_JUMP] * rules[LONGEST_JUMP]);
    npy_intp count = 1;
    chain[0] = 0;
    for (;;) {
        const npy_intp last = chain[count - 1];
        npy_intp next = 0;
        float least = INFINITY;
        for (npy_intp i = last + 1; i < s->count; i++) {
            float apart[3];
            for (int k = 0; k < 3; k++) apart[k] = s->starts[i][k] - s->ends[last][k];
            const float squared = dot(apart, apart);
            if (squared < least) least = squared, next = i;
        }
        if (!next || least > longest) return count;
        chain[count++] = next;
    }
}

/* Writes points at even distances on the line that connects `points`. The distances of `points`
   along the line are `marks`. */
static void interpolate(const double *marks, const double (*points)[LINE_SIZE], npy_intp count,
                        double spacing, npy_intp num_points, float *out)
{
    npy_intp before = 0;
    for (npy_intp i = 0; i < num_points; i++, out += LINE_SIZE) {
        const double at = spacing * (double)i;
        while (before + 1 < count && marks[before + 1] <= at) before++;
        for (int k = 0; k < LINE_SIZE; k++) {
            const double here = points[before][k];
            if (before + 1 == count || marks[before] == at) {
                out[k] = (float)here;
                continue;
            }
            const double slope = (points[before + 1][k] - here) / (marks[before + 1] - marks[before]);
            out[k] = (float)(slope * (at - marks[before]) + here);
        }
    }
}

static void trace(const Segments *s, const double *rules, npy_intp num_points, float *out)
{
    npy_intp chain[MOST_SEGMENTS];
    double points[MOST_POINTS][LINE_SIZE], marks[MOST_POINTS] = {0};
    const npy_intp links = chain_of(s, rules, chain), last = 2 * links;
    for (npy_intp i = 0; i < links; i++) {
        const npy_intp segment = chain[i];
        double *start = points[2 * i], *end = points[2 * i + 1];
        for (int k = 0; k < 3; k++) start[k] = s->starts[segment][k], end[k] = s->ends[segment][k];
        start[3] = end[3] = s->widths[segment] / 2;
    }
    double along[3], squared = 0;
    for (int k = 0; k < 3; k++) {
        along[k] = points[last - 1][k] - points[last - 2][k];
        squared = fma(along[k], along[k], squared);
    }
    const double length = sqrt(squared), scale = rules[TAIL] / (length > 1e-3 ? length : 1e-3);
    for (int k = 0; k < 3; k++) points[last][k] = points[last - 1][k] + along[k] * scale;
    points[last][3] = points[last - 1][3];
    for (npy_intp i = 1; i <= last; i++) {
        double step[3];
        for (int k = 0; k < 3; k++) step[k] = points[i][k] - points[i - 1][k];
        marks[i] = marks[i - 1] +
                   sqrt(step[0] * step[0] + step[1] * step[1] + step[2] * step[2]);
    }
    interpolate(marks, (const double (*)[LINE_SIZE])points, last + 1, rules[POINT_SPACING], num_points, out);
}

/* Reads the segments of a kart. If there are none, uses one segment of zero length at the kart.
   Returns -1 with an exception set on failure. */
static int read_segments(Segments *s, PyObject *starts, PyObject *ends, PyObject *widths,
                         npy_intp most)
{
    s->count = read_vectors(starts, 3, most, s->starts[0]);
    if (s->count < 0) return -1;
    const npy_intp num_ends = read_vectors(ends, 3, most, s->ends[0]);
    if (num_ends < 0) return -1;
    const npy_intp num_widths = read_vectors(widths, 1, most, s->widths);
    if (num_widths < 0) return -1;
    if (num_ends != s->count || num_widths != s->count) {
        return refuse("there must be as many ends and widths of segments as starts");
    }
    if (!s->count) memset(s, 0, sizeof *s), s->count = 1;
    return 0;
}

/* Writes points of a line of `num_points` points at distances ahead of a kart. The kart is at the
   origin, on the first segment. */
static void look_ahead(const Segments *s, const float *line, npy_intp num_points, float spacing,
                       Floats looks, float *out)
{
    const float *start = s->starts[0], *end = s->ends[0];
    const float along[3] = {end[0] - start[0], end[1] - start[1], end[2] - start[2]};
    const float here = way_passed(start, along);
    for (npy_intp i = 0; i < looks.size; i++, out += LINE_SIZE) {
        look_on_line(line, num_points, (here + looks.data[i]) / spacing, out);
    }
}

/* trace_roads(starts, ends, widths, most, rules, lines, looks, points): writes the lines ahead of
   karts, and the lines' points at some distances. */
PyObject *trace_roads(PyObject *Py_UNUSED(module), PyObject *args)
{
    PyObject *starts, *ends, *widths;
    npy_intp most;
    Doubles rules;
    Floats lines, looks, points;
    if (!PyArg_ParseTuple(args, "O!O!O!nO&O&O&O&", &PyTuple_Type, &starts, &PyTuple_Type, &ends,
                          &PyTuple_Type, &widths, &most, as_doubles, &rules, as_written_floats,
                          &lines, as_floats, &looks, as_written_floats, &points)) {
        return NULL;
    }
    const npy_intp count = PyTuple_GET_SIZE(starts);
    const npy_intp num_points = count ? lines.size / (LINE_SIZE * count) : 0;
    if (PyTuple_GET_SIZE(ends) != count || PyTuple_GET_SIZE(widths) != count ||
        lines.size != LINE_SIZE * num_points * count || (count && num_points < 2) ||
        points.size != LINE_SIZE * looks.size * count || rules.size != NUM_RULES || most < 1 ||
        most > MOST_SEGMENTS || !((float)rules.data[POINT_SPACING] > 0)) {
        return PyErr_Format(PyExc_ValueError, "the arrays of %zd roads do not fit together", count);
    }
    Segments segments;
    for (npy_intp i = 0; i < count; i++) {
        if (read_segments(&segments, PyTuple_GET_ITEM(starts, i), PyTuple_GET_ITEM(ends, i),
                          PyTuple_GET_ITEM(widths, i), most) < 0) {
            return NULL;
        }
        float *line = lines.data + LINE_SIZE * num_points * i;
        trace(&segments, rules.data, num_points, line);
        look_ahead(&segments, line, num_points, (float)rules.data[POINT_SPACING], looks,
                   points.data + LINE_SIZE * looks.size * i);
    }
    Py_RETURN_NONE;
}
