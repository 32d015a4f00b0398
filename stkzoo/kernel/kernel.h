/* Declarations that the parts of the kernel share.

   This is the code that runs: tests/kernel compares it with NumPy implementations in tests/oracle.
   The stub _kernel.pyi has the signatures. */

#ifndef STKZOO_KERNEL_H
#define STKZOO_KERNEL_H

#include "arguments.h"

/* ---------------------------------------------------------------- snapshots */

/* HEADER_DTYPE, KART_DTYPE and ITEM_DTYPE of stkzoo.engine.snapshot, which compares the sizes when
   it is imported. */
typedef struct {
    float time, aux_ticks;
    npy_int32 phase, num_kart, num_items, running;
} Header;

typedef struct {
    float location[3], rotation[4], front[3], velocity[3], velocity_lc[3];
    float angular_velocity[3], size[3];
    float speed, max_steer_angle, wheel_base, energy, skeed_factor, shield_time;
    float attachment_time_left, distance_down_track, overall_distance, finish_time, lap_time;
    npy_int32 node, position, finished_laps, powerup_type, powerup_num, attachment_type;
    npy_int32 has_finished_race, race_result, jumping, is_on_road;
    float control[7];
} Kart;

typedef struct {
    float location[3], size;
    npy_int32 type, id;
} Item;

enum { NUM_CONTROLS = sizeof(((Kart *)0)->control) / sizeof(float) };

/* Pointers to the parts of a snapshot's bytes. */
typedef struct {
    const Header *header;
    const Kart *karts;
    const Item *items;
} Snapshot;

int as_snapshot(PyObject *object, void *snapshot); /* converts the bytes of a Snapshot */

/* ---------------------------------------------------------------- types */

/* The first members of every object. `kept` is a list of all Python objects that the other members
   point to, including the constructor's arguments. */
#define OBJECT_HEAD PyObject_HEAD PyObject *kept;

/* Moves a new reference to the list `kept` and returns it as a borrowed reference. Returns NULL
   with an exception set on failure, or if `made` is NULL. */
PyObject *keep(void *self, PyObject *made);

/* Returns zeroed memory that is freed with the object; NULL with an exception set if there is not
   enough memory. */
void *room_for(void *self, npy_intp count, size_t size);

/* The graph of a stkzoo.engine.track.TrackMap, and the segments ahead of each segment in order. */
typedef struct {
    OBJECT_HEAD
    Floats nodes, widths, distances; /* (N, 2, 3), (N, 1), (N, 2) */
    Indices begins, successors;      /* segment n: successors[begins[n]:begins[n + 1]] */
    npy_intp num_nodes;
    double length;
    npy_int32 **orders; /* (N,) for each segment; NULL until first used */
} TrackGraph;

/* Returns the segments ahead of a segment, (N,), in order of driving distance and beginning with
   itself. Returns NULL with an exception set if there is no such segment or not enough memory. */
const npy_int32 *nodes_ahead(TrackGraph *track, npy_intp node);

/* Creates an object that holds references to its constructor's arguments; returns NULL with an
   exception set on failure. */
PyObject *new_object(PyTypeObject *type, PyObject *args, PyObject *kwargs);
void free_object(PyObject *self);

/* Defines a type of this module with its methods. PREFIX_set_up reads the constructor's arguments;
   it returns -1 with an exception set if they are invalid. */
#define KERNEL_TYPE(TYPE, PREFIX, DOC, ...)                                                       \
    static PyObject *PREFIX##_new(PyTypeObject *type, PyObject *args, PyObject *kwargs)           \
    {                                                                                             \
        PyObject *self = new_object(type, args, kwargs);                                          \
        if (self && PREFIX##_set_up((TYPE *)self, args, kwargs) < 0) Py_CLEAR(self);              \
        return self;                                                                              \
    }                                                                                             \
    static PyMethodDef PREFIX##_methods[] = {__VA_ARGS__, {NULL, NULL, 0, NULL}};                 \
    PyTypeObject TYPE##Type = {                                                                   \
        PyVarObject_HEAD_INIT(NULL, 0).tp_name = "stkzoo.kernel._kernel." #TYPE,                  \
        .tp_basicsize = sizeof(TYPE), .tp_flags = Py_TPFLAGS_DEFAULT, .tp_doc = DOC,              \
        .tp_new = PREFIX##_new, .tp_dealloc = free_object, .tp_methods = PREFIX##_methods,        \
    };

PyObject *join_rows(PyObject *module, PyObject *rows);
PyObject *look_around(PyObject *module, PyObject *args);
PyObject *new_batch(PyObject *module, PyObject *args);
PyObject *observe_racing(PyObject *module, PyObject *args);
PyObject *observe_standing(PyObject *module, PyObject *args);
PyObject *action_mask(PyObject *module, PyObject *args);
PyObject *split_batch(PyObject *module, PyObject *args);
PyObject *to_polar(PyObject *module, PyObject *points);
PyObject *trace_roads(PyObject *module, PyObject *args);
PyObject *write_racing_view(PyObject *module, PyObject *args);

extern PyTypeObject CarControllerType, EventCounterType, GameStepperType, TrackGraphType, KartObserverType, ActionReaderType, StepScorerType;

#endif
