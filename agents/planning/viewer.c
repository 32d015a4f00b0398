/* Computes the inputs of plans, and a policy's inputs from the weighed plans.

   The NumPy version in tests/oracle/plan_viewer.py matches bit for bit where NumPy uses fused
   multiply-adds. */

#include "geometry.h"
#include "planning.h"
#include "vectors.h"

enum {
    MANEUVERS = 4, BRAKE = 1, OFFSETS = 7, KART_SIZE = 16, TURN_MARKS = 9, MOST_MARKS = 64,
    MOST_NEAR = 16
};
/* Columns of the road's line after the point: distances to the left and to the right edge [m]. */
enum { TO_LEFT = 3, TO_RIGHT, LINE_SIZE };
/* Number of rows of the road in the arguments of weigh_plans. */
enum { ROAD_ROWS = 4 };
static const double PI = 3.14159265358979323846;

/* Indices of `rules`, which apply to all karts. */
enum {
    MARK_SPACING, SLOWEST, AIM_DISTANCE, AIM_TIME, WHEEL_BASE, DRIFT_SPEED, BRAKE_SPEED, MARGIN,
    CAUTION_ROOM, GREATEST_ROOM, STRAIGHT_TIME, ITEM_RADIUS, BAD_ITEM_RADIUS, NEAREST, FARTHEST,
    LEVEL, BEYOND, REACH, FASTEST, NOWHERE, STEP, MOST_TURNED, RELEASE_STEPS, LONGEST_DRIFT,
    SWITCH, SWITCH_REACH, DANGER, NITRO_SPEED, NITRO_TURN, STRAIGHT_AIM, STRAIGHT_ANGLE,
    FIRE_EVERY, WORTH_SCALE, NEVER, NUM_RULES
};

/* Columns of the scene: where a kart is on the road, and whether firing is useful. */
enum { ANGLE, OFFSET, ASIDE, STRAIGHTNESS, IS_USEFUL, SCENE_SIZE };

/* The karts' own state: entries of the full view in batch form. */
typedef struct {
    Floats velocity, energy;
    Wholes jumping, powerup, powerups;
} Own;

/* The road ahead of a kart, at the marks. */
typedef struct {
    npy_intp marks;
    const float *line; /* (marks + 1, LINE_SIZE) */
    float *headings, curvature[MOST_MARKS];
    float x[MOST_MARKS], y[MOST_MARKS], z[MOST_MARKS], squares[MOST_MARKS];
    float apart[MOST_MARKS];
    float offset, angle;
} Road;

typedef struct {
    double along;
    float across, above, to_left, to_right, sine, cosine;
} Place;

typedef struct {
    const double *rules;
    npy_intp count, marks, num_karts, num_items, num_rivals, num_kept, num_types;
    Own own;
    Floats worths, memory, line, headings, tangents, karts, items;
    Wholes types;
    Floats spots_before, velocity_before, headings_before, spots, velocity;
    Indices rows;
    Floats out_karts, out_road, out_scene;
    Doubles out_items, out_rivals;
} Survey;

/* The smaller and the larger of two numbers; y if one of them is NaN. */
FORCE_INLINE float least_of(float x, float y) { return x < y ? x : y; }
FORCE_INLINE float most_of(float x, float y) { return x > y ? x : y; }

/* Returns the number of marks within a distance, clamped to `least` and `most`. Clamps before the
   cast, because casting NaN or a number out of range is undefined. */
FORCE_INLINE npy_intp marks_within(double distance, double spacing, npy_intp least, npy_intp most)
{
    const double marks = distance / spacing;
    return marks >= (double)most ? most : marks > (double)least ? (npy_intp)marks : least;
}

/* ---------------------------------------------------------------- the road */

/* Removes jumps of a full turn from headings, as numpy.unwrap does. */
static void unwrap(float *headings, npy_intp marks)
{
    const float full = (float)(2 * PI), half = (float)PI;
    float shift = 0, last = headings[0];
    for (npy_intp i = 1; i < marks; i++) {
        const float turn = headings[i] - last;
        float wrapped = fmodf(turn + half, full);
        if (wrapped < 0) wrapped += full;
        wrapped -= half;
        if (wrapped == -half && turn > 0) wrapped = half;
        if (!(fabsf(turn) < half)) shift += wrapped - turn;
        last = headings[i];
        headings[i] += shift;
    }
}

FORCE_INLINE void read_road(Road *road, const double *rules)
{
    const npy_intp marks = road->marks;
    float *headings = road->headings, *curvature = road->curvature;
    int jumps = 0;
    for (npy_intp i = 1; i < marks; i++) {
        jumps |= fabsf(headings[i] - headings[i - 1]) >= (float)PI;
    }
    if (jumps) unwrap(headings, marks);
    for (npy_intp i = 0; i < marks; i++) {
        const float *point = road->line + LINE_SIZE * i;
        const float x = point[0], y = point[1], z = point[2];
        road->x[i] = x, road->y[i] = y, road->z[i] = z;
        road->squares[i] = x * x + y * y + z * z;
        float bend = i + 1 < marks ? headings[i + 1] - headings[i] : 0;
        if (i && i + 1 < marks) bend = (bend + (headings[i] - headings[i - 1])) / 2;
        curvature[i] = bend / (float)rules[MARK_SPACING];
    }
    float sine, cosine;
    sine_and_cosine(headings[0], &sine, &cosine);
    road->offset = road->z[0] * sine - road->x[0] * cosine;
    road->angle = -headings[0];
}

/* Returns the position of a spot relative to the road. */
FORCE_INLINE Place place_of(Road *road, const double *rules, const float *spot)
{
    const npy_intp marks = road->marks;
    const float x = spot[0], y = spot[1], z = spot[2];
    for (npy_intp i = 0; i < marks; i++) {
        const float product = fmaf(z, road->z[i], fmaf(y, road->y[i], x * road->x[i]));
        road->apart[i] = road->squares[i] - 2.0f * product;
    }
    npy_intp nearest = 0;
    for (npy_intp i = 1; i < marks; i++) {
        if (road->apart[i] < road->apart[nearest]) nearest = i;
    }
    const float right = x - road->x[nearest], ahead = z - road->z[nearest];
    Place place = {.above = y - road->y[nearest]};
    sine_and_cosine(road->headings[nearest], &place.sine, &place.cosine);
    place.along = (double)nearest * rules[MARK_SPACING] + right * place.sine + ahead * place.cosine;
    place.across = right * place.cosine - ahead * place.sine;
    const npy_intp mark = marks_within(place.along, rules[MARK_SPACING], 0, marks - 1);
    const float *point = road->line + LINE_SIZE * mark;
    place.to_left = point[TO_LEFT], place.to_right = point[TO_RIGHT];
    return place;
}

/* Returns the distance of the kart beyond the nearer edge of the road [m], NaN if any number is.
   Subtracts from 0, because a kart in the middle of a road without width is at 0, not at -0. */
FORCE_INLINE float aside_of(const Road *road)
{
    const float right = road->offset - road->line[TO_RIGHT];
    const float left = 0.0f - road->offset - road->line[TO_LEFT];
    return right > left || right != right ? right : left;
}

/* Returns the largest offset of a kart from the middle of the road to one side [m]. */
FORCE_INLINE float room_of(const double *rules, float to_edge, float widest)
{
    return least_of(most_of(to_edge - (float)rules[MARGIN], 0.3f), widest);
}

/* Returns the largest turn of the road within a distance [rad]. */
FORCE_INLINE float straightness_of(const Road *road, const double *rules, float distance)
{
    const npy_intp count =
        marks_within(distance / (float)rules[MARK_SPACING], 1.0, 1, road->marks);
    float most = 0;
    for (npy_intp i = 1; i < count; i++) {
        most = most_of(most, fabsf(road->headings[i] - road->headings[0]));
    }
    return most;
}

/* ---------------------------------------------------------------- nearby items */

/* Inserts an object among the nearest, behind those with an equal key. Returns the new count, at
   most `limit`. */
FORCE_INLINE npy_intp add_near(Near *nearest, npy_intp count, npy_intp limit, const Near *one)
{
    npy_intp at = count;
    while (at > 0 && one->key < nearest[at - 1].key) at--;
    if (at >= limit) return count;
    if (count < limit) count++;
    for (npy_intp i = count - 1; i > at; i--) nearest[i] = nearest[i - 1];
    nearest[at] = *one;
    return count;
}

/* Writes the relevant items ahead, nearest first, and whether the kart should fire. */
FORCE_INLINE void survey_items(const Survey *s, npy_intp kart, Road *road)
{
    const double *rules = s->rules;
    const float *spots = s->items.data + 3 * s->num_items * kart;
    const npy_int64 *types = s->types.data + s->num_items * kart;
    const int has_powerup = s->own.powerup.data[kart] != 0;
    const float *worths = s->worths.data + (has_powerup ? s->num_types : 0);
    const float reach = (float)((rules[FARTHEST] + 5.0) * (rules[FARTHEST] + 5.0));
    const float switch_reach = (float)(rules[SWITCH_REACH] * rules[SWITCH_REACH]);
    Near nearest[MOST_NEAR];
    npy_intp count = 0;
    int is_close = 0;
    for (npy_intp i = 0; i < s->num_items; i++) {
        const float *spot = spots + 3 * i;
        if (!(spot[2] > 0)) continue;
        const Near one = {.key = dot(spot, spot), .which = (int)i};
        is_close |= one.key < switch_reach && types[i] >= 0;
        const int is_known = types[i] >= 0 && types[i] < s->num_types;
        if (!is_known || worths[types[i]] == 0 || !(one.key < reach)) continue;
        count = add_near(nearest, count, s->num_kept, &one);
    }
    double *out = s->out_items.data + 4 * s->num_kept * kart;
    memset(out, 0, (size_t)(4 * s->num_kept) * sizeof *out);
    for (npy_intp i = 0; i < count; i++, out += 4) {
        const int which = nearest[i].which;
        const float worth = worths[types[which]];
        const Place place = place_of(road, rules, spots + 3 * which);
        const int is_kept = place.along > rules[NEAREST] && place.along < rules[FARTHEST] &&
                            fabsf(place.above) < (float)rules[LEVEL] &&
                            place.across < place.to_right + (float)rules[BEYOND] &&
                            -place.across < place.to_left + (float)rules[BEYOND];
        out[0] = place.along, out[1] = place.across, out[2] = is_kept ? worth : 0;
        out[3] = (float)rules[worth > 0 ? ITEM_RADIUS : BAD_ITEM_RADIUS];
    }
    const int spoils = s->own.powerup.data[kart] == (npy_int64)rules[SWITCH] && is_close;
    s->out_scene.data[SCENE_SIZE * kart + IS_USEFUL] =
        s->own.powerups.data[kart] > 0 && !spoils;
}

/* ---------------------------------------------------------------- the nearest karts */

/* Returns how far a kart has turned to the right since the previous step [rad]. */
FORCE_INLINE float turned_since(const double *rules, const Road *road, const float *before, float way)
{
    const float marks = way / (float)rules[MARK_SPACING];
    const double first = marks > 0 ? least_of(marks, 1.0f) : 0;
    double turns[TURN_MARKS];
    for (int i = 0; i < TURN_MARKS; i++) {
        const double place = i + first;
        const npy_intp mark = (npy_intp)place;
        const double share = place - (double)mark;
        const double then = before[mark] * (1 - share) + before[mark + 1] * share;
        const double turn = then - road->headings[i];
        int at = i;
        for (; at > 0 && turn < turns[at - 1]; at--) turns[at] = turns[at - 1];
        turns[at] = turn;
    }
    double turned = fmod(turns[TURN_MARKS / 2] + PI, 2 * PI);
    if (turned < 0) turned += 2 * PI;
    turned -= PI;
    return fabs(turned) < rules[MOST_TURNED] ? (float)turned : 0;
}

/* Positions in two arrays. If the coordinates of a point were adjacent, GCC 12 would rotate it with
   fused operations even with -ffp-contract=off, which changes the last bits. */
typedef struct {
    float right[MOST_NEAR], ahead[MOST_NEAR];
} Spots;

FORCE_INLINE void turn_right(Spots *spots, npy_intp i, float sine, float cosine)
{
    const float right = spots->right[i], ahead = spots->ahead[i];
    spots->right[i] = right * cosine - ahead * sine;
    spots->ahead[i] = right * sine + ahead * cosine;
}

/* Writes the karts' previous positions in the observing kart's current frame. Returns how far the
   observing kart has turned to the right since the previous step [rad]. */
FORCE_INLINE float move_spots(const Survey *s, npy_intp kart, const Road *road,
                              const float *velocity, Spots *stayed)
{
    const float *before = s->velocity_before.data + 2 * kart, half_step = (float)(s->rules[STEP] / 2);
    const float *spots = s->spots_before.data + 2 * s->num_rivals * kart;
    const float right = (velocity[0] + before[0]) * half_step;
    const float ahead = (velocity[1] + before[1]) * half_step;
    const float *headings = s->headings_before.data + s->marks * kart;
    const float way = sqrtf(right * right + ahead * ahead);
    const float turned = turned_since(s->rules, road, headings, way);
    float sine, cosine;
    sine_and_cosine(turned * 0.5f, &sine, &cosine);
    for (npy_intp i = 0; i < s->num_rivals; i++) {
        stayed->right[i] = spots[2 * i], stayed->ahead[i] = spots[2 * i + 1];
        turn_right(stayed, i, sine, cosine);
        stayed->right[i] -= right, stayed->ahead[i] -= ahead;
        turn_right(stayed, i, sine, cosine);
    }
    return turned;
}

/* Writes the nearest karts, with velocities from the changes of their positions since the previous
   step. Returns how far the observing kart has turned to the right since then [rad]. */
FORCE_INLINE float survey_rivals(const Survey *s, npy_intp kart, Road *road)
{
    const double *rules = s->rules;
    const npy_intp num_rivals = s->num_rivals;
    const float *own = s->own.velocity.data + 3 * kart;
    float *velocity = s->velocity.data + 2 * kart, *spots = s->spots.data + 2 * num_rivals * kart;
    velocity[0] = own[0], velocity[1] = own[2];
    const float pace = sqrtf(velocity[0] * velocity[0] + velocity[1] * velocity[1]);
    Near nearest[MOST_NEAR];
    npy_intp count = 0;
    for (npy_intp i = 0; i < s->num_karts; i++) {
        const float *spot = s->karts.data + 3 * (s->num_karts * kart + i);
        Near one = {.key = dot(spot, spot), .place = {spot[0], spot[1], spot[2]}};
        if (!(one.key < (float)(rules[REACH] * rules[REACH]))) continue;
        count = add_near(nearest, count, num_rivals, &one);
    }
    Spots stayed;
    const float turned = move_spots(s, kart, road, velocity, &stayed);
    double *out = s->out_rivals.data + 5 * num_rivals * kart;
    memset(out, 0, (size_t)(5 * num_rivals) * sizeof *out);
    for (npy_intp i = 0; i < num_rivals; i++, out += 5) {
        spots[2 * i] = spots[2 * i + 1] = (float)rules[NOWHERE];
        if (i >= count) continue;
        const Place place = place_of(road, rules, nearest[i].place);
        if (!(fabsf(place.above) < (float)rules[LEVEL])) continue;
        const float right = spots[2 * i] = nearest[i].place[0];
        const float ahead = spots[2 * i + 1] = nearest[i].place[2];
        float moved[2] = {0}, least = 0;
        for (npy_intp k = 0; k < num_rivals; k++) {
            const float x = (right - stayed.right[k]) / (float)rules[STEP];
            const float z = (ahead - stayed.ahead[k]) / (float)rules[STEP];
            const float strangeness = fabsf(x - velocity[0]) + fabsf(z - velocity[1]);
            if (k && !(strangeness < least)) continue;
            least = strangeness, moved[0] = x, moved[1] = z;
        }
        out[0] = 1, out[1] = place.along, out[2] = place.across;
        if (!(sqrtf(moved[0] * moved[0] + moved[1] * moved[1]) < (float)rules[FASTEST])) continue;
        out[3] = moved[0] * place.sine + moved[1] * place.cosine - pace;
        out[4] = moved[0] * place.cosine - moved[1] * place.sine;
    }
    return turned;
}

/* ---------------------------------------------------------------- inputs of plans */

FORCE_INLINE float remembered(const Survey *s, int name, npy_intp kart)
{
    return s->memory.data[name * s->count + kart];
}

/* Returns the index of the kart's state in the table of plans. */
FORCE_INLINE npy_intp state_of(const Survey *s, npy_intp kart)
{
    const double *rules = s->rules;
    const npy_intp most = (npy_intp)rules[LONGEST_DRIFT], release = (npy_intp)rules[RELEASE_STEPS];
    const float side = remembered(s, DRIFT_SIDE, kart);
    if (side == 0) return marks_within(remembered(s, RELEASE_LEFT, kart), 1.0, 0, release);
    return release + 1 + (side > 0 ? most + 1 : 0) +
           marks_within(remembered(s, DRIFT_COUNT, kart), 1.0, 0, most);
}

FORCE_INLINE void survey_kart(const Survey *s, npy_intp kart)
{
    const double *rules = s->rules;
    const npy_intp marks = s->marks;
    Road road = {.marks = marks, .line = s->line.data + LINE_SIZE * (marks + 1) * kart,
                 .headings = s->headings.data + marks * kart};
    read_road(&road, rules);
    const float turned = s->num_rivals ? survey_rivals(s, kart, &road) : 0;
    survey_items(s, kart, &road);

    const float speed = s->own.velocity.data[3 * kart + 2];
    const float assumed = most_of(speed, (float)rules[SLOWEST]);
    const float reach = (float)rules[AIM_DISTANCE] + (float)rules[AIM_TIME] * assumed;
    const int is_jumping = s->own.jumping.data[kart] > 0;
    const float numbers[] = {
        assumed,
        assumed * s->tangents.data[kart] / (float)rules[WHEEL_BASE],
        reach,
        remembered(s, TURN, kart),
        remembered(s, DRIFT_TURN, kart),
        road.offset,
        road.angle,
        remembered(s, BOOST_STEPS, kart),
        remembered(s, BIG_BOOST_STEPS, kart),
        speed > (float)rules[DRIFT_SPEED] && !is_jumping && remembered(s, HOP_STEPS, kart) == 0,
        speed > (float)rules[BRAKE_SPEED],
        s->own.velocity.data[3 * kart],
        turned,
        remembered(s, DRIFT_SIDE, kart),
        remembered(s, DRIFT_COUNT, kart),
        remembered(s, RELEASE_LEFT, kart),
    };
    memcpy(s->out_karts.data + KART_SIZE * kart, numbers, sizeof numbers);
    s->rows.data[kart] = state_of(s, kart);

    const int is_cautious = remembered(s, CAUTION_STEPS, kart) > 0;
    const float widest = (float)rules[is_cautious ? CAUTION_ROOM : GREATEST_ROOM];
    const npy_intp ahead = marks_within(reach / (float)rules[MARK_SPACING], 1.0, 1, marks - 1);
    const float aside = 0.5f * reach * reach;
    float *bends = s->out_road.data + ROAD_ROWS * marks * kart;
    float *lefts = bends + marks, *rights = lefts + marks;
    for (npy_intp i = 0; i < marks; i++) {
        const npy_intp there = i + ahead;
        const float turn = there < marks ? road.headings[there] - road.headings[i] : 0;
        bends[i] = (float)(turn / ((double)ahead * rules[MARK_SPACING]) * aside);
        const float *point = road.line + LINE_SIZE * i;
        lefts[i] = room_of(rules, point[TO_LEFT], widest);
        rights[i] = room_of(rules, point[TO_RIGHT], widest);
    }
    memcpy(rights + marks, road.curvature, (size_t)marks * sizeof(float));

    float *scene = s->out_scene.data + SCENE_SIZE * kart;
    scene[ANGLE] = road.angle, scene[OFFSET] = road.offset;
    scene[ASIDE] = aside_of(&road);
    scene[STRAIGHTNESS] = straightness_of(&road, rules, (float)rules[STRAIGHT_TIME] * speed);
}

FOR_ALL_PROCESSORS
static void survey_all(const Survey *s)
{
    for (npy_intp kart = 0; kart < s->count; kart++) survey_kart(s, kart);
}

/* ---------------------------------------------------------------- the arguments */

static int are_sizes(const npy_intp (*sizes)[2], size_t count)
{
    for (size_t i = 0; i < count; i++) {
        if (sizes[i][0] != sizes[i][1]) return refuse("the arrays of the karts do not fit together");
    }
    return 0;
}

#define ARE_SIZES(SIZES) are_sizes(SIZES, sizeof SIZES / sizeof *SIZES)

static int read_own(PyObject *tuple, Own *own)
{
    return PyArg_ParseTuple(tuple, "O&O&O&O&O&", as_floats, &own->velocity, as_floats, &own->energy,
                            as_wholes, &own->jumping, as_wholes, &own->powerup, as_wholes,
                            &own->powerups);
}

static int is_own(const Own *own, npy_intp count)
{
    const npy_intp sizes[][2] = {
        {own->velocity.size, 3 * count}, {own->energy.size, count}, {own->jumping.size, count},
        {own->powerup.size, count},      {own->powerups.size, count},
    };
    return ARE_SIZES(sizes);
}

static int survey_fits(Survey *s, Doubles rules)
{
    const npy_intp count = s->count = s->rows.size;
    if (!count) return 0;
    s->rules = rules.data;
    s->marks = s->headings.size / count;
    s->num_karts = s->karts.size / (3 * count), s->num_items = s->items.size / (3 * count);
    s->num_rivals = s->out_rivals.size / (5 * count), s->num_kept = s->out_items.size / (4 * count);
    s->num_types = s->worths.size / 2;
    const npy_intp rivals = s->num_rivals, marks = s->marks;
    const npy_intp sizes[][2] = {
        {rules.size, NUM_RULES},
        {s->worths.size, 2 * s->num_types},
        {s->memory.size, MEMORY_SIZE * count},
        {s->line.size, LINE_SIZE * (marks + 1) * count},
        {s->headings.size, marks * count},
        {s->tangents.size, count},
        {s->karts.size, 3 * s->num_karts * count},
        {s->items.size, 3 * s->num_items * count},
        {s->types.size, s->num_items * count},
        {s->out_karts.size, KART_SIZE * count},
        {s->out_road.size, ROAD_ROWS * marks * count},
        {s->out_items.size, 4 * s->num_kept * count},
        {s->out_rivals.size, 5 * rivals * count},
        {s->out_scene.size, SCENE_SIZE * count},
        {s->spots_before.size, rivals ? 2 * rivals * count : s->spots_before.size},
        {s->velocity_before.size, rivals ? 2 * count : s->velocity_before.size},
        {s->headings_before.size, rivals ? marks * count : s->headings_before.size},
        {s->spots.size, rivals ? 2 * rivals * count : s->spots.size},
        {s->velocity.size, rivals ? 2 * count : s->velocity.size},
    };
    if (ARE_SIZES(sizes) < 0 || is_own(&s->own, count) < 0) return -1;
    if (marks <= TURN_MARKS + 1 || marks > MOST_MARKS || rivals > MOST_NEAR ||
        s->num_kept > MOST_NEAR) {
        return refuse("too few or too many marks, items or rivals");
    }
    const double release = rules.data[RELEASE_STEPS], longest = rules.data[LONGEST_DRIFT];
    if (!(release >= 0 && release < 1e6 && longest >= 0 && longest < 1e6 &&
          rules.data[MARK_SPACING] > 0 && fabs(rules.data[SWITCH]) < 1e6)) {
        return refuse("a rule is out of bounds");
    }
    return 0;
}

/* survey_road(rules, worths, memory, own, around, before, now, out): writes the arguments of
   weigh_plans for A karts, and where the karts are.

   rules: (34,) in the order of the enum above.
   worths: (2, types) worth of item types for karts without and with a powerup [m].
   memory: (22, A) in the order of stkzoo.agents.planning.memory.PlanMemory.
   own: entries of the full view in batch form: velocity (A, 3) and energy (A,) float32; jumping,
       powerup_type and powerup_count (A,) int64.
   around: the road at M marks, 12 or more, with distances to its left and to its right edge,
       (A, M + 1, 5) [m]; directions of the road (A, M) [rad], which are unwrapped in place; tangents
       of the karts' largest steering angles (A,); positions in the kart's frame of other karts
       (A, K, 3) [m], not finite if missing, and of items (A, N, 3) [m]; types of the items (A, N).
   before: observations of the previous step: positions of the nearest karts, right and ahead
       (A, R, 2) [m]; velocity of the observing kart (A, 2) [m/s]; directions of the road (A, M).
   now: the same positions and velocities of this step, which are written.
   out: arrays to write: the arguments rows, karts, road, items (A, I, 4) and rivals (A, R, 5) of
       weigh_plans; with R = 0, other karts are ignored. The last one, (A, 5), is the scene: angle to
       the road [rad], offset from its middle [m], distance beyond the nearer edge [m], the largest
       turn of the road in the near future [rad], and whether firing is useful.

   Observations have no velocities of other karts. The observing kart's own motion is known: its
   velocity, and its rotation from the apparent rotation of the road. Once this is subtracted, other
   karts move little in a step, so each is matched with the nearest previous position. */
PyObject *survey_road(PyObject *Py_UNUSED(module), PyObject *args)
{
    Survey s;
    PyObject *own, *around, *before, *now, *out;
    Doubles rules;
    if (!PyArg_ParseTuple(args, "O&O&O&O!O!O!O!O!", as_doubles, &rules, as_floats, &s.worths,
                          as_floats, &s.memory, &PyTuple_Type, &own, &PyTuple_Type, &around,
                          &PyTuple_Type, &before, &PyTuple_Type, &now, &PyTuple_Type, &out) ||
        !read_own(own, &s.own) ||
        !PyArg_ParseTuple(around, "O&O&O&O&O&O&", as_floats, &s.line, as_written_floats,
                          &s.headings, as_floats, &s.tangents, as_floats, &s.karts, as_floats,
                          &s.items, as_wholes, &s.types) ||
        !PyArg_ParseTuple(before, "O&O&O&", as_floats, &s.spots_before, as_floats,
                          &s.velocity_before, as_floats, &s.headings_before) ||
        !PyArg_ParseTuple(now, "O&O&", as_written_floats, &s.spots, as_written_floats,
                          &s.velocity) ||
        !PyArg_ParseTuple(out, "O&O&O&O&O&O&", as_written_indices, &s.rows, as_written_floats,
                          &s.out_karts, as_written_floats, &s.out_road, as_written_doubles,
                          &s.out_items, as_written_doubles, &s.out_rivals, as_written_floats,
                          &s.out_scene) ||
        survey_fits(&s, rules) < 0) {
        return NULL;
    }
    survey_all(&s);
    Py_RETURN_NONE;
}

/* ---------------------------------------------------------------- inputs of a policy */

typedef struct {
    const double *rules;
    npy_intp count, num_rivals, width, first;
    Own own;
    Floats memory, offset_logits, button_logits, best, scene, prior, inputs;
    Doubles rivals;
} Presentation;

static npy_intp best_of(const float *worth)
{
    npy_intp best = 0;
    for (npy_intp i = 1; i < MANEUVERS; i++) {
        if (worth[i] > worth[best]) best = i;
    }
    return best;
}

/* Writes the logits of the rules. */
static void put_prior(const Presentation *p, npy_intp kart)
{
    const double *rules = p->rules;
    const npy_intp all = MANEUVERS * p->count;
    const float *worth = p->best.data + MANEUVERS * kart, *scene = p->scene.data + SCENE_SIZE * kart;
    const npy_intp best = best_of(worth);
    const float turn = worth[all + best], danger = worth[2 * all + best];
    const int is_safe = danger < (float)rules[DANGER] && best != BRAKE;
    const int is_straight = fabsf(scene[ANGLE]) < (float)rules[STRAIGHT_AIM] &&
                            scene[STRAIGHTNESS] < (float)rules[STRAIGHT_ANGLE];
    const int wanted[] = {
        is_safe && p->memory.data[NITRO_STEPS * p->count + kart] == 0 &&
            p->own.velocity.data[3 * kart + 2] > (float)rules[NITRO_SPEED] &&
            fabsf(turn) < (float)rules[NITRO_TURN] && p->own.energy.data[kart] > 0 &&
            !(p->own.jumping.data[kart] > 0),
        is_safe && is_straight && scene[IS_USEFUL] != 0 &&
            p->memory.data[SINCE_FIRE * p->count + kart] >= (float)rules[FIRE_EVERY],
    };
    float *out = p->prior.data + (MANEUVERS + OFFSETS + 4) * kart;
    for (int i = 0; i < MANEUVERS; i++) {
        *out++ = most_of((float)rules[NEVER], (float)rules[WORTH_SCALE] * (worth[i] - worth[best]));
    }
    for (int i = 0; i < OFFSETS; i++) *out++ = p->offset_logits.data[i];
    for (int button = 0; button < 2; button++) {
        for (int i = 0; i < 2; i++) *out++ = p->button_logits.data[2 * wanted[button] + i];
    }
}

/* Writes a policy's inputs from the plans and the nearest karts. */
static void put_inputs(const Presentation *p, npy_intp kart)
{
    const npy_intp all = MANEUVERS * p->count;
    const float *worth = p->best.data + MANEUVERS * kart, *scene = p->scene.data + SCENE_SIZE * kart;
    const float most = worth[best_of(worth)];
    const float hopeless = (float)(p->rules[NEVER] / p->rules[WORTH_SCALE] * 10);
    float *out = p->inputs.data + p->width * kart + p->first;
    for (int i = 0; i < MANEUVERS; i++) {
        const float behind = worth[i] - most;
        *out++ = behind > hopeless;
        *out++ = most_of(-2.0f, behind / 10.0f);
        *out++ = worth[all + i];
        *out++ = least_of(2.0f, worth[2 * all + i] / 10.0f);
    }
    *out++ = scene[ANGLE], *out++ = scene[OFFSET] / 10.0f, *out++ = scene[STRAIGHTNESS];
    const double *rival = p->rivals.data + 5 * p->num_rivals * kart;
    for (npy_intp i = 0; i < p->num_rivals; i++, rival += 5) {
        *out++ = (float)rival[0];
        *out++ = (float)(rival[1] / 10.0);
        *out++ = rival[0] != 0 ? ((float)rival[2] - scene[OFFSET]) / 3.0f : 0;
        *out++ = (float)rival[3] / 5.0f;
        *out++ = (float)rival[4] / 3.0f;
    }
}

static int presentation_fits(Presentation *p, Doubles rules)
{
    const npy_intp count = p->count = p->scene.size / SCENE_SIZE;
    if (!count) return 0;
    p->rules = rules.data;
    p->num_rivals = p->rivals.size / (5 * count), p->width = p->inputs.size / count;
    const npy_intp own_width = 4 * MANEUVERS + 3 + 5 * p->num_rivals;
    const npy_intp sizes[][2] = {
        {rules.size, NUM_RULES},
        {p->memory.size, MEMORY_SIZE * count},
        {p->offset_logits.size, OFFSETS},
        {p->button_logits.size, 4},
        {p->best.size, 3 * MANEUVERS * count},
        {p->scene.size, SCENE_SIZE * count},
        {p->rivals.size, 5 * p->num_rivals * count},
        {p->prior.size, (MANEUVERS + OFFSETS + 4) * count},
        {p->inputs.size, p->width * count},
    };
    if (ARE_SIZES(sizes) < 0 || is_own(&p->own, count) < 0) return -1;
    if (p->width && (p->first < 0 || p->first > p->width || p->width - p->first < own_width)) {
        return refuse("a row of the inputs is too short");
    }
    return 0;
}

/* present_plans(rules, logits, memory, own, best, scene, rivals, prior, inputs, first): writes the
   logits of the rules, and a policy's inputs from the plans and the nearest karts.

   rules, memory, own, scene, rivals: see survey_road.
   logits: (7,) logits of the offsets, and (2, 2) logits of a button, first if the rules do not press
       it, then if they do.
   best: argument `out` of weigh_plans.
   prior: (A, 15) logits of the rules, which are written.
   inputs: (A, F); 19 columns, and 5 for each rival, are written. With F = 0, none are written.
   first: index of the first of these columns. */
PyObject *present_plans(PyObject *Py_UNUSED(module), PyObject *args)
{
    Presentation p;
    PyObject *logits, *own;
    Doubles rules;
    if (!PyArg_ParseTuple(args, "O&O!O&O!O&O&O&O&O&n", as_doubles, &rules, &PyTuple_Type, &logits,
                          as_floats, &p.memory, &PyTuple_Type, &own, as_floats, &p.best, as_floats,
                          &p.scene, as_doubles, &p.rivals, as_written_floats, &p.prior,
                          as_written_floats, &p.inputs, &p.first) ||
        !PyArg_ParseTuple(logits, "O&O&", as_floats, &p.offset_logits, as_floats,
                          &p.button_logits) ||
        !read_own(own, &p.own) ||
        presentation_fits(&p, rules) < 0) {
        return NULL;
    }
    for (npy_intp kart = 0; kart < p.count; kart++) {
        put_prior(&p, kart);
        if (p.width) put_inputs(&p, kart);
    }
    Py_RETURN_NONE;
}
