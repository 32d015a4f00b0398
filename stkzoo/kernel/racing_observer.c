/* Converts a snapshot's records to the vectors of the racing view in one pass.

   stkzoo.wrappers.racing.features describes each number; its constants and tables are arguments of
   RacingObserver. Both forms of the view run here: `observe` from a snapshot, and `write` from the
   observations of any environment in the `full` view. */

#include "geometry.h"

/* A point of a line has LINE_SIZE numbers: x, y, z, and the distance to the edge of the road. */

typedef struct {
    OBJECT_HEAD
    Floats lines, starts, along; /* of the road: (N, points, LINE_SIZE), (N, 3), (N, 3) */
    npy_intp num_nodes, num_points;
    Floats marks;      /* distances at which the road is observed [m] */
    Floats looks;      /* all distances, see set_looks() */
    Bytes items;       /* by type: column of a good item, -1 for a bad one, -2 for others */
    Bytes attachments; /* by type: column, or -1 */
    int num_powerups, num_hangs, num_kinds; /* one-hot lengths */
    int karts, goods, bads; /* numbers of objects in the view */
    float step, beyond, kart_reach, item_reach, item_ahead, item_level;
    npy_intp size;
} RacingObserver;

enum { MOST = 8 }; /* largest number of objects of one kind in the view */

typedef struct {
    const RacingObserver *view;
    float *out;
} Pen;

/* The observing kart, its rotation, and its distance from the start of its segment [m]. */
typedef struct {
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

static void put_one_of(Pen *pen, float which, int count)
{
    for (int i = 0; i < count; i++) put(pen, (float)i == which ? 1.0f : 0.0f);
}

/* Returns a table's entry for a type, or `none` for types outside the table and NaN. */
static int entry_of(Bytes table, double type, int none)
{
    return type >= 0 && type < (double)table.size ? table.data[(npy_intp)type] : none;
}

/* ---------------------------------------------------------------- own state */

static OwnState own_of(const Kart *kart)
{
    return (OwnState){
        .velocity = {kart->velocity_lc[0], kart->velocity_lc[1], kart->velocity_lc[2]},
        .max_steer_angle = kart->max_steer_angle,
        .skeed_factor = kart->skeed_factor,
        .energy = kart->energy,
        .attachment_time_left = kart->attachment_time_left,
        .shield_time = kart->shield_time,
        .jumping = (float)kart->jumping,
        .powerup_type = (float)kart->powerup_type,
        .powerup_count = (float)powerup_count(kart),
        .attachment = (float)kart->attachment_type,
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
    put(pen, own->jumping);
    put_one_of(pen, own->powerup_type, view->num_powerups);
    put(pen, own->powerup_count / 3.0f);
    put_one_of(pen, (float)entry_of(view->attachments, own->attachment, -1), view->num_hangs);
}

/* ---------------------------------------------------------------- the road */

/* Writes the line's point at a distance ahead of the kart, in the kart's frame, and the point's
   distance to the edge of the road. */
static void look_at(const RacingObserver *view, const Eye *eye, float distance, float *point)
{
    const float *line = view->lines.data + LINE_SIZE * view->num_points * eye->kart->node;
    float there[LINE_SIZE];
    look_on_line(line, view->num_points, (eye->passed + distance) / view->step, there);
    to_kart_frame(eye->kart, eye->matrix, there, point);
    point[3] = there[3];
}

/* Writes the features of the road from its points beside the kart, at the marks and beyond them. */
static void put_road(Pen *pen, const float *road)
{
    const npy_intp count = pen->view->marks.size;
    const float *marks = pen->view->marks.data;
    for (int i = 0; i < LINE_SIZE; i++) put(pen, road[i] / 10.0f);
    float *out = pen->out;
    for (npy_intp mark = 0; mark < count; mark++) {
        const float *point = road + LINE_SIZE * (1 + mark), *beyond = point + LINE_SIZE * count;
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
        const int kind = entry_of(view->items, (double)types[i], -2);
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
        put_one_of(pen, i < num_goods ? (float)goods[i].which : -1.0f, view->num_kinds);
    }
    put_places(pen, bads, num_bads, view->bads);
    for (int i = 0; i < view->bads; i++) put(pen, i < num_bads ? bads[i].place[0] / 5.0f : 0);
}

/* ---------------------------------------------------------------- a kart's surroundings */

/* Sets the observing kart. Returns -1 with an exception set if its segment does not exist. */
static int open_eye(const RacingObserver *view, const Kart *kart, Eye *eye)
{
    eye->kart = kart;
    const npy_intp node = eye->kart->node;
    if (node < 0 || node >= view->num_nodes) {
        PyErr_Format(PyExc_IndexError, "there is no segment %zd", node);
        return -1;
    }
    rotation_matrix(eye->kart, eye->matrix);
    float start[3];
    for (int i = 0; i < 3; i++) {
        start[i] = view->starts.data[3 * node + i] - eye->kart->location[i];
    }
    eye->passed = way_passed(start, view->along.data + 3 * node);
    return 0;
}

/* What one kart observes: points of the road, other karts, and items. */
typedef struct {
    float *road, *karts, *items;
    npy_int64 *types;
    npy_intp num_karts, num_items;
} Sight;

/* Writes the road at several distances ahead of the kart. Writes the positions of the other karts in
   the kart's frame: infinity for missing karts and for the kart itself. Writes the positions of the
   items and their types; missing items have position 0 and type -1. Karts and items for which there
   is no room are left out. */
static void see(const RacingObserver *view, const Eye *eye, const Snapshot *snapshot, Floats looks,
                const Sight *sight)
{
    for (npy_intp i = 0; i < looks.size; i++) {
        look_at(view, eye, looks.data[i], sight->road + LINE_SIZE * i);
    }
    for (npy_intp i = 0; i < sight->num_karts; i++) {
        const Kart *other = snapshot->karts + i;
        float *out = sight->karts + 3 * i;
        if (i < snapshot->header->num_kart && other != eye->kart) {
            to_kart_frame(eye->kart, eye->matrix, other->location, out);
        } else {
            out[0] = out[1] = out[2] = INFINITY;
        }
    }
    for (npy_intp i = 0; i < sight->num_items; i++) {
        const Item *item = snapshot->items + i;
        const int is_there = i < snapshot->header->num_items;
        float *out = sight->items + 3 * i;
        sight->types[i] = is_there ? item->type : -1;
        if (is_there) to_kart_frame(eye->kart, eye->matrix, item->location, out);
        else out[0] = out[1] = out[2] = 0;
    }
}

/* Returns a row of the arrays of surroundings. */
static Sight sight_at(const Around *around, npy_intp row)
{
    const npy_intp num_karts = around->num_karts, num_items = around->num_items;
    return (Sight){
        .road = around->road.data + LINE_SIZE * around->num_looks * row,
        .karts = around->karts.data + 3 * num_karts * row,
        .items = around->items.data + 3 * num_items * row,
        .types = around->types.data + num_items * row,
        .num_karts = num_karts,
        .num_items = num_items,
    };
}

static void put_view(const RacingObserver *view, const OwnState *own, const Sight *sight, float *out)
{
    Pen pen = {.view = view, .out = out};
    put_own(&pen, own);
    put_road(&pen, sight->road);
    put_karts(&pen, sight->karts, sight->num_karts);
    put_items(&pen, sight->items, sight->types, sight->num_items);
}

/* ---------------------------------------------------------------- the type */

/* observe(data, who, rows, out): writes the view of kart who[i] into row rows[i] of `out`. */
static PyObject *racing_observe(PyObject *self, PyObject *args)
{
    const RacingObserver *view = (RacingObserver *)self;
    Snapshot snapshot;
    Indices who, rows;
    Floats out;
    if (!PyArg_ParseTuple(args, "O&O&O&O&", as_snapshot, &snapshot, as_indices, &who, as_indices,
                          &rows, as_written_floats, &out)) {
        return NULL;
    }
    if (out.size % view->size) return refuse("the rows have another size than the view"), NULL;
    if (check_rows("kart", who, snapshot.header->num_kart, rows, out.size / view->size) < 0) return NULL;
    Sight sight = {.num_karts = snapshot.header->num_kart, .num_items = snapshot.header->num_items};
    const size_t floats =
        (size_t)(LINE_SIZE * view->looks.size + 3 * (sight.num_karts + sight.num_items));
    const size_t num_items = (size_t)sight.num_items;
    if (!(sight.types = PyMem_Malloc(num_items * sizeof *sight.types + floats * sizeof(float)))) {
        return PyErr_NoMemory();
    }
    sight.road = (float *)(sight.types + num_items);
    sight.karts = sight.road + LINE_SIZE * view->looks.size;
    sight.items = sight.karts + 3 * sight.num_karts;
    for (npy_intp i = 0; i < who.size; i++) {
        Eye eye;
        if (open_eye(view, snapshot.karts + who.data[i], &eye) < 0) break;
        const OwnState own = own_of(eye.kart);
        see(view, &eye, &snapshot, view->looks, &sight);
        put_view(view, &own, &sight, out.data + rows.data[i] * view->size);
    }
    PyMem_Free(sight.types);
    return PyErr_Occurred() ? NULL : Py_NewRef(Py_None);
}

/* look(data, who, looks, around): writes the surroundings of each kart of `who`. */
static PyObject *racing_look(PyObject *self, PyObject *args)
{
    const RacingObserver *view = (RacingObserver *)self;
    Snapshot snapshot;
    PyObject *arrays;
    Indices who;
    Floats looks;
    Around around;
    if (!PyArg_ParseTuple(args, "O&O&O&O!", as_snapshot, &snapshot, as_indices, &who, as_floats,
                          &looks, &PyTuple_Type, &arrays) ||
        read_around(arrays, 1, &around) < 0) {
        return NULL;
    }
    if (around.count != who.size || (who.size && around.num_looks != looks.size) ||
        !are_below(who, snapshot.header->num_kart)) {
        return refuse("the arrays do not fit the karts or the distances"), NULL;
    }
    for (npy_intp i = 0; i < who.size; i++) {
        Eye eye;
        if (open_eye(view, snapshot.karts + who.data[i], &eye) < 0) return NULL;
        const Sight sight = sight_at(&around, i);
        ((OwnState *)around.own.data)[i] = own_of(eye.kart);
        see(view, &eye, &snapshot, looks, &sight);
    }
    Py_RETURN_NONE;
}

/* write(around, out): writes the view of karts with given surroundings into the first columns of
   `out`. */
static PyObject *racing_write(PyObject *self, PyObject *args)
{
    const RacingObserver *view = (RacingObserver *)self;
    PyObject *arrays;
    Around around;
    Floats out;
    if (!PyArg_ParseTuple(args, "O!O&", &PyTuple_Type, &arrays, as_written_floats, &out) ||
        read_around(arrays, 0, &around) < 0) {
        return NULL;
    }
    const npy_intp count = around.count, width = count ? out.size / count : 0;
    if (count && (around.num_looks < view->looks.size || out.size != width * count ||
                  width < view->size)) {
        return PyErr_Format(PyExc_ValueError, "the arrays of %zd karts do not fit together", count);
    }
    for (npy_intp i = 0; i < count; i++) {
        const Sight sight = sight_at(&around, i);
        put_view(view, (const OwnState *)around.own.data + i, &sight, out.data + width * i);
    }
    Py_RETURN_NONE;
}

/* Reads the arrays of the road, if any. Returns -1 with an exception set on failure. */
static int read_road(RacingObserver *view, PyObject *road)
{
    if (!PyTuple_GET_SIZE(road)) return 0;
    if (!PyArg_ParseTuple(road, "O&O&O&", as_floats, &view->lines, as_floats, &view->starts,
                          as_floats, &view->along)) {
        return -1;
    }
    const npy_intp count = view->num_nodes = view->starts.size / 3;
    view->num_points = count ? view->lines.size / (LINE_SIZE * count) : 0;
    if (view->starts.size != 3 * count || view->along.size != view->starts.size ||
        view->num_points < 2 || view->lines.size != LINE_SIZE * count * view->num_points) {
        return refuse("the road's arrays do not fit together");
    }
    return 0;
}

/* Sets the distances at which the road is observed: beside the kart, at the marks, and beyond. */
static int set_looks(RacingObserver *view)
{
    const npy_intp count = view->marks.size;
    view->looks.size = 1 + 2 * count;
    if (!(view->looks.data = room_for(view, view->looks.size, sizeof(float)))) return -1;
    for (npy_intp i = 0; i < count; i++) {
        view->looks.data[1 + i] = view->marks.data[i];
        view->looks.data[1 + count + i] = view->marks.data[i] + view->beyond;
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

/* RacingObserver(road, (marks, items, attachments), (counts), (lengths)) */
static int racing_set_up(RacingObserver *view, PyObject *args, PyObject *Py_UNUSED(kwargs))
{
    PyObject *road, *tables;
    if (!PyArg_ParseTuple(args, "O!O!(iiiiii)(ffffff)", &PyTuple_Type, &road, &PyTuple_Type,
                          &tables, &view->num_powerups, &view->num_hangs,
                          &view->num_kinds, &view->karts, &view->goods, &view->bads, &view->step,
                          &view->beyond, &view->kart_reach, &view->item_reach, &view->item_ahead,
                          &view->item_level) ||
        !PyArg_ParseTuple(tables, "O&O&O&", as_floats, &view->marks, as_bytes, &view->items,
                          as_bytes, &view->attachments)) {
        return -1;
    }
    if (!fits_together(view)) return refuse("the view's numbers do not fit together");
    view->size = 10 + (npy_intp)view->num_powerups + view->num_hangs + LINE_SIZE + 6 * view->marks.size +
                 4 * view->karts + (5 + (npy_intp)view->num_kinds) * view->goods + 5 * view->bads;
    return set_looks(view) < 0 ? -1 : read_road(view, road);
}

KERNEL_TYPE(RacingObserver, racing, "Makes the view `racing` on a road.",
            {"observe", racing_observe, METH_VARARGS,
             "Writes the views of karts into rows."},
            {"look", racing_look, METH_VARARGS, "Writes the surroundings of karts."},
            {"write", racing_write, METH_VARARGS, "Writes the views for given surroundings."})
