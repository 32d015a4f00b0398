/* Rewards by term and infos; the formulas are those of stkzoo.mdp.rewards. */

#include "kernel.h"

#include <math.h>

enum { PROGRESS, RANK, TIME, FINISH, COURSE, PLACEMENT, NUM_TERMS };

static double driven(const Kart *kart)
{
    return kart->overall_distance > 0 ? kart->overall_distance : 0;
}

static double term(int code, const Kart *before, const Kart *after, double num_karts,
                   double race_length)
{
    const double finishes = after->has_finished_race > before->has_finished_race;
    const double now = driven(after), then = driven(before);
    switch (code) {
    case PROGRESS: return (now - then) / 10.0;
    case RANK: return (1.0 - after->position / num_karts) * (3.0 + 7.0 * finishes);
    case TIME: return -0.1;
    case FINISH: return finishes ? 10.0 : 0.0;
    case COURSE: {
        const double end = after->has_finished_race > 0 ? race_length : fmin(now, race_length);
        return (end - fmin(then, race_length)) / race_length;
    }
    default:
        return finishes * (num_karts - after->position) / (num_karts > 1 ? num_karts - 1 : 1);
    }
}

/* score(before, after, race_length, terms, weights, columns, rows, karts, last): the terms of a
   step into last[rows[i], columns[t]], for kart karts[i]. */
PyObject *score(PyObject *Py_UNUSED(module), PyObject *const *args, Py_ssize_t nargs)
{
    npy_intp num_karts, num_after, num_terms, num_weights, num_columns, num_rows, count, size;
    if (nargs != 9) return PyErr_Format(PyExc_TypeError, "score() takes 9 arguments, not %zd", nargs);
    const Kart *before = array_of(args[0], "before", sizeof(Kart), &num_karts);
    if (!before) return NULL;
    const Kart *after = array_of(args[1], "after", sizeof(Kart), &num_after);
    if (!after) return NULL;
    const double race_length = PyFloat_AsDouble(args[2]);
    if (PyErr_Occurred()) return NULL;
    const npy_intp *terms = numbers_of(args[3], "terms", NPY_INTP, &num_terms);
    if (!terms) return NULL;
    const double *weights = numbers_of(args[4], "weights", NPY_FLOAT64, &num_weights);
    if (!weights) return NULL;
    const npy_intp *columns = numbers_of(args[5], "columns", NPY_INTP, &num_columns);
    if (!columns) return NULL;
    const npy_intp *rows = numbers_of(args[6], "rows", NPY_INTP, &num_rows);
    if (!rows) return NULL;
    const npy_intp *karts = numbers_of(args[7], "karts", NPY_INTP, &count);
    if (!karts) return NULL;
    double *last = numbers_of(args[8], "last", NPY_FLOAT64, &size);
    if (!last) return NULL;
    const npy_intp width = PyArray_DIM((PyArrayObject *)args[8], 1);
    if (num_after != num_karts || num_rows != count || num_weights != num_terms ||
        num_columns != num_terms) {
        return PyErr_Format(PyExc_ValueError, "the arrays do not fit together");
    }
    for (npy_intp i = 0; i < count; i++) {
        const npy_intp kart = karts[i];
        if (kart < 0 || kart >= num_karts || rows[i] < 0 || (rows[i] + 1) * width > size) {
            return PyErr_Format(PyExc_IndexError, "there is no kart %zd or row %zd", kart, rows[i]);
        }
        for (npy_intp t = 0; t < num_terms; t++) {
            if (columns[t] < 0 || columns[t] >= width) {
                return PyErr_Format(PyExc_IndexError, "there is no column %zd", columns[t]);
            }
            last[rows[i] * width + columns[t]] =
                term((int)terms[t], before + kart, after + kart, (double)num_karts, race_length) *
                weights[t];
        }
    }
    Py_RETURN_NONE;
}

/* add_up(last, sums, rows): adds a step's terms to the sums; the totals of some rows. */
PyObject *add_up(PyObject *Py_UNUSED(module), PyObject *const *args, Py_ssize_t nargs)
{
    npy_intp size, num_sums, count;
    if (nargs != 3) return PyErr_Format(PyExc_TypeError, "add_up() takes 3 arguments");
    const double *last = numbers_of(args[0], "last", NPY_FLOAT64, &size);
    if (!last) return NULL;
    double *sums = numbers_of(args[1], "sums", NPY_FLOAT64, &num_sums);
    if (!sums) return NULL;
    const npy_intp *rows = numbers_of(args[2], "rows", NPY_INTP, &count);
    if (!rows) return NULL;
    if (num_sums != size) return PyErr_Format(PyExc_ValueError, "sums of other terms");
    const npy_intp width = PyArray_DIM((PyArrayObject *)args[0], 1);
    for (npy_intp i = 0; i < size; i++) sums[i] += last[i];
    PyObject *list = PyList_New(count);
    for (npy_intp i = 0; list && i < count; i++) {
        double total = 0;
        if (rows[i] < 0 || (rows[i] + 1) * width > size) {
            Py_DECREF(list);
            return PyErr_Format(PyExc_IndexError, "there is no row %zd", rows[i]);
        }
        for (npy_intp c = 0; c < width; c++) total += last[rows[i] * width + c];
        PyList_SET_ITEM(list, i, PyFloat_FromDouble(total));
    }
    return list;
}

/* finished(karts, who): whether each kart has finished the race. */
PyObject *finished(PyObject *Py_UNUSED(module), PyObject *const *args, Py_ssize_t nargs)
{
    npy_intp num_karts, count;
    if (nargs != 2) return PyErr_Format(PyExc_TypeError, "finished() takes 2 arguments");
    const Kart *karts = array_of(args[0], "karts", sizeof(Kart), &num_karts);
    if (!karts) return NULL;
    const npy_intp *who = numbers_of(args[1], "who", NPY_INTP, &count);
    if (!who) return NULL;
    PyObject *list = PyList_New(count);
    for (npy_intp i = 0; list && i < count; i++) {
        if (who[i] < 0 || who[i] >= num_karts) {
            Py_DECREF(list);
            return PyErr_Format(PyExc_IndexError, "there is no kart %zd", who[i]);
        }
        PyList_SET_ITEM(list, i, PyBool_FromLong(karts[who[i]].has_finished_race > 0));
    }
    return list;
}

static int put(PyObject *dict, PyObject *keys, Py_ssize_t *i, PyObject *value)
{
    const int failed = !value || *i >= PyTuple_GET_SIZE(keys) ||
                       PyDict_SetItem(dict, PyTuple_GET_ITEM(keys, *i), value) < 0;
    Py_XDECREF(value);
    (*i)++;
    return failed ? -1 : 0;
}

static PyObject *info_of(PyObject *keys, const Kart *kart, const double *last, const double *sums,
                         npy_intp width, PyObject *length)
{
    Py_ssize_t at = 0;
    double total = 0;
    PyObject *dict = PyDict_New();
    if (!dict) return NULL;
    int failed = put(dict, keys, &at, PyLong_FromLong(kart->position)) < 0;
    failed = failed || put(dict, keys, &at, PyFloat_FromDouble(driven(kart))) < 0;
    const long laps = kart->finished_laps > 0 ? kart->finished_laps : 0;
    failed = failed || put(dict, keys, &at, PyLong_FromLong(laps)) < 0;
    failed = failed || put(dict, keys, &at, PyFloat_FromDouble(kart->finish_time)) < 0;
    for (npy_intp c = 0; !failed && c < width; c++) {
        failed = put(dict, keys, &at, PyFloat_FromDouble(last[c])) < 0;
    }
    for (npy_intp c = 0; !failed && c < width; c++) {
        total += sums[c];
        failed = put(dict, keys, &at, PyFloat_FromDouble(sums[c])) < 0;
    }
    failed = failed || put(dict, keys, &at, PyFloat_FromDouble(total)) < 0;
    Py_INCREF(length);
    failed = failed || put(dict, keys, &at, length) < 0;
    if (failed) {
        if (!PyErr_Occurred()) PyErr_SetString(PyExc_ValueError, "there are too few keys");
        Py_CLEAR(dict);
    }
    return dict;
}

/* make_infos(keys, karts, last, sums, length, rows, kart_of_row): one info for each of some rows. */
PyObject *make_infos(PyObject *Py_UNUSED(module), PyObject *const *args, Py_ssize_t nargs)
{
    npy_intp num_karts, size, num_sums, num_all, count;
    if (nargs != 7 || !PyTuple_Check(args[0])) {
        return PyErr_Format(PyExc_TypeError, "make_infos() takes a tuple and 6 more arguments");
    }
    const Kart *karts = array_of(args[1], "karts", sizeof(Kart), &num_karts);
    if (!karts) return NULL;
    const double *last = numbers_of(args[2], "last", NPY_FLOAT64, &size);
    if (!last) return NULL;
    const double *sums = numbers_of(args[3], "sums", NPY_FLOAT64, &num_sums);
    if (!sums) return NULL;
    const npy_intp *rows = numbers_of(args[5], "rows", NPY_INTP, &count);
    if (!rows) return NULL;
    const npy_intp *kart_of = numbers_of(args[6], "kart_of_row", NPY_INTP, &num_all);
    if (!kart_of) return NULL;
    const npy_intp width = PyArray_DIM((PyArrayObject *)args[2], 1);
    if (num_sums != size || num_all * width != size) {
        return PyErr_Format(PyExc_ValueError, "the arrays do not fit together");
    }
    PyObject *list = PyList_New(count);
    for (npy_intp i = 0; list && i < count; i++) {
        PyObject *info = NULL;
        const npy_intp row = rows[i];
        if (row < 0 || row >= num_all || kart_of[row] < 0 || kart_of[row] >= num_karts) {
            PyErr_Format(PyExc_IndexError, "there is no row %zd or no kart for it", row);
        } else {
            const npy_intp at = row * width;
            info = info_of(args[0], karts + kart_of[row], last + at, sums + at, width, args[4]);
        }
        if (!info) Py_CLEAR(list);
        else PyList_SET_ITEM(list, i, info);
    }
    return list;
}
