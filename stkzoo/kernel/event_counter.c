/* Counts the events of a race's karts between two snapshots.

   stkzoo.mdp.events defines the events. The engine does not report contacts, hits or rescues, so they are derived
   from the karts' motion. The thresholds were measured in races recorded at 120 Hz, the engine's
   own rate. */

#include "geometry.h"

/* Columns of `counts`. */
enum {
    KART_CONTACT, WALL_CONTACT, HIT, ITEM_TAKEN, ITEM_USED,
    OVERTAKE, OVERTAKEN, RESCUE, OFF_ROAD, WRONG_WAY, NUM_EVENTS
};

/* First columns of `memory`. One column per kart follows: the time for which further contacts with
   that kart are not counted [s]. WALL_FOR is the same for contacts with walls. PLACE is the
   location from which STUCK is measured [m]. */
enum {
    OFF_ROAD_FOR, WRONG_WAY_FOR, STUCK_FOR, /* [s] */
    PLACE, IS_CARRIED = PLACE + 3, WALL_FOR, NUM_OWN
};

#define APART 0.5     /* contacts within this time count as one [s] */
#define TOUCH 0.1     /* boxes within this distance touch [m] */
#define NEAR 0.25     /* a jolt this close to another kart is not a wall contact [m] */
#define STUCK 3.0     /* a kart that stays within this distance is stuck [m] */
#define BACKWARDS 1.0 /* minimum speed against the road's direction [m/s] */
#define NITRO 0.4     /* a bottle adds at least 1; a step burns at most 0.15 */
#define CANNON 15.0   /* cannons are faster, rescues and explosions slower [m/s] */
#define TUMBLE 1.7    /* explosions rotate karts faster; rescues do not rotate them [rad/s] */
#define GUM_REACH 3.0 /* maximum distance of bubble gum from the kart that drove over it [m] */
#define FORWARDS 2.0  /* slower or reversing karts can brake as hard as at a wall [m/s] */
#define LOSS 4.5      /* more than a kart loses in a step of 0.1 s without a collision [m/s] */
#define BRAKES 40.0   /* the same per second, for longer steps [m/s^2] */
#define DRAG 2.0      /* factor of both limits with a parachute */

enum { ATTACHED_PARACHUTE, ATTACHED_ANVIL, ATTACHED_BOMB, ATTACHED_SHIELD = 6 };
enum { NO_POWERUP = 0, BUBBLE_GUM = 4 };

typedef struct {
    OBJECT_HEAD
    Floats nodes;           /* (N, 2, 3) */
    double step_size;
    Doubles memory, counts; /* (K, NUM_OWN + K), (K, NUM_EVENTS) */
    npy_intp num_karts;
} EventCounter;

/* A kart's bounding box. */
typedef struct {
    double place[3], velocity[3], axes[3][3], reach[3]; /* right, up, forward; half sizes */
    int is_carried, is_dragged;
} Box;

static double *memory_of(const EventCounter *self, npy_intp kart)
{
    return self->memory.data + kart * (NUM_OWN + self->num_karts);
}

static double *counts_of(const EventCounter *self, npy_intp kart)
{
    return self->counts.data + kart * NUM_EVENTS;
}

static double inner(const double *v, const double *w)
{
    return v[0] * w[0] + v[1] * w[1] + v[2] * w[2];
}

static double apart(const float *here, const float *there)
{
    const double way[3] = {(double)here[0] - there[0], (double)here[1] - there[1],
                           (double)here[2] - there[2]};
    return sqrt(inner(way, way));
}

/* ---------------------------------------------------------------- one kart */

static void time_kart(const EventCounter *self, const Kart *then, const Kart *kart, double *memory,
                      double *counts)
{
    const float *begin = self->nodes.data + 6 * kart->node, *v = kart->velocity;
    const double dt = self->step_size;
    const double road[3] = {(double)begin[3] - begin[0], (double)begin[4] - begin[1],
                            (double)begin[5] - begin[2]};
    const double along = road[0] * v[0] + road[1] * v[1] + road[2] * v[2];
    const int is_off = kart->is_on_road == 0;
    /* A carried kart keeps its velocity, but its speed is 0. */
    const int is_back = kart->speed != 0 && along < -BACKWARDS * sqrt(inner(road, road));
    for (int i = 0; i < 3; i++) {
        if (isinf(memory[PLACE + i])) memory[PLACE + i] = then->location[i]; /* the first step */
    }
    const double way[3] = {kart->location[0] - memory[PLACE], kart->location[1] - memory[PLACE + 1],
                           kart->location[2] - memory[PLACE + 2]};
    const int has_moved = inner(way, way) > STUCK * STUCK;
    for (int i = 0; has_moved && i < 3; i++) memory[PLACE + i] = kart->location[i];
    counts[OFF_ROAD] = is_off ? dt : 0;
    counts[WRONG_WAY] = is_back ? dt : 0;
    memory[OFF_ROAD_FOR] = is_off ? memory[OFF_ROAD_FOR] + dt : 0;
    memory[WRONG_WAY_FOR] = is_back ? memory[WRONG_WAY_FOR] + dt : 0;
    memory[STUCK_FOR] = has_moved ? 0 : memory[STUCK_FOR] + dt;
}

static void count_items(const Kart *then, const Kart *now, double *counts)
{
    const int is_other = now->powerup_num > 0 && now->powerup_type != then->powerup_type;
    const int has_more = (now->powerup_num > then->powerup_num || is_other) &&
                         now->powerup_type != NO_POWERUP;
    counts[ITEM_TAKEN] = has_more + (now->energy > then->energy + (float)NITRO);
    counts[ITEM_USED] = now->powerup_num < then->powerup_num && !has_more;
    const npy_int32 hung = now->attachment_type;
    counts[HIT] += hung != then->attachment_type &&
                   (hung == ATTACHED_PARACHUTE || hung == ATTACHED_ANVIL || hung == ATTACHED_BOMB);
}

/* Counts rescues and explosions. A kart that a rescue, an explosion or a cannon carries keeps its
   last velocity. */
static void count_ride(const Kart *then, const Kart *now, double dt, double *memory, double *counts)
{
    const float *v = now->velocity, *w = then->velocity, *p = now->rotation, *q = then->rotation;
    const double way = apart(now->location, then->location);
    const int is_carried = v[0] == w[0] && v[1] == w[1] && v[2] == w[2] && way > 0;
    if (is_carried && !memory[IS_CARRIED] && way < CANNON * dt) {
        double product = 0;
        for (int i = 0; i < 4; i++) product += (double)p[i] * q[i];
        const int tumbles = 2 * acos(fmin(fabs(product), 1)) > TUMBLE * dt;
        counts[tumbles ? HIT : RESCUE] += 1;
    }
    memory[IS_CARRIED] = is_carried;
}

/* Returns whether a kart loses more speed than brakes and the ground can take. A landing does not
   count: it increases the vertical velocity by more than the loss. */
static int is_jolted(const Box *then, const Box *now, double dt)
{
    const double *v = then->velocity, *w = now->velocity;
    const double x = w[0] - v[0], up = w[1] - v[1], z = w[2] - v[2];
    const double loss = -(x * v[0] + z * v[2]) / (hypot(v[0], v[2]) + 1e-9);
    const double limit = fmax(LOSS, BRAKES * dt) * (now->is_dragged ? DRAG : 1);
    return inner(then->axes[2], v) > FORWARDS && loss > limit && up <= loss;
}

/* ---------------------------------------------------------------- several karts */

static void count_ranks(const EventCounter *self, const Kart *then, const Kart *now)
{
    for (npy_intp i = 0; i < self->num_karts; i++) {
        for (npy_intp j = 0; j < self->num_karts; j++) {
            if (then[i].position <= then[j].position || now[i].position >= now[j].position ||
                then[i].has_finished_race || then[j].has_finished_race) {
                continue;
            }
            counts_of(self, i)[OVERTAKE] += 1;
            counts_of(self, j)[OVERTAKEN] += 1;
        }
    }
}

static int has_item(const Snapshot *snapshot, npy_int32 id)
{
    for (npy_int32 i = 0; i < snapshot->header->num_items; i++) {
        if (snapshot->items[i].id == id) return 1;
    }
    return 0;
}

/* Bubble gum that has disappeared counts as a hit of the nearest kart within GUM_REACH, unless that
   kart has a shield. */
static void count_gum(const EventCounter *self, const Snapshot *then, const Snapshot *now)
{
    for (npy_int32 n = 0; n < then->header->num_items; n++) {
        const Item *item = then->items + n;
        if (item->type != BUBBLE_GUM || has_item(now, item->id)) continue;
        npy_intp nearest = 0;
        double least = INFINITY;
        for (npy_intp i = 0; i < self->num_karts; i++) {
            const double far = apart(now->karts[i].location, item->location);
            if (far < least) least = far, nearest = i;
        }
        if (least < GUM_REACH && now->karts[nearest].attachment_type != ATTACHED_SHIELD) {
            counts_of(self, nearest)[HIT] += 1;
        }
    }
}

static void set_box(const Kart *kart, Box *box)
{
    float matrix[9];
    rotation_matrix(kart, matrix);
    for (int i = 0; i < 3; i++) {
        box->place[i] = kart->location[i];
        box->velocity[i] = kart->velocity[i];
        box->reach[i] = kart->size[i] / 2.0;
        for (int j = 0; j < 3; j++) box->axes[i][j] = matrix[3 * i + j];
    }
    const float *v = kart->velocity;
    box->is_dragged = kart->attachment_type == ATTACHED_PARACHUTE;
    box->is_carried = kart->speed == 0 && fabsf(v[0]) + fabsf(v[1]) + fabsf(v[2]) > 0.3f;
}

/* Returns the largest gap between two boxes along the axes of the first one [m], negative if they
   overlap along all of them. `way` is the vector from the first box to the second. */
static double gap_along(const Box *first, const Box *second, const double *way)
{
    double gap = fabs(inner(first->axes[1], way)) - first->reach[1] - second->reach[1];
    for (int axis = 0; axis < 3; axis += 2) {
        const double *along = first->axes[axis];
        double reach = first->reach[axis];
        for (int other = 0; other < 3; other += 2) {
            reach += fabs(inner(along, second->axes[other])) * second->reach[other];
        }
        gap = fmax(gap, fabs(inner(along, way)) - reach);
    }
    return gap;
}

/* Returns the smallest gap between two boxes within half of `ahead` [m]. `ahead` is the step size,
   or its negative to look back [s]. Returns infinity for boxes that are never near. */
static double least_gap(const Box *first, const Box *second, double ahead)
{
    double least = INFINITY, near = NEAR;
    double place = 0;
    for (int i = 0; i < 3; i++) {
        const double way = second->place[i] - first->place[i];
        place += way * way;
        near += first->reach[i] + second->reach[i] +
                0.5 * fabs(ahead * (second->velocity[i] - first->velocity[i]));
    }
    if (place > near * near) return least;
    for (int quarter = 0; quarter <= 2; quarter++) {
        double way[3];
        for (int i = 0; i < 3; i++) {
            way[i] = second->place[i] - first->place[i] +
                     0.25 * quarter * ahead * (second->velocity[i] - first->velocity[i]);
        }
        const double gap = fmax(gap_along(first, second, way), gap_along(second, first, way));
        least = fmin(least, gap);
    }
    return least;
}

/* Counts a contact if two karts touch; returns whether they are near each other. */
static int count_touch(const EventCounter *self, const Box *then, const Box *now, npy_intp i,
                       npy_intp j)
{
    const double dt = self->step_size;
    double *since = memory_of(self, i) + NUM_OWN + j, *same = memory_of(self, j) + NUM_OWN + i;
    double gap = INFINITY;
    if (!then[i].is_carried && !then[j].is_carried && !now[i].is_carried && !now[j].is_carried) {
        gap = fmin(least_gap(then + i, then + j, dt), least_gap(now + i, now + j, -dt));
    }
    if (gap <= TOUCH && *since <= 0) {
        counts_of(self, i)[KART_CONTACT] += 1;
        counts_of(self, j)[KART_CONTACT] += 1;
    }
    *since = *same = gap <= TOUCH ? APART : *since - dt;
    return gap <= NEAR;
}

/* Counts contacts with karts and walls; returns -1 with an exception set on failure. One block of
   memory holds the boxes of both snapshots and, for each kart, whether it is near another. */
static int count_contacts(const EventCounter *self, const Kart *before, const Kart *after)
{
    const npy_intp count = self->num_karts;
    Box *then = PyMem_Calloc((size_t)count, 2 * sizeof *then + 1), *now = then + count;
    char *is_near = (char *)(now + count);
    if (!then) return PyErr_NoMemory(), -1;
    for (npy_intp i = 0; i < count; i++) {
        set_box(before + i, then + i);
        set_box(after + i, now + i);
        for (npy_intp j = 0; j < i; j++) {
            if (count_touch(self, then, now, i, j)) is_near[i] = is_near[j] = 1;
        }
    }
    for (npy_intp i = 0; i < count; i++) {
        double *free_for = memory_of(self, i) + WALL_FOR, *counts = counts_of(self, i);
        const int is_carried = then[i].is_carried || now[i].is_carried ||
                               memory_of(self, i)[IS_CARRIED]; /* or set down at speed */
        const int is_bumped = !is_near[i] && counts[HIT] == 0 && !is_carried &&
                              is_jolted(then + i, now + i, self->step_size);
        counts[WALL_CONTACT] = is_bumped && *free_for <= 0;
        *free_for = is_bumped || is_carried ? APART : *free_for - self->step_size;
    }
    PyMem_Free(then);
    return 0;
}

/* ---------------------------------------------------------------- the type */

static int is_valid(const EventCounter *self, const Snapshot *snapshot)
{
    if (snapshot->header->num_kart != self->num_karts) {
        PyErr_Format(PyExc_ValueError, "a snapshot of another race, with %d karts",
                     snapshot->header->num_kart);
        return 0;
    }
    for (npy_intp i = 0; i < self->num_karts; i++) {
        const npy_intp node = snapshot->karts[i].node;
        if (node < 0 || node >= self->nodes.size / 6) return refuse("a kart is on no segment"), 0;
    }
    return 1;
}

/* count(before, after): counts the events between the bytes of two snapshots. */
static PyObject *counter_count(PyObject *object, PyObject *args)
{
    const EventCounter *self = (EventCounter *)object;
    Snapshot then, now;
    if (!PyArg_ParseTuple(args, "O&O&", as_snapshot, &then, as_snapshot, &now) ||
        !is_valid(self, &then) || !is_valid(self, &now)) {
        return NULL;
    }
    memset(self->counts.data, 0, (size_t)self->counts.size * sizeof(double));
    if (now.header->time <= then.header->time) Py_RETURN_NONE; /* karts cannot drive yet */
    for (npy_intp i = 0; i < self->num_karts; i++) {
        double *memory = memory_of(self, i), *counts = counts_of(self, i);
        time_kart(self, then.karts + i, now.karts + i, memory, counts);
        count_items(then.karts + i, now.karts + i, counts);
        count_ride(then.karts + i, now.karts + i, self->step_size, memory, counts);
    }
    count_ranks(self, then.karts, now.karts);
    count_gum(self, &then, &now);
    if (count_contacts(self, then.karts, now.karts) < 0) return NULL;
    Py_RETURN_NONE;
}

/* EventCounter(nodes, step_size, memory, counts) */
static int counter_set_up(EventCounter *self, PyObject *args, PyObject *Py_UNUSED(kwargs))
{
    if (!PyArg_ParseTuple(args, "O&dO&O&", as_floats, &self->nodes, &self->step_size,
                          as_written_doubles, &self->memory, as_written_doubles, &self->counts)) {
        return -1;
    }
    self->num_karts = self->counts.size / NUM_EVENTS;
    const int fits = self->counts.size == self->num_karts * NUM_EVENTS &&
                     self->memory.size == self->num_karts * (NUM_OWN + self->num_karts);
    return fits ? 0 : refuse("the arrays do not fit together");
}

KERNEL_TYPE(EventCounter, counter, "Counts the events of a race's karts.",
            {"count", counter_count, METH_VARARGS, "Counts the events between two snapshots."})
