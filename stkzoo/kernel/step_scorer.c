/* Rewards, ends and infos of a race's agents.

   Its numpy twin is stkzoo.kernel.reference.step_scorer; the formulas are those of
   stkzoo.mdp.rewards. */

#include "kernel.h"

#include <math.h>
#include <string.h>

enum { PROGRESS, RANK, TIME, FINISH, COURSE, PLACEMENT, NUM_TERMS };

/* Agents that share a reward. */
typedef struct {
    const npy_intp *terms, *columns, *who; /* who: numbers of agents */
    const double *weights;
    npy_intp num_terms, num_agents;
} Reward;

typedef struct {
    PyObject_HEAD
    PyObject *arguments;      /* keeps alive what follows */
    PyObject *agents, *keys;  /* tuples */
    PyObject *blank_info;     /* with all keys */
    const npy_intp *karts, *rows; /* each agent's kart, and its row of the arrays below */
    double *last, *sums;      /* (R, C): a step's terms and the episode's, of all agents */
    npy_intp num_agents, num_rows, num_columns;
    double race_length;
    Reward *rewards;
    Py_ssize_t num_rewards;
    npy_intp last_kart; /* the highest number of a kart */
    char *is_racing; /* (R,) whether a row is one of the agents' */
} StepScorer;

/* ---------------------------------------------------------------- rewards */

static double driven(const Kart *kart)
{
    return kart->overall_distance > 0 ? kart->overall_distance : 0;
}

static double term(npy_intp code, const Kart *before, const Kart *after, double num_karts,
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

static void score(StepScorer *self, const Reward *reward, const Moment *before, const Moment *after)
{
    for (npy_intp i = 0; i < reward->num_agents; i++) {
        const npy_intp agent = reward->who[i], kart = self->karts[agent];
        double *row = self->last + self->rows[agent] * self->num_columns;
        for (npy_intp t = 0; t < reward->num_terms; t++) {
            row[reward->columns[t]] =
                reward->weights[t] * term(reward->terms[t], before->karts + kart,
                                          after->karts + kart, after->header->num_kart,
                                          self->race_length);
        }
    }
}

/* Adds the step's terms to the sums; those who have left get nothing. */
static void add_up(StepScorer *self)
{
    const npy_intp width = self->num_columns;
    for (npy_intp row = 0; row < self->num_rows; row++) {
        double *last = self->last + row * width, *sums = self->sums + row * width;
        if (!self->is_racing[row]) memset(last, 0, (size_t)width * sizeof *last);
        for (npy_intp c = 0; c < width; c++) sums[c] += last[c];
    }
}

/* ---------------------------------------------------------------- what is handed out */

static int put(PyObject *dict, PyObject *key, PyObject *value)
{
    const int status = value ? PyDict_SetItem(dict, key, value) : -1;
    Py_XDECREF(value);
    return status;
}

static PyObject *info_of(const StepScorer *self, npy_intp agent, const Kart *kart, PyObject *length)
{
    const npy_intp width = self->num_columns;
    const double *last = self->last + self->rows[agent] * width;
    const double *sums = self->sums + self->rows[agent] * width;
    PyObject *const *key = &PyTuple_GET_ITEM(self->keys, 0);
    PyObject *dict = PyDict_Copy(self->blank_info); /* quicker than a new one that grows */
    if (!dict) return NULL;
    const long laps = kart->finished_laps > 0 ? kart->finished_laps : 0;
    int status = put(dict, *key++, PyLong_FromLong(kart->position));
    status = status ? status : put(dict, *key++, PyFloat_FromDouble(driven(kart)));
    status = status ? status : put(dict, *key++, PyLong_FromLong(laps));
    status = status ? status : put(dict, *key++, PyFloat_FromDouble(kart->finish_time));
    double total = 0;
    for (npy_intp c = 0; !status && c < width; c++) {
        status = put(dict, *key++, PyFloat_FromDouble(last[c]));
    }
    for (npy_intp c = 0; !status && c < width; c++) {
        total += sums[c];
        status = put(dict, *key++, PyFloat_FromDouble(sums[c]));
    }
    status = status ? status : put(dict, *key++, PyFloat_FromDouble(total));
    Py_INCREF(length);
    status = status ? status : put(dict, *key++, length);
    if (status) Py_CLEAR(dict);
    return dict;
}

static double total_of(const StepScorer *self, npy_intp agent)
{
    double total = 0;
    const double *last = self->last + self->rows[agent] * self->num_columns;
    for (npy_intp c = 0; c < self->num_columns; c++) total += last[c];
    return total;
}

static int is_of_this_race(const StepScorer *self, const Moment *moment)
{
    if (self->last_kart < moment->header->num_kart) return 1;
    PyErr_Format(PyExc_ValueError, "a snapshot of another race, of %d karts",
                 moment->header->num_kart);
    return 0;
}

enum { REWARDS, TERMINATIONS, TRUNCATIONS, NUM_PARTS };

static PyObject *ends_and_rewards(const StepScorer *self, const Moment *after, int is_over)
{
    PyObject *parts = PyTuple_New(NUM_PARTS);
    for (int part = 0; parts && part < NUM_PARTS; part++) {
        PyObject *dict = PyDict_New();
        if (!dict) Py_CLEAR(parts);
        else PyTuple_SET_ITEM(parts, part, dict);
    }
    for (npy_intp agent = 0; parts && agent < self->num_agents; agent++) {
        PyObject *name = PyTuple_GET_ITEM(self->agents, agent);
        const int has_ended = after->karts[self->karts[agent]].has_finished_race > 0;
        if (put(PyTuple_GET_ITEM(parts, REWARDS), name,
                PyFloat_FromDouble(total_of(self, agent))) < 0 ||
            put(PyTuple_GET_ITEM(parts, TERMINATIONS), name, PyBool_FromLong(has_ended)) < 0 ||
            put(PyTuple_GET_ITEM(parts, TRUNCATIONS), name,
                PyBool_FromLong(is_over && !has_ended)) < 0) {
            Py_CLEAR(parts);
        }
    }
    return parts;
}

/* score(before, after, is_over): rewards, terminations and truncations of the step between the
   bytes of two snapshots, each a dict by agent; whether time is up. */
static PyObject *scorer_score(PyObject *object, PyObject *const *args, Py_ssize_t nargs)
{
    StepScorer *self = (StepScorer *)object;
    Moment before, after;
    if (nargs != 3) return PyErr_Format(PyExc_TypeError, "score() takes 3 arguments");
    if (read_moment(args[0], &before) < 0 || read_moment(args[1], &after) < 0) return NULL;
    const int is_over = PyObject_IsTrue(args[2]);
    if (is_over < 0 || !is_of_this_race(self, &before) || !is_of_this_race(self, &after)) {
        return NULL;
    }
    for (Py_ssize_t i = 0; i < self->num_rewards; i++) {
        score(self, self->rewards + i, &before, &after);
    }
    add_up(self);
    return ends_and_rewards(self, &after, is_over);
}

/* infos(data, length): the infos at a snapshot, a dict by agent; how many steps the episode has. */
static PyObject *scorer_infos(PyObject *object, PyObject *const *args, Py_ssize_t nargs)
{
    const StepScorer *self = (StepScorer *)object;
    Moment now;
    if (nargs != 2) return PyErr_Format(PyExc_TypeError, "infos() takes 2 arguments");
    if (read_moment(args[0], &now) < 0 || !is_of_this_race(self, &now)) return NULL;
    PyObject *infos = PyDict_New();
    for (npy_intp agent = 0; infos && agent < self->num_agents; agent++) {
        const Kart *kart = now.karts + self->karts[agent];
        PyObject *name = PyTuple_GET_ITEM(self->agents, agent);
        if (put(infos, name, info_of(self, agent, kart, args[1])) < 0) Py_CLEAR(infos);
    }
    return infos;
}

/* ---------------------------------------------------------------- the type */

static int are_below(const npy_intp *numbers, npy_intp count, npy_intp limit)
{
    for (npy_intp i = 0; i < count; i++) {
        if (numbers[i] < 0 || numbers[i] >= limit) return 0;
    }
    return 1;
}

static int unfit(const char *what)
{
    if (!PyErr_Occurred()) PyErr_Format(PyExc_ValueError, "the %s do not fit together", what);
    return -1;
}

/* A reward from (terms, weights, columns, who). */
static int set_reward(const StepScorer *self, Reward *reward, PyObject *spec)
{
    PyObject *arrays[4];
    npy_intp num_weights, num_columns;
    if (!PyArg_ParseTuple(spec, "OOOO", arrays, arrays + 1, arrays + 2, arrays + 3) ||
        !(reward->terms = numbers_of(arrays[0], "terms", NPY_INTP, &reward->num_terms)) ||
        !(reward->weights = numbers_of(arrays[1], "weights", NPY_FLOAT64, &num_weights)) ||
        !(reward->columns = numbers_of(arrays[2], "columns", NPY_INTP, &num_columns)) ||
        !(reward->who = numbers_of(arrays[3], "who", NPY_INTP, &reward->num_agents)) ||
        num_weights != reward->num_terms || num_columns != reward->num_terms ||
        !are_below(reward->terms, reward->num_terms, NUM_TERMS) ||
        !are_below(reward->columns, num_columns, self->num_columns) ||
        !are_below(reward->who, reward->num_agents, self->num_agents)) {
        return unfit("parts of a reward");
    }
    return 0;
}

static int set_rows(StepScorer *self, PyObject *const *arrays)
{
    npy_intp num_karts, num_rows, sizes[2];
    if (!(self->karts = numbers_of(arrays[0], "karts", NPY_INTP, &num_karts)) ||
        !(self->rows = numbers_of(arrays[1], "rows", NPY_INTP, &num_rows)) ||
        !(self->last = numbers_of(arrays[2], "last", NPY_FLOAT64, sizes)) ||
        !(self->sums = numbers_of(arrays[3], "sums", NPY_FLOAT64, sizes + 1)) ||
        PyArray_NDIM((PyArrayObject *)arrays[2]) != 2) {
        return unfit("arrays");
    }
    self->num_agents = PyTuple_GET_SIZE(self->agents);
    self->num_rows = PyArray_DIM((PyArrayObject *)arrays[2], 0);
    self->num_columns = PyArray_DIM((PyArrayObject *)arrays[2], 1);
    if (num_karts != self->num_agents || num_rows != self->num_agents || sizes[0] != sizes[1] ||
        !are_below(self->karts, num_karts, NPY_MAX_INT32) ||
        !are_below(self->rows, num_rows, self->num_rows) ||
        PyTuple_GET_SIZE(self->keys) != 6 + 2 * self->num_columns) {
        return unfit("arrays");
    }
    if (!(self->is_racing = PyMem_Calloc((size_t)self->num_rows + 1, 1))) {
        PyErr_NoMemory();
        return -1;
    }
    self->last_kart = -1;
    for (npy_intp i = 0; i < num_rows; i++) {
        self->is_racing[self->rows[i]] = 1;
        if (self->karts[i] > self->last_kart) self->last_kart = self->karts[i];
    }
    return 0;
}

static int set_blank_info(StepScorer *self)
{
    self->blank_info = PyDict_New();
    for (Py_ssize_t i = 0; self->blank_info && i < PyTuple_GET_SIZE(self->keys); i++) {
        if (PyDict_SetItem(self->blank_info, PyTuple_GET_ITEM(self->keys, i), Py_None) < 0) {
            Py_CLEAR(self->blank_info);
        }
    }
    return self->blank_info ? 0 : -1;
}

static int set_rewards(StepScorer *self, PyObject *rewards)
{
    const Py_ssize_t count = PyTuple_GET_SIZE(rewards);
    if (!(self->rewards = PyMem_Calloc((size_t)count + 1, sizeof *self->rewards))) {
        PyErr_NoMemory();
        return -1;
    }
    while (self->num_rewards < count) {
        const Py_ssize_t i = self->num_rewards++;
        if (set_reward(self, self->rewards + i, PyTuple_GET_ITEM(rewards, i)) < 0) return -1;
    }
    return 0;
}

/* StepScorer(agents, karts, rows, last, sums, keys, race_length, rewards): rewards is a tuple of
   what set_reward takes. */
static PyObject *scorer_new(PyTypeObject *type, PyObject *args, PyObject *Py_UNUSED(kwargs))
{
    PyObject *arrays[4], *rewards;
    StepScorer *self = (StepScorer *)type->tp_alloc(type, 0);
    if (!self) return NULL;
    if (!PyArg_ParseTuple(args, "O!OOOOO!dO!", &PyTuple_Type, &self->agents, arrays, arrays + 1,
                          arrays + 2, arrays + 3, &PyTuple_Type, &self->keys, &self->race_length,
                          &PyTuple_Type, &rewards) ||
        set_rows(self, arrays) < 0 || set_blank_info(self) < 0 || set_rewards(self, rewards) < 0) {
        Py_DECREF(self);
        return NULL;
    }
    Py_INCREF(args);
    self->arguments = args;
    return (PyObject *)self;
}

static void scorer_dealloc(PyObject *object)
{
    StepScorer *self = (StepScorer *)object;
    PyMem_Free(self->rewards);
    PyMem_Free(self->is_racing);
    Py_XDECREF(self->blank_info);
    Py_XDECREF(self->arguments);
    Py_TYPE(object)->tp_free(object);
}

static PyMethodDef scorer_methods[] = {
    FAST_METHOD("score", scorer_score, "Rewards and ends."),
    FAST_METHOD("infos", scorer_infos, "Infos by agent."),
    {NULL, NULL, 0, NULL},
};

KERNEL_TYPE(StepScorer, scorer, "What a race's steps mean for some agents.")
