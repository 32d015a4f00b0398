/* From the engine's objects to records, and back to its actions. */

#include "kernel.h"

#include <string.h>

/* One row of a copying plan. */
typedef struct {
    npy_int32 from, to, words; /* offsets [bytes]; 4-byte words, 0 for one byte to an int */
} Field;

/* copy_fields(block, starts, records, plan): fills records from where they start in the block. */
PyObject *copy_fields(PyObject *Py_UNUSED(module), PyObject *const *args, Py_ssize_t nargs)
{
    char *block, *record;
    Py_ssize_t size;
    npy_intp count, num_records, num_numbers;
    if (nargs != 4) {
        return PyErr_Format(PyExc_TypeError, "copy_fields() takes 4 arguments, not %zd", nargs);
    }
    if (PyBytes_AsStringAndSize(args[0], &block, &size) < 0) return NULL;
    const npy_intp *starts = numbers_of(args[1], "starts", NPY_INTP, &count);
    if (!starts) return NULL;
    if (!PyArray_Check(args[2])) {
        return PyErr_Format(PyExc_TypeError, "records must be an array");
    }
    const npy_intp stride = PyArray_ITEMSIZE((PyArrayObject *)args[2]);
    if (!(record = array_of(args[2], "records", (size_t)stride, &num_records))) return NULL;
    const npy_int32 *plan = numbers_of(args[3], "plan", NPY_INT32, &num_numbers);
    if (!plan) return NULL;
    if (num_records != count || num_numbers % 3) {
        return PyErr_Format(PyExc_ValueError, "%zd starts for %zd records", count, num_records);
    }
    const Field *fields = (const Field *)plan;
    for (npy_intp i = 0; i < count; i++, record += stride) {
        for (npy_intp f = 0; f < num_numbers / 3; f++) {
            const Field *field = fields + f;
            const npy_intp length = field->words ? 4 * (npy_intp)field->words : 1;
            const npy_intp at = starts[i] + field->from;
            if (at < 0 || at + length > size || field->to + (field->words ? length : 4) > stride) {
                return PyErr_Format(PyExc_ValueError, "field %zd of record %zd is outside", f, i);
            }
            if (field->words) {
                memcpy(record + field->to, block + at, (size_t)length);
            } else {
                const npy_int32 value = (unsigned char)block[at];
                memcpy(record + field->to, &value, sizeof value);
            }
        }
    }
    Py_RETURN_NONE;
}

static int copy_number(PyObject *value, int is_whole, char *to)
{
    if (is_whole) {
        const npy_int32 number = (npy_int32)PyLong_AsLong(value);
        memcpy(to, &number, sizeof number);
    } else {
        const float number = (float)PyFloat_AsDouble(value);
        memcpy(to, &number, sizeof number);
    }
    return PyErr_Occurred() ? -1 : 0;
}

static int copy_attribute(PyObject *object, PyObject *name, const npy_int32 *to, char *record)
{
    const npy_int32 offset = to[0], count = to[1], is_whole = to[2];
    PyObject *value = PyObject_GetAttr(object, name);
    if (!value) return -1;
    int status = 0;
    if (count == 1) {
        status = copy_number(value, is_whole, record + offset);
    } else {
        PyObject *parts = PySequence_Fast(value, "expected a sequence");
        if (!parts || PySequence_Fast_GET_SIZE(parts) != count) status = -1;
        for (npy_int32 i = 0; !status && i < count; i++) {
            PyObject *part = PySequence_Fast_GET_ITEM(parts, i);
            status = copy_number(part, is_whole, record + offset + 4 * i);
        }
        Py_XDECREF(parts);
    }
    Py_DECREF(value);
    if (status && !PyErr_Occurred()) PyErr_Format(PyExc_ValueError, "%S has another length", name);
    return status;
}

/* copy_attributes(objects, names, records, plan): fills records from attributes of objects; the
   plan has, for each name, the offset in the record, how many numbers, and whether whole. */
PyObject *copy_attributes(PyObject *Py_UNUSED(module), PyObject *const *args, Py_ssize_t nargs)
{
    npy_intp num_records, num_numbers;
    if (nargs != 4 || !PyList_Check(args[0]) || !PyTuple_Check(args[1]) ||
        !PyArray_Check(args[2])) {
        return PyErr_Format(PyExc_TypeError, "expected a list, a tuple and two arrays");
    }
    const npy_intp stride = PyArray_ITEMSIZE((PyArrayObject *)args[2]);
    char *record = array_of(args[2], "records", (size_t)stride, &num_records);
    if (!record) return NULL;
    const npy_int32 *plan = numbers_of(args[3], "plan", NPY_INT32, &num_numbers);
    if (!plan) return NULL;
    const Py_ssize_t num_names = PyTuple_GET_SIZE(args[1]);
    if (PyList_GET_SIZE(args[0]) != num_records || num_numbers != 3 * num_names) {
        return PyErr_Format(PyExc_ValueError, "the arguments do not fit together");
    }
    for (npy_intp i = 0; i < num_records; i++, record += stride) {
        for (Py_ssize_t n = 0; n < num_names; n++) {
            const npy_int32 *to = plan + 3 * n;
            if (to[0] < 0 || to[1] < 1 || to[0] + 4 * to[1] > stride) {
                return PyErr_Format(PyExc_ValueError, "attribute %zd is outside", n);
            }
            PyObject *name = PyTuple_GET_ITEM(args[1], n);
            if (copy_attribute(PyList_GET_ITEM(args[0], i), name, to, record) < 0) return NULL;
        }
    }
    Py_RETURN_NONE;
}

/* set_actions(actions, names, controls, present): gives each object of a list the attributes of
   its row of controls, where they differ from `present`, which is brought up to date. The first
   two are numbers, the others true or false. */
PyObject *set_actions(PyObject *Py_UNUSED(module), PyObject *const *args, Py_ssize_t nargs)
{
    npy_intp size, num_present;
    if (nargs != 4 || !PyList_Check(args[0]) || !PyTuple_Check(args[1])) {
        return PyErr_Format(PyExc_TypeError, "expected a list, a tuple and two arrays");
    }
    const float *controls = numbers_of(args[2], "controls", NPY_FLOAT32, &size);
    if (!controls) return NULL;
    float *present = numbers_of(args[3], "present", NPY_FLOAT32, &num_present);
    if (!present) return NULL;
    const Py_ssize_t width = PyTuple_GET_SIZE(args[1]);
    if (size != PyList_GET_SIZE(args[0]) * width || num_present != size) {
        return PyErr_Format(PyExc_ValueError, "%zd controls for %zd actions of %zd", size,
                            PyList_GET_SIZE(args[0]), width);
    }
    for (npy_intp i = 0; i < size; i++) {
        if (controls[i] == present[i]) continue;
        const npy_intp column = i % width;
        PyObject *value = column < 2 ? PyFloat_FromDouble(controls[i])
                                     : PyBool_FromLong(controls[i] > 0);
        PyObject *action = PyList_GET_ITEM(args[0], i / width);
        if (!value || PyObject_SetAttr(action, PyTuple_GET_ITEM(args[1], column), value) < 0) {
            Py_XDECREF(value);
            return NULL;
        }
        Py_DECREF(value);
        present[i] = controls[i];
    }
    Py_RETURN_NONE;
}
