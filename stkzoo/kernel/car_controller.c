/* Converts a speed or an acceleration, and a steering angle or steering speed, to throttle,
   steering and brake.

   CarAction.controls in stkzoo.wrappers.control calls it too. tests/oracle has the same formulas. */

#include "kernel.h"

#include <math.h>

enum { NUM_GEARS = 4 };
enum { THROTTLE, STEERING, BRAKE }; /* the first controls */

/* The measured model of a kart: PEDALS in stkzoo.wrappers.control.kart. */
typedef struct {
    double gears[NUM_GEARS], thrust[NUM_GEARS + 1], brake[NUM_GEARS + 1];
    double reverse, reverse_speed, roll_drag, air_drag, self_stop_speed, stop_speed, rolling;
} Pedals;

/* Memory of an agent's controller: the wheel angle [rad], the remaining speed change [m/s], and the
   step size [s]. */
typedef struct {
    double angle, owed, step_size;
} State;

typedef struct {
    OBJECT_HEAD
    const Pedals *pedals;
    /* Whether actions are speeds (otherwise accelerations), steering angles (otherwise steering
       speeds), and in [-1, 1] (otherwise in physical units). */
    int is_speed, is_angle, is_normalized;
    double steer_low, steer_high, low, high, v_min, v_max, sv_max, speed_gain, steer_lag;
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
    const double share = self->steer_lag > 0 ? 1.0 - exp(-step / self->steer_lag) : 1.0;
    const double rate = self->is_angle ? (asked - angle) / step * share : asked;
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

/* Replaces the action in a row of controls with the game's controls. */
static void drive(const CarController *self, const Kart *kart, State *state, float *row)
{
    const Pedals *pedals = self->pedals;
    const double speed = kart->velocity_lc[2], step = state->step_size;
    const double most = kart->max_steer_angle > 1e-3 ? kart->max_steer_angle : 1e-3;
    const double turn = physical(self, row[STEERING], self->steer_low, self->steer_high);
    const double asked = physical(self, row[THROTTLE], self->low, self->high);
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
    row[THROTTLE] = (float)throttle;
    row[STEERING] = (float)(state->angle / most);
    row[BRAKE] = (float)brake;
}

/* drive(controls, rows, data, karts, states, places): for each i, replaces the action in row
   rows[i] of `controls` with the game's controls for kart karts[i] of a snapshot, and updates the
   memory in row places[i] of `states`. */
static PyObject *controller_drive(PyObject *object, PyObject *args)
{
    const CarController *self = (CarController *)object;
    Floats controls;
    Snapshot snapshot;
    Doubles memory;
    Indices rows, karts, places;
    if (!PyArg_ParseTuple(args, "O&O&O&O&O&O&", as_written_floats, &controls, as_indices, &rows,
                          as_snapshot, &snapshot, as_indices, &karts, as_written_doubles, &memory,
                          as_indices, &places)) {
        return NULL;
    }
    const npy_intp num_rows = controls.size / NUM_CONTROLS;
    if (check_rows("kart", karts, snapshot.header->num_kart, rows, num_rows) < 0 ||
        check_rows("state", places, memory.size / 3, rows, num_rows) < 0) {
        return NULL;
    }
    State *states = (State *)memory.data;
    for (npy_intp i = 0; i < rows.size; i++) {
        drive(self, snapshot.karts + karts.data[i], states + places.data[i],
              controls.data + rows.data[i] * NUM_CONTROLS);
    }
    Py_RETURN_NONE;
}

/* CarController(kinds, limits, pedals): whether the numbers are a speed, an angle and normalized; the
   limits of the numbers and of the kart; the model of the kart. */
static int controller_set_up(CarController *self, PyObject *args, PyObject *Py_UNUSED(kwargs))
{
    Doubles model;
    if (!PyArg_ParseTuple(args, "(ppp)(ddddddddd)O&", &self->is_speed, &self->is_angle,
                          &self->is_normalized, &self->steer_low, &self->steer_high, &self->low,
                          &self->high, &self->v_min, &self->v_max, &self->sv_max,
                          &self->speed_gain, &self->steer_lag, as_doubles, &model)) {
        return -1;
    }
    self->pedals = (const Pedals *)model.data;
    return model.size * sizeof(double) == sizeof(Pedals) ? 0 : refuse("the pedals do not fit");
}

KERNEL_TYPE(CarController, controller, "Converts physical actions to controls.",
            {"drive", controller_drive, METH_VARARGS, "Replaces physical actions with controls."})
