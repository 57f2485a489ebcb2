/* The rk4 step of rb_dynamics in plain C, for the comparison alone: the arithmetic of rb_dynamics/motion/rk4.py and of
 * `grown` in rb_dynamics/motion/phase_state.py, operation by operation, so that -ffp-contract=off leaves the same bits
 * (benchmarks/peers/c.py checks it). With books = 0 it is what one writes by hand who wants the state alone.
 *
 * Numbers as in rb_dynamics/motion/kernel_layout.py:
 * constants (16): mass, three moments, force and torque in principal axes, force and torque in world axes.
 * state (35): quaternion (x, y, z, w), angular velocity, 14 sums and their 14 rests.
 */
#include <math.h>
#include <string.h>

#define CONSTANTS 16
#define STATE 35
#define LANES 64 /* bodies that are taken through all steps before the next ones: they stay in the first cache */
#define INLINE static inline __attribute__((always_inline))

/* R(q) v for a quaternion of any length, twice = 2 / |q|^2. */
INLINE void rotate(double x, double y, double z, double w, double twice, const double v[3], double out[3])
{
    double tx = twice * (y * v[2] - z * v[1]), ty = twice * (z * v[0] - x * v[2]), tz = twice * (x * v[1] - y * v[0]);
    out[0] = v[0] + w * tx + (y * tz - z * ty);
    out[1] = v[1] + w * ty + (z * tx - x * tz);
    out[2] = v[2] + w * tz + (x * ty - y * tx);
}

INLINE void add_to_sum(double *high, double *low, double a, int books)
{
    double total = *high + a;
    if (books) {
        double part = total - *high;
        *low = *low + ((*high - (total - part)) + (a - part));
    }
    *high = total;
}

typedef struct {
    double spin[4], angular[3], force[3], torque[3], power;
} Slope;

INLINE Slope slope(const double c[CONSTANTS], const double inverse[3], const double v[3], const double q[4],
                   const double w[3], int alone)
{
    const double *I = c + 1;
    Slope out;
    double twice = 2.0 / (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    double force[3], torque[3];
    rotate(q[0], q[1], q[2], q[3], twice, c + 4, force);
    for (int k = 0; k < 3; k++) {
        out.force[k] = force[k] + c[10 + k];
        torque[k] = c[7 + k];
    }
    /* A torque of the world is rare; side by side it is cheaper to turn it than to ask. */
    if (!alone || c[13] != 0.0 || c[14] != 0.0 || c[15] != 0.0) {
        double turned[3];
        rotate(-q[0], -q[1], -q[2], q[3], twice, c + 13, turned);
        for (int k = 0; k < 3; k++)
            torque[k] = torque[k] + turned[k];
    }
    double a = 0.5 * w[0], b = 0.5 * w[1], g = 0.5 * w[2];
    out.spin[0] = q[3] * a + q[1] * g - q[2] * b;
    out.spin[1] = q[3] * b + q[2] * a - q[0] * g;
    out.spin[2] = q[3] * g + q[0] * b - q[1] * a;
    out.spin[3] = -q[0] * a - q[1] * b - q[2] * g;
    out.angular[0] = (torque[0] + (I[1] - I[2]) * w[1] * w[2]) * inverse[0];
    out.angular[1] = (torque[1] + (I[2] - I[0]) * w[2] * w[0]) * inverse[1];
    out.angular[2] = (torque[2] + (I[0] - I[1]) * w[0] * w[1]) * inverse[2];
    rotate(q[0], q[1], q[2], q[3], twice, torque, out.torque);
    out.power = (out.force[0] * v[0] + out.force[1] * v[1] + out.force[2] * v[2])
                + (torque[0] * w[0] + torque[1] * w[1] + torque[2] * w[2]);
    return out;
}

/* One step of h s. Constants and state are `stride` numbers apart: 1 for one body, LANES for many. */
INLINE void step(const double *constants, double *s, int stride, double h, int books)
{
#define S(k) s[(k) * stride]
    double c[CONSTANTS];
    for (int k = 0; k < CONSTANTS; k++)
        c[k] = constants[k * stride];
    const double inverse_mass = 1.0 / c[0], inverse[3] = {1.0 / c[1], 1.0 / c[2], 1.0 / c[3]};
    const double half = 0.5 * h, ahead[3] = {half, half, h}, sixth = h / 6.0;
    const double q0[4] = {S(0), S(1), S(2), S(3)}, w0[3] = {S(4), S(5), S(6)};
    double v0[3], q[4], w[3], v[3];
    for (int k = 0; k < 3; k++)
        v0[k] = inverse_mass * (books ? S(10 + k) + S(24 + k) : S(10 + k));

    Slope at[4];
    at[0] = slope(c, inverse, v0, q0, w0, stride == 1);
#pragma GCC unroll 3
    for (int i = 0; i < 3; i++) {
        for (int k = 0; k < 4; k++)
            q[k] = q0[k] + ahead[i] * at[i].spin[k];
        for (int k = 0; k < 3; k++) {
            w[k] = w0[k] + ahead[i] * at[i].angular[k];
            v[k] = v0[k] + (ahead[i] * inverse_mass) * at[i].force[k];
        }
        at[i + 1] = slope(c, inverse, v, q, w, stride == 1);
    }
#define SUM(name) (at[0].name + at[3].name + 2.0 * (at[1].name + at[2].name))
    for (int k = 0; k < 4; k++)
        q[k] = q0[k] + sixth * SUM(spin[k]);
    double square = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
    double n = sqrt(square);
    n = fabs(n - 1.0) > 0x1p-51 ? n : 1.0;          /* as `renormalize` in rotation.py */
    n = 0.5 < square && square < 2.0 ? n : NAN; /* turned too far: no rotation any more */
    for (int k = 0; k < 4; k++)
        S(k) = q[k] / n;
    for (int k = 0; k < 3; k++) {
        S(4 + k) = w0[k] + sixth * SUM(angular[k]);
        double impulse = sixth * SUM(force[k]);
        double place = h * v0[k]
                       + h * sixth * inverse_mass * (at[0].force[k] + (at[1].force[k] + at[2].force[k]));
        add_to_sum(&S(7 + k), &S(21 + k), place, books);
        add_to_sum(&S(10 + k), &S(24 + k), impulse, books);
        if (books) {
            add_to_sum(&S(13 + k), &S(27 + k), impulse, books);
            add_to_sum(&S(16 + k), &S(30 + k), sixth * SUM(torque[k]), books);
        }
    }
    if (books) {
        add_to_sum(&S(19), &S(33), sixth * (at[0].power + at[3].power + 2.0 * (at[1].power + at[2].power)), books);
        add_to_sum(&S(20), &S(34), h, books);
    }
}

/* n steps of one body under one wrench. */
#define RUN(name, books)                                                                                              \
    void name(const double *constants, double h, long n, double *state)                                               \
    {                                                                                                                 \
        double s[STATE];                                                                                              \
        memcpy(s, state, sizeof s);                                                                                   \
        for (long i = 0; i < n; i++)                                                                                  \
            step(constants, s, 1, h, books);                                                                          \
        memcpy(state, s, sizeof s);                                                                                   \
    }
RUN(run, 1)
RUN(run_bare, 0)

/* `count` wrenches (12 numbers each), n steps of h s under each. */
#define SCHEDULE(name, books)                                                                                         \
    void name(const double *constants, const double *wrenches, long count, double h, long n, double *state)           \
    {                                                                                                                 \
        double c[CONSTANTS], s[STATE];                                                                                \
        memcpy(c, constants, sizeof c);                                                                               \
        memcpy(s, state, sizeof s);                                                                                   \
        for (long k = 0; k < count; k++) {                                                                            \
            memcpy(c + 4, wrenches + 12 * k, 12 * sizeof(double));                                                    \
            for (long i = 0; i < n; i++)                                                                              \
                step(c, s, 1, h, books);                                                                              \
        }                                                                                                             \
        memcpy(state, s, sizeof s);                                                                                   \
    }
SCHEDULE(run_schedule, 1)
SCHEDULE(run_schedule_bare, 0)

/* n steps of the bodies first to last - 1; constants[16][bodies] and state[35][bodies], `bodies` a multiple of LANES. */
void run_many(const double *constants, double h, long n, double *state, long bodies, long first, long last)
{
    for (long start = first; start < last; start += LANES) {
        double c[CONSTANTS][LANES], s[STATE][LANES];
        for (int k = 0; k < CONSTANTS; k++)
            memcpy(c[k], constants + k * bodies + start, sizeof c[k]);
        for (int k = 0; k < STATE; k++)
            memcpy(s[k], state + k * bodies + start, sizeof s[k]);
        for (long i = 0; i < n; i++)
#pragma GCC ivdep
            for (int j = 0; j < LANES; j++)
                step(&c[0][j], &s[0][j], LANES, h, 1);
        for (int k = 0; k < STATE; k++)
            memcpy(state + k * bodies + start, s[k], sizeof s[k]);
    }
}
