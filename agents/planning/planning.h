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

/* stkzoo.agents.planning.parameters.DriverParameters */
typedef struct {
    double wheel_base, aim_distance, aim_time, margin, lane_changes, greatest_room, over_cost;
    double late_time, late_cost, angle_cost, drift_speed, brake_speed, boost_worth;
    double big_boost_worth, boost_wait_cost, box_worth, second_box_worth, small_nitro_worth;
    double big_nitro_worth, banana_cost, gum_cost, item_radius, bad_item_radius, nitro_wait;
    double nitro_speed, nitro_turn, danger, straight_angle, straight_time, straight_aim;
    double switch_reach, fire_every, crash_drop, caution_time, caution_room, stuck_speed;
    double stuck_time, crawl_speed, crawl_time, reverse_time, rescue_reverses, rescued_reverses;
    double free_time, lost_room, lost_time, bump_cost, bump_width, turn_hold, learned_motion;
    double racing_line;
} Rules;

/* Numbers of marks along the road, and of the nearest karts and items that plans consider. */
enum { MARKS = 36, RIVALS = 4, ITEMS = 8 };

/* Constants of stkzoo.agents.planning.motion: the length of a step [s], and numbers of steps. */
#define STEP 0.1
enum {
    SMALL_DRIFT = 11, BIG_DRIFT = 31, SMALL_LASTS = 35, BIG_LASTS = 45, RELEASE_STEPS = 7,
    BRAKE_STEPS = 3
};

enum { MANEUVERS = 4, BRAKE = 1 };
#define MARK_SPACING 3.0 /* [m] */

/* Number of states in the table of plans: without a drift, by the remaining time of the last one;
   in a drift to the left or to the right, by its duration. */
enum { NUM_STATES = RELEASE_STEPS + 1 + 2 * (BIG_DRIFT + 1) };

typedef struct {
    double along, across, worth, radius;
} RoadItem;

typedef struct {
    double is_there, along, across, gain, drift;
} RoadRival;

/* A kart on the road, in the forms that plans need. */
typedef struct {
    npy_intp state; /* in the table of plans */
    /* Speed [m/s]; turn at full lock [rad/s]; distance at which the kart aims [m]; turn in the last
       step, and in the last step of a drift [fraction of full lock]; offset from the middle of the
       road [m] and angle to the road [rad]; remaining time of a small and of a big boost [steps]. */
    float speed, lock, reach, turn, drift_turn, offset, angle, boost_steps, big_boost_steps;
    int may_drift, may_brake;
    /* Speed to the right [m/s] and turn in the last step [rad]; side of a drift and its duration
       [steps]; remaining time of the turn after a drift [steps]. */
    float slide, yaw, drift_side, drift_steps, release_steps;
    /* Distance beyond the nearer edge of the road [m]; the road's largest turn in the near future
       [rad]; whether firing is useful. */
    float beyond, straightness, is_useful;
    /* At the marks: lateral displacement by the road's bend within the distance at which the kart
       aims, largest offsets from the middle to the left and to the right [m]; curvature [1/m]. */
    float bends[MARKS], lefts[MARKS], rights[MARKS], curves[MARKS];
    RoadItem items[ITEMS];    /* nearest first; worth 0 for none */
    RoadRival rivals[RIVALS]; /* nearest first */
} Situation;

/* The best plan that begins with each maneuver: its worth [m], its current turn [fraction of full
   lock], and its cost beyond the edge of the road [m]. */
enum { WORTH, BEST_TURN, BEST_DANGER, NUM_BESTS };
typedef float Best[NUM_BESTS][MANEUVERS];

/* Converters for "O&" of PyArg_ParseTuple. */
int as_rules(PyObject *object, void *rules); /* to const Rules * */

PyObject *age_memory(PyObject *module, PyObject *args);
PyObject *compute_layer(PyObject *module, PyObject *args);
PyObject *plan_karts(PyObject *module, PyObject *args);
PyObject *write_memory(PyObject *module, PyObject *args);

/* What karts observe of the road and of others; see plan_karts. */
typedef struct {
    float spots[RIVALS][2], velocity[2], headings[MARKS];
} Moment;

typedef struct {
    const Rules *rules;
    npy_intp count, num_types, line_step, line_size;
    Floats worths, memory;
    Around around;
    const float *line;    /* of the first kart; those of others follow at distances of `line_step` */
    Moment (*moments)[2]; /* before and now; NULL to ignore other karts */
} Survey;

void survey_kart(const Survey *survey, npy_intp kart, Situation *situation);

typedef struct Forecast Forecast;

/* Reads a table and a network from tuples. Returns NULL with an exception set on failure; the caller
   frees the forecast with PyMem_Free. */
Forecast *new_forecast(const Rules *rules, PyObject *table, PyObject *motion);
void weigh(Forecast *forecast, const Situation *situation, Best best);

#endif
