/* Faster forms of functions of the engine, with the same results, bit for bit.

   Engine processes that do not draw load this file before the engine (SHORTCUTS in
   stkzoo/engine/process.py), whose calls then come here. Mangled names, layouts and the order of the
   operations on floats are those of the engine's version there, for x86-64. */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>
#include <xmmintrin.h>

/* ---- The search of a track's triangles near a ray, such as one from a wheel, or in a box ---- */

/* Three coordinates and an unused number. */
typedef float vec __attribute__((vector_size(16)));
typedef int mask __attribute__((vector_size(16)));

/* A node of Bullet's tree over the triangles of a mesh. The nodes below a node follow it; `escape`
   is their number, itself included, and -1 for a node with a triangle (a leaf). */
typedef struct {
    vec low, high;
    int escape, part, triangle, unused[5];
} node;

/* Offsets of the number of nodes and of the nodes in a btQuantizedBvh. */
enum { NUM_NODES = 0x3c, NODES = 0x78 };

/* The virtual functions of a btNodeOverlapCallback. */
typedef struct {
    void (*destroy[2])(void *callback);
    void (*process)(void *callback, int part, int triangle);
} callback_functions;

typedef struct {
    vec from, inverse, least, most; /* 1 / direction; extents of the moved box, 0 for a ray */
    mask is_negative;               /* components of the direction */
    float length;
} ray;

static vec vector_at(const float *numbers)
{
    vec result;
    memcpy(&result, numbers, sizeof result);
    return result;
}

static vec chosen(mask is_first, vec first, vec second)
{
    return (vec)((is_first & (mask)first) | (~is_first & (mask)second));
}

static float sum(vec v) { return v[0] + v[1] + v[2]; }

static int crosses(const ray *ray, const node *node)
{
    const vec low = (node->low - ray->most - ray->from) * ray->inverse;
    const vec high = (node->high - ray->least - ray->from) * ray->inverse;
    const vec enters = chosen(ray->is_negative, high, low);
    const vec leaves = chosen(ray->is_negative, low, high);
    float enter = enters[0], leave = leaves[0];
    for (int axis = 1; axis < 3; axis++) {
        if (enters[axis] > enter) enter = enters[axis];
        if (leaves[axis] < leave) leave = leaves[axis];
    }
    return enter <= leave && enter < ray->length && leave > 0.0f;
}

/* Calls back for each leaf that meets a box and, if there is one, a ray. */
static inline __attribute__((always_inline)) void walk(
    const char *tree, const callback_functions **callback, vec low, vec high, const ray *ray)
{
    int count;
    const node *at;
    memcpy(&count, tree + NUM_NODES, sizeof count);
    memcpy(&at, tree + NODES, sizeof at);
    for (const node *const end = at + count; at < end;) {
        const int is_leaf = at->escape == -1;
        const node *const after = at + (is_leaf ? 1 : at->escape);
        __builtin_prefetch(at + 1);
        __builtin_prefetch(after);
        const vec overlaps = _mm_and_ps(_mm_cmple_ps(low, at->high), _mm_cmpge_ps(high, at->low));
        const int meets = (_mm_movemask_ps(overlaps) & 7) == 7 && (!ray || crosses(ray, at));
        if (meets && is_leaf) (*callback)->process(callback, at->part, at->triangle);
        at = meets ? at + 1 : after;
    }
}

/* btQuantizedBvh::walkStacklessTree */
void _ZNK14btQuantizedBvh17walkStacklessTreeEP21btNodeOverlapCallbackRK9btVector3S4_(
    const char *tree, const callback_functions **callback, const float *low, const float *high)
{
    walk(tree, callback, vector_at(low), vector_at(high), NULL);
}

/* btQuantizedBvh::walkStacklessTreeAgainstRay */
void _ZNK14btQuantizedBvh27walkStacklessTreeAgainstRayEP21btNodeOverlapCallbackRK9btVector3S4_S4_S4_ii(
    const char *tree, const callback_functions **callback, const float *source,
    const float *target, const float *low, const float *high)
{
    const vec from = vector_at(source), to = vector_at(target), way = to - from;
    const vec direction = way * (1.0f / sqrtf(sum(way * way)));
    const vec least = vector_at(low), most = vector_at(high);
    vec inverse = {1.0f, 1.0f, 1.0f, 1.0f};
    for (int axis = 0; axis < 3; axis++)
        inverse[axis] = direction[axis] == 0.0f ? 1e18f : 1.0f / direction[axis];
    const ray ray = {from, inverse, least, most, inverse < 0.0f, sum(direction * way)};
    const vec first = chosen(from < to, from, to) + least, last = chosen(from > to, from, to) + most;
    walk(tree, callback, first, last, &ray);
}

/* ---- dynamic_cast, which compares names of types and climbs the tree of their bases ---- */

/* Where a cast leads depends only on the table of virtual functions and the two types. */
typedef struct {
    const void *table, *from, *to;
    ptrdiff_t offset; /* NONE if the cast fails */
} cast;

enum { NUM_CASTS = 256 };
static const ptrdiff_t NONE = PTRDIFF_MIN;

typedef void *cast_function(const void *, const void *, const void *, ptrdiff_t);

void *__dynamic_cast(const void *object, const void *from, const void *to, ptrdiff_t hint)
{
    static __thread cast casts[NUM_CASTS] __attribute__((tls_model("initial-exec")));
    static __thread cast_function *library_cast __attribute__((tls_model("initial-exec")));
    const void *const table = *(const void *const *)object;
    const uintptr_t key = ((uintptr_t)table >> 3) + ((uintptr_t)to >> 3) * 7;
    cast *const known = &casts[(key ^ key >> 9) % NUM_CASTS];
    if (known->table != table || known->from != from || known->to != to) {
        if (!library_cast)
            library_cast = (cast_function *)dlsym(
                dlopen("libstdc++.so.6", RTLD_LAZY), "__dynamic_cast");
        const char *const result = library_cast(object, from, to, hint);
        *known = (cast){table, from, to, result ? result - (const char *)object : NONE};
    }
    return known->offset == NONE ? NULL : (char *)object + known->offset;
}

/* ---- Vertices of animated models, which only pictures need ---- */

/* irr::scene::CSkinnedMesh::skinMesh */
void _ZN3irr5scene12CSkinnedMesh8skinMeshEf(void) {}
