/* The extension module, and the functions that its parts share. */

#define STKZOO_EXTENSION
#include "kernel.h"

#include <stddef.h>
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

#define AT(TYPE, FIELD) {#TYPE "." #FIELD, offsetof(TYPE, FIELD)}

/* layouts(): returns the name and byte offset of each record field, to compare with the dtypes. */
static PyObject *layouts(PyObject *Py_UNUSED(module), PyObject *Py_UNUSED(none))
{
    static const struct {
        const char *name;
        size_t offset;
    } FIELDS[] = {
        AT(Header, time), AT(Header, aux_ticks), AT(Header, phase), AT(Header, num_kart),
        AT(Header, num_items), AT(Header, running), AT(Kart, location), AT(Kart, rotation),
        AT(Kart, front), AT(Kart, velocity), AT(Kart, velocity_lc), AT(Kart, angular_velocity),
        AT(Kart, size), AT(Kart, speed), AT(Kart, max_steer_angle), AT(Kart, wheel_base),
        AT(Kart, energy), AT(Kart, skeed_factor), AT(Kart, shield_time),
        AT(Kart, attachment_time_left), AT(Kart, distance_down_track), AT(Kart, overall_distance),
        AT(Kart, finish_time), AT(Kart, lap_time), AT(Kart, node), AT(Kart, position),
        AT(Kart, finished_laps), AT(Kart, powerup_type), AT(Kart, powerup_num),
        AT(Kart, attachment_type), AT(Kart, has_finished_race), AT(Kart, race_result),
        AT(Kart, jumping), AT(Kart, is_on_road), AT(Kart, control), AT(Item, location),
        AT(Item, size), AT(Item, type), AT(Item, id),
    };
    PyObject *all = PyList_New(0);
    for (size_t i = 0; all && i < sizeof FIELDS / sizeof *FIELDS; i++) {
        PyObject *field = Py_BuildValue("sn", FIELDS[i].name, (Py_ssize_t)FIELDS[i].offset);
        if (!field || PyList_Append(all, field) < 0) Py_CLEAR(all);
        Py_XDECREF(field);
    }
    return all;
}

static PyMethodDef methods[] = {
    {"action_mask", action_mask, METH_VARARGS, "Returns masks of the actions with an effect."},
    {"join_rows", join_rows, METH_O, "Returns the bytes of arrays of one dtype and shape."},
    {"layouts", layouts, METH_NOARGS, "Returns the byte offsets of record fields."},
    {"look_along", look_along, METH_VARARGS, "Writes points at distances ahead of karts."},
    {"new_batch", new_batch, METH_VARARGS, "Returns a batch without content."},
    {"reward_term", reward_term, METH_VARARGS, "Returns a reward term of all karts."},
    {"split_batch", split_batch, METH_VARARGS, "Returns the values of a batch's rows."},
    {"stack_vectors", stack_vectors, METH_VARARGS, "Writes the vectors of rows, padded."},
    {"to_polar", to_polar, METH_O, "Returns positions as two angles and a distance."},
    {"trace_roads", trace_roads, METH_VARARGS, "Writes the lines ahead of karts."},
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
        &KartObserverType,  &MlpType, &RacingObserverType, &StepScorerType,   &TrackGraphType,
    };
    import_array();
    PyObject *kernel = PyModule_Create(&module);
    for (size_t i = 0; kernel && i < sizeof TYPES / sizeof *TYPES; i++) {
        if (PyModule_AddType(kernel, TYPES[i]) < 0) Py_CLEAR(kernel);
    }
    return kernel;
}
