/* The extension module of the planner, and the function that plans. */

#define STKZOO_EXTENSION
#include "planning.h"

#include <math.h>

enum { OFFSETS = 7, LOGITS = MANEUVERS + OFFSETS + 4, INPUTS = 4 * MANEUVERS + 3 + 5 * RIVALS };
enum { ANGLE, OFFSET, BEYOND_EDGE, SCENE_SIZE }; /* columns of the scene */

#define METER 2.0f         /* logit per meter of worth */
#define LEAST_LOGIT -30.0f /* stkzoo.agents.planning.worth.LEAST_LOGIT */
#define BUTTON_LOGIT 2.0f  /* logit of the state of a button that the rules choose */

int as_rules(PyObject *object, void *rules)
{
    Doubles numbers;
    if (!as_doubles(object, &numbers)) return 0;
    *(const Rules **)rules = (const Rules *)numbers.data;
    if (numbers.size == sizeof(Rules) / sizeof(double)) return 1;
    refuse("the rules have the wrong length");
    return 0;
}

/* ---------------------------------------------------------------- inputs of a policy */

static int best_of(const float *worth)
{
    int best = 0;
    for (int i = 1; i < MANEUVERS; i++) {
        if (worth[i] > worth[best]) best = i;
    }
    return best;
}

/* Writes the logits of the rules. */
static void write_prior(const Survey *s, npy_intp kart, const Situation *at, Best plans,
                        const float *offset_logits, float *out)
{
    const Rules *rules = s->rules;
    const OwnState *own = (const OwnState *)s->around.own.data + kart;
    const float *memory = s->memory.data + kart, *worth = plans[WORTH];
    const int best = best_of(worth);
    const int is_safe = plans[BEST_DANGER][best] < (float)rules->danger && best != BRAKE;
    const int is_straight = fabsf(at->angle) < (float)rules->straight_aim &&
                            at->straightness < (float)rules->straight_angle;
    const int is_pressed[] = {
        is_safe && memory[NITRO_STEPS * s->count] == 0 &&
            own->velocity[2] > (float)rules->nitro_speed &&
            fabsf(plans[BEST_TURN][best]) < (float)rules->nitro_turn && own->energy > 0 &&
            !(own->jumping > 0),
        is_safe && is_straight && at->is_useful != 0 &&
            memory[SINCE_FIRE * s->count] >= (float)rules->fire_every,
    };
    for (int i = 0; i < MANEUVERS; i++) {
        const float logit = METER * (worth[i] - worth[best]);
        *out++ = LEAST_LOGIT > logit ? LEAST_LOGIT : logit;
    }
    for (int i = 0; i < OFFSETS; i++) *out++ = offset_logits[i];
    for (int button = 0; button < 2; button++) {
        *out++ = is_pressed[button] ? -BUTTON_LOGIT : BUTTON_LOGIT;
        *out++ = is_pressed[button] ? BUTTON_LOGIT : -BUTTON_LOGIT;
    }
}

/* Writes a policy's inputs from the plans and the nearest karts. */
static void write_inputs(const Situation *at, Best plans, float *out)
{
    const float *worth = plans[WORTH], most = worth[best_of(worth)];
    for (int i = 0; i < MANEUVERS; i++) {
        const float behind = worth[i] - most, danger = plans[BEST_DANGER][i] / 10.0f;
        *out++ = behind > LEAST_LOGIT / METER * 10;
        *out++ = -2.0f > behind / 10.0f ? -2.0f : behind / 10.0f;
        *out++ = plans[BEST_TURN][i];
        *out++ = 2.0f < danger ? 2.0f : danger;
    }
    *out++ = at->angle, *out++ = at->offset / 10.0f, *out++ = at->straightness;
    for (const RoadRival *rival = at->rivals; rival < at->rivals + RIVALS; rival++) {
        *out++ = (float)rival->is_there;
        *out++ = (float)(rival->along / 10.0);
        *out++ = rival->is_there != 0 ? ((float)rival->across - at->offset) / 3.0f : 0;
        *out++ = (float)rival->gain / 5.0f;
        *out++ = (float)rival->drift / 3.0f;
    }
}

/* ---------------------------------------------------------------- plans */

/* Sets where the road is, which plans follow; returns -1 with an exception set on failure. */
static int set_line(Survey *s, PyObject *line)
{
    const npy_intp num_looks = s->around.num_looks;
    if (line != Py_None) {
        Floats points;
        if (!as_floats(line, &points)) return -1;
        s->line = points.data, s->line_size = LINE_SIZE + 1, s->line_step = 5 * (MARKS + 1);
        return points.size == s->line_step * s->count ? 0 : refuse("the line does not fit");
    }
    s->line_size = LINE_SIZE, s->line_step = LINE_SIZE * num_looks;
    s->line = s->around.road.data + LINE_SIZE * (num_looks - MARKS - 1);
    return num_looks > MARKS ? 0 : refuse("the road has too few points");
}

/* plan_karts(plans, memory, around, line, moments, out, first): simulates and weighs the plans of A
   karts, and writes what a policy needs to choose among them.

   A kart steers toward a point of its lane ahead, within the turning limits of its plan. The lanes
   from -1 to 0 share the room to the left, those from 0 to 1 the room to the right.

   plans: a tuple: the parameters, (50,) float64 in the order of Rules; the worth of item types for
       karts without and with a powerup, (2, types) [m]; the plans of all states, in the order of
       stkzoo.agents.planning.plans.PlanTable; and the logits of the offsets, (7,). The fourth part
       is empty for karts that drive arcs at constant speed. Otherwise it has three layers of a
       network, (outputs, inputs) and (outputs,) each, with rectified linear units between them. The
       network maps MotionState.inputs to the turn to the right in a step [rad] and the changes of
       forward speed and speed to the right [m/s].
   memory: (22, A) in the order of stkzoo.agents.planning.memory.PlanMemory.
   around: the first five arrays of stkzoo.wrappers.racing.Surroundings; the marks are the last 37
       points of the road.
   line: (A, 37, 5) marks of another line, with the distances to its left and to its right edge [m];
       or None.
   moments: (A, 2, 46) observations of the step before and of this one, which are written: positions
       of the nearest karts, right and ahead, (4, 2) [m]; velocity of the observing kart, (2,) [m/s];
       directions of the road, (36,) [rad]. None to ignore other karts.
   out: arrays to write: (3, A, 4), see Best; (A, 3) angle to the road [rad], offset from its middle
       and distance beyond its nearer edge [m]; (A, 15) logits of the rules; and (A, F) a policy's
       inputs. The function writes 39 columns of them, beginning at `first`; none if F is 0. */
PyObject *plan_karts(PyObject *Py_UNUSED(module), PyObject *args)
{
    PyObject *plans, *around, *line, *moments, *out, *table, *motion;
    Survey s = {.moments = NULL};
    Floats logits, moment = {NULL, 0}, bests, scene, prior, inputs;
    npy_intp first;
    if (!PyArg_ParseTuple(args, "O!O&O!OOO!n", &PyTuple_Type, &plans, as_floats, &s.memory,
                          &PyTuple_Type, &around, &line, &moments, &PyTuple_Type, &out, &first) ||
        !PyArg_ParseTuple(plans, "O&O&O!O!O&", as_rules, &s.rules, as_floats, &s.worths,
                          &PyTuple_Type, &table, &PyTuple_Type, &motion, as_floats, &logits) ||
        !PyArg_ParseTuple(out, "O&O&O&O&", as_written_floats, &bests, as_written_floats, &scene,
                          as_written_floats, &prior, as_written_floats, &inputs) ||
        (moments != Py_None && !as_written_floats(moments, &moment)) ||
        read_around(around, 0, &s.around) < 0) {
        return NULL;
    }
    const npy_intp count = s.count = s.memory.size / MEMORY_SIZE, all = MANEUVERS * count;
    const npy_intp width = count ? inputs.size / count : 0, one = sizeof(Moment) / sizeof(float);
    s.num_types = s.worths.size / 2;
    const npy_intp sizes[][2] = {
        {s.memory.size, MEMORY_SIZE * count},
        {s.around.count, count},
        {s.worths.size, 2 * s.num_types},
        {logits.size, OFFSETS},
        {moment.size, moment.data ? 2 * one * count : 0},
        {bests.size, NUM_BESTS * all},
        {scene.size, SCENE_SIZE * count},
        {prior.size, LOGITS * count},
        {inputs.size, width * count},
        {width == 0 || (first >= 0 && first <= width && width - first >= INPUTS), 1},
    };
    if (ARE_SIZES(sizes) < 0) return NULL;
    if (!count) Py_RETURN_NONE;
    if (set_line(&s, line) < 0) return NULL;
    if (moment.data) s.moments = (Moment (*)[2])moment.data;
    Forecast *forecast = new_forecast(s.rules, table, motion);
    if (!forecast) return NULL;
    for (npy_intp kart = 0; kart < count; kart++) {
        Situation at;
        Best best;
        survey_kart(&s, kart, &at);
        weigh(forecast, &at, best);
        write_prior(&s, kart, &at, best, logits.data, prior.data + LOGITS * kart);
        if (width) write_inputs(&at, best, inputs.data + width * kart + first);
        for (int part = 0; part < NUM_BESTS; part++) {
            memcpy(bests.data + all * part + MANEUVERS * kart, best[part], sizeof best[part]);
        }
        float *row = scene.data + SCENE_SIZE * kart;
        row[ANGLE] = at.angle, row[OFFSET] = at.offset, row[BEYOND_EDGE] = at.beyond;
    }
    PyMem_Free(forecast);
    Py_RETURN_NONE;
}

/* ---------------------------------------------------------------- the module */

static PyMethodDef methods[] = {
    {"age_memory", age_memory, METH_VARARGS, "Advances the memory of drivers by one step."},
    {"compute_layer", compute_layer, METH_VARARGS, "Writes the outputs of a layer of a network."},
    {"plan_karts", plan_karts, METH_VARARGS, "Simulates and weighs the plans of karts."},
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
