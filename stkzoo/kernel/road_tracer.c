/* Builds the line of the road ahead, with evenly spaced points, from a track's segments. */

#include "geometry.h"

enum { MOST_SEGMENTS = 128, MOST_POINTS = 2 * MOST_SEGMENTS + 1 };

/* Indices of `rules`. */
enum { POINT_SPACING, TOUCHING, LONGEST_JUMP, TAIL, NUM_RULES };

/* The segments ahead of a kart. */
typedef struct {
    npy_intp count;
    const float (*starts)[3], (*ends)[3], *widths;
} Segments;

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

/* trace_roads(starts, ends, widths, counts, rules, lines, looks, points): writes the lines ahead of
   karts, and the lines' points at some distances. Kart i has counts[i] segments. */
PyObject *trace_roads(PyObject *Py_UNUSED(module), PyObject *args)
{
    Doubles rules;
    Indices counts;
    Floats starts, ends, widths, lines, looks, points;
    if (!PyArg_ParseTuple(args, "O&O&O&O&O&O&O&O&", as_floats, &starts, as_floats, &ends, as_floats,
                          &widths, as_indices, &counts, as_doubles, &rules, as_written_floats,
                          &lines, as_floats, &looks, as_written_floats, &points)) {
        return NULL;
    }
    const npy_intp num_roads = counts.size, divisor = num_roads ? num_roads : 1;
    const npy_intp most = widths.size / divisor, num_points = lines.size / (LINE_SIZE * divisor);
    const npy_intp sizes[][2] = {
        {widths.size, most * num_roads},
        {starts.size, 3 * most * num_roads},
        {ends.size, starts.size},
        {lines.size, LINE_SIZE * num_points * num_roads},
        {points.size, LINE_SIZE * looks.size * num_roads},
        {rules.size, NUM_RULES},
        {most <= MOST_SEGMENTS && are_below(counts, most + 1), 1},
        {!num_roads || num_points >= 2, 1},
    };
    if (ARE_SIZES(sizes) < 0) return NULL;
    const float spacing = (float)rules.data[POINT_SPACING];
    if (!(spacing > 0)) return refuse("the distance between points must be positive"), NULL;
    static const float NOWHERE[1][3] = {{0}}; /* a segment of zero length at the kart */
    for (npy_intp i = 0; i < num_roads; i++) {
        const npy_intp first = most * i;
        Segments segments = {1, NOWHERE, NOWHERE, *NOWHERE};
        if (counts.data[i]) {
            segments = (Segments){counts.data[i], (const float (*)[3])starts.data + first,
                                  (const float (*)[3])ends.data + first, widths.data + first};
        }
        float *line = lines.data + LINE_SIZE * num_points * i;
        trace(&segments, rules.data, num_points, line);
        look_ahead(&segments, line, num_points, spacing, looks,
                   points.data + LINE_SIZE * looks.size * i);
    }
    Py_RETURN_NONE;
}
