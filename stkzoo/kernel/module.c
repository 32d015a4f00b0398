/* The module and what its parts share. */

#define STKZOO_KERNEL_MODULE
#include "kernel.h"

#include <stddef.h>

void *numbers_of(PyObject *object, const char *name, int type, npy_intp *count)
{
    PyArrayObject *array = (PyArrayObject *)object;
    if (!PyArray_Check(object) || !PyArray_EquivTypenums(PyArray_TYPE(array), type)) {
        PyErr_Format(PyExc_TypeError, "%s must be an array of another type", name);
        return NULL;
    }
    if (!PyArray_IS_C_CONTIGUOUS(array) || !PyArray_ISALIGNED(array)) {
        PyErr_Format(PyExc_ValueError, "%s must be C-contiguous and aligned", name);
        return NULL;
    }
    *count = PyArray_SIZE(array);
    return PyArray_DATA(array);
}

int read_moment(PyObject *data, Moment *moment)
{
    if (!PyBytes_Check(data)) {
        PyErr_Format(PyExc_TypeError, "expected a snapshot's bytes, not %R", data);
        return -1;
    }
    const size_t size = (size_t)PyBytes_GET_SIZE(data);
    const char *bytes = PyBytes_AS_STRING(data);
    moment->header = (const Header *)bytes;
    const Header *header = moment->header;
    if (size < sizeof *header || header->num_kart < 0 || header->num_items < 0 ||
        size != sizeof *header + (size_t)header->num_kart * sizeof(Kart) +
                    (size_t)header->num_items * sizeof(Item)) {
        PyErr_Format(PyExc_ValueError, "%zu bytes are no snapshot", size);
        return -1;
    }
    moment->karts = (const Kart *)(bytes + sizeof *header);
    moment->items = (const Item *)(moment->karts + header->num_kart);
    return 0;
}

static int add_field(PyObject *layout, const char *name, size_t offset)
{
    PyObject *number = PyLong_FromSize_t(offset);
    const int status = number ? PyDict_SetItemString(layout, name, number) : -1;
    Py_XDECREF(number);
    return status;
}

#define FIELD(type, name) add_field(layout, #name, offsetof(type, name))

static int describe_header(PyObject *layout)
{
    return FIELD(Header, time) | FIELD(Header, aux_ticks) | FIELD(Header, phase) |
           FIELD(Header, num_kart) | FIELD(Header, num_items) | FIELD(Header, running);
}

static int describe_kart(PyObject *layout)
{
    return FIELD(Kart, location) | FIELD(Kart, rotation) | FIELD(Kart, front) |
           FIELD(Kart, velocity) | FIELD(Kart, velocity_lc) | FIELD(Kart, angular_velocity) |
           FIELD(Kart, size) | FIELD(Kart, speed) | FIELD(Kart, max_steer_angle) |
           FIELD(Kart, wheel_base) | FIELD(Kart, energy) | FIELD(Kart, skeed_factor) |
           FIELD(Kart, shield_time) | FIELD(Kart, attachment_time_left) |
           FIELD(Kart, distance_down_track) | FIELD(Kart, overall_distance) |
           FIELD(Kart, finish_time) | FIELD(Kart, lap_time) | FIELD(Kart, node) |
           FIELD(Kart, position) | FIELD(Kart, finished_laps) | FIELD(Kart, powerup_type) |
           FIELD(Kart, powerup_num) | FIELD(Kart, attachment_type) |
           FIELD(Kart, has_finished_race) | FIELD(Kart, race_result) | FIELD(Kart, jumping) |
           FIELD(Kart, is_on_road) | FIELD(Kart, control);
}

static int describe_item(PyObject *layout)
{
    return FIELD(Item, location) | FIELD(Item, size) | FIELD(Item, type) | FIELD(Item, id);
}

/* Where the fields of the records are, in bytes, for a comparison with the dtypes. */
static PyObject *layouts(PyObject *Py_UNUSED(module), PyObject *Py_UNUSED(none))
{
    static const struct {
        const char *name;
        int (*describe)(PyObject *);
    } RECORDS[] = {{"header", describe_header}, {"kart", describe_kart}, {"item", describe_item}};
    PyObject *all = PyDict_New();
    for (int i = 0; all && i < 3; i++) {
        PyObject *layout = PyDict_New();
        if (!layout || RECORDS[i].describe(layout) ||
            PyDict_SetItemString(all, RECORDS[i].name, layout) < 0) {
            Py_CLEAR(all);
        }
        Py_XDECREF(layout);
    }
    return all;
}

static PyMethodDef methods[] = {
    FAST_METHOD("join_rows", join_rows, "The bytes of arrays that are alike."),
    {"layouts", layouts, METH_NOARGS, "Where the fields of the records are."},
    FAST_METHOD("weigh_plans", weigh_plans, "The best plan of each manoeuvre, for some karts."),
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
    static PyTypeObject *const TYPES[] = {
        &ActionReaderType,   &CarControllerType, &GameStepperType, &KartObserverType,
        &RacingObserverType, &StepScorerType,    &TrackGraphType,
    };
    const size_t count = sizeof TYPES / sizeof *TYPES;
    import_array();
    PyObject *kernel = PyModule_Create(&module);
    for (size_t i = 0; kernel && i < count; i++) {
        if (PyModule_AddType(kernel, TYPES[i]) < 0) Py_CLEAR(kernel);
    }
    return kernel;
}
