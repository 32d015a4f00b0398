/* What the parts of the kernel share. Everything here has a numpy counterpart in the package,
   which the tests compare with it and which runs where no compiler was at hand. */

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

/* stkzoo.engine.snapshot.KART_DTYPE, field by field; that module compares the two. */
typedef struct {
    float location[3], rotation[4], front[3], velocity[3], velocity_lc[3];
    float angular_velocity[3], size[3];
    float speed, max_steer_angle, wheel_base, energy, skeed_factor, shield_time;
    float attachment_time_left, distance_down_track, overall_distance, finish_time, lap_time;
    npy_int32 node, position, finished_laps, powerup_type, powerup_num, attachment_type;
    npy_int32 has_finished_race, race_result, jumping, is_on_road;
    float control[7];
} Kart;

/* stkzoo.engine.snapshot.ITEM_DTYPE. */
typedef struct {
    float location[3], size;
    npy_int32 type, id;
} Item;

/* The data of a C-contiguous array whose items have the given size, and their number;
   NULL with an exception set if it is none. */
void *array_of(PyObject *object, const char *name, size_t item_size, npy_intp *count);

/* The data of a C-contiguous array of one of numpy's own types; as array_of. */
void *numbers_of(PyObject *object, const char *name, int type, npy_intp *count);

PyObject *copy_fields(PyObject *module, PyObject *const *args, Py_ssize_t nargs);
PyObject *copy_attributes(PyObject *module, PyObject *const *args, Py_ssize_t nargs);
PyObject *set_actions(PyObject *module, PyObject *const *args, Py_ssize_t nargs);
PyObject *score(PyObject *module, PyObject *const *args, Py_ssize_t nargs);
PyObject *add_up(PyObject *module, PyObject *const *args, Py_ssize_t nargs);
PyObject *finished(PyObject *module, PyObject *const *args, Py_ssize_t nargs);
PyObject *make_infos(PyObject *module, PyObject *const *args, Py_ssize_t nargs);
PyObject *join_rows(PyObject *module, PyObject *const *args, Py_ssize_t nargs);

extern PyTypeObject ViewType;
extern PyTypeObject ControlsType;

#endif
