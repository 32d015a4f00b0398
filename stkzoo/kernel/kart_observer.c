/* Converts a snapshot's records to agents' observations in one pass.

   KEYS lists the entries of the `full` view. The options of KartObserver replace the wrappers
   ConstantSizedObservations (items, karts, paths), PolarObservations (polar), FlattenerWrapper and
   JoinedObservations (the parts of the entries) and ActionMasks (uses) of stkzoo.wrappers, which
   change observations of any environment. */

#include "geometry.h"

#include <stddef.h>
#include <string.h>

enum { ITEMS, KARTS, PATHS, OWN, ACTIONS, NUM_GROUPS }; /* what the rows of an entry describe */

/* A snapshot, and what one kart sees of it. */
typedef struct {
    TrackGraph *track;
    npy_intp num_paths;   /* number of visible segments */
    PyObject *kart_types; /* tuple */
    Snapshot snapshot;
    int is_polar;
    npy_intp rows[NUM_GROUPS], real[NUM_GROUPS]; /* by group: number of rows, and number of those without padding */
    Flags uses;
    /* of the observing kart: */
    const Kart *me;
    const void *records[3]; /* by source: HEADER, KART, SCENE */
    float matrix[9], center_path[3], center_path_distance;
    Near *nearest[2]; /* items and karts, those ahead first */
    const npy_int32 *ahead;
} Scene;

enum { NUMBER, CHOICE, MASK, NAME };
enum { HEADER, KART, SCENE, NODES, WIDTHS, DISTANCES, NEAREST, MOTION }; /* sources of numbers */
enum { IS_POINT = 1, IS_PLACE = 2 }; /* stored in the world frame; converted in a polar view */

/* An entry of an observation. */
typedef struct {
    const char *name;
    int kind, group, width;
    int source;    /* of numbers and choices */
    size_t offset; /* in the source [bytes] */
    int form;
} Key;

/* The entries of the `full` view, and masks of its padded lists. Vectors are in the observing kart's
   frame: x right, y up, z forward [m]. stkzoo.engine.snapshot has the units of the records. */
static const Key KEYS[] = {
    {"kart_type", NAME, OWN, 1},
    {"aux_ticks", NUMBER, OWN, 1, HEADER, offsetof(Header, aux_ticks)},
    {"phase", CHOICE, OWN, 1, HEADER, offsetof(Header, phase)},
    {"powerup_type", CHOICE, OWN, 1, KART, offsetof(Kart, powerup_type)},
    {"powerup_count", CHOICE, OWN, 1, KART, offsetof(Kart, powerup_num)},
    {"attachment", CHOICE, OWN, 1, KART, offsetof(Kart, attachment_type)},
    {"skeed_factor", NUMBER, OWN, 1, KART, offsetof(Kart, skeed_factor)},
    {"energy", NUMBER, OWN, 1, KART, offsetof(Kart, energy)},
    {"attachment_time_left", NUMBER, OWN, 1, KART, offsetof(Kart, attachment_time_left)},
    {"shield_time", NUMBER, OWN, 1, KART, offsetof(Kart, shield_time)},
    {"velocity", NUMBER, OWN, 3, KART, offsetof(Kart, velocity_lc)},
    {"max_steer_angle", NUMBER, OWN, 1, KART, offsetof(Kart, max_steer_angle)},
    {"distance_down_track", NUMBER, OWN, 1, KART, offsetof(Kart, distance_down_track)},
    /* find_center_path() */
    {"center_path_distance", NUMBER, OWN, 1, SCENE, offsetof(Scene, center_path_distance)},
    {"center_path", NUMBER, OWN, 3, SCENE, offsetof(Scene, center_path), IS_PLACE},
    {"front", NUMBER, OWN, 3, KART, offsetof(Kart, front), IS_POINT},
    {"jumping", CHOICE, OWN, 1, KART, offsetof(Kart, jumping)},
    /* find_near(), write_motion() */
    {"items_position", NUMBER, ITEMS, 3, NEAREST, 0, IS_PLACE},
    {"items_type", CHOICE, ITEMS, 1},
    {"karts_position", NUMBER, KARTS, 3, NEAREST, 0, IS_PLACE},
    {"karts_velocity", NUMBER, KARTS, 3, MOTION},
    {"karts_heading", NUMBER, KARTS, 1, MOTION},
    /* the segments ahead, the kart's own first: nodes_ahead() */
    {"paths_distance", NUMBER, PATHS, 2, DISTANCES},
    {"paths_width", NUMBER, PATHS, 1, WIDTHS},
    {"paths_start", NUMBER, PATHS, 3, NODES, 0, IS_POINT | IS_PLACE},
    {"paths_end", NUMBER, PATHS, 3, NODES, 3 * sizeof(float), IS_POINT | IS_PLACE},
    {"items_mask", MASK, ITEMS, 1},
    {"karts_mask", MASK, KARTS, 1},
    {"paths_mask", MASK, PATHS, 1},
    {"action_mask", MASK, ACTIONS, 1},
};

enum { NUM_KEYS = sizeof KEYS / sizeof *KEYS };

/* An entry of one observer. */
typedef struct {
    const Key *key;
    PyObject *name;
    int part;        /* of the batch that has the entry */
    npy_intp offset; /* of the entry in a row of that part [elements] */
    int values;      /* one-hot length of a choice; 0 if it is written as a number */
    /* Tuples of rows that earlier calls returned, for lists of varying length; the oldest is at
       `next`. A tuple is reused if neither it nor its rows are referenced elsewhere, which costs a
       tenth of creating a new one. */
    PyObject *pool;
    Py_ssize_t next;
} Entry;

/* An array of a batch, which is one entry or a vector of several, or a list of names. */
typedef struct {
    PyObject *name; /* its key, unless the batch is no dict but the part itself */
    int kind;
    npy_intp width; /* number of elements in a row */
} Part;

typedef struct {
    OBJECT_HEAD
    Entry entries[NUM_KEYS];
    Part parts[NUM_KEYS];
    int num_entries, num_parts;
    int sizes[NUM_GROUPS]; /* rows of each group; -1 for a variable number */
    int is_polar;
    int needs[NUM_GROUPS]; /* whether there are entries of each group */
    Flags uses;            /* (2, n): whether an action needs nitro, and a powerup; empty: no mask */
} KartObserver;

/* ---------------------------------------------------------------- one kart's surroundings */

static void see(const Scene *scene, const float *point, float *out)
{
    to_kart_frame(scene->me, scene->matrix, point, out);
}

/* Converts a position (x, y, z) to (atan2(x, z), atan2(y, z), norm) [rad, rad, m]. */
static void make_polar(float *v)
{
    const float x = v[0], y = v[1], z = v[2];
    v[2] = length(v);
    v[0] = atan2f(x, z);
    v[1] = atan2f(y, z);
}

/* Computes center_path, the vector to the kart from the nearest point of the infinite line through
   its segment, and center_path_distance, the vector's length, negative when the line is to the right
   of the kart [m]. */
static void find_center_path(Scene *scene)
{
    float start[3], end[3], along[3];
    const float *node = scene->track->nodes.data + 6 * scene->me->node;
    see(scene, node, start);
    see(scene, node + 3, end);
    for (int i = 0; i < 3; i++) along[i] = start[i] - end[i];
    const float squared = dot(along, along), share = dot(along, start) / squared;
    float *path = scene->center_path;
    for (int i = 0; i < 3; i++) path[i] = squared > 0 ? share * along[i] - start[i] : 0;
    scene->center_path_distance = path[0] < 0 ? -length(path) : length(path);
}

/* Finds the nearest items or other karts: those in front by distance, then those behind. */
static void find_near(Scene *scene, int group)
{
    const Snapshot *snapshot = &scene->snapshot;
    const npy_intp there = group == ITEMS ? snapshot->header->num_items : snapshot->header->num_kart;
    npy_intp count = 0;
    for (npy_intp i = 0; i < there; i++) {
        if (group == KARTS && snapshot->karts + i == scene->me) continue;
        Near one = {.which = (int)i};
        see(scene, group == ITEMS ? snapshot->items[i].location : snapshot->karts[i].location,
            one.place);
        one.key = one.place[2] < 0 ? -length(one.place) : length(one.place);
        count = insert(scene->nearest[group], count, scene->real[group], &one);
    }
}

/* Sets the observing kart and computes what the entries need. Returns -1 with an exception set on
   failure. */
static int look(const KartObserver *observer, Scene *scene, npy_intp kart)
{
    scene->me = scene->records[KART] = scene->snapshot.karts + kart;
    if (!(scene->ahead = nodes_ahead(scene->track, scene->me->node))) return -1;
    rotation_matrix(scene->me, scene->matrix);
    if (observer->needs[OWN]) find_center_path(scene);
    if (observer->needs[ITEMS]) find_near(scene, ITEMS);
    if (observer->needs[KARTS]) find_near(scene, KARTS);
    return 0;
}

/* ---------------------------------------------------------------- an entry's numbers */

static const void *record_of(const Scene *scene, const Key *key)
{
    return (const char *)scene->records[key->source] + key->offset;
}

static npy_int64 item_type(const Scene *scene, npy_intp i)
{
    return scene->snapshot.items[scene->nearest[ITEMS][i].which].type;
}

/* Returns row i of a choice; 0 for padding. */
static npy_int64 choice_at(const Scene *scene, const Key *key, npy_intp i)
{
    if (key->group != OWN) return i < scene->real[ITEMS] ? item_type(scene, i) : 0;
    const int is_count = key->source == KART && key->offset == offsetof(Kart, powerup_num);
    return is_count ? powerup_count(scene->me) : *(const npy_int32 *)record_of(scene, key);
}

/* Writes the one-hot encoding of a choice. Returns -1 with an exception set if the choice is out of
   range. */
static int write_ones(const Scene *scene, const Entry *entry, float *out)
{
    for (npy_intp i = 0; i < scene->rows[entry->key->group]; i++, out += entry->values) {
        const npy_int64 choice = choice_at(scene, entry->key, i);
        if (choice < 0 || choice >= entry->values) {
            PyErr_Format(PyExc_IndexError, "%U is out of its range", entry->name);
            return -1;
        }
        for (npy_intp value = 0; value < entry->values; value++) out[value] = value == choice;
    }
    return 0;
}

/* Writes another kart's velocity over the ground in the observing kart's frame [m/s], or its heading
   relative to that kart, positive to the right, seen from above it [rad]. */
static void write_motion(const Scene *scene, const Key *key, const Kart *other, float *out)
{
    if (key->width == 3) {
        const float *v = other->velocity;
        rotate(scene->matrix, v[0], v[1], v[2], out);
    } else {
        float m[9], forward[3];
        rotation_matrix(other, m);
        rotate(scene->matrix, m[6], m[7], m[8], forward);
        *out = atan2f(forward[0], forward[2]);
    }
}

static void write_numbers(const Scene *scene, const Key *key, float *out)
{
    const TrackGraph *track = scene->track;
    const npy_intp rows = scene->rows[key->group], real = scene->real[key->group];
    const int width = key->width;
    const float *from; /* row i is at from + step * (order ? order[i] : i) */
    const npy_int32 *order = scene->ahead;
    npy_intp step = width;
    for (npy_intp i = real * width; i < rows * width; i++) out[i] = 0;
    if (key->kind == MASK) {
        for (npy_intp i = 0; i < real; i++) out[i] = 1;
        return;
    }
    if (key->source == MOTION) {
        const Near *near = scene->nearest[KARTS];
        for (npy_intp i = 0; i < real; i++, near++) {
            write_motion(scene, key, scene->snapshot.karts + near->which, out + width * i);
        }
        return;
    }
    switch (key->source) {
    case NODES: from = track->nodes.data + key->offset / sizeof *from, step = 6; break;
    case WIDTHS: from = track->widths.data; break;
    case DISTANCES: from = track->distances.data; break;
    case NEAREST:
        from = scene->nearest[key->group]->place, order = NULL, step = sizeof(Near) / sizeof *from;
        break;
    default: from = record_of(scene, key), order = NULL;
    }
    for (npy_intp i = 0; i < real; i++) {
        const float *row = from + step * (order ? order[i] : i);
        if (key->form & IS_POINT) see(scene, row, out + width * i);
        else memcpy(out + width * i, row, width * sizeof *row);
    }
    for (npy_intp i = 0; i < real && scene->is_polar && key->form & IS_PLACE; i++) {
        make_polar(out + width * i);
    }
}

/* ---------------------------------------------------------------- Python objects */

/* Enlarges the pools until they can hold the tuples of three calls, because the caller may still
   hold those of earlier calls. Returns -1 with an exception set on failure. */
static int grow(KartObserver *observer, npy_intp count)
{
    for (Entry *entry = observer->entries; entry < observer->entries + observer->num_entries; entry++) {
        while (PyList_GET_SIZE(entry->pool) < 3 * count) {
            if (PyList_Append(entry->pool, Py_None) < 0) return -1;
        }
    }
    return 0;
}

/* Returns the data of a tuple's rows. Returns NULL if the tuple cannot be reused: its rows have
   changed, or there are other references to it, to a row, or to the rows' block. A view of a row
   references the block. */
static float *free_block(PyObject *tuple, npy_intp rows, int width)
{
    if (tuple == Py_None || Py_REFCNT(tuple) != 1 || PyTuple_GET_SIZE(tuple) != rows) return NULL;
    PyObject *block = PyArray_BASE((PyArrayObject *)PyTuple_GET_ITEM(tuple, 0));
    if (Py_REFCNT(block) != rows) return NULL;
    float *data = PyArray_DATA((PyArrayObject *)block);
    for (npy_intp i = 0; i < rows; i++) {
        PyArrayObject *row = (PyArrayObject *)PyTuple_GET_ITEM(tuple, i);
        if (Py_REFCNT(row) != 1 || PyArray_DATA(row) != data + width * i ||
            PyArray_NDIM(row) != 1 || PyArray_TYPE(row) != NPY_FLOAT32 ||
            !PyArray_ISNOTSWAPPED(row) ||
            !PyArray_CHKFLAGS(row, NPY_ARRAY_C_CONTIGUOUS | NPY_ARRAY_WRITEABLE)) {
            return NULL;
        }
    }
    return data;
}

/* Returns a tuple of the rows of a new block, and the block's data. */
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

/* Returns an entry's numbers as a tuple of arrays, one per row. The tuple is new or reused. */
static PyObject *number_rows(const Scene *scene, Entry *entry)
{
    const npy_intp rows = scene->real[entry->key->group];
    if (rows == 0) return PyTuple_New(0);
    const Py_ssize_t place = entry->next;
    entry->next = (place + 1) % PyList_GET_SIZE(entry->pool);
    float *data = free_block(PyList_GET_ITEM(entry->pool, place), rows, entry->key->width);
    if (!data) {
        PyObject *tuple = new_rows(rows, entry->key->width, &data);
        if (!tuple || PyList_SetItem(entry->pool, place, tuple) < 0) return NULL;
    }
    write_numbers(scene, entry->key, data);
    return Py_NewRef(PyList_GET_ITEM(entry->pool, place));
}

/* Returns the items' types as a tuple of NumPy's numbers. */
static PyObject *choice_rows(const Scene *scene)
{
    const npy_intp rows = scene->real[ITEMS];
    PyArray_Descr *type = PyArray_DescrFromType(NPY_INT64);
    PyObject *tuple = PyTuple_New(rows);
    for (npy_intp i = 0; tuple && i < rows; i++) {
        npy_int64 value = item_type(scene, i);
        PyObject *scalar = PyArray_Scalar(&value, type, NULL);
        if (!scalar) Py_CLEAR(tuple);
        else PyTuple_SET_ITEM(tuple, i, scalar);
    }
    Py_DECREF(type);
    return tuple;
}

/* Returns the value of an entry in Gymnasium's format: lists are tuples of arrays or numbers. */
static PyObject *value_of(const Scene *scene, Entry *entry)
{
    const Key *key = entry->key;
    npy_intp width = key->width;
    if (key->kind == NAME) {
        return Py_XNewRef(PyTuple_GetItem(scene->kart_types, scene->me - scene->snapshot.karts));
    }
    if (key->group != OWN) {
        return key->kind == CHOICE ? choice_rows(scene) : number_rows(scene, entry);
    }
    if (key->kind == CHOICE) return PyLong_FromLongLong(choice_at(scene, key, 0));
    PyObject *array = PyArray_SimpleNew(1, &width, NPY_FLOAT32);
    if (array) write_numbers(scene, key, PyArray_DATA((PyArrayObject *)array));
    return array;
}

static PyObject *as_dict(KartObserver *observer, const Scene *scene)
{
    PyObject *dict = PyDict_New();
    for (int i = 0; dict && i < observer->num_entries; i++) {
        Entry *entry = observer->entries + i;
        PyObject *value = value_of(scene, entry);
        if (!value || PyDict_SetItem(dict, entry->name, value) < 0) Py_CLEAR(dict);
        Py_XDECREF(value);
    }
    return dict;
}

/* ---------------------------------------------------------------- rows of a batch */

/* Writes 0 for actions without effect, which press nitro with an empty tank or fire without a
   powerup, and 1 for the others. */
static void write_action_mask(float energy, int powerup, Flags uses, npy_int8 *out)
{
    const int no_nitro = !(energy > 0), no_powerup = powerup == 0;
    const npy_intp count = uses.size / 2;
    const npy_bool *nitro = uses.data, *fire = nitro + count;
    for (npy_intp i = 0; i < count; i++) {
        out[i] = !((no_nitro && nitro[i]) || (no_powerup && fire[i]));
    }
}

PyObject *action_mask(PyObject *Py_UNUSED(module), PyObject *args)
{
    float energy;
    int powerup;
    Flags uses;
    if (!PyArg_ParseTuple(args, "fiO&", &energy, &powerup, as_flags, &uses)) return NULL;
    npy_intp count = uses.size / 2;
    PyObject *mask = PyArray_SimpleNew(1, &count, NPY_INT8);
    if (mask) write_action_mask(energy, powerup, uses, PyArray_DATA((PyArrayObject *)mask));
    return mask;
}

/* Writes the mask of actions or, for lists, 1 for real rows and 0 for padding. */
static void write_mask(const Scene *scene, const Key *key, npy_int8 *out)
{
    const npy_intp rows = scene->rows[key->group], real = scene->real[key->group];
    if (key->group == ACTIONS) {
        const Kart *me = scene->me;
        write_action_mask(me->energy, me->powerup_type, scene->uses, out);
        return;
    }
    for (npy_intp i = 0; i < rows; i++) out[i] = i < real;
}

/* Returns a part of a batch, a borrowed reference; NULL if the batch lacks it. */
static PyObject *part_of(PyObject *batch, const Part *part)
{
    return PyDict_Check(batch) ? PyDict_GetItemWithError(batch, part->name) : batch;
}

/* Where values are written: the address in the first row, and the size of a row and of an element
   [bytes]. */
typedef struct {
    char *first;
    npy_intp row_size, size;
} Column;

/* Finds a part of a batch. Returns -1 with an exception set if it is of another type, or if it does
   not have all of `rows`. */
static int find_column(const Part *part, PyObject *batch, Indices rows, Column *column)
{
    static const int TYPES[] = {[NUMBER] = NPY_FLOAT32, [CHOICE] = NPY_INT64, [MASK] = NPY_INT8};
    Floats numbers; /* or Wholes or Bytes, which differ only in their pointer */
    PyObject *array = part_of(batch, part);
    if (!array) PyErr_Format(PyExc_ValueError, "the batch has no %U", part->name);
    if (!array || !as_array(array, TYPES[part->kind], NPY_ARRAY_WRITEABLE, &numbers)) return -1;
    const int has_slots = PyArray_NDIM((PyArrayObject *)array) > 0;
    const npy_intp count = has_slots ? PyArray_DIM((PyArrayObject *)array, 0) : 0;
    if (numbers.size != count * part->width) {
        PyErr_Format(PyExc_ValueError, "the batch has the wrong number of %U", part->name);
        return -1;
    }
    if (!are_below(rows, count)) {
        PyErr_SetString(PyExc_IndexError, "a row index is out of range");
        return -1;
    }
    const npy_intp size = PyArray_ITEMSIZE((PyArrayObject *)array);
    *column = (Column){(char *)numbers.data, part->width * size, size};
    return 0;
}

/* Writes an entry into a row of a batch. Returns -1 with an exception set on failure. */
static int write_entry(const Scene *scene, const Entry *entry, int is_mask, void *out)
{
    const Key *key = entry->key;
    if (entry->values) return write_ones(scene, entry, out);
    if (key->kind == CHOICE) {
        npy_int64 *choices = out;
        for (npy_intp i = 0; i < scene->rows[key->group]; i++) choices[i] = choice_at(scene, key, i);
    } else if (is_mask) {
        write_mask(scene, key, out);
    } else {
        write_numbers(scene, key, out);
    }
    return 0;
}

/* Writes the names into lists of a batch. Call this after writing the numbers, because replacing a
   list's items can run code that changes the batch. */
static int names_into(const KartObserver *observer, const Scene *scene, Indices who, Indices rows,
                      PyObject *batch)
{
    int status = 0;
    for (const Part *part = observer->parts; !status && part < observer->parts + observer->num_parts;
         part++) {
        if (part->kind != NAME) continue;
        PyObject *list = Py_XNewRef(part_of(batch, part));
        if (!list || !PyList_Check(list)) status = refuse("the names of a batch must be a list");
        for (npy_intp n = 0; !status && n < who.size; n++) {
            PyObject *name = Py_XNewRef(PyTuple_GetItem(scene->kart_types, who.data[n]));
            status = name ? PyList_SetItem(list, rows.data[n], name) : -1;
        }
        Py_XDECREF(list);
    }
    return status;
}

/* Writes the observations of a view of fixed size into rows of a batch. */
static int write_rows(const KartObserver *observer, Scene *scene, Indices who, Indices rows,
                      PyObject *batch)
{
    Column columns[NUM_KEYS] = {{0}};
    for (int n = 0; n < observer->num_parts; n++) {
        const Part *part = observer->parts + n;
        if (part->kind != NAME && find_column(part, batch, rows, columns + n) < 0) {
            return -1;
        }
    }
    for (npy_intp i = 0; i < who.size; i++) {
        if (look(observer, scene, who.data[i]) < 0) return -1;
        for (int n = 0; n < observer->num_entries; n++) {
            const Entry *entry = observer->entries + n;
            const int kind = observer->parts[entry->part].kind;
            const Column *column = columns + entry->part;
            if (kind == NAME) continue;
            char *row = column->first + column->row_size * rows.data[i];
            if (write_entry(scene, entry, kind == MASK, row + column->size * entry->offset) < 0) {
                return -1;
            }
        }
    }
    return names_into(observer, scene, who, rows, batch);
}

/* ---------------------------------------------------------------- entries of other environments */

/* to_polar(points): returns positions (..., 3) [m] as two angles and a distance. */
PyObject *to_polar(PyObject *Py_UNUSED(module), PyObject *points)
{
    Floats numbers;
    if (!as_floats(points, &numbers)) return NULL;
    const int axes = PyArray_NDIM((PyArrayObject *)points);
    if (!axes || PyArray_DIM((PyArrayObject *)points, axes - 1) != 3) {
        return PyErr_Format(PyExc_ValueError, "expected vectors of 3 numbers");
    }
    PyArrayObject *polar = (PyArrayObject *)PyArray_NewCopy((PyArrayObject *)points, NPY_CORDER);
    float *out = polar ? PyArray_DATA(polar) : NULL;
    for (npy_intp i = 0; out && i < numbers.size; i += 3) make_polar(out + i);
    return (PyObject *)polar;
}

/* ---------------------------------------------------------------- the type */

/* Reads the arguments of both methods: track, num_paths, kart_types, data and who, and for rows of a
   batch also rows and batch. Allocates nearest[ITEMS], which the caller frees. Returns -1 with an
   exception set on failure. */
static int open_scene(const KartObserver *observer, Scene *scene, PyObject *args, Indices *who,
                      Indices *rows, PyObject **batch)
{
    if (!PyArg_ParseTuple(args, batch ? "O!nO!O&O&O&O" : "O!nO!O&O&", &TrackGraphType,
                          &scene->track, &scene->num_paths, &PyTuple_Type, &scene->kart_types,
                          as_snapshot, &scene->snapshot, as_indices, who, as_indices, rows, batch)) {
        return -1;
    }
    const Header *header = scene->records[HEADER] = scene->snapshot.header;
    if (check_rows("kart", *who, header->num_kart, batch ? *rows : *who, NPY_MAX_INTP) < 0) return -1;
    if (scene->num_paths < 0 || scene->num_paths > scene->track->num_nodes) {
        PyErr_Format(PyExc_ValueError, "%zd of %zd segments", scene->num_paths,
                     scene->track->num_nodes);
        return -1;
    }
    const npy_intp there[] = {header->num_items, header->num_kart - 1, scene->num_paths, 1,
                              observer->uses.size / 2};
    for (int group = 0; group < NUM_GROUPS; group++) {
        const npy_intp size = observer->sizes[group];
        scene->rows[group] = size < 0 ? there[group] : size;
        scene->real[group] = size < 0 || there[group] < size ? there[group] : size;
    }
    scene->is_polar = observer->is_polar;
    scene->uses = observer->uses;
    scene->records[SCENE] = scene;
    Near *room = PyMem_Malloc((size_t)(header->num_items + header->num_kart) * sizeof *room);
    if (!room) PyErr_NoMemory();
    scene->nearest[ITEMS] = room, scene->nearest[KARTS] = room + header->num_items;
    return room ? 0 : -1;
}

/* observe(track, num_paths, kart_types, data, who): returns a list with one observation for each
   kart of `who`, in a view with lists of varying length. */
static PyObject *observer_observe(PyObject *self, PyObject *args)
{
    KartObserver *observer = (KartObserver *)self;
    Scene scene;
    Indices who;
    if (open_scene(observer, &scene, args, &who, NULL, NULL) < 0) return NULL;
    PyObject *list = grow(observer, who.size) == 0 ? PyList_New(who.size) : NULL;
    for (npy_intp i = 0; list && i < who.size; i++) {
        PyObject *seen =
            look(observer, &scene, who.data[i]) < 0 ? NULL : as_dict(observer, &scene);
        if (!seen) Py_CLEAR(list);
        else PyList_SET_ITEM(list, i, seen);
    }
    PyMem_Free(scene.nearest[ITEMS]);
    return list;
}

/* observe_into(track, num_paths, kart_types, data, who, rows, batch): writes the observation of
   kart who[i] into row rows[i] of a batch. The batch is a dict of arrays by entry, with a list for
   names, or one array if the view is one vector. */
static PyObject *observer_observe_into(PyObject *self, PyObject *args)
{
    const KartObserver *observer = (KartObserver *)self;
    Scene scene;
    Indices who, rows;
    PyObject *batch;
    if (open_scene(observer, &scene, args, &who, &rows, &batch) < 0) return NULL;
    const int status = write_rows(observer, &scene, who, rows, batch);
    PyMem_Free(scene.nearest[ITEMS]);
    return status < 0 ? NULL : Py_NewRef(Py_None);
}

/* Adds an entry from a tuple: its name; the name of its part of the batch; and its one-hot length, or
   0. */
static int add_entry(KartObserver *observer, PyObject *spec)
{
    PyObject *name, *part_name;
    const Key *key = KEYS;
    Part *part = observer->parts;
    int values;
    if (!is_tuple(spec) || !PyArg_ParseTuple(spec, "UUi", &name, &part_name, &values)) return -1;
    while (key < KEYS + NUM_KEYS && PyUnicode_CompareWithASCIIString(name, key->name)) key++;
    if (key == KEYS + NUM_KEYS) {
        PyErr_Format(PyExc_ValueError, "there is no entry named %S", name);
        return -1;
    }
    if (values < 0 || (values && key->kind != CHOICE)) return refuse("only choices have values");
    if (observer->num_entries == NUM_KEYS) return refuse("too many entries");
    const npy_intp rows = key->group == OWN ? 1 : observer->sizes[key->group];
    const int kind = values ? NUMBER : key->kind;
    while (part < observer->parts + observer->num_parts && PyUnicode_Compare(part->name, part_name)) {
        part++;
    }
    if (part == observer->parts + observer->num_parts) {
        *part = (Part){part_name, kind, 0};
        observer->num_parts++;
    } else if (rows < 0 || part->width < 0 || kind == NAME ||
               (part->kind != kind && (part->kind != NUMBER || kind != MASK))) {
        return refuse("an entry does not fit into its part");
    }
    PyObject *pool = keep(observer, PyList_New(0));
    if (!pool) return -1;
    observer->entries[observer->num_entries++] = (Entry){
        .key = key, .name = name, .part = (int)(part - observer->parts), .offset = part->width,
        .values = values, .pool = pool,
    };
    part->width += rows * (values ? values : key->width);
    observer->needs[key->group] = 1;
    return 0;
}

static int observer_set_up(KartObserver *observer, PyObject *args, PyObject *kwargs)
{
    static char *words[] = {"entries", "items", "karts", "paths", "polar", "uses", NULL};
    PyObject *entries, *uses = Py_None;
    int *sizes = observer->sizes;
    for (int group = 0; group < NUM_GROUPS; group++) sizes[group] = -1;
    if (!PyArg_ParseTupleAndKeywords(args, kwargs, "O!|iiipO", words, &PyTuple_Type, &entries,
                                     sizes + ITEMS, sizes + KARTS, sizes + PATHS,
                                     &observer->is_polar, &uses) ||
        (uses != Py_None && !as_flags(uses, &observer->uses))) {
        return -1;
    }
    if (observer->uses.size > NPY_MAX_INT32) return refuse("there are too many actions");
    if (uses != Py_None) sizes[ACTIONS] = (int)(observer->uses.size / 2);
    for (Py_ssize_t i = 0; i < PyTuple_GET_SIZE(entries); i++) {
        if (add_entry(observer, PyTuple_GET_ITEM(entries, i)) < 0) return -1;
    }
    return 0;
}

KERNEL_TYPE(KartObserver, observer, "Makes the observations of one view.",
            {"observe", observer_observe, METH_VARARGS,
             "Returns a list with one observation per kart."},
            {"observe_into", observer_observe_into, METH_VARARGS,
             "Writes observations into rows of a batch."})
