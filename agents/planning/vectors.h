/* Vector types and function versions for different processors, and NumPy's sine and cosine. */

#ifndef STKZOO_VECTORS_H
#define STKZOO_VECTORS_H

#include <math.h>

/* Compiles a function in two versions: for processors with vectors of eight floats and fused
   multiply-adds, and for all others. The version is chosen when the module is loaded. Older
   compilers can only name an Intel processor for the first version, so processors of other
   vendors run the second one. */
#if defined(__x86_64__) && defined(__linux__)
#if __GNUC__ >= 12 && !defined(__clang__)
#define FOR_ALL_PROCESSORS __attribute__((target_clones("arch=x86-64-v3", "default")))
#else
#define FOR_ALL_PROCESSORS __attribute__((target_clones("arch=haswell", "default")))
#endif
#else
#define FOR_ALL_PROCESSORS
#endif

/* A helper of a FOR_ALL_PROCESSORS function. It is inlined, so each version of that function has a
   copy that is compiled for the same processor. */
#define FORCE_INLINE __attribute__((always_inline)) static inline

/* A vector of floats. Operations on it give the same results as on one number at a time. */
typedef float Lanes __attribute__((vector_size(32), aligned(4), may_alias));

/* Computes sine and cosine as NumPy does in float32: a Cody-Waite reduction, followed by
   polynomials. */
FORCE_INLINE void sine_and_cosine(float x, float *sine, float *cosine)
{
    const float magic = 0x1.8p23f;
    const float quarter = (x * 0x1.45f306p-1f + magic) - magic;
    float r = fmaf(quarter, -1.5703125e+00f, x);
    r = fmaf(quarter, -4.837512969970703125e-4f, r);
    r = fmaf(quarter, -7.54978995489188216e-8f, r);
    const float square = r * r;
    float c = fmaf(0x1.98e616p-16f, square, -0x1.6c06dcp-10f);
    c = fmaf(c, square, 0x1.55553cp-05f);
    c = fmaf(c, square, -0.5f);
    c = fmaf(c, square, 1.0f);
    float s = fmaf(0x1.7d3bbcp-19f, square, -0x1.a06bbap-13f);
    s = fmaf(s, square, 0x1.11119ap-07f);
    s = fmaf(s, square, -0x1.555556p-03f);
    s = fmaf(s * square, r, r);
    const float most = 0x1p30f; /* larger values and NaN cannot be cast to int */
    const float below = quarter < most ? quarter : most;
    const int turned = (int)(below > -most ? below : -most);
    const float first = turned & 1 ? c : s, second = turned & 1 ? s : c;
    *sine = turned & 2 ? -first : first;
    *cosine = (turned + 1) & 2 ? -second : second;
}

#endif
