/* Updates the memory that drivers keep between steps. */

#include "planning.h"

#include <math.h>

#define LONG_AGO 40.0f   /* upper limit of elapsed times [steps]: stkzoo.agents.planning.memory */
#define DRIFT_SHOWS 4.0f /* a skid factor of 1 after this many steps ends the drift [steps] */
enum { NUMBERS = 12 };

/* Returns the address of a kart's number in a row of the memory. */
static float *at(Floats memory, npy_intp count, int row, npy_intp kart)
{
    return memory.data + row * count + kart;
}

/* Converts a time [s] to the nearest number of steps. */
static float steps_of(double time)
{
    return (float)rint(time / STEP);
}

/* age_memory(rules, memory, speed, skeed_factor): advances the memory of A karts by one step.

   rules: (50,) in the order of Rules.
   memory: (22, A) in the order of stkzoo.agents.planning.memory.PlanMemory.
   speed: (A,) forward speed [m/s].
   skeed_factor: (A,) skid factor. */
PyObject *age_memory(PyObject *Py_UNUSED(module), PyObject *args)
{
    const Rules *rules;
    Floats memory, speeds, skeeds;
    if (!PyArg_ParseTuple(args, "O&O&O&O&", as_rules, &rules, as_written_floats, &memory,
                          as_floats, &speeds, as_floats, &skeeds)) {
        return NULL;
    }
    const npy_intp count = speeds.size;
    const npy_intp sizes[][2] = {{memory.size, MEMORY_SIZE * count}, {skeeds.size, count}};
    if (ARE_SIZES(sizes) < 0) return NULL;
    for (npy_intp i = 0; i < count; i++) {
        for (int row = HOLD_STEPS; row <= RESCUE_STEPS; row++) {
            float *clock = at(memory, count, row, i);
            *clock = *clock - 1 > 0 ? *clock - 1 : 0;
        }
        const float speed = speeds.data[i], pace = fabsf(speed);
        const float gain = speed - *at(memory, count, SPEED, i);
        *at(memory, count, GAIN, i) = gain, *at(memory, count, SPEED, i) = speed;
        if (gain < -(float)rules->crash_drop) {
            *at(memory, count, CAUTION_STEPS, i) = steps_of(rules->caution_time);
        }
        const int is_free = *at(memory, count, RESCUE_STEPS, i) == 0;
        const int is_still = pace < (float)rules->stuck_speed && is_free;
        const int crawls = pace < (float)rules->crawl_speed && is_free;
        float *still = at(memory, count, STILL_STEPS, i), *free = at(memory, count, FREE_STEPS, i);
        float *crawl = at(memory, count, CRAWL_STEPS, i), *fire = at(memory, count, SINCE_FIRE, i);
        *still = is_still ? *still + 1 : 0;
        *crawl = crawls ? *crawl + 1 : 0;
        *free = is_still ? 0 : *free + 1;
        if (*free * (float)STEP > (float)rules->free_time) {
            *at(memory, count, REVERSES, i) = 0;
        }
        *fire = *fire + 1 < LONG_AGO ? *fire + 1 : LONG_AGO;
        float *drift = at(memory, count, DRIFT_COUNT, i);
        if (*drift >= DRIFT_SHOWS && skeeds.data[i] <= 1.0f) {
            *at(memory, count, DRIFT_SIDE, i) = *drift = 0;
        }
    }
    Py_RETURN_NONE;
}

/* write_memory(rules, memory, out, first): writes a policy's inputs from the memory, beginning at
   column `first` of `out`, (A, F); 12 columns are written. */
PyObject *write_memory(PyObject *Py_UNUSED(module), PyObject *args)
{
    const Rules *rules;
    Floats memory, out;
    npy_intp first;
    if (!PyArg_ParseTuple(args, "O&O&O&n", as_rules, &rules, as_floats, &memory,
                          as_written_floats, &out, &first)) {
        return NULL;
    }
    const npy_intp count = memory.size / MEMORY_SIZE, width = count ? out.size / count : 0;
    if (memory.size != MEMORY_SIZE * count || out.size != width * count || first < 0 ||
        (count && first > width - NUMBERS)) {
        return PyErr_Format(PyExc_ValueError, "a row is too short for %d numbers", NUMBERS);
    }
    const float nitro_time = fmaxf(steps_of(rules->nitro_wait), 1);
    const float caution_time = fmaxf(steps_of(rules->caution_time), 1);
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
        *number++ = *at(memory, count, RELEASE_LEFT, i) / RELEASE_STEPS;
        *number++ = *at(memory, count, BOOST_STEPS, i) / SMALL_LASTS;
        *number++ = *at(memory, count, BIG_BOOST_STEPS, i) / BIG_LASTS;
        *number++ = *at(memory, count, NITRO_STEPS, i) / nitro_time;
        *number++ = *at(memory, count, CAUTION_STEPS, i) / caution_time;
        *number++ = *at(memory, count, STILL_STEPS, i) / steps_of(rules->stuck_time);
        *number++ = gain < -2.0f ? -2.0f : gain > 2.0f ? 2.0f : gain;
        *number++ = *at(memory, count, SINCE_FIRE, i) / LONG_AGO;
    }
    Py_RETURN_NONE;
}
