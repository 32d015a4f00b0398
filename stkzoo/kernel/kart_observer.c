/* What karts see, from records to the values that an agent gets, in one pass.

   Its numpy twin is stkzoo.kernel.reference.kart_observer; the formulas are those of
   stkzoo.mdp.observations and of the wrappers in stkzoo.wrappers. */

#include "geometry.h"

#include <string.h>

enum { ITEMS, KARTS, PATHS, OWN }; /* what the rows of an entry are */
enum { NUMBER, CHOICE, NAME, CONTROL };

enum {
    KART_TYPE, AUX_TICKS, PHASE, POWERUP_TYPE, POWERUP_COUNT, ATTACHMENT, SKEED_FACTOR, ENERGY,
    ATTACHMENT_TIME_LEFT, SHIELD_TIME, VELOCITY, MAX_STEER_ANGLE, DISTANCE_DOWN_TRACK,
    CENTER_PATH_DISTANCE, CENTER_PATH, FRONT, JUMPING, ITEMS_POSITION, ITEMS_TYPE,
    KARTS_POSITION, PATHS_DISTANCE, PATHS_WIDTH, PATHS_START, PATHS_END, ITEMS_MASK, KARTS_MASK,
    PATHS_MASK, ACTION, NUM_KEYS
};

static const struct {
    const char *name;
    int kind, group, width;
} KEYS[NUM_KEYS] = {
    [KART_TYPE] = {"kart_type", NAME, OWN, 1},
    [AUX_TICKS] = {"aux_ticks", NUMBER, OWN, 1},
    [PHASE] = {"phase", CHOICE, OWN, 1},
    [POWERUP_TYPE] = {"powerup_type", CHOICE, OWN, 1},
    [POWERUP_COUNT] = {"powerup_count", CHOICE, OWN, 1},
    [ATTACHMENT] = {"attachment", CHOICE, OWN, 1},
    [SKEED_FACTOR] = {"skeed_factor", NUMBER, OWN, 1},
    [ENERGY] = {"energy", NUMBER, OWN, 1},
    [ATTACHMENT_TIME_LEFT] = {"attachment_time_left", NUMBER, OWN, 1},
    [SHIELD_TIME] = {"shield_time", NUMBER, OWN, 1},
    [VELOCITY] = {"velocity", NUMBER, OWN, 3},
    [MAX_STEER_ANGLE] = {"max_steer_angle", NUMBER, OWN, 1},
    [DISTANCE_DOWN_TRACK] = {"distance_down_track", NUMBER, OWN, 1},
    [CENTER_PATH_DISTANCE] = {"center_path_distance", NUMBER, OWN, 1},
    [CENTER_PATH] = {"center_path", NUMBER, OWN, 3},
    [FRONT] = {"front", NUMBER, OWN, 3},
    [JUMPING] = {"jumping", CHOICE, OWN, 1},
    [ITEMS_POSITION] = {"items_position", NUMBER, ITEMS, 3},
    [ITEMS_TYPE] = {"items_type", CHOICE, ITEMS, 1},
    [KARTS_POSITION] = {"karts_position", NUMBER, KARTS, 3},
    [PATHS_DISTANCE] = {"paths_distance", NUMBER, PATHS, 2},
    [PATHS_WIDTH] = {"paths_width", NUMBER, PATHS, 1},
    [PATHS_START] = {"paths_start", NUMBER, PATHS, 3},
    [PATHS_END] = {"paths_end", NUMBER, PATHS, 3},
    [ITEMS_MASK] = {"items_mask", NUMBER, ITEMS, 1},
    [KARTS_MASK] = {"karts_mask", NUMBER, KARTS, 1},
    [PATHS_MASK] = {"paths_mask", NUMBER, PATHS, 1},
    [ACTION] = {"action", CONTROL, OWN, 1},
};

typedef struct KartObserver KartObserver;

/* How a race is seen. */
typedef struct {
    TrackGraph *track;
    npy_intp num_paths;   /* segments that are seen */
    PyObject *kart_types; /* a tuple */
} Course;

/* stkzoo.mdp.spaces.POWERUP_COUNT_LIMIT */
enum { POWERUP_COUNT_LIMIT = 9 };

/* Tuples of rows that were handed out, oldest at `next`. One that nobody else holds any more, in
   whole or in part, is used again, which costs a tenth of making a new one. */
typedef struct {
    PyObject **tuples;
    Py_ssize_t size, next;
} Pool;

struct KartObserver {
    PyObject_HEAD
    Pool pools[NUM_KEYS];
    PyObject *names; /* tuple of the keys, in the order of the space */
    int num_entries;
    int keys[NUM_KEYS];
    int sizes[3]; /* rows of items, karts, paths; -1 for all there are */
    int is_polar, is_flat;
    int needs[4]; /* which groups the entries look at */
    npy_intp num_continuous, num_discrete; /* of a flat observer */
    PyObject *arrays;                      /* keeps alive what follows */
    const npy_intp *joined;                /* values of each choice; NULL if they stay choices */
    npy_intp num_ones;                     /* their sum */
    const npy_bool *nitro, *fire;          /* actions that need nitro, a powerup; NULL: no mask */
    npy_intp num_actions;
};

/* One moment of a race, and what one kart sees of it. */
typedef struct {
    const Course *course;
    const TrackGraph *track;
    const Header *header;
    const Kart *karts;
    const Item *items;
    /* of the present kart: */
    const Kart *me;
    float matrix[9], center_path[3], center_path_distance;
    float *seen[2];  /* items and karts in its frame */
    int *nearest[2]; /* their order */
    npy_intp num_nearest[2];
    const npy_int32 *ahead;
} Scene;

/* ---------------------------------------------------------------- geometry */

static void see(const Scene *scene, const float *point, float *out)
{
    to_kart_frame(scene->me, scene->matrix, point, out);
}

static void make_polar(float *v)
{
    const float x = v[0], y = v[1], z = v[2];
    v[2] = length(v);
    v[0] = atan2f(x, z);
    v[1] = atan2f(y, z);
}

static void find_center_path(Scene *scene)
{
    float start[3], end[3], along[3];
    const float *node = scene->track->nodes + 6 * scene->me->node;
    see(scene, node, start);
    see(scene, node + 3, end);
    for (int i = 0; i < 3; i++) along[i] = start[i] - end[i];
    const float squared = dot(along, along), share = dot(along, start) / squared;
    float *path = scene->center_path;
    for (int i = 0; i < 3; i++) path[i] = squared > 0 ? share * along[i] - start[i] : 0;
    scene->center_path_distance = path[0] < 0 ? -length(path) : length(path);
}

/* ---------------------------------------------------------------- what is near */

/* Inserts point number `which` where it belongs: what is in front by distance, then what is
   behind by distance; of equals the first stays first. Keeps no more than `limit`. */
static npy_intp insert(const float *points, float *keys, int *order, npy_intp count,
                       npy_intp limit, int which)
{
    const float *point = points + 3 * which;
    const float far = length(point);
    /* One number to compare: the distance, negative for what is behind. */
    const float key = point[2] < 0 ? -far : far;
    npy_intp low = 0, high = count;
    while (low < high) {
        const npy_intp middle = (low + high) / 2;
        const float other = keys[middle];
        const int is_before = key < 0 ? other < 0 && key > other : other < 0 || key < other;
        if (is_before) high = middle;
        else low = middle + 1;
    }
    if (low >= limit) return count;
    if (count < limit) count++;
    const size_t moved = (size_t)(count - 1 - low);
    memmove(keys + low + 1, keys + low, moved * sizeof *keys);
    memmove(order + low + 1, order + low, moved * sizeof *order);
    keys[low] = key;
    order[low] = which;
    return count;
}

static npy_intp shown(const KartObserver *observer, const Scene *scene, int group)
{
    const npy_intp there = group == ITEMS   ? scene->header->num_items
                           : group == KARTS ? scene->header->num_kart - 1
                                            : scene->course->num_paths;
    return observer->sizes[group] < 0 || there < observer->sizes[group] ? there : observer->sizes[group];
}

/* Finds the nearest items or karts. */
static void find_near(const KartObserver *observer, Scene *scene, int group, float *keys)
{
    const npy_intp limit = shown(observer, scene, group);
    const npy_intp there = group == ITEMS ? scene->header->num_items : scene->header->num_kart;
    npy_intp count = 0;
    for (npy_intp i = 0; i < there; i++) {
        if (group == KARTS && scene->karts + i == scene->me) continue;
        see(scene, group == ITEMS ? scene->items[i].location : scene->karts[i].location,
            scene->seen[group] + 3 * i);
        count = insert(scene->seen[group], keys, scene->nearest[group], count, limit, (int)i);
    }
    scene->num_nearest[group] = count;
}

/* ---------------------------------------------------------------- entries */

static npy_int64 choice_of(const Scene *scene, int key)
{
    const Kart *me = scene->me;
    switch (key) {
    case PHASE: return scene->header->phase;
    case POWERUP_TYPE: return me->powerup_type;
    case POWERUP_COUNT:
        return me->powerup_num < POWERUP_COUNT_LIMIT ? me->powerup_num : POWERUP_COUNT_LIMIT;
    case ATTACHMENT: return me->attachment_type;
    default: return me->jumping;
    }
}

/* The rows of an entry: how many there are to show, and how many of them are real. */
static npy_intp rows_of(const KartObserver *observer, const Scene *scene, int key, npy_intp *real)
{
    const int group = KEYS[key].group;
    if (group == OWN) return *real = 1;
    *real = shown(observer, scene, group);
    return observer->sizes[group] < 0 ? *real : observer->sizes[group];
}

static void write_choices(const KartObserver *observer, const Scene *scene, int key, npy_int64 *out)
{
    npy_intp real;
    const npy_intp rows = rows_of(observer, scene, key, &real);
    if (KEYS[key].group == OWN) {
        *out = choice_of(scene, key);
        return;
    }
    for (npy_intp i = 0; i < rows; i++) {
        out[i] = i < real ? scene->items[scene->nearest[ITEMS][i]].type : 0;
    }
}

static void write_near(const Scene *scene, int group, npy_intp real, float *out)
{
    for (npy_intp i = 0; i < real; i++) {
        const float *point = scene->seen[group] + 3 * scene->nearest[group][i];
        memcpy(out + 3 * i, point, 3 * sizeof *point);
    }
}

static void write_own(const Scene *scene, int key, float *out)
{
    const Kart *me = scene->me;
    switch (key) {
    case AUX_TICKS: *out = scene->header->aux_ticks; break;
    case SKEED_FACTOR: *out = me->skeed_factor; break;
    case ENERGY: *out = me->energy; break;
    case ATTACHMENT_TIME_LEFT: *out = me->attachment_time_left; break;
    case SHIELD_TIME: *out = me->shield_time; break;
    case MAX_STEER_ANGLE: *out = me->max_steer_angle; break;
    case DISTANCE_DOWN_TRACK: *out = me->distance_down_track; break;
    case CENTER_PATH_DISTANCE: *out = scene->center_path_distance; break;
    case VELOCITY: memcpy(out, me->velocity_lc, sizeof me->velocity_lc); break;
    case CENTER_PATH: memcpy(out, scene->center_path, sizeof scene->center_path); break;
    default: see(scene, me->front, out); break;
    }
}

static void write_numbers(const KartObserver *observer, const Scene *scene, int key, float *out)
{
    const TrackGraph *track = scene->track;
    npy_intp real;
    const npy_intp rows = rows_of(observer, scene, key, &real);
    const int width = KEYS[key].width;
    for (npy_intp i = real * width; i < rows * width; i++) out[i] = 0;
    switch (key) {
    case ITEMS_POSITION: write_near(scene, ITEMS, real, out); break;
    case KARTS_POSITION: write_near(scene, KARTS, real, out); break;
    case PATHS_DISTANCE:
        for (npy_intp i = 0; i < real; i++) {
            memcpy(out + 2 * i, track->distances + 2 * scene->ahead[i], 2 * sizeof *out);
        }
        break;
    case PATHS_WIDTH:
        for (npy_intp i = 0; i < real; i++) out[i] = track->widths[scene->ahead[i]];
        break;
    case PATHS_START:
        for (npy_intp i = 0; i < real; i++) see(scene, track->nodes + 6 * scene->ahead[i], out + 3 * i);
        break;
    case PATHS_END:
        for (npy_intp i = 0; i < real; i++) {
            see(scene, track->nodes + 6 * scene->ahead[i] + 3, out + 3 * i);
        }
        break;
    case ITEMS_MASK:
    case KARTS_MASK:
    case PATHS_MASK:
        for (npy_intp i = 0; i < real; i++) out[i] = 1;
        break;
    default: write_own(scene, key, out);
    }
    const int is_place = key == CENTER_PATH || (KEYS[key].group != OWN && width == 3);
    if (observer->is_polar && is_place) {
        for (npy_intp i = 0; i < real; i++) make_polar(out + 3 * i);
    }
}

/* ---------------------------------------------------------------- as Python's values */

static PyObject *new_array(int dimensions, npy_intp *shape, int type, void **data)
{
    PyObject *array = PyArray_SimpleNew(dimensions, shape, type);
    if (array) *data = PyArray_DATA((PyArrayObject *)array);
    return array;
}

/* Room for three calls' tuples: those of the calls before may be held while this one makes its. */
static int grow(Pool *pool, Py_ssize_t count)
{
    const Py_ssize_t size = 3 * count;
    if (size <= pool->size) return 0;
    PyObject **tuples = PyMem_Realloc(pool->tuples, (size_t)size * sizeof *tuples);
    if (!tuples) {
        PyErr_NoMemory();
        return -1;
    }
    memset(tuples + pool->size, 0, (size_t)(size - pool->size) * sizeof *tuples);
    pool->tuples = tuples;
    pool->size = size;
    return 0;
}

/* The numbers behind a tuple's rows, if the rows are as they were made and nobody holds the tuple,
   a row, or an array that looks into one (it would hold the block that the rows look into). */
static float *free_block(PyObject *tuple, npy_intp rows, int width)
{
    if (!tuple || Py_REFCNT(tuple) != 1 || PyTuple_GET_SIZE(tuple) != rows) return NULL;
    PyObject *block = PyArray_BASE((PyArrayObject *)PyTuple_GET_ITEM(tuple, 0));
    if (Py_REFCNT(block) != rows) return NULL;
    float *data = PyArray_DATA((PyArrayObject *)block);
    for (npy_intp i = 0; i < rows; i++) {
        PyArrayObject *row = (PyArrayObject *)PyTuple_GET_ITEM(tuple, i);
        if (Py_REFCNT(row) != 1 || PyArray_DATA(row) != data + width * i ||
            PyArray_NDIM(row) != 1 || PyArray_TYPE(row) != NPY_FLOAT32 ||
            !PyArray_CHKFLAGS(row, NPY_ARRAY_C_CONTIGUOUS | NPY_ARRAY_WRITEABLE)) {
            return NULL;
        }
    }
    return data;
}

/* A tuple of the rows of a new block. */
static PyObject *new_rows(npy_intp rows, npy_intp width, float **data)
{
    npy_intp shape[2] = {rows, width};
    PyObject *block = PyArray_SimpleNew(2, shape, NPY_FLOAT32);
    PyObject *tuple = block ? PyTuple_New(rows) : NULL;
    if (block) *data = PyArray_DATA((PyArrayObject *)block);
    for (npy_intp i = 0; tuple && i < rows; i++) {
        PyObject *row = PyArray_SimpleNewFromData(1, &width, NPY_FLOAT32, *data + width * i);
        if (!row) {
            Py_CLEAR(tuple);
            break;
        }
        PyTuple_SET_ITEM(tuple, i, row);
        Py_INCREF(block);
        PyArray_SetBaseObject((PyArrayObject *)row, block);
    }
    Py_XDECREF(block);
    return tuple;
}

/* A tuple of arrays, one for each row, that nobody else holds. */
static PyObject *number_rows(KartObserver *observer, const Scene *scene, int key)
{
    Pool *pool = observer->pools + key;
    npy_intp real;
    const npy_intp rows = rows_of(observer, scene, key, &real);
    if (rows == 0) return PyTuple_New(0);
    PyObject **place = pool->tuples + pool->next;
    pool->next = (pool->next + 1) % pool->size;
    float *data = free_block(*place, rows, KEYS[key].width);
    if (!data) {
        PyObject *tuple = new_rows(rows, KEYS[key].width, &data);
        if (!tuple) return NULL;
        Py_XSETREF(*place, tuple);
    }
    write_numbers(observer, scene, key, data);
    Py_INCREF(*place);
    return *place;
}

static PyObject *choice_rows(const Scene *scene)
{
    const npy_intp rows = scene->num_nearest[ITEMS];
    PyArray_Descr *type = PyArray_DescrFromType(NPY_INT64);
    PyObject *tuple = PyTuple_New(rows);
    for (npy_intp i = 0; tuple && i < rows; i++) {
        npy_int64 value = scene->items[scene->nearest[ITEMS][i]].type;
        PyObject *scalar = PyArray_Scalar(&value, type, NULL);
        if (!scalar) Py_CLEAR(tuple);
        else PyTuple_SET_ITEM(tuple, i, scalar);
    }
    Py_DECREF(type);
    return tuple;
}

static PyObject *mask(const KartObserver *observer, const Scene *scene, int key)
{
    npy_intp real, rows = rows_of(observer, scene, key, &real);
    void *data;
    PyObject *array = new_array(1, &rows, NPY_INT8, &data);
    for (npy_intp i = 0; array && i < rows; i++) ((npy_int8 *)data)[i] = i < real;
    return array;
}

static int set_entry(PyObject *dict, const char *name, PyObject *value)
{
    const int status = value ? PyDict_SetItemString(dict, name, value) : -1;
    Py_XDECREF(value);
    return status;
}

/* What the kart's driver does, as an action. */
static PyObject *control_of(const Kart *me)
{
    /* In the order of the action space's keys; columns as in stkzoo.engine.snapshot.CONTROLS. */
    static const struct {
        const char *name;
        int column;
    } PARTS[NUM_CONTROLS] = {{"acceleration", 0}, {"brake", 2}, {"drift", 3}, {"fire", 4},
                             {"nitro", 5},        {"rescue", 6}, {"steer", 1}};
    PyObject *dict = PyDict_New();
    for (int i = 0; dict && i < NUM_CONTROLS; i++) {
        npy_intp one = 1;
        void *data = NULL;
        const int column = PARTS[i].column, is_number = column < 2;
        PyObject *value = is_number ? new_array(1, &one, NPY_FLOAT32, &data)
                                    : PyLong_FromLong((long)me->control[column]);
        if (value && is_number) memcpy(data, me->control + column, sizeof(float));
        if (set_entry(dict, PARTS[i].name, value) < 0) Py_CLEAR(dict);
    }
    return dict;
}

/* The value of one entry in Gymnasium's form. */
static PyObject *value_of(KartObserver *observer, const Scene *scene, int key)
{
    const int kind = KEYS[key].kind, group = KEYS[key].group;
    npy_intp real, shape[2];
    void *data;
    PyObject *array;
    if (kind == NAME) {
        PyObject *name = PyTuple_GetItem(scene->course->kart_types, scene->me - scene->karts);
        Py_XINCREF(name);
        return name;
    }
    if (group == OWN && kind == CHOICE) return PyLong_FromLongLong(choice_of(scene, key));
    if (group != OWN && observer->sizes[group] < 0) {
        return kind == CHOICE ? choice_rows(scene) : number_rows(observer, scene, key);
    }
    if (kind == CONTROL) return control_of(scene->me);
    if (key >= ITEMS_MASK) return mask(observer, scene, key);
    shape[0] = rows_of(observer, scene, key, &real);
    shape[1] = KEYS[key].width;
    if (kind == CHOICE) {
        if ((array = new_array(1, shape, NPY_INT64, &data))) write_choices(observer, scene, key, data);
        return array;
    }
    array = group == OWN ? new_array(1, shape + 1, NPY_FLOAT32, &data)
                         : new_array(2, shape, NPY_FLOAT32, &data);
    if (array) write_numbers(observer, scene, key, data);
    return array;
}

static PyObject *as_dict(KartObserver *observer, const Scene *scene)
{
    PyObject *dict = PyDict_New();
    for (int i = 0; dict && i < observer->num_entries; i++) {
        PyObject *value = value_of(observer, scene, observer->keys[i]);
        if (!value || PyDict_SetItem(dict, PyTuple_GET_ITEM(observer->names, i), value) < 0) {
            Py_CLEAR(dict);
        }
        Py_XDECREF(value);
    }
    return dict;
}

static void write_flat(const KartObserver *observer, const Scene *scene, float *numbers, npy_int64 *choices)
{
    for (int i = 0; i < observer->num_entries; i++) {
        const int key = observer->keys[i];
        npy_intp real;
        const npy_intp rows = rows_of(observer, scene, key, &real);
        if (KEYS[key].kind == CHOICE) {
            write_choices(observer, scene, key, choices);
            choices += rows;
        } else {
            write_numbers(observer, scene, key, numbers);
            numbers += rows * KEYS[key].width;
        }
    }
}

/* 1 for actions that can do something, 0 for those that need nitro or a powerup in vain. */
static PyObject *action_mask(const KartObserver *observer, const Kart *me)
{
    npy_intp count = observer->num_actions;
    void *data;
    PyObject *array = new_array(1, &count, NPY_INT8, &data);
    const int no_nitro = !(me->energy > 0), no_powerup = me->powerup_type == 0;
    for (npy_intp i = 0; array && i < count; i++) {
        const int is_vain = (no_nitro && observer->nitro[i]) || (no_powerup && observer->fire[i]);
        ((npy_int8 *)data)[i] = !is_vain;
    }
    return array;
}

/* Choices as one place for each of their values, 1 where it holds. */
static int write_ones(const KartObserver *observer, const npy_int64 *choices, float *ones)
{
    memset(ones, 0, (size_t)observer->num_ones * sizeof *ones);
    for (npy_intp i = 0; i < observer->num_discrete; ones += observer->joined[i++]) {
        if (choices[i] < 0 || choices[i] >= observer->joined[i]) {
            PyErr_Format(PyExc_IndexError, "choice %zd is out of its range", i);
            return -1;
        }
        ones[choices[i]] = 1;
    }
    return 0;
}

static PyObject *as_one_vector(const KartObserver *observer, const Scene *scene)
{
    npy_intp size = observer->num_continuous + observer->num_ones;
    void *data = NULL;
    npy_int64 *choices = PyMem_Malloc((size_t)(observer->num_discrete + 1) * sizeof *choices);
    PyObject *array = choices ? new_array(1, &size, NPY_FLOAT32, &data) : PyErr_NoMemory();
    if (array) {
        float *numbers = data;
        write_flat(observer, scene, numbers, choices);
        if (write_ones(observer, choices, numbers + observer->num_continuous) < 0) Py_CLEAR(array);
    }
    PyMem_Free(choices);
    return array;
}

static int set_two_vectors(const KartObserver *observer, const Scene *scene, PyObject *dict)
{
    void *numbers = NULL, *choices = NULL;
    npy_intp sizes[2] = {observer->num_continuous, observer->num_discrete};
    PyObject *continuous = new_array(1, sizes, NPY_FLOAT32, &numbers);
    PyObject *discrete = new_array(1, sizes + 1, NPY_INT64, &choices);
    if (continuous && discrete) write_flat(observer, scene, numbers, choices);
    const int failed = set_entry(dict, "continuous", continuous) < 0;
    return set_entry(dict, "discrete", discrete) < 0 || failed ? -1 : 0;
}

/* The observation of a flat view; in a dict, if it is more than one vector, in the order of the
   space's keys. */
static PyObject *as_vectors(const KartObserver *observer, const Scene *scene)
{
    if (observer->joined && !observer->nitro) return as_one_vector(observer, scene);
    PyObject *dict = PyDict_New();
    int status = dict ? 0 : -1;
    if (!status && observer->nitro) {
        status = set_entry(dict, "action_mask", action_mask(observer, scene->me));
    }
    if (!status && observer->joined) {
        status = set_entry(dict, "observation", as_one_vector(observer, scene));
    } else if (!status) {
        status = set_two_vectors(observer, scene, dict);
    }
    if (status) Py_CLEAR(dict);
    return dict;
}

/* ---------------------------------------------------------------- the type */

/* Takes a kart's place. */
static int look(const KartObserver *observer, Scene *scene, npy_intp kart, float *keys)
{
    if (kart < 0 || kart >= scene->header->num_kart) {
        PyErr_Format(PyExc_IndexError, "kart %zd of %d", kart, scene->header->num_kart);
        return -1;
    }
    scene->me = scene->karts + kart;
    if (!(scene->ahead = nodes_ahead(scene->course->track, scene->me->node))) return -1;
    rotation_matrix(scene->me, scene->matrix);
    if (observer->needs[OWN]) find_center_path(scene);
    if (observer->needs[ITEMS]) find_near(observer, scene, ITEMS, keys);
    if (observer->needs[KARTS]) find_near(observer, scene, KARTS, keys);
    return 0;
}

/* Room for what one kart sees: places and their order, and sort keys. */
static float *scratch_for(Scene *scene, float **keys)
{
    const npy_intp items = scene->header->num_items, karts = scene->header->num_kart;
    const npy_intp words = 4 * (items + karts) + (items > karts ? items : karts);
    float *room = PyMem_Malloc((size_t)(words + 1) * sizeof *room);
    if (!room) return (float *)PyErr_NoMemory();
    scene->seen[ITEMS] = room;
    scene->seen[KARTS] = scene->seen[ITEMS] + 3 * items;
    scene->nearest[ITEMS] = (int *)(scene->seen[KARTS] + 3 * karts);
    scene->nearest[KARTS] = scene->nearest[ITEMS] + items;
    *keys = (float *)(scene->nearest[KARTS] + karts);
    return room;
}

static int set_course(Course *course, PyObject *track, PyObject *num_paths, PyObject *kart_types)
{
    if (!PyObject_TypeCheck(track, &TrackGraphType) || !PyTuple_Check(kart_types)) {
        PyErr_SetString(PyExc_TypeError, "a course is a TrackGraph, a number and a tuple");
        return -1;
    }
    course->track = (TrackGraph *)track;
    course->num_paths = PyLong_AsSsize_t(num_paths);
    course->kart_types = kart_types;
    if (PyErr_Occurred()) return -1;
    if (course->num_paths < 0 || course->num_paths > course->track->num_nodes) {
        PyErr_Format(PyExc_ValueError, "%zd of %zd segments", course->num_paths,
                     course->track->num_nodes);
        return -1;
    }
    return 0;
}

/* One observation for each of some karts; -1 with an exception set. */
static int observe(KartObserver *observer, const Course *course, const Moment *moment, const npy_intp *who,
            npy_intp count, PyObject **out)
{
    Scene scene = {.course = course, .track = course->track, .header = moment->header,
                   .karts = moment->karts, .items = moment->items};
    float *keys = NULL, *room = scratch_for(&scene, &keys);
    int status = room ? 0 : -1;
    for (int key = 0; !status && !observer->is_flat && key < NUM_KEYS; key++) {
        status = grow(observer->pools + key, count);
    }
    for (npy_intp i = 0; !status && i < count; i++) {
        status = look(observer, &scene, who[i], keys);
        out[i] = status ? NULL : observer->is_flat ? as_vectors(observer, &scene) : as_dict(observer, &scene);
        if (!out[i]) {
            while (i-- > 0) Py_CLEAR(out[i]);
            status = -1;
        }
    }
    PyMem_Free(room);
    return status;
}

/* observe(track, num_paths, kart_types, data, who): one observation for each kart of `who`, in a
   list. */
static PyObject *observer_observe(PyObject *self, PyObject *const *args, Py_ssize_t nargs)
{
    Course course;
    Moment moment;
    npy_intp count;
    if (nargs != 5) return PyErr_Format(PyExc_TypeError, "observe() takes 5 arguments");
    if (set_course(&course, args[0], args[1], args[2]) < 0) return NULL;
    if (read_moment(args[3], &moment) < 0) return NULL;
    const npy_intp *who = numbers_of(args[4], "who", NPY_INTP, &count);
    PyObject **seen = who ? PyMem_Calloc((size_t)count + 1, sizeof *seen) : NULL;
    if (!seen) return who ? PyErr_NoMemory() : NULL;
    PyObject *list = observe((KartObserver *)self, &course, &moment, who, count, seen) < 0
                         ? NULL
                         : PyList_New(count);
    for (npy_intp i = 0; list && i < count; i++) PyList_SET_ITEM(list, i, seen[i]);
    PyMem_Free(seen);
    return list;
}

static int add_entry(KartObserver *observer, const char *name)
{
    for (int key = 0; key < NUM_KEYS; key++) {
        if (strcmp(KEYS[key].name, name) == 0) {
            const int group = KEYS[key].group;
            if (KEYS[key].kind == CONTROL && observer->is_flat) break;
            const npy_intp rows = group == OWN ? 1 : observer->sizes[group];
            observer->needs[group] = 1;
            observer->keys[observer->num_entries++] = key;
            if (KEYS[key].kind == CHOICE) observer->num_discrete += rows;
            else observer->num_continuous += rows * KEYS[key].width;
            return 0;
        }
    }
    PyErr_Format(PyExc_ValueError, "no entry is called %s", name);
    return -1;
}

/* What a flat view has beside its two vectors. */
static int set_extras(KartObserver *observer, PyObject *joined, PyObject *nitro, PyObject *fire)
{
    npy_intp count = 0, num_fire = 0;
    if (joined != Py_None) {
        if (!(observer->joined = numbers_of(joined, "joined", NPY_INTP, &count))) return -1;
        for (npy_intp i = 0; i < count; i++) observer->num_ones += observer->joined[i];
        if (!observer->is_flat || count != observer->num_discrete) {
            PyErr_SetString(PyExc_ValueError, "joined has one count for each choice of a flat view");
            return -1;
        }
    }
    if (nitro != Py_None) {
        if (!(observer->nitro = numbers_of(nitro, "nitro", NPY_BOOL, &observer->num_actions)) ||
            !(observer->fire = numbers_of(fire, "fire", NPY_BOOL, &num_fire))) {
            return -1;
        }
        if (!observer->is_flat || num_fire != observer->num_actions) {
            PyErr_SetString(PyExc_ValueError, "a mask is part of a flat view, as long as nitro");
            return -1;
        }
    }
    observer->arrays = PyTuple_Pack(3, joined, nitro, fire);
    return observer->arrays ? 0 : -1;
}

static PyObject *observer_new(PyTypeObject *type, PyObject *args, PyObject *kwargs)
{
    static char *words[] = {"names", "items", "karts",  "paths", "polar",
                            "flat",  "joined", "nitro", "fire",  NULL};
    PyObject *joined = Py_None, *nitro = Py_None, *fire = Py_None;
    KartObserver *observer = (KartObserver *)type->tp_alloc(type, 0);
    if (!observer) return NULL;
    int *sizes = observer->sizes;
    sizes[ITEMS] = sizes[KARTS] = sizes[PATHS] = -1;
    if (!PyArg_ParseTupleAndKeywords(args, kwargs, "O!|iiippOOO", words, &PyTuple_Type,
                                     &observer->names, sizes + ITEMS, sizes + KARTS,
                                     sizes + PATHS, &observer->is_polar, &observer->is_flat,
                                     &joined, &nitro, &fire)) {
        observer->names = NULL;
        Py_DECREF(observer);
        return NULL;
    }
    Py_INCREF(observer->names);
    const Py_ssize_t count = PyTuple_GET_SIZE(observer->names);
    if (count > NUM_KEYS) {
        PyErr_SetString(PyExc_ValueError, "too many entries");
    } else if (observer->is_flat && (sizes[0] < 0 || sizes[1] < 0 || sizes[2] < 0)) {
        PyErr_SetString(PyExc_ValueError, "a flat view has a fixed size");
    }
    for (Py_ssize_t i = 0; !PyErr_Occurred() && i < count; i++) {
        const char *name = PyUnicode_AsUTF8(PyTuple_GET_ITEM(observer->names, i));
        if (name) add_entry(observer, name);
    }
    if (!PyErr_Occurred()) set_extras(observer, joined, nitro, fire);
    if (PyErr_Occurred()) Py_CLEAR(observer);
    return (PyObject *)observer;
}

static void observer_dealloc(PyObject *self)
{
    KartObserver *observer = (KartObserver *)self;
    for (int key = 0; key < NUM_KEYS; key++) {
        Pool *pool = observer->pools + key;
        for (Py_ssize_t i = 0; i < pool->size; i++) Py_XDECREF(pool->tuples[i]);
        PyMem_Free(pool->tuples);
    }
    Py_XDECREF(observer->names);
    Py_XDECREF(observer->arrays);
    Py_TYPE(self)->tp_free(self);
}

static PyMethodDef observer_methods[] = {
    FAST_METHOD("observe", observer_observe, "One observation for each kart, in a list."),
    {NULL, NULL, 0, NULL},
};

KERNEL_TYPE(KartObserver, observer, "What is shown to agents of one observer.")
