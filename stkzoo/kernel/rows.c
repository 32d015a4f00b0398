/* Rows of arrays: joins them, makes blocks of them, and splits blocks into values of single agents. */

#include "kernel.h"

#include <string.h>

static int is_like(PyArrayObject *row, PyArrayObject *first)
{
    const int axes = PyArray_NDIM(first);
    return PyArray_DESCR(row) == PyArray_DESCR(first) && PyArray_NDIM(row) == axes &&
           PyArray_IS_C_CONTIGUOUS(row) &&
           PyArray_CompareLists(PyArray_DIMS(row), PyArray_DIMS(first), axes);
}

/* join_rows(tuple): returns the concatenated bytes of arrays of one dtype and shape. Returns None
   if the tuple is empty or contains other objects, if dtypes or shapes differ, or if an array is
   not C-contiguous or holds Python objects. */
PyObject *join_rows(PyObject *Py_UNUSED(module), PyObject *rows)
{
    if (!is_tuple(rows)) return NULL;
    const Py_ssize_t count = PyTuple_GET_SIZE(rows);
    PyArrayObject **row = (PyArrayObject **)&PyTuple_GET_ITEM(rows, 0);
    int are_alike = count > 0;
    for (Py_ssize_t i = 0; are_alike && i < count; i++) {
        are_alike = PyArray_CheckExact(row[i]) && is_like(row[i], row[0]);
    }
    if (!are_alike || PyDataType_REFCHK(PyArray_DESCR(row[0]))) Py_RETURN_NONE;
    const npy_intp size = PyArray_NBYTES(row[0]);
    PyObject *block = PyBytes_FromStringAndSize(NULL, count * size);
    for (Py_ssize_t i = 0; block && i < count; i++) {
        memcpy(PyBytes_AS_STRING(block) + i * size, PyArray_DATA(row[i]), (size_t)size);
    }
    return block;
}

/* ---------------------------------------------------------------- batches */

/* A batch holds one value for each of several agents: an array with a row for each, a list of texts,
   or a dict of batches. */

/* Returns a batch of `count` rows without content in the form of another batch. */
static PyObject *new_part(PyObject *like, npy_intp count)
{
    if (PyList_Check(like)) {
        PyObject *list = PyList_New(count);
        for (npy_intp i = 0; list && i < count; i++) PyList_SET_ITEM(list, i, Py_NewRef(Py_None));
        return list;
    }
    if (PyArray_Check(like) && PyArray_NDIM((PyArrayObject *)like) > 0) {
        PyArrayObject *array = (PyArrayObject *)like;
        npy_intp shape[NPY_MAXDIMS];
        memcpy(shape, PyArray_DIMS(array), (size_t)PyArray_NDIM(array) * sizeof *shape);
        shape[0] = count;
        return PyArray_SimpleNew(PyArray_NDIM(array), shape, PyArray_TYPE(array));
    }
    if (!PyDict_Check(like)) return PyErr_Format(PyExc_TypeError, "%R is not a batch", like);
    PyObject *batch = PyDict_Copy(like), *key, *part;
    Py_ssize_t at = 0;
    while (batch && PyDict_Next(like, &at, &key, &part)) {
        PyObject *made = new_part(part, count);
        if (!made || PyDict_SetItem(batch, key, made) < 0) Py_CLEAR(batch);
        Py_XDECREF(made);
    }
    return batch;
}

/* new_batch(like, count): returns a batch of `count` rows, whose content is undefined, in the form
   of another batch of numbers and texts. */
PyObject *new_batch(PyObject *Py_UNUSED(module), PyObject *args)
{
    PyObject *like;
    npy_intp count;
    if (!PyArg_ParseTuple(args, "On", &like, &count)) return NULL;
    if (count < 0) return PyErr_Format(PyExc_ValueError, "%zd rows", count);
    return new_part(like, count);
}

/* Returns row i of an array: a view, or a Python number if the array has one axis. */
static PyObject *array_row(PyArrayObject *array, npy_intp i)
{
    const int axes = PyArray_NDIM(array) - 1;
    if (axes < 0 || i >= PyArray_DIM(array, 0)) {
        return PyErr_Format(PyExc_IndexError, "a batch has no row %zd", i);
    }
    char *data = PyArray_BYTES(array) + i * PyArray_STRIDE(array, 0);
    if (!axes && PyArray_TYPE(array) == NPY_DOUBLE) return PyFloat_FromDouble(*(double *)data);
    if (!axes) return PyArray_GETITEM(array, data);
    PyArray_Descr *type = PyArray_DESCR(array);
    Py_INCREF(type);
    PyObject *row = PyArray_NewFromDescr(&PyArray_Type, type, axes, PyArray_DIMS(array) + 1,
                                         PyArray_STRIDES(array) + 1, data,
                                         PyArray_FLAGS(array) & NPY_ARRAY_WRITEABLE, NULL);
    if (row && PyArray_SetBaseObject((PyArrayObject *)row, Py_NewRef(array)) < 0) Py_CLEAR(row);
    return row;
}

/* Returns the value of row i of a batch. */
static PyObject *batch_row(PyObject *batch, npy_intp i)
{
    if (PyArray_Check(batch)) return array_row((PyArrayObject *)batch, i);
    if (PyList_Check(batch)) return Py_XNewRef(PyList_GetItem(batch, i));
    if (!PyDict_Check(batch)) return PyErr_Format(PyExc_TypeError, "%R is not a batch", batch);
    PyObject *row = PyDict_Copy(batch), *key, *part; /* faster than filling an empty dict */
    Py_ssize_t at = 0;
    while (row && PyDict_Next(batch, &at, &key, &part)) {
        PyObject *value = batch_row(part, i);
        if (!value || PyDict_SetItem(row, key, value) < 0) Py_CLEAR(row);
        Py_XDECREF(value);
    }
    return row;
}

/* split_batch(batch, agents): returns a dict from agents, a tuple, to the values of a batch's first
   rows. Arrays are views of the batch's rows. */
PyObject *split_batch(PyObject *Py_UNUSED(module), PyObject *args)
{
    PyObject *batch, *agents;
    if (!PyArg_ParseTuple(args, "OO!", &batch, &PyTuple_Type, &agents)) return NULL;
    PyObject *rows = PyDict_New();
    for (Py_ssize_t i = 0; rows && i < PyTuple_GET_SIZE(agents); i++) {
        PyObject *row = batch_row(batch, i);
        if (!row || PyDict_SetItem(rows, PyTuple_GET_ITEM(agents, i), row) < 0) Py_CLEAR(rows);
        Py_XDECREF(row);
    }
    return rows;
}
