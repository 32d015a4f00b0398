/* A track's segments, and the order of the segments ahead of each. */

#include "kernel.h"

#include <math.h>
#include <string.h>

/* A segment that the search has reached, and the driving distance to it [m]. */
typedef struct {
    double distance;
    npy_int32 node;
} Reached;

/* Removes and returns the nearest of `count` segments; ties go to the lowest number. A linear scan
   suffices: there is usually one segment, and two or three at a fork. */
static Reached take_nearest(Reached *reached, npy_intp count)
{
    Reached *nearest = reached;
    for (Reached *one = reached + 1; one < reached + count; one++) {
        const int is_nearer = one->distance < nearest->distance;
        if (is_nearer || (one->distance == nearest->distance && one->node < nearest->node)) {
            nearest = one;
        }
    }
    const Reached taken = *nearest;
    *nearest = reached[count - 1];
    return taken;
}

/* Returns the distance along the lap from the start of one segment to that of another [m]. */
static double gap(const TrackGraph *track, npy_intp from, npy_intp to)
{
    const float *begins = track->distances.data;
    const double rest = fmod((double)begins[2 * to] - (double)begins[2 * from], track->length);
    return rest < 0 ? rest + track->length : rest;
}

/* Fills a row with the segments that are reachable from `start`, by driving distance, then with the
   others, by distance along the lap. */
static void fill_order(const TrackGraph *track, npy_intp start, Reached *reached, char *is_seen,
                       npy_int32 *row)
{
    npy_intp size = 1, count = 0;
    reached[0] = (Reached){0.0, (npy_int32)start};
    while (size) {
        const Reached now = take_nearest(reached, size--);
        if (is_seen[now.node]) continue;
        is_seen[now.node] = 1;
        row[count++] = now.node;
        const npy_intp *begin = track->begins.data + now.node;
        for (npy_intp i = begin[0]; i < begin[1]; i++) {
            const npy_int32 next = (npy_int32)track->successors.data[i];
            reached[size++] = (Reached){now.distance + gap(track, now.node, next), next};
        }
    }
    for (npy_int32 node = 0; node < track->num_nodes; node++) {
        if (!is_seen[node]) reached[size++] = (Reached){gap(track, start, node), node};
    }
    while (size) row[count++] = take_nearest(reached, size--).node;
}

const npy_int32 *nodes_ahead(TrackGraph *track, npy_intp node)
{
    if (node < 0 || node >= track->num_nodes) {
        PyErr_Format(PyExc_IndexError, "there is no segment %zd", node);
        return NULL;
    }
    if (!track->orders[node]) {
        const size_t most = (size_t)(track->successors.size + track->num_nodes);
        Reached *reached = PyMem_Malloc(most * sizeof *reached + (size_t)track->num_nodes);
        char *is_seen = (char *)(reached + most);
        npy_int32 *row = reached ? room_for(track, track->num_nodes, sizeof *row) : NULL;
        if (row) {
            memset(is_seen, 0, (size_t)track->num_nodes);
            fill_order(track, node, reached, is_seen, row);
            track->orders[node] = row;
        } else if (!reached) {
            PyErr_NoMemory();
        }
        PyMem_Free(reached);
    }
    return track->orders[node];
}

/* ahead(node): returns the segments ahead of a segment, (N,), beginning with itself. */
static PyObject *track_ahead(PyObject *self, PyObject *number)
{
    TrackGraph *track = (TrackGraph *)self;
    const npy_intp node = PyLong_AsSsize_t(number);
    if (node == -1 && PyErr_Occurred()) return NULL;
    const npy_int32 *row = nodes_ahead(track, node);
    PyObject *array = row ? PyArray_SimpleNew(1, &track->num_nodes, NPY_INTP) : NULL;
    for (npy_intp i = 0; array && i < track->num_nodes; i++) {
        ((npy_intp *)PyArray_DATA((PyArrayObject *)array))[i] = row[i];
    }
    return array;
}

static int is_whole(const TrackGraph *track)
{
    const npy_intp count = track->num_nodes, *begins = track->begins.data;
    if (count < 1 || count > NPY_MAX_INT32 || track->nodes.size != 6 * count ||
        track->widths.size != count || track->distances.size != 2 * count ||
        !(track->length > 0) || begins[0] != 0 || begins[count] != track->successors.size) {
        return 0;
    }
    for (npy_intp n = 0; n < count; n++) {
        if (begins[n] > begins[n + 1]) return 0;
    }
    return are_below(track->successors, count);
}

/* TrackGraph(nodes, widths, distances, begins, successors, length) */
static int track_set_up(TrackGraph *track, PyObject *args, PyObject *Py_UNUSED(kwargs))
{
    if (!PyArg_ParseTuple(args, "O&O&O&O&O&d", as_floats, &track->nodes, as_floats, &track->widths,
                          as_floats, &track->distances, as_indices, &track->begins, as_indices,
                          &track->successors, &track->length)) {
        return -1;
    }
    track->num_nodes = track->begins.size - 1;
    if (!is_whole(track)) return refuse("the track's arrays do not fit together");
    track->orders = room_for(track, track->num_nodes, sizeof *track->orders);
    return track->orders ? 0 : -1;
}

KERNEL_TYPE(TrackGraph, track, "A track's segments.",
            {"ahead", track_ahead, METH_O, "Returns the segments ahead of a segment."})
