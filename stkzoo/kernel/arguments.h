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

/* C-contiguous, aligned NumPy arrays: their data and number of elements. */
typedef struct { float *data; npy_intp size; } Floats;
typedef struct { double *data; npy_intp size; } Doubles;
typedef struct { npy_intp *data; npy_intp size; } Indices;
typedef struct { npy_int64 *data; npy_intp size; } Wholes;
typedef struct { npy_int8 *data; npy_intp size; } Bytes;
typedef struct { npy_bool *data; npy_intp size; } Flags;

/* Converters for "O&" of PyArg_ParseTuple. as_written_* require a writeable array. */
int as_floats(PyObject *object, void *floats);
int as_written_floats(PyObject *object, void *floats);
int as_doubles(PyObject *object, void *doubles);
int as_written_doubles(PyObject *object, void *doubles);
int as_indices(PyObject *object, void *indices);
int as_written_indices(PyObject *object, void *indices);
int as_wholes(PyObject *object, void *wholes);
int as_written_wholes(PyObject *object, void *wholes);
int as_bytes(PyObject *object, void *bytes);
int as_written_bytes(PyObject *object, void *bytes);
int as_flags(PyObject *object, void *flags);
int as_written_flags(PyObject *object, void *flags);

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
