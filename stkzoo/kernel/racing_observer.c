/* The view racing, from records to its vector, in one pass.

   The formulas are those of stkzoo.wrappers.racing.features, the order of the numbers is that of
   stkzoo.wrappers.racing.layout, from where constants and tables are given. */

#include "geometry.h"

enum { LINE = 4 }; /* x, y, z and room of a line's point */

typedef struct {
    OBJECT_HEAD
    Floats lines, starts, along; /* (N, points, 4), (N, 3), (N, 3) */
    npy_intp num_nodes, num_points;
    Floats marks;      /* where the road is looked at */
    Bytes items;       /* by type: a good one's column, -1 for a bad one, -2 for others */
    Bytes attachments; /* by type: its column, or -1 */
    int num_powerups, powerup_limit, num_hangs, num_kinds; /* columns of the one-hot parts */
    int karts, goods, bads;                                /* how many are seen */
    float step, beyond, kart_reach, item_reach, item_ahead, item_level;
    npy_intp size;
} RacingObserver;

enum { MOST = 8 }; /* that are seen of one sort */

typedef struct {
    const RacingObserver *view;
    const Kart *me;
    float matrix[9];
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

static void put_one_of(Pen *pen, npy_intp which, int count)
{
    for (int i = 0; i < count; i++) put(pen, i == which ? 1.0f : 0.0f);
}

/* A table's entry for a type; `none` for types that it does not know. */
static int entry_of(Bytes table, npy_int32 type, int none)
{
    return type >= 0 && type < table.size ? table.data[type] : none;
}

/* ---------------------------------------------------------------- the kart itself */

static void put_own(Pen *pen)
{
    const RacingObserver *view = pen->view;
    const Kart *me = pen->me;
    for (int i = 0; i < 3; i++) put(pen, me->velocity_lc[i] / 20.0f);
    put(pen, me->max_steer_angle);
    put(pen, me->skeed_factor);
    put(pen, me->energy / 20.0f);
    put(pen, me->attachment_time_left / 10.0f);
    put(pen, me->shield_time / 10.0f);
    put(pen, (float)me->jumping);
    put_one_of(pen, me->powerup_type, view->num_powerups);
    const int count = me->powerup_num;
    put(pen, (float)(count < view->powerup_limit ? count : view->powerup_limit) / 3.0f);
    put_one_of(pen, entry_of(view->attachments, me->attachment_type, -1), view->num_hangs);
}

/* ---------------------------------------------------------------- the road */

/* How far the kart has come on its segment [m]. */
static float passed(const RacingObserver *view, const Kart *me)
{
    const float *start = view->starts.data + 3 * me->node;
    const float *along = view->along.data + 3 * me->node;
    float from[3];
    for (int i = 0; i < 3; i++) from[i] = start[i] - me->location[i];
    const float squared = dot(along, along);
    const float share = -dot(from, along) / (squared > 0 ? squared : 1.0f);
    return (share < 0 ? 0 : share > 1 ? 1 : share) * sqrtf(squared);
}

/* The line's point at a distance along it, in the kart's frame, and its room. */
static void look_at(const Pen *pen, float distance, float point[LINE])
{
    const RacingObserver *view = pen->view;
    const float place = distance / view->step;
    const npy_intp last = view->num_points - 2;
    /* NaN, and places before or beyond the line, must not become an index. */
    const npy_intp before = place >= (float)last ? last : place > 0 ? (npy_intp)place : 0;
    const float share = place - (float)before;
    const float *first = view->lines.data + LINE * (view->num_points * pen->me->node + before);
    float there[LINE];
    for (int i = 0; i < LINE; i++) there[i] = first[i] + (first[LINE + i] - first[i]) * share;
    to_kart_frame(pen->me, pen->matrix, there, point);
    point[3] = there[3];
}

static void put_road(Pen *pen)
{
    const RacingObserver *view = pen->view;
    const npy_intp count = view->marks.size;
    const float *marks = view->marks.data;
    const float here = passed(view, pen->me);
    float point[LINE], beyond[LINE];
    look_at(pen, here, point);
    for (int i = 0; i < LINE; i++) put(pen, point[i] / 10.0f);
    float *out = pen->out;
    for (npy_intp mark = 0; mark < count; mark++) {
        look_at(pen, here + marks[mark], point);
        look_at(pen, here + (marks[mark] + view->beyond), beyond);
        const float x = beyond[0] - point[0], z = beyond[2] - point[2];
        const float far = sqrtf(x * x + z * z), least = far > 0.1f ? far : 0.1f;
        for (int i = 0; i < 3; i++) out[3 * mark + i] = clipped(point[i] / marks[mark]);
        out[3 * count + mark] = clipped(point[3] / 10.0f);
        out[4 * count + 2 * mark] = clipped(x / least);
        out[4 * count + 2 * mark + 1] = clipped(z / least);
    }
    pen->out += 6 * count;
}

/* ---------------------------------------------------------------- what is near */

static Near near_of(const Pen *pen, const float *location, int kind)
{
    Near one = {.which = kind};
    to_kart_frame(pen->me, pen->matrix, location, one.place);
    one.key = dot(one.place, one.place);
    return one;
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

static void put_karts(Pen *pen, const Moment *moment)
{
    const RacingObserver *view = pen->view;
    Near nearest[MOST];
    int count = 0;
    for (npy_int32 i = 0; i < moment->header->num_kart; i++) {
        if (moment->karts + i == pen->me) continue;
        const Near one = near_of(pen, moment->karts[i].location, 0);
        if (!(one.key < view->kart_reach * view->kart_reach)) continue;
        count = (int)insert(nearest, count, view->karts, &one);
    }
    put_places(pen, nearest, count, view->karts);
}

static void put_items(Pen *pen, const Moment *moment)
{
    const RacingObserver *view = pen->view;
    Near goods[MOST], bads[MOST];
    int num_goods = 0, num_bads = 0;
    for (npy_int32 i = 0; i < moment->header->num_items; i++) {
        const Item *item = moment->items + i;
        const int kind = entry_of(view->items, item->type, -2);
        if (kind == -2) continue;
        const Near one = near_of(pen, item->location, kind);
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

/* ---------------------------------------------------------------- the type */

/* observe(data, who, out, rows): the view of each kart of `who`, into row rows[i] of `out`; without
   rows, `out` has one for each kart. */
static PyObject *racing_observe(PyObject *self, PyObject *args)
{
    const RacingObserver *view = (RacingObserver *)self;
    Moment moment;
    Indices who, rows = {NULL, 0};
    Floats out;
    if (!PyArg_ParseTuple(args, "O&O&O&|O&", as_moment, &moment, as_indices, &who,
                          as_written_floats, &out, as_indices, &rows)) {
        return NULL;
    }
    const int has_rows = PyTuple_GET_SIZE(args) > 3;
    if (!has_rows && out.size != who.size * view->size) {
        return PyErr_Format(PyExc_ValueError, "out must hold %zd numbers", who.size * view->size);
    }
    if (has_rows && (rows.size != who.size || out.size % view->size)) {
        return PyErr_Format(PyExc_ValueError, "%zd karts for %zd rows of %zd numbers", who.size,
                            rows.size, view->size);
    }
    if (has_rows && !are_below(rows, out.size / view->size)) {
        return PyErr_Format(PyExc_IndexError, "there is no row of that number");
    }
    for (npy_intp i = 0; i < who.size; i++) {
        if (who.data[i] < 0 || who.data[i] >= moment.header->num_kart) {
            return PyErr_Format(PyExc_IndexError, "kart %zd of %d", who.data[i],
                                moment.header->num_kart);
        }
        const npy_intp row = has_rows ? rows.data[i] : i;
        Pen pen = {
            .view = view, .me = moment.karts + who.data[i], .out = out.data + row * view->size};
        if (pen.me->node < 0 || pen.me->node >= view->num_nodes) {
            return PyErr_Format(PyExc_IndexError, "there is no segment %d", pen.me->node);
        }
        rotation_matrix(pen.me, pen.matrix);
        put_own(&pen);
        put_road(&pen);
        put_karts(&pen, &moment);
        put_items(&pen, &moment);
    }
    Py_RETURN_NONE;
}

static int fits_together(const RacingObserver *view)
{
    const int counts[] = {view->karts, view->goods, view->bads};
    int fits = view->num_nodes > 0 && view->starts.size == 3 * view->num_nodes &&
               view->along.size == view->starts.size && view->num_points >= 2 &&
               view->lines.size == LINE * view->num_nodes * view->num_points && view->step > 0 &&
               view->num_powerups >= 0 && view->num_kinds >= 0 && view->num_hangs >= 0;
    for (int i = 0; i < 3; i++) fits &= counts[i] >= 0 && counts[i] <= MOST;
    return fits;
}

/* RacingObserver((lines, starts, along), (marks, items, attachments), (counts), (lengths)) */
static int racing_set_up(RacingObserver *view, PyObject *args, PyObject *Py_UNUSED(kwargs))
{
    if (!PyArg_ParseTuple(args, "(O&O&O&)(O&O&O&)(iiiiiii)(ffffff)", as_floats, &view->lines,
                          as_floats, &view->starts, as_floats, &view->along, as_floats,
                          &view->marks, as_bytes, &view->items, as_bytes, &view->attachments,
                          &view->num_powerups, &view->powerup_limit, &view->num_hangs,
                          &view->num_kinds, &view->karts, &view->goods, &view->bads, &view->step,
                          &view->beyond, &view->kart_reach, &view->item_reach, &view->item_ahead,
                          &view->item_level)) {
        return -1;
    }
    view->num_nodes = view->starts.size / 3;
    view->num_points = view->num_nodes ? view->lines.size / (LINE * view->num_nodes) : 0;
    if (!fits_together(view)) return refuse("the road's arrays do not fit together");
    view->size = 10 + (npy_intp)view->num_powerups + view->num_hangs + LINE + 6 * view->marks.size +
                 4 * view->karts + (5 + (npy_intp)view->num_kinds) * view->goods + 5 * view->bads;
    return 0;
}

KERNEL_TYPE(RacingObserver, racing, "The view racing on a track.",
            {"observe", racing_observe, METH_VARARGS,
             "The view of each of some karts, as rows of an array."})
