/* A kart's frame and its own state, and sorted lists of nearby objects. */

#ifndef STKZOO_GEOMETRY_H
#define STKZOO_GEOMETRY_H

#include "kernel.h"

#include <math.h>
#include <string.h>

/* stkzoo.mdp.spaces.POWERUP_COUNT_LIMIT */
enum { POWERUP_COUNT_LIMIT = 9 };

/* Returns the number of powerups that observations show. */
static inline npy_int32 powerup_count(const Kart *kart)
{
    return kart->powerup_num < POWERUP_COUNT_LIMIT ? kart->powerup_num : POWERUP_COUNT_LIMIT;
}

/* Returns the matrix of the kart's unit quaternion q = (w, x, y, z), the expansion of q v q*. It
   rotates directions from the world frame to the kart's frame. */
static inline void rotation_matrix(const Kart *kart, float m[9])
{
    const float *q = kart->rotation;
    const float w = q[0], x = q[1], y = q[2], z = q[3];
    m[0] = w * w + x * x - y * y - z * z;
    m[1] = 2 * x * y - 2 * w * z;
    m[2] = 2 * x * z + 2 * w * y;
    m[3] = 2 * x * y + 2 * w * z;
    m[4] = w * w - x * x + y * y - z * z;
    m[5] = 2 * y * z - 2 * w * x;
    m[6] = 2 * x * z - 2 * w * y;
    m[7] = 2 * y * z + 2 * w * x;
    m[8] = w * w - x * x - y * y + z * z;
}

/* Rotates a direction from the world frame to the frame of a kart with this rotation matrix. */
static inline void rotate(const float m[9], float x, float y, float z, float *out)
{
    out[0] = x * m[0] + y * m[1] + z * m[2];
    out[1] = x * m[3] + y * m[4] + z * m[5];
    out[2] = x * m[6] + y * m[7] + z * m[8];
}

/* Transforms a point [m] from the world frame to the kart's frame: x right, y up, z forward. */
static inline void to_kart_frame(const Kart *kart, const float m[9], const float *point,
                                 float *out)
{
    const float *o = kart->location;
    rotate(m, point[0] - o[0], point[1] - o[1], point[2] - o[2], out);
}

static inline float dot(const float *v, const float *w)
{
    return v[0] * w[0] + v[1] * w[1] + v[2] * w[2];
}

static inline float length(const float *v)
{
    return sqrtf(dot(v, v));
}

/* Returns how far along its segment a kart is [m]. The kart is at the origin; `start` is the start
   of the segment, and `along` the vector to its end. */
static inline float way_passed(const float *start, const float *along)
{
    const float squared = dot(along, along);
    const float share = -dot(start, along) / (squared > 0 ? squared : 1.0f);
    return (share < 0 ? 0 : share > 1 ? 1 : share) * sqrtf(squared);
}

/* Interpolates all four columns of a line of at least two points. `place` is a fractional index of
   these points; values beyond an end extrapolate the line. */
static inline void look_on_line(const float *line, npy_intp num_points, float place, float *point)
{
    const npy_intp last = num_points - 2;
    /* NaN and places beyond the ends must not become an index. */
    const npy_intp before = place >= (float)last ? last : place > 0 ? (npy_intp)place : 0;
    const float share = place - (float)before, *first = line + 4 * before;
    for (int i = 0; i < 4; i++) point[i] = first[i] + (first[4 + i] - first[i]) * share;
}

/* A nearby object in a kart's frame. */
typedef struct {
    float key;      /* sort key */
    float place[3];
    int which;
} Near;

/* Inserts an object into a sorted list of at most `limit` objects and returns the new length. Keys
   that are not negative come first, in ascending order; negative keys follow, in descending order.
   Objects with equal keys stay in the order of insertion. */
static inline npy_intp insert(Near *nearest, npy_intp count, npy_intp limit, const Near *one)
{
    npy_intp low = 0, high = count;
    while (low < high) {
        const npy_intp middle = (low + high) / 2;
        const float key = one->key, other = nearest[middle].key;
        const int is_before = key < 0 ? other < 0 && key > other : other < 0 || key < other;
        if (is_before) high = middle;
        else low = middle + 1;
    }
    if (low >= limit) return count;
    if (count < limit) count++;
    memmove(nearest + low + 1, nearest + low, (size_t)(count - 1 - low) * sizeof *nearest);
    nearest[low] = *one;
    return count;
}

#endif
