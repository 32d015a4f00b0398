/* Arguments of functions of the extensions: NumPy arrays with their sizes. The file of an extension
   that calls import_array defines STKZOO_EXTENSION before it includes this header. */

#ifndef STKZOO_ARGUMENTS_H
#define STKZOO_ARGUMENTS_H

#define PY_SSIZE_T_CLEAN
#include <Python.h>

#define NPY_NO_DEPRECATED_API NPY_2_0_API_VERSION
#define PY_ARRAY_UNIQUE_SYMBOL stkzoo_numpy
#ifndef STKZOO_EXTENSION
#define NO_IMPORT_ARRAY
#endif
#include <numpy/arrayobject.h>

/* A C-contiguous, aligned NumPy array: its data and number of elements. as_NAME and as_written_NAME
   are converters for "O&" of PyArg_ParseTuple; as_written_NAME requires a writeable array. */
#define ARRAY_TYPE(TYPE, NAME, ELEMENT)                                                           \
    typedef struct { ELEMENT *data; npy_intp size; } TYPE;                                        \
    int as_##NAME(PyObject *object, void *array);                                                 \
    int as_written_##NAME(PyObject *object, void *array);

/* Converts an array of a NumPy type with some NPY_ARRAY flags to any of the types below. */
int as_array(PyObject *object, int type, int flags, void *array);

ARRAY_TYPE(Floats, floats, float)
ARRAY_TYPE(Doubles, doubles, double)
ARRAY_TYPE(Indices, indices, npy_intp)
ARRAY_TYPE(Wholes, wholes, npy_int64)
ARRAY_TYPE(Bytes, bytes, npy_int8)
ARRAY_TYPE(Flags, flags, npy_bool)

/* Returns whether an object is a tuple; sets a TypeError if not. PyArg_ParseTuple needs one. */
int is_tuple(PyObject *object);

/* Returns whether all indices are at least 0 and below a limit. */
int are_below(Indices indices, npy_intp limit);

/* Own state of a kart: stkzoo.wrappers.racing.features.OWN. */
typedef struct {
    float velocity[3], max_steer_angle, skeed_factor, energy, attachment_time_left, shield_time;
    float jumping, powerup_type, powerup_count, attachment;
} OwnState;

enum { OWN_SIZE = sizeof(OwnState) / sizeof(float), LINE_SIZE = 4 };

/* The first arrays of stkzoo.wrappers.racing.Surroundings, which have a row for each kart. */
typedef struct {
    Floats own, road, karts, items; /* (A, OWN_SIZE), (A, L, LINE_SIZE), (A, K, 3), (A, N, 3) */
    Wholes types;                   /* (A, N) */
    npy_intp count, num_looks, num_karts, num_items;
} Around;

/* Reads the arrays from a tuple; returns -1 with an exception set on failure. */
int read_around(PyObject *tuple, int is_written, Around *around);

/* Returns 0 if the numbers of each pair are equal, otherwise -1 with a ValueError set. */
#define ARE_SIZES(PAIRS) are_sizes(PAIRS, sizeof PAIRS / sizeof *PAIRS)
int are_sizes(const npy_intp (*pairs)[2], size_t count);

/* Returns 0 if there is a row below `num_rows` for each of some indices below `limit`, otherwise -1
   with an exception set. `name` is what the indices are. */
int check_rows(const char *name, Indices indices, npy_intp limit, Indices rows, npy_intp num_rows);

/* Sets a ValueError, unless an exception is set already; always returns -1. */
int refuse(const char *message);

#endif
