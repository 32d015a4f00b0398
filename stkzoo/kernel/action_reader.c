/* Actions as they come from agents, into the controls that the engine takes.

   Only the usual forms are read, and only what lies in the space. For all else the caller has
   stkzoo.views.actions.read_actions, which brings an action into a usual form or raises. */

#include "kernel.h"

#include <math.h>
#include <string.h>

/* One number of an action. */
typedef struct {
    double low, high;
    int is_whole, column, width; /* where it goes; columns of the table */
    const float *table;          /* controls to add for each whole number; NULL: it is the control */
} Entry;

/* Numbers that come together: the whole action, or what stands under one key. */
typedef struct {
    int first, count;
} Leaf;

typedef struct {
    PyObject_HEAD
    PyObject *names;  /* tuple of the leaves' keys; empty if the action is the only leaf */
    PyObject *tables; /* keeps the tables alive */
    int num_leaves, num_entries, num_columns;
    Leaf *leaves;
    Entry *entries;
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

/* Number i of an array that holds one of the usual types; 0 if it holds another. */
static int number_at(PyArrayObject *array, npy_intp i, double *value)
{
    const void *data = PyArray_DATA(array);
    switch (PyArray_TYPE(array)) {
    case NPY_FLOAT32: *value = ((const float *)data)[i]; return 1;
    case NPY_FLOAT64: *value = ((const double *)data)[i]; return 1;
    case NPY_LONG: *value = (double)((const npy_long *)data)[i]; return 1;
    case NPY_LONGLONG: *value = (double)((const npy_longlong *)data)[i]; return 1;
    case NPY_INT32: *value = ((const npy_int32 *)data)[i]; return 1;
    case NPY_INT8: *value = ((const npy_int8 *)data)[i]; return 1;
    case NPY_BOOL: *value = ((const npy_bool *)data)[i]; return 1;
    default: return 0;
    }
}

static int read_array(const ActionReader *self, const Leaf *leaf, PyArrayObject *array, float *row)
{
    if (!PyArray_IS_C_CONTIGUOUS(array) || !PyArray_ISBEHAVED_RO(array) ||
        PyArray_SIZE(array) != leaf->count || (leaf->count > 1 && PyArray_NDIM(array) != 1)) {
        return 0;
    }
    for (int i = 0; i < leaf->count; i++) {
        double value;
        if (!number_at(array, i, &value) || !put(self->entries + leaf->first + i, value, row)) {
            return 0;
        }
    }
    return 1;
}

static int read_leaf(const ActionReader *self, const Leaf *leaf, PyObject *object, float *row)
{
    if (PyArray_Check(object)) return read_array(self, leaf, (PyArrayObject *)object, row);
    if (leaf->count != 1) return 0;
    if (!PyFloat_Check(object) && !PyLong_Check(object) && !PyArray_IsScalar(object, Integer) &&
        !PyArray_IsScalar(object, Floating) && !PyArray_IsScalar(object, Bool)) {
        return 0;
    }
    const double value = PyFloat_AsDouble(object);
    if (value == -1 && PyErr_Occurred()) {
        PyErr_Clear();
        return 0;
    }
    return put(self->entries + leaf->first, value, row);
}

static int read_action(const ActionReader *self, PyObject *action, float *row)
{
    const Py_ssize_t num_names = PyTuple_GET_SIZE(self->names);
    if (num_names == 0) return read_leaf(self, self->leaves, action, row);
    if (!PyDict_Check(action) || PyDict_GET_SIZE(action) != num_names) return 0;
    for (Py_ssize_t i = 0; i < num_names; i++) {
        PyObject *part = PyDict_GetItemWithError(action, PyTuple_GET_ITEM(self->names, i));
        if (!part) return PyErr_Occurred() ? -1 : 0;
        const int is_read = read_leaf(self, self->leaves + i, part, row);
        if (is_read <= 0) return is_read;
    }
    return 1;
}

/* read(actions, agents, rows, controls): the action of agents[i], from a dict, into row rows[i];
   whether all were there and could be read. */
static PyObject *reader_read(PyObject *object, PyObject *const *args, Py_ssize_t nargs)
{
    const ActionReader *self = (ActionReader *)object;
    npy_intp num_rows, size;
    if (nargs != 4 || !PyTuple_Check(args[1])) {
        return PyErr_Format(PyExc_TypeError, "read() takes actions, a tuple and two arrays");
    }
    const npy_intp *rows = numbers_of(args[2], "rows", NPY_INTP, &num_rows);
    if (!rows) return NULL;
    float *controls = numbers_of(args[3], "controls", NPY_FLOAT32, &size);
    if (!controls) return NULL;
    if (PyTuple_GET_SIZE(args[1]) != num_rows) {
        return PyErr_Format(PyExc_ValueError, "%zd agents for %zd rows",
                            PyTuple_GET_SIZE(args[1]), num_rows);
    }
    if (!PyDict_Check(args[0])) Py_RETURN_FALSE;
    for (npy_intp i = 0; i < num_rows; i++) {
        if (rows[i] < 0 || (rows[i] + 1) * self->num_columns > size) {
            return PyErr_Format(PyExc_IndexError, "there is no row %zd", rows[i]);
        }
        PyObject *action = PyDict_GetItemWithError(args[0], PyTuple_GET_ITEM(args[1], i));
        if (!action && PyErr_Occurred()) return NULL;
        float *row = controls + rows[i] * self->num_columns;
        memset(row, 0, (size_t)self->num_columns * sizeof *row);
        const int is_read = action ? read_action(self, action, row) : 0;
        if (is_read < 0) return NULL;
        if (!is_read) Py_RETURN_FALSE;
    }
    Py_RETURN_TRUE;
}

/* One entry from (low, high, is_whole, column, table or None). */
static int set_entry(ActionReader *self, Entry *entry, PyObject *spec)
{
    PyObject *table;
    npy_intp size;
    if (!PyArg_ParseTuple(spec, "ddpiO", &entry->low, &entry->high, &entry->is_whole,
                          &entry->column, &table)) {
        return -1;
    }
    entry->width = 1;
    if (table != Py_None) {
        if (!(entry->table = numbers_of(table, "table", NPY_FLOAT32, &size))) return -1;
        const npy_intp steps = (npy_intp)(entry->high - entry->low) + 1;
        entry->width = (int)(size / steps);
        if (!entry->is_whole || size == 0 || size % steps) {
            PyErr_SetString(PyExc_ValueError, "a table has a row for each whole number");
            return -1;
        }
        if (PyList_Append(self->tables, table) < 0) return -1;
    }
    if (entry->column < 0 || entry->column + entry->width > self->num_columns) {
        PyErr_SetString(PyExc_ValueError, "an entry leads beyond the last column");
        return -1;
    }
    return 0;
}

static int set_leaves(ActionReader *self, PyObject *leaves)
{
    const Py_ssize_t num_leaves = PyTuple_GET_SIZE(leaves);
    Py_ssize_t num_entries = 0;
    for (Py_ssize_t i = 0; i < num_leaves; i++) {
        if (!PyTuple_Check(PyTuple_GET_ITEM(leaves, i))) {
            PyErr_SetString(PyExc_TypeError, "a leaf is a tuple of entries");
            return -1;
        }
        num_entries += PyTuple_GET_SIZE(PyTuple_GET_ITEM(leaves, i));
    }
    self->leaves = PyMem_Calloc((size_t)num_leaves + 1, sizeof *self->leaves);
    self->entries = PyMem_Calloc((size_t)num_entries + 1, sizeof *self->entries);
    if (!self->leaves || !self->entries) {
        PyErr_NoMemory();
        return -1;
    }
    for (Py_ssize_t i = 0; i < num_leaves; i++) {
        PyObject *leaf = PyTuple_GET_ITEM(leaves, i);
        self->leaves[i].first = self->num_entries;
        self->leaves[i].count = (int)PyTuple_GET_SIZE(leaf);
        for (Py_ssize_t j = 0; j < PyTuple_GET_SIZE(leaf); j++) {
            Entry *entry = self->entries + self->num_entries++;
            if (set_entry(self, entry, PyTuple_GET_ITEM(leaf, j)) < 0) return -1;
        }
    }
    return 0;
}

static PyObject *reader_new(PyTypeObject *type, PyObject *args, PyObject *kwargs)
{
    static char *words[] = {"names", "leaves", "num_columns", NULL};
    PyObject *names, *leaves;
    int num_columns;
    if (!PyArg_ParseTupleAndKeywords(args, kwargs, "O!O!i", words, &PyTuple_Type, &names,
                                     &PyTuple_Type, &leaves, &num_columns)) {
        return NULL;
    }
    const Py_ssize_t num_names = PyTuple_GET_SIZE(names);
    if (PyTuple_GET_SIZE(leaves) != (num_names ? num_names : 1)) {
        PyErr_SetString(PyExc_ValueError, "there is one leaf for each name, or one without");
        return NULL;
    }
    ActionReader *self = (ActionReader *)type->tp_alloc(type, 0);
    if (!self) return NULL;
    Py_INCREF(names);
    self->names = names;
    self->num_columns = num_columns;
    self->tables = PyList_New(0);
    if (!self->tables || set_leaves(self, leaves) < 0) Py_CLEAR(self);
    return (PyObject *)self;
}

static void reader_dealloc(PyObject *object)
{
    ActionReader *self = (ActionReader *)object;
    Py_XDECREF(self->names);
    Py_XDECREF(self->tables);
    PyMem_Free(self->leaves);
    PyMem_Free(self->entries);
    Py_TYPE(object)->tp_free(object);
}

static PyMethodDef reader_methods[] = {
    FAST_METHOD("read", reader_read, "Actions into rows of controls; whether all could be read."),
    {NULL, NULL, 0, NULL},
};

KERNEL_TYPE(ActionReader, reader, "How actions of one space become controls.")
