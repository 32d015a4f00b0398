/* What the parts of the kernel share. Every type has a twin in numpy in stkzoo.kernel.reference,
   with which the tests compare it and which runs where the kernel is not compiled. */

#ifndef STKZOO_KERNEL_H
#define STKZOO_KERNEL_H

#define PY_SSIZE_T_CLEAN
#include <Python.h>

#define NPY_NO_DEPRECATED_API NPY_2_0_API_VERSION
#define PY_ARRAY_UNIQUE_SYMBOL stkzoo_kernel_numpy
#ifndef STKZOO_KERNEL_MODULE
#define NO_IMPORT_ARRAY
#endif
#include <numpy/arrayobject.h>

/* stkzoo.engine.snapshot.HEADER_DTYPE, KART_DTYPE and ITEM_DTYPE, field by field; that module
   compares them. */
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

/* The parts of Snapshot.data. */
typedef struct {
    const Header *header;
    const Kart *karts;
    const Item *items;
} Moment;

/* Takes the bytes of a Snapshot apart; -1 with an exception set if they are none. */
int read_moment(PyObject *data, Moment *moment);

/* stkzoo.engine.track.TrackMap, and the order of what lies ahead of each of its segments. */
typedef struct {
    PyObject_HEAD
    PyObject *arrays; /* keeps them alive */
    const float *nodes, *widths, *distances; /* (N, 2, 3), (N, 1), (N, 2) */
    const npy_intp *begins, *successors;     /* those of n: successors[begins[n]:begins[n + 1]] */
    npy_intp num_nodes;
    double length;
    npy_int32 **orders; /* (N,) each; NULL until asked for */
} TrackGraph;

/* The segments ahead of one, by distance; NULL with an exception set if there is none such. */
const npy_int32 *nodes_ahead(TrackGraph *track, npy_intp node);

/* The data of a C-contiguous array of one of numpy's own types, and how many numbers it has;
   NULL with an exception set if it is none. */
void *numbers_of(PyObject *object, const char *name, int type, npy_intp *count);

/* A row of a table of methods: one that takes its arguments as an array. */
#define FAST_METHOD(NAME, FUNCTION, DOC)                                                         \
    {NAME, (PyCFunction)(void (*)(void))FUNCTION, METH_FASTCALL, DOC}

/* A type of this module, from PREFIX_new, PREFIX_dealloc and PREFIX_methods. */
#define KERNEL_TYPE(TYPE, PREFIX, DOC)                                                            \
    PyTypeObject TYPE##Type = {                                                                   \
        PyVarObject_HEAD_INIT(NULL, 0).tp_name = "stkzoo.kernel._kernel." #TYPE,                  \
        .tp_basicsize = sizeof(TYPE), .tp_flags = Py_TPFLAGS_DEFAULT, .tp_doc = DOC,              \
        .tp_new = PREFIX##_new, .tp_dealloc = PREFIX##_dealloc, .tp_methods = PREFIX##_methods,   \
    };

PyObject *join_rows(PyObject *module, PyObject *const *args, Py_ssize_t nargs);
PyObject *weigh_plans(PyObject *module, PyObject *const *args, Py_ssize_t nargs);

extern PyTypeObject CarControllerType, GameStepperType, TrackGraphType, KartObserverType, RacingObserverType, ActionReaderType, StepScorerType;

#endif
