/* What karts see, from records to the values that an agent gets, in one pass.

   The formulas are those of stkzoo.mdp.observations, stkzoo.wrappers.polar,
   stkzoo.wrappers.constant_size and stkzoo.wrappers.space_flattener. */

#include "geometry.h"

#include <string.h>

enum { ITEMS, KARTS, PATHS, OWN }; /* what the rows of an entry are */
enum { NUMBER, CHOICE, NAME };

enum {
    KART_TYPE, AUX_TICKS, PHASE, POWERUP_TYPE, POWERUP_COUNT, ATTACHMENT, SKEED_FACTOR, ENERGY,
    ATTACHMENT_TIME_LEFT, SHIELD_TIME, VELOCITY, MAX_STEER_ANGLE, DISTANCE_DOWN_TRACK,
    CENTER_PATH_DISTANCE, CENTER_PATH, FRONT, JUMPING, ITEMS_POSITION, ITEMS_TYPE,
    KARTS_POSITION, PATHS_DISTANCE, PATHS_WIDTH, PATHS_START, PATHS_END, ITEMS_MASK, KARTS_MASK,
    PATHS_MASK, NUM_KEYS
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
};

/* stkzoo.mdp.spaces.POWERUP_COUNT_LIMIT */
enum { POWERUP_COUNT_LIMIT = 9 };

/* Tuples of rows that were handed out, oldest at `next`. One that nobody else holds any more, in
   whole or in part, is used again, which costs a tenth of making a new one. */
typedef struct {
    PyObject **tuples;
    Py_ssize_t size, next;
} Pool;

struct View {
    PyObject_HEAD
    Pool pools[NUM_KEYS];
    PyObject *names; /* tuple of the keys, in the order of the space */
    int num_entries;
    int keys[NUM_KEYS];
    int sizes[3]; /* rows of items, karts, paths; -1 for all there are */
    int is_polar, is_flat;
    int needs[4]; /* which groups the entries look at */
    npy_intp num_continuous, num_discrete; /* of a flat view */
};

/* One moment of a race, and what one kart sees of it. */
typedef struct {
    const Course *course;
    const Track *track;
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

static npy_intp shown(const View *view, const Scene *scene, int group)
{
    const npy_intp there = group == ITEMS   ? scene->header->num_items
                           : group == KARTS ? scene->header->num_kart - 1
                                            : scene->course->num_paths;
    return view->sizes[group] < 0 || there < view->sizes[group] ? there : view->sizes[group];
}

static void find_items(const View *view, Scene *scene, float *keys)
{
    const npy_intp limit = shown(view, scene, ITEMS);
    npy_intp count = 0;
    for (npy_intp i = 0; i < scene->header->num_items; i++) {
        see(scene, scene->items[i].location, scene->seen[ITEMS] + 3 * i);
        count = insert(scene->seen[ITEMS], keys, scene->nearest[ITEMS], count, limit, (int)i);
    }
    scene->num_nearest[ITEMS] = count;
}

static void find_karts(const View *view, Scene *scene, float *keys)
{
    const npy_intp limit = shown(view, scene, KARTS);
    npy_intp count = 0;
    for (npy_intp i = 0; i < scene->header->num_kart; i++) {
        if (scene->karts + i == scene->me) continue;
        see(scene, scene->karts[i].location, scene->seen[KARTS] + 3 * i);
        count = insert(scene->seen[KARTS], keys, scene->nearest[KARTS], count, limit, (int)i);
    }
    scene->num_nearest[KARTS] = count;
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
static npy_intp rows_of(const View *view, const Scene *scene, int key, npy_intp *real)
{
    const int group = KEYS[key].group;
    if (group == OWN) return *real = 1;
    *real = shown(view, scene, group);
    return view->sizes[group] < 0 ? *real : view->sizes[group];
}

static void write_choices(const View *view, const Scene *scene, int key, npy_int64 *out)
{
    npy_intp real;
    const npy_intp rows = rows_of(view, scene, key, &real);
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

static void write_numbers(const View *view, const Scene *scene, int key, float *out)
{
    const Track *track = scene->track;
    npy_intp real;
    const npy_intp rows = rows_of(view, scene, key, &real);
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
    if (view->is_polar && is_place) {
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
static PyObject *number_rows(View *view, const Scene *scene, int key)
{
    Pool *pool = view->pools + key;
    npy_intp real;
    const npy_intp rows = rows_of(view, scene, key, &real);
    if (rows == 0) return PyTuple_New(0);
    PyObject **place = pool->tuples + pool->next;
    pool->next = (pool->next + 1) % pool->size;
    float *data = free_block(*place, rows, KEYS[key].width);
    if (!data) {
        PyObject *tuple = new_rows(rows, KEYS[key].width, &data);
        if (!tuple) return NULL;
        Py_XSETREF(*place, tuple);
    }
    write_numbers(view, scene, key, data);
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

static PyObject *mask(const View *view, const Scene *scene, int key)
{
    npy_intp real, rows = rows_of(view, scene, key, &real);
    void *data;
    PyObject *array = new_array(1, &rows, NPY_INT8, &data);
    for (npy_intp i = 0; array && i < rows; i++) ((npy_int8 *)data)[i] = i < real;
    return array;
}

/* The value of one entry in Gymnasium's form. */
static PyObject *value_of(View *view, const Scene *scene, int key)
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
    if (group != OWN && view->sizes[group] < 0) {
        return kind == CHOICE ? choice_rows(scene) : number_rows(view, scene, key);
    }
    if (key >= ITEMS_MASK) return mask(view, scene, key);
    shape[0] = rows_of(view, scene, key, &real);
    shape[1] = KEYS[key].width;
    if (kind == CHOICE) {
        if ((array = new_array(1, shape, NPY_INT64, &data))) write_choices(view, scene, key, data);
        return array;
    }
    array = group == OWN ? new_array(1, shape + 1, NPY_FLOAT32, &data)
                         : new_array(2, shape, NPY_FLOAT32, &data);
    if (array) write_numbers(view, scene, key, data);
    return array;
}

static PyObject *as_dict(View *view, const Scene *scene)
{
    PyObject *dict = PyDict_New();
    for (int i = 0; dict && i < view->num_entries; i++) {
        PyObject *value = value_of(view, scene, view->keys[i]);
        if (!value || PyDict_SetItem(dict, PyTuple_GET_ITEM(view->names, i), value) < 0) {
            Py_CLEAR(dict);
        }
        Py_XDECREF(value);
    }
    return dict;
}

static void write_flat(const View *view, const Scene *scene, float *numbers, npy_int64 *choices)
{
    for (int i = 0; i < view->num_entries; i++) {
        const int key = view->keys[i];
        npy_intp real;
        const npy_intp rows = rows_of(view, scene, key, &real);
        if (KEYS[key].kind == CHOICE) {
            write_choices(view, scene, key, choices);
            choices += rows;
        } else {
            write_numbers(view, scene, key, numbers);
            numbers += rows * KEYS[key].width;
        }
    }
}

static PyObject *as_vectors(View *view, const Scene *scene)
{
    void *numbers = NULL, *choices = NULL;
    PyObject *continuous = new_array(1, &view->num_continuous, NPY_FLOAT32, &numbers);
    PyObject *discrete = new_array(1, &view->num_discrete, NPY_INT64, &choices);
    PyObject *dict = continuous && discrete ? PyDict_New() : NULL;
    if (dict) {
        write_flat(view, scene, numbers, choices);
        if (PyDict_SetItemString(dict, "continuous", continuous) < 0 ||
            PyDict_SetItemString(dict, "discrete", discrete) < 0) {
            Py_CLEAR(dict);
        }
    }
    Py_XDECREF(continuous);
    Py_XDECREF(discrete);
    return dict;
}

/* ---------------------------------------------------------------- the type */

/* Takes a kart's place. */
static int look(const View *view, Scene *scene, npy_intp kart, float *keys)
{
    if (kart < 0 || kart >= scene->header->num_kart) {
        PyErr_Format(PyExc_IndexError, "kart %zd of %d", kart, scene->header->num_kart);
        return -1;
    }
    scene->me = scene->karts + kart;
    if (!(scene->ahead = nodes_ahead(scene->course->track, scene->me->node))) return -1;
    rotation_matrix(scene->me, scene->matrix);
    if (view->needs[OWN]) find_center_path(scene);
    if (view->needs[ITEMS]) find_items(view, scene, keys);
    if (view->needs[KARTS]) find_karts(view, scene, keys);
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

int set_course(Course *course, PyObject *track, PyObject *num_paths, PyObject *kart_types)
{
    if (!PyObject_TypeCheck(track, &TrackType) || !PyTuple_Check(kart_types)) {
        PyErr_SetString(PyExc_TypeError, "a course is a Track, a number and a tuple");
        return -1;
    }
    course->track = (Track *)track;
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

int observe(View *view, const Course *course, const Moment *moment, const npy_intp *who,
            npy_intp count, PyObject **out)
{
    Scene scene = {.course = course, .track = course->track, .header = moment->header,
                   .karts = moment->karts, .items = moment->items};
    float *keys = NULL, *room = scratch_for(&scene, &keys);
    int status = room ? 0 : -1;
    for (int key = 0; !status && !view->is_flat && key < NUM_KEYS; key++) {
        status = grow(view->pools + key, count);
    }
    for (npy_intp i = 0; !status && i < count; i++) {
        status = look(view, &scene, who[i], keys);
        out[i] = status ? NULL : view->is_flat ? as_vectors(view, &scene) : as_dict(view, &scene);
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
static PyObject *view_observe(PyObject *self, PyObject *const *args, Py_ssize_t nargs)
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
    PyObject *list = observe((View *)self, &course, &moment, who, count, seen) < 0
                         ? NULL
                         : PyList_New(count);
    for (npy_intp i = 0; list && i < count; i++) PyList_SET_ITEM(list, i, seen[i]);
    PyMem_Free(seen);
    return list;
}

static int add_entry(View *view, const char *name)
{
    for (int key = 0; key < NUM_KEYS; key++) {
        if (strcmp(KEYS[key].name, name) == 0) {
            const int group = KEYS[key].group;
            const npy_intp rows = group == OWN ? 1 : view->sizes[group];
            view->needs[group] = 1;
            view->keys[view->num_entries++] = key;
            if (KEYS[key].kind == CHOICE) view->num_discrete += rows;
            else view->num_continuous += rows * KEYS[key].width;
            return 0;
        }
    }
    PyErr_Format(PyExc_ValueError, "no entry is called %s", name);
    return -1;
}

static PyObject *view_new(PyTypeObject *type, PyObject *args, PyObject *kwargs)
{
    static char *words[] = {"names", "items", "karts", "paths", "polar", "flat", NULL};
    View *view = (View *)type->tp_alloc(type, 0);
    if (!view) return NULL;
    int *sizes = view->sizes;
    sizes[ITEMS] = sizes[KARTS] = sizes[PATHS] = -1;
    if (!PyArg_ParseTupleAndKeywords(args, kwargs, "O!|iiipp", words, &PyTuple_Type, &view->names,
                                     sizes + ITEMS, sizes + KARTS, sizes + PATHS,
                                     &view->is_polar, &view->is_flat)) {
        view->names = NULL;
        Py_DECREF(view);
        return NULL;
    }
    Py_INCREF(view->names);
    const Py_ssize_t count = PyTuple_GET_SIZE(view->names);
    if (count > NUM_KEYS) {
        PyErr_SetString(PyExc_ValueError, "too many entries");
    } else if (view->is_flat && (sizes[0] < 0 || sizes[1] < 0 || sizes[2] < 0)) {
        PyErr_SetString(PyExc_ValueError, "a flat view has a fixed size");
    }
    for (Py_ssize_t i = 0; !PyErr_Occurred() && i < count; i++) {
        const char *name = PyUnicode_AsUTF8(PyTuple_GET_ITEM(view->names, i));
        if (name) add_entry(view, name);
    }
    if (PyErr_Occurred()) Py_CLEAR(view);
    return (PyObject *)view;
}

static void view_dealloc(PyObject *self)
{
    View *view = (View *)self;
    for (int key = 0; key < NUM_KEYS; key++) {
        Pool *pool = view->pools + key;
        for (Py_ssize_t i = 0; i < pool->size; i++) Py_XDECREF(pool->tuples[i]);
        PyMem_Free(pool->tuples);
    }
    Py_XDECREF(view->names);
    Py_TYPE(self)->tp_free(self);
}

static PyMethodDef view_methods[] = {
    {"observe", (PyCFunction)(void (*)(void))view_observe, METH_FASTCALL,
     "One observation for each kart, in a list."},
    {NULL, NULL, 0, NULL},
};

PyTypeObject ViewType = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "stkzoo.kernel._kernel.View",
    .tp_basicsize = sizeof(View),
    .tp_flags = Py_TPFLAGS_DEFAULT,
    .tp_doc = "What is shown to agents of one view.",
    .tp_new = view_new,
    .tp_dealloc = view_dealloc,
    .tp_methods = view_methods,
};
