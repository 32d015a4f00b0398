/* Updates the memory that drivers keep between steps. */

#include "planning.h"

#include <math.h>

/* Indices of `rules`. */
enum {
    STEP, CRASH_DROP, CAUTION_TIME, STUCK_SPEED, STUCK_TIME, CRAWL_SPEED, FREE_TIME, NITRO_TIME,
    LONG_AGO, DRIFT_SHOWS, RELEASE_TIME, BOOST_TIME, BIG_BOOST_TIME, NUM_RULES
};

enum { NUMBERS = 12 };

/* Returns the address of a kart's number in a row of the memory. */
static float *at(Floats memory, npy_intp count, int row, npy_intp kart)
{
    return memory.data + row * count + kart;
}

static int fits_rules(Doubles rules, Floats memory, npy_intp count)
{
    if (rules.size == NUM_RULES && memory.size == MEMORY_SIZE * count) return 1;
    refuse("the memory does not fit its rules or its karts");
    return 0;
}

/* age_memory(rules, memory, speed, skeed_factor): advances the memory of A karts by one step.

   rules: (13,) in the order of the enum above; times are in steps, except STEP and FREE_TIME [s].
   memory: (22, A) in the order of stkzoo.agents.planning.memory.PlanMemory.
   speed: (A,) forward speed [m/s].
   skeed_factor: (A,) skid factor. */
PyObject *age_memory(PyObject *Py_UNUSED(module), PyObject *args)
{
    Doubles rules;
    Floats memory, speeds, skeeds;
    if (!PyArg_ParseTuple(args, "O&O&O&O&", as_doubles, &rules, as_written_floats, &memory,
                          as_floats, &speeds, as_floats, &skeeds)) {
        return NULL;
    }
    const npy_intp count = speeds.size;
    if (!fits_rules(rules, memory, count)) return NULL;
    if (skeeds.size != count) {
        return PyErr_Format(PyExc_ValueError, "there must be %zd skid factors", count);
    }
    const double *rule = rules.data;
    for (npy_intp i = 0; i < count; i++) {
        for (int row = HOLD_STEPS; row <= RESCUE_STEPS; row++) {
            float *clock = at(memory, count, row, i);
            *clock = *clock - 1 > 0 ? *clock - 1 : 0;
        }
        const float speed = speeds.data[i], pace = fabsf(speed);
        const float gain = speed - *at(memory, count, SPEED, i);
        *at(memory, count, GAIN, i) = gain, *at(memory, count, SPEED, i) = speed;
        if (gain < -(float)rule[CRASH_DROP]) {
            *at(memory, count, CAUTION_STEPS, i) = (float)rule[CAUTION_TIME];
        }
        const int is_free = *at(memory, count, RESCUE_STEPS, i) == 0;
        const int is_still = pace < (float)rule[STUCK_SPEED] && is_free;
        const int crawls = pace < (float)rule[CRAWL_SPEED] && is_free;
        float *still = at(memory, count, STILL_STEPS, i), *free = at(memory, count, FREE_STEPS, i);
        float *crawl = at(memory, count, CRAWL_STEPS, i), *fire = at(memory, count, SINCE_FIRE, i);
        *still = is_still ? *still + 1 : 0;
        *crawl = crawls ? *crawl + 1 : 0;
        *free = is_still ? 0 : *free + 1;
        if (*free * (float)rule[STEP] > (float)rule[FREE_TIME]) {
            *at(memory, count, REVERSES, i) = 0;
        }
        *fire = *fire + 1 < (float)rule[LONG_AGO] ? *fire + 1 : (float)rule[LONG_AGO];
        float *drift = at(memory, count, DRIFT_COUNT, i);
        if (*drift >= (float)rule[DRIFT_SHOWS] && skeeds.data[i] <= 1.0f) {
            *at(memory, count, DRIFT_SIDE, i) = *drift = 0;
        }
    }
    Py_RETURN_NONE;
}

/* write_memory(rules, memory, out, first): writes a policy's inputs from the memory, beginning at
   column `first` of `out`, (A, F); 12 columns are written. */
PyObject *write_memory(PyObject *Py_UNUSED(module), PyObject *args)
{
    Doubles rules;
    Floats memory, out;
    npy_intp first;
    if (!PyArg_ParseTuple(args, "O&O&O&n", as_doubles, &rules, as_floats, &memory,
                          as_written_floats, &out, &first)) {
        return NULL;
    }
    const npy_intp count = memory.size / MEMORY_SIZE, width = count ? out.size / count : 0;
    if (!fits_rules(rules, memory, count)) return NULL;
    if (out.size != width * count || first < 0 || (count && first > width - NUMBERS)) {
        return PyErr_Format(PyExc_ValueError, "a row is too short for %d numbers", NUMBERS);
    }
    const double *rule = rules.data;
    const float nitro_time = (float)(rule[NITRO_TIME] > 1 ? rule[NITRO_TIME] : 1);
    const float caution_time = (float)(rule[CAUTION_TIME] > 1 ? rule[CAUTION_TIME] : 1);
    for (npy_intp i = 0; i < count; i++) {
        float *number = out.data + width * i + first;
        const float side = *at(memory, count, DRIFT_SIDE, i);
        const float drifted = *at(memory, count, DRIFT_COUNT, i) / 30.0f;
        const float drift = drifted < 2.0f ? drifted : 2.0f;
        const float gain = *at(memory, count, GAIN, i) / 5.0f;
        *number++ = *at(memory, count, TURN, i);
        *number++ = *at(memory, count, DRIFT_TURN, i) * (float)(side != 0);
        *number++ = drift * side;
        *number++ = drift;
        *number++ = *at(memory, count, RELEASE_LEFT, i) / (float)rule[RELEASE_TIME];
        *number++ = *at(memory, count, BOOST_STEPS, i) / (float)rule[BOOST_TIME];
        *number++ = *at(memory, count, BIG_BOOST_STEPS, i) / (float)rule[BIG_BOOST_TIME];
        *number++ = *at(memory, count, NITRO_STEPS, i) / nitro_time;
        *number++ = *at(memory, count, CAUTION_STEPS, i) / caution_time;
        *number++ = *at(memory, count, STILL_STEPS, i) / (float)rule[STUCK_TIME];
        *number++ = gain < -2.0f ? -2.0f : gain > 2.0f ? 2.0f : gain;
        *number++ = *at(memory, count, SINCE_FIRE, i) / (float)rule[LONG_AGO];
    }
    Py_RETURN_NONE;
}
