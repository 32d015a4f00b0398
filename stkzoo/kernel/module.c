/* The module and what its parts share. */

#define STKZOO_KERNEL_MODULE
#include "kernel.h"

#include <stddef.h>

static void *data_of(PyArrayObject *array, const char *name, npy_intp *count)
{
    if (!PyArray_IS_C_CONTIGUOUS(array) || !PyArray_ISALIGNED(array)) {
        PyErr_Format(PyExc_ValueError, "%s must be C-contiguous and aligned", name);
        return NULL;
    }
    *count = PyArray_SIZE(array);
    return PyArray_DATA(array);
}

void *array_of(PyObject *object, const char *name, size_t item_size, npy_intp *count)
{
    if (!PyArray_Check(object) ||
        (size_t)PyArray_ITEMSIZE((PyArrayObject *)object) != item_size) {
        PyErr_Format(PyExc_TypeError, "%s must be an array of items of %zu bytes", name, item_size);
        return NULL;
    }
    return data_of((PyArrayObject *)object, name, count);
}

void *numbers_of(PyObject *object, const char *name, int type, npy_intp *count)
{
    if (!PyArray_Check(object) ||
        !PyArray_EquivTypenums(PyArray_TYPE((PyArrayObject *)object), type)) {
        PyErr_Format(PyExc_TypeError, "%s must be an array of another type", name);
        return NULL;
    }
    return data_of((PyArrayObject *)object, name, count);
}

#define FIELD(type, name) #name, (Py_ssize_t)offsetof(type, name)

/* Where the fields of a record are, in bytes, for a comparison with the dtypes. */
static PyObject *layouts(PyObject *Py_UNUSED(module), PyObject *Py_UNUSED(none))
{
    return Py_BuildValue(
        "{s:{s:n,s:n,s:n,s:n,s:n,s:n,s:n,s:n,s:n,s:n,s:n,s:n,s:n,s:n,s:n,s:n,s:n,s:n,s:n,s:n,"
        "s:n,s:n,s:n,s:n,s:n,s:n,s:n,s:n,s:n},s:{s:n,s:n,s:n,s:n}}",
        "kart", FIELD(Kart, location), FIELD(Kart, rotation), FIELD(Kart, front),
        FIELD(Kart, velocity), FIELD(Kart, velocity_lc), FIELD(Kart, angular_velocity),
        FIELD(Kart, size), FIELD(Kart, speed), FIELD(Kart, max_steer_angle),
        FIELD(Kart, wheel_base), FIELD(Kart, energy), FIELD(Kart, skeed_factor),
        FIELD(Kart, shield_time), FIELD(Kart, attachment_time_left),
        FIELD(Kart, distance_down_track), FIELD(Kart, overall_distance), FIELD(Kart, finish_time),
        FIELD(Kart, lap_time), FIELD(Kart, node), FIELD(Kart, position),
        FIELD(Kart, finished_laps), FIELD(Kart, powerup_type), FIELD(Kart, powerup_num),
        FIELD(Kart, attachment_type), FIELD(Kart, has_finished_race),
        FIELD(Kart, race_result), FIELD(Kart, jumping), FIELD(Kart, is_on_road),
        FIELD(Kart, control), "item", FIELD(Item, location), FIELD(Item, size), FIELD(Item, type),
        FIELD(Item, id));
}

#define FAST(function) (PyCFunction)(void (*)(void))(function), METH_FASTCALL

static PyMethodDef methods[] = {
    {"copy_fields", FAST(copy_fields), "Fills records from a block of bytes."},
    {"copy_attributes", FAST(copy_attributes), "Fills records from attributes of objects."},
    {"set_actions", FAST(set_actions), "Sets the attributes of actions that have changed."},
    {"score", FAST(score), "The reward terms of one step."},
    {"add_up", FAST(add_up), "Adds a step's terms to their sums; the rows' totals."},
    {"finished", FAST(finished), "Which karts have finished."},
    {"make_infos", FAST(make_infos), "One info for each agent."},
    {"join_rows", FAST(join_rows), "The bytes of arrays that are alike."},
    {"layouts", layouts, METH_NOARGS, "Where the fields of the records are."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {
    PyModuleDef_HEAD_INIT,
    .m_name = "stkzoo.kernel._kernel",
    .m_doc = "The step's inner loops.",
    .m_size = -1,
    .m_methods = methods,
};

PyMODINIT_FUNC PyInit__kernel(void)
{
    import_array();
    if (PyType_Ready(&ViewType) < 0 || PyType_Ready(&ControlsType) < 0) return NULL;
    PyObject *kernel = PyModule_Create(&module);
    if (kernel && (PyModule_AddObjectRef(kernel, "View", (PyObject *)&ViewType) < 0 ||
                   PyModule_AddObjectRef(kernel, "Controls", (PyObject *)&ControlsType) < 0)) {
        Py_CLEAR(kernel);
    }
    return kernel;
}
