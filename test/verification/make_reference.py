"""Make data/forced_motion.json and data/ten_thousand_wrenches.json: driven triaxial bodies, to 30 digits.

    python test/verification/make_reference.py [forced_motion] [ten_thousand_wrenches]

The first is one wrench held in both frames for 10 s; it takes a minute. In the second both wrenches change every
0.01 s for 100 s; it takes some minutes.

The method is a Taylor series in mpmath for quaternion, angular velocity in body axes with the full inertia matrix,
motion of the centre of mass, and the integrals of force, torque and power. It shares no code and no equations with the
package, which works in principal axes and with angular momentum. Each is computed twice, with another order, step or
precision, and energy and momentum have to balance.
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

from mpmath import matrix, mp, mpf, nstr

ORDER = 45
STEP = "0.0625"
TIMES = (1, 2, 5, 10)
DIGITS = 30
DATA = Path(__file__).parent / "data"

CASE = {
    "mass": 3.7,
    "center_of_mass": [0.11, -0.07, 0.23],
    "inertia": [[2.1, 0.13, -0.27], [0.13, 1.7, 0.31], [-0.27, 0.31, 2.9]],
    "position_world": [1.5, -2.0, 0.25],
    "orientation_xyzw": [0.5, -0.1, 0.7, 0.5],
    "linear_velocity_world": [0.3, -0.1, 0.2],
    "angular_velocity_body": [0.7, -1.1, 0.9],
    "force_body": [0.9, -0.4, 0.6],
    "torque_body": [0.3, -0.2, 0.25],
    "force_world": [-0.5, 0.8, 0.3],
    "torque_world": [0.2, 0.35, -0.3],
}

CONVENTIONS = (
    "SI; quaternions (x, y, z, w), body to world; the initial one is normalised exactly; every input is the IEEE "
    "double nearest the decimal shown; {held}, forces through the centre of mass; position and velocity are those of "
    f"the body origin; states to {DIGITS} digits"
)

COUNT = 10_000
PERIOD = "0.01"
MARKS = (100, 1000, 2500, 5000, 10_000)
WRENCHES = ("force_body", "torque_body", "force_world", "torque_world")

COMMANDED = {
    "mass": 2.6,
    "center_of_mass": [-0.13, 0.21, 0.08],
    "inertia": [[1.9, -0.21, 0.17], [-0.21, 2.6, 0.29], [0.17, 0.29, 1.4]],
    "position_world": [-0.75, 0.5, 2.0],
    "orientation_xyzw": [-0.5, 0.1, 0.5, 0.7],
    "linear_velocity_world": [-0.2, 0.15, 0.1],
    "angular_velocity_body": [0.4, -0.7, 0.6],
}

# Amplitude (N or N m), frequency (rad per command) and phase of each component of each wrench. Neighbouring commands
# differ by up to a third of the amplitude, and no two components share a frequency.
SINES = {
    "force_body": ((0.9, 0.23, 0.1), (0.7, 0.31, 1.3), (0.8, 0.17, 2.2)),
    "torque_body": ((0.5, 0.29, 0.7), (0.4, 0.19, 2.9), (0.6, 0.37, 1.9)),
    "force_world": ((0.6, 0.13, 2.5), (0.9, 0.27, 0.4), (0.7, 0.33, 1.1)),
    "torque_world": ((0.4, 0.21, 1.7), (0.6, 0.35, 0.2), (0.5, 0.15, 2.6)),
}
UNIT = 1024


def commanded(k):
    """Return the four vectors held from k * 0.01 s on: sines rounded to 1/1024, the same doubles on every machine."""
    return {
        name: tuple(round(UNIT * a * math.sin(b * k + c)) / UNIT for a, b, c in components)
        for name, components in SINES.items()
    }


def distance_from_a_tie():
    """Return how far (in 1/1024) the rounding of any command is from turning over: rounding of `sin` is no danger."""
    return min(
        abs(abs(UNIT * a * math.sin(b * k + c)) % 1.0 - 0.5)
        for k in range(COUNT)
        for components in SINES.values()
        for a, b, c in components
    )


def numbers(values):
    """Return the IEEE doubles nearest to the decimals shown, exactly."""
    return [mpf(float(v)) for v in values]


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def rotation_entries(xx, yy, zz, ww, xy, xz, yz, xw, yw, zw):
    """Return R(q) from the products of the components of q; homogeneous, so that it holds for coefficients too."""
    return [
        [xx - yy - zz + ww, 2 * (xy - zw), 2 * (xz + yw)],
        [2 * (xy + zw), yy - xx - zz + ww, 2 * (yz - xw)],
        [2 * (xz - yw), 2 * (yz + xw), zz - xx - yy + ww],
    ]


def rotation(q):
    x, y, z, w = q
    return rotation_entries(x * x, y * y, z * z, w * w, x * y, x * z, y * z, x * w, y * w, z * w)


def times(rows, v):
    return [sum(row[i] * v[i] for i in range(3)) for row in rows]


def transposed(rows):
    return [[rows[j][i] for j in range(3)] for i in range(3)]


def value(series, h):
    """Return the polynomial with these coefficients, lowest first, at h (Horner)."""
    total = mpf(0)
    for coefficient in reversed(series):
        total = total * h + coefficient
    return total


class Motion:
    """The unknowns: q (4), w (3, body), x and v of the centre of mass (3 + 3), impulses (3 + 3) and work."""

    def __init__(self, case):
        inertia = matrix([numbers(row) for row in case["inertia"]])
        self.inertia = [[inertia[i, j] for j in range(3)] for i in range(3)]
        inverse = inertia**-1
        self.inverse = [[inverse[i, j] for j in range(3)] for i in range(3)]
        self.mass = mpf(case["mass"])
        self.hold({name: case.get(name, (0.0, 0.0, 0.0)) for name in WRENCHES})
        self.arm = numbers(case["center_of_mass"])
        q = numbers(case["orientation_xyzw"])
        length = mp.sqrt(sum(c * c for c in q))
        q = [c / length for c in q]
        w = numbers(case["angular_velocity_body"])
        turn = rotation(q)
        x = [a + b for a, b in zip(numbers(case["position_world"]), times(turn, self.arm), strict=True)]
        spin = times(turn, cross(w, self.arm))
        v = [a + b for a, b in zip(numbers(case["linear_velocity_world"]), spin, strict=True)]
        self.start = [*q, *w, *x, *v, *([mpf(0)] * 7)]

    def hold(self, wrenches):
        """Apply these four vectors from now on."""
        self.force_body, self.torque_body = numbers(wrenches["force_body"]), numbers(wrenches["torque_body"])
        self.force_world, self.torque_world = numbers(wrenches["force_world"]), numbers(wrenches["torque_world"])

    def coefficients(self, y, order):
        """Return the Taylor coefficients of all unknowns at the point y, by recurrence."""
        c = [[component] for component in y]

        def product(a, b, n):
            return mp.fdot(a[: n + 1], b[n::-1])

        momentum, torque, force = ([[], [], []] for _ in range(3))
        torque_body = [[], [], []]
        for n in range(order):
            x, y_, z, w = c[0], c[1], c[2], c[3]
            pairs = ((x, x), (y_, y_), (z, z), (w, w), (x, y_), (x, z), (y_, z), (x, w), (y_, w), (z, w))
            turn = rotation_entries(*(product(a, b, n) for a, b in pairs))
            omega, velocity = c[4:7], c[10:13]
            now = [o[n] for o in omega]
            constant = 1 if n == 0 else 0
            f = times(turn, self.force_body)
            t = times(turn, self.torque_body)
            tb = times(transposed(turn), self.torque_world)
            m = times(self.inertia, now)
            for i in range(3):
                force[i].append(f[i] + constant * self.force_world[i])
                torque[i].append(t[i] + constant * self.torque_world[i])
                torque_body[i].append(tb[i] + constant * self.torque_body[i])
                momentum[i].append(m[i])
            gyro = [
                product(omega[(i + 1) % 3], momentum[(i + 2) % 3], n)
                - product(omega[(i + 2) % 3], momentum[(i + 1) % 3], n)
                for i in range(3)
            ]
            omega_dot = times(self.inverse, [torque_body[i][n] - gyro[i] for i in range(3)])
            a, b, g = omega
            q_dot = [
                (product(w, a, n) + product(y_, g, n) - product(z, b, n)) / 2,
                (product(w, b, n) + product(z, a, n) - product(x, g, n)) / 2,
                (product(w, g, n) + product(x, b, n) - product(y_, a, n)) / 2,
                -(product(x, a, n) + product(y_, b, n) + product(z, g, n)) / 2,
            ]
            power = sum(product(force[i], velocity[i], n) + product(torque_body[i], omega[i], n) for i in range(3))
            derivative = [
                *q_dot,
                *omega_dot,
                *(velocity[i][n] for i in range(3)),
                *(force[i][n] / self.mass for i in range(3)),
                *(force[i][n] for i in range(3)),
                *(torque[i][n] for i in range(3)),
                power,
            ]
            for series, d in zip(c, derivative, strict=True):
                series.append(d / (n + 1))
        return c

    def states(self, step, order):
        """Return the unknowns at TIMES."""
        y, h, found = list(self.start), mpf(step), []
        for k in range(1, round(TIMES[-1] / h) + 1):
            y = [value(series, h) for series in self.coefficients(y, order)]
            if k * h in TIMES:
                found.append(list(y))
        return found

    def commanded_states(self, order):
        """Return the unknowns at MARKS, one step for each command."""
        y, h, found = list(self.start), mpf(PERIOD), []
        for k in range(COUNT):
            self.hold(commanded(k))
            y = [value(series, h) for series in self.coefficients(y, order)]
            if k + 1 in MARKS:
                found.append(list(y))
        return found

    def outputs(self, time, y):
        """Return what is compared: everything of the body origin, as the package gives it."""
        q, w = y[0:4], y[4:7]
        turn = rotation(q)
        arm, spin = times(turn, self.arm), times(turn, cross(w, self.arm))
        values = {
            "position_world": [a - b for a, b in zip(y[7:10], arm, strict=True)],
            "orientation_xyzw": q,
            "linear_velocity_world": [a - b for a, b in zip(y[10:13], spin, strict=True)],
            "angular_velocity_body": w,
            "impulse_world": y[13:16],
            "torque_impulse_world": y[16:19],
            "work": y[19],
        }
        texts = {k: [nstr(c, DIGITS) for c in v] if isinstance(v, list) else nstr(v, DIGITS) for k, v in values.items()}
        return {"time": time, **texts}

    def energy(self, y):
        w, v = y[4:7], y[10:13]
        return (sum(a * b for a, b in zip(w, times(self.inertia, w), strict=True)) + self.mass * mp.fdot(v, v)) / 2


def largest_difference(first, second):
    return max(abs(a - b) for f, s in zip(first, second, strict=True) for a, b in zip(f, s, strict=True))


def imbalance(motion, states):
    """Return the largest |T - T0 - W|, J: both sides come from the unknowns, by different ones of them."""
    return max(abs(motion.energy(y) - motion.energy(motion.start) - y[19]) for y in states)


def write(name, document):
    (DATA / f"{name}.json").write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def forced_motion():
    mp.dps = 60
    motion = Motion(CASE)
    coarse, fine = motion.states(STEP, ORDER), motion.states(mpf(STEP) / 2, ORDER + 5)
    agreement, balance = largest_difference(coarse, fine), imbalance(motion, fine)
    assert agreement < mpf(10) ** -40, nstr(agreement, 3)
    assert balance < mpf(10) ** -40, nstr(balance, 3)
    document = {
        "conventions": CONVENTIONS.format(held="body and world wrench are held from 0 on"),
        "how": f"Taylor order {ORDER + 5}, step {STEP}/2 s, 60 digits (make_reference.py); order {ORDER} with twice "
        f"the step agrees to {nstr(agreement, 1)}, kinetic energy less work is constant to {nstr(balance, 1)} J",
        "case": CASE,
        "states": [motion.outputs(t, y) for t, y in zip(TIMES, fine, strict=True)],
    }
    write("forced_motion", document)


def ten_thousand_wrenches():
    margin = distance_from_a_tie()
    assert margin > 1e-9, margin
    mp.dps = 42
    check = Motion(COMMANDED).commanded_states(18)
    mp.dps = 50
    motion = Motion(COMMANDED)
    states = motion.commanded_states(22)
    agreement, balance = largest_difference(check, states), imbalance(motion, states)
    assert agreement < mpf(10) ** -33, nstr(agreement, 3)
    assert balance < mpf(10) ** -33, nstr(balance, 3)
    document = {
        "conventions": CONVENTIONS.format(
            held="body and world wrench change every 0.01 s, as commanded() of the generator says"
        ),
        "how": "Taylor order 22, step 0.01 s, 50 digits (make_reference.py); order 18 in 42 digits agrees to "
        f"{nstr(agreement, 1)}, kinetic energy less work is constant to {nstr(balance, 1)} J",
        "case": COMMANDED,
        "states": [motion.outputs(k // 100, y) for k, y in zip(MARKS, states, strict=True)],
    }
    write("ten_thousand_wrenches", document)


MADE = {"forced_motion": forced_motion, "ten_thousand_wrenches": ten_thousand_wrenches}


def main(names):
    for name in names or MADE:
        MADE[name]()


if __name__ == "__main__":
    main(sys.argv[1:])
