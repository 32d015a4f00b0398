/* The plans of karts: driven over the road ahead by a simple model of a kart, and weighed.

   The formulas are those of stkzoo.kernel.reference.plan_weigher, which says what the numbers
   are. Results agree with numpy's to the last bit where numpy uses fused multiply-adds. */

#include "kernel.h"
#include "vectors.h"

/* Before a loop: what it writes is read by no later round. */
#if defined(__clang__)
#define NO_OVERLAP _Pragma("clang loop vectorize(assume_safety)")
#elif defined(__GNUC__)
#define NO_OVERLAP _Pragma("GCC ivdep")
#else
#define NO_OVERLAP
#endif

enum { MANOEUVRES = 4, BRAKE = 1, ITEM_LANES = 2 };
static const float NEVER = -1e4f;

/* The plans of all states, in the order in which they are given. */
typedef struct {
    Floats spans;                                         /* (T,) */
    Floats least, most, drifts, releases, slower, lanes; /* (S, T, C) */
    Indices items, manoeuvres, boosts;                    /* (S, C) */
    Floats boost_steps;
    Flags needs_drift;
} Table;

/* What holds for all karts, in the order in which it is given. */
enum {
    RELEASE_TURN, STEERING_LAG, MARK_SPACING, OVER_COST, LATE_TIME, LATE_COST, ANGLE_COST,
    SMALL_BOOST_LASTS, BIG_BOOST_LASTS, BOOST_WORTH, BIG_BOOST_WORTH, BOOST_WAIT_COST, BLUR,
    BUMP_COST, BUMP_WIDTH, LENGTH, BESIDE, HARMLESS, CROSSING, NUM_RULES
};

/* A kart's own numbers, in the order in which they are given. */
typedef struct {
    float speed, lock, reach, turn, drift_turn, offset, angle, boost_steps, big_boost_steps;
    float may_drift, may_brake;
} PlanKart;

typedef struct {
    double along, across, worth, radius;
} RoadItem;

typedef struct {
    double is_there, along, across, gain, drift;
} RoadRival;

/* What plans of a kart come to: moments by plans, and plans. */
typedef struct {
    const Table *table;
    npy_intp states, moments, plans, marks;
    npy_intp row; /* where the plans of the kart's state begin in (S, C) */
    const double *rules;
    float *along, *across, *ahead;            /* (T, C) */
    float *angle, *last_turn, *turns, *extra; /* (C,) */
    float *danger, *worth, *gain;             /* (C,) */
    float *bends, *curves, *first_rooms;      /* (C,) of the road where a moment begins */
    npy_int32 *places;                        /* (C,) */
    float *ends;                              /* (T,) of the moments */
} Forecast;

/* One moment of all plans, from where the moment before it ended. */
FORCE_INLINE void drive_moment(const Forecast *f, const PlanKart *kart, npy_intp moment,
                               const int is_first)
{
    const Table *t = f->table;
    const npy_intp plans = f->plans, at = moment * plans, in_table = f->row * f->moments + at;
    const float span = t->spans.data[moment], lock = kart->lock, reach = kart->reach;
    const float pull = 2.0f / (reach * reach * lock), rate = lock * span;
    const float release_rate = (float)f->rules[RELEASE_TURN] / lock;
    const float lag = (float)f->rules[STEERING_LAG], own_turn = kart->turn;
    const float per_mark = (float)(1.0 / f->rules[MARK_SPACING]);
    const float last_mark = (float)(f->marks - 1), own_speed = kart->speed;
    const float own_offset = kart->offset;
    const float *least = t->least.data + in_table, *most = t->most.data + in_table;
    const float *drifts = t->drifts.data + in_table;
    const float *releases = t->releases.data + in_table;
    const float *slower = t->slower.data + in_table;
    const float *lanes = t->lanes.data + in_table, *extra = f->extra;
    float *along = f->along + at, *across = f->across + at;
    float *angles = f->angle, *last_turns = f->last_turn;
    float *turns = f->turns;
    const float *bends = f->bends, *curves = f->curves;
    npy_int32 *places = f->places;
    const float *along_before = f->along + at - (is_first ? 0 : plans);
    const float *across_before = f->across + at - (is_first ? 0 : plans);
    const float *rooms = is_first ? f->first_rooms : f->ahead + at - plans;
    NO_OVERLAP
    for (npy_intp i = 0; i < plans; i++) {
        const float curve = curves[i];
        const float beside = is_first ? own_offset : across_before[i];
        const float wanted_speed = own_speed + slower[i];
        const float speed = wanted_speed > 4.0f ? wanted_speed : 4.0f;
        float angle = angles[i];
        float turn = (lanes[i] * rooms[i] + extra[i] - beside + bends[i] - angle * reach) *
                     (speed * pull);
        turn = turn > least[i] ? turn : least[i];
        turn = turn < most[i] ? turn : most[i];
        const float turn_before = last_turns[i];
        const float last_turn = drifts[i] > 0 ? turn : turn_before;
        last_turns[i] = last_turn;
        if (is_first) {
            turns[i] = turn;
            turn = turn + (own_turn - turn) * lag;
        }
        turn = (turn + last_turn * (releases[i] * release_rate)) * rate;
        /* along the road the inner side of a curve is the shorter one */
        const float step = speed * span, inner = 1.0f - beside * curve;
        float way = step / (inner > 0.3f ? inner : 0.3f);
        turn = 0.5f * (turn - way * curve);
        angle += turn;
        float sine, cosine;
        sine_and_cosine(angle, &sine, &cosine);
        way = way * cosine;
        const float there = (is_first ? 0.0f : along_before[i]) + way;
        along[i] = there;
        across[i] = beside + step * sine;
        angles[i] = angle + turn;
        float next = there * per_mark; /* which may be too large for a whole number, or NaN */
        next = next > 0 ? next : 0;
        places[i] = (npy_int32)(next < last_mark ? next : last_mark);
    }
}

/* The road where all plans are; apart, because compilers do not look numbers up side by side. */
static void look_up(const Forecast *f, const float *road, float *rooms)
{
    for (npy_intp i = 0; i < f->plans; i++) {
        const float *mark = road + f->places[i];
        f->bends[i] = mark[0], rooms[i] = mark[f->marks], f->curves[i] = mark[2 * f->marks];
    }
}

/* All moments of all plans. */
FOR_ALL_PROCESSORS
static void drive(const Forecast *f, const PlanKart *kart, const float *road)
{
    look_up(f, road, f->first_rooms);
    for (npy_intp moment = 0; moment < f->moments; moment++) {
        if (moment) drive_moment(f, kart, moment, 0);
        else drive_moment(f, kart, moment, 1);
        look_up(f, road, f->ahead + moment * f->plans);
    }
}

/* What plans cost beyond the edge of the road [m]. */
FOR_ALL_PROCESSORS
static void weigh_danger(const Forecast *f, const PlanKart *kart)
{
    const npy_intp plans = f->plans, last = (f->moments - 1) * plans;
    const double *rules = f->rules;
    const float late_way = kart->speed * (float)rules[LATE_TIME];
    for (npy_intp i = 0; i < plans; i++) f->danger[i] = 0;
    for (npy_intp moment = 0; moment < f->moments; moment++) {
        const float *across = f->across + moment * plans, *ahead = f->ahead + moment * plans;
        for (npy_intp i = 0; i < plans; i++) {
            const float over = fabsf(across[i]) - ahead[i];
            f->danger[i] = fmaf(f->table->spans.data[moment], over > 0 ? over : 0, f->danger[i]);
        }
    }
    for (npy_intp i = 0; i < plans; i++) {
        const float out = f->across[last + i] + f->angle[i] * late_way;
        const float late = fabsf(out) - f->ahead[last + i];
        f->danger[i] = f->danger[i] * (float)rules[OVER_COST] +
                       (float)rules[LATE_COST] * (late > 0 ? late : 0);
    }
}

/* What plans earn by drifting [m]: less while such a boost still lasts. */
static float boost_of(const Forecast *f, const PlanKart *kart, npy_intp i)
{
    const npy_intp boost = f->table->boosts.data[f->row + i];
    if (boost < 0) return 0;
    const double *rules = f->rules;
    const int is_big = boost == 1;
    const float lasts = (float)rules[is_big ? BIG_BOOST_LASTS : SMALL_BOOST_LASTS];
    const float wait = f->table->boost_steps.data[f->row + i];
    const float fresh = 1.0f - ((is_big ? kart->big_boost_steps : kart->boost_steps) - wait) / lasts;
    const float worth = (fresh < 1.0f ? fresh : 1.0f) *
                            (float)rules[is_big ? BIG_BOOST_WORTH : BOOST_WORTH] -
                        (float)rules[BOOST_WAIT_COST] * wait;
    return worth > 0 ? worth : 0;
}

static double share_of(double x)
{
    return x < 0 ? 0 : x > 1 ? 1 : x;
}

/* What plans earn by an item on their way, added to their gain [m]. */
static void add_item(const Forecast *f, const RoadItem *item)
{
    const npy_intp plans = f->plans;
    for (npy_intp i = 0; i < plans; i++) {
        npy_intp moment = 0;
        if (!(f->along[(f->moments - 1) * plans + i] >= item->along)) continue;
        while (!(f->along[moment * plans + i] >= item->along)) moment++;
        const npy_intp before = (moment ? moment - 1 : 0) * plans + i, after = moment * plans + i;
        const float way = f->along[after] - f->along[before];
        const float start = f->across[before], end = f->across[after];
        const double share =
            share_of((item->along - f->along[before]) / (way > 1e-3f ? way : 1e-3f));
        const double miss = fabs(start + (end - start) * share - item->across);
        const double hit = share_of((item->radius - miss) / f->rules[BLUR] + 1.0);
        f->gain[i] = (float)(f->gain[i] + item->worth * hit);
    }
}

/* What plans cost by running into a slower kart ahead, added to their gain as a loss [m]. */
static void add_rival(const Forecast *f, const PlanKart *kart, const RoadRival *rival)
{
    const double *rules = f->rules;
    const float *ends = f->ends;
    const float closing = -(float)rival->gain, length = (float)rules[LENGTH];
    const npy_intp last = f->moments - 1;
    if (!rival->is_there || !(rival->along > rules[BESIDE]) || !(closing > (float)rules[HARMLESS]) ||
        !(rival->along < (double)(closing * ends[last] + length))) {
        return;
    }
    const float pace = kart->speed - closing, drift = (float)rival->drift;
    for (npy_intp i = 0; i < f->plans; i++) {
        for (npy_intp moment = 0; moment <= last; moment++) {
            const npy_intp at = moment * f->plans + i;
            if (!(rival->along + pace * ends[moment] - f->along[at] < rules[LENGTH])) continue;
            const float crossing = (float)rules[CROSSING];
            const float time = ends[moment] < crossing ? ends[moment] : crossing;
            const float gap = fabsf(f->across[at] - ((float)rival->across + drift * time));
            const float hit = ((float)rules[BUMP_WIDTH] - gap) / (float)rules[BLUR];
            f->gain[i] += (float)rules[BUMP_COST] * closing * (hit < 0 ? 0 : hit > 1 ? 1 : hit);
            break;
        }
    }
}

/* How far across the road the next good items are; plans for items are to drive there. */
static void set_item_lanes(const Forecast *f, const RoadItem *items, npy_intp num_items)
{
    const npy_intp *item = f->table->items.data + f->row;
    float lanes[ITEM_LANES] = {0};
    int count = 0;
    for (npy_intp i = 0; i < num_items && count < ITEM_LANES; i++) {
        if (items[i].worth > 0) lanes[count++] = (float)items[i].across;
    }
    for (npy_intp i = 0; i < f->plans; i++) {
        f->extra[i] = item[i] < 0 || item[i] >= ITEM_LANES ? 0 : lanes[item[i]];
    }
}

static void find_best(const Forecast *f, const PlanKart *kart, npy_intp num_karts, float *out)
{
    const npy_intp *manoeuvres = f->table->manoeuvres.data + f->row;
    const npy_bool *needs_drift = f->table->needs_drift.data + f->row;
    float *worth = out, *turn = worth + MANOEUVRES * num_karts;
    float *danger = turn + MANOEUVRES * num_karts;
    for (int m = 0; m < MANOEUVRES; m++) {
        npy_intp best = -1;
        for (npy_intp i = 0; i < f->plans; i++) {
            if (manoeuvres[i] != m || (needs_drift[i] && !kart->may_drift) ||
                (m == BRAKE && !kart->may_brake)) {
                continue;
            }
            if (best < 0 || f->worth[i] > f->worth[best]) best = i;
        }
        worth[m] = best < 0 ? NEVER : f->worth[best];
        turn[m] = best < 0 ? 0 : f->turns[best];
        danger[m] = best < 0 ? 0 : f->danger[best];
    }
}

/* Drives and weighs the plans of one kart. */
static void weigh(const Forecast *f, const PlanKart *kart, const float *road,
                  const RoadItem *items, npy_intp num_items, const RoadRival *rivals,
                  npy_intp num_rivals)
{
    const npy_intp plans = f->plans;
    set_item_lanes(f, items, num_items);
    for (npy_intp i = 0; i < plans; i++) {
        f->angle[i] = kart->angle;
        f->last_turn[i] = kart->drift_turn;
        f->places[i] = 0;
    }
    drive(f, kart, road);
    weigh_danger(f, kart);
    const float *along = f->along + (f->moments - 1) * plans;
    const float angle_cost = (float)f->rules[ANGLE_COST];
    for (npy_intp i = 0; i < plans; i++) {
        f->worth[i] = along[i] - f->danger[i] - angle_cost * f->angle[i] * f->angle[i] +
                      boost_of(f, kart, i);
        f->gain[i] = 0;
    }
    for (npy_intp i = 0; i < num_items; i++) {
        if (items[i].worth != 0) add_item(f, items + i);
    }
    for (npy_intp i = 0; i < plans; i++) {
        f->worth[i] += f->gain[i];
        f->gain[i] = 0;
    }
    if (f->rules[BUMP_COST] == 0) return;
    for (npy_intp i = 0; i < num_rivals; i++) add_rival(f, kart, rivals + i);
    for (npy_intp i = 0; i < plans; i++) f->worth[i] -= f->gain[i];
}

/* ---------------------------------------------------------------- the arguments */

static int read_table(PyObject *tuple, Table *t, Forecast *f)
{
    if (!PyArg_ParseTuple(tuple, "O&O&O&O&O&O&O&O&O&O&O&O&", as_floats, &t->spans, as_floats,
                          &t->least, as_floats, &t->most, as_floats, &t->drifts, as_floats,
                          &t->releases, as_floats, &t->slower, as_floats, &t->lanes, as_indices,
                          &t->items, as_indices, &t->manoeuvres, as_indices, &t->boosts,
                          as_floats, &t->boost_steps, as_flags, &t->needs_drift)) {
        return -1;
    }
    PyArrayObject *items = (PyArrayObject *)PyTuple_GET_ITEM(tuple, 7);
    if (PyArray_NDIM(items) != 2) return refuse("items must be states by plans");
    f->table = t;
    f->states = PyArray_DIM(items, 0), f->plans = PyArray_DIM(items, 1);
    f->moments = t->spans.size;
    const npy_intp one = t->items.size, all = one * f->moments;
    const int fits = f->moments > 0 && t->least.size == all && t->most.size == all &&
                     t->drifts.size == all && t->releases.size == all && t->slower.size == all &&
                     t->lanes.size == all && t->manoeuvres.size == one && t->boosts.size == one &&
                     t->boost_steps.size == one && t->needs_drift.size == one;
    return fits ? 0 : refuse("the arrays of the table do not fit together");
}

/* Room for a forecast, all of it in one block; NULL with an exception set if there is none. */
static void *make_room(Forecast *f)
{
    const size_t plans = (size_t)f->plans, all = plans * (size_t)f->moments;
    float *block = PyMem_Malloc((3 * all + 11 * plans + (size_t)f->moments) * sizeof(float));
    if (!block) return PyErr_NoMemory();
    f->along = block, f->across = f->along + all, f->ahead = f->across + all;
    float **columns[] = {&f->angle,  &f->last_turn, &f->turns, &f->extra,  &f->danger,
                         &f->worth,  &f->gain,      &f->bends, &f->curves, &f->first_rooms};
    float *next = f->ahead + all;
    for (size_t i = 0; i < sizeof columns / sizeof *columns; i++, next += plans) *columns[i] = next;
    f->places = (npy_int32 *)next, f->ends = next + plans;
    const float *spans = f->table->spans.data;
    for (npy_intp i = 0; i < f->moments; i++) f->ends[i] = spans[i] + (i ? f->ends[i - 1] : 0);
    return block;
}

/* weigh_plans(table, rules, rows, karts, road, items, rivals, out) */
PyObject *weigh_plans(PyObject *Py_UNUSED(module), PyObject *args)
{
    PyObject *tuple;
    Table table;
    Forecast forecast;
    Doubles rules, item_numbers, rival_numbers;
    Indices rows;
    Floats kart_numbers, road, out;
    if (!PyArg_ParseTuple(args, "O!O&O&O&O&O&O&O&", &PyTuple_Type, &tuple, as_doubles, &rules,
                          as_indices, &rows, as_floats, &kart_numbers, as_floats, &road,
                          as_doubles, &item_numbers, as_doubles, &rival_numbers,
                          as_written_floats, &out) ||
        read_table(tuple, &table, &forecast) < 0) {
        return NULL;
    }
    const npy_intp count = rows.size;
    if (!count) Py_RETURN_NONE;
    const npy_intp num_items = item_numbers.size / (4 * count);
    const npy_intp num_rivals = rival_numbers.size / (5 * count);
    forecast.marks = road.size / (3 * count);
    if (rules.size != NUM_RULES || kart_numbers.size != 11 * count ||
        road.size != 3 * count * forecast.marks || forecast.marks < 1 ||
        item_numbers.size != 4 * count * num_items ||
        rival_numbers.size != 5 * count * num_rivals || out.size != 3 * MANOEUVRES * count) {
        return PyErr_Format(PyExc_ValueError, "the arrays of %zd karts do not fit together", count);
    }
    if (!are_below(rows, forecast.states)) {
        return PyErr_Format(PyExc_IndexError, "there is no state of that number");
    }
    const PlanKart *karts = (const PlanKart *)kart_numbers.data;
    const RoadItem *items = (const RoadItem *)item_numbers.data;
    const RoadRival *rivals = (const RoadRival *)rival_numbers.data;
    forecast.rules = rules.data;
    void *block = make_room(&forecast);
    if (!block) return NULL;
    for (npy_intp i = 0; i < count; i++) {
        forecast.row = rows.data[i] * forecast.plans;
        weigh(&forecast, karts + i, road.data + 3 * forecast.marks * i, items + num_items * i,
              num_items, rivals + num_rivals * i, num_rivals);
        find_best(&forecast, karts + i, count, out.data + MANOEUVRES * i);
    }
    PyMem_Free(block);
    Py_RETURN_NONE;
}
