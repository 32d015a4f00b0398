/* Speed or acceleration and a steering angle or its speed, as throttle, steering and brake.

   Its numpy twin is stkzoo.kernel.reference.car_controller; the formulas are those of
   stkzoo.wrappers.control. */

#include "kernel.h"

#include <math.h>

enum { NUM_GEARS = 4 };

/* A measured kart, see stkzoo.wrappers.control.pedals. */
typedef struct {
    double gears[NUM_GEARS], thrust[NUM_GEARS + 1], brake[NUM_GEARS + 1];
    double reverse, reverse_speed, roll_drag, air_drag, self_stop_speed, stop_speed, rolling;
} Pedals;

/* What an agent's controller remembers, and how long its steps are. */
typedef struct {
    double angle, owed, step_size;
} State;

typedef struct {
    PyObject_HEAD
    PyObject *model; /* keeps pedals alive */
    const Pedals *pedals;
    int is_speed, is_angle, is_normalized; /* what is asked for, and in which units */
    double steer_low, steer_high, low, high, v_min, v_max, sv_max, speed_gain;
    int throttle_column, steer_column, brake_column, num_columns;
} CarController;

static double clipped(double value, double low, double high)
{
    value = value > low ? value : low;
    return value < high ? value : high;
}

static double sign(double value)
{
    return value > 0 ? 1 : value < 0 ? -1 : 0;
}

static int gear(const Pedals *pedals, double speed)
{
    int gear = 0;
    while (gear < NUM_GEARS && pedals->gears[gear] < speed) gear++;
    return gear;
}

static double thrust(const Pedals *pedals, double speed)
{
    return pedals->thrust[gear(pedals, speed)];
}

static double braking(const Pedals *pedals, double speed)
{
    return speed > pedals->reverse_speed ? pedals->brake[gear(pedals, speed)] : pedals->reverse;
}

static double drag(const Pedals *pedals, double speed)
{
    return sign(speed) * (pedals->roll_drag + pedals->air_drag * speed * speed);
}

static double press(const Pedals *pedals, double accl, double speed, double step, int *brake)
{
    const double force = accl + drag(pedals, speed), next = fabs(speed + accl * step);
    double throttle = clipped(force / thrust(pedals, speed), 0, 1);
    const int stops = fabs(speed) < pedals->stop_speed && next < 0.5 &&
                      next <= 0.55 * fabs(speed) + 0.02;
    *brake = force < -braking(pedals, speed) / 2 && !stops;
    if (stops || *brake) return 0;
    if (fabs(speed) < pedals->self_stop_speed + 0.5 && throttle < pedals->rolling) {
        throttle = pedals->rolling;
    }
    return throttle;
}

static double effect(const Pedals *pedals, double throttle, int brake, double speed, double step)
{
    if (brake) return -braking(pedals, speed) - drag(pedals, speed);
    if (throttle <= 0 && fabs(speed) < pedals->self_stop_speed) {
        const double most = fabs(speed) / step;
        return -sign(speed) * (most < 30.0 ? most : 30.0);
    }
    return throttle * thrust(pedals, speed) - drag(pedals, speed);
}

static double physical(const CarController *self, double value, double low, double high)
{
    return self->is_normalized ? low + (value + 1.0) / 2.0 * (high - low) : value;
}

static double steer(const CarController *self, double asked, double angle, double most, double step)
{
    const double rate = self->is_angle ? (asked - angle) / step : asked;
    return clipped(angle + clipped(rate, -self->sv_max, self->sv_max) * step, -most, most);
}

static double accelerate(const CarController *self, double asked, double speed, double step)
{
    if (self->is_speed) {
        const double most = 0.8 / step;
        return (asked - speed) * (most < self->speed_gain ? most : self->speed_gain);
    }
    const double slowest = (self->v_min - speed) / step, fastest = (self->v_max - speed) / step;
    return clipped(asked, slowest < 0 ? slowest : 0, fastest > 0 ? fastest : 0);
}

/* What was asked for in a row of controls, replaced by what the game is told. */
static void drive(const CarController *self, const Kart *kart, State *state, float *row)
{
    const Pedals *pedals = self->pedals;
    const double speed = kart->velocity_lc[2], step = state->step_size;
    const double most = kart->max_steer_angle > 1e-3 ? kart->max_steer_angle : 1e-3;
    const double turn = physical(self, row[self->steer_column], self->steer_low, self->steer_high);
    const double asked = physical(self, row[self->throttle_column], self->low, self->high);
    double accl = accelerate(self, asked, speed, step), throttle;
    int brake;
    state->angle = steer(self, turn, state->angle, most, step);
    if (self->is_speed) {
        throttle = press(pedals, accl, speed, step, &brake);
        state->owed = 0;
    } else {
        const double pull = drag(pedals, speed);
        accl = clipped(accl, -braking(pedals, speed) - pull, thrust(pedals, speed) - pull);
        accl += state->owed / step;
        throttle = press(pedals, accl, speed, step, &brake);
        const double given = effect(pedals, throttle, brake, speed, step);
        state->owed = clipped((accl - given) * step, -2.0, 2.0);
    }
    row[self->throttle_column] = (float)throttle;
    row[self->steer_column] = (float)(state->angle / most);
    row[self->brake_column] = (float)brake;
}

/* drive(controls, rows, data, karts, states, places): for each i, the controls in row rows[i] of
   the kart karts[i] at a snapshot's moment, with the memory in row places[i] of the states. */
static PyObject *controller_drive(PyObject *object, PyObject *const *args, Py_ssize_t nargs)
{
    const CarController *self = (CarController *)object;
    Moment moment;
    npy_intp size, num_rows, num_karts, num_places, num_states;
    if (nargs != 6) return PyErr_Format(PyExc_TypeError, "drive() takes 6 arguments");
    float *controls = numbers_of(args[0], "controls", NPY_FLOAT32, &size);
    if (!controls) return NULL;
    const npy_intp *rows = numbers_of(args[1], "rows", NPY_INTP, &num_rows);
    if (!rows || read_moment(args[2], &moment) < 0) return NULL;
    const npy_intp *karts = numbers_of(args[3], "karts", NPY_INTP, &num_karts);
    if (!karts) return NULL;
    State *states = numbers_of(args[4], "states", NPY_FLOAT64, &num_states);
    if (!states) return NULL;
    const npy_intp *places = numbers_of(args[5], "places", NPY_INTP, &num_places);
    if (!places) return NULL;
    if (num_rows != num_karts || num_rows != num_places) {
        return PyErr_Format(PyExc_ValueError, "%zd rows, %zd karts, %zd places", num_rows,
                            num_karts, num_places);
    }
    for (npy_intp i = 0; i < num_rows; i++) {
        if (rows[i] < 0 || (rows[i] + 1) * self->num_columns > size || karts[i] < 0 ||
            karts[i] >= moment.header->num_kart || places[i] < 0 ||
            3 * (places[i] + 1) > num_states) {
            return PyErr_Format(PyExc_IndexError, "there is no row, kart or state number %zd", i);
        }
        drive(self, moment.karts + karts[i], states + places[i],
              controls + rows[i] * self->num_columns);
    }
    Py_RETURN_NONE;
}

/* CarController(act, kinds, limits, pedals, columns, num_columns) */
static PyObject *controller_new(PyTypeObject *type, PyObject *args, PyObject *Py_UNUSED(kwargs))
{
    PyObject *act, *model;
    npy_intp size;
    CarController *self = (CarController *)type->tp_alloc(type, 0);
    if (!self) return NULL;
    if (!PyArg_ParseTuple(args, "O(ppp)(dddddddd)O(iii)i", &act, &self->is_speed, &self->is_angle,
                          &self->is_normalized, &self->steer_low, &self->steer_high, &self->low,
                          &self->high, &self->v_min, &self->v_max, &self->sv_max,
                          &self->speed_gain, &model, &self->throttle_column, &self->steer_column,
                          &self->brake_column, &self->num_columns) ||
        !(self->pedals = numbers_of(model, "pedals", NPY_FLOAT64, &size))) {
        Py_DECREF(self);
        return NULL;
    }
    Py_INCREF(model);
    self->model = model;
    const int columns[] = {self->throttle_column, self->steer_column, self->brake_column};
    int fits = size * sizeof(double) == sizeof(Pedals);
    for (int i = 0; i < 3; i++) fits &= columns[i] >= 0 && columns[i] < self->num_columns;
    if (!fits) {
        PyErr_SetString(PyExc_ValueError, "the pedals or columns do not fit");
        Py_CLEAR(self);
    }
    return (PyObject *)self;
}

static void controller_dealloc(PyObject *object)
{
    Py_XDECREF(((CarController *)object)->model);
    Py_TYPE(object)->tp_free(object);
}

static PyMethodDef controller_methods[] = {
    FAST_METHOD("drive", controller_drive, "What was asked for, replaced by controls."),
    {NULL, NULL, 0, NULL},
};

KERNEL_TYPE(CarController, controller, "Physical actions as controls.")
