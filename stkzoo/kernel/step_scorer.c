/* Computes the rewards, terminations, truncations and infos of a race's agents. To add a built-in term,
   write a function here, add it to TERMS, and name it in stkzoo/mdp/rewards.py. */

#include "kernel.h"

#include <math.h>
#include <string.h>

/* The race of a step. */
typedef struct {
    double num_karts, length; /* length: number of laps times the length of a lap [m] */
} Race;

/* A term of a reward: the value of a step for a kart, from its records before and after the step. */
typedef double (*Term)(const Kart *before, const Kart *after, const Race *race);

/* A sum of terms. */
typedef struct {
    Term *terms;
    Indices columns;
    Doubles weights;
} Reward;

typedef struct {
    OBJECT_HEAD
    Indices karts;            /* (A,) each agent's kart */
    Doubles last, sums;       /* (A, C): reward terms, then events, of the step; their sums */
    Doubles owed, limits;     /* (A, T): earned but not yet paid; the most that a step pays */
    Doubles events;           /* (K, E): events of all karts in the step */
    npy_intp num_columns, num_terms, num_events;
    double race_length;
    Reward *rewards; /* (A,) */
} StepScorer;

/* ---------------------------------------------------------------- rewards */

/* Returns the distance driven [m]. The engine's distance is negative until the start line. */
static double driven(const Kart *kart)
{
    return kart->overall_distance > 0 ? kart->overall_distance : 0;
}

/* Returns the distance driven [m], limited to the length of the race. The engine may finish a kart a
   few centimeters before the line. */
static double driven_of(const Kart *kart, const Race *race)
{
    return kart->has_finished_race > 0 ? race->length : fmin(driven(kart), race->length);
}

/* Returns 1 in the step in which the kart finishes, otherwise 0. */
static double finishes(const Kart *before, const Kart *after)
{
    return after->has_finished_race > before->has_finished_race;
}

/* Returns the fraction of the other karts that are behind this one. */
static double share_behind(const Kart *kart, const Race *race)
{
    return (race->num_karts - kart->position) / (race->num_karts > 1 ? race->num_karts - 1 : 1);
}

/* 0.1 per meter driven. */
static double progress_term(const Kart *before, const Kart *after, const Race *Py_UNUSED(race))
{
    return (driven(after) - driven(before)) / 10.0;
}

/* (1 - position/K) (3 + 7 f), where f is 1 in the finishing step and otherwise 0. */
static double rank_term(const Kart *before, const Kart *after, const Race *race)
{
    return (1.0 - after->position / race->num_karts) * (3.0 + 7.0 * finishes(before, after));
}

/* -0.1 in every step. */
static double time_term(const Kart *Py_UNUSED(before), const Kart *Py_UNUSED(after),
                        const Race *Py_UNUSED(race))
{
    return -0.1;
}

/* 10 in the finishing step. */
static double finish_term(const Kart *before, const Kart *after, const Race *Py_UNUSED(race))
{
    return finishes(before, after) > 0 ? 10.0 : 0.0;
}

/* The fraction of the race driven in this step; a finisher's sum is 1. */
static double course_term(const Kart *before, const Kart *after, const Race *race)
{
    return (driven_of(after, race) - fmin(driven(before), race->length)) / race->length;
}

/* In the finishing step, 1 for the winner down to 0 for the last kart, evenly spaced. */
static double placement_term(const Kart *before, const Kart *after, const Race *race)
{
    return finishes(before, after) * share_behind(after, race);
}

/* 0.1 per meter driven up to the finish line. */
static double advance_term(const Kart *before, const Kart *after, const Race *race)
{
    return (driven_of(after, race) - driven_of(before, race)) / 10.0;
}

/* The potential of place_term. */
static double worth_of_place(const Kart *kart, const Race *race)
{
    return 20.0 * share_behind(kart, race) * (driven_of(kart, race) / race->length);
}

/* The change of 20 (K - position)/(K - 1) times the fraction of the race driven. As the term is
   potential-based, it sums to 20 for the winner and 0 for the last kart, from every place on the
   grid. Early in the race a place counts little, because the driven fraction is small. */
static double place_term(const Kart *before, const Kart *after, const Race *race)
{
    return worth_of_place(after, race) - worth_of_place(before, race);
}

/* 1 for each place gained, -1 for each place lost. */
static double overtaking_term(const Kart *before, const Kart *after, const Race *Py_UNUSED(race))
{
    return before->position - after->position;
}

/* The built-in terms by name. */
static const struct {
    const char *name;
    Term term;
} TERMS[] = {
    {"progress", progress_term}, {"rank", rank_term},           {"time", time_term},
    {"finish", finish_term},     {"course", course_term},       {"placement", placement_term},
    {"advance", advance_term},   {"place", place_term},         {"overtaking", overtaking_term},
};

/* Returns the term of a name; NULL with an exception set if there is none. */
static Term find_term(PyObject *name)
{
    const char *text = PyUnicode_Check(name) ? PyUnicode_AsUTF8(name) : NULL;
    for (size_t i = 0; text && i < sizeof TERMS / sizeof *TERMS; i++) {
        if (!strcmp(TERMS[i].name, text)) return TERMS[i].term;
    }
    if (!PyErr_Occurred()) PyErr_Format(PyExc_ValueError, "there is no reward term %R", name);
    return NULL;
}

static double *row_of(const StepScorer *self, Doubles table, npy_intp agent)
{
    return table.data + agent * self->num_columns;
}

static double clip(double value, double limit)
{
    return fmax(-limit, fmin(value, limit));
}

/* Limits what each term pays in a step. What is left is paid in later steps, a tenth of the limit in
   each; the finishing step pays all. */
static void limit_terms(const StepScorer *self, npy_intp agent, int has_finished, double *terms)
{
    double *owed = self->owed.data + agent * self->num_terms;
    const double *limits = self->limits.data + agent * self->num_terms;
    for (npy_intp t = 0; t < self->num_terms; t++) {
        const double all = terms[t] + owed[t], limit = limits[t];
        if (isinf(limit)) continue;
        terms[t] = has_finished ? all : clip(terms[t], limit) + clip(owed[t], limit / 10);
        owed[t] = all - terms[t];
    }
}

/* Computes an agent's terms in a step and adds them to its sums. Returns the reward. */
static double score(const StepScorer *self, npy_intp agent, const Snapshot *before,
                  const Snapshot *after)
{
    const Race race = {after->header->num_kart, self->race_length};
    const Reward *reward = self->rewards + agent;
    const npy_intp kart = self->karts.data[agent];
    double *last = row_of(self, self->last, agent), *sums = row_of(self, self->sums, agent);
    for (npy_intp t = 0; t < reward->weights.size; t++) {
        last[reward->columns.data[t]] =
            reward->weights.data[t] *
            reward->terms[t](before->karts + kart, after->karts + kart, &race);
    }
    limit_terms(self, agent, after->karts[kart].has_finished_race > 0, last);
    memcpy(last + self->num_terms, self->events.data + kart * self->num_events,
           (size_t)self->num_events * sizeof *last);
    double total = 0;
    for (npy_intp c = 0; c < self->num_columns; c++) {
        if (c < self->num_terms) total += last[c];
        sums[c] += last[c];
    }
    return total;
}

/* ---------------------------------------------------------------- results */

/* Writes an agent's info: its whole numbers and its other numbers, each in a column of a table. */
static void write_info(const StepScorer *self, npy_intp agent, const Kart *kart, npy_int64 length,
                       npy_intp step, npy_int64 *wholes, double *numbers)
{
    const npy_intp width = self->num_columns;
    const double *last = row_of(self, self->last, agent), *sums = row_of(self, self->sums, agent);
    double total = 0;
    wholes[0] = kart->position;
    wholes[step] = kart->finished_laps > 0 ? kart->finished_laps : 0;
    wholes[2 * step] = length;
    numbers[0] = driven(kart);
    numbers[step] = kart->finish_time;
    numbers += 2 * step;
    for (npy_intp c = 0; c < width; c++, numbers += step) *numbers = last[c];
    for (npy_intp c = 0; c < width; c++, numbers += step) {
        if (c < self->num_terms) total += sums[c];
        *numbers = sums[c];
    }
    *numbers = total;
}

static int is_of_this_race(const StepScorer *self, const Snapshot *snapshot)
{
    if (are_below(self->karts, snapshot->header->num_kart)) return 1;
    PyErr_Format(PyExc_ValueError, "a snapshot of another race, with %d karts",
                 snapshot->header->num_kart);
    return 0;
}

static int is_among(npy_intp agent, Indices who)
{
    npy_intp i = 0;
    while (i < who.size && who.data[i] != agent) i++;
    return i < who.size;
}

/* score_into(before, after, is_over, who, slots, rewards, terminations, truncations): computes the
   step between the bytes of two snapshots, and writes the results into arrays with one element per
   slot; agent who[i] has slots[i]. The terms of all other agents are zeros. `is_over` is whether the
   time limit has been reached. */
static PyObject *scorer_score_into(PyObject *object, PyObject *args)
{
    StepScorer *self = (StepScorer *)object;
    Snapshot before, after;
    int is_over;
    Indices who, slots;
    Doubles rewards;
    Flags ended, cut;
    if (!PyArg_ParseTuple(args, "O&O&pO&O&O&O&O&", as_snapshot, &before, as_snapshot, &after,
                          &is_over, as_indices, &who, as_indices, &slots, as_written_doubles,
                          &rewards, as_written_flags, &ended, as_written_flags, &cut) ||
        !is_of_this_race(self, &before) || !is_of_this_race(self, &after)) {
        return NULL;
    }
    if (ended.size != rewards.size || cut.size != rewards.size) {
        return PyErr_Format(PyExc_ValueError, "the arrays differ in length");
    }
    if (check_rows("agent", who, self->karts.size, slots, rewards.size) < 0) return NULL;
    for (npy_intp agent = 0; agent < self->karts.size; agent++) {
        const npy_intp width = is_among(agent, who) ? 0 : self->num_columns;
        memset(row_of(self, self->last, agent), 0, (size_t)width * sizeof(double));
    }
    for (npy_intp i = 0; i < slots.size; i++) {
        const npy_intp agent = who.data[i], slot = slots.data[i];
        const npy_bool has_ended = after.karts[self->karts.data[agent]].has_finished_race > 0;
        rewards.data[slot] = score(self, agent, &before, &after);
        ended.data[slot] = has_ended;
        cut.data[slot] = is_over && !has_ended;
    }
    Py_RETURN_NONE;
}

/* infos_into(data, length, who, slots, wholes, numbers): writes the infos at a snapshot into two
   tables, each with a row per key and a column per slot; agent who[i] has slots[i]. `length` is the
   number of steps of the episode. */
static PyObject *scorer_infos_into(PyObject *object, PyObject *args)
{
    const StepScorer *self = (StepScorer *)object;
    Snapshot now;
    npy_intp length;
    Indices who, slots;
    Wholes wholes;
    Doubles numbers;
    if (!PyArg_ParseTuple(args, "O&nO&O&O&O&", as_snapshot, &now, &length, as_indices, &who,
                          as_indices, &slots, as_written_wholes, &wholes, as_written_doubles,
                          &numbers) ||
        !is_of_this_race(self, &now)) {
        return NULL;
    }
    const npy_intp count = wholes.size / 3, num_rows = 3 + 2 * self->num_columns;
    if (wholes.size != 3 * count || numbers.size != num_rows * count) {
        return PyErr_Format(PyExc_ValueError, "expected tables of 3 and %zd rows", num_rows);
    }
    if (check_rows("agent", who, self->karts.size, slots, count) < 0) return NULL;
    for (npy_intp i = 0; i < slots.size; i++) {
        const npy_intp agent = who.data[i], slot = slots.data[i];
        write_info(self, agent, now.karts + self->karts.data[agent], length, count,
                   wholes.data + slot, numbers.data + slot);
    }
    Py_RETURN_NONE;
}

/* ---------------------------------------------------------------- the type */

/* Sets a reward from a tuple (names of terms, weights, columns). */
static int set_reward(StepScorer *self, Reward *reward, PyObject *spec)
{
    PyObject *names;
    if (!is_tuple(spec) ||
        !PyArg_ParseTuple(spec, "O!O&O&", &PyTuple_Type, &names, as_doubles, &reward->weights,
                          as_indices, &reward->columns)) {
        return -1;
    }
    const npy_intp count = PyTuple_GET_SIZE(names);
    if (reward->weights.size != count || reward->columns.size != count ||
        !are_below(reward->columns, self->num_terms)) {
        return refuse("the parts of a reward do not fit together");
    }
    if (!(reward->terms = room_for(self, count, sizeof *reward->terms))) return -1;
    for (npy_intp i = 0; i < count; i++) {
        if (!(reward->terms[i] = find_term(PyTuple_GET_ITEM(names, i)))) return -1;
    }
    return 0;
}

/* StepScorer(karts, last, sums, owed, limits, race_length, rewards, events): `rewards` has a tuple for
   set_reward() for each agent. */
static int scorer_set_up(StepScorer *self, PyObject *args, PyObject *Py_UNUSED(kwargs))
{
    PyObject *rewards;
    if (!PyArg_ParseTuple(args, "O&O&O&O&O&dO!O&", as_indices, &self->karts, as_written_doubles,
                          &self->last, as_written_doubles, &self->sums, as_written_doubles,
                          &self->owed, as_doubles, &self->limits, &self->race_length, &PyTuple_Type,
                          &rewards, as_written_doubles, &self->events)) {
        return -1;
    }
    const npy_intp count = self->karts.size, width = count ? self->sums.size / count : 0;
    self->num_terms = count ? self->limits.size / count : 0;
    const npy_intp num_events = self->num_events = width - self->num_terms;
    const npy_intp num_karts = num_events > 0 ? self->events.size / num_events : NPY_MAX_INTP;
    const npy_intp sizes[][2] = {
        {self->sums.size, width * count},
        {self->last.size, self->sums.size},
        {self->limits.size, self->num_terms * count},
        {self->owed.size, self->limits.size},
        {PyTuple_GET_SIZE(rewards), count},
        {num_events >= 0 && are_below(self->karts, num_karts), 1},
    };
    self->num_columns = width;
    if (ARE_SIZES(sizes) < 0 ||
        !(self->rewards = room_for(self, count, sizeof *self->rewards))) {
        return -1;
    }
    for (Py_ssize_t i = 0; i < count; i++) {
        if (set_reward(self, self->rewards + i, PyTuple_GET_ITEM(rewards, i)) < 0) return -1;
    }
    return 0;
}

KERNEL_TYPE(StepScorer, scorer, "Makes the rewards, ends and infos of agents.",
            {"score_into", scorer_score_into, METH_VARARGS, "Writes rewards and ends into arrays."},
            {"infos_into", scorer_infos_into, METH_VARARGS, "Writes infos into tables."})
