/* A layer of a multilayer perceptron, for any number of karts at once.

   Each output is summed in the order of the inputs, without fused multiply-adds. It therefore does
   not depend on other rows, on the number of rows or on the width of the processor's vectors. */

#include "planning.h"
#include "vectors.h"

#include <math.h>
#include <string.h>

/* Number of rows that are summed in registers at once, vectors per row, and columns per block. */
enum { ROWS = 4, VECTORS = 2, BLOCK = VECTORS * sizeof(Lanes) / sizeof(float) };

enum { LINEAR, TANH, RECTIFIER, NUM_ACTIVATIONS }; /* stkzoo.agents.planning.network */

/* Computes tanh for -20 to 20 with an error below 2e-7, as 1 - 2e / (1 + e) with e = exp(-2|x|).
   To compute e, the exponent to base 2 is split into an integer, which becomes the exponent of a
   float, and a fraction, for which the Taylor series of exp up to the ninth power is used. If x is
   NaN, the fraction is NaN; the integer is not, because casting NaN is undefined. */
FORCE_INLINE float tanh_of(float x)
{
    const float exponent = -2.8853900817779268f * fabsf(x); /* -2 / ln 2 */
    const npy_int32 whole = (npy_int32)(exponent > -60.0f ? exponent : -60.0f);
    const float y = 0.6931471805599453f * (exponent - (float)whole);
    float part = 1.0f / 362880;
    part = part * y + 1.0f / 40320;
    part = part * y + 1.0f / 5040;
    part = part * y + 1.0f / 720;
    part = part * y + 1.0f / 120;
    part = part * y + 1.0f / 24;
    part = part * y + 1.0f / 6;
    part = part * y + 0.5f;
    part = part * y + 1.0f;
    part = part * y + 1.0f;
    const npy_int32 bits = (whole + 127) << 23;
    float power;
    memcpy(&power, &bits, sizeof power);
    const float e = part * power;
    return copysignf(1.0f - 2.0f * e / (1.0f + e), x);
}

/* Computes a block of output columns for some rows. */
FORCE_INLINE void sum_block(const float *weights, const float *biases, npy_intp width,
                            const float *ins, npy_intp inputs, npy_intp stride, float *outs,
                            const int rows)
{
    const Lanes *bias = (const Lanes *)biases;
    Lanes sums[ROWS][VECTORS];
    for (int r = 0; r < rows; r++) {
        for (int v = 0; v < VECTORS; v++) sums[r][v] = bias[v];
    }
    for (npy_intp i = 0; i < inputs; i++, weights += width) {
        const Lanes *weight = (const Lanes *)weights;
        for (int r = 0; r < rows; r++) {
            for (int v = 0; v < VECTORS; v++) sums[r][v] += ins[r * stride + i] * weight[v];
        }
    }
    for (int r = 0; r < rows; r++) {
        Lanes *out = (Lanes *)(outs + r * width);
        for (int v = 0; v < VECTORS; v++) out[v] = sums[r][v];
    }
}

/* Applies the activation function. Comparisons are false for NaN and let it pass, as NumPy does. */
FORCE_INLINE void activate(float *numbers, npy_intp count, int activation)
{
    if (activation == TANH) {
        for (npy_intp i = 0; i < count; i++) {
            const float below = numbers[i] > 20.0f ? 20.0f : numbers[i];
            numbers[i] = below < -20.0f ? -20.0f : below;
        }
        /* A separate loop, which compilers can vectorize. */
        for (npy_intp i = 0; i < count; i++) numbers[i] = tanh_of(numbers[i]);
    } else if (activation == RECTIFIER) {
        for (npy_intp i = 0; i < count; i++) numbers[i] = numbers[i] <= 0 ? 0 : numbers[i];
    }
}

FOR_ALL_PROCESSORS
static void compute_rows(Floats matrix, Floats bias, int activation, const float *ins,
                         npy_intp stride, npy_intp count, float *outs)
{
    const npy_intp width = bias.size, inputs = matrix.size / width;
    for (npy_intp row = 0; row < count;) {
        const int rows = count - row < ROWS ? 1 : ROWS;
        const float *in = ins + row * stride;
        float *out = outs + row * width;
        for (npy_intp column = 0; column < width; column += BLOCK) {
            const float *weights = matrix.data + column, *biases = bias.data + column;
            if (rows == 1) sum_block(weights, biases, width, in, inputs, stride, out + column, 1);
            else sum_block(weights, biases, width, in, inputs, stride, out + column, ROWS);
        }
        activate(out, rows * width, activation);
        row += rows;
    }
}

/* compute_layer(matrix, bias, activation, inputs, out): writes a layer's outputs for each row of
   inputs. Rows may have additional columns after the layer's inputs, which are ignored. */
PyObject *compute_layer(PyObject *Py_UNUSED(module), PyObject *args)
{
    Floats matrix, bias, inputs, out;
    int activation;
    if (!PyArg_ParseTuple(args, "O&O&iO&O&", as_floats, &matrix, as_floats, &bias, &activation,
                          as_floats, &inputs, as_written_floats, &out)) {
        return NULL;
    }
    const npy_intp width = bias.size ? bias.size : 1, count = out.size / width;
    const npy_intp stride = count ? inputs.size / count : 0;
    const npy_intp sizes[][2] = {
        {bias.size % BLOCK || !bias.size, 0},
        {matrix.size % width, 0},
        {out.size, count * width},
        {inputs.size, count * stride},
        {count && stride < matrix.size / width, 0},
        {activation >= 0 && activation < NUM_ACTIVATIONS, 1},
    };
    if (ARE_SIZES(sizes) < 0) return NULL;
    compute_rows(matrix, bias, activation, inputs.data, stride, count, out.data);
    Py_RETURN_NONE;
}
