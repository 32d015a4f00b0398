/* The extension module of the planner. */

#define STKZOO_EXTENSION
#include "planning.h"

static PyMethodDef methods[] = {
    {"age_memory", age_memory, METH_VARARGS, "Advances the memory of drivers by one step."},
    {"present_plans", present_plans, METH_VARARGS, "Writes a policy's inputs on plans."},
    {"survey_road", survey_road, METH_VARARGS, "Writes the arguments of weigh_plans."},
    {"weigh_plans", weigh_plans, METH_VARARGS, "Writes each kart's best plan of each maneuver."},
    {"write_memory", write_memory, METH_VARARGS, "Writes a policy's inputs from the memory."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {
    PyModuleDef_HEAD_INIT,
    .m_name = "stkzoo.agents.planning._planning",
    .m_doc = "The inner loops of the planner.",
    .m_size = -1,
    .m_methods = methods,
};

PyMODINIT_FUNC PyInit__planning(void)
{
    import_array();
    return PyModule_Create(&module);
}
