/* Converts a snapshot's records to the vectors of the racing view in one pass.

   stkzoo.wrappers.racing.features describes each number; its constants and tables are arguments of
   RacingObserver. Both forms of the view run here: `observe` from a snapshot, and `write` from the
   observations of any environment in the `full` view. */

#include "geometry.h"

enum { LINE = 4 }; /* x, y, z of a line's point, and its distance to the edge of the road */

typedef struct {
    Floats lines, starts, along; /* (N, points, 4), (N, 3), (N, 3) */
    npy_intp num_nodes, num_points;
} Track;

typedef struct {
    OBJECT_HEAD
    Track *tracks;
    npy_intp num_tracks;
    Floats marks;      /* distances at which the road is observed [m] */
    Bytes items;       /* by type: column of a good item, -1 for a bad one, -2 for others */
    Bytes attachments; /* by type: column, or -1 */
    int num_powerups, num_hangs, num_kinds; /* one-hot lengths */
    int karts, goods, bads; /* numbers of objects in the view */
    float step, beyond, kart_reach, item_reach, item_ahead, item_level;
    npy_intp size;
} RacingObserver;

enum { MOST = 8 }; /* largest number of objects of one kind in the view */

/* A kart's own state, with the names of the full view. */
typedef struct {
    const float *velocity;
    float max_steer_angle, skeed_factor, energy, attachment_time_left, shield_time;
    npy_int64 jumping, powerup_type, powerup_count, attachment;
} OwnState;

typedef struct {
    const RacingObserver *view;
    float *out;
} Pen;

/* The observing kart, its rotation, and its distance from the start of its segment [m]. */
typedef struct {
    const Track *track;
    const Kart *kart;
    float matrix[9], passed;
} Eye;

static float clipped(float x)
{
    return x < -5.0f ? -5.0f : x > 5.0f ? 5.0f : x;
}

static void put(Pen *pen, float x)
{
    *pen->out++ = clipped(x);
}

static void put_one_of(Pen *pen, npy_intp which, int count)
{
    for (int i = 0; i < count; i++) put(pen, i == which ? 1.0f : 0.0f);
}

/* Returns a table's entry for a type, or `none` for types outside the table. */
static int entry_of(Bytes table, npy_int64 type, int none)
{
    return type >= 0 && type < table.size ? table.data[type] : none;
}

/* ---------------------------------------------------------------- own state */

/* Arrays of the own state of karts, in the order of OWN_NUMBERS and OWN_KINDS. */
typedef struct {
    Floats velocity, numbers[5];
    Wholes kinds[4];
} OwnArrays;

/* Reads the arrays from two tuples; returns 0 with an exception set on failure. */
static int read_own(PyObject *floats, PyObject *wholes, int (*to_floats)(PyObject *, void *),
                    int (*to_wholes)(PyObject *, void *), OwnArrays *own)
{
    Floats *numbers = own->numbers;
    Wholes *kinds = own->kinds;
    return PyArg_ParseTuple(floats, "O&O&O&O&O&O&", to_floats, &own->velocity, to_floats, numbers,
                            to_floats, numbers + 1, to_floats, numbers + 2, to_floats, numbers + 3,
                            to_floats, numbers + 4) &&
           PyArg_ParseTuple(wholes, "O&O&O&O&", to_wholes, kinds, to_wholes, kinds + 1, to_wholes,
                            kinds + 2, to_wholes, kinds + 3);
}

/* Returns whether the arrays have a row for each of `count` karts. */
static int has_rows_of(const OwnArrays *own, npy_intp count)
{
    int fits = own->velocity.size == 3 * count;
    for (int i = 0; i < 5; i++) fits &= own->numbers[i].size == count;
    for (int i = 0; i < 4; i++) fits &= own->kinds[i].size == count;
    return fits;
}

static OwnState own_at(const OwnArrays *own, npy_intp row)
{
    const Floats *numbers = own->numbers;
    const Wholes *kinds = own->kinds;
    return (OwnState){
        own->velocity.data + 3 * row, numbers[0].data[row], numbers[1].data[row],
        numbers[2].data[row],         numbers[3].data[row], numbers[4].data[row],
        kinds[0].data[row],           kinds[1].data[row],   kinds[2].data[row],
        kinds[3].data[row],
    };
}

static void store_own(const OwnState *own, OwnArrays *out, npy_intp row)
{
    const float numbers[] = {own->max_steer_angle, own->skeed_factor, own->energy,
                             own->attachment_time_left, own->shield_time};
    const npy_int64 kinds[] = {own->jumping, own->powerup_type, own->powerup_count,
                               own->attachment};
    memcpy(out->velocity.data + 3 * row, own->velocity, 3 * sizeof *own->velocity);
    for (int i = 0; i < 5; i++) out->numbers[i].data[row] = numbers[i];
    for (int i = 0; i < 4; i++) out->kinds[i].data[row] = kinds[i];
}

static OwnState own_of(const Kart *kart)
{
    return (OwnState){
        .velocity = kart->velocity_lc,
        .max_steer_angle = kart->max_steer_angle,
        .skeed_factor = kart->skeed_factor,
        .energy = kart->energy,
        .attachment_time_left = kart->attachment_time_left,
        .shield_time = kart->shield_time,
        .jumping = kart->jumping,
        .powerup_type = kart->powerup_type,
        .powerup_count = powerup_count(kart),
        .attachment = kart->attachment_type,
    };
}

static void put_own(Pen *pen, const OwnState *own)
{
    const RacingObserver *view = pen->view;
    for (int i = 0; i < 3; i++) put(pen, own->velocity[i] / 20.0f);
    put(pen, own->max_steer_angle);
    put(pen, own->skeed_factor);
    put(pen, own->energy / 20.0f);
    put(pen, own->attachment_time_left / 10.0f);
    put(pen, own->shield_time / 10.0f);
    put(pen, (float)own->jumping);
    put_one_of(pen, own->powerup_type, view->num_powerups);
    put(pen, (float)own->powerup_count / 3.0f);
    put_one_of(pen, entry_of(view->attachments, own->attachment, -1), view->num_hangs);
}

/* ---------------------------------------------------------------- the road */

/* Writes the line's point at a distance ahead of the kart, in the kart's frame, and the point's
   distance to the edge of the road. */
static void look_at(const RacingObserver *view, const Eye *eye, float distance, float *point)
{
    const Track *track = eye->track;
    const float *line = track->lines.data + LINE * track->num_points * eye->kart->node;
    float there[LINE];
    look_on_line(line, track->num_points, (eye->passed + distance) / view->step, there);
    to_kart_frame(eye->kart, eye->matrix, there, point);
    point[3] = there[3];
}

/* Writes the line's points at several distances ahead of the kart. */
static void see_road(const RacingObserver *view, const Eye *eye, Floats looks, float *out)
{
    for (npy_intp i = 0; i < looks.size; i++) look_at(view, eye, looks.data[i], out + LINE * i);
}

/* Writes the features of the road from its points beside the kart, at the marks and beyond them. */
static void put_road(Pen *pen, const float *road)
{
    const npy_intp count = pen->view->marks.size;
    const float *marks = pen->view->marks.data;
    for (int i = 0; i < LINE; i++) put(pen, road[i] / 10.0f);
    float *out = pen->out;
    for (npy_intp mark = 0; mark < count; mark++) {
        const float *point = road + LINE * (1 + mark), *beyond = point + LINE * count;
        const float x = beyond[0] - point[0], z = beyond[2] - point[2];
        const float far = sqrtf(x * x + z * z), least = far > 0.1f ? far : 0.1f;
        for (int i = 0; i < 3; i++) out[3 * mark + i] = clipped(point[i] / marks[mark]);
        out[3 * count + mark] = clipped(point[3] / 10.0f);
        out[4 * count + 2 * mark] = clipped(x / least);
        out[4 * count + 2 * mark + 1] = clipped(z / least);
    }
    pen->out += 6 * count;
}

/* ---------------------------------------------------------------- nearby karts and items */

static Near near_at(const float *place, int kind)
{
    return (Near){.which = kind, .place = {place[0], place[1], place[2]}, .key = dot(place, place)};
}

static void put_places(Pen *pen, const Near *nearest, int count, int limit)
{
    for (int i = 0; i < limit; i++) {
        const float far = i < count ? length(nearest[i].place) : 1.0f;
        const float least = far > 0.5f ? far : 0.5f;
        for (int k = 0; k < 3; k++) put(pen, i < count ? nearest[i].place[k] / least : 0.0f);
    }
    for (int i = 0; i < limit; i++) {
        put(pen, i < count ? 1.0f / (1.0f + length(nearest[i].place) / 5.0f) : 0.0f);
    }
}

static void put_karts(Pen *pen, const float *karts, npy_intp num_karts)
{
    const RacingObserver *view = pen->view;
    Near nearest[MOST] = {{0}};
    int count = 0;
    for (npy_intp i = 0; i < num_karts; i++) {
        const Near one = near_at(karts + 3 * i, 0);
        if (!(one.key < view->kart_reach * view->kart_reach)) continue;
        count = (int)insert(nearest, count, view->karts, &one);
    }
    put_places(pen, nearest, count, view->karts);
}

static void put_items(Pen *pen, const float *items, const npy_int64 *types, npy_intp num_items)
{
    const RacingObserver *view = pen->view;
    Near goods[MOST] = {{0}}, bads[MOST] = {{0}};
    int num_goods = 0, num_bads = 0;
    for (npy_intp i = 0; i < num_items; i++) {
        const int kind = entry_of(view->items, types[i], -2);
        if (kind == -2) continue;
        const Near one = near_at(items + 3 * i, kind);
        if (!(one.place[2] > view->item_ahead && fabsf(one.place[1]) < view->item_level &&
              one.key < view->item_reach * view->item_reach)) {
            continue;
        }
        if (kind < 0) num_bads = (int)insert(bads, num_bads, view->bads, &one);
        else num_goods = (int)insert(goods, num_goods, view->goods, &one);
    }
    put_places(pen, goods, num_goods, view->goods);
    for (int i = 0; i < view->goods; i++) put(pen, i < num_goods ? goods[i].place[0] / 5.0f : 0);
    for (int i = 0; i < view->goods; i++) {
        put_one_of(pen, i < num_goods ? goods[i].which : -1, view->num_kinds);
    }
    put_places(pen, bads, num_bads, view->bads);
    for (int i = 0; i < view->bads; i++) put(pen, i < num_bads ? bads[i].place[0] / 5.0f : 0);
}

/* ---------------------------------------------------------------- a kart's surroundings */

/* Sets the observing kart. Returns -1 with an exception set if its track, kart or segment does not
   exist. */
static int open_eye(const RacingObserver *view, npy_intp track, const Snapshot *snapshot, npy_intp kart,
                    Eye *eye)
{
    if (track < 0 || track >= view->num_tracks) {
        PyErr_Format(PyExc_IndexError, "there is no road %zd", track);
        return -1;
    }
    if (kart < 0 || kart >= snapshot->header->num_kart) {
        PyErr_Format(PyExc_IndexError, "kart %zd of %d", kart, snapshot->header->num_kart);
        return -1;
    }
    eye->track = view->tracks + track, eye->kart = snapshot->karts + kart;
    const npy_intp node = eye->kart->node;
    if (node < 0 || node >= eye->track->num_nodes) {
        PyErr_Format(PyExc_IndexError, "there is no segment %zd", node);
        return -1;
    }
    rotation_matrix(eye->kart, eye->matrix);
    float start[3];
    for (int i = 0; i < 3; i++) {
        start[i] = eye->track->starts.data[3 * node + i] - eye->kart->location[i];
    }
    eye->passed = way_passed(start, eye->track->along.data + 3 * node);
    return 0;
}

/* Writes the positions of the other karts in the kart's frame: infinity for missing karts and for
   the kart itself. */
static void see_karts(const Eye *eye, const Snapshot *snapshot, npy_intp most, float *out)
{
    for (npy_intp i = 0; i < most; i++, out += 3) {
        const Kart *other = snapshot->karts + i;
        if (i < snapshot->header->num_kart && other != eye->kart) {
            to_kart_frame(eye->kart, eye->matrix, other->location, out);
        } else {
            out[0] = out[1] = out[2] = INFINITY;
        }
    }
}

/* Writes the positions of the items in the kart's frame, and their types. Missing items have
   position 0 and type -1. */
static void see_items(const Eye *eye, const Snapshot *snapshot, npy_intp most, float *out,
                      npy_int64 *types)
{
    for (npy_intp i = 0; i < most; i++, out += 3) {
        const Item *item = snapshot->items + i;
        const int is_there = i < snapshot->header->num_items;
        types[i] = is_there ? item->type : -1;
        if (is_there) to_kart_frame(eye->kart, eye->matrix, item->location, out);
        else out[0] = out[1] = out[2] = 0;
    }
}

/* ---------------------------------------------------------------- the type */

/* observe(data, road, who, rows, out): writes the view of kart who[i] into row rows[i] of `out`. */
static PyObject *racing_observe(PyObject *self, PyObject *args)
{
    const RacingObserver *view = (RacingObserver *)self;
    Snapshot snapshot;
    npy_intp track;
    Indices who, rows;
    Floats out;
    if (!PyArg_ParseTuple(args, "O&nO&O&O&", as_snapshot, &snapshot, &track, as_indices, &who,
                          as_indices, &rows, as_written_floats, &out)) {
        return NULL;
    }
    if (rows.size != who.size || out.size % view->size) {
        return PyErr_Format(PyExc_ValueError, "%zd karts for %zd rows of %zd numbers", who.size,
                            rows.size, view->size);
    }
    if (!are_below(rows, out.size / view->size)) {
        return PyErr_Format(PyExc_IndexError, "a row index is out of range");
    }
    const npy_intp marks = view->marks.size, num_looks = 1 + 2 * marks;
    const npy_intp num_karts = snapshot.header->num_kart, num_items = snapshot.header->num_items;
    const size_t floats = (size_t)(LINE * num_looks + 3 * (num_karts + num_items));
    npy_int64 *types = PyMem_Malloc((size_t)num_items * sizeof *types + floats * sizeof(float));
    if (!types) return PyErr_NoMemory();
    float *road = (float *)(types + num_items), *karts = road + LINE * num_looks;
    float *items = karts + 3 * num_karts;
    for (npy_intp i = 0; i < who.size; i++) {
        Eye eye;
        if (open_eye(view, track, &snapshot, who.data[i], &eye) < 0) break;
        Pen pen = {.view = view, .out = out.data + rows.data[i] * view->size};
        const OwnState own = own_of(eye.kart);
        look_at(view, &eye, 0, road);
        for (npy_intp mark = 0; mark < marks; mark++) {
            const float distance = view->marks.data[mark];
            look_at(view, &eye, distance, road + LINE * (1 + mark));
            look_at(view, &eye, distance + view->beyond, road + LINE * (1 + marks + mark));
        }
        see_karts(&eye, &snapshot, num_karts, karts);
        see_items(&eye, &snapshot, num_items, items, types);
        put_own(&pen, &own);
        put_road(&pen, road);
        put_karts(&pen, karts, num_karts);
        put_items(&pen, items, types, num_items);
    }
    PyMem_Free(types);
    if (PyErr_Occurred()) return NULL;
    Py_RETURN_NONE;
}

/* look(data, road, who, looks, numbers, kinds, around): writes the own state and the surroundings of
   each kart of `who`. */
static PyObject *racing_look(PyObject *self, PyObject *args)
{
    const RacingObserver *view = (RacingObserver *)self;
    Snapshot snapshot;
    npy_intp track;
    PyObject *numbers, *kinds, *arrays;
    Indices who;
    OwnArrays own;
    Floats looks, road, karts, items;
    Wholes types;
    if (!PyArg_ParseTuple(args, "O&nO&O&O!O!O!", as_snapshot, &snapshot, &track, as_indices, &who,
                          as_floats, &looks, &PyTuple_Type, &numbers, &PyTuple_Type, &kinds,
                          &PyTuple_Type, &arrays) ||
        !read_own(numbers, kinds, as_written_floats, as_written_wholes, &own) ||
        !PyArg_ParseTuple(arrays, "O&O&O&O&", as_written_floats, &road, as_written_floats, &karts,
                          as_written_floats, &items, as_written_wholes, &types)) {
        return NULL;
    }
    const npy_intp count = who.size;
    if (!count) Py_RETURN_NONE;
    const npy_intp num_karts = karts.size / (3 * count), num_items = types.size / count;
    if (road.size != LINE * looks.size * count || karts.size != 3 * num_karts * count ||
        types.size != num_items * count || items.size != 3 * num_items * count ||
        num_karts < snapshot.header->num_kart || num_items < snapshot.header->num_items ||
        !has_rows_of(&own, count)) {
        return PyErr_Format(PyExc_ValueError, "the arrays of %zd karts do not fit together", count);
    }
    for (npy_intp i = 0; i < count; i++) {
        Eye eye;
        if (open_eye(view, track, &snapshot, who.data[i], &eye) < 0) return NULL;
        const OwnState state = own_of(eye.kart);
        store_own(&state, &own, i);
        see_road(view, &eye, looks, road.data + LINE * looks.size * i);
        see_karts(&eye, &snapshot, num_karts, karts.data + 3 * num_karts * i);
        see_items(&eye, &snapshot, num_items, items.data + 3 * num_items * i,
                  types.data + num_items * i);
    }
    Py_RETURN_NONE;
}

/* write(numbers, kinds, around, out): writes the view of karts with given surroundings into the
   first columns of `out`. */
static PyObject *racing_write(PyObject *self, PyObject *args)
{
    const RacingObserver *view = (RacingObserver *)self;
    PyObject *own_numbers, *own_kinds, *around;
    OwnArrays own;
    Floats road, karts, items, out;
    Wholes types;
    if (!PyArg_ParseTuple(args, "O!O!O!O&", &PyTuple_Type, &own_numbers, &PyTuple_Type, &own_kinds,
                          &PyTuple_Type, &around, as_written_floats, &out) ||
        !read_own(own_numbers, own_kinds, as_floats, as_wholes, &own) ||
        !PyArg_ParseTuple(around, "O&O&O&O&", as_floats, &road, as_floats, &karts, as_floats,
                          &items, as_wholes, &types)) {
        return NULL;
    }
    const npy_intp count = own.velocity.size / 3;
    if (!count) Py_RETURN_NONE;
    const npy_intp num_looks = road.size / (LINE * count), num_karts = karts.size / (3 * count);
    const npy_intp num_items = types.size / count, width = out.size / count;
    const int fits = has_rows_of(&own, count) && road.size == LINE * num_looks * count &&
               num_looks > 2 * view->marks.size && karts.size == 3 * num_karts * count &&
               types.size == num_items * count && items.size == 3 * num_items * count &&
               out.size == width * count && width >= view->size;
    if (!fits) {
        return PyErr_Format(PyExc_ValueError, "the arrays of %zd karts do not fit together", count);
    }
    for (npy_intp i = 0; i < count; i++) {
        Pen pen = {.view = view, .out = out.data + width * i};
        const OwnState state = own_at(&own, i);
        put_own(&pen, &state);
        put_road(&pen, road.data + LINE * num_looks * i);
        put_karts(&pen, karts.data + 3 * num_karts * i, num_karts);
        put_items(&pen, items.data + 3 * num_items * i, types.data + num_items * i, num_items);
    }
    Py_RETURN_NONE;
}

/* Reads the arrays of the tracks. Returns -1 with an exception set on failure. */
static int read_tracks(RacingObserver *view, PyObject *roads)
{
    view->num_tracks = PyTuple_GET_SIZE(roads);
    view->tracks = room_for(view, view->num_tracks, sizeof *view->tracks);
    if (!view->tracks) return -1;
    for (npy_intp i = 0; i < view->num_tracks; i++) {
        Track *track = view->tracks + i;
        PyObject *road = PyTuple_GET_ITEM(roads, i);
        if (!PyTuple_Check(road)) return refuse("a road must be a tuple of arrays");
        if (!PyArg_ParseTuple(road, "O&O&O&", as_floats, &track->lines, as_floats, &track->starts,
                              as_floats, &track->along)) {
            return -1;
        }
        track->num_nodes = track->starts.size / 3;
        track->num_points =
            track->num_nodes ? track->lines.size / (LINE * track->num_nodes) : 0;
        if (!track->num_nodes || track->starts.size != 3 * track->num_nodes ||
            track->along.size != track->starts.size || track->num_points < 2 ||
            track->lines.size != LINE * track->num_nodes * track->num_points) {
            return refuse("the road's arrays do not fit together");
        }
    }
    return 0;
}

static int fits_together(const RacingObserver *view)
{
    const int counts[] = {view->karts, view->goods, view->bads};
    int fits = view->step > 0 && view->num_powerups >= 0 && view->num_kinds >= 0 &&
               view->num_hangs >= 0;
    for (int i = 0; i < 3; i++) fits &= counts[i] >= 0 && counts[i] <= MOST;
    return fits;
}

/* RacingObserver(roads, (marks, items, attachments), (counts), (lengths)) */
static int racing_set_up(RacingObserver *view, PyObject *args, PyObject *Py_UNUSED(kwargs))
{
    PyObject *roads, *tables;
    if (!PyArg_ParseTuple(args, "O!O!(iiiiii)(ffffff)", &PyTuple_Type, &roads, &PyTuple_Type,
                          &tables, &view->num_powerups, &view->num_hangs,
                          &view->num_kinds, &view->karts, &view->goods, &view->bads, &view->step,
                          &view->beyond, &view->kart_reach, &view->item_reach, &view->item_ahead,
                          &view->item_level) ||
        !PyArg_ParseTuple(tables, "O&O&O&", as_floats, &view->marks, as_bytes, &view->items,
                          as_bytes, &view->attachments)) {
        return -1;
    }
    if (!fits_together(view)) return refuse("the view's numbers do not fit together");
    view->size = 10 + (npy_intp)view->num_powerups + view->num_hangs + LINE + 6 * view->marks.size +
                 4 * view->karts + (5 + (npy_intp)view->num_kinds) * view->goods + 5 * view->bads;
    return read_tracks(view, roads);
}

KERNEL_TYPE(RacingObserver, racing, "Makes the view `racing` on a set of tracks.",
            {"observe", racing_observe, METH_VARARGS,
             "Writes the views of karts into rows."},
            {"look", racing_look, METH_VARARGS, "Writes the surroundings of karts."},
            {"write", racing_write, METH_VARARGS, "Writes the views for given surroundings."})
