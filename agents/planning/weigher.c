/* Simulates the plans of karts on the road ahead with a model of a kart, and weighs them.

   There are two models: arcs at constant speed, and a small network that has learned how karts
   move. The NumPy version in tests/oracle/plan_weigher.py matches bit for bit where NumPy uses fused
   multiply-adds. The network's results do not depend on the processor. */

#include "planning.h"
#include "vectors.h"

/* Before a loop: asserts that no iteration reads what an earlier one wrote, so that the compiler
   can vectorize the loop. */
#if defined(__clang__)
#define NO_OVERLAP _Pragma("clang loop vectorize(assume_safety)")
#else
#define NO_OVERLAP _Pragma("GCC ivdep")
#endif

enum { ITEM_LANES = 2 };
static const float NEVER = -1e4f;
/* Largest turn per step [rad] and lowest speed [m/s] of plans simulated by the network. */
static const float MOST_YAW = 0.4f, LEAST_SPEED = 2.0f;
/* Longest time that plans can last [s], which bounds the number of steps. */
static const float MOST_TIME = 100.0f;

/* The plans of all states, in the order of stkzoo.agents.planning.plans.PlanTable. */
typedef struct {
    Floats spans;                                         /* (T,) */
    Floats least, most, drifts, releases, slower, lanes; /* (S, T, C) */
    Indices items, maneuvers, boosts;                    /* (S, C) */
    Floats boost_steps;
    Flags needs_drift;
} Table;

/* Turning rate after a drift [rad/s per fraction of full lock], as in
   stkzoo.agents.planning.motion, and lag of the wheels behind the steering [fraction of a step]. */
#define RELEASE_TURN (1.25 / 0.7)
#define STEERING_LAG 0.33
#define BLUR 0.5     /* a miss by this much more than the radius earns nothing [m] */
#define LENGTH 1.8   /* distance between the centers of colliding karts [m] */
#define BESIDE 0.5   /* a rival less far ahead is beside the kart [m] */
#define HARMLESS 1.0 /* a lower approach speed is harmless [m/s] */
#define CROSSING 0.5 /* rivals are assumed to keep their speed across the road for this time [s] */

/* Rectified linear units, which let NaN pass. They use a mask, because in C compilers reject ?: for
   vectors. */
typedef npy_int32 Masks __attribute__((vector_size(32), aligned(4), may_alias));
#define RECTIFIED(X) (Lanes)(~((X) <= 0) & (Masks)(X))

/* Number of units whose sums are kept in registers, number of vectors per unit, and number of plans
   in these vectors. */
enum { UNITS = 4, VECTORS = 2, BLOCK = VECTORS * sizeof(Lanes) / sizeof(float) };

/* Inputs and outputs of the network, for a plan at a step. */
enum {
    SEEN_SPEED, SEEN_SLIDE, SEEN_YAW, SEEN_TURN, SEEN_TURN_BEFORE, SEEN_SIDE, SEEN_DRIFT_STEPS,
    SEEN_RELEASE, SEEN_DRIFT_TURN, SEEN_BOOST, SEEN_BIG_BOOST, SEEN_BRAKE, SEEN_DRIFT_BEGIN,
    SEEN_EARNED, SEEN_INWARDS, SEEN_RELEASED_TURN, NUM_SEEN
};
enum { NEXT_YAW, MORE_SPEED, MORE_SLIDE, NUM_NEXT };
enum { LAYERS = 3, MOST_UNITS = 64 };

/* The network: (outputs, inputs) and (outputs,) of each layer. Without layers, karts drive arcs. */
typedef struct {
    Floats matrices[LAYERS], biases[LAYERS];
    npy_intp units[LAYERS + 1];
} Network;

/* The simulated plans of one kart: (T, C) for stages by plans, (C,) for plans. */
struct Forecast {
    const Rules *rules;
    Table table;
    Network network;
    npy_intp stages, plans;
    npy_intp row; /* index of the first plan of the kart's state in arrays (S, C) */
    float *along, *across;                    /* (T, C) */
    float *angle, *last_turn, *turns, *extra; /* (C,) */
    float *danger, *worth, *gain;             /* (C,) */
    float *bends, *curves;                    /* (C,) of the road at the plans' marks */
    float *lefts_now, *rights_now;            /* (C,) room at these marks */
    npy_int32 *places;                        /* (C,) marks */
    float *ends;                              /* (T,) of the stages [s] */
    npy_intp driven; /* number of simulated plans, counted from the first */
    npy_intp stride; /* number of plans, rounded up to whole blocks */
    float *along_now, *across_now; /* (C,) */
    /* (C,) states of the plans, if the network simulates them */
    float *speed, *slide, *yaw, *side, *steps, *release, *boost, *big_boost, *turn;
    float *seen, *hidden[2], *next; /* (units, C) */
};

/* Returns the mark at a distance. Clamps before the cast, because casting NaN or a number out of
   range is undefined. */
FORCE_INLINE npy_int32 mark_at(float along)
{
    const float last = (float)(MARKS - 1);
    float mark = along * (float)(1.0 / MARK_SPACING);
    mark = mark > 0 ? mark : 0;
    return (npy_int32)(mark < last ? mark : last);
}

/* Simulates one stage of all plans, from the end of the previous stage. */
FORCE_INLINE void drive_stage(const Forecast *f, const Situation *kart, npy_intp stage,
                               const int is_first)
{
    const Table *t = &f->table;
    const npy_intp plans = f->plans, in_table = f->row * f->stages + stage * plans;
    const float span = t->spans.data[stage], lock = kart->lock, reach = kart->reach;
    const float pull = 2.0f / (reach * reach * lock), rate = lock * span;
    const float release_rate = (float)RELEASE_TURN / lock;
    const float lag = (float)STEERING_LAG, own_turn = kart->turn, own_speed = kart->speed;
    const float *least = t->least.data + in_table, *most = t->most.data + in_table;
    const float *drifts = t->drifts.data + in_table;
    const float *releases = t->releases.data + in_table;
    const float *slower = t->slower.data + in_table;
    const float *lanes = t->lanes.data + in_table, *extra = f->extra;
    float *along = f->along_now, *across = f->across_now;
    float *angles = f->angle, *last_turns = f->last_turn;
    float *turns = f->turns;
    const float *bends = f->bends, *curves = f->curves;
    npy_int32 *places = f->places;
    const float *lefts = f->lefts_now, *rights = f->rights_now;
    NO_OVERLAP
    for (npy_intp i = 0; i < plans; i++) {
        const float curve = curves[i], beside = across[i];
        const float wanted_speed = own_speed + slower[i];
        const float speed = wanted_speed > 4.0f ? wanted_speed : 4.0f;
        float angle = angles[i];
        const float room = lanes[i] > 0 ? rights[i] : lefts[i];
        float turn = (lanes[i] * room + extra[i] - beside + bends[i] - angle * reach) *
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
        /* the inner side of a curve is shorter than the middle of the road */
        const float step = speed * span, inner = 1.0f - beside * curve;
        float way = step / (inner > 0.3f ? inner : 0.3f);
        turn = 0.5f * (turn - way * curve);
        angle += turn;
        float sine, cosine;
        sine_and_cosine(angle, &sine, &cosine);
        way = way * cosine;
        const float there = along[i] + way;
        along[i] = there;
        across[i] = beside + step * sine;
        angles[i] = angle + turn;
        places[i] = mark_at(there);
    }
}

/* Looks up the road at the marks of all plans. This is a separate loop, because compilers do not
   vectorize table lookups. */
static void look_up(const Forecast *f, const Situation *kart)
{
    for (npy_intp i = 0; i < f->driven; i++) {
        const npy_int32 mark = f->places[i];
        f->bends[i] = kart->bends[mark], f->curves[i] = kart->curves[mark];
        f->lefts_now[i] = kart->lefts[mark], f->rights_now[i] = kart->rights[mark];
    }
}

/* ---------------------------------------------------------------- simulation by the network */

/* Computes some units of a layer for a block of plans. Adds the inputs of each unit in order. */
FORCE_INLINE void sum_units(const float *matrix, const float *bias, npy_intp inputs,
                            const float *in, npy_intp stride, int is_last, float *out,
                            const int units)
{
    Lanes sums[UNITS][VECTORS];
    for (int u = 0; u < units; u++) {
        for (int v = 0; v < VECTORS; v++) sums[u][v] = (Lanes){0} + bias[u];
    }
    for (npy_intp i = 0; i < inputs; i++) {
        const Lanes *column = (const Lanes *)(in + i * stride);
        for (int u = 0; u < units; u++) {
            for (int v = 0; v < VECTORS; v++) sums[u][v] += matrix[u * inputs + i] * column[v];
        }
    }
    for (int u = 0; u < units; u++) {
        Lanes *own = (Lanes *)(out + u * stride);
        for (int v = 0; v < VECTORS; v++) own[v] = is_last ? sums[u][v] : RECTIFIED(sums[u][v]);
    }
}

/* Computes the outputs of the network for all simulated plans. */
FORCE_INLINE void infer(const Forecast *f)
{
    const Network *network = &f->network;
    const float *ins[LAYERS] = {f->seen, f->hidden[0], f->hidden[1]};
    float *outs[LAYERS] = {f->hidden[0], f->hidden[1], f->next};
    for (npy_intp block = 0; block < f->driven; block += BLOCK) {
        for (int n = 0; n < LAYERS; n++) {
            const npy_intp inputs = network->units[n], outputs = network->units[n + 1];
            const float *matrix = network->matrices[n].data, *bias = network->biases[n].data;
            const float *in = ins[n] + block;
            npy_intp unit = 0;
            for (; unit + UNITS <= outputs; unit += UNITS) {
                sum_units(matrix + unit * inputs, bias + unit, inputs, in, f->stride,
                          n + 1 == LAYERS, outs[n] + unit * f->stride + block, UNITS);
            }
            for (; unit < outputs; unit++) {
                sum_units(matrix + unit * inputs, bias + unit, inputs, in, f->stride,
                          n + 1 == LAYERS, outs[n] + unit * f->stride + block, 1);
            }
        }
    }
}

/* Updates what the driver would remember of each plan, then writes the network's inputs. */
FORCE_INLINE void look_at_step(const Forecast *f, const Situation *kart, npy_intp stage,
                               npy_intp step)
{
    const Table *t = &f->table;
    const npy_intp in_table = f->row * f->stages + stage * f->plans, stride = f->stride;
    const float *least = t->least.data + in_table, *most = t->most.data + in_table;
    const float *drifts = t->drifts.data + in_table, *lanes = t->lanes.data + in_table;
    const npy_intp *maneuvers = t->maneuvers.data + f->row;
    const float pull = 2.0f / (kart->reach * kart->reach * kart->lock), reach = kart->reach;
    const float small = SMALL_DRIFT, big = BIG_DRIFT;
    const float small_lasts = SMALL_LASTS, big_lasts = BIG_LASTS, most_release = RELEASE_STEPS;
    const float aged = step ? 1.0f : 0, braking = step < BRAKE_STEPS ? 1.0f : 0;
    const float *across = f->across_now, *angles = f->angle, *extra = f->extra;
    const float *bends = f->bends, *speeds = f->speed;
    const float *lefts = f->lefts_now, *rights = f->rights_now;
    float *last_turns = f->last_turn, *sides = f->side, *all_steps = f->steps;
    float *releases = f->release, *boosts = f->boost, *big_boosts = f->big_boost;
    float *turns_before = f->turn, *seen = f->seen, *turns = f->turns;
    const float *slides = f->slide, *yaws = f->yaw;
    const npy_intp driven = f->driven;
    NO_OVERLAP
    for (npy_intp i = 0; i < driven; i++) {
        const float room = lanes[i] > 0 ? rights[i] : lefts[i];
        float turn = (lanes[i] * room + extra[i] - across[i] + bends[i] - angles[i] * reach) *
                     (speeds[i] * pull);
        turn = turn > least[i] ? turn : least[i];
        turn = turn < most[i] ? turn : most[i];
        const float middle = least[i] + most[i], drift = drifts[i] > 0 ? 1.0f : 0;
        const float side = drift * ((middle > 0) - (middle < 0));
        const float side_before = sides[i], lasted = all_steps[i];
        const int ends = (side_before != 0) & (side == 0), earns_big = ends & (lasted >= big);
        const int earns = ends & (lasted >= small) & !earns_big;
        const float new_release = lasted < most_release ? lasted : most_release;
        float release = releases[i] - aged, boost = boosts[i] - aged, big_boost = big_boosts[i] - aged;
        release = release > 0 ? release : 0;
        boost = boost > 0 ? boost : 0;
        big_boost = big_boost > 0 ? big_boost : 0;
        release = ends ? new_release : release;
        boost = earns ? small_lasts : boost;
        big_boost = earns_big ? big_lasts : big_boost;
        const float steps = drift * ((side_before != 0 ? lasted : 0) + 1.0f);
        const float turn_before = last_turns[i], last_turn = side != 0 ? turn : turn_before;
        const float first_turn = step ? turns[i] : turn;
        const float brake = maneuvers[i] == BRAKE ? braking : 0;
        sides[i] = side, all_steps[i] = steps, releases[i] = release;
        boosts[i] = boost, big_boosts[i] = big_boost, last_turns[i] = last_turn;
        turns[i] = first_turn;
        seen[SEEN_SPEED * stride + i] = speeds[i];
        seen[SEEN_SLIDE * stride + i] = slides[i];
        seen[SEEN_YAW * stride + i] = yaws[i];
        seen[SEEN_TURN * stride + i] = turn;
        seen[SEEN_TURN_BEFORE * stride + i] = turns_before[i];
        seen[SEEN_SIDE * stride + i] = side;
        seen[SEEN_DRIFT_STEPS * stride + i] = steps < big ? steps : big;
        seen[SEEN_RELEASE * stride + i] = release;
        seen[SEEN_DRIFT_TURN * stride + i] = last_turn;
        seen[SEEN_BOOST * stride + i] = boost;
        seen[SEEN_BIG_BOOST * stride + i] = big_boost;
        seen[SEEN_BRAKE * stride + i] = brake;
        seen[SEEN_DRIFT_BEGIN * stride + i] = side / (1.0f + steps);
        seen[SEEN_EARNED * stride + i] = steps >= small ? 1.0f : 0;
        seen[SEEN_INWARDS * stride + i] = turn * side;
        seen[SEEN_RELEASED_TURN * stride + i] = release > 0 ? turn : 0;
        turns_before[i] = turn;
    }
}

/* Advances all plans by one step with the network's outputs. NaN in them passes. */
FORCE_INLINE void move_plans(const Forecast *f)
{
    const float half = (float)(0.5 * STEP), most_yaw = MOST_YAW, least_speed = LEAST_SPEED;
    const float *next_yaws = f->next + NEXT_YAW * f->stride;
    const float *more_speeds = f->next + MORE_SPEED * f->stride;
    const float *more_slides = f->next + MORE_SLIDE * f->stride, *curves = f->curves;
    float *speeds = f->speed, *slides = f->slide, *yaws = f->yaw, *angles = f->angle;
    float *along = f->along_now, *across = f->across_now;
    npy_int32 *places = f->places;
    const npy_intp driven = f->driven;
    NO_OVERLAP
    for (npy_intp i = 0; i < driven; i++) {
        const float speed_before = speeds[i], slide_before = slides[i], angle = angles[i];
        const float curve = curves[i], beside = across[i], next_yaw = next_yaws[i];
        float yaw = next_yaw > most_yaw ? most_yaw : next_yaw;
        yaw = yaw < -most_yaw ? -most_yaw : yaw;
        const float next_speed = speed_before + more_speeds[i];
        const float speed = next_speed < least_speed ? least_speed : next_speed;
        const float slide = slide_before + more_slides[i];
        const float ahead = half * (speed_before + speed), aside = half * (slide_before + slide);
        float sine, cosine;
        sine_and_cosine(angle + 0.5f * yaw, &sine, &cosine);
        /* the inner side of a curve is shorter than the middle of the road */
        const float inner = 1.0f - beside * curve;
        const float way = (ahead * cosine - aside * sine) / (inner > 0.3f ? inner : 0.3f);
        const float there = along[i] + way;
        along[i] = there;
        across[i] = beside + (ahead * sine + aside * cosine);
        angles[i] = angle + (yaw - way * curve);
        speeds[i] = speed, slides[i] = slide, yaws[i] = yaw;
        places[i] = mark_at(there);
    }
}

/* Returns the distance beyond the nearer edge of the road [m], 0 on the road. */
FORCE_INLINE float beyond_edge(float across, float left, float right)
{
    const float beyond_left = -across - left, beyond_right = across - right;
    const float beyond = beyond_right > beyond_left ? beyond_right : beyond_left;
    return beyond < 0 ? 0 : beyond;
}

/* Adds the cost of a stage beyond the edge of the road to each plan [m s]. */
FORCE_INLINE void add_danger(const Forecast *f, float span)
{
    for (npy_intp i = 0; i < f->driven; i++) {
        const float over = beyond_edge(f->across_now[i], f->lefts_now[i], f->rights_now[i]);
        f->danger[i] = fmaf(span, over, f->danger[i]);
    }
}

/* Converts the danger to meters, and adds the cost of what follows the last stage. */
FORCE_INLINE void add_late_danger(const Forecast *f, const Situation *kart)
{
    const float late_way = kart->speed * (float)f->rules->late_time;
    for (npy_intp i = 0; i < f->driven; i++) {
        const float out = f->across_now[i] + f->angle[i] * late_way;
        const float late = beyond_edge(out, f->lefts_now[i], f->rights_now[i]);
        f->danger[i] = f->danger[i] * (float)f->rules->over_cost +
                       (float)f->rules->late_cost * late;
    }
}

/* Simulates all stages of all plans, in arcs or step by step with the network, and computes the
   cost of each plan beyond the edge of the road [m]. */
FOR_ALL_PROCESSORS
static void drive(const Forecast *f, const Situation *kart)
{
    const int has_network = f->network.units[0] > 0;
    const size_t size = (size_t)f->driven * sizeof(float);
    for (npy_intp i = 0; i < f->driven; i++) {
        f->along_now[i] = 0, f->across_now[i] = kart->offset, f->angle[i] = kart->angle;
        f->last_turn[i] = kart->drift_turn, f->danger[i] = 0, f->places[i] = 0;
        f->speed[i] = kart->speed, f->slide[i] = kart->slide, f->yaw[i] = kart->yaw;
        f->side[i] = kart->drift_side, f->steps[i] = kart->drift_steps;
        f->release[i] = kart->release_steps, f->turn[i] = kart->turn;
        f->boost[i] = kart->boost_steps, f->big_boost[i] = kart->big_boost_steps;
    }
    look_up(f, kart);
    npy_intp step = 0;
    for (npy_intp stage = 0; stage < f->stages; stage++) {
        const float end = f->ends[stage] - (float)(0.5 * STEP);
        if (!has_network) {
            if (stage) drive_stage(f, kart, stage, 0);
            else drive_stage(f, kart, stage, 1);
            look_up(f, kart);
        }
        for (; has_network && (float)step * (float)STEP < end; step++) {
            look_at_step(f, kart, stage, step);
            infer(f);
            move_plans(f);
            look_up(f, kart);
        }
        memcpy(f->along + stage * f->plans, f->along_now, size);
        memcpy(f->across + stage * f->plans, f->across_now, size);
        add_danger(f, f->table.spans.data[stage]);
    }
    add_late_danger(f, kart);
}

/* Returns the gain of a plan from the boost of its drift [m]. The gain is smaller while an earlier
   boost of the same kind lasts. */
static float boost_of(const Forecast *f, const Situation *kart, npy_intp i)
{
    const npy_intp boost = f->table.boosts.data[f->row + i];
    if (boost < 0) return 0;
    const Rules *rules = f->rules;
    const int is_big = boost == 1;
    const float lasts = is_big ? BIG_LASTS : SMALL_LASTS;
    const float wait = f->table.boost_steps.data[f->row + i];
    const float fresh = 1.0f - ((is_big ? kart->big_boost_steps : kart->boost_steps) - wait) / lasts;
    const float worth = (fresh < 1.0f ? fresh : 1.0f) *
                            (float)(is_big ? rules->big_boost_worth : rules->boost_worth) -
                        (float)(rules->boost_wait_cost * STEP) * wait;
    return worth > 0 ? worth : 0;
}

static double share_of(double x)
{
    return x < 0 ? 0 : x > 1 ? 1 : x;
}

/* Adds the worth of an item to the gain of each plan that hits it [m]. */
static void add_item(const Forecast *f, const RoadItem *item)
{
    const npy_intp plans = f->plans;
    for (npy_intp i = 0; i < plans; i++) {
        npy_intp stage = 0;
        if (!(f->along[(f->stages - 1) * plans + i] >= item->along)) continue;
        while (!(f->along[stage * plans + i] >= item->along)) stage++;
        const npy_intp before = (stage ? stage - 1 : 0) * plans + i, after = stage * plans + i;
        const float way = f->along[after] - f->along[before];
        const float start = f->across[before], end = f->across[after];
        const double share =
            share_of((item->along - f->along[before]) / (way > 1e-3f ? way : 1e-3f));
        const double miss = fabs(start + (end - start) * share - item->across);
        const double hit = share_of((item->radius - miss) / BLUR + 1.0);
        f->gain[i] = (float)(f->gain[i] + item->worth * hit);
    }
}

/* Adds the cost of running into a slower kart ahead to `gain` [m]. The caller subtracts it. */
static void add_rival(const Forecast *f, const Situation *kart, const RoadRival *rival)
{
    const float *ends = f->ends;
    const float closing = -(float)rival->gain;
    const npy_intp last = f->stages - 1;
    if (!rival->is_there || !(rival->along > BESIDE) || !(closing > (float)HARMLESS) ||
        !(rival->along < (double)(closing * ends[last] + (float)LENGTH))) {
        return;
    }
    const float pace = kart->speed - closing, drift = (float)rival->drift;
    for (npy_intp i = 0; i < f->plans; i++) {
        for (npy_intp stage = 0; stage <= last; stage++) {
            const npy_intp at = stage * f->plans + i;
            if (!(rival->along + pace * ends[stage] - f->along[at] < LENGTH)) continue;
            const float time = ends[stage] < (float)CROSSING ? ends[stage] : (float)CROSSING;
            const float gap = fabsf(f->across[at] - ((float)rival->across + drift * time));
            const float hit = ((float)f->rules->bump_width - gap) / (float)BLUR;
            f->gain[i] += (float)f->rules->bump_cost * closing * (hit < 0 ? 0 : hit > 1 ? 1 : hit);
            break;
        }
    }
}

/* Sets the lateral target of plans for items: the offset of the next good items [m]. */
static void set_item_lanes(const Forecast *f, const RoadItem *items)
{
    const npy_intp *item = f->table.items.data + f->row;
    float lanes[ITEM_LANES] = {0};
    int count = 0;
    for (npy_intp i = 0; i < ITEMS && count < ITEM_LANES; i++) {
        if (items[i].worth > 0) lanes[count++] = (float)items[i].across;
    }
    for (npy_intp i = 0; i < f->plans; i++) {
        f->extra[i] = item[i] < 0 || item[i] >= ITEM_LANES ? 0 : lanes[item[i]];
    }
}

/* Returns whether a plan exists and the kart may follow it. */
FORCE_INLINE int has_plan(const Forecast *f, const Situation *kart, npy_intp i)
{
    const npy_intp maneuver = f->table.maneuvers.data[f->row + i];
    return maneuver >= 0 && (kart->may_drift || !f->table.needs_drift.data[f->row + i]) &&
           (kart->may_brake || maneuver != BRAKE);
}

static void find_best(const Forecast *f, const Situation *kart, Best out)
{
    const npy_intp *maneuvers = f->table.maneuvers.data + f->row;
    for (int m = 0; m < MANEUVERS; m++) {
        npy_intp best = -1;
        for (npy_intp i = 0; i < f->plans; i++) {
            if (maneuvers[i] != m || !has_plan(f, kart, i)) continue;
            if (best < 0 || f->worth[i] > f->worth[best]) best = i;
        }
        out[WORTH][m] = best < 0 ? NEVER : f->worth[best];
        out[BEST_TURN][m] = best < 0 ? 0 : f->turns[best];
        out[BEST_DANGER][m] = best < 0 ? 0 : f->danger[best];
    }
}

/* Returns the number of plans up to the last one that the kart may follow. */
static npy_intp plans_of(const Forecast *f, const Situation *kart)
{
    npy_intp plans = f->plans;
    while (plans && !has_plan(f, kart, plans - 1)) plans--;
    return plans;
}

void weigh(Forecast *f, const Situation *kart, Best best)
{
    const npy_intp plans = f->plans;
    f->row = kart->state * plans;
    f->driven = f->network.units[0] > 0 ? plans_of(f, kart) : plans;
    set_item_lanes(f, kart->items);
    drive(f, kart);
    const float *along = f->along + (f->stages - 1) * plans;
    const float angle_cost = (float)f->rules->angle_cost;
    for (npy_intp i = 0; i < plans; i++) {
        f->worth[i] = along[i] - f->danger[i] - angle_cost * f->angle[i] * f->angle[i] +
                      boost_of(f, kart, i);
        f->gain[i] = 0;
    }
    for (npy_intp i = 0; i < ITEMS; i++) {
        if (kart->items[i].worth != 0) add_item(f, kart->items + i);
    }
    for (npy_intp i = 0; i < plans; i++) {
        f->worth[i] += f->gain[i];
        f->gain[i] = 0;
    }
    if (f->rules->bump_cost != 0) {
        for (npy_intp i = 0; i < RIVALS; i++) add_rival(f, kart, kart->rivals + i);
        for (npy_intp i = 0; i < plans; i++) f->worth[i] -= f->gain[i];
    }
    find_best(f, kart, best);
}

/* ---------------------------------------------------------------- the arguments */

static int read_table(PyObject *tuple, Forecast *f)
{
    Table *t = &f->table;
    if (!PyArg_ParseTuple(tuple, "O&O&O&O&O&O&O&O&O&O&O&O&", as_floats, &t->spans, as_floats,
                          &t->least, as_floats, &t->most, as_floats, &t->drifts, as_floats,
                          &t->releases, as_floats, &t->slower, as_floats, &t->lanes, as_indices,
                          &t->items, as_indices, &t->maneuvers, as_indices, &t->boosts,
                          as_floats, &t->boost_steps, as_flags, &t->needs_drift)) {
        return -1;
    }
    f->plans = t->items.size / NUM_STATES, f->stages = t->spans.size;
    const npy_intp one = NUM_STATES * f->plans, all = one * f->stages;
    const npy_intp sizes[][2] = {
        {t->items.size, one}, {t->least.size, all}, {t->most.size, all}, {t->drifts.size, all},
        {t->releases.size, all}, {t->slower.size, all}, {t->lanes.size, all},
        {t->maneuvers.size, one}, {t->boosts.size, one}, {t->boost_steps.size, one},
        {t->needs_drift.size, one},
    };
    if (ARE_SIZES(sizes) < 0 || !f->stages) return refuse("there are no stages");
    float end = 0;
    for (npy_intp i = 0; i < f->stages; i++) {
        const float span = t->spans.data[i];
        end += span;
        if (!(span >= 0 && end <= MOST_TIME)) {
            return refuse("the spans of the table must be at least 0 s and at most 100 s in total");
        }
    }
    return 0;
}

/* Reads the layers of the network. An empty tuple means that there is no network. */
static int read_network(PyObject *tuple, Network *network)
{
    *network = (Network){.units = {0}};
    if (!PyTuple_GET_SIZE(tuple)) return 0;
    Floats *matrices = network->matrices, *biases = network->biases;
    if (!PyArg_ParseTuple(tuple, "O&O&O&O&O&O&", as_floats, &matrices[0], as_floats, &biases[0],
                          as_floats, &matrices[1], as_floats, &biases[1], as_floats, &matrices[2],
                          as_floats, &biases[2])) {
        return -1;
    }
    network->units[0] = NUM_SEEN;
    for (int n = 0; n < LAYERS; n++) {
        const npy_intp units = network->units[n + 1] = biases[n].size;
        if (units < 1 || units > MOST_UNITS || matrices[n].size != units * network->units[n]) {
            return refuse("the layers of the network do not fit together");
        }
    }
    return network->units[LAYERS] == NUM_NEXT ? 0 : refuse("the network has the wrong outputs");
}

/* Allocates a forecast and its arrays in one block. The arrays are zeroed, because plans that are
   not simulated are weighed too, though never chosen. */
Forecast *new_forecast(const Rules *rules, PyObject *table, PyObject *motion)
{
    Forecast read = {.rules = rules}, *f = &read;
    if (read_table(table, f) < 0 || read_network(motion, &f->network) < 0) return NULL;
    const npy_intp *units = f->network.units;
    const size_t plans = (size_t)((f->plans + BLOCK - 1) / BLOCK * BLOCK);
    const size_t all = (size_t)f->plans * (size_t)f->stages;
    const size_t num_units = (size_t)(units[0] + units[1] + units[2] + units[3]);
    float **columns[] = {
        &f->angle, &f->last_turn, &f->turns, &f->extra, &f->danger, &f->worth, &f->gain,
        &f->bends, &f->curves, &f->lefts_now, &f->rights_now, &f->along_now, &f->across_now,
        &f->speed, &f->slide, &f->yaw, &f->side, &f->steps, &f->release, &f->boost,
        &f->big_boost, &f->turn,
    };
    const size_t num_columns = sizeof columns / sizeof *columns;
    const size_t floats = 2 * all + (num_columns + 1 + num_units) * plans + (size_t)f->stages;
    Forecast *block = PyMem_Calloc(1, sizeof *block + floats * sizeof(float));
    if (!block) {
        PyErr_NoMemory();
        return NULL;
    }
    f->stride = (npy_intp)plans;
    f->along = (float *)(block + 1), f->across = f->along + all;
    float *next = f->across + all;
    for (size_t i = 0; i < num_columns; i++, next += plans) *columns[i] = next;
    float **layers[] = {&f->seen, &f->hidden[0], &f->hidden[1], &f->next};
    for (int n = 0; n <= LAYERS; n++) *layers[n] = next, next += (size_t)units[n] * plans;
    f->places = (npy_int32 *)next, f->ends = next + plans;
    const float *spans = f->table.spans.data;
    for (npy_intp i = 0; i < f->stages; i++) f->ends[i] = spans[i] + (i ? f->ends[i - 1] : 0);
    *block = *f;
    return block;
}
