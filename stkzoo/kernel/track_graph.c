/* A track's segments, and the order of what lies ahead of each.

   As stkzoo.engine.track.TrackMap._order_from. */

#include "kernel.h"

#include <math.h>

typedef struct {
    double distance;
    npy_int32 node;
} Reached;

static int is_nearer(Reached a, Reached b)
{
    return a.distance < b.distance || (a.distance == b.distance && a.node < b.node);
}

static void push(Reached *heap, npy_intp at, Reached reached)
{
    while (at > 0 && is_nearer(reached, heap[(at - 1) / 2])) {
        heap[at] = heap[(at - 1) / 2];
        at = (at - 1) / 2;
    }
    heap[at] = reached;
}

/* Takes the nearest of `count` off. */
static Reached pop(Reached *heap, npy_intp count)
{
    const Reached first = heap[0], last = heap[count - 1];
    npy_intp at = 0, child;
    while ((child = 2 * at + 1) < count - 1) {
        if (child + 1 < count - 1 && is_nearer(heap[child + 1], heap[child])) child++;
        if (!is_nearer(heap[child], last)) break;
        heap[at] = heap[child];
        at = child;
    }
    heap[at] = last;
    return first;
}

/* How far it is from one segment's start on to another's, along the lap. */
static double gap(const TrackGraph *track, npy_intp from, npy_intp to)
{
    const double way = (double)track->distances[2 * to] - (double)track->distances[2 * from];
    const double rest = fmod(way, track->length);
    return rest < 0 ? rest + track->length : rest;
}

/* Those that no way leads to, by their place in the lap, after those that are in the row. */
static void add_unreachable(const TrackGraph *track, npy_intp start, const char *is_seen,
                            npy_int32 *row, npy_intp count)
{
    const npy_intp first = count;
    for (npy_int32 node = 0; node < track->num_nodes; node++) {
        if (is_seen[node]) continue;
        npy_intp at = count++;
        while (at > first && gap(track, start, row[at - 1]) > gap(track, start, node)) {
            row[at] = row[at - 1];
            at--;
        }
        row[at] = node;
    }
}

static void fill_order(const TrackGraph *track, npy_intp start, Reached *heap, char *is_seen,
                       npy_int32 *row)
{
    npy_intp size = 1, count = 0;
    heap[0] = (Reached){0.0, (npy_int32)start};
    while (size) {
        const Reached now = pop(heap, size--);
        if (is_seen[now.node]) continue;
        is_seen[now.node] = 1;
        row[count++] = now.node;
        for (npy_intp i = track->begins[now.node]; i < track->begins[now.node + 1]; i++) {
            const npy_int32 next = (npy_int32)track->successors[i];
            push(heap, size++, (Reached){now.distance + gap(track, now.node, next), next});
        }
    }
    add_unreachable(track, start, is_seen, row, count);
}

const npy_int32 *nodes_ahead(TrackGraph *track, npy_intp node)
{
    if (node < 0 || node >= track->num_nodes) {
        PyErr_Format(PyExc_IndexError, "there is no segment %zd", node);
        return NULL;
    }
    if (!track->orders[node]) {
        const size_t count = (size_t)track->num_nodes;
        const size_t most = (size_t)track->begins[count] + 1; /* each way is gone once */
        npy_int32 *row = PyMem_Malloc(count * sizeof *row);
        Reached *heap = PyMem_Malloc(most * sizeof *heap);
        char *is_seen = PyMem_Calloc(count, 1);
        if (row && heap && is_seen) {
            fill_order(track, node, heap, is_seen, row);
            track->orders[node] = row;
        } else {
            PyMem_Free(row);
            PyErr_NoMemory();
        }
        PyMem_Free(heap);
        PyMem_Free(is_seen);
    }
    return track->orders[node];
}

/* ahead(node): the segments ahead of one, (N,). */
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

static int is_whole(const TrackGraph *track, const npy_intp sizes[5])
{
    const npy_intp count = track->num_nodes;
    if (count < 1 || count > NPY_MAX_INT32 || sizes[0] != 6 * count || sizes[1] != count ||
        sizes[2] != 2 * count || !(track->length > 0) || track->begins[0] != 0 ||
        track->begins[count] != sizes[4]) {
        return 0;
    }
    for (npy_intp n = 0; n < count; n++) {
        if (track->begins[n] > track->begins[n + 1]) return 0;
    }
    for (npy_intp i = 0; i < sizes[4]; i++) {
        if (track->successors[i] < 0 || track->successors[i] >= count) return 0;
    }
    return 1;
}

/* TrackGraph(nodes, widths, distances, begins, successors, length) */
static PyObject *track_new(PyTypeObject *type, PyObject *args, PyObject *Py_UNUSED(kwargs))
{
    PyObject *arrays[5];
    npy_intp sizes[5];
    TrackGraph *track = (TrackGraph *)type->tp_alloc(type, 0);
    if (!track) return NULL;
    if (!PyArg_ParseTuple(args, "OOOOOd", arrays, arrays + 1, arrays + 2, arrays + 3, arrays + 4,
                          &track->length) ||
        !(track->nodes = numbers_of(arrays[0], "nodes", NPY_FLOAT32, sizes)) ||
        !(track->widths = numbers_of(arrays[1], "widths", NPY_FLOAT32, sizes + 1)) ||
        !(track->distances = numbers_of(arrays[2], "distances", NPY_FLOAT32, sizes + 2)) ||
        !(track->begins = numbers_of(arrays[3], "begins", NPY_INTP, sizes + 3)) ||
        !(track->successors = numbers_of(arrays[4], "successors", NPY_INTP, sizes + 4))) {
        Py_DECREF(track);
        return NULL;
    }
    track->num_nodes = sizes[3] - 1;
    if (!is_whole(track, sizes)) {
        track->num_nodes = 0;
        PyErr_SetString(PyExc_ValueError, "the track's arrays do not fit together");
    } else if (!(track->orders = PyMem_Calloc((size_t)track->num_nodes, sizeof(void *)))) {
        track->num_nodes = 0;
        PyErr_NoMemory();
    }
    Py_INCREF(args);
    track->arrays = args;
    if (PyErr_Occurred()) Py_CLEAR(track);
    return (PyObject *)track;
}

static void track_dealloc(PyObject *self)
{
    TrackGraph *track = (TrackGraph *)self;
    for (npy_intp n = 0; track->orders && n < track->num_nodes; n++) PyMem_Free(track->orders[n]);
    PyMem_Free(track->orders);
    Py_XDECREF(track->arrays);
    Py_TYPE(self)->tp_free(self);
}

static PyMethodDef track_methods[] = {
    {"ahead", track_ahead, METH_O, "The segments ahead of one, nearest first along the way."},
    {NULL, NULL, 0, NULL},
};

KERNEL_TYPE(TrackGraph, track, "A track's segments.")
