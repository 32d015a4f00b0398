/* Functions of the C library whose results changed with glibc 2.41, as of glibc 2.40 and older.

   The game's physics and AI use them, so a race would have other bits with a newer library.
   Engine processes therefore load this file (LIBM in stkzoo/engine/process.py), and the kernel
   contains it. The constants and the order of the operations are those of the libraries that glibc
   used: fdlibm (Sun Microsystems, 1993) and, for asinf, Cephes (Stephen Moshier). Each operation
   rounds to a float, so other formulas would have other bits. */

#include <math.h>
#include <stdint.h>
#include <string.h>

/* Pi is the sum of a float and a rest, as other constants below. */
static const float PI = 3.1415927410f, PI_REST = -8.7422776573e-08f;
static const float HALF_PI = 1.5707963705f;

/* Evaluates a polynomial: `coefficient` starts with the constant term. */
static float polynomial(float x, const float *coefficient, int count)
{
    float value = coefficient[count - 1];
    for (int i = count - 2; i >= 0; i--) value = coefficient[i] + x * value;
    return value;
}

/* Clears the last twelve bits of a float. */
static float shortened(float x)
{
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    bits &= 0xfffff000u;
    memcpy(&x, &bits, sizeof x);
    return x;
}

/* The arc tangent of a number is that of a center plus that of a small rest. */
float atanf(float x)
{
    static const float EVEN[] = {3.3333334327e-01f, 1.4285714924e-01f, 9.0908870101e-02f,
                                 6.6610731184e-02f, 4.9768779427e-02f, 1.6285819933e-02f};
    static const float ODD[] = {-2.0000000298e-01f, -1.1111110449e-01f, -7.6918758452e-02f,
                                -5.8335702866e-02f, -3.6531571299e-02f};
    static const float CENTER[] = {4.6364760399e-01f, 7.8539812565e-01f, 9.8279368877e-01f,
                                   1.5707962513e+00f};
    static const float CENTER_REST[] = {5.0121582440e-09f, 3.7748947079e-08f, 3.4473217170e-08f,
                                        7.5497894159e-08f};
    if (isnan(x)) return x + x;
    const float size = fabsf(x);
    if (size >= 0x1p25f) return copysignf(CENTER[3] + CENTER_REST[3], x);
    if (size < 0x1p-29f) return x;
    int center = -1;
    float rest = x;
    if (size >= 2.4375f) {
        center = 3;
        rest = -1.0f / size;
    } else if (size >= 1.1875f) {
        center = 2;
        rest = (size - 1.5f) / (1.0f + 1.5f * size);
    } else if (size >= 0.6875f) {
        center = 1;
        rest = (size - 1.0f) / (size + 1.0f);
    } else if (size >= 0.4375f) {
        center = 0;
        rest = (2.0f * size - 1.0f) / (2.0f + size);
    }
    const float square = rest * rest, fourth = square * square;
    const float correction =
        rest * (square * polynomial(fourth, EVEN, 6) + fourth * polynomial(fourth, ODD, 5));
    if (center < 0) return rest - correction;
    return copysignf(CENTER[center] - ((correction - CENTER_REST[center]) - rest), x);
}

float atan2f(float y, float x)
{
    if (isnan(x) || isnan(y)) return x + y;
    if (x == 1.0f) return atanf(y);
    if (y == 0.0f) return signbit(x) ? copysignf(PI, y) : y;
    if (x == 0.0f) return copysignf(HALF_PI, y);
    if (isinf(x)) {
        const float size = isinf(y) ? HALF_PI / 2.0f : 0.0f;
        const float beyond = isinf(y) ? 3.0f * (HALF_PI / 2.0f) : PI;
        return copysignf(x > 0.0f ? size : beyond, y);
    }
    if (isinf(y)) return copysignf(HALF_PI, y);
    const int steeper = ilogbf(y) - ilogbf(x); /* binary orders of magnitude */
    float angle;
    if (steeper > 60) {
        angle = HALF_PI + 0.5f * PI_REST;
    } else if (x < 0.0f && steeper < -60) {
        angle = 0.0f;
    } else {
        angle = atanf(fabsf(y / x));
    }
    return copysignf(x > 0.0f ? angle : PI - (angle - PI_REST), y);
}

float acosf(float x)
{
    static const float TOP[] = {1.6666667163e-01f,  -3.2556581497e-01f, 2.0121252537e-01f,
                                -4.0055535734e-02f, 7.9153501429e-04f,  3.4793309169e-05f};
    static const float BOTTOM[] = {1.0f, -2.4033949375e+00f, 2.0209457874e+00f,
                                   -6.8828397989e-01f, 7.7038154006e-02f};
    static const float RIGHT = 1.5707962513e+00f, RIGHT_REST = 7.5497894159e-08f;
    const float size = fabsf(x);
    if (!(size <= 1.0f)) return (x - x) / (x - x);
    if (x == 1.0f) return 0.0f;
    if (x == -1.0f) return 2.0f * RIGHT + 2.0f * RIGHT_REST;
    if (size < 0.5f) {
        if (size < 0x1p-57f) return RIGHT + RIGHT_REST;
        const float square = x * x;
        const float ratio = square * polynomial(square, TOP, 6) / polynomial(square, BOTTOM, 5);
        return RIGHT - (x - (RIGHT_REST - x * ratio));
    }
    const float half = (1.0f - size) * 0.5f, root = sqrtf(half);
    const float ratio = half * polynomial(half, TOP, 6) / polynomial(half, BOTTOM, 5);
    if (x < 0.0f) return 2.0f * RIGHT - 2.0f * (root + (ratio * root - RIGHT_REST));
    const float first = shortened(root), rest = (half - first * first) / (root + first);
    return 2.0f * (first + (ratio * root + rest));
}

float asinf(float x)
{
    static const float SERIES[] = {1.666675248e-1f, 7.495297643e-2f, 4.547037598e-2f,
                                   2.417951451e-2f, 4.216630880e-2f};
    static const float RIGHT = 1.57079637050628662109375f, RIGHT_REST = -4.37113900018624283e-8f;
    static const float EIGHTH = 0.785398185253143310546875f;
    const float size = fabsf(x);
    if (size == 1.0f) return x * RIGHT + x * RIGHT_REST;
    if (!(size < 1.0f)) return (x - x) / (x - x);
    if (size < 0.5f) {
        if (size < 0x1p-27f) return x;
        const float square = x * x;
        return x + x * (square * polynomial(square, SERIES, 5));
    }
    const float half = (1.0f - size) * 0.5f, root = sqrtf(half);
    const float ratio = half * polynomial(half, SERIES, 5);
    if (size >= 0.975f) {
        return copysignf(RIGHT - (2.0f * (root + root * ratio) - RIGHT_REST), x);
    }
    const float first = shortened(root), rest = (half - first * first) / (root + first);
    const float correction = 2.0f * root * ratio - (RIGHT_REST - 2.0f * rest);
    return copysignf(EIGHTH - (correction - (EIGHTH - 2.0f * first)), x);
}
