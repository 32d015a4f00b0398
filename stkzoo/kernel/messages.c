/* Computes how much memory it takes to decode a message of stkzoo.drivers.codec. */

#include "kernel.h"

/* Sizes of CPython's and NumPy's objects on a 64-bit machine, rounded up to the sizes that malloc
   allocates [bytes]. The reference implementation uses the same values. */
enum {
    POINTER = 8, LIST = 64, TUPLE = 48, EMPTY_DICT = 80, DICT = 256, ENTRY = 160, NUMBER = 32,
    TEXT = 64, WIDE_TEXT = 80, BYTES = 48, ARRAY = 112, AXIS = 16, WORKING = 1024,
};

enum { MAX_AXES = 8 };
enum { IS_TUPLE = 1, IS_ARRAY, IS_SCALAR, IS_ROWS, IS_ENCODED };

static const unsigned char ITEM_SIZES[] = {1, 1, 2, 4, 8, 1, 2, 4, 8, 2, 4, 8};

typedef struct {
    const unsigned char *at, *end; /* unread part of the innermost extension, or of the message */
    Py_ssize_t max_depth, max_length, max_elements, max_memory;
    Py_ssize_t elements, now, peak;
    const char *fault;
} Scan;

/* A function below that rejects the message sets `fault` and returns 0, or NULL if it returns a
   pointer, or -1 if it returns a length. */
static int fail(Scan *scan, const char *fault)
{
    scan->fault = fault;
    return 0;
}

static int hold(Scan *scan, Py_ssize_t size)
{
    scan->now += size;
    if (scan->now > scan->peak) scan->peak = scan->now;
    return scan->now <= scan->max_memory || fail(scan, "it takes too much memory for its length");
}

static const unsigned char *take(Scan *scan, Py_ssize_t size)
{
    const unsigned char *begin = scan->at;
    if (size > scan->end - begin) {
        fail(scan, "it ends too early");
        return NULL;
    }
    scan->at += size;
    return begin;
}

static int skip(Scan *scan, Py_ssize_t size, Py_ssize_t held)
{
    return take(scan, size) && hold(scan, held);
}

/* Reads a big-endian number of `num_bytes` bytes. */
static Py_ssize_t length_of(Scan *scan, int num_bytes)
{
    const unsigned char *begin = take(scan, num_bytes);
    Py_ssize_t length = 0;
    for (int i = 0; begin && i < num_bytes; i++) length = length << 8 | begin[i];
    return begin ? length : -1;
}

static int count_elements(Scan *scan, Py_ssize_t count)
{
    if (count > scan->max_length) return fail(scan, "it has too many elements in one place");
    scan->elements += count;
    return scan->elements <= scan->max_elements || fail(scan, "it has too many elements");
}

static int scan_value(Scan *scan, Py_ssize_t depth);

static int scan_text(Scan *scan, Py_ssize_t size)
{
    const unsigned char *text = size < 0 ? NULL : take(scan, size);
    if (!text) return 0;
    unsigned char all = 0;
    for (Py_ssize_t i = 0; i < size; i++) all |= text[i];
    if (all < 0x80) return size < 2 || hold(scan, TEXT + size);
    /* At a wider character, Python copies the text decoded so far to a wider form. */
    if (!hold(scan, WIDE_TEXT + 8 * size)) return 0;
    scan->now -= 4 * size;
    return 1;
}

static int scan_items(Scan *scan, Py_ssize_t count, Py_ssize_t depth)
{
    if (depth >= scan->max_depth) return fail(scan, "it is too deep");
    for (Py_ssize_t i = 0; i < count; i++) {
        if (!scan_value(scan, depth + 1)) return 0;
    }
    return 1;
}

static int scan_list(Scan *scan, Py_ssize_t count, Py_ssize_t depth)
{
    return count >= 0 && count_elements(scan, count) && hold(scan, LIST + POINTER * count) &&
           scan_items(scan, count, depth);
}

static int scan_key(Scan *scan)
{
    const Py_ssize_t code = length_of(scan, 1);
    if (code < 0) return 0;
    if (code >= 0xa0 && code < 0xc0) return scan_text(scan, code & 31);
    if (code >= 0xd9 && code <= 0xdb) return scan_text(scan, length_of(scan, 1 << (code - 0xd9)));
    return fail(scan, "it has a dict with a key that is not text");
}

static int scan_dict(Scan *scan, Py_ssize_t count, Py_ssize_t depth)
{
    if (count < 0 || !count_elements(scan, count)) return 0;
    if (!hold(scan, count ? DICT + ENTRY * count : EMPTY_DICT)) return 0;
    if (depth >= scan->max_depth) return fail(scan, "it is too deep");
    for (Py_ssize_t i = 0; i < count; i++) {
        if (!scan_key(scan) || !scan_value(scan, depth + 1)) return 0;
    }
    return 1;
}

/* Scans the elements of an array, which fill the rest of its extension. */
static int scan_elements(Scan *scan, unsigned char dtype, Py_ssize_t axes, Py_ssize_t count)
{
    if (dtype >= sizeof ITEM_SIZES) return fail(scan, "it has an array of an unknown dtype");
    const Py_ssize_t size = scan->end - scan->at;
    if (count * ITEM_SIZES[dtype] != size) {
        return fail(scan, "it has an array whose content does not fit its shape");
    }
    const Py_ssize_t held = ARRAY + AXIS * axes + size;
    if (!skip(scan, size, held) || (!dtype && !hold(scan, held))) return 0;
    if (!dtype) scan->now -= held; /* booleans are compared, which creates a second array */
    return 1;
}

static int scan_array(Scan *scan, int is_rows)
{
    const unsigned char *head = take(scan, 2);
    if (!head) return 0;
    const Py_ssize_t axes = head[1], left = scan->end - scan->at;
    if (axes > MAX_AXES) return fail(scan, "it has an array of too many axes");
    Py_ssize_t count = 1, rows = -1;
    int is_empty = 0;
    for (Py_ssize_t axis = 0; axis < axes; axis++) {
        const unsigned char *bytes = take(scan, 4);
        if (!bytes) return 0;
        const Py_ssize_t length = bytes[0] | bytes[1] << 8 | bytes[2] << 16 |
                                  (Py_ssize_t)bytes[3] << 24;
        if (axis == 0) rows = length;
        is_empty |= length == 0;
        /* The product leaves out zeros: the other axes of an empty array are limited like the
           length of a list. The comparison prevents overflow. */
        if (length && count <= left + scan->max_length) count *= length;
    }
    if (is_empty && count > scan->max_length) {
        return fail(scan, "it has an empty array of a long shape");
    }
    if (!scan_elements(scan, head[0], axes, is_empty ? 0 : count)) return 0;
    if (!is_rows) return 1;
    if (rows < 0) return fail(scan, "it has rows without an axis");
    const Py_ssize_t row = POINTER + (axes > 1 ? ARRAY + AXIS * (axes - 2) : NUMBER);
    return count_elements(scan, rows) && hold(scan, TUPLE + row * rows);
}

static int scan_scalar(Scan *scan)
{
    const unsigned char *dtype = take(scan, 1);
    if (!dtype) return 0;
    const Py_ssize_t before = scan->now;
    if (!scan_elements(scan, *dtype, 0, 1)) return 0;
    scan->now = before;
    return hold(scan, NUMBER);
}

/* A tuple is encoded as a list, which is freed after the tuple has been created. */
static int scan_tuple(Scan *scan, Py_ssize_t depth)
{
    const Py_ssize_t code = length_of(scan, 1);
    if (code < 0) return 0;
    Py_ssize_t count = code & 15;
    if (code == 0xdc || code == 0xdd) {
        count = length_of(scan, code == 0xdc ? 2 : 4);
    } else if (code < 0x90 || code > 0x9f) {
        return fail(scan, "it has a tuple without a list of its items");
    }
    if (!scan_list(scan, count, depth) || !hold(scan, TUPLE + POINTER * count)) return 0;
    scan->now -= LIST + POINTER * count;
    return 1;
}

static int scan_content(Scan *scan, unsigned char type, Py_ssize_t depth)
{
    switch (type) {
    case IS_TUPLE: return scan_tuple(scan, depth);
    case IS_ARRAY: return scan_array(scan, 0);
    case IS_SCALAR: return scan_scalar(scan);
    case IS_ROWS: return scan_array(scan, 1);
    case IS_ENCODED:
        if (depth >= scan->max_depth) return fail(scan, "it is too deep");
        return scan_value(scan, depth + 1);
    default: return fail(scan, "it has an unknown extension type");
    }
}

/* The decoder copies an extension's content before decoding it. */
static int scan_extension(Scan *scan, Py_ssize_t size, Py_ssize_t depth)
{
    if (size < 0) return 0;
    const unsigned char *type = take(scan, 1), *content = type ? take(scan, size) : NULL;
    if (!content || !hold(scan, BYTES + size)) return 0;
    const unsigned char *at = scan->at, *end = scan->end;
    scan->at = content;
    scan->end = content + size;
    if (!scan_content(scan, *type, depth)) return 0;
    if (scan->at != scan->end) return fail(scan, "it goes on after its end");
    scan->at = at;
    scan->end = end;
    scan->now -= BYTES + size;
    return 1;
}

static int scan_bytes(Scan *scan, Py_ssize_t size)
{
    return size >= 0 && skip(scan, size, BYTES + size);
}

static int scan_value(Scan *scan, Py_ssize_t depth)
{
    const Py_ssize_t code = length_of(scan, 1);
    if (code < 0) return 0;
    if (code < 0x80 || code >= 0xfb) return 1; /* Python caches these integers */
    if (code < 0x90) return scan_dict(scan, code & 15, depth);
    if (code < 0xa0) return scan_list(scan, code & 15, depth);
    if (code < 0xc0) return scan_text(scan, code & 31);
    if (code >= 0xe0) return hold(scan, NUMBER);
    switch (code) {
    case 0xc0: case 0xc2: case 0xc3: return 1;
    case 0xc4: case 0xc5: case 0xc6: return scan_bytes(scan, length_of(scan, 1 << (code - 0xc4)));
    case 0xc7: case 0xc8: case 0xc9:
        return scan_extension(scan, length_of(scan, 1 << (code - 0xc7)), depth);
    case 0xca: case 0xcb: return skip(scan, 4 << (code - 0xca), NUMBER);
    case 0xcc: return skip(scan, 1, 0);
    case 0xcd: case 0xce: case 0xcf: return skip(scan, 1 << (code - 0xcc), NUMBER);
    case 0xd0: case 0xd1: case 0xd2: case 0xd3: return skip(scan, 1 << (code - 0xd0), NUMBER);
    case 0xd4: case 0xd5: case 0xd6: case 0xd7: case 0xd8:
        return scan_extension(scan, 1 << (code - 0xd4), depth);
    case 0xd9: case 0xda: case 0xdb: return scan_text(scan, length_of(scan, 1 << (code - 0xd9)));
    case 0xdc: case 0xdd: return scan_list(scan, length_of(scan, 2 << (code - 0xdc)), depth);
    case 0xde: case 0xdf: return scan_dict(scan, length_of(scan, 2 << (code - 0xde)), depth);
    default: return fail(scan, "it has a reserved byte");
    }
}

/* measure_message(data, (max_depth, max_length, max_elements, max_memory)): returns the peak memory
   of decoding [bytes]. Raises ValueError if the data is not a message or exceeds a limit. */
PyObject *measure_message(PyObject *Py_UNUSED(module), PyObject *args)
{
    Py_buffer data;
    Scan scan = {.now = WORKING, .peak = WORKING};
    if (!PyArg_ParseTuple(args, "y*(nnnn)", &data, &scan.max_depth, &scan.max_length,
                          &scan.max_elements, &scan.max_memory)) {
        return NULL;
    }
    scan.at = data.buf;
    scan.end = scan.at + data.len;
    if (scan_value(&scan, 0) && scan.at != scan.end) fail(&scan, "it goes on after its end");
    PyBuffer_Release(&data);
    if (scan.fault) return PyErr_Format(PyExc_ValueError, "%s", scan.fault);
    return PyLong_FromSsize_t(scan.peak);
}
