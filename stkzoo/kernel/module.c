/* The extension module, and the functions that its parts share. */

#define STKZOO_EXTENSION
#include "kernel.h"

#include <string.h>

/* ---------------------------------------------------------------- snapshots */

int as_snapshot(PyObject *object, void *out)
{
    Snapshot *snapshot = out;
    if (!PyBytes_Check(object)) {
        PyErr_Format(PyExc_TypeError, "expected a snapshot's bytes, not %R", object);
        return 0;
    }
    const size_t size = (size_t)PyBytes_GET_SIZE(object);
    const Header *header = snapshot->header = (const Header *)PyBytes_AS_STRING(object);
    if (size < sizeof *header || header->num_kart < 0 || header->num_items < 0 ||
        size != sizeof *header + (size_t)header->num_kart * sizeof(Kart) +
                    (size_t)header->num_items * sizeof(Item)) {
        PyErr_Format(PyExc_ValueError, "%zu bytes are not a snapshot", size);
        return 0;
    }
    snapshot->karts = (const Kart *)(header + 1);
    snapshot->items = (const Item *)(snapshot->karts + header->num_kart);
    return 1;
}

/* ---------------------------------------------------------------- objects */

typedef struct {
    OBJECT_HEAD
} Object;

PyObject *keep(void *self, PyObject *made)
{
    if (!made) return NULL;
    const int status = PyList_Append(((Object *)self)->kept, made);
    Py_DECREF(made);
    return status < 0 ? NULL : made;
}

void *room_for(void *self, npy_intp count, size_t size)
{
    const size_t bytes = (size_t)count * size;
    PyObject *room = keep(self, PyByteArray_FromStringAndSize(NULL, (Py_ssize_t)bytes));
    return room ? memset(PyByteArray_AS_STRING(room), 0, bytes) : NULL;
}

PyObject *new_object(PyTypeObject *type, PyObject *args, PyObject *kwargs)
{
    Object *self = (Object *)type->tp_alloc(type, 0);
    if (self && !(self->kept = Py_BuildValue("[OO]", args, kwargs ? kwargs : Py_None))) {
        Py_CLEAR(self);
    }
    return (PyObject *)self;
}

void free_object(PyObject *self)
{
    Py_XDECREF(((Object *)self)->kept);
    Py_TYPE(self)->tp_free(self);
}

/* ---------------------------------------------------------------- the module */

static PyMethodDef methods[] = {
    {"action_mask", action_mask, METH_VARARGS, "Returns which actions have an effect."},
    {"join_rows", join_rows, METH_O, "Returns the bytes of arrays of one dtype and shape."},
    {"look_around", look_around, METH_VARARGS, "Writes the surroundings of karts."},
    {"new_batch", new_batch, METH_VARARGS, "Returns a batch without content."},
    {"observe_standing", observe_standing, METH_VARARGS, "Writes the standing of karts."},
    {"observe_racing", observe_racing, METH_VARARGS, "Writes the view `racing` of karts."},
    {"split_batch", split_batch, METH_VARARGS, "Returns the values of a batch's rows."},
    {"to_polar", to_polar, METH_O, "Returns positions as two angles and a distance."},
    {"trace_roads", trace_roads, METH_VARARGS, "Writes the lines ahead of karts."},
    {"write_racing_view", write_racing_view, METH_VARARGS, "Writes the view `racing` for surroundings."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {
    PyModuleDef_HEAD_INIT,
    .m_name = "stkzoo.kernel._kernel",
    .m_doc = "The inner loops of a step.",
    .m_size = -1,
    .m_methods = methods,
};

PyMODINIT_FUNC PyInit__kernel(void)
{
    static PyTypeObject *const TYPES[] = {
        &ActionReaderType,  &CarControllerType,  &EventCounterType, &GameStepperType,
        &KartObserverType,  &StepScorerType,   &TrackGraphType,
    };
    import_array();
    PyObject *kernel = PyModule_Create(&module);
    PyObject *sizes = Py_BuildValue("(nnn)", sizeof(Header), sizeof(Kart), sizeof(Item));
    if (kernel && PyModule_AddObjectRef(kernel, "RECORD_SIZES", sizes) < 0) Py_CLEAR(kernel);
    Py_XDECREF(sizes);
    for (size_t i = 0; kernel && i < sizeof TYPES / sizeof *TYPES; i++) {
        if (PyModule_AddType(kernel, TYPES[i]) < 0) Py_CLEAR(kernel);
    }
    return kernel;
}
