/* Declarations that the parts of the planner's extension share. */

#ifndef STKZOO_PLANNING_H
#define STKZOO_PLANNING_H

#include "arguments.h"

/* The rows of stkzoo.agents.planning.memory.PlanMemory. Each row has one number per kart. */
enum {
    SPEED, GAIN, TURN, DRIFT_TURN, DRIFT_SIDE, DRIFT_COUNT, STILL_STEPS, CRAWL_STEPS, FREE_STEPS,
    REVERSES, LOST_STEPS, SINCE_FIRE, HELD_OFFSET, HOLD_STEPS, HOP_STEPS, RELEASE_LEFT,
    BOOST_STEPS, BIG_BOOST_STEPS, NITRO_STEPS, CAUTION_STEPS, REVERSE_STEPS, RESCUE_STEPS,
    MEMORY_SIZE
};

PyObject *age_memory(PyObject *module, PyObject *args);
PyObject *present_plans(PyObject *module, PyObject *args);
PyObject *survey_road(PyObject *module, PyObject *args);
PyObject *weigh_plans(PyObject *module, PyObject *args);
PyObject *write_memory(PyObject *module, PyObject *args);

#endif
