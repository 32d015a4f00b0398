/* Multilayer perceptrons: the networks of drivers, for any number of karts at once.

   Each output is summed in the order of the inputs, without fused multiply-adds. It therefore does
   not depend on other rows, on the number of rows or on the width of the processor's vectors. */

#include "kernel.h"
#include "vectors.h"

#include <string.h>

/* Number of rows that are summed in registers at once, vectors per row, and columns per block. */
enum { ROWS = 4, VECTORS = 2, BLOCK = VECTORS * sizeof(Lanes) / sizeof(float) };

typedef struct {
    npy_intp inputs, outputs, width; /* width: number of outputs, rounded up to whole blocks */
    float *matrix, *bias;            /* (inputs, width), (width,), padded with zeros */
} Layer;

typedef struct {
    OBJECT_HEAD
    PyObject *given; /* the constructor's argument `layers` */
    npy_intp num_layers, widest;
    int is_tanh;
    Layer *layers;
} Mlp;

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

/* Computes a block of a layer's output columns for some rows. */
FORCE_INLINE void sum_block(const Layer *layer, npy_intp column, const float *ins, npy_intp stride,
                            float *outs, const int rows)
{
    const Lanes *bias = (const Lanes *)(layer->bias + column);
    const float *weights = layer->matrix + column;
    Lanes sums[ROWS][VECTORS];
    for (int r = 0; r < rows; r++) {
        for (int v = 0; v < VECTORS; v++) sums[r][v] = bias[v];
    }
    for (npy_intp i = 0; i < layer->inputs; i++, weights += layer->width) {
        const Lanes *weight = (const Lanes *)weights;
        for (int r = 0; r < rows; r++) {
            for (int v = 0; v < VECTORS; v++) sums[r][v] += ins[r * stride + i] * weight[v];
        }
    }
    for (int r = 0; r < rows; r++) {
        Lanes *out = (Lanes *)(outs + r * layer->width + column);
        for (int v = 0; v < VECTORS; v++) out[v] = sums[r][v];
    }
}

/* Applies the activation function. Comparisons are false for NaN and let it pass, as NumPy does. */
FORCE_INLINE void activate(float *numbers, npy_intp count, int is_tanh)
{
    if (is_tanh) {
        for (npy_intp i = 0; i < count; i++) {
            const float below = numbers[i] > 20.0f ? 20.0f : numbers[i];
            numbers[i] = below < -20.0f ? -20.0f : below;
        }
        /* A separate loop, which compilers can vectorize. */
        for (npy_intp i = 0; i < count; i++) numbers[i] = tanh_of(numbers[i]);
    } else {
        for (npy_intp i = 0; i < count; i++) numbers[i] = numbers[i] <= 0 ? 0 : numbers[i];
    }
}

/* Computes all layers for some rows and returns a pointer to the outputs, which are in `room`.
   `room` has space for the outputs of two layers. */
FORCE_INLINE const float *forward(const Mlp *mlp, const float *ins, npy_intp stride, float *room,
                                  const int rows)
{
    for (npy_intp n = 0; n < mlp->num_layers; n++) {
        const Layer *layer = mlp->layers + n;
        float *outs = room + (n % 2) * ROWS * mlp->widest;
        for (npy_intp column = 0; column < layer->width; column += BLOCK) {
            sum_block(layer, column, ins, stride, outs, rows);
        }
        if (n + 1 < mlp->num_layers) activate(outs, rows * layer->width, mlp->is_tanh);
        ins = outs, stride = layer->width;
    }
    return ins;
}

FOR_ALL_PROCESSORS
static void evaluate_rows(const Mlp *mlp, const float *inputs, npy_intp stride, npy_intp count,
                          float *out, float *room)
{
    const Layer *last = mlp->layers + mlp->num_layers - 1;
    for (npy_intp row = 0; row < count;) {
        const float *ins = inputs + row * stride;
        const int rows = count - row < ROWS ? 1 : ROWS;
        const float *found = rows == 1 ? forward(mlp, ins, stride, room, 1)
                                       : forward(mlp, ins, stride, room, ROWS);
        for (int r = 0; r < rows; r++, row++) {
            memcpy(out + row * last->outputs, found + r * last->width,
                   (size_t)last->outputs * sizeof *out);
        }
    }
}

/* evaluate(inputs, out): writes the outputs for each row of inputs. Rows may have additional
   columns after the network's inputs, which are ignored. */
static PyObject *mlp_evaluate(PyObject *self, PyObject *args)
{
    const Mlp *mlp = (const Mlp *)self;
    Floats inputs, out;
    if (!PyArg_ParseTuple(args, "O&O&", as_floats, &inputs, as_written_floats, &out)) return NULL;
    const npy_intp outputs = mlp->layers[mlp->num_layers - 1].outputs, count = out.size / outputs;
    const npy_intp stride = count ? inputs.size / count : 0;
    if (out.size != count * outputs || inputs.size != count * stride ||
        (count && stride < mlp->layers[0].inputs)) {
        return PyErr_Format(PyExc_ValueError, "rows of %zd inputs and %zd outputs do not fit",
                            mlp->layers[0].inputs, outputs);
    }
    float *room = PyMem_Malloc((size_t)(2 * ROWS * mlp->widest) * sizeof *room);
    if (!room) return PyErr_NoMemory();
    evaluate_rows(mlp, inputs.data, stride, count, out.data, room);
    PyMem_Free(room);
    Py_RETURN_NONE;
}

static int set_layer(Mlp *mlp, Layer *layer, PyObject *weights, npy_intp inputs)
{
    Floats matrix, bias;
    if (!PyArg_ParseTuple(weights, "O&O&", as_floats, &matrix, as_floats, &bias)) return -1;
    const npy_intp outputs = bias.size;
    if (!outputs || !matrix.size || matrix.size % outputs ||
        (inputs && matrix.size != inputs * outputs)) {
        return refuse("the layers' shapes do not fit");
    }
    layer->inputs = matrix.size / outputs, layer->outputs = outputs;
    layer->width = (outputs + BLOCK - 1) / BLOCK * BLOCK;
    layer->matrix = room_for(mlp, layer->inputs * layer->width, sizeof(float));
    layer->bias = room_for(mlp, layer->width, sizeof(float));
    if (!layer->matrix || !layer->bias) return -1;
    memcpy(layer->bias, bias.data, (size_t)outputs * sizeof(float));
    for (npy_intp i = 0; i < layer->inputs; i++) {
        memcpy(layer->matrix + i * layer->width, matrix.data + i * outputs,
               (size_t)outputs * sizeof(float));
    }
    if (layer->width > mlp->widest) mlp->widest = layer->width;
    return 0;
}

static int mlp_set_up(Mlp *mlp, PyObject *args, PyObject *kwargs)
{
    static char *NAMES[] = {"layers", "is_tanh", NULL};
    PyObject *layers;
    if (!PyArg_ParseTupleAndKeywords(args, kwargs, "O!p", NAMES, &PyTuple_Type, &layers,
                                     &mlp->is_tanh)) {
        return -1;
    }
    mlp->given = layers, mlp->num_layers = PyTuple_GET_SIZE(layers);
    if (!mlp->num_layers) return refuse("there are no layers");
    if (!(mlp->layers = room_for(mlp, mlp->num_layers, sizeof(Layer)))) return -1;
    npy_intp inputs = 0;
    for (npy_intp n = 0; n < mlp->num_layers; n++) {
        PyObject *weights = PyTuple_GET_ITEM(layers, n);
        if (!PyTuple_Check(weights)) {
            PyErr_SetString(PyExc_TypeError, "a layer must be a tuple of a matrix and a bias");
            return -1;
        }
        if (set_layer(mlp, mlp->layers + n, weights, inputs) < 0) return -1;
        inputs = mlp->layers[n].outputs;
    }
    return 0;
}

/* Pickled and copied objects are rebuilt from the constructor's arguments. */
static PyObject *mlp_reduce(PyObject *self, PyObject *Py_UNUSED(none))
{
    const Mlp *mlp = (const Mlp *)self;
    return Py_BuildValue("O(Oi)", Py_TYPE(self), mlp->given, mlp->is_tanh);
}

KERNEL_TYPE(Mlp, mlp, "A multilayer perceptron.",
            {"evaluate", mlp_evaluate, METH_VARARGS, "Writes the outputs for rows of inputs."},
            {"__reduce__", mlp_reduce, METH_NOARGS, "Returns the parts of a pickle."})
