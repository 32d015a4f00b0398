/* Updates the memory that drivers keep between steps. */

#include "planning.h"

#include <math.h>

#define LONG_AGO 40.0f   /* upper limit of elapsed times [steps]: stkzoo.agents.planning.memory */
#define DRIFT_SHOWS 4.0f /* a skid factor of 1 after this many steps ends the drift [steps] */
enum { NUMBERS = 12 };

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
        float *of = memory.data + i; /* the kart's numbers, `count` apart */
        for (int row = HOLD_STEPS; row <= RESCUE_STEPS; row++) {
            float *clock = of + row * count;
            *clock = *clock - 1 > 0 ? *clock - 1 : 0;
        }
        const float speed = speeds.data[i], pace = fabsf(speed), gain = speed - of[SPEED * count];
        of[GAIN * count] = gain, of[SPEED * count] = speed;
        if (gain < -(float)rules->crash_drop) {
            of[CAUTION_STEPS * count] = steps_of(rules->caution_time);
        }
        const int is_free = of[RESCUE_STEPS * count] == 0;
        const int is_still = pace < (float)rules->stuck_speed && is_free;
        const int crawls = pace < (float)rules->crawl_speed && is_free;
        of[STILL_STEPS * count] = is_still ? of[STILL_STEPS * count] + 1 : 0;
        of[CRAWL_STEPS * count] = crawls ? of[CRAWL_STEPS * count] + 1 : 0;
        const float free = of[FREE_STEPS * count] = is_still ? 0 : of[FREE_STEPS * count] + 1;
        if (free * (float)STEP > (float)rules->free_time) of[REVERSES * count] = 0;
        const float since_fire = of[SINCE_FIRE * count] + 1;
        of[SINCE_FIRE * count] = since_fire < LONG_AGO ? since_fire : LONG_AGO;
        if (of[DRIFT_COUNT * count] >= DRIFT_SHOWS && skeeds.data[i] <= 1.0f) {
            of[DRIFT_SIDE * count] = of[DRIFT_COUNT * count] = 0;
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
        const float *of = memory.data + i;
        float *number = out.data + width * i + first;
        const float side = of[DRIFT_SIDE * count];
        const float drifted = of[DRIFT_COUNT * count] / 30.0f;
        const float drift = drifted < 2.0f ? drifted : 2.0f;
        const float gain = of[GAIN * count] / 5.0f;
        *number++ = of[TURN * count];
        *number++ = of[DRIFT_TURN * count] * (float)(side != 0);
        *number++ = drift * side;
        *number++ = drift;
        *number++ = of[RELEASE_LEFT * count] / RELEASE_STEPS;
        *number++ = of[BOOST_STEPS * count] / SMALL_LASTS;
        *number++ = of[BIG_BOOST_STEPS * count] / BIG_LASTS;
        *number++ = of[NITRO_STEPS * count] / nitro_time;
        *number++ = of[CAUTION_STEPS * count] / caution_time;
        *number++ = of[STILL_STEPS * count] / steps_of(rules->stuck_time);
        *number++ = gain < -2.0f ? -2.0f : gain > 2.0f ? 2.0f : gain;
        *number++ = of[SINCE_FIRE * count] / LONG_AGO;
    }
    Py_RETURN_NONE;
}
