/* Observes the surroundings of karts on a road, and converts surroundings to the racing view.

   stkzoo.wrappers.racing.features describes each number of the view; its constants and tables are
   arguments here. */

#include "geometry.h"

/* A point of a line has LINE_SIZE numbers: x, y, z, and the distance to the edge of the road. */

typedef struct {
    Floats lines, starts, along; /* (N, points, LINE_SIZE), (N, 3), (N, 3) */
    npy_intp num_nodes, num_points;
    float step; /* distance between the points of a line [m] */
} Road;

/* What the racing view consists of. */
typedef struct {
    Floats looks;      /* distances beside the kart, at the marks and beyond them [m] */
    Bytes items;       /* by type: column of a good item, -1 for a bad one, -2 for others */
    Bytes attachments; /* by type: column, or -1 */
    int num_powerups, num_hangs, num_kinds; /* one-hot lengths */
    int karts, goods, bads;                 /* numbers of objects in the view */
    float kart_reach, item_reach, item_ahead, item_level;
    npy_intp num_marks, size;
} View;

enum { MOST = 8 }; /* largest number of objects of one kind in the view */
enum { RIVALS = 4, RIVAL_SIZE = 9, STANDING_SIZE = 4 + RIVALS * RIVAL_SIZE };
enum { STEER = 1, DRIFT = 3 }; /* places in Kart.control */

/* Rows of an array (count, width). */
typedef struct {
    float *data;
    npy_intp count, width;
} Rows;

/* A converter for "O&". */
static int as_rows(PyObject *object, void *out)
{
    Floats numbers;
    if (!as_written_floats(object, &numbers)) return 0;
    PyArrayObject *array = (PyArrayObject *)object;
    if (PyArray_NDIM(array) != 2) return refuse("expected an array of rows"), 0;
    *(Rows *)out = (Rows){numbers.data, PyArray_DIM(array, 0), PyArray_DIM(array, 1)};
    return 1;
}

typedef struct {
    const View *view;
    float *out;
} Pen;

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
    const View *view = pen->view;
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

/* Writes the features of the road from its points beside the kart, at the marks and beyond them. */
static void put_road(Pen *pen, const float *road)
{
    const npy_intp count = pen->view->num_marks;
    const float *marks = pen->view->looks.data + 1;
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
    const View *view = pen->view;
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
    const View *view = pen->view;
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

/* Writes a row of surroundings: the kart's own state; the road at several distances ahead of it; the
   positions of the other karts in its frame, infinity for missing karts and for itself; and the
   positions of the items and their types. Missing items have position 0 and type -1. Karts and items
   for which there is no room are left out. Returns -1 with an exception set if the kart's segment
   does not exist. */
static int see(const Road *road, const Kart *kart, const Snapshot *snapshot, Floats looks,
               const Around *around, npy_intp row)
{
    const npy_intp node = kart->node;
    if (node < 0 || node >= road->num_nodes) {
        PyErr_Format(PyExc_IndexError, "there is no segment %zd", node);
        return -1;
    }
    float matrix[9], start[3];
    rotation_matrix(kart, matrix);
    for (int i = 0; i < 3; i++) start[i] = road->starts.data[3 * node + i] - kart->location[i];
    const float passed = way_passed(start, road->along.data + 3 * node);
    const float *line = road->lines.data + LINE_SIZE * road->num_points * node;
    ((OwnState *)around->own.data)[row] = own_of(kart);
    float *out = around->road.data + LINE_SIZE * looks.size * row;
    for (npy_intp i = 0; i < looks.size; i++, out += LINE_SIZE) {
        float there[LINE_SIZE];
        look_on_line(line, road->num_points, (passed + looks.data[i]) / road->step, there);
        to_kart_frame(kart, matrix, there, out);
        out[3] = there[3];
    }
    out = around->karts.data + 3 * around->num_karts * row;
    for (npy_intp i = 0; i < around->num_karts; i++, out += 3) {
        const Kart *other = snapshot->karts + i;
        if (i < snapshot->header->num_kart && other != kart) {
            to_kart_frame(kart, matrix, other->location, out);
        } else {
            out[0] = out[1] = out[2] = INFINITY;
        }
    }
    out = around->items.data + 3 * around->num_items * row;
    for (npy_intp i = 0; i < around->num_items; i++, out += 3) {
        const Item *item = snapshot->items + i;
        const int is_there = i < snapshot->header->num_items;
        around->types.data[around->num_items * row + i] = is_there ? item->type : -1;
        if (is_there) to_kart_frame(kart, matrix, item->location, out);
        else out[0] = out[1] = out[2] = 0;
    }
    return 0;
}

/* Reads a road from a tuple; a converter for "O&". */
static int as_road(PyObject *tuple, void *out)
{
    Road *road = out;
    if (!is_tuple(tuple) ||
        !PyArg_ParseTuple(tuple, "O&O&O&f", as_floats, &road->lines, as_floats, &road->starts,
                          as_floats, &road->along, &road->step)) {
        return 0;
    }
    const npy_intp count = road->num_nodes = road->starts.size / 3;
    road->num_points = count ? road->lines.size / (LINE_SIZE * count) : 0;
    const npy_intp sizes[][2] = {
        {road->starts.size, 3 * count},
        {road->along.size, road->starts.size},
        {road->lines.size, LINE_SIZE * count * road->num_points},
        {road->num_points >= 2 && road->step > 0, 1},
    };
    return ARE_SIZES(sizes) == 0;
}

/* look_around(road, data, who, looks, around): writes the surroundings of each kart of `who`. */
PyObject *look_around(PyObject *Py_UNUSED(module), PyObject *args)
{
    Road road;
    Snapshot snapshot;
    PyObject *arrays;
    Indices who;
    Floats looks;
    Around around;
    if (!PyArg_ParseTuple(args, "O&O&O&O&O!", as_road, &road, as_snapshot, &snapshot, as_indices,
                          &who, as_floats, &looks, &PyTuple_Type, &arrays) ||
        read_around(arrays, 1, &around) < 0 ||
        check_rows("kart", who, snapshot.header->num_kart, who, NPY_MAX_INTP) < 0) {
        return NULL;
    }
    const npy_intp sizes[][2] = {
        {around.count, who.size}, {around.num_looks, who.size ? looks.size : 0}
    };
    if (ARE_SIZES(sizes) < 0) return NULL;
    for (npy_intp i = 0; i < who.size; i++) {
        if (see(&road, snapshot.karts + who.data[i], &snapshot, looks, &around, i) < 0) return NULL;
    }
    Py_RETURN_NONE;
}

/* ---------------------------------------------------------------- standing */

/* Writes the standing of a kart (STANDING of stkzoo.mdp.spaces): its rank among all karts, its
   progress, its last steering and drift; and for the RIVALS nearest karts, their position, velocity
   relative to the kart, lead along the race, and whether they are teammates. */
static void put_standing(Pen *pen, const Snapshot *snapshot, const Kart *kart, Indices teams,
                         float race_length)
{
    const npy_intp num_karts = snapshot->header->num_kart;
    float matrix[9];
    rotation_matrix(kart, matrix);
    Near nearest[RIVALS] = {{0}};
    npy_intp count = 0;
    for (npy_intp i = 0; i < num_karts; i++) {
        if (snapshot->karts + i == kart) continue;
        Near one = {.which = (int)i};
        to_kart_frame(kart, matrix, snapshot->karts[i].location, one.place);
        one.key = dot(one.place, one.place);
        count = insert(nearest, count, RIVALS, &one);
    }
    const float others = num_karts > 1 ? (float)(num_karts - 1) : 1.0f;
    put(pen, (float)(kart->position - 1) / others);
    put(pen, kart->overall_distance / race_length);
    put(pen, kart->control[STEER]);
    put(pen, kart->control[DRIFT]);
    const npy_intp team = teams.data[kart - snapshot->karts];
    for (npy_intp i = 0; i < RIVALS; i++) {
        if (i >= count) {
            for (int k = 0; k < RIVAL_SIZE; k++) put(pen, 0.0f);
            continue;
        }
        const Kart *other = snapshot->karts + nearest[i].which;
        const float *v = other->velocity, *u = kart->velocity;
        float motion[3];
        rotate(matrix, v[0] - u[0], v[1] - u[1], v[2] - u[2], motion);
        put(pen, 1.0f);
        for (int k = 0; k < 3; k++) put(pen, nearest[i].place[k] / 20.0f);
        for (int k = 0; k < 3; k++) put(pen, motion[k] / 20.0f);
        put(pen, (other->overall_distance - kart->overall_distance) / 20.0f);
        put(pen, team >= 0 && teams.data[nearest[i].which] == team ? 1.0f : 0.0f);
    }
}

/* observe_standing(data, teams, race_length, who, rows, out, column): writes the standing of kart
   who[i] into row rows[i] of `out`, from a column on. */
PyObject *observe_standing(PyObject *Py_UNUSED(module), PyObject *args)
{
    Snapshot snapshot;
    Indices teams, who, rows;
    float race_length;
    Rows out;
    npy_intp column;
    if (!PyArg_ParseTuple(args, "O&O&fO&O&O&n", as_snapshot, &snapshot, as_indices, &teams,
                          &race_length, as_indices, &who, as_indices, &rows, as_rows, &out,
                          &column) ||
        check_rows("kart", who, snapshot.header->num_kart, rows, out.count) < 0) {
        return NULL;
    }
    const npy_intp sizes[][2] = {
        {teams.size, snapshot.header->num_kart}, {column >= 0 && out.width - column >= STANDING_SIZE, 1}
    };
    if (ARE_SIZES(sizes) < 0) return NULL;
    for (npy_intp i = 0; i < who.size; i++) {
        Pen pen = {.out = out.data + rows.data[i] * out.width + column};
        put_standing(&pen, &snapshot, snapshot.karts + who.data[i], teams, race_length);
    }
    Py_RETURN_NONE;
}

/* ---------------------------------------------------------------- the racing view */

static void put_view(const View *view, const Around *around, npy_intp row, float *out)
{
    Pen pen = {.view = view, .out = out};
    const npy_intp num_karts = around->num_karts, num_items = around->num_items;
    put_own(&pen, (const OwnState *)around->own.data + row);
    put_road(&pen, around->road.data + LINE_SIZE * around->num_looks * row);
    put_karts(&pen, around->karts.data + 3 * num_karts * row, num_karts);
    put_items(&pen, around->items.data + 3 * num_items * row, around->types.data + num_items * row,
              num_items);
}

/* Reads stkzoo.wrappers.racing.features.KERNEL_TABLES; a converter for "O&". */
static int as_view(PyObject *tuple, void *out)
{
    View *v = out;
    if (!is_tuple(tuple) ||
        !PyArg_ParseTuple(tuple, "O&O&O&(iiiiii)(ffff)", as_floats, &v->looks, as_bytes, &v->items,
                          as_bytes, &v->attachments, &v->num_powerups, &v->num_hangs,
                          &v->num_kinds, &v->karts, &v->goods, &v->bads, &v->kart_reach,
                          &v->item_reach, &v->item_ahead, &v->item_level)) {
        return 0;
    }
    const int counts[] = {v->num_powerups, v->num_hangs, v->num_kinds, v->karts, v->goods, v->bads};
    int fits = v->looks.size % 2;
    for (int i = 0; i < 6; i++) fits &= counts[i] >= 0 && (i < 3 || counts[i] <= MOST);
    if (!fits) return refuse("the view's numbers do not fit together"), 0;
    v->num_marks = v->looks.size / 2;
    v->size = 10 + (npy_intp)v->num_powerups + v->num_hangs + LINE_SIZE + 6 * v->num_marks +
              4 * v->karts + (5 + (npy_intp)v->num_kinds) * v->goods + 5 * v->bads;
    return 1;
}

/* write_racing_view(tables, around, out): writes the view of karts with given surroundings into the
   first columns of `out`. */
PyObject *write_racing_view(PyObject *Py_UNUSED(module), PyObject *args)
{
    View view;
    PyObject *arrays;
    Around around;
    Floats out;
    if (!PyArg_ParseTuple(args, "O&O!O&", as_view, &view, &PyTuple_Type, &arrays, as_written_floats,
                          &out) ||
        read_around(arrays, 0, &around) < 0) {
        return NULL;
    }
    const npy_intp count = around.count, width = count ? out.size / count : 0;
    if (count && (around.num_looks < view.looks.size || out.size != width * count ||
                  width < view.size)) {
        return PyErr_Format(PyExc_ValueError, "the arrays of %zd karts do not fit together", count);
    }
    for (npy_intp i = 0; i < count; i++) put_view(&view, &around, i, out.data + width * i);
    Py_RETURN_NONE;
}

/* observe_racing(road, tables, data, who, rows, out): writes the view of kart who[i] into row rows[i]
   of `out`, in its first columns. */
PyObject *observe_racing(PyObject *Py_UNUSED(module), PyObject *args)
{
    Road road;
    View view;
    Snapshot snapshot;
    Indices who, rows;
    Rows out;
    if (!PyArg_ParseTuple(args, "O&O&O&O&O&O&", as_road, &road, as_view, &view, as_snapshot,
                          &snapshot, as_indices, &who, as_indices, &rows, as_rows, &out)) {
        return NULL;
    }
    const npy_intp num_karts = snapshot.header->num_kart, num_items = snapshot.header->num_items;
    if (out.width < view.size) return refuse("the rows are shorter than the view"), NULL;
    if (check_rows("kart", who, num_karts, rows, out.count) < 0) return NULL;
    const npy_intp floats = OWN_SIZE + LINE_SIZE * view.looks.size + 3 * (num_karts + num_items);
    npy_int64 *types = PyMem_Malloc((size_t)num_items * sizeof *types + (size_t)floats * sizeof(float));
    if (!types) return PyErr_NoMemory();
    /* The surroundings of one kart at a time. */
    Around around = {.num_looks = view.looks.size, .num_karts = num_karts, .num_items = num_items};
    around.types.data = types;
    around.own.data = (float *)(types + num_items);
    around.road.data = around.own.data + OWN_SIZE;
    around.karts.data = around.road.data + LINE_SIZE * view.looks.size;
    around.items.data = around.karts.data + 3 * num_karts;
    int status = 0;
    for (npy_intp i = 0; !status && i < who.size; i++) {
        status = see(&road, snapshot.karts + who.data[i], &snapshot, view.looks, &around, 0);
        if (!status) put_view(&view, &around, 0, out.data + rows.data[i] * out.width);
    }
    PyMem_Free(types);
    return status < 0 ? NULL : Py_NewRef(Py_None);
}
