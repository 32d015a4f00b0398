/* The game's step: from controls to the moment after it. */

#include "kernel.h"

#include <math.h>
#include <string.h>

/* One row of a plan for copying from the engine's own block of bytes. */
typedef struct {
    npy_int32 from, to, words; /* offsets [bytes]; 4-byte words, 0 for one byte to an int */
} Field;

/* One row of a plan for reading attributes. */
typedef struct {
    npy_int32 to, count; /* how many floats */
} Attribute;

/* A plan for copying records, and how many bytes it reaches over. */
typedef struct {
    const Field *fields;
    npy_intp count, extent;
} Plan;

typedef struct {
    OBJECT_HEAD
    PyObject *step, *update, *write, *report; /* the engine's own functions */
    PyObject *world, *actions, *controls, *attributes, *phases, *reporting;
    Indices places; /* of the karts in the block */
    Plan kart, item;
    const Attribute *kart_attributes;
    npy_intp num_kart, items_at, item_size;
    int phase, last_phase; /* phases come one after the other; the last one stays */
    float *present;        /* what the actions say */
} GameStepper;

/* ---------------------------------------------------------------- to the engine */

/* Brings the engine's actions from what they say to what they should. */
static int set_actions(GameStepper *self, const float *controls)
{
    const npy_intp size = PyList_GET_SIZE(self->actions) * NUM_CONTROLS;
    for (npy_intp i = 0; i < size; i++) {
        if (controls[i] == self->present[i]) continue;
        const npy_intp column = i % NUM_CONTROLS;
        PyObject *value = column < 2 ? PyFloat_FromDouble(controls[i])
                                     : PyBool_FromLong(controls[i] > 0);
        PyObject *action = PyList_GET_ITEM(self->actions, i / NUM_CONTROLS);
        const int failed =
            !value || PyObject_SetAttr(action, PyTuple_GET_ITEM(self->controls, column), value) < 0;
        Py_XDECREF(value);
        if (failed) return -1;
        self->present[i] = controls[i];
    }
    return 0;
}

/* Whether the race goes on after a step; -1 if it failed. */
static int advance(GameStepper *self)
{
    PyObject *answer = PyList_GET_SIZE(self->actions) ? PyObject_CallOneArg(self->step, self->actions)
                                                      : PyObject_CallNoArgs(self->step);
    const int is_running = answer ? PyObject_IsTrue(answer) : -1;
    Py_XDECREF(answer);
    return is_running;
}

/* ---------------------------------------------------------------- from the engine */

static npy_intp length_of(const Field *field)
{
    return field->words ? 4 * (npy_intp)field->words : 1;
}

/* Copies what begins at `start` of the block. */
static int copy_fields(const char *block, npy_intp size, npy_intp start, const Plan *plan,
                       void *record)
{
    if (start < 0 || start + plan->extent > size) {
        return refuse("the engine's block is shorter than it was");
    }
    for (const Field *field = plan->fields; field < plan->fields + plan->count; field++) {
        const char *from = block + start + field->from;
        char *to = (char *)record + field->to;
        switch (field->words) { /* of a size that the compiler knows, which is quicker */
        case 0: memcpy(to, &(npy_int32){(unsigned char)*from}, 4); break;
        case 1: memcpy(to, from, 4); break;
        case 3: memcpy(to, from, 12); break;
        default: memcpy(to, from, (size_t)length_of(field));
        }
    }
    return 0;
}

/* One number or a sequence of them into a record; takes over the value. */
static int copy_numbers(PyObject *value, npy_intp count, void *to)
{
    if (!value) return -1;
    if (count == 1) {
        const float number = (float)PyFloat_AsDouble(value);
        memcpy(to, &number, sizeof number);
        Py_DECREF(value);
        return PyErr_Occurred() ? -1 : 0;
    }
    PyArrayObject *array = (PyArrayObject *)PyArray_FROM_OTF(
        value, NPY_FLOAT32, NPY_ARRAY_CARRAY_RO | NPY_ARRAY_FORCECAST);
    const int fits = array && PyArray_SIZE(array) == count;
    if (fits) memcpy(to, PyArray_DATA(array), sizeof(float) * (size_t)count);
    Py_DECREF(value);
    Py_XDECREF(array);
    return fits ? 0 : refuse("an attribute of the engine has another length");
}

static int copy_attributes(const GameStepper *self, Kart *records)
{
    PyObject *karts = PyObject_GetAttrString(self->world, "karts");
    int status = karts ? 0 : -1;
    if (karts && (!PyList_Check(karts) || PyList_GET_SIZE(karts) != self->num_kart)) {
        status = refuse("the engine has other karts than before");
    }
    for (npy_intp i = 0; !status && i < self->num_kart; i++) {
        for (Py_ssize_t n = 0; !status && n < PyTuple_GET_SIZE(self->attributes); n++) {
            const Attribute *plan = self->kart_attributes + n;
            PyObject *name = PyTuple_GET_ITEM(self->attributes, n);
            status = copy_numbers(PyObject_GetAttr(PyList_GET_ITEM(karts, i), name), plan->count,
                                  (char *)(records + i) + plan->to);
        }
    }
    Py_XDECREF(karts);
    return status;
}

/* What the game's AI does with a kart, into its record. */
static int copy_report(const GameStepper *self, PyObject *number, Kart *records)
{
    const npy_intp kart = PyLong_AsSsize_t(number);
    PyObject *action = PyObject_CallOneArg(self->report, number);
    int status = action ? 0 : -1;
    for (int i = 0; !status && i < NUM_CONTROLS; i++) {
        PyObject *name = PyTuple_GET_ITEM(self->controls, i);
        status = copy_numbers(PyObject_GetAttr(action, name), 1, records[kart].control + i);
    }
    Py_XDECREF(action);
    return status;
}

static int read_karts(const GameStepper *self, const char *block, npy_intp size, Kart *karts)
{
    memset(karts, 0, (size_t)self->num_kart * sizeof *karts);
    for (npy_intp i = 0; i < self->num_kart; i++) {
        if (copy_fields(block, size, self->places.data[i], &self->kart, karts + i) < 0) return -1;
    }
    if (copy_attributes(self, karts) < 0) return -1;
    for (Py_ssize_t i = 0; i < PyTuple_GET_SIZE(self->reporting); i++) {
        if (copy_report(self, PyTuple_GET_ITEM(self->reporting, i), karts) < 0) return -1;
    }
    return 0;
}

static int read_phase(GameStepper *self)
{
    if (self->phase == self->last_phase) return 0;
    PyObject *value = PyObject_GetAttrString(self->world, "phase");
    PyObject *number = value ? PyDict_GetItemWithError(self->phases, value) : NULL;
    self->phase = number ? (int)PyLong_AsLong(number) : self->last_phase;
    Py_XDECREF(value);
    return PyErr_Occurred() ? -1 : 0;
}

static int read_header(GameStepper *self, npy_int32 num_items, int is_running, Header *header)
{
    PyObject *world = self->world;
    if (read_phase(self) < 0 ||
        copy_numbers(PyObject_GetAttrString(world, "time"), 1, &header->time) < 0 ||
        copy_numbers(PyObject_GetAttrString(world, "aux_ticks"), 1, &header->aux_ticks) < 0) {
        return -1;
    }
    header->phase = self->phase;
    header->num_kart = (npy_int32)self->num_kart;
    header->num_items = num_items;
    header->running = is_running;
    return 0;
}

/* The present moment from the engine's own block. */
static PyObject *moment_from(GameStepper *self, const char *block, npy_intp size, int is_running)
{
    npy_int32 num_items = -1;
    if (self->items_at + (npy_intp)sizeof num_items <= size) {
        memcpy(&num_items, block + self->items_at, sizeof num_items);
    }
    if (num_items < 0) return PyErr_Format(PyExc_ValueError, "the engine's block has no items");
    const size_t karts = (size_t)self->num_kart * sizeof(Kart), items = num_items * sizeof(Item);
    PyObject *data = PyBytes_FromStringAndSize(NULL, (Py_ssize_t)(sizeof(Header) + karts + items));
    if (!data) return NULL;
    Header *header = (Header *)PyBytes_AS_STRING(data);
    Kart *kart = (Kart *)(header + 1);
    Item *item = (Item *)(kart + self->num_kart);
    int status = read_header(self, num_items, is_running, header);
    if (!status) status = read_karts(self, block, size, kart);
    npy_intp at = self->items_at + (npy_intp)sizeof num_items;
    for (npy_int32 i = 0; !status && i < num_items; i++, at += self->item_size) {
        status = copy_fields(block, size, at, &self->item, item + i);
    }
    if (status) Py_CLEAR(data);
    return data;
}

static PyObject *read_now(GameStepper *self, int is_running)
{
    char *block;
    Py_ssize_t size;
    PyObject *state = PyObject_CallNoArgs(self->write), *data = NULL;
    if (!state) return NULL;
    if (!PyTuple_Check(state) || PyTuple_GET_SIZE(state) < 1) {
        PyErr_SetString(PyExc_TypeError, "the engine's state is no tuple");
    } else if (PyBytes_AsStringAndSize(PyTuple_GET_ITEM(state, 0), &block, &size) == 0) {
        data = moment_from(self, block, size, is_running);
    }
    Py_DECREF(state);
    return data;
}

/* read(is_running): the present moment, as the bytes of a Snapshot. */
static PyObject *stepper_read(PyObject *self, PyObject *is_running)
{
    const int running = PyObject_IsTrue(is_running);
    return running < 0 ? NULL : read_now((GameStepper *)self, running);
}

/* step(controls): (P, 7) float32, as a buffer; the moment after the step, as bytes. */
static PyObject *stepper_step(PyObject *object, PyObject *controls)
{
    GameStepper *self = (GameStepper *)object;
    const npy_intp size =
        PyList_GET_SIZE(self->actions) * NUM_CONTROLS * (npy_intp)sizeof(float);
    Py_buffer view;
    if (PyObject_GetBuffer(controls, &view, PyBUF_C_CONTIGUOUS) < 0) return NULL;
    int status = -1;
    if (view.len == size) {
        status = set_actions(self, view.buf);
    } else {
        PyErr_Format(PyExc_ValueError, "%zd bytes of controls, expected %zd", view.len, size);
    }
    PyBuffer_Release(&view);
    if (status < 0) return NULL;
    const int is_running = advance(self);
    if (is_running < 0) return NULL;
    PyObject *none = PyObject_CallNoArgs(self->update);
    if (!none) return NULL;
    Py_DECREF(none);
    return read_now(self, is_running);
}

#ifndef _WIN32

#include <errno.h>
#include <sys/socket.h>
#include <sys/uio.h>

/* stkzoo.engine.wire: a message of one frame. */
#pragma pack(push, 1)
typedef struct {
    char kind, num_frames;
    npy_uint32 length;
} Head;
#pragma pack(pop)

static PyObject *gone(void)
{
    PyErr_SetString(PyExc_EOFError, "the connection was closed");
    return NULL;
}

static PyObject *step_and_send(PyObject *self, int fd, PyObject *controls)
{
    PyObject *data = stepper_step(self, controls);
    if (!data) return NULL;
    Head head = {'O', 1, (npy_uint32)PyBytes_GET_SIZE(data)};
    struct iovec parts[2] = {{&head, sizeof head},
                             {PyBytes_AS_STRING(data), (size_t)PyBytes_GET_SIZE(data)}};
    struct msghdr message = {.msg_iov = parts, .msg_iovlen = 2};
    ssize_t sent;
    do sent = sendmsg(fd, &message, MSG_NOSIGNAL);
    while (sent < 0 && errno == EINTR);
    Py_DECREF(data);
    if (sent < 0) return gone();
    Py_RETURN_NONE;
}

/* serve(fd): takes the steps that are asked for over a packet socket, until something else is,
   which it returns. */
static PyObject *stepper_serve(PyObject *self, PyObject *file)
{
    static char room[1 << 18]; /* as stkzoo.engine.wire's; no threads here */
    const int fd = (int)PyLong_AsLong(file);
    if (PyErr_Occurred()) return NULL;
    for (;;) {
        const ssize_t size = recv(fd, room, sizeof room, 0);
        if (size < 0 && errno == EINTR) continue;
        if (size <= 0) return gone();
        Head head;
        memcpy(&head, room, (size_t)size < sizeof head ? (size_t)size : sizeof head);
        if ((size_t)size < sizeof head || head.kind != 'A' || head.num_frames != 1) {
            return PyBytes_FromStringAndSize(room, size);
        }
        PyObject *controls = PyMemoryView_FromMemory(room + sizeof head,
                                                     size - (ssize_t)sizeof head, PyBUF_READ);
        PyObject *none = controls ? step_and_send(self, fd, controls) : NULL;
        Py_XDECREF(controls);
        if (!none) return NULL;
        Py_DECREF(none);
    }
}

#endif

/* ---------------------------------------------------------------- the type */

/* Takes a plan for records of some size. */
static int set_plan(Plan *plan, Integers numbers, size_t size)
{
    *plan = (Plan){(const Field *)numbers.data, numbers.size / 3, 0};
    for (const Field *field = plan->fields; field < plan->fields + plan->count; field++) {
        const size_t words = field->words > 0 ? (size_t)field->words : 1;
        if (field->from < 0 || field->to < 0 || field->words < 0 ||
            (size_t)field->to + 4 * words > size) {
            return 0;
        }
        const npy_intp end = field->from + length_of(field);
        if (end > plan->extent) plan->extent = end;
    }
    return 1;
}

static int are_valid(const GameStepper *self, Integers attributes)
{
    if (attributes.size != 2 * PyTuple_GET_SIZE(self->attributes)) return 0;
    for (Py_ssize_t n = 0; n < PyTuple_GET_SIZE(self->attributes); n++) {
        const Attribute *plan = self->kart_attributes + n;
        if (plan->to < 0 || plan->count < 1 ||
            (size_t)plan->to + 4 * (size_t)plan->count > sizeof(Kart)) {
            return 0;
        }
    }
    for (Py_ssize_t i = 0; i < PyTuple_GET_SIZE(self->reporting); i++) {
        const npy_intp kart = PyLong_AsSsize_t(PyTuple_GET_ITEM(self->reporting, i));
        if (kart < 0 || kart >= self->num_kart) return 0;
    }
    return self->items_at >= 0 && self->item_size > 0 &&
           PyTuple_GET_SIZE(self->controls) == NUM_CONTROLS;
}

/* GameStepper(race, world, actions, controls, attributes, phases, last_phase, reporting, plans): the
   engine's race, world and a list of its actions, the names of the controls and of the attributes
   to read, the phases' numbers by the engine's own, the karts whose control is reported, and the
   plans of stkzoo.engine.reader.block_plans. */
static int stepper_set_up(GameStepper *self, PyObject *args, PyObject *Py_UNUSED(kwargs))
{
    PyObject *race;
    Integers kart, item, attributes;
    if (!PyArg_ParseTuple(args, "OOO!O!O!O!iO!(O&O&nnO&O&)", &race, &self->world, &PyList_Type,
                          &self->actions, &PyTuple_Type, &self->controls, &PyTuple_Type,
                          &self->attributes, &PyDict_Type, &self->phases, &self->last_phase,
                          &PyTuple_Type, &self->reporting, as_indices, &self->places, as_integers,
                          &kart, &self->items_at, &self->item_size, as_integers, &item,
                          as_integers, &attributes)) {
        return -1;
    }
    self->phase = self->last_phase - 1;
    self->num_kart = self->places.size;
    self->kart_attributes = (const Attribute *)attributes.data;
    if (!set_plan(&self->kart, kart, sizeof(Kart)) || !set_plan(&self->item, item, sizeof(Item)) ||
        !are_valid(self, attributes)) {
        return refuse("the plans do not fit together");
    }
    const npy_intp size = PyList_GET_SIZE(self->actions) * NUM_CONTROLS;
    if (!(self->present = room_for(self, size, sizeof *self->present))) return -1;
    for (npy_intp i = 0; i < size; i++) self->present[i] = NAN; /* equal to nothing */
    self->step = keep(self, PyObject_GetAttrString(race, "step"));
    self->report = keep(self, PyObject_GetAttrString(race, "get_kart_action"));
    self->update = keep(self, PyObject_GetAttrString(self->world, "update"));
    self->write = keep(self, PyObject_GetAttrString(self->world, "__getstate__"));
    return PyErr_Occurred() ? -1 : 0;
}

static PyMethodDef stepper_methods[] = {
    {"step", stepper_step, METH_O, "Advances the race; the moment after the step."},
    {"read", stepper_read, METH_O, "The present moment."},
#ifndef _WIN32
    {"serve", stepper_serve, METH_O, "Takes steps over a socket."},
#endif
    {NULL, NULL, 0, NULL},
};

KERNEL_TYPE(GameStepper, stepper, "A race of the engine, stepped and read in one go.")
