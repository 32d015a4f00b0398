/* Reads arguments of functions of the extensions. */

#include "arguments.h"

#include <string.h>

int as_array(PyObject *object, int type, int flags, void *out)
{
    PyArrayObject *array = (PyArrayObject *)object;
    if (!PyArray_Check(object) || !PyArray_EquivTypenums(PyArray_TYPE(array), type)) {
        PyArray_Descr *expected = PyArray_DescrFromType(type);
        PyErr_Format(PyExc_TypeError, "expected an array of %S, not %R", expected, object);
        Py_XDECREF(expected);
        return 0;
    }
    if (!PyArray_CHKFLAGS(array, flags | NPY_ARRAY_CARRAY_RO) || !PyArray_ISNOTSWAPPED(array)) {
        PyErr_Format(PyExc_ValueError, "an array must be C-contiguous, aligned%s and native-endian",
                     flags ? ", writeable" : "");
        return 0;
    }
    /* Floats, Doubles and the other types differ only in the type of their pointer. */
    const struct { void *data; npy_intp size; } numbers = {PyArray_DATA(array), PyArray_SIZE(array)};
    memcpy(out, &numbers, sizeof numbers);
    return 1;
}

#define CONVERTERS(NAME, TYPE)                                                                    \
    int as_##NAME(PyObject *object, void *array)                                                  \
    {                                                                                             \
        return as_array(object, TYPE, 0, array);                                                  \
    }                                                                                             \
    int as_written_##NAME(PyObject *object, void *array)                                          \
    {                                                                                             \
        return as_array(object, TYPE, NPY_ARRAY_WRITEABLE, array);                                \
    }

CONVERTERS(floats, NPY_FLOAT32)
CONVERTERS(doubles, NPY_FLOAT64)
CONVERTERS(indices, NPY_INTP)
CONVERTERS(wholes, NPY_INT64)
CONVERTERS(bytes, NPY_INT8)
CONVERTERS(flags, NPY_BOOL)

int is_tuple(PyObject *object)
{
    if (PyTuple_Check(object)) return 1;
    PyErr_Format(PyExc_TypeError, "must be tuple, not %.50s", Py_TYPE(object)->tp_name);
    return 0;
}

int are_below(Indices indices, npy_intp limit)
{
    for (npy_intp i = 0; i < indices.size; i++) {
        if (indices.data[i] < 0 || indices.data[i] >= limit) return 0;
    }
    return 1;
}

int check_rows(const char *name, Indices indices, npy_intp limit, Indices rows, npy_intp num_rows)
{
    if (indices.size != rows.size) {
        PyErr_Format(PyExc_ValueError, "%zd %ss for %zd rows", indices.size, name, rows.size);
        return -1;
    }
    if (are_below(indices, limit) && are_below(rows, num_rows)) return 0;
    PyErr_Format(PyExc_IndexError, "a %s index or a row index is out of range", name);
    return -1;
}

int are_sizes(const npy_intp (*pairs)[2], size_t count)
{
    for (size_t i = 0; i < count; i++) {
        if (pairs[i][0] != pairs[i][1]) return refuse("the arrays do not fit together");
    }
    return 0;
}

int read_around(PyObject *tuple, int is_written, Around *around)
{
    int (*const floats)(PyObject *, void *) = is_written ? as_written_floats : as_floats;
    int (*const wholes)(PyObject *, void *) = is_written ? as_written_wholes : as_wholes;
    if (!PyArg_ParseTuple(tuple, "O&O&O&O&O&", floats, &around->own, floats, &around->road, floats,
                          &around->karts, floats, &around->items, wholes, &around->types)) {
        return -1;
    }
    const npy_intp count = around->count = around->own.size / OWN_SIZE, divisor = count ? count : 1;
    around->num_looks = around->road.size / (LINE_SIZE * divisor);
    around->num_karts = around->karts.size / (3 * divisor);
    around->num_items = around->types.size / divisor;
    const npy_intp sizes[][2] = {
        {around->own.size, OWN_SIZE * count},
        {around->road.size, LINE_SIZE * around->num_looks * count},
        {around->karts.size, 3 * around->num_karts * count},
        {around->items.size, 3 * around->num_items * count},
        {around->types.size, around->num_items * count},
    };
    return ARE_SIZES(sizes);
}

int refuse(const char *message)
{
    if (!PyErr_Occurred()) PyErr_SetString(PyExc_ValueError, message);
    return -1;
}
