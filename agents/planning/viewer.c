/* Computes how karts are on the road, in the forms that plans need.

   The NumPy version in tests/oracle/plan_viewer.py matches bit for bit where NumPy uses fused
   multiply-adds. */

#include "geometry.h"
#include "planning.h"
#include "vectors.h"

/* Number of marks that measure a kart's rotation. */
enum { TURN_MARKS = 9 };
static const double PI = 3.14159265358979323846;

#define SLOWEST 5.0f             /* minimum assumed speed of karts [m/s] */
#define LEAST_LOCK 0.02f         /* minimum assumed angle of the wheels at full lock [rad] */
#define NEAREST 1.0              /* items nearer than this are too close to steer for [m] */
#define FARTHEST 60.0            /* items farther than this are ignored [m] */
#define BEYOND 1.0f              /* also items farther beyond the edge of the road [m] */
#define LEVEL 4.0f               /* items and karts farther above or below are on another level [m] */
#define REACH 25.0f              /* maximum distance of karts [m] */
#define FASTEST 50.0f            /* a match of karts that implies a higher speed is rejected [m/s] */
#define MOST_TURNED 0.6          /* a larger rotation is due to a change of the road [rad] */
static const float NOWHERE = 1e3f; /* position of a missing kart: stkzoo.agents.planning.memory [m] */
enum { SWITCH = 6 };             /* stkzoo.PowerupType */

/* The road ahead of a kart, at the marks. */
typedef struct {
    const float *line; /* (MARKS + 1, size): points, distances to the left and to the right edge [m] */
    npy_intp size;     /* of a point; with 4 numbers, the last one is the distance to both edges */
    float headings[MARKS], curvature[MARKS];
    float x[MARKS], y[MARKS], z[MARKS], squares[MARKS];
    float apart[MARKS];
    float offset, angle;
} Road;

typedef struct {
    double along;
    float across, above, to_left, to_right, sine, cosine;
} Place;

/* The smaller and the larger of two numbers; y if one of them is NaN. */
FORCE_INLINE float least_of(float x, float y) { return x < y ? x : y; }
FORCE_INLINE float most_of(float x, float y) { return x > y ? x : y; }

/* Returns the whole part of a number, clamped to `least` and `most`. Clamps before the cast, because
   casting NaN or a number out of range is undefined. */
FORCE_INLINE npy_intp whole_within(double marks, npy_intp least, npy_intp most)
{
    return marks >= (double)most ? most : marks > (double)least ? (npy_intp)marks : least;
}

/* ---------------------------------------------------------------- the road */

/* Removes jumps of a full turn from headings, as numpy.unwrap does. */
static void unwrap(float *headings)
{
    const float full = (float)(2 * PI), half = (float)PI;
    float shift = 0, last = headings[0];
    for (int i = 1; i < MARKS; i++) {
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

static float to_left(const Road *road, npy_intp mark)
{
    return road->line[road->size * mark + 3];
}

static float to_right(const Road *road, npy_intp mark)
{
    return road->line[road->size * (mark + 1) - 1];
}

FORCE_INLINE void read_road(Road *road)
{
    float *headings = road->headings, *curvature = road->curvature;
    int jumps = 0;
    for (int i = 0; i < MARKS; i++) {
        const float *point = road->line + road->size * i, *next = point + road->size;
        headings[i] = atan2f(next[0] - point[0], next[2] - point[2]);
        jumps |= i && fabsf(headings[i] - headings[i - 1]) >= (float)PI;
    }
    if (jumps) unwrap(headings);
    for (int i = 0; i < MARKS; i++) {
        const float *point = road->line + road->size * i;
        const float x = point[0], y = point[1], z = point[2];
        road->x[i] = x, road->y[i] = y, road->z[i] = z;
        road->squares[i] = x * x + y * y + z * z;
        float bend = i + 1 < MARKS ? headings[i + 1] - headings[i] : 0;
        if (i && i + 1 < MARKS) bend = (bend + (headings[i] - headings[i - 1])) / 2;
        curvature[i] = bend / (float)MARK_SPACING;
    }
    float sine, cosine;
    sine_and_cosine(headings[0], &sine, &cosine);
    road->offset = road->z[0] * sine - road->x[0] * cosine;
    road->angle = -headings[0];
}

/* Returns the position of a spot relative to the road. */
FORCE_INLINE Place place_of(Road *road, const float *spot)
{
    const float x = spot[0], y = spot[1], z = spot[2];
    for (int i = 0; i < MARKS; i++) {
        const float product = fmaf(z, road->z[i], fmaf(y, road->y[i], x * road->x[i]));
        road->apart[i] = road->squares[i] - 2.0f * product;
    }
    int nearest = 0;
    for (int i = 1; i < MARKS; i++) {
        if (road->apart[i] < road->apart[nearest]) nearest = i;
    }
    const float right = x - road->x[nearest], ahead = z - road->z[nearest];
    Place place = {.above = y - road->y[nearest]};
    sine_and_cosine(road->headings[nearest], &place.sine, &place.cosine);
    place.along = (double)nearest * MARK_SPACING + right * place.sine + ahead * place.cosine;
    place.across = right * place.cosine - ahead * place.sine;
    const npy_intp mark = whole_within(place.along / MARK_SPACING, 0, MARKS - 1);
    place.to_left = to_left(road, mark), place.to_right = to_right(road, mark);
    return place;
}

/* Returns the distance of the kart beyond the nearer edge of the road [m], NaN if any number is.
   Subtracts from 0, because a kart in the middle of a road without width is at 0, not at -0. */
FORCE_INLINE float aside_of(const Road *road)
{
    const float right = road->offset - to_right(road, 0);
    const float left = 0.0f - road->offset - to_left(road, 0);
    return right > left || right != right ? right : left;
}

/* Returns the largest turn of the road within a distance [rad]. */
FORCE_INLINE float straightness_of(const Road *road, float distance)
{
    const npy_intp count = whole_within(distance / (float)MARK_SPACING, 1, MARKS);
    float most = 0;
    for (npy_intp i = 1; i < count; i++) {
        most = most_of(most, fabsf(road->headings[i] - road->headings[0]));
    }
    return most;
}

/* ---------------------------------------------------------------- nearby items */

/* Writes the relevant items ahead, nearest first, and whether the kart should fire. */
FORCE_INLINE void survey_items(const Survey *s, npy_intp kart, const OwnState *own, Road *road,
                               Situation *out)
{
    const Rules *rules = s->rules;
    const npy_intp num_items = s->around.num_items;
    const float *spots = s->around.items.data + 3 * num_items * kart;
    const npy_int64 *types = s->around.types.data + num_items * kart;
    const float *worths = s->worths.data + (own->powerup_type != 0 ? s->num_types : 0);
    const float reach = (float)((FARTHEST + 5.0) * (FARTHEST + 5.0));
    const float switch_reach = (float)(rules->switch_reach * rules->switch_reach);
    Near nearest[ITEMS];
    npy_intp count = 0;
    int is_close = 0;
    for (npy_intp i = 0; i < num_items; i++) {
        const float *spot = spots + 3 * i;
        if (!(spot[2] > 0)) continue;
        const Near one = {.key = dot(spot, spot), .which = (int)i};
        is_close |= one.key < switch_reach && types[i] >= 0;
        const int is_known = types[i] >= 0 && types[i] < s->num_types;
        if (!is_known || worths[types[i]] == 0 || !(one.key < reach)) continue;
        count = insert(nearest, count, ITEMS, &one);
    }
    for (npy_intp i = 0; i < count; i++) {
        const int which = nearest[i].which;
        const float worth = worths[types[which]];
        const Place place = place_of(road, spots + 3 * which);
        const int is_kept = place.along > NEAREST && place.along < FARTHEST &&
                            fabsf(place.above) < LEVEL && place.across < place.to_right + BEYOND &&
                            -place.across < place.to_left + BEYOND;
        const float radius = (float)(worth > 0 ? rules->item_radius : rules->bad_item_radius);
        out->items[i] = (RoadItem){place.along, place.across, is_kept ? worth : 0, radius};
    }
    out->is_useful = own->powerup_count > 0 && !(own->powerup_type == SWITCH && is_close);
}

/* ---------------------------------------------------------------- the nearest karts */

/* Returns how far a kart has turned to the right since the previous step [rad]. */
FORCE_INLINE float turned_since(const Road *road, const float *before, float way)
{
    const float marks = way / (float)MARK_SPACING;
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
    return fabs(turned) < MOST_TURNED ? (float)turned : 0;
}

/* Positions in two arrays. If the coordinates of a point were adjacent, GCC 12 would rotate it with
   fused operations even with -ffp-contract=off, which changes the last bits. */
typedef struct {
    float right[RIVALS], ahead[RIVALS];
} Spots;

FORCE_INLINE void turn_right(Spots *spots, npy_intp i, float sine, float cosine)
{
    const float right = spots->right[i], ahead = spots->ahead[i];
    spots->right[i] = right * cosine - ahead * sine;
    spots->ahead[i] = right * sine + ahead * cosine;
}

/* Writes the karts' previous positions in the observing kart's current frame. Returns how far the
   observing kart has turned to the right since the previous step [rad]. */
FORCE_INLINE float move_spots(const Moment *before, const Road *road, const float *velocity,
                              Spots *stayed)
{
    const float half_step = (float)(STEP / 2);
    const float right = (velocity[0] + before->velocity[0]) * half_step;
    const float ahead = (velocity[1] + before->velocity[1]) * half_step;
    const float turned = turned_since(road, before->headings, sqrtf(right * right + ahead * ahead));
    float sine, cosine;
    sine_and_cosine(turned * 0.5f, &sine, &cosine);
    for (int i = 0; i < RIVALS; i++) {
        stayed->right[i] = before->spots[i][0], stayed->ahead[i] = before->spots[i][1];
        turn_right(stayed, i, sine, cosine);
        stayed->right[i] -= right, stayed->ahead[i] -= ahead;
        turn_right(stayed, i, sine, cosine);
    }
    return turned;
}

/* Writes the nearest karts, with velocities from the changes of their positions since the previous
   step. Returns how far the observing kart has turned to the right since then [rad].

   Observations have no velocities of other karts. The observing kart's own motion is known: its
   velocity, and its rotation from the apparent rotation of the road. Once this is subtracted, other
   karts move little in a step, so each is matched with the nearest previous position. */
FORCE_INLINE float survey_rivals(const Survey *s, npy_intp kart, const OwnState *own, Road *road,
                                 RoadRival *out)
{
    Moment *now = &s->moments[kart][1];
    float *velocity = now->velocity;
    velocity[0] = own->velocity[0], velocity[1] = own->velocity[2];
    memcpy(now->headings, road->headings, sizeof now->headings);
    const float pace = sqrtf(velocity[0] * velocity[0] + velocity[1] * velocity[1]);
    Near nearest[RIVALS];
    npy_intp count = 0;
    for (npy_intp i = 0; i < s->around.num_karts; i++) {
        const float *spot = s->around.karts.data + 3 * (s->around.num_karts * kart + i);
        Near one = {.key = dot(spot, spot), .place = {spot[0], spot[1], spot[2]}};
        if (one.key < REACH * REACH) count = insert(nearest, count, RIVALS, &one);
    }
    Spots stayed;
    const float turned = move_spots(&s->moments[kart][0], road, velocity, &stayed);
    for (int i = 0; i < RIVALS; i++, out++) {
        now->spots[i][0] = now->spots[i][1] = NOWHERE;
        if (i >= count) continue;
        const Place place = place_of(road, nearest[i].place);
        if (!(fabsf(place.above) < LEVEL)) continue;
        const float right = now->spots[i][0] = nearest[i].place[0];
        const float ahead = now->spots[i][1] = nearest[i].place[2];
        float moved[2] = {0}, least = 0;
        for (int k = 0; k < RIVALS; k++) {
            const float x = (right - stayed.right[k]) / (float)STEP;
            const float z = (ahead - stayed.ahead[k]) / (float)STEP;
            const float strangeness = fabsf(x - velocity[0]) + fabsf(z - velocity[1]);
            if (k && !(strangeness < least)) continue;
            least = strangeness, moved[0] = x, moved[1] = z;
        }
        *out = (RoadRival){1, place.along, place.across, 0, 0};
        if (!(sqrtf(moved[0] * moved[0] + moved[1] * moved[1]) < FASTEST)) continue;
        out->gain = moved[0] * place.sine + moved[1] * place.cosine - pace;
        out->drift = moved[0] * place.cosine - moved[1] * place.sine;
    }
    return turned;
}

/* ---------------------------------------------------------------- the situation of a kart */

FORCE_INLINE float remembered(const Survey *s, int name, npy_intp kart)
{
    return s->memory.data[name * s->count + kart];
}

/* Returns the index of the kart's state in the table of plans. */
FORCE_INLINE npy_intp state_of(const Survey *s, npy_intp kart)
{
    const float side = remembered(s, DRIFT_SIDE, kart);
    if (side == 0) return whole_within(remembered(s, RELEASE_LEFT, kart), 0, RELEASE_STEPS);
    return RELEASE_STEPS + 1 + (side > 0 ? BIG_DRIFT + 1 : 0) +
           whole_within(remembered(s, DRIFT_COUNT, kart), 0, BIG_DRIFT);
}

/* Returns the tangent of an angle from -1 to 1 rad, with the same bits on every system. This is
   Lambert's continued fraction, which has an error below 1e-13 with eight terms. */
FORCE_INLINE float tangent(double x)
{
    double fraction = 15.0;
    for (int odd = 13; odd > 0; odd -= 2) fraction = odd - x * x / fraction;
    return (float)(x / fraction);
}

/* Writes the road at the marks in the form that plans need. */
FORCE_INLINE void write_marks(const Road *road, const Rules *rules, int is_cautious, Situation *out)
{
    const float widest = (float)(is_cautious ? rules->caution_room : rules->greatest_room);
    const float margin = (float)rules->margin, aside = 0.5f * out->reach * out->reach;
    const npy_intp ahead = whole_within(out->reach / (float)MARK_SPACING, 1, MARKS - 1);
    for (npy_intp i = 0; i < MARKS; i++) {
        const npy_intp there = i + ahead;
        const float turn = there < MARKS ? road->headings[there] - road->headings[i] : 0;
        out->bends[i] = (float)(turn / ((double)ahead * MARK_SPACING) * aside);
        out->lefts[i] = least_of(most_of(to_left(road, i) - margin, 0.3f), widest);
        out->rights[i] = least_of(most_of(to_right(road, i) - margin, 0.3f), widest);
    }
    memcpy(out->curves, road->curvature, sizeof out->curves);
}

FOR_ALL_PROCESSORS
void survey_kart(const Survey *s, npy_intp kart, Situation *out)
{
    const Rules *rules = s->rules;
    const OwnState *own = (const OwnState *)s->around.own.data + kart;
    Road road = {.line = s->line + s->line_step * kart, .size = s->line_size};
    read_road(&road);
    const float speed = own->velocity[2], assumed = most_of(speed, SLOWEST);
    const float lock = tangent(most_of(own->max_steer_angle, LEAST_LOCK));
    const int is_jumping = own->jumping > 0;
    *out = (Situation){
        .state = state_of(s, kart),
        .speed = assumed,
        .lock = assumed * lock / (float)rules->wheel_base,
        .reach = (float)rules->aim_distance + (float)rules->aim_time * assumed,
        .turn = remembered(s, TURN, kart),
        .drift_turn = remembered(s, DRIFT_TURN, kart),
        .offset = road.offset,
        .angle = road.angle,
        .boost_steps = remembered(s, BOOST_STEPS, kart),
        .big_boost_steps = remembered(s, BIG_BOOST_STEPS, kart),
        .may_drift = speed > (float)rules->drift_speed && !is_jumping &&
                     remembered(s, HOP_STEPS, kart) == 0,
        .may_brake = speed > (float)rules->brake_speed,
        .slide = own->velocity[0],
        .drift_side = remembered(s, DRIFT_SIDE, kart),
        .drift_steps = remembered(s, DRIFT_COUNT, kart),
        .release_steps = remembered(s, RELEASE_LEFT, kart),
        .beyond = aside_of(&road),
        .straightness = straightness_of(&road, (float)rules->straight_time * speed),
    };
    if (s->moments) out->yaw = survey_rivals(s, kart, own, &road, out->rivals);
    survey_items(s, kart, own, &road, out);
    write_marks(&road, rules, remembered(s, CAUTION_STEPS, kart) > 0, out);
}
