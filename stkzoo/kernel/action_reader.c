/* Converts agents' actions to the engine's controls.

   Only actions in the usual forms and within the action space are read. For all others, the caller
   uses stkzoo.views.actions.read_action, which converts an action to a usual form or raises. */

#include "kernel.h"

#include <math.h>
#include <string.h>

/* One number of an action. */
typedef struct {
    double low, high;
    int is_whole, column, width; /* whether it is an integer; first of `width` columns to write */
    const float *table; /* (values, width): controls to add for each integer. If NULL, the number
                           itself is the control. */
} Entry;

/* Numbers that form one array: the whole action, or the value of one key. */
typedef struct {
    Entry *entries;
    npy_intp count;
} Leaf;

typedef struct {
    OBJECT_HEAD
    PyObject *names; /* tuple of the leaves' keys; empty if the action is a single leaf */
    Leaf *leaves;
} ActionReader;

/* stkzoo.views.actions.BOUND_TOLERANCE */
static const double TOLERANCE = 1e-6;

static int put(const Entry *entry, double value, float *row)
{
    const double slack = entry->is_whole ? 0 : TOLERANCE;
    if (!(value >= entry->low - slack && value <= entry->high + slack)) return 0;
    if (entry->is_whole && value != floor(value)) return 0;
    if (entry->table) {
        const float *controls = entry->table + (npy_intp)(value - entry->low) * entry->width;
        for (int i = 0; i < entry->width; i++) row[entry->column + i] += controls[i];
        return 1;
    }
    if (value < entry->low) value = entry->low;
    if (value > entry->high) value = entry->high;
    row[entry->column] = (float)value;
    return 1;
}

/* Reads a number of an array; returns 0 if the dtype is not one of the usual ones. */
static int number_at(PyArrayObject *array, const char *data, double *value)
{
    switch (PyArray_TYPE(array)) {
    case NPY_FLOAT32: *value = *(const float *)data; return 1;
    case NPY_FLOAT64: *value = *(const double *)data; return 1;
    case NPY_LONG: *value = (double)*(const npy_long *)data; return 1;
    case NPY_LONGLONG: *value = (double)*(const npy_longlong *)data; return 1;
    case NPY_INT32: *value = *(const npy_int32 *)data; return 1;
    case NPY_INT8: *value = *(const npy_int8 *)data; return 1;
    case NPY_BOOL: *value = *(const npy_bool *)data; return 1;
    default: return 0;
    }
}

/* Reads a leaf's numbers from an array, or from a slot's row of it. */
static int read_numbers(const Leaf *leaf, PyArrayObject *array, npy_intp slot, float *row)
{
    const int axes = PyArray_NDIM(array);
    const char *data = PyArray_BYTES(array) + (slot ? slot * PyArray_STRIDE(array, 0) : 0);
    const npy_intp stride = leaf->count > 1 ? PyArray_STRIDE(array, axes - 1) : 0;
    for (npy_intp i = 0; i < leaf->count; i++) {
        double value;
        if (!number_at(array, data + i * stride, &value) || !put(leaf->entries + i, value, row)) {
            return 0;
        }
    }
    return 1;
}

/* Returns whether an array has the numbers of a leaf, or a row with them for each of `count` slots. */
static int fits_leaf(const Leaf *leaf, PyArrayObject *array, npy_intp count)
{
    const int axes = PyArray_NDIM(array), has_slots = count >= 0;
    if (!PyArray_ISBEHAVED_RO(array) ||
        (has_slots && (axes == 0 || PyArray_DIM(array, 0) != count))) {
        return 0;
    }
    return PyArray_SIZE(array) == leaf->count * (has_slots ? count : 1) &&
           (leaf->count == 1 || axes == 1 + has_slots);
}

/* Reads a leaf from an array or a number; from a row of an array if `count` is at least 0. */
static int read_leaf(const Leaf *leaf, PyObject *object, npy_intp slot, npy_intp count, float *row)
{
    if (PyArray_Check(object)) {
        PyArrayObject *array = (PyArrayObject *)object;
        return fits_leaf(leaf, array, count) && read_numbers(leaf, array, slot, row);
    }
    if (leaf->count != 1 || count >= 0) return 0;
    if (!PyFloat_Check(object) && !PyLong_Check(object) && !PyArray_IsScalar(object, Integer) &&
        !PyArray_IsScalar(object, Floating) && !PyArray_IsScalar(object, Bool)) {
        return 0;
    }
    const double value = PyFloat_AsDouble(object);
    if (value == -1 && PyErr_Occurred()) {
        PyErr_Clear();
        return 0;
    }
    return put(leaf->entries, value, row);
}

/* Reads an action, or the action of a slot from a batch for `count` slots. Returns 0 if it cannot be
   read, and -1 with an exception set on failure. */
static int read_action(const ActionReader *self, PyObject *action, npy_intp slot, npy_intp count,
                       float *row)
{
    const Py_ssize_t num_names = PyTuple_GET_SIZE(self->names);
    memset(row, 0, NUM_CONTROLS * sizeof *row);
    if (num_names == 0) return read_leaf(self->leaves, action, slot, count, row);
    if (!PyDict_Check(action) || PyDict_GET_SIZE(action) != num_names) return 0;
    for (Py_ssize_t i = 0; i < num_names; i++) {
        PyObject *part = PyDict_GetItemWithError(action, PyTuple_GET_ITEM(self->names, i));
        if (!part) return PyErr_Occurred() ? -1 : 0;
        Py_INCREF(part); /* converting a number can run code that removes it from the dict */
        const int is_read = read_leaf(self->leaves + i, part, slot, count, row);
        Py_DECREF(part);
        if (is_read <= 0) return is_read;
    }
    return 1;
}

/* read(actions, who, rows, controls, count): reads one action for each row of `rows` into that row of
   `controls`. Without `count`, `actions` is a dict by agent and `who` a tuple of agents. Otherwise,
   `actions` is a batch, which is one array or a dict of arrays with a row for each of `count` slots,
   and `who` holds the slots. Returns False if an action is missing or cannot be read. */
static PyObject *reader_read(PyObject *object, PyObject *args)
{
    const ActionReader *self = (ActionReader *)object;
    PyObject *actions, *who;
    Indices rows, slots = {NULL, 0};
    Floats controls;
    Py_ssize_t count = -1;
    if (!PyArg_ParseTuple(args, "OOO&O&|n", &actions, &who, as_indices, &rows, as_written_floats,
                          &controls, &count)) {
        return NULL;
    }
    const int is_batch = count >= 0;
    if (!(is_batch ? as_indices(who, &slots) : is_tuple(who))) return NULL;
    const npy_intp size = is_batch ? slots.size : PyTuple_GET_SIZE(who);
    if (size != rows.size) {
        return PyErr_Format(PyExc_ValueError, "%zd actions for %zd rows", size, rows.size);
    }
    if (!are_below(slots, count) || !are_below(rows, controls.size / NUM_CONTROLS)) {
        return PyErr_Format(PyExc_IndexError, "a slot or row index is out of range");
    }
    if (!is_batch && !PyDict_Check(actions)) Py_RETURN_FALSE;
    int is_read = 1;
    for (npy_intp i = 0; is_read > 0 && i < size; i++) {
        PyObject *action =
            is_batch ? actions : PyDict_GetItemWithError(actions, PyTuple_GET_ITEM(who, i));
        if (!action && PyErr_Occurred()) return NULL;
        Py_XINCREF(action); /* see read_action */
        float *row = controls.data + rows.data[i] * NUM_CONTROLS;
        is_read = action ? read_action(self, action, is_batch ? slots.data[i] : 0, count, row) : 0;
        Py_XDECREF(action);
    }
    return is_read < 0 ? NULL : PyBool_FromLong(is_read);
}

/* Sets an entry from a tuple (low, high, is_whole, column, table or None). */
static int set_entry(Entry *entry, PyObject *spec)
{
    PyObject *table;
    Floats controls = {NULL, 1};
    if (!is_tuple(spec) ||
        !PyArg_ParseTuple(spec, "ddpiO", &entry->low, &entry->high, &entry->is_whole,
                          &entry->column, &table) ||
        (table != Py_None && !as_floats(table, &controls))) {
        return -1;
    }
    const double range = entry->high - entry->low;
    const int has_rows = entry->is_whole && range >= 0 && range < (double)controls.size;
    const npy_intp steps = controls.data && has_rows ? (npy_intp)range + 1 : 1;
    if (controls.data && (!has_rows || controls.size % steps)) {
        return refuse("a table must have a row for each whole number");
    }
    entry->table = controls.data;
    if (entry->column < 0 || controls.size / steps > NUM_CONTROLS - entry->column) {
        return refuse("an entry has a column beyond the last one");
    }
    entry->width = (int)(controls.size / steps);
    return 0;
}

static int set_leaf(ActionReader *self, Leaf *leaf, PyObject *specs)
{
    if (!is_tuple(specs)) return -1;
    leaf->count = PyTuple_GET_SIZE(specs);
    if (!(leaf->entries = room_for(self, leaf->count, sizeof *leaf->entries))) return -1;
    for (npy_intp i = 0; i < leaf->count; i++) {
        if (set_entry(leaf->entries + i, PyTuple_GET_ITEM(specs, i)) < 0) return -1;
    }
    return 0;
}

/* ActionReader(names, leaves) */
static int reader_set_up(ActionReader *self, PyObject *args, PyObject *Py_UNUSED(kwargs))
{
    PyObject *leaves;
    if (!PyArg_ParseTuple(args, "O!O!", &PyTuple_Type, &self->names, &PyTuple_Type, &leaves)) {
        return -1;
    }
    const Py_ssize_t num_names = PyTuple_GET_SIZE(self->names), count = PyTuple_GET_SIZE(leaves);
    if (count != (num_names ? num_names : 1)) {
        return refuse("expected one leaf per name, or one leaf without a name");
    }
    if (!(self->leaves = room_for(self, count, sizeof *self->leaves))) return -1;
    for (Py_ssize_t i = 0; i < count; i++) {
        if (set_leaf(self, self->leaves + i, PyTuple_GET_ITEM(leaves, i)) < 0) return -1;
    }
    return 0;
}

KERNEL_TYPE(ActionReader, reader, "Converts actions of one space to controls.",
            {"read", reader_read, METH_VARARGS, "Reads actions into rows of controls."})
