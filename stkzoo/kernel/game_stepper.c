/* Steps the game: sets the controls, advances the engine and reads the next snapshot. */

#include "kernel.h"

#include <math.h>
#include <string.h>

/* ---------------------------------------------------------------- the engine's block */

/* The engine can write its whole world as one block of bytes, its pickle state. This takes a few
   microseconds; reading the attributes one by one takes ten times as long. The engine does not
   guarantee the block's layout, so stkzoo.engine.race.GameRace uses the block only if it agrees
   with the attributes at the start of the race.

   The block is little-endian and unpadded: world time; number of players; players; number of karts;
   karts; number of items; items. A kart consists of a flag, two ids, its name and model, each
   preceded by its length, and an EngineKart. Each vector is preceded by its number of dimensions
   and its length. */

/* Fields of a kart in the block, in order. */
#define KART_FIELDS(VECTOR, NUMBER, UNKNOWN)                                                      \
    VECTOR(location, 3) VECTOR(rotation, 4) VECTOR(front, 3) VECTOR(velocity, 3)                  \
    VECTOR(velocity_lc, 3) VECTOR(size, 3)                                                        \
    NUMBER(float, shield_time) NUMBER(npy_uint8, race_result) NUMBER(npy_uint8, jumping)          \
    NUMBER(npy_int32, position) NUMBER(float, energy) NUMBER(npy_int32, finished_laps)            \
    NUMBER(float, lap_time) NUMBER(float, finish_time) NUMBER(float, overall_distance)            \
    NUMBER(float, distance_down_track) NUMBER(float, max_steer_angle) NUMBER(float, wheel_base)   \
    NUMBER(npy_uint8, attachment_type) NUMBER(float, attachment_time_left)                        \
    NUMBER(npy_uint8, powerup_type) NUMBER(npy_int32, powerup_num) UNKNOWN(npy_int32, unknown)    \
    NUMBER(float, skeed_factor) NUMBER(npy_uint8, has_finished_race) NUMBER(npy_int32, node)      \
    NUMBER(npy_uint8, is_on_road)

/* Fields of an item in the block, in order. */
#define ITEM_FIELDS(VECTOR, NUMBER, UNKNOWN)                                                      \
    UNKNOWN(npy_uint8, flag) NUMBER(npy_int32, id) VECTOR(location, 3) NUMBER(float, size)        \
    NUMBER(npy_int32, type)

#define VECTOR_MEMBER(NAME, SIZE) npy_int32 NAME##_shape[2]; float NAME[SIZE];
#define MEMBER(TYPE, NAME) TYPE NAME;
#define COPY_VECTOR(NAME, SIZE) memcpy(to->NAME, from->NAME, sizeof to->NAME);
#define COPY(TYPE, NAME) to->NAME = from->NAME;
#define SKIP(TYPE, NAME)

#pragma pack(push, 1)
typedef struct { KART_FIELDS(VECTOR_MEMBER, MEMBER, MEMBER) } EngineKart;
typedef struct { ITEM_FIELDS(VECTOR_MEMBER, MEMBER, MEMBER) } EngineItem;
#pragma pack(pop)

enum { PLAYERS_AT = 4, PLAYER_SIZE = 6, KART_IDS_SIZE = 9, NUM_TEXTS = 2 };

typedef struct {
    const char *data;
    npy_intp size;
} Block;

typedef struct {
    OBJECT_HEAD
    PyObject *step, *update, *write, *report; /* functions of the engine */
    PyObject *world, *actions, *controls, *phases, *reporting;
    PyObject *speed, *angular_velocity; /* names of attributes that the block lacks */
    npy_intp num_kart, *places, items_at; /* offsets of karts and items in the block */
    int phase, last_phase; /* phases follow in order; the last one is final */
    int has_stepped;       /* whether there are controls */
    float *present;        /* (P, 7) current controls of the engine's actions */
    Indices players;       /* (P,) karts of these actions */
} GameStepper;

/* Reads a count from the block; returns -1 with an exception set if it is invalid. */
static npy_int32 count_at(Block block, npy_intp at)
{
    npy_int32 count = -1;
    if (at + (npy_intp)sizeof count <= block.size) memcpy(&count, block.data + at, sizeof count);
    return count < 0 ? refuse("the engine's block has an unexpected layout") : count;
}

/* Finds the karts and the items in the block. Their offsets do not change during a race. */
static int find_places(GameStepper *self, Block block)
{
    const npy_intp num_players = count_at(block, PLAYERS_AT);
    npy_intp at = PLAYERS_AT + (npy_intp)sizeof(npy_int32) + PLAYER_SIZE * num_players;
    self->num_kart = num_players < 0 ? -1 : count_at(block, at);
    if (self->num_kart < 0 || self->num_kart > block.size / (npy_intp)sizeof(EngineKart) ||
        !(self->places = room_for(self, self->num_kart, sizeof *self->places))) {
        return refuse("the engine's block is too short for its karts");
    }
    at += (npy_intp)sizeof(npy_int32);
    for (npy_intp i = 0; i < self->num_kart; i++, at += (npy_intp)sizeof(EngineKart)) {
        at += KART_IDS_SIZE;
        for (int text = 0; text < NUM_TEXTS; text++) {
            const npy_int32 length = count_at(block, at);
            if (length < 0) return -1;
            at += (npy_intp)sizeof length + length;
        }
        self->places[i] = at;
    }
    self->items_at = at;
    return 0;
}

/* ---------------------------------------------------------------- to the engine */

/* Updates the engine's actions where controls have changed. `controls` may be unaligned, because in
   a message it follows a header of six bytes. */
static int set_actions(GameStepper *self, const char *controls)
{
    const npy_intp size = PyList_GET_SIZE(self->actions) * NUM_CONTROLS;
    for (npy_intp i = 0; i < size; i++) {
        float control;
        memcpy(&control, controls + i * (npy_intp)sizeof control, sizeof control);
        if (control == self->present[i]) continue;
        const npy_intp column = i % NUM_CONTROLS;
        PyObject *value = column < 2 ? PyFloat_FromDouble(control) : PyBool_FromLong(control > 0);
        PyObject *action = PyList_GET_ITEM(self->actions, i / NUM_CONTROLS);
        const int failed =
            !value || PyObject_SetAttr(action, PyTuple_GET_ITEM(self->controls, column), value) < 0;
        Py_XDECREF(value);
        if (failed) return -1;
        self->present[i] = control;
    }
    return 0;
}

/* ---------------------------------------------------------------- from the engine */

/* Copies a number or a sequence of `count` numbers to a record, and releases `value`. */
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
    return fits ? 0 : refuse("an attribute of the engine has an unexpected length");
}

/* Copies the controls that the game's AI chose for a kart to the kart's record. */
static int copy_report(const GameStepper *self, PyObject *number, Kart *records)
{
    const npy_intp kart = PyLong_AsSsize_t(number);
    if (kart < 0 || kart >= self->num_kart) return refuse("a reporting kart is out of range");
    PyObject *action = PyObject_CallOneArg(self->report, number);
    int status = action ? 0 : -1;
    for (int i = 0; !status && i < NUM_CONTROLS; i++) {
        PyObject *name = PyTuple_GET_ITEM(self->controls, i);
        status = copy_numbers(PyObject_GetAttr(action, name), 1, records[kart].control + i);
    }
    Py_XDECREF(action);
    return status;
}

/* Reads a kart from the block, and the fields that the block lacks from its attributes. */
static int read_kart(const GameStepper *self, PyObject *kart, const EngineKart *from, Kart *to)
{
    KART_FIELDS(COPY_VECTOR, COPY, SKIP)
    memset(to->control, 0, sizeof to->control);
    const int status = copy_numbers(PyObject_GetAttr(kart, self->speed), 1, &to->speed);
    return status ? status : copy_numbers(PyObject_GetAttr(kart, self->angular_velocity), 3,
                                          to->angular_velocity);
}

static int read_karts(const GameStepper *self, Block block, Kart *records)
{
    PyObject *karts = PyObject_GetAttrString(self->world, "karts");
    int status = karts ? 0 : -1;
    if (karts && (!PyList_Check(karts) || PyList_GET_SIZE(karts) != self->num_kart)) {
        status = refuse("the engine's karts have changed");
    }
    for (npy_intp i = 0; !status && i < self->num_kart; i++) {
        status = read_kart(self, PyList_GET_ITEM(karts, i),
                           (const EngineKart *)(block.data + self->places[i]), records + i);
    }
    Py_XDECREF(karts);
    for (npy_intp i = 0; !status && self->has_stepped && i < self->players.size; i++) {
        memcpy(records[self->players.data[i]].control, self->present + NUM_CONTROLS * i,
               sizeof records->control);
    }
    for (Py_ssize_t i = 0; !status && i < PyTuple_GET_SIZE(self->reporting); i++) {
        status = copy_report(self, PyTuple_GET_ITEM(self->reporting, i), records);
    }
    return status;
}

static void read_items(const char *items, npy_int32 num_items, Item *to)
{
    const EngineItem *from = (const EngineItem *)items;
    for (npy_int32 i = 0; i < num_items; i++, from++, to++) {
        ITEM_FIELDS(COPY_VECTOR, COPY, SKIP)
    }
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

/* Returns the current snapshot as bytes, read from the engine's block. */
static PyObject *snapshot_from(GameStepper *self, Block block, int is_running)
{
    const npy_int32 num_items = count_at(block, self->items_at);
    if (num_items < 0) return NULL;
    const npy_intp begin = self->items_at + (npy_intp)sizeof num_items;
    if (num_items > (block.size - begin) / (npy_intp)sizeof(EngineItem)) {
        refuse("the engine's block is too short for its items");
        return NULL;
    }
    const size_t karts = (size_t)self->num_kart * sizeof(Kart), items = num_items * sizeof(Item);
    PyObject *data = PyBytes_FromStringAndSize(NULL, (Py_ssize_t)(sizeof(Header) + karts + items));
    if (!data) return NULL;
    Header *header = (Header *)PyBytes_AS_STRING(data);
    Kart *kart = (Kart *)(header + 1);
    if (read_header(self, num_items, is_running, header) < 0 ||
        read_karts(self, block, kart) < 0) {
        Py_CLEAR(data);
    } else {
        read_items(block.data + begin, num_items, (Item *)(kart + self->num_kart));
    }
    return data;
}

/* Makes the engine write its block. Returns the engine's state, a new reference that owns the
   block; NULL with an exception set on failure. */
static PyObject *write_block(const GameStepper *self, Block *block)
{
    PyObject *state = PyObject_CallNoArgs(self->write);
    if (state && !(is_tuple(state) && PyArg_ParseTuple(state, "y#", &block->data, &block->size))) {
        Py_CLEAR(state);
    }
    return state;
}

static PyObject *read_now(GameStepper *self, int is_running)
{
    Block block;
    PyObject *state = write_block(self, &block);
    PyObject *data = state ? snapshot_from(self, block, is_running) : NULL;
    Py_XDECREF(state);
    return data;
}

/* read(): returns the current snapshot of a race that is running as bytes. */
static PyObject *stepper_read(PyObject *self, PyObject *Py_UNUSED(nothing))
{
    return read_now((GameStepper *)self, 1);
}

/* Applies controls, (P, 7) float32, advances the race by a step and returns the next snapshot. */
static PyObject *step_with(GameStepper *self, const char *controls, Py_ssize_t size)
{
    const npy_intp num_players = PyList_GET_SIZE(self->actions);
    const npy_intp expected = num_players * NUM_CONTROLS * (npy_intp)sizeof(float);
    if (size != expected) {
        return PyErr_Format(PyExc_ValueError, "%zd bytes of controls, expected %zd", size, expected);
    }
    if (set_actions(self, controls) < 0) return NULL;
    self->has_stepped = 1;
    PyObject *answer = num_players ? PyObject_CallOneArg(self->step, self->actions)
                                   : PyObject_CallNoArgs(self->step);
    const int is_running = answer ? PyObject_IsTrue(answer) : -1;
    Py_XDECREF(answer);
    PyObject *none = is_running < 0 ? NULL : PyObject_CallNoArgs(self->update);
    if (!none) return NULL;
    Py_DECREF(none);
    return read_now(self, is_running);
}

/* step(controls): applies the controls, a buffer of (P, 7) float32, advances the race by a step and
   returns the next snapshot as bytes. */
static PyObject *stepper_step(PyObject *self, PyObject *controls)
{
    Py_buffer view;
    if (PyObject_GetBuffer(controls, &view, PyBUF_C_CONTIGUOUS) < 0) return NULL;
    PyObject *data = step_with((GameStepper *)self, view.buf, view.len);
    PyBuffer_Release(&view);
    return data;
}

#ifndef _WIN32

#include <errno.h>
#include <sys/socket.h>
#include <sys/uio.h>

/* Header of a message with one frame; see stkzoo.engine.wire. */
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

/* Sends a snapshot; returns -1 with an exception set on failure. */
static int send_snapshot(int fd, PyObject *data)
{
    Head head = {'O', 1, (npy_uint32)PyBytes_GET_SIZE(data)};
    struct iovec parts[2] = {{&head, sizeof head},
                             {PyBytes_AS_STRING(data), (size_t)PyBytes_GET_SIZE(data)}};
    struct msghdr message = {.msg_iov = parts, .msg_iovlen = 2};
    ssize_t sent;
    do sent = sendmsg(fd, &message, MSG_NOSIGNAL);
    while (sent < 0 && errno == EINTR);
    return sent < 0 ? gone(), -1 : 0;
}

/* serve(fd): serves step requests on a packet socket until another request arrives, and returns
   that request. */
static PyObject *stepper_serve(PyObject *self, PyObject *file)
{
    static char room[1 << 18]; /* as in stkzoo.engine.wire; only one thread uses it */
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
        PyObject *data =
            step_with((GameStepper *)self, room + sizeof head, size - (ssize_t)sizeof head);
        const int status = data ? send_snapshot(fd, data) : -1;
        Py_XDECREF(data);
        if (status < 0) return NULL;
    }
}

#define SERVE , {"serve", stepper_serve, METH_O, "Serves step requests on a socket."}
#else
#define SERVE
#endif

/* ---------------------------------------------------------------- the type */

/* GameStepper(functions, world, actions, controls, phases, last_phase, reporting, players):
   functions of the engine's race and world; the world and the list of actions; the names of the
   controls; a dict from the engine's phases to their numbers; the number of all other phases; the
   karts of the game's AI whose controls are reported; and the kart of each action. */
static int stepper_set_up(GameStepper *self, PyObject *args, PyObject *Py_UNUSED(kwargs))
{
    PyObject *functions;
    if (!PyArg_ParseTuple(args, "O!OO!O!O!iO!O&", &PyTuple_Type, &functions, &self->world,
                          &PyList_Type, &self->actions, &PyTuple_Type, &self->controls,
                          &PyDict_Type, &self->phases, &self->last_phase, &PyTuple_Type,
                          &self->reporting, as_indices, &self->players) ||
        !PyArg_ParseTuple(functions, "OOOO", &self->step, &self->report, &self->update,
                          &self->write)) {
        return -1;
    }
    if (PyTuple_GET_SIZE(self->controls) != NUM_CONTROLS) {
        return refuse("the number of controls is wrong");
    }
    if (self->last_phase < 0) return refuse("a phase number must not be negative");
    self->phase = self->last_phase - 1;
    const npy_intp size = PyList_GET_SIZE(self->actions) * NUM_CONTROLS;
    if (!(self->present = room_for(self, size, sizeof *self->present))) return -1;
    for (npy_intp i = 0; i < size; i++) self->present[i] = NAN; /* differs from every control */
    if (!(self->speed = keep(self, PyUnicode_InternFromString("speed"))) ||
        !(self->angular_velocity = keep(self, PyUnicode_InternFromString("angular_velocity")))) {
        return -1;
    }
    Block block;
    PyObject *state = write_block(self, &block);
    int status = state ? find_places(self, block) : -1;
    Py_XDECREF(state);
    if (status) return -1;
    if (self->players.size != PyList_GET_SIZE(self->actions) ||
        !are_below(self->players, self->num_kart)) {
        return refuse("each action needs a kart");
    }
    return 0;
}

KERNEL_TYPE(GameStepper, stepper, "Advances a race of the engine and reads its state.",
            {"step", stepper_step, METH_O, "Advances the race by a step; returns the snapshot."},
            {"read", stepper_read, METH_NOARGS, "Returns the current snapshot."} SERVE)
