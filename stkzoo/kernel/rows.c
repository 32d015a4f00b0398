/* Rows that are alike, as one block. */

#include "kernel.h"

#include <string.h>

static int is_like(PyArrayObject *row, PyArrayObject *first)
{
    const int axes = PyArray_NDIM(first);
    return PyArray_DESCR(row) == PyArray_DESCR(first) && PyArray_NDIM(row) == axes &&
           PyArray_IS_C_CONTIGUOUS(row) &&
           PyArray_CompareLists(PyArray_DIMS(row), PyArray_DIMS(first), axes);
}

/* join_rows(tuple): the bytes of arrays of one dtype and shape, one after the other; None if
   they are not alike or do not lie in one piece. */
PyObject *join_rows(PyObject *Py_UNUSED(module), PyObject *const *args, Py_ssize_t nargs)
{
    if (nargs != 1 || !PyTuple_Check(args[0])) {
        return PyErr_Format(PyExc_TypeError, "expected one tuple");
    }
    const Py_ssize_t count = PyTuple_GET_SIZE(args[0]);
    for (Py_ssize_t i = 0; i < count; i++) {
        PyObject *row = PyTuple_GET_ITEM(args[0], i);
        if (!PyArray_CheckExact(row) ||
            !is_like((PyArrayObject *)row, (PyArrayObject *)PyTuple_GET_ITEM(args[0], 0))) {
            Py_RETURN_NONE;
        }
    }
    if (count == 0) Py_RETURN_NONE;
    PyArrayObject *first = (PyArrayObject *)PyTuple_GET_ITEM(args[0], 0);
    if (PyDataType_REFCHK(PyArray_DESCR(first))) Py_RETURN_NONE;
    const npy_intp size = PyArray_NBYTES(first);
    PyObject *block = PyBytes_FromStringAndSize(NULL, count * size);
    for (Py_ssize_t i = 0; block && i < count; i++) {
        PyArrayObject *row = (PyArrayObject *)PyTuple_GET_ITEM(args[0], i);
        memcpy(PyBytes_AS_STRING(block) + i * size, PyArray_DATA(row), (size_t)size);
    }
    return block;
}
