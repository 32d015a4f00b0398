/* Joins arrays of one dtype and shape. */

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
    if (!PyTuple_Check(rows)) return PyErr_Format(PyExc_TypeError, "expected a tuple");
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
